"""`simulate_many`: many parameter sets of a model over one recording, as many single runs would have it."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import Record
from hydrotwin.records.between import settled

from .block import Block
from .control import Accuracy
from .many import Ran, controlled_many, run_many
from .propagator import prepare
from .simulate import InaccurateWarning, answer_of, check_own_period, filled, inputs_of, simulate, since_start, started
from .stops import Diverged


@dataclasses.dataclass(frozen=True, eq=False)
class Ensemble:
    """What many parameter sets give on one recording.

    values : (sets, n, ny), SI, nan for a set that diverged. outputs : names of the ny columns. time : (n,), recorded.
    reasons : why sets diverged, by their position. accuracies : of each set, None where none is known.
    """

    values: np.ndarray
    outputs: tuple[str, ...]
    time: np.ndarray
    reasons: Mapping[int, str]
    accuracies: tuple[Accuracy | None, ...]
    _form: Record = dataclasses.field(repr=False)

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, output: str) -> np.ndarray:
        """One output of all sets, (sets, n)."""
        if output not in self.outputs:
            raise DeclarationError(f"{self._form.name}: no output '{output}'. {nearest(output, self.outputs)}")
        return self.values[:, :, self.outputs.index(output)]

    @property
    def diverged(self) -> np.ndarray:
        """Which sets diverged, (sets,) of bool."""
        return np.isin(np.arange(len(self)), list(self.reasons))

    def record(self, position: int) -> Record:
        """One set as the Record that `simulate` gives. Raises Diverged with the reason for one that diverged."""
        position = range(len(self))[position]
        if position in self.reasons:
            raise Diverged(self.reasons[position], float(self.time[0]), None)
        signals = dict(zip(self.outputs, self.values[position].T, strict=True))
        return dataclasses.replace(self._form, signals=signals)


def simulate_many(
    model,
    parameter_sets: Sequence[Mapping[str, float]] | np.ndarray,
    record: Record,
    *,
    names: Sequence[str] | None = None,
    start: Mapping[str, float] | None = None,
    step: float | None = None,
    method: str = "auto",
    interpolation: Mapping[str, str] | None = None,
) -> Ensemble:
    """Outputs of a model or Block for many parameter sets at ``record.time``: each as `simulate` gives it, to 1e-9 of
    the output's range.

    parameter_sets : changed parameter values (SI) by path for each set, or an array (sets, k) with their ``names``.
    start, step, method, interpolation : as in `simulate`, the same for all sets.

    Explicit runs of a model go side by side through vector registers, several times faster than one by one. What needs
    implicit steps, Blocks, FMUs, equations without a vector form and machines without a compiler run one by one. A set
    that diverges costs only itself and is marked. Sets that miss the accuracy are told in one `InaccurateWarning`.

    Raises DeclarationError for an unknown parameter and where there is no set, DataError for a missing input.
    """
    sets = _mappings(model, parameter_sets, names)
    record = filled(record, model)
    if isinstance(model, Block):
        check_own_period(model, step, method)
        ran = [_block_run(model, record, parameters, start, interpolation) for parameters in sets]
    else:
        model = settled(model, [record], interpolation)
        model = getattr(model, "flat", model)
        ran = _model_runs(model, record, sets, start, (step, method))
    _tell_inaccurate(model, record, ran)
    y = np.stack([one.y for one in ran])
    reasons = {k: str(one.stop) for k, one in enumerate(ran) if one.stop is not None}
    outputs = tuple(s.name for s in model.outputs)
    return Ensemble(y, outputs, record.time, reasons, tuple(r.accuracy for r in ran), answer_of(record, model, y[0]))


def _mappings(model, sets, names) -> list[Mapping[str, float]]:
    name = getattr(model, "name", None) or model.flat.name
    if isinstance(sets, Mapping):
        raise DeclarationError(f"{name}: one parameter set is no list of sets. Write [{{'path': value}}].")
    if names is not None:
        sets = _named(name, sets, list(names))
    sets = list(sets)
    if not all(isinstance(one, Mapping) for one in sets):
        raise DeclarationError(f"{name}: parameter sets without names. Give mappings, or the array's columns as names.")
    if not sets:
        raise DeclarationError(f"{name}: no parameter sets. Give at least one, {{}} for the model as it is.")
    return sets


def _named(name: str, sets, names: list[str]) -> list[dict[str, float]]:
    """The mappings of an array (sets, k) of values, k of them named."""
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise DeclarationError(f"{name}: '{twice}' is named for two columns. Name each parameter once.")
    try:
        values = np.asarray(sets, dtype=float)
    except (TypeError, ValueError):
        raise DeclarationError(
            f"{name}: with names the parameter sets are an array of numbers (sets, {len(names)}). Leave names out for "
            "mappings."
        ) from None
    if values.ndim != 2 or values.shape[1] != len(names):
        raise DeclarationError(
            f"{name}: with {len(names)} names the parameter sets are an array (sets, {len(names)}) (got "
            f"{values.shape}). Give a row for each set."
        )
    return [dict(zip(names, row, strict=True)) for row in values.tolist()]


def _model_runs(flat: FlatModel, record: Record, sets, start, how: tuple[float | None, str]) -> list[Ran]:
    u = inputs_of(flat, record)
    p = np.array([flat.parameter_vector(parameters) for parameters in sets])
    x0 = np.array([started(flat, record, u, one, start) for one in p])
    propagator = prepare(flat, step=how[0], method=how[1])
    if flat.black_box:
        return [Ran(*one) for one in zip(*run_many(propagator, since_start(record), u, p, x0), strict=True)]
    return controlled_many(propagator, since_start(record), u, p, x0)


def _block_run(block: Block, record: Record, parameters, start, interpolation) -> Ran:
    try:
        ran = simulate(block, record, parameters=parameters, start=start, interpolation=interpolation)
    except Diverged as stop:
        return Ran(np.full((len(record.time), len(block.outputs)), np.nan), stop)
    return Ran(ran.array([s.name for s in block.outputs]))


def _tell_inaccurate(model, record: Record, ran: list[Ran]) -> None:
    missed = {k: one.accuracy for k, one in enumerate(ran) if one.accuracy is not None and not one.accuracy.reached}
    if missed:
        worst = max(missed, key=lambda k: missed[k].error)
        text = f"{model.name} on {record.name}: {len(missed)} of {len(ran)} sets; the worst, set {worst}, is "
        warnings.warn(f"{text}{missed[worst]}.", InaccurateWarning, stacklevel=3)
