"""A job of a comparison: one model on one recording, run in every mode and scored, wherever there is room for it."""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.export.reader import StartValueWarning
from hydrotwin.identification.beginning import StartEstimate, StartState
from hydrotwin.learned.bands import LEAST, scores
from hydrotwin.models.language.errors import DataError, HydrotwinError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible
from hydrotwin.records import NoiseFloor, Record, require, unbroken
from hydrotwin.simulation import InaccurateWarning
from hydrotwin.work.memory import key_of

from .band import SD
from .comparison import FREE_RUN, MODES, Failure, Score, Unscored
from .contender import Contender
from .field import Predicted, field_metrics
from .metrics import errors_of
from .rates import with_rates
from .residual import Residual, explain
from .starts import ESTIMATE, Started, start_of
from .travel import Carried
from .untold import untold_start

SAME_STEP = 1e-3  # relative: the period of a block is that of a recording
TIMING_BUDGET = 5.0  # s spent on repeating one run for its median
WARNINGS: Mapping[str, type[Warning]] = {w.__name__: w for w in (InaccurateWarning, StartValueWarning)}


@dataclass(frozen=True)
class Plan:
    """What is scored: ``wanted`` outputs in every mode, the ``rates`` of the ``sloped`` outputs in free run only.

    known : signals without which no model runs; where a recording has a hole in one, runs begin anew behind it.
    """

    modes: tuple[str, ...]
    wanted: tuple[Signal, ...]
    sloped: tuple[Signal, ...]
    rates: tuple[Signal, ...]
    initial_states: str
    known: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Job:
    """One model on one recording.

    noise : of the columns of the recording. repeats : timed runs after the first; None for that alone. curves : whether
    all that was predicted comes back; else only what tells how far a learned model was from what it was trained on.
    """

    carried: Carried
    record: Record
    plan: Plan
    noise: Mapping[str, NoiseFloor]
    repeats: int | None
    curves: bool = True

    @property
    def content(self) -> str:
        """All that its answer depends on, hashed; not how often a run is timed."""
        record = self.record
        return key_of(
            self.carried, record.name, record.time, dict(record.signals), record.units, self.plan, self.curves
        )


@dataclass(frozen=True, eq=False)
class Run:
    """One mode of a job: predicted ``signals`` (n,) at the times of the recording, their ``units``, standard deviations
    by output, and wall ``seconds`` of each timed run; chance : by output, see `Score`."""

    mode: str
    signals: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    name: str
    deviation: Mapping[str, np.ndarray]
    seconds: tuple[float, ...]
    chance: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Done:
    """What a job found."""

    runs: tuple[Run, ...]
    scores: tuple[Score, ...]
    residuals: tuple[Residual, ...]
    failures: tuple[Failure, ...]
    unscored: tuple[Unscored, ...]
    started: tuple[Started, ...]
    warned: tuple[tuple[str, str], ...]


KEPT = (Done, Run, Score, Residual, Failure, Unscored, Started, StartEstimate, StartState)


