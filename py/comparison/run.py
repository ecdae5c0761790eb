"""Run every contender on every recording and score it: the verb of this room."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from hydrotwin.learned.bands import scores
from hydrotwin.models.language.errors import DataError, DeclarationError, HydrotwinError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible
from hydrotwin.records import NoiseFloor, Record, as_needed, distinct, noise_floor, require
from hydrotwin.records.between import between, settled, told

from .comparison import (
    FREE_RUN,
    MODES,
    Comparison,
    Entrant,
    Failure,
    Score,
    Timing,
    Trajectory,
    Unscored,
    mean_scores,
    relative_scores,
)
from .contender import Contender, as_contender
from .domain import domain_shares
from .field import Predicted, field_metrics
from .metrics import errors_of
from .rates import rate_signal, with_rates
from .residual import Residual, explain
from .starts import with_starts

SD = ".sd"  # behind the name of an output: the standard deviation that a block gives beside it
TIMING_BUDGET = 5.0  # s spent on repeating one run for its median


def compare(
    contenders: Sequence[Contender],
    records: Sequence[Record],
    *,
    modes: Sequence[str] = MODES,
    outputs: Sequence[str] | None = None,
    rates: Sequence[str] = (),
    train_records: Sequence[Record] = (),
    title: str = "Comparison of models",
    repeats: int = 3,
    progress: Callable[[int, int, str], None] | None = None,
    interpolation: Mapping[str, str] | None = None,
    initial_states: str = "measured",
) -> Comparison:
    """Score ``contenders`` on ``records``, all on the same inputs and the same samples.

    contenders : models, blocks and FMUs, as they are or by `as_contender`.
    modes : "free run" (inputs and start only) and "one step" (each sample from the measurement before it).
    outputs : names to score; by default every output that some contender gives and some recording holds.
    rates : names of outputs whose slope is scored too, in free run, as output ``<name>.rate``.
    train_records : the recordings the models were made from, for the share of each recording they cover.
    repeats : timed runs per model and recording; fewer when they take longer than TIMING_BUDGET together.
    progress : called with (runs done, runs in all, what is next).
    interpolation : "hold" or "linear" by input, in place of what the models say or the recordings show.
    initial_states : "measured": first samples count as exact, and models find the rest of their start; "auto" and
        "free": physical models have it estimated from the first part of each recording, see `estimate_start`. All
        samples are scored, the first part too.

    A contender that fails on a recording is a row of ``failures``. Raises DeclarationError for names that are used
    twice or not known, DataError when there is nothing to compare.
    """
    contenders, records = [as_contender(c) for c in contenders], distinct(records)[0]
    _check(contenders, records, modes)
    contenders = _settled(contenders, records, interpolation or {})
    contenders, starts = with_starts(contenders, records, initial_states)
    wanted = _wanted(contenders, records, outputs)
    sloped = _wanted(contenders, records, rates) if rates else []
    noise = {r.name: noise_floor(r) for r in records}
    records = [with_rates(as_needed(r, wanted), sloped) for r in records]
    plan = _Plan(tuple(wanted), tuple(sloped), tuple(rate_signal(s) for s in sloped), repeats, noise)
    runs = [(c, r, m) for m in modes for c in contenders for r in records]
    found = _Findings([], [], {}, [], [], [])
    for done, (contender, record, mode) in enumerate(runs):
        if progress:
            progress(done, len(runs), f"{contender.name}, {record.name}, {mode}")
        prediction = _predict(contender, record, mode, plan, found)
        if prediction is not None:
            _score(contender, record, mode, prediction, plan, found)
    if progress:
        progress(len(runs), len(runs), "done")
    scores = relative_scores(found.scores)
    return Comparison(
        title=title,
        entrants=tuple(_entrant(c) for c in contenders),
        records=tuple(records),
        train_records=tuple(train_records),
        modes=tuple(modes),
        outputs=plan.wanted + plan.rates,
        scores=scores,
        means=mean_scores(scores),
        trajectories=tuple(found.trajectories),
        timings=tuple(_timing(key, values) for key, values in found.seconds.items()),
        failures=tuple(found.failures),
        unscored=tuple(dict.fromkeys(found.unscored)),
        domains=domain_shares(contenders, records, train_records, found.trajectories),
        residuals=tuple(found.residuals),
        starts=starts,
    )


@dataclasses.dataclass(frozen=True)
class _Plan:
    """What is scored: outputs in every mode, the ``rates`` of the ``sloped`` outputs in free run only."""

    wanted: tuple[Signal, ...]
    sloped: tuple[Signal, ...]
    rates: tuple[Signal, ...]
    repeats: int
    noise: Mapping[str, Mapping[str, NoiseFloor]]


@dataclasses.dataclass
class _Findings:
    """What the runs have shown so far."""

    scores: list[Score]
    trajectories: list[Trajectory]
    seconds: dict[tuple[str, str], list[float]]
    failures: list[Failure]
    unscored: list[Unscored]
    residuals: list[Residual]


def _predict(contender, record: Record, mode: str, plan: _Plan, found: _Findings) -> Record | None:
    """What one contender predicts for one recording, timed; a failure becomes a row, and the answer None."""
    labels = (contender.name, record.name, mode)
    if mode not in getattr(contender, "modes", MODES):
        reason = f"no {mode}: its states cannot be set"
        found.unscored.extend(Unscored(contender.name, record.name, s.name, reason) for s in plan.wanted)
        return None
    run = contender.free_run if mode == FREE_RUN else contender.one_step
    try:
        require(record, contender.inputs, contender.name)
        prediction, seconds = _timed(run, record, plan.repeats)
        prediction = _on_time_of(record, prediction)
    except Exception as error:
        found.failures.append(Failure(*labels, _sentence(error)))
        return None
    if mode == FREE_RUN:
        prediction = with_rates(prediction, plan.sloped)
    duration = max(record.duration, np.finfo(float).tiny)
    found.seconds.setdefault((contender.name, mode), []).extend(s / duration for s in seconds)
    found.trajectories.append(Trajectory(*labels, prediction, _deviation(contender, record, prediction, mode)))
    return prediction


def _deviation(contender, record: Record, prediction: Record, mode: str) -> dict[str, np.ndarray]:
    """Standard deviations by output where the contender has them for this mode; without them it is scored, too."""
    own = {s.name for s in contender.outputs}
    known = {n: prediction[f"{n}{SD}"] for n in own if f"{n}{SD}" in own and f"{n}{SD}" in prediction.signals}
    if known or mode != FREE_RUN or not hasattr(contender, "deviations"):
        return known
    try:
        return contender.deviations(record)
    except HydrotwinError:
        return {}


def _score(contender, record: Record, mode: str, prediction: Record, plan: _Plan, found: _Findings) -> None:
    """Score every wanted output of one prediction; what cannot be scored becomes a row."""
    for signal in plan.wanted + (plan.rates if mode == FREE_RUN else ()):
        name = signal.name
        reason = _not_comparable(record, prediction, signal)
        if reason:
            found.unscored.append(Unscored(contender.name, record.name, name, reason))
            continue
        try:
            errors = errors_of(record[name], prediction[name])
        except DataError as error:
            found.failures.append(Failure(contender.name, record.name, mode, f"{name}: {error}"))
            continue
        labels = (contender.name, record.name, name, mode)
        floor = plan.noise[record.name].get(name)
        white = floor.white if floor else np.nan
        deviation = found.trajectories[-1].deviation.get(name)
        band = _band(record[name], prediction[name], deviation)
        predicted, inputs = Predicted(name, prediction[name], deviation), [s.name for s in contender.inputs]
        field = field_metrics(record, predicted, inputs, plan.noise[record.name], rated=mode == FREE_RUN)
        told = dataclasses.asdict(errors) | dataclasses.asdict(field) | band
        found.scores.append(Score(*labels, unit=signal.unit, noise=white, **told))
        if mode == FREE_RUN and floor:
            found.residuals.append(explain(record, name, prediction[name], model=contender.name, noise=floor.sigma))


def _band(measured: np.ndarray, predicted: np.ndarray, deviation: np.ndarray | None) -> dict[str, float]:
    """Coverage, NLPD and CRPS of a band; nothing without one."""
    if deviation is None:
        return {}
    known = np.isfinite(measured) & (deviation > 0)
    found = scores(measured[known] - predicted[known], deviation[known]) if known.any() else {}
    return {key: found[key] for key in ("coverage", "nlpd", "crps") if key in found}


def _timed(run: Callable[[Record], Record], record: Record, repeats: int) -> tuple[Record, list[float]]:
    """The prediction and the wall seconds of each timed run; the first run (which may compile) counts only alone."""
    seconds: list[float] = []
    while len(seconds) < repeats + 1 and sum(seconds) < TIMING_BUDGET:
        begin = time.perf_counter()
        prediction = run(record)
        seconds.append(time.perf_counter() - begin)
    return prediction, seconds[1:] or seconds


def _not_comparable(record: Record, prediction: Record, signal: Signal) -> str | None:
    """Why an output cannot be scored, or None."""
    if signal.name not in record.signals:
        return "not recorded"
    if signal.name not in prediction.signals:
        return "not an output of this model"
    unit = prediction.units.get(signal.name, signal.unit)
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


def _timing(key: tuple[str, str], values: list[float]) -> Timing:
    return Timing(*key, float(np.median(values)), float(min(values)), float(max(values)), len(values))


def _settled(contenders: Sequence[Contender], records: Sequence[Record], wanted: Mapping[str, str]) -> list[Contender]:
    """The contenders with their inputs decided for all recordings together: one rule for what they share."""
    told([s for c in contenders for s in c.inputs], wanted, "none of the models")
    contenders = [_fed(c, records) for c in contenders]
    own = [{s.name: wanted[s.name] for s in c.inputs if s.name in wanted} for c in contenders]
    return [settled(c, records, some) for c, some in zip(contenders, own, strict=True)]


def _fed(contender: Contender, records: Sequence[Record]) -> Contender:
    """An FMU whose inputs that nobody recorded keep their start values, under the name of its contender."""
    fed_by = getattr(contender, "fed_by", None)
    return contender if fed_by is None else as_contender(fed_by(records), contender.name)


def _entrant(contender) -> Entrant:
    chosen = between([s for s in contender.inputs if s.chosen_by != "model"])
    return Entrant(
        contender.name,
        contender.kind,
        tuple(contender.inputs),
        tuple(contender.outputs),
        tuple(getattr(contender, "parameters", None) or ()),
        {**(getattr(contender, "provenance", None) or {}), **({"inputs between samples": chosen} if chosen else {})},
    )


def _check(contenders: Sequence[Contender], records: Sequence[Record], modes: Sequence[str]) -> None:
    if not contenders or not records:
        what = "contenders" if not contenders else "recordings"
        raise DataError(f"compare: nothing to compare (got 0 {what}). Give at least one model and one recording.")
    names = [c.name for c in contenders]
    for name in names:
        if names.count(name) > 1:
            raise DeclarationError(
                f"compare: two models are called '{name}'. Each needs its own name, which is its row in every table. "
                "Give one of them another name."
            )
    for mode in modes:
        if mode not in MODES:
            raise DeclarationError(f"compare: no mode '{mode}'. {nearest(mode, MODES)}")


def _wanted(contenders, records: Sequence[Record], outputs: Sequence[str] | None) -> list[Signal]:
    """Signals to score. An asked-for name that no contender gives raises."""
    given = {s.name: s for s in _signals(contenders)}
    if outputs is None:
        measured = [s for s in given.values() if any(s.name in r.signals for r in records)]
        if not measured:
            raise DataError(
                f"compare: no recording holds an output of any model (got {', '.join(records[0].signals)}). "
                f"The models give {', '.join(given)}. Rename a column, or record one of them."
            )
        return measured
    for name in outputs:
        if name not in given:
            raise DeclarationError(f"compare: no model has an output '{name}'. {nearest(name, given)}")
    return [given[name] for name in outputs]


def _signals(contenders) -> Iterator[Signal]:
    """Outputs of all contenders; the first to declare one sets its unit, yardsticks come last."""
    for contender in contenders:
        yield from contender.outputs
