"""Profile and Profiles: what the recordings say of a parameter when all others may follow it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.amounts import amount
from hydrotwin.models.language.summary_html import SmallTable, summary_html

from .walk import BOUND, BUDGET, CROSSED, DIVERGES, FLAT, LEVEL

AGREE = 0.2  # of half the quadratic interval: ends that are so near are the same
MOST_DIGITS = 8
_OPEN = "not identifiable"


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one parameter, SI.

    value : at the minimum; low, high : the 95 % interval, infinite to a side that never crosses the level; below, above
    : how each side ended ("crossed", "bound", "flat", "diverges", "budget"). quadratic : value -+ 1.96 sigma of the
    fit, None where it has no sigma, and then ``unknown`` says why. grid (m,) and rise (m,) : the profile, ``LEVEL`` is
    where it crosses; others (m, np) : all parameters there.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    below: str
    above: str
    quadratic: tuple[float, float] | None
    grid: np.ndarray
    rise: np.ndarray
    others: np.ndarray
    along: tuple[str, ...]
    unknown: str = ""

    @property
    def identifiable(self) -> bool:
        """Whether the recordings bound it on both sides."""
        return self.below == self.above == CROSSED

    @property
    def quadratic_holds(self) -> bool:
        """Whether the quadratic interval is that of the likelihood."""
        if self.quadratic is None:
            return False
        reach = 0.5 * (self.quadratic[1] - self.quadratic[0])
        ends = np.subtract((self.low, self.high), self.quadratic)
        return bool(self.identifiable and np.all(np.abs(ends) <= AGREE * reach))

    @property
    def sentence(self) -> str:
        """What the profile says, beside the quadratic interval."""
        told = f" It has no quadratic interval: {self.unknown}." if self.quadratic is None else ""
        return f"{self._allowed}{told}"

    @property
    def _allowed(self) -> str:
        """What the recordings allow, in a sentence or two."""
        if self.quadratic_holds:
            return f"{self.name}: the quadratic interval holds, {self._between(self.low, self.high)}."
        if self.identifiable:
            said = f"; the quadratic interval says {self._between(*self.quadratic)}" if self.quadratic else ""
            return f"{self.name}: the recordings allow {self._between(self.low, self.high)}{said}."
        ends = float(self.grid[0]), float(self.grid[-1])
        if {self.below, self.above} <= {BOUND, FLAT}:
            return (
                f"{self.name} is not identifiable from these recordings, neither downwards nor upwards: nothing "
                f"contradicts it from {self._between(*ends)}{self._made_up}."
            )
        sides = ((self.below, "downwards", ends[0]), (self.above, "upwards", ends[1]))
        return " ".join(self._open(why, where, end) for why, where, end in sides if why != CROSSED)

    @property
    def _made_up(self) -> str:
        """What goes along with a parameter that nothing contradicts."""
        verb = "makes" if len(self.along) == 1 else "make"
        return f", because {' and '.join(self.along)} {verb} up for it" if self.along else ""

    def _open(self, why: str, where: str, end: float) -> str:
        """What to say of a side that does not cross, beside another that does."""
        reached = amount(end, self.unit)
        if why == BUDGET:
            return f"{self.name}: {where} the profile was given up at {reached}: more fits than allowed."
        if why == DIVERGES:
            lost = "runs or their derivatives diverge before the recordings contradict it"
            return f"{self.name}: {where} of {reached} {lost}."
        until = f"as far as {reached}" + (", its bound" if why == BOUND else "")
        told = f"nothing contradicts it {until}{self._made_up}"
        return f"{self.name} is not identifiable from these recordings {where}: {told}."

    def _between(self, low: float, high: float) -> str:
        """Both ends, with as many digits as tell them apart."""
        narrow = np.log10(max(abs(low), abs(high)) / max(high - low, 1e-300))
        digits = int(np.clip(np.ceil(narrow) + 2, 3, MOST_DIGITS))
        return " to ".join(amount(end, self.unit, digits=digits) for end in (low, high))

    def as_data(self) -> dict:
        """As plain data."""
        return {
            "name": self.name,
            "unit": self.unit,
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "below": self.below,
            "above": self.above,
            "quadratic": list(self.quadratic) if self.quadratic else None,
            "no_quadratic": self.unknown,
            "quadratic_holds": self.quadratic_holds,
            "identifiable": self.identifiable,
            "grid": self.grid.tolist(),
            "rise": self.rise.tolist(),
            "sentence": self.sentence,
        }


@dataclass(frozen=True, eq=False)
class Profiles:
    """The profiles of a fit; names : of all its parameters, the columns of ``others``.

    lower : what to say where a minimum lower than that of the fit was found, and the profiles are around that one.
    """

    name: str
    names: tuple[str, ...]
    profiles: tuple[Profile, ...]
    fits: int
    lower: str
    seconds: float

    def __getitem__(self, name: str) -> Profile:
        return next(p for p in self.profiles if p.name == name)

    def sentences(self) -> list[str]:
        """What the profiles say, what is not identifiable first."""
        ordered = sorted(self.profiles, key=lambda p: (p.identifiable, p.quadratic_holds))
        return [*([self.lower] if self.lower else []), *(p.sentence for p in ordered)]

    def as_data(self) -> dict:
        """As plain data."""
        told = [p.as_data() for p in self.profiles]
        return {"level": LEVEL, "fits": self.fits, "lower": self.lower, "profiles": told, "seconds": self.seconds}

    def _repr_html_(self) -> str:
        rows = [
            (
                p.name,
                p.value,
                p.low,
                p.high,
                *(p.quadratic or ("none", "none")),
                p.unit,
                "" if p.identifiable else "not identifiable",
            )
            for p in self.profiles
        ]
        head = ("parameter", "value", "from", "to", "quadratic from", "to", "unit", "")
        facts = {"parameters": len(rows), "fits": self.fits}
        notes = self.sentences()
        return summary_html(f"Profiles of {self.name}", "", facts, [SmallTable("95 %, SI", head, rows)], notes)
