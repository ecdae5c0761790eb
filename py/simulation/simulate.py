"""`simulate` and `predict_one_step`: a model or block over a recording."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import Record, as_needed, known_inputs, require
from hydrotwin.records.between import settled

from . import sampled
from .block import INSIDE_TRAINING, ON_THE_EDGE, TRAINING_DISTANCE, Block
from .control import Accuracy
from .inputs import as_seen
from .propagator import OWN_METHOD, prepare


class InaccurateWarning(UserWarning):
    """A run that misses the accuracy; the text says by how much."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Simulated(Record):
    """A Record that was simulated, and how accurately."""

    accuracy: Accuracy | None = None


def simulate(
    model,
    record: Record,
    *,
    parameters: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    step: float | None = None,
    method: str = OWN_METHOD,
    interpolation: Mapping[str, str] | None = None,
) -> Record:
    """Outputs of a model or Block at ``record.time``, driven by the inputs in the record. Its time is 0 as they begin.

    States start from ``start`` (SI, by name), else from the first sample of the output that measures them, else from
    the model's own initialisation. A Block runs at its own period: inputs are held or linear between the samples of
    the record, outputs are linear between those of the block; samples that are even count as even, however their times
    are printed (`Record.evenly`). A Block that knows its training domain also gives
    ``training_distance`` (box widths outside, 0 inside) and ``inside_training_domain`` (1 or 0).

    parameters : changed parameter values (SI, by path). step, method : see `prepare`; a Block is refused them.
    interpolation : "hold" or "linear" by input, in place of what the model says or the recording shows.

    Of a model's run the answer's ``accuracy`` says how far it is from that with half the step; a run that misses
    `control.ACCURACY` warns with the numbers (`InaccurateWarning`).

    Raises DataError for a missing input, Diverged with time and state for a run that leaves the finite numbers.
    """
    record = filled(record, model)
    model = settled(model, [record], interpolation)
    if isinstance(model, Block):
        check_own_period(model, step, method)
        even = record.evenly()
        run = _block_run(model, even, parameters, start)
        y = sampled.run_block(model, run.grid, run.u, run.p, run.x0)[0]
        answer = _with_domain(answer_of(even, model, y, run.grid), model, run, y)
        return dataclasses.replace(answer, time=record.time)
    flat = getattr(model, "flat", model)
    u, p, x0 = _driven(flat, record, parameters, start)
    propagator = prepare(flat, step=step, method=method)
    if flat.black_box:
        return answer_of(record, flat, propagator.run(since_start(record), u, p, x0)[0])
    y, _, reached = propagator.controlled_run(since_start(record), u, p, x0)
    if not reached.reached:
        warnings.warn(f"{flat.name} on {record.name}: {reached}.", InaccurateWarning, stacklevel=2)
    return Simulated(**vars(answer_of(record, flat, y)), accuracy=reached)


def predict_one_step(
    model,
    record: Record,
    *,
    parameters: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    step: float | None = None,
    method: str = OWN_METHOD,
) -> Record:
    """Outputs predicted from each sample to the next.

    At every sample the measured outputs replace the states they determine (``StateVariable.measured_by``); all other
    states are those of the free run. The first sample is that of the free run.
    """
    record = filled(record, model)
    model = settled(model, [record])
    if isinstance(model, Block):
        check_own_period(model, step, method)
        even = record.evenly()
        run = _block_run(model, even, parameters, start)
        _, x = sampled.run_block(model, run.grid, run.u, run.p, run.x0)
        measured = _corrected(model, even, x, run.grid)
        predicted = sampled.predict_block(model, run.grid, even.time, run.u, run.p, measured)
        return dataclasses.replace(answer_of(even, model, predicted, run.grid), time=record.time)
    flat = getattr(model, "flat", model)
    u, p, x0 = _driven(flat, record, parameters, start)
    propagator = prepare(flat, step=step, method=method)
    _, x = propagator.run(since_start(record), u, p, x0)
    restart = _corrected(flat, record, x, record.time)
    return answer_of(record, flat, propagator.run(since_start(record), u, p, x0, restart)[0])


