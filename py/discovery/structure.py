"""Structures: the base with effects added and fitted, and what was tried on the way to one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hydrotwin.models.effects import Candidate

from .decide import Evidence
from .refit import Refitted
from .screen import Screened

IMPLAUSIBLE = 10.0  # times the largest usual value, or of a limit that part of the smallest


@dataclass(frozen=True, eq=False)
class Structure:
    """The base with some candidates added, fitted."""

    members: tuple[Candidate, ...]
    fitted: Refitted

    @property
    def key(self) -> tuple[str, ...]:
        return tuple(c.label for c in self.members)

    def without(self, member: Candidate) -> Structure:
        """The other members, as they stand beside it: where a fit without it begins."""
        return Structure(tuple(m for m in self.members if m is not member), self.fitted)

    def holds(self, candidate: Candidate) -> bool:
        """Whether it is a member, or at its place a part of a member that is a finer form of it."""
        return any(m.label == candidate.label or m.refines(candidate) for m in self.members)


@dataclass(frozen=True, eq=False)
class Tried:
    """One candidate (or pair) in one step: screen, refit and evidence against the structure before.

    reason : why it could not be fitted or, with evidence, why it is nothing to be named.
    """

    members: tuple[Candidate, ...]
    screened: Screened | None
    structure: Structure | None = None
    evidence: Evidence | None = None
    reason: str = ""

    @property
    def implausible(self) -> str:
        """A sentence when a value lies far outside what is usual, on the side where the effect is larger."""
        if self.structure is None:
            return ""
        known = self.structure.fitted.values
        for c in (c for c in self.members if c.site.frees is None):
            for name, (low, high) in c.typical.items():
                size, absent = abs(known.get(name, 0.0)), c.neutral.get(name, 0.0)
                limits = abs(absent) > high and known.get(name, 0.0) * absent > 0  # the lower, the more it does
                if high > 0 and size > IMPLAUSIBLE * high and not limits:
                    return f"{name} = {size:.3g} is more than {IMPLAUSIBLE:g} times the usual {high:.3g}"
                if limits and size < low / IMPLAUSIBLE:
                    return f"{name} = {size:.3g} is less than 1/{IMPLAUSIBLE:g} of the usual {low:.3g}"
        return ""


def label_of(members: Sequence[Candidate]) -> str:
    """``id at site`` of every member, joined."""
    return " + ".join(c.label for c in members)
