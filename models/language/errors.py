"""The one tree of errors. A message says what and where, then the next step:

``{path}: {rule broken} (got {value} {unit}). {what would be right}. {nearest name or next step}.``
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class HydrotwinError(Exception):
    """Anything the user can put right."""


class DeclarationError(HydrotwinError):
    """A name, value or bound that the model does not know or cannot take."""


class TopologyError(HydrotwinError):
    """Equations and unknowns do not match: open ports, singular or unsolvable systems."""


class UnitError(HydrotwinError):
    """Two quantities of different dimension meet, or a unit is not known."""


class DataError(HydrotwinError):
    """A file or recording that cannot be used as it is."""


class SolveError(HydrotwinError):
    """A numerical method failed: a run diverged, a fit did not move, a compiler stopped."""


def nearest(name: str, known: Iterable[str]) -> str:
    """The sentence that ends an "unknown name" error: the nearest right name, or the whole choice.

    >>> nearest("colomb", ["coulomb", "viscous"])
    "Did you mean 'coulomb'?"
    >>> nearest("zzz", ["coulomb", "viscous"])
    'Known: coulomb, viscous.'
    >>> nearest("COULOMB", ["coulomb", "viscous"])
    "Did you mean 'coulomb'?"
    """
    known = list(known)
    leaf_of = {k.rsplit(".", 1)[-1]: k for k in known}
    leaf = _alike(name.rsplit(".", 1)[-1], leaf_of)
    if close := _alike(name, known) or (leaf and leaf_of[leaf]):
        return f"Did you mean '{close}'?"
    if not known:
        return "There is none to choose from."
    shown = ", ".join(known[:12])
    return f"Known: {shown}{', …' if len(known) > 12 else ''}."


def _alike(name: str, known: Iterable[str]) -> str | None:
    """The most alike, whatever its case; of those that differ by case only the one that is written most alike."""
    folded: dict[str, list[str]] = {}
    for one in known:
        folded.setdefault(one.casefold(), []).append(one)
    close = difflib.get_close_matches(name.casefold(), list(folded), n=1)
    return max(folded[close[0]], key=lambda one: difflib.SequenceMatcher(None, name, one).ratio()) if close else None
