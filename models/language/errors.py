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
    """
    known = list(known)
    leaf_of = {k.rsplit(".", 1)[-1]: k for k in known}
    close = difflib.get_close_matches(name, known, n=1) or [
        leaf_of[leaf] for leaf in difflib.get_close_matches(name.rsplit(".", 1)[-1], list(leaf_of), n=1)
    ]
    if close:
        return f"Did you mean '{close[0]}'?"
    if not known:
        return "There is none to choose from."
    shown = ", ".join(known[:12])
    return f"Known: {shown}{', …' if len(known) > 12 else ''}."