def run_job(job: Job) -> Done:
    """Run and score; whatever fails becomes a row, and whatever warns a sentence."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        for kind in WARNINGS.values():
            warnings.simplefilter("always", kind)
        contender, found = job.carried.contender, _Found([], [], [], [], [])
        parts = unbroken(job.record, job.plan.known)
        begun = [start_of(contender, part, job.plan.initial_states) for part in parts]
        legs = [(own, part) for (own, _), part in zip(begun, parts, strict=True)]
        for mode in job.plan.modes:
            run = _predict(legs, mode, job, found)
            if run is not None and mode == FREE_RUN and begun[0][1] is None:
                begun[0] = legs[0][0], _doubted(legs[0], run, job)
            if run is not None:
                found.runs.append(run if job.curves else _lean(run, contender, job.record))
                _score(contender, run, job, found)
    warned = dict.fromkeys((w.category.__name__, str(w.message)) for w in caught)
    rows = (tuple(rows) for rows in (found.runs, found.scores, found.residuals, found.failures, found.unscored))
    return Done(*rows, tuple(started for _, started in begun if started), tuple(warned))


def _doubted(leg: tuple[Contender, Record], run: Run, job: Job) -> Started | None:
    """How the first part of a recording starts, where nobody knows that and it makes most of the error."""
    contender, part = leg
    wanted = {s.name for s in job.plan.wanted}
    at = np.searchsorted(job.record.time, part.time)
    predicted = {n: y[at] for n, y in run.signals.items() if n in wanted and n in part.signals}
    if not (note := untold_start(contender, part, predicted, job.noise)):
        return None
    return Started(contender.name, StartEstimate(part.name, note=f"{note}. {ESTIMATE}."), part.whole)


@dataclass
class _Found:
    """What the modes have shown so far."""

    runs: list[Run]
    scores: list[Score]
    residuals: list[Residual]
    failures: list[Failure]
    unscored: list[Unscored]


def _predict(legs: Sequence[tuple[Contender, Record]], mode: str, job: Job, found: _Found) -> Run | None:
    """What one contender predicts in one mode, timed; a failure becomes a row, and the answer None.

    legs : it with its start on every part of the recording, and the part. What is between them nothing predicts.
    """
    (contender, _), record, plan = legs[0], job.record, job.plan
    if reason := _not_in(mode, contender, record):
        found.unscored.extend(Unscored(contender.name, record.name, s.name, reason) for s in plan.wanted)
        return None
    try:
        made = [_leg(own, part, mode, job.repeats or 0) for own, part in legs]
    except Exception as error:
        found.failures.append(Failure(contender.name, record.name, mode, _sentence(error)))
        return None
    runs, seconds = [run for run, _ in made], [sum(each) for each in zip(*(s for _, s in made), strict=False)]
    bands = [_band_of(own, (part, job.noise), run, mode) for (own, part), run in zip(legs, runs, strict=True)]
    prediction = Record(record.time, _joined(record, [(r.time, r.signals) for r in runs]), runs[0].units, runs[0].name)
    if mode == FREE_RUN:
        prediction = with_rates(prediction, plan.sloped, record)
    deviation = _joined(record, [(run.time, sd) for run, (sd, _) in zip(runs, bands, strict=True)])
    chances = [chance for _, chance in bands]
    each = {n: [one[n] for one in chances] for n in chances[0] if all(n in one for one in chances)}
    chance = {n: min(1.0, len(chances) * min(values)) for n, values in each.items()}  # that of one of several parts
    signals, units = dict(prediction.signals), dict(prediction.units)
    return Run(mode, signals, units, prediction.name, deviation, tuple(seconds), chance)


def _not_in(mode: str, contender: Contender, record: Record) -> str:
    """Why a contender has no score in a mode, whatever the output; "" where it has."""
    if mode not in getattr(contender, "modes", MODES):
        return f"no {mode}: its states cannot be set"
    if mode == FREE_RUN or not hasattr(contender, "states_set") or contender.states_set(record):
        return ""
    return f"no {mode}: no output that is measured sets a state of it, so that it would be its free run"


def _leg(contender: Contender, part: Record, mode: str, repeats: int) -> tuple[Record, list[float]]:
    """The prediction of one part of a recording at its samples, and the wall seconds of each timed run."""
    require(part, contender.inputs, contender.name)
    run = contender.free_run if mode == FREE_RUN else contender.one_step
    prediction, seconds = _timed(run, part, repeats)
    return _on_time_of(part, prediction), seconds


def _joined(record: Record, parts: Sequence[tuple[np.ndarray, Mapping[str, np.ndarray]]]) -> dict[str, np.ndarray]:
    """Columns (n,) at the times of a recording, of its parts: their times and columns. NaN where there is none."""
    if len(parts[0][0]) == len(record):
        return dict(parts[0][1])
    names = [name for name in parts[0][1] if all(name in values for _, values in parts)]
    columns = {name: np.full(len(record), np.nan) for name in names}
    for times, values in parts:
        at = np.searchsorted(record.time, times)
        for name, column in columns.items():
            column[at] = values[name]
    return columns


def _band_of(
    contender, measured: tuple[Record, Mapping[str, NoiseFloor]], prediction: Record, mode: str
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Standard deviations by output where the contender has them for this mode, and the chance of what was measured
    where it says what they are made of; without them it is scored, too."""
    (record, noise), own = measured, {s.name for s in contender.outputs}
    known = {n: prediction[f"{n}{SD}"] for n in own if f"{n}{SD}" in own and f"{n}{SD}" in prediction.signals}
    if mode != FREE_RUN and not _steps_with(contender, record):
        return {}, {}
    if mode != FREE_RUN or not hasattr(contender, "deviations"):
        return known, {}
    try:
        if not hasattr(contender, "moves"):
            return contender.deviations(record) | known, {}
        moved = contender.moves(record)
    except HydrotwinError:
        return known, {}
    both = [n for n in moved if n in record.signals and n in prediction.signals]
    steps = {n: noise[n].quantum if n in noise else 0.0 for n in both}
    chance = {n: moved[n].chance(record[n] - prediction[n], steps[n]) for n in both}
    return {n: one.deviation for n, one in moved.items()} | known, chance