def check_own_period(block: Block, step: float | None, method: str) -> None:
    """Raises DeclarationError where a block is asked for a step or a method: it has its own."""
    if step is not None or method != OWN_METHOD:
        raise DeclarationError(
            f"simulate: {block.name} steps every {block.period:g} s, and step and method do not reach it. Drop them."
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _BlockRun:
    grid: np.ndarray
    u: np.ndarray
    p: np.ndarray
    x0: np.ndarray


def since_start(record: Record) -> np.ndarray:
    """A model's time is 0 where the recording begins, whatever the clock of the logger says; of a part, its whole."""
    return record.time - record.begins


def filled(record: Record, model) -> Record:
    system = getattr(model, "flat", model)
    if len(record.time) == 0:
        raise DataError(f"{record.source or record.name}: no samples to run {model.name} on. Give one with data.")
    return as_needed(record, (*system.inputs, *system.outputs))


def _driven(flat: FlatModel, record: Record, parameters, start) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inputs, parameters and start state of a model on a record."""
    u = inputs_of(flat, record)
    p = flat.parameter_vector(parameters)
    return u, p, started(flat, record, u, p, start)


def started(flat: FlatModel, record: Record, u, p, start: Mapping[str, float] | None) -> np.ndarray:
    """The start states (nx,) of a model on a record: given, measured, or by its own initialisation."""
    given = {s.name: record[s.measured_by][0] for s in flat.states if _measures(record, s.measured_by)}
    given = {name: float(value) for name, value in given.items() if np.isfinite(value)} | dict(start or {})
    order = {s.name: k for k, s in enumerate(flat.states)}
    given = dict(sorted(given.items(), key=lambda item: order.get(item[0], -1)))  # as a model that travels has them
    return flat.start_given(tuple(given))(u[0], p, list(given.values())).full().ravel()


def _block_run(block: Block, record: Record, parameters, start) -> _BlockRun:
    u = inputs_of(block, record)
    grid = sampled.sample_grid(block, record.time)
    u = u if grid is record.time else sampled.sampled_inputs(block, record.time, u, grid)
    p, start = block.parameter_vector(), dict(start or {})
    _replace(p, [q.name for q in block.parameters], parameters or {}, f"{block.name}: no parameter")
    _replace(np.empty(len(block.states)), [s.name for s in block.states], start, f"{block.name}: no state")
    y = np.array([record[s.name][0] if _measures(record, s.name) else np.nan for s in block.outputs])
    return _BlockRun(grid, u, p, sampled.start_state(block, u[0], y, p, start))


def inputs_of(system: FlatModel | Block, record: Record) -> np.ndarray:
    """The input columns (n, nu), present, of the right dimension and without gaps."""
    record = known_inputs(require(record, system.inputs, system.name), system.inputs, system.name)
    u = record.array([s.name for s in system.inputs])
    for j, signal in enumerate(system.inputs):
        u[:, j] = as_seen(signal, record.time, u[:, j])
    return u


def _replace(values: np.ndarray, names: list[str], changes: Mapping[str, float], refusal: str) -> None:
    for name, value in changes.items():
        if name not in names:
            raise DeclarationError(f"{refusal} '{name}'. {nearest(name, names)}")
        values[names.index(name)] = value


def _measures(record: Record, output: str | None) -> bool:
    return output is not None and output in record


def _corrected(system: FlatModel | Block, record: Record, x: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """The states with the measured ones replaced by what was measured; gaps (nan) keep the free run."""
    corrected = x.copy()
    for j, state in enumerate(system.states):
        if not _measures(record, state.measured_by):
            continue
        measured = record[state.measured_by]
        measured = measured if grid is record.time else np.interp(grid, record.time, measured)
        corrected[:, j] = np.where(np.isfinite(measured), measured, x[:, j])
    return corrected


def _with_domain(answer: Record, block: Block, run: _BlockRun, y: np.ndarray) -> Record:
    """With the distance from the training data and whether that is nil, where the block knows its domain."""
    if block.domain is None:
        return answer
    columns = dict(zip([s.name for s in (*block.inputs, *block.outputs)], np.hstack([run.u, y]).T, strict=True))
    distance = block.domain.distance(np.column_stack([columns[name] for name in block.domain.names]))
    distance = np.interp(answer.time, run.grid, distance)
    told = {TRAINING_DISTANCE: distance, INSIDE_TRAINING: (distance <= ON_THE_EDGE).astype(float)}
    return answer.with_signals(told, dict.fromkeys(told, "1"))


def answer_of(record: Record, system: FlatModel | Block, y: np.ndarray, grid: np.ndarray | None = None) -> Record:
    """Outputs as a record on the time axis of the input record."""
    columns = [y[:, j] if grid is None or grid is record.time else np.interp(record.time, grid, y[:, j])
               for j in range(len(system.outputs))]  # fmt: skip
    return dataclasses.replace(
        record,
        signals={s.name: column for s, column in zip(system.outputs, columns, strict=True)},
        units={s.name: s.unit for s in system.outputs},
        name=f"{record.name}, {system.name}",
        source=None,
        digest=None,
    )
