"""Global sensitivities: Sobol indices of the courses of the outputs over the intervals of the parameters.

    S_k = V(E(y | p_k)) / V(y),     T_k = 1 - V(E(y | all but p_k)) / V(y)

S_k is the share of the variance that parameter k makes alone, T_k with everything that it acts in. Parameters are
independent and uniform over their intervals. A course is many numbers: V is the sum of their variances over a stretch
of time, so an index is the mean over the samples, weighed by the variances there. Of a linear model the S_k add up to
one. SALib samples; the runs go side by side. With y from base samples A and B and from A with column k of B (AB), all
about their mean,

    V S_k = mean(y_B . (y_AB - y_A)),     V T_k = mean |y_A - y_AB|^2 / 2

Source: I. Sobol, Math. Comput. Simul. 2001; A. Saltelli et al., Comput. Phys. Commun. 2010 (estimators); F. Gamboa, A.
Janon, T. Klein, A. Lagnoux, Electron. J. Statist. 8 (2014) 575-603 (courses).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.simulation.many import controlled_many, run_many

from .intervals import Interval
from .local import NOTHING
from .runs import Run, Runs

FEWEST = 16  # base samples that still give an index
KEPT, FEW_KEPT = 600, 8  # instants of all runs at which outputs are kept, and of a stretch at least
AT_ONCE = 64  # sets of one call: their runs are held in memory
RESAMPLES, SIGMAS = 200, 1.96  # of the base samples, for the half widths of 95 % intervals
FAR = 10.0  # ranges of the nominal run, sizes of an output at rest: a set further away is run again as it needs
VAGUE = 0.5  # half width of a total index from which on nothing is told of who drives an output
COURSE, DEVIATION = "course", "deviation"
OF = (COURSE, DEVIATION)


@dataclass(frozen=True)
class Sampling:
    """What is sampled: ``samples`` base points, each with one more run for every parameter and one; 0 for none.

    of : "course", the outputs over time, or "deviation", the root mean square of their distance from the nominal run,
        one number for each stretch. seed : the same seed gives the same indices.
    """

    samples: int = 512
    of: str = COURSE
    seed: int = 0
    threads: int = 1

    def __post_init__(self):
        if self.of not in OF:
            raise DeclarationError(f"sensitivity: no indices of '{self.of}'. {nearest(self.of, OF)}")
        if self.samples and (self.samples < FEWEST or self.samples & (self.samples - 1)):
            raise DeclarationError(
                f"sensitivity: samples must be a power of two from {FEWEST} on, for Sobol's sequence to be balanced "
                f"(got {self.samples}). Take {2 ** max(4, round(np.log2(max(self.samples, 1))))}, or 0 for none."
            )


@dataclass(frozen=True, eq=False)
class Indices:
    """Sobol indices of every output over one stretch of time: first, total (ny, np) with the half widths of their 95 %
    intervals; spread (ny,), SI, the standard deviation of the output there. Nan for an output that nothing moves."""

    first: np.ndarray
    first_half: np.ndarray
    total: np.ndarray
    total_half: np.ndarray
    spread: np.ndarray

    @property
    def vague(self) -> np.ndarray:
        """Outputs (ny,) of which the samples do not tell what drives them: a few sets make most of the variance.

        Total indices add up to one at least; an estimate that does not, within its errors, is none.
        """
        moved = np.isfinite(self.total).any(axis=1)
        most = np.nansum(self.total + self.total_half, axis=1)
        return moved & ((np.nan_to_num(self.total_half).max(axis=1) > VAGUE) | (most < 1.0))

    @property
    def error(self) -> float:
        """How well the total indices are known: the largest half width, or how far one lies beyond one, its most."""
        beyond = np.fmax(self.total_half, self.total - 1.0)
        return float(np.nanmax(beyond, initial=0.0))


@dataclass(frozen=True, eq=False)
class Global:
    """Sobol indices over all runs, and of the stretches of each.

    sets : parameter sets that were run; diverged : how many of them left the finite numbers in some recording, and why
    the first did; used : base samples of which every run went through, the others count for nothing.
    """

    whole: Indices
    by_stretch: tuple[tuple[Indices, ...], ...]
    sets: int
    diverged: int
    reason: str
    used: int
    sampling: Sampling


def sobol(
    runs: Runs, intervals: Sequence[Interval], sampling: Sampling, told: Callable[[int, int], None] | None = None
) -> Global:
    """Indices over the intervals. ``told(done, total)`` counts the sets times the recordings.

    Raises DataError where (nearly) all sets diverge.
    """
    cube = _sampled(len(intervals), sampling)
    p = np.tile(runs.p, (len(cube) + 1, 1))  # the nominal one first
    for k, interval in enumerate(intervals):
        p[1:, runs.flat.index_of(interval.name)] = interval.at(cube[:, k])
    told = told or (lambda done, total: None)
    share = max(FEW_KEPT, KEPT // sum(len(run.edges) - 1 for run in runs.runs))
    kept, reasons = [], {}
    for number, run in enumerate(runs.runs):
        courses, stopped = _courses(
            runs, run, p, (sampling.threads, _kept(run, share)),
            lambda n, at=number: told(at * len(p) + n, len(p) * len(runs.runs)),
        )  # fmt: skip
        kept.append(courses)
        reasons = {**stopped, **reasons}
    through = np.all([np.isfinite(courses).all(axis=(1, 2)) for courses in kept], axis=0)
    groups = through[1:].reshape(sampling.samples, -1).all(axis=1)
    lost, reason = int((~through[1:]).sum()), reasons[min(reasons)] if reasons else "An output is not finite."
    if groups.sum() < FEWEST:
        raise DataError(_too_few(runs, lost, len(cube), reason))
    here = np.concatenate([[True], np.repeat(groups, len(intervals) + 2)])
    stretches = [_cut(courses[here], run, share) for courses, run in zip(kept, runs.runs, strict=True)]
    whole = np.concatenate([part for parts in stretches for part in parts], axis=1)
    found = _Indices(len(intervals), sampling, _scales(whole))
    by_stretch = tuple(tuple(found.of(part) for part in parts) for parts in stretches)
    weighed = found.of(whole * _weights(runs.runs, share)[:, None])
    return Global(weighed, by_stretch, len(cube), lost, reason, int(groups.sum()), sampling)


def _sampled(count: int, sampling: Sampling) -> np.ndarray:
    """Shares of the intervals (sets, np): for each base sample A, A with one column of B for each parameter, and B."""
    from SALib.sample import sobol as sampler  # pandas and matplotlib come with it: seconds

    problem = _problem(count)
    return sampler.sample(problem, sampling.samples, calc_second_order=False, seed=sampling.seed)


def _problem(count: int) -> dict:
    return {"num_vars": count, "names": [str(k) for k in range(count)], "bounds": [[0.0, 1.0]] * count}


def _courses(
    runs: Runs, run: Run, p: np.ndarray, how: tuple[int, np.ndarray], told: Callable[[int], None]
) -> tuple[np.ndarray, dict[int, str]]:
    """Outputs of all sets at the kept instants, (sets, m, ny), nan for a set that diverged; why, by its position.

    how : on so many threads, at those samples. The nominal set stands first in each call: it decides how all are run.
    """
    (threads, kept), step = how, AT_ONCE - 1
    answer = np.full((len(p), len(kept), len(runs.flat.outputs)), np.nan)
    reasons: dict[int, str] = {}

    def ran(begin: int) -> int:
        part = np.arange(begin, min(begin + step, len(p)))
        sets = np.concatenate([p[:1], p[part]])
        x0 = np.array([run.start(one) for one in sets])
        y, stops = run_many(runs.propagator, run.time, run.u, sets, x0)
        _run_far_ones_again(runs, run, (sets, x0), y, stops)
        answer[part] = y[1:, kept]
        reasons.update({int(s): str(stop) for s, stop in zip(part, stops[1:], strict=True) if stop})
        return len(part)

    done, begins = 0, range(0, len(p), step)
    done += ran(begins[0])
    with ThreadPoolExecutor(threads) as pool:
        for count in pool.map(ran, begins[1:]):
            done += count
            told(done)
    return answer, reasons


def _run_far_ones_again(runs: Runs, run: Run, given: tuple[np.ndarray, np.ndarray], y: np.ndarray, stops: list) -> None:
    """Put into y and stops what sets far from the nominal one, the first, give when each is run as it needs.

    They may be stiffer than that, and nearly diverge in its steps. What no method runs accurately counts as diverged.
    """
    moved, size = np.ptp(y[0], axis=0), np.abs(y[0]).max(axis=0)
    size = np.where(size > 0, size, [s.nominal for s in runs.flat.outputs])
    apart = np.where(moved > NOTHING * size, moved, size)  # an output at rest tells its size alone
    far = [s for s in range(1, len(y)) if stops[s] is None and (np.abs(y[s] - y[0]).max(axis=0) > FAR * apart).any()]
    if not far:
        return
    p, x0 = given
    for s, ran in zip(far, controlled_many(runs.propagator, run.time, run.u, p[far], x0[far]), strict=True):
        accurate = ran.accuracy is None or ran.accuracy.reached
        stops[s] = ran.stop or (None if accurate else "No method runs it accurately: it nearly diverges.")
        y[s] = np.nan if stops[s] else ran.y


def _kept(run: Run, share: int) -> np.ndarray:
    """Samples at which outputs are kept: in every stretch as many, evenly spread."""
    pairs = itertools.pairwise(run.edges)
    return np.concatenate([np.linspace(a, b - 1, min(share, b - a)).astype(int) for a, b in pairs])


def _weights(runs: Sequence[Run], share: int) -> np.ndarray:
    """Factors of the kept instants of all runs, of mean square one: each stands for as many samples as lie around it.

    Variances are squares, so those of courses times these are sums over all samples, whatever was kept of a recording.
    """
    lengths = np.concatenate([np.diff(run.edges) for run in runs])
    kept = np.minimum(share, lengths)
    around = np.repeat(lengths / np.maximum(kept, 1), kept)
    return np.sqrt(around / around.mean())


def _cut(courses: np.ndarray, run: Run, share: int) -> list[np.ndarray]:
    """Courses (sets, m, ny) of one run by its stretches."""
    return np.split(courses, np.searchsorted(_kept(run, share), run.edges[1:-1]), axis=1)


def _scales(whole: np.ndarray) -> np.ndarray:
    """Range of every output (ny,) over all sets, below a share of which nothing moves."""
    return np.ptp(whole, axis=(0, 1))


def _too_few(runs: Runs, lost: int, sets: int, reason: str) -> str:
    how = "every parameter set" if lost == sets else f"{lost} of {sets} parameter sets"
    return (
        f"sensitivity: {how} of {runs.flat.name} diverged, which leaves too few for indices. The first: {reason} Take "
        "narrower intervals, or more samples."
    )


class _Indices:
    """Indices of courses by SALib."""

    def __init__(self, count: int, sampling: Sampling, scales: np.ndarray):
        self.count, self.sampling, self.scales = count, sampling, scales

    def of(self, courses: np.ndarray) -> Indices:
        """Of courses (1 + sets, m, ny), the nominal run first."""
        rows = [self._output(courses[:, :, j], scale) for j, scale in enumerate(self.scales)]
        return Indices(*(np.array(part) for part in zip(*rows, strict=True)))

    def _output(self, course: np.ndarray, scale: float):
        nominal, course = course[0], course[1:]
        spread = float(np.sqrt(course.var(axis=0).mean()))
        if not spread > NOTHING * scale:
            return *np.full((4, self.count), np.nan), spread
        if self.sampling.of == DEVIATION:
            course = np.sqrt(np.mean((course - nominal) ** 2, axis=1))[:, None]
        return *self._estimated(course - course.mean(axis=0)), spread

    def _estimated(self, away: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """First-order indices, their half widths, total indices, theirs, (np,), of courses about their mean (sets, m).

        Sets come by base sample: A, A with a column of B for each parameter, B.
        """
        groups = away.reshape(-1, self.count + 2, away.shape[1])
        a, mixed, b = groups[:, 0], groups[:, 1:-1], groups[:, -1]
        gained = np.einsum("nm,nkm->nk", b, mixed) - np.einsum("nm,nm->n", b, a)[:, None]
        apart = 0.5 * np.stack([((a - mixed[:, k]) ** 2).sum(axis=1) for k in range(self.count)], axis=1)
        squares = 0.5 * ((a**2).sum(axis=1) + (b**2).sum(axis=1))
        off = float((np.concatenate([a, b]).mean(axis=0) ** 2).sum())  # of these alone from the mean of all

        def indices(chosen) -> np.ndarray:
            return np.array([gained[chosen].mean(axis=0), apart[chosen].mean(axis=0)]) / (squares[chosen].mean() - off)

        found, rng = indices(slice(None)), np.random.default_rng(self.sampling.seed)
        again = [indices(rng.integers(0, len(a), len(a))) for _ in range(RESAMPLES)]
        half = SIGMAS * np.std(again, axis=0, ddof=1)
        return found[0], half[0], found[1], half[1]