def _steps_with(contender, record: Record) -> bool:
    """Whether one step of a block is one of the recording: from sample to sample of a slower one its deviations are not
    those of one step."""
    block = getattr(contender, "block", None)
    return block is None or (record.uniform and math.isclose(record.period, block.period, rel_tol=SAME_STEP))


def _lean(run: Run, contender, record: Record) -> Run:
    box = getattr(contender, "domain", None)
    wanted = [n for n in box.names if n not in record.signals and n in run.signals] if box else []
    return dataclasses.replace(run, signals={n: run.signals[n] for n in wanted}, deviation={})


def _score(contender, run: Run, job: Job, found: _Found) -> None:
    """Score every wanted output of one prediction; what cannot be scored becomes a row."""
    record, free = job.record, run.mode == FREE_RUN
    inputs = [s.name for s in contender.inputs]
    for signal in job.plan.wanted + (job.plan.rates if free else ()):
        name = signal.name
        reason = _not_comparable(record, run, signal)
        if reason:
            found.unscored.append(Unscored(contender.name, record.name, name, reason))
            continue
        predicted = run.signals[name]
        try:
            errors = errors_of(record[name], predicted)
        except DataError as error:
            found.failures.append(Failure(contender.name, record.name, run.mode, f"{name}: {error}"))
            continue
        floor, deviation = job.noise.get(name), run.deviation.get(name)
        metrics = field_metrics(record, Predicted(name, predicted, deviation), inputs, job.noise, rated=free)
        told = dataclasses.asdict(errors) | dataclasses.asdict(metrics) | _band(record[name], predicted, deviation)
        told |= {"chance": run.chance[name]} if name in run.chance else {}
        white = floor.white if floor else np.nan
        found.scores.append(Score(contender.name, record.name, name, run.mode, unit=signal.unit, noise=white, **told))
        if free and floor:
            found.residuals.append(explain(record, name, predicted, model=contender.name, noise=floor.sigma))


def _band(measured: np.ndarray, predicted: np.ndarray, deviation: np.ndarray | None) -> dict[str, float]:
    """Coverage, NLPD and CRPS of a band; nothing without one, or where it is not told.

    A sample that was given, and not predicted, has no deviation and no miss, and tells nothing. What a model claims to
    know exactly, and misses, lies outside.
    """
    miss, known = measured - predicted, np.isfinite(measured)
    if deviation is None or not np.isfinite(deviation[known]).all():
        return {}
    known &= (deviation > 0) | (miss != 0)
    if not (deviation[known] > 0).any():
        return {}
    least = LEAST * float(np.abs(miss[known]).max())
    found = scores(miss[known], np.maximum(deviation[known], least))
    return {key: found[key] for key in ("coverage", "nlpd", "crps")}


def _timed(run: Callable[[Record], Record], record: Record, repeats: int) -> tuple[Record, list[float]]:
    """The prediction and the wall seconds of each timed run; the first run (which may compile) counts only alone."""
    seconds: list[float] = []
    while len(seconds) < repeats + 1 and sum(seconds) < TIMING_BUDGET:
        begin = time.perf_counter()
        prediction = run(record)
        seconds.append(time.perf_counter() - begin)
    return prediction, seconds[1:] or seconds


def _not_comparable(record: Record, run: Run, signal: Signal) -> str | None:
    """Why an output cannot be scored, or None."""
    if signal.name not in record.signals:
        return "not recorded"
    if signal.name not in run.signals:
        return "not an output of this model"
    unit = run.units.get(signal.name, signal.unit)
    if not compatible(record.units[signal.name], unit):
        return f"recorded in {record.units[signal.name]}, predicted in {unit}"
    return None


def _on_time_of(record: Record, prediction: Record) -> Record:
    """The prediction on the samples of the recording (linear in between)."""
    if len(prediction.time) == len(record.time) and np.allclose(prediction.time, record.time, rtol=0, atol=1e-9):
        return prediction
    signals = {n: np.interp(record.time, prediction.time, v) for n, v in prediction.signals.items()}
    return Record(record.time, signals, dict(prediction.units), prediction.name)


def _sentence(error: Exception) -> str:
    text = " ".join(str(error).split()) or "stopped without a message"
    return text if isinstance(error, HydrotwinError) else f"{type(error).__name__}: {text}"
