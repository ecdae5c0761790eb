"""Fit of the latent-spool grey box by variable projection: the map is linear least squares inside, the rest outside.

For given dynamics the output is linear in the values of the map at its knots, F c, and those are found by monotone
least squares; the five constants of the dynamics are what the outer solver moves.
Source: Golub, Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432; knots after de Boor, A Practical Guide to Splines, XII.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from .block import Dynamics
from .data import Run, best_ratio, weighing

STIFFNESS = 1e-5  # of the information per knot: what a kink costs; it bridges knots that no sample tells of
SHORTEST = 0.3  # of a period: the time constants of spool and lag
LEAST_DAMPING = 0.5  # a spool is well damped; less would be a load that rings, taken for it
SCAN_KNOTS = 13


@dataclass(frozen=True, eq=False)
class Fitted:
    """Dynamics and map; loss: mean square of the whitened residuals, of which ``residuals`` holds all."""

    dynamics: Dynamics
    knots: np.ndarray
    values: np.ndarray
    loss: float
    residuals: np.ndarray


@dataclass(frozen=True, eq=False)
class Problem:
    """What is fitted: runs of one input and one output, and how their misses are weighed (see `weighing`)."""

    runs: Sequence[Run]
    period: float
    integrating: bool
    ratio: float | None
    longest: float  # dead time and time constants, s

    @property
    def span(self) -> tuple[float, float]:
        """Range of the input."""
        return min(r.input.min() for r in self.runs), max(r.input.max() for r in self.runs)

    def rows(self, columns_of: Callable[[Run], np.ndarray]) -> np.ndarray:
        """Weighed rows of all runs of what ``columns_of`` gives at the times of the output."""
        maps = weighing(self.runs, self.ratio)
        return np.concatenate([weigh(columns_of(run)) for run, weigh in zip(self.runs, maps, strict=True)])


def opening(run: Run, dynamics: Dynamics, period: float) -> np.ndarray:
    """What the map is of, (m,): the spool, or what lies behind its play; from rest at the first input."""
    whole, share = dynamics.late(period)
    padded = np.concatenate([np.full(whole + 1, run.input[0]), run.input])[: len(run.input) + 1]
    late = (1 - share) * padded[1:] + share * padded[:-1]
    if dynamics.play_first:
        return _spool(follow(late, dynamics.play), dynamics, period)
    return follow(_spool(late, dynamics, period), dynamics.play)


def _spool(driven: np.ndarray, dynamics: Dynamics, period: float) -> np.ndarray:
    """The spool (m,) that follows an input held over each period."""
    from scipy.signal import lfilter

    A, B = dynamics.spool(period)
    b = [0.0, B[0], A[0, 1] * B[1] - A[1, 1] * B[0]]
    return driven[0] + lfilter(b, [1.0, -np.trace(A), np.linalg.det(A)], driven - driven[0])


def follow(pushed: np.ndarray, width: float) -> np.ndarray:
    """Play of that width behind ``pushed`` (m,), at first in its middle."""
    if width <= 0:
        return pushed
    q, half, answer = float(pushed[0]), width / 2, []
    for s in pushed.tolist():
        if q < s - half:
            q = s - half
        elif q > s + half:
            q = s + half
        answer.append(q)
    return np.array(answer)


def shares(q: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """How much of each knot's value the map has at q: hats of piecewise linear interpolation, (knots, m)."""
    inside = np.clip(q, knots[0], knots[-1])
    cell = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(knots) - 2)
    upper = (inside - knots[cell]) / np.diff(knots)[cell]
    hats, at = np.zeros((len(knots), len(q))), np.arange(len(q))
    hats[cell, at], hats[cell + 1, at] = 1 - upper, upper
    return hats


def responses(q: np.ndarray, knots: np.ndarray, lag: float, period: float, integrating: bool) -> np.ndarray:
    """The output that each knot's value alone would cause, from zero; (m, knots)."""
    from scipy.signal import lfilter

    hats = shares(q, knots)
    mean = (hats[:, 1:] + hats[:, :-1]) / 2
    a = np.exp(-period / lag) if lag > 0 else 0.0
    v, _ = lfilter([1 - a], [1, -a], mean, axis=1, zi=a * hats[:, :1])
    v = np.hstack([hats[:, :1], v])
    if not integrating:
        return v.T
    travelled = np.cumsum(period * mean, axis=1) - lag * (v[:, 1:] - v[:, :1])
    return np.hstack([np.zeros((len(knots), 1)), travelled]).T


