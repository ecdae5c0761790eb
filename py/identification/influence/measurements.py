"""What to measure next: by how much another sensor, or another recording, would narrow what is known.

    C = (H + 1)^-1  now,   C' = (H' + 1)^-1  with the measurement,   gain = 1/2 ln(det C / det C')

H is the information of the recordings in q (`information`), 1 that every parameter was known to a factor of e before.
Measurements are ranked by their gain (D-optimal), or, where somebody says what for, by what they take from the
variance of those parameters (A-optimal) or from the band of those outputs.
Source: A. Atkinson, A. Donev, R. Tobias, Optimum Experimental Designs, 2007, ch. 10.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.amounts import amount
from hydrotwin.models.language.errors import DeclarationError, SolveError, nearest

from ..drives import Limits, candidates, seen_limits, span_of, stays_inside, varied
from ..problem import Recording
from .information import Known, information_of, slope_of
from .intervals import SIGMAS
from .local import Local, RunInformation, information
from .runs import Run, Runs

SENSOR = 0.005  # of the range of an output: error of a sensor of which nothing is known (accuracy class 0.5)
DRIVES = 3  # inputs that are told, each of another kind
OPEN = 0.35  # standard deviation in the size of a parameter (a factor of two): known no better, it is left open
MANY = 0.1  # of a width: below, how many times narrower is said
NOTHING_NEW = 0.95  # of a width: what narrows none to less tells nothing new
HALF = (0.45, 0.55)
REPEAT, DETERMINANT = "repeat", "all parameters"


@dataclass(frozen=True, eq=False)
class Drive:
    """An input to drive the machine with: values (n,) at time (n,), SI."""

    input: str
    unit: str
    kind: str
    time: np.ndarray
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Measurement:
    """One measurement that could be made.

    kind : "sensor", "repeat" or "drive"; what : the output, or the recording in words; noise : of the sensor, SI, as it
    was given or assumed, nan where there is none. gain : 1/2 ln of the ratio of determinants. score : what it is ranked
    by. narrowed : widths of the intervals afterwards over those now, by parameter; bands : the same of the outputs.
    """

    kind: str
    what: str
    noise: float
    gain: float
    score: float
    narrowed: Mapping[str, float]
    bands: Mapping[str, float]
    sentence: str
    drive: Drive | None = None

    @property
    def label(self) -> str:
        """It in a few words."""
        return f"sensor of {self.what}" if self.kind == "sensor" else self.what

    def as_data(self) -> dict:
        """As plain data; of a drive the input alone."""
        told = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "drive"}
        told |= {"narrowed": dict(self.narrowed), "bands": dict(self.bands)}
        return told | {"input": self.drive.input if self.drive else None}


def measurements(
    runs: Runs,
    near: Local,
    sure: Known,
    goal: Sequence[str] = (),
    noise: Mapping[str, float] | None = None,
    told: Callable[[int, int], None] | None = None,
) -> tuple[Measurement, ...]:
    """Measurements that would tell more of the parameters, the best first; empty where no recording has an output.

    goal : names of parameters, or of outputs, that are wanted better; noise : of sensors that are not there yet, SI.

    Raises DeclarationError for a goal that is neither.
    """
    ranking = _Ranking(runs, near, sure, goal)
    if not np.isfinite(sure.worth).any():
        return ()
    found = [*_sensors(ranking, noise or {}), ranking.judged(REPEAT, "same recordings once more", sure.matrix)]
    return tuple(sorted([*found, *_drives(ranking, told or (lambda done, total: None))], key=lambda m: -m.score))


class _Ranking:
    """What is known now, and how more information is told and scored."""

    def __init__(self, runs: Runs, near: Local, sure: Known, goal: Sequence[str]):
        self.runs, self.near, self.sure = runs, near, sure
        self.slope, self.now = slope_of(sure.free), sure.covariance()
        self.outputs = [s.name for s in runs.flat.outputs]
        for name in goal:
            if name not in (*runs.names, *self.outputs):
                raise DeclarationError(
                    f"sensitivity: '{name}' is neither a parameter asked about nor an output. "
                    f"{nearest(name, [*runs.names, *self.outputs])}"
                )
        self.goal = tuple(goal)
        n = len(runs.names)
        scale = np.outer(self.slope, self.slope)
        self._moves = [sum(r.all[j, :n, :n] for r in near.information) * scale for j in range(len(self.outputs))]

    @property
    def weights(self) -> np.ndarray:
        """One over the error of a sample of each output (ny,), 0 where none is recorded."""
        worth = self.sure.worth
        return np.where(np.isfinite(worth), 1 / np.where(np.isfinite(worth), worth, 1.0), 0.0)

    def judged(self, kind: str, what: str, more: np.ndarray, noise: float = np.nan, drive=None) -> Measurement:
        """A measurement that brings ``more`` information (np, np)."""
        then = self.sure.covariance(more)
        gain = 0.5 * float(np.linalg.slogdet(self.now)[1] - np.linalg.slogdet(then)[1])
        narrowed = np.sqrt(np.diag(then) / np.diag(self.now))
        bands = {}
        for name, moves in zip(self.outputs, self._moves, strict=True):
            if (wide := float(np.trace(self.now @ moves))) > 0:
                bands[name] = float(np.sqrt(np.trace(then @ moves) / wide))
        by_name = dict(zip(self.runs.names, map(float, narrowed), strict=True))
        wanted = [1 - (by_name | bands).get(name, 1.0) ** 2 for name in self.goal]
        score = float(np.mean(wanted)) if wanted else gain
        sentence = self._sentence(kind, what, noise, then, by_name | bands)
        return Measurement(kind, what, float(noise), gain, score, by_name, bands, sentence, drive)

    def _sentence(self, kind: str, what: str, noise: float, then: np.ndarray, ratios: Mapping[str, float]) -> str:
        who = {"sensor": f"A sensor of {what}", REPEAT: f"The {what}", "drive": f"Driving {what}"}[kind]
        if np.isfinite(noise):
            unit = self.runs.flat.outputs[self.outputs.index(what)].unit
            who += f" (error {amount(noise, unit)})"
        names = self.goal or self.runs.names
        best = min(names, key=lambda name: ratios.get(name, 1.0))
        if ratios.get(best, 1.0) > NOTHING_NEW:
            return f"{who} would tell next to nothing new" + (f" of {', '.join(self.goal)}." if self.goal else ".")
        if best not in self.runs.names:
            return f"{who} would {_shrunk('the band', best, ratios[best])}."
        k = self.runs.names.index(best)
        before, after = (self._width(k, np.sqrt(C[k, k])) for C in (self.now, then))
        if np.sqrt(self.now[k, k]) > OPEN * self.sure.free.sizes[k]:
            return f"{who} would tell {best} to {after}, which these recordings leave open."
        return f"{who} would {_shrunk('the interval', best, ratios[best])}, from {before} to {after}."

    def _width(self, k: int, sigma: float) -> str:
        """Half the 95 % interval of parameter k in words."""
        free = self.sure.free
        if not free.logarithmic[k]:
            return f"±{amount(SIGMAS * sigma * free.unit[k], free.units[k])}"
        reach = SIGMAS * sigma
        return f"±{100 * reach:.2g} %" if reach < 0.5 else f"a factor of {np.exp(reach):.2g}"


def _shrunk(what: str, name: str, ratio: float) -> str:
    if HALF[0] <= ratio <= HALF[1]:
        return f"halve {what} of {name}"
    how = f"to {100 * ratio:.2g} % of its width" if ratio > MANY else f"{1 / ratio:.2g} times"
    return f"narrow {what} of {name} {how}"


def _sensors(ranking: _Ranking, noise: Mapping[str, float]) -> Iterator[Measurement]:
    """A sensor of every output that no recording has."""
    worth, ranges = ranking.sure.worth, ranking.near.range
    known = np.isfinite(worth) & (ranges > 0)
    usual = max(SENSOR, float(np.median(worth[known] / ranges[known]))) if known.any() else SENSOR
    for j in np.flatnonzero(~np.isfinite(worth)):
        error = noise.get(ranking.outputs[j], usual * ranges[j])
        if not error > 0:
            continue
        added = np.zeros(len(worth))
        added[j] = 1 / error
        whole = information_of(ranking.near.information, ranking.weights, added, ranking.slope)
        yield ranking.judged("sensor", ranking.outputs[j], whole - ranking.sure.matrix, error)


def _drives(ranking: _Ranking, told: Callable[[int, int], None]) -> list[Measurement]:
    """The best recordings with other inputs, within what was seen, each of another kind."""
    runs = ranking.runs
    recordings = [Recording(r.name, r.digest, r.time, r.u, r.y) for r in runs.runs]
    j = varied(runs.flat.inputs, recordings)
    if j is None or runs.flat.black_box:
        return []
    limits = seen_limits(recordings, j)
    if not (limits.amplitude > 0 and limits.rate > 0):
        return []
    others, span = np.mean(np.concatenate([r.u for r in recordings]), axis=0), _span(ranking)
    signal = runs.flat.inputs[j]
    tried = list(candidates(limits, signal.unit))
    best: dict[str, Measurement] = {}
    for number, candidate in enumerate(tried):
        told(number, len(tried))
        found = _driven(runs, limits, np.where(np.arange(len(others)) == j, candidate.values[:, None], others), span)
        if found is None:
            continue
        more = information_of([found], np.zeros(len(ranking.weights)), ranking.weights, ranking.slope)
        drive = Drive(signal.name, signal.unit, candidate.kind, limits.time, candidate.values)
        words = f"{signal.name} with {candidate.words} for {limits.time[-1]:.4g} s"
        judged = ranking.judged("drive", words, more, drive=drive)
        if candidate.kind not in best or judged.score > best[candidate.kind].score:
            best[candidate.kind] = judged
    return sorted(best.values(), key=lambda m: -m.score)[:DRIVES]


def _span(ranking: _Ranking) -> np.ndarray:
    """Least and largest value of every output in the nominal runs, (2, ny): what another run must not leave."""
    curves = [Recording(c.record, None, c.time, np.zeros((len(c.time), 0)), c.outputs) for c in ranking.near.curves]
    return span_of(curves)


def _driven(runs: Runs, limits: Limits, u: np.ndarray, span: np.ndarray) -> RunInformation | None:
    """What a run from the start of the first recording would hold; None where it diverges or leaves the range."""
    first = runs.runs[0]
    y = np.full((len(limits.time), len(runs.flat.outputs)), np.nan)
    run: Run = dataclasses.replace(first, time=limits.time, u=u, y=y)
    if not stays_inside(runs.propagator, run.time, run.u, runs.p, run.start(runs.p), span):
        return None
    try:
        outputs, dy = runs.sensitivities(run)
    except SolveError:
        return None
    return information(run, outputs, dy) if np.isfinite(dy).all() else None
