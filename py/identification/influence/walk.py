"""A walk along one parameter: it is moved outward step by step, the others are fitted again from the step before.

    rise(q_j) = 2 (min over the others of cost(q) - cost at the minimum) / scale_j

Steps are chosen so that the root of the rise, straight where the cost is quadratic, grows evenly.
Source: A. Raue et al., Bioinformatics 2009, section 2.2 (profile likelihood, its steps).
"""

from __future__ import annotations

import contextlib
import dataclasses
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import SolveError

from ..least_squares import Minimum, minimise
from ..shooting import Shooting

LEVEL = 3.841459  # of chi-square with one degree of freedom: 95 %
EVENLY = 0.25  # of the root of the level: how much a step should gain
UNKNOWN_STEP = 0.05  # in q, where no sigma says how far
BOLDEST = 0.25  # in q, or of it: a first step goes no further, whatever a sigma says
FARTHEST = np.log(1000.0)  # in q: a factor of a thousand, where the lower bound is positive, ...
FARTHEST_UNITS = 1000.0  # ... and so many units elsewhere
REFIT = 20  # iterations of one fit of the others
NEAR = 0.005  # half a chi-square, in units of the scale: how near that fit comes to its minimum
MET, SECANTS = 0.02, 4  # of the root of the level: how near a crossing is met, and in how many tries
SHORTENED = 6  # times the first step is halved, at most, where runs diverge, or the cost jumps
JUMP = 3.0  # of the root of the level: a step to there was too far, or the fit of the others went astray
LOWER = 0.1  # half a chi-square: a minimum that is lower by so much is another
CROSSED, BOUND, FLAT, DIVERGES, BUDGET = "crossed", "bound", "flat", "diverges", "budget"


class FoundLower(Exception):
    """A walk has come to a minimum that is lower than the one it started from."""

    def __init__(self, minimum: Minimum):
        super().__init__("a lower minimum")
        self.minimum = minimum


@dataclass
class Budget:
    """Fits of the others that are left; ``spent`` counts them."""

    most: int
    spent: int = 0

    @property
    def left(self) -> bool:
        return self.spent < self.most


