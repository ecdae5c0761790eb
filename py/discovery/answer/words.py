"""The answer of a search in words: titles and places, shares and probabilities, the sentence of the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .discovery import Ranked, Step

ALMOST_ALL = 0.9999  # told as "over 99.9 %"
MOST = 6  # members of a class that are told
NAMES = ("Coulomb", "Stribeck", "Dahl", "Maxwell", "Bingham", "Karnopp")  # keep their capital in a sentence
NONE = "–"  # what does not exist


def said(verdict: str, steps: Sequence[Step], reason: str = "") -> str:
    """The result in a sentence: the ``reason`` why there is no name, where it is known, else what the verdict says."""
    if reason.strip():
        return reason.strip()
    if verdict == "none":
        return "No effect is missing: the model agrees with the recordings to within the noise of the sensors."
    if verdict == "unknown":
        named = f" beyond {joined([lowered(placed(s)) for s in steps])}" if steps else ""
        return f"Something is missing{named}, and no effect of the catalogue explains it: it gets no physical name."
    found = [class_words(s) if len(s.members) > 1 else lowered(placed(s)) for s in steps]
    return f"Missing in the model: {joined(found)}."


def placed(step: Step | Ranked) -> str:
    """Title and site in words."""
    title = step.title or step.effect
    return f"{title} at {step.site}" if step.site else title


def class_words(step: Step) -> str:
    """The members of a class, each with its probability where that is known."""
    known = {(r.effect, r.site): r for r in step.ranked}
    words = []
    for effect, site in step.members:
        row = known.get((effect, site))
        name = lowered(placed(row)) if row else f"{effect} at {site}"
        words.append(f"{name} ({certainty(row.probability)})" if row and math.isfinite(row.probability) else name)
    if len(words) > MOST:
        words[MOST:] = [f"one of {len(words) - MOST} others"]
    return " or ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def percent(share: float) -> str:
    r"""A share as percent: whole numbers, a decimal from 99 on, never rounded up to all or down to nothing.

    >>> percent(0.873), percent(0.9934), percent(0.99996), percent(1e-4), percent(float("nan"))
    ('87\xa0%', '99.3\xa0%', 'over 99.9\xa0%', 'under 1\xa0%', '–')
    """
    if not math.isfinite(share):
        return NONE
    if 0.9995 <= share < 1.0:
        return "over 99.9\u00a0%"
    if 0.0 < share < 0.005:
        return "under 1\u00a0%"
    text = f"{100.0 * share:.{1 if 0.99 <= share < 1.0 else 0}f}".replace("-", "−")
    return f"{'0' if text in ('−0', '0') else text}\u00a0%"


def certainty(probability: float) -> str:
    r"""A probability as percent: nothing that is inferred is certain.

    >>> certainty(1.0), certainty(0.62)
    ('over 99.9\xa0%', '62\xa0%')
    """
    return percent(min(probability, ALMOST_ALL))


def joined(words: Sequence[str]) -> str:
    """a, b and c."""
    words = list(words)
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def capitalised(text: str) -> str:
    """A sentence with its capital."""
    return text[:1].upper() + text[1:]


def lowered(text: str) -> str:
    """A title or sentence inside another: without its capital, unless its first word is a name or an abbreviation.

    >>> lowered("Internal leakage"), lowered("Coulomb friction"), lowered("LuGre friction"), lowered("BIC is 3.")
    ('internal leakage', 'Coulomb friction', 'LuGre friction', 'BIC is 3.')
    """
    first = text.split(" ", 1)[0]
    keep = first in NAMES or not (first[1:].islower() or len(first) == 1)
    return text if keep else text[:1].lower() + text[1:]


def sentence(text: str) -> str:
    """A text as a sentence: with a full stop, without the verb in front that errors carry."""
    text = text.strip().removeprefix("gap: ").removeprefix("identify: ")
    return text if not text or text.endswith((".", "!", "?")) else f"{text}."