def monotone(rows: np.ndarray, target: np.ndarray, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (knots,) that never fall from knot to knot, nearest to ``rows @ values = target``; and the rows' misses.

    A small cost on kinks carries the map over knots without samples; its misses are the last of the answer.
    """
    from scipy.optimize import nnls

    n = len(knots)
    kinks = np.diff(np.diff(np.eye(n), axis=0) / np.diff(knots)[:, None], axis=0) * (knots[-1] - knots[0]) / (n - 1)
    gram = rows.T @ rows
    kinks *= np.sqrt(STIFFNESS * np.trace(gram) / n)
    sums = np.tril(np.ones((n, n)))  # values from the first one and the steps after it
    information = sums.T @ (gram + kinks.T @ kinks + 1e-14 * np.trace(gram) / n * np.eye(n)) @ sums
    root = np.linalg.cholesky(information).T
    aim = np.linalg.solve(root.T, sums.T @ (rows.T @ target))
    steps, _ = nnls(root[1:, 1:], aim[1:])
    first = (aim[0] - root[0, 1:] @ steps) / root[0, 0]
    values = sums @ np.concatenate([[first], steps])
    return values, np.concatenate([target - rows @ values, -kinks @ values])


def evaluate(problem: Problem, dynamics: Dynamics, knots: np.ndarray) -> Fitted:
    """The best monotone map for these dynamics."""
    h, integrating = problem.period, problem.integrating

    def columns(run):
        return run.sampled(responses(opening(run, dynamics, h), knots, dynamics.lag, h, integrating))

    target = problem.rows(lambda run: run.output - run.output[0] * integrating)
    values, misses = monotone(problem.rows(columns), target, knots)
    return Fitted(dynamics, knots, values, float(np.mean(misses[: len(target)] ** 2)), misses)


def rough_starts(problem: Problem, keep: int) -> list[Dynamics]:
    """The best dynamics of a scan over dead time and play, with a quick spool and lag."""
    low, high = problem.span
    knots = np.linspace(low, high, SCAN_KNOTS)
    delays = np.concatenate([[0.0], np.geomspace(problem.period, 0.7 * problem.longest, 7)])
    quick = Dynamics(0.0, 0.8 / problem.period, 1.0, 0.0, problem.period)
    first = [evaluate(problem, replace(quick, dead_time=d), knots) for d in delays]
    best = sorted(first, key=lambda f: f.loss)[: max(keep // 2, 1)]
    wide = [evaluate(problem, replace(f.dynamics, play=0.06 * (high - low)), knots) for f in best]
    return [f.dynamics for f in sorted([*best, *wide], key=lambda f: f.loss)][:keep]


def refine(problem: Problem, start: Dynamics, knots: np.ndarray, evaluations: int, seen: Callable) -> Fitted:
    """Move the dynamics from ``start`` to the least loss; ``seen`` is called with every `Fitted` on the way."""
    from scipy.optimize import least_squares

    lower, upper = _limits(problem)

    def misses(scaled):
        fitted = evaluate(problem, _dynamics(problem, scaled, start.play_first), knots)
        seen(fitted)
        return fitted.residuals

    first = np.clip(_scaled(problem, start), lower + 1e-3, upper - 1e-3)
    found = least_squares(misses, first, bounds=(lower, upper), diff_step=2e-3, max_nfev=evaluations, xtol=1e-5)
    return evaluate(problem, _dynamics(problem, found.x, start.play_first), knots)


def intervals(problem: Problem, fitted: Fitted) -> dict[str, tuple[float, float]]:
    """95 % interval of each constant, from the curvature at the fit; as good as the model is right.

    cov = s^2 (J'J)^-1,    J of the misses with the map fitted anew, in the scaled constants
    """
    at, step, first = _scaled(problem, fitted.dynamics), 5e-3, fitted.dynamics.play_first
    lower, upper = _limits(problem)
    sides = [np.where(at + step > upper, -step, step)[k] * np.eye(5)[k] for k in range(5)]
    moved = [evaluate(problem, _dynamics(problem, at + side, first), fitted.knots).residuals for side in sides]
    J = np.column_stack([(m - fitted.residuals) / side.sum() for m, side in zip(moved, sides, strict=True)])
    spread = 1.96 * np.sqrt(fitted.loss * np.diag(np.linalg.pinv(J.T @ J)))
    ends = [astuple(_dynamics(problem, np.clip(at + sign * spread, lower, upper), first))[:5] for sign in (-1, 1)]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    names = ("dead_time", "natural_frequency", "damping", "play", "lag")
    return {name: (float(a), float(b)) for name, a, b in zip(names, low, high, strict=True)}


def bent_knots(knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """As many knots again, dense where the map bends (density ~ root of the kinks, blended with an even one)."""
    slopes = np.diff(values) / np.diff(knots)
    bend = np.sqrt(np.abs(np.diff(slopes)) * np.minimum(np.diff(knots)[1:], np.diff(knots)[:-1]))
    per_cell = np.convolve(bend, [0.5, 0.5])
    density = per_cell / max(per_cell.sum(), 1e-300) + np.diff(knots) / (knots[-1] - knots[0])
    places = np.concatenate([[0.0], np.cumsum(density)])
    return np.interp(np.linspace(0, places[-1], len(knots)), places, knots)


def reweighed(problem: Problem, fitted: Fitted) -> Problem:
    """The problem with the ratio of walk to sensor noise under which what is left is most likely."""
    if problem.ratio is None:
        return problem
    d, h = fitted.dynamics, problem.period
    misses = []
    for run in problem.runs:
        rows = run.sampled(responses(opening(run, d, h), fitted.knots, d.lag, h, True))
        misses.append(np.diff(run.output - rows @ fitted.values))
    return replace(problem, ratio=best_ratio(problem.runs, misses))


def _scaled(problem: Problem, d: Dynamics) -> np.ndarray:
    width = problem.span[1] - problem.span[0]
    return np.array(
        [
            d.dead_time / problem.longest * 10,
            np.log(d.natural_frequency * problem.period),
            np.log(d.damping),
            d.play / width * 10,
            np.log(d.lag / problem.period),
        ]
    )


def _dynamics(problem: Problem, scaled: np.ndarray, play_first: bool) -> Dynamics:
    width = problem.span[1] - problem.span[0]
    dead, w, damping, play, lag = (float(v) for v in scaled)
    return Dynamics(
        dead * problem.longest / 10,
        float(np.exp(w)) / problem.period,
        float(np.exp(damping)),
        play * float(width) / 10,
        float(np.exp(lag)) * problem.period,
        play_first,
    )


def _limits(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    slow = problem.longest / problem.period
    lower = np.array([0.0, np.log(2 / slow), np.log(LEAST_DAMPING), 0.0, np.log(SHORTEST)])
    upper = np.array([10.0, np.log(1 / SHORTEST), np.log(3.0), 4.0, np.log(slow)])
    return lower, upper
