"""What comes after an answer, in words: what a longer search would try, and which experiment would tell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from .words import joined, lowered, placed, sentence

if TYPE_CHECKING:
    from .discovery import Discovery


def untried_sentences(discovery: Discovery) -> tuple[str, ...]:
    """What a longer search would try next; nothing where it came to its end."""
    if not discovery.untried:
        return ()
    names = names_of(discovery)
    words = joined([structure_words(label, names) for label in discovery.untried])
    return (f"The search ended at its time limit. A longer one would try next: {words}.",)


def experiment_sentence(discovery: Discovery) -> str:
    """Which experiment would tell; that there is none when a class has none."""
    e = discovery.experiment
    if e is None:
        hints = [s.sentence for s in discovery.steps if len(s.members) > 1]
        told = f" What may: {lowered(sentence(hints[0]))}" if hints and hints[0] else ""
        return f"No input within the limits was found that would tell them apart.{told}" if hints else ""
    return f"The experiment that would tell: {lowered(sentence(e.sentence))}"


def structure_words(key: str, names: Mapping[str, str]) -> str:
    """A structure in words: its effects with their titles."""
    return " with ".join(names.get(label, label) for label in key.split(" + "))


def names_of(discovery: Discovery) -> dict[str, str]:
    """Title and site of every effect that was looked at, by label."""
    ranked = [*discovery.not_testable, *discovery.last_ranked]
    ranked += [r for s in discovery.steps for r in s.ranked]
    named = {label_of(s.effect, s.site): lowered(placed(s)) for s in discovery.steps}
    return {r.label: lowered(placed(r)) for r in ranked} | named


def label_of(effect: str, site: str) -> str:
    """``effect at site``, the key of `Discovery.probabilities`."""
    return f"{effect} at {site}" if site else effect