@dataclass(frozen=True, eq=False)
class Point:
    """One point of a profile: the minimum with parameter j held there; root of its rise over the level."""

    minimum: Minimum
    root: float


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a profile: how it ended, q_j there (of the crossing, else how far it went), its points outward."""

    why: str
    end: float
    points: tuple[Point, ...]


@dataclass(frozen=True, eq=False)
class Walk:
    """The walk along parameter ``j`` from a minimum; scale : of the rise; sigma : in q, nan where it is unknown."""

    shooting: Shooting
    base: Minimum
    j: int
    scale: float
    sigma: float
    budget: Budget

    def side(self, sign: float) -> Side:
        """Outward to one side, -1 or 1, until the level is crossed, or there is no further.

        Raises FoundLower.
        """
        free, start = self.shooting.free, self.base.q[self.j]
        limit = free.scaled(free.upper if sign > 0 else free.lower)[self.j]
        farthest = start + sign * (FARTHEST if free.logarithmic[self.j] else FARTHEST_UNITS)
        reach = np.sqrt(LEVEL * self.scale) * self.sigma
        step = min(EVENLY * reach, BOLDEST * max(1.0, abs(start))) if reach > 0 else UNKNOWN_STEP  # nan: not known
        points, least = [Point(self.base, 0.0)], step / 2**SHORTENED
        while True:
            here = points[-1].minimum.q[self.j]
            if sign * (limit - here) <= 1e-12 * max(1.0, abs(here)):
                return Side(BOUND, here, tuple(points))
            if sign * (here - farthest) >= 0:
                return Side(FLAT, here, tuple(points))
            found = self._stepped(points, sign * step, least, sorted((here, limit)))
            if found is None:
                return Side(DIVERGES if self.budget.left else BUDGET, here, tuple(points))
            if found.root >= 1:
                return self._crossing(points, found)
            grew = max(found.root - points[-1].root, 1e-9)
            step = max(abs(found.minimum.q[self.j] - here) * np.clip(EVENLY / grew, 0.5, 2.0), least)
            points.append(found)

    def _stepped(self, points: list[Point], step: float, least: float, within) -> Point | None:
        """The next point, nearer where the runs diverge or the cost jumps, but not by less than ``least``.

        None where they diverge even then, or the budget is spent.
        """
        here, found = points[-1].minimum.q[self.j], None
        while abs(step) >= least and self.budget.left:
            with contextlib.suppress(SolveError):
                found = self._at(float(np.clip(here + step, *within)), points)
                if found.root < JUMP:
                    return found
            step /= 2
        return found

    def _at(self, target: float, points: list[Point]) -> Point:
        """The others fitted with parameter j at ``target``, from where the last points lead."""
        self.budget.spent += 1
        near = points[-1].minimum
        q = near.q.copy()
        if len(points) > 1:
            before = points[-2].minimum
            share = (target - near.q[self.j]) / (near.q[self.j] - before.q[self.j])
            q = near.q + share * (near.q - before.q)
        q[self.j] = target
        found = self._refitted(q, near)
        if found.cost < self.base.cost - LOWER * max(self.scale, 1.0):
            raise FoundLower(found)
        rise = 2 * (found.cost - self.base.cost) / self.scale
        return Point(found, float(np.sqrt(max(rise, 0.0) / LEVEL)))

    def _refitted(self, q: np.ndarray, near: Minimum) -> Minimum:
        """The others fitted from q. Raises SolveError where a run or its derivatives are lost."""
        stayed = np.where(np.arange(len(q)) == self.j, q, near.q)  # where the straight line leads astray
        found = []
        for start in (q, stayed):
            found += self._minima(start, near)
            if found and found[-1].converged:
                return found[-1]
        if found:
            return min(found, key=lambda m: m.cost)
        raise SolveError(f"profile: the runs diverge at {self.shooting.free.names[self.j]} = {q[self.j]:.6g} (scaled).")

    def _minima(self, q: np.ndarray, near: Minimum) -> list[Minimum]:
        """Where the others end from q; nothing where a run or its derivatives are lost."""
        held, q = _held(self.shooting, self.j, q)
        try:
            found = minimise(held, q, near.z, absolute=NEAR * max(self.scale, 1.0), most=REFIT)
        except SolveError:
            return []
        return [] if found.at.diverged.any() else [found]

    def _crossing(self, points: list[Point], beyond: Point) -> Side:
        """Where the root of the rise is one, between the last point and one beyond."""
        inner, outer = points[-1], beyond
        for _ in range(SECANTS):
            if outer.root - 1 < MET or 1 - inner.root < MET or not self.budget.left:
                break
            try:
                between = self._at(_met(inner, outer, self.j), [inner])
            except SolveError:
                break
            inner, outer = (between, outer) if between.root < 1 else (inner, between)
            if between.root < 1:
                points.append(between)
        return Side(CROSSED, _met(inner, outer, self.j), (*points, outer))


def _met(inner: Point, outer: Point, j: int) -> float:
    """q_j at which a straight root is one; half way to a point behind a jump."""
    share = (1 - inner.root) / (outer.root - inner.root) if outer.root < JUMP else 0.5
    return float(inner.minimum.q[j] + share * (outer.minimum.q[j] - inner.minimum.q[j]))


def _held(shooting: Shooting, j: int, q: np.ndarray) -> tuple[Shooting, np.ndarray]:
    """The same problem with parameter j held where q has it, and q to the last digit there."""
    free = shooting.free
    lower, upper, value = free.lower.copy(), free.upper.copy(), free.values(q)[j]
    lower[j] = upper[j] = value
    held = dataclasses.replace(free, lower=lower, upper=upper)
    q = np.clip(q, held.scaled(lower), held.scaled(upper))
    return dataclasses.replace(shooting, free=held), q
