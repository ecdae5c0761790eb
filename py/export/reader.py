"""read_fmu: anybody's FMU as a contender in a comparison."""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import ParameterValue, Signal, changed
from hydrotwin.models.language.provenance import lasting
from hydrotwin.records import NEAR, Record, as_needed, known_inputs, require, steps_over
from hydrotwin.records.between import settled, told
from hydrotwin.simulation.inputs import as_seen

from .child_process import run_child
from .fmu_process.master import FLOATS, inputs_of, is_scalar, late_outputs, outputs_of
from .fmu_settings import (
    AT_REST,
    LEFT_OUT,
    REDEFINED,
    at_rest,
    check_settable,
    constants_read,
    is_settable,
    own_value,
    unrecorded,
)
from .foreign import DIFFERENCE, Description, describe_fmu, kind_of
from .inside import made_from_inside

TIME_LIMIT = 120.0
MEAN = "the FMU takes no slopes, and each of its steps sees the mean"
LATE = "one sample late, for they follow an input at once and the FMU takes one step size only"
NAMED = 8  # variables in a sentence


class StartValueWarning(UserWarning):
    """An input that is not recorded keeps its start value; the text says which and what."""


@dataclass(frozen=True, eq=False)
class FmuBlock:
    """An FMU seen as a contender: it runs in a process of its own, in SI, under the names of the records.

    starts : start parameter -> output whose first sample it is set to.
    values : variables set before initialization, in the FMU's own units.
    named : the variables that were named as its outputs; () where those are its own.
    resting : inputs that keep one value, their default, in every run. notes : what a reader of its runs must know.
    """

    name: str
    path: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: tuple[ParameterValue, ...]
    description: Description = field(repr=False)
    starts: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    time_limit: float = TIME_LIMIT
    kind: str = "fmu"
    provenance: dict = field(default_factory=dict)
    named: tuple[str, ...] = ()
    resting: tuple[Signal, ...] = ()
    notes: tuple[str, ...] = ()

    def with_inputs(self, changes: Mapping[str, Mapping]) -> FmuBlock:
        """The same FMU whose inputs do something else between samples, see `changed`.

        Of an input that moves, an FMU that takes no slopes sees the mean over each step, and ``why`` says so.
        """
        other = replace(self, inputs=changed(self.inputs, changes, self.name))
        return other if self.description.slopes else replace(other, inputs=tuple(map(_seen_as_mean, other.inputs)))

    def with_values(self, values: Mapping[str, float | str]) -> FmuBlock:
        """The same FMU with other parameters, start values, and inputs that stay at one value in every run.

        Numbers are in SI, texts may have a unit ("35 bar"), be true or false, or the name of an item. Raises
        DeclarationError or UnitError for what the FMU does not have or cannot take.
        """
        for name in values:
            if name not in self.description.scales:
                settable = [v.name for v in self.description.source.modelVariables if is_settable(v)]
                raise DeclarationError(f"{self.path}: no variable '{name}'. {nearest(name, settable)}")
        check_settable(self.path, self.description.source, values)
        own = {name: own_value(name, given, self.description) for name, given in values.items()}
        inputs = {self.description.fmu_names[s.name]: s for s in (*self.inputs, *self.resting)}
        fixed = [_resting(s, own[n], n, self.description) for n, s in inputs.items() if n in own]
        rest = {n: v for n, v in own.items() if n not in inputs}
        shown = {n: np.polyval(self.description.scales[n], v) for n, v in rest.items() if not isinstance(v, str)}
        other = replace(
            self, values={**self.values, **rest},
            parameters=tuple(replace(p, value=float(shown.get(p.name, p.value))) for p in self.parameters),
            provenance=lasting(self.provenance, f"{', '.join(rest)} set") if rest else self.provenance,
        )  # fmt: skip
        return other.at_rest(fixed, [at_rest(s, (), given=True) for s in fixed])

    def fed_by(self, records: Sequence[Record]) -> FmuBlock:
        """The same FMU for these records: inputs that none of them has keep their start values, as ``notes`` say.

        An input that only some of them have stays one, so that the record without it is refused.
        """
        gone = unrecorded(self.inputs, self.description.starting, records)
        return self.at_rest(gone, [at_rest(s, records, given=False) for s in gone]) if gone else self

    def constants_read(self, constants: Mapping[str, str]) -> list[str]:
        """What is to be told of constants that recordings are given, see there."""
        return constants_read((*self.inputs, *self.resting), self.description, constants)

    def at_rest(self, signals: Sequence[Signal], notes: Sequence[str]) -> FmuBlock:
        """The same FMU whose inputs ``signals`` stay at their defaults."""
        names = {s.name for s in signals}
        kept = tuple(s for s in self.resting if s.name not in names)
        said = "; ".join(filter(None, (self.provenance.get(AT_REST), *notes)))
        return replace(
            self, inputs=tuple(s for s in self.inputs if s.name not in names), resting=(*kept, *signals),
            notes=(*self.notes, *notes), provenance={**self.provenance, **({AT_REST: said} if said else {})},
        )  # fmt: skip

    @property
    def content(self) -> tuple:
        """What its runs depend on."""
        with open(self.path, "rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        names, scales = self.description.record_names, self.description.scales
        return digest, self.inputs, self.outputs, self.starts, self.values, self.resting, names, scales

    def to_travel(self) -> FmuBlock:
        """The same for another process; whoever runs it there must have the file at the same path."""
        return replace(self, description=replace(self.description, source=None), provenance={})

    def free_run(self, record: Record) -> Record:
        """Outputs at ``record.time`` from the inputs; start parameters take the first sample of their output.

        A sampled block runs at its own period, as in `simulate`. An input that the record lacks keeps its start value,
        with a warning. Raises DataError or UnitError for one without or in another unit, SolveError when it fails.
        """
        self = settled(self._told(record), [record])
        period = self.description.period
        if period is None or len(record) < 2 or np.ptp(record.time) < period:
            return self._run(record)
        even = record.evenly()
        steps_over(np.ptp(even.time), period, self.name)
        if even.on_grid(period):
            own = replace(require(even, self.inputs, self.name), time=even.time[0] + period * np.arange(len(even)))
            return replace(self._run(own, even), time=record.time)
        grid = np.arange(even.time[0], even.time[-1] + (1 - NEAR) * period, period)  # to the end or beyond it
        held, until = [s.name for s in self.inputs if s.held], np.minimum(grid, even.time[-1])
        known = require(even, self.inputs, self.name).resample(times=until, hold=held)
        run = self._run(replace(known, time=grid), even)
        return replace(
            run, time=record.time, signals={n: np.interp(even.time, grid, v) for n, v in run.signals.items()}
        )

    def _run(self, record: Record, first: Record | None = None) -> Record:
        """One free run; ``first`` holds the measured outputs to start from, when ``record`` has inputs only."""
        return self._record(record, run_child(*self._job("run", record, first or record), self.time_limit)["y"])

    @property
    def modes(self) -> tuple[str, ...]:
        """What this FMU can be asked: one step only where every state can be set at the start."""
        return ("free run", "one step") if self.description.restarts else ("free run",)

    def states_set(self, record: Record) -> list[str]:
        """Starts that a measured output of ``record`` sets, one step ahead."""
        return [p for p, o in self.starts.items() if o in record.signals and np.isfinite(record[o]).any()]

    def one_step(self, record: Record) -> Record:
        """Outputs at ``record.time``, each from a restart at the sample before. DeclarationError where none can be."""
        if not self.description.restarts:
            raise DeclarationError(
                f"{self.name}: one-step prediction is not available for this FMU, its inner states cannot be set. "
                "Compare it in free run, or export the model with start parameters for all states (given=...)."
            )
        record = as_needed(record, self.outputs)
        job, arrays = settled(self._told(record), [record])._job("restart", record, record)
        pairs = {p: o for p, o in self.starts.items() if o in record}
        job |= {"states": list(self.description.states), "measured_starts": list(pairs)}
        told = np.reshape([self.in_own_units(p, record, o) for p, o in pairs.items()], (len(pairs), len(record))).T
        return self._record(record, run_child(job, arrays | {"measured": told}, self.time_limit)["y"])

    def _told(self, record: Record) -> FmuBlock:
        """`fed_by` for whoever has not asked for it: with a warning."""
        other = self.fed_by([record])
        for note in other.notes[len(self.notes) :]:
            warnings.warn(f"{self.name}: {note}", StartValueWarning, stacklevel=3)
        return other

    def starts_of(self, record: Record) -> dict[str, float]:
        """What a run of ``record`` sets before initialization, in the FMU's own units.

        An FMU of hydrotwin says which output measures which state: it starts where `simulate` does.
        """
        record, unknown = as_needed(record, self.outputs), self.unknown_at_first(record)
        known = {p: o for p, o in self.starts.items() if o in record and o not in unknown}
        return {**{p: float(self.in_own_units(p, record, o, slice(1))[0]) for p, o in known.items()}, **self.values}

    def unknown_at_first(self, record: Record) -> list[str]:
        """Outputs that say where a state starts that nobody gave, and of which the first sample is not known."""
        told = [o for p, o in self.starts.items() if p not in self.values and o in record]
        return [o for o in told if not np.isfinite(record[o][:1]).all()]

    def _job(self, task: str, record: Record, first: Record) -> tuple[dict, dict[str, np.ndarray]]:
        if len(record) < 2:
            raise DataError(f"{record.name}: an FMU needs two samples or more (got {len(record)}).")
        self._check_time_axis(record)
        record = known_inputs(require(record, self.inputs, self.name), self.inputs, self.name)
        self.require_outputs()
        self._require_possible()
        of = self.description.fmu_names
        seen = {s.name: as_seen(s, record.time, record[s.name]) for s in self.inputs}
        seen |= {s.name: np.full(len(record), s.default) for s in self.resting}
        record = record.with_signals(seen, {s.name: s.unit for s in self.resting}) if seen else record
        inputs = (*self.inputs, *self.resting)
        columns = [self.in_own_units(of[s.name], record, s.name) for s in inputs]
        job = {
            "task": task,
            "path": self.path,
            "interface": self.description.interface,
            "starts": self.starts_of(first),
            "inputs": [of[s.name] for s in inputs],
            "outputs": [of[s.name] for s in self.outputs],
            "linear": [of[s.name] for s in self.inputs if not s.held],
        }
        u = np.column_stack(columns) if columns else np.empty((len(record), 0))
        return job, {"time": record.time - record.begins, "u": u}  # as a model's, its time is 0 as a record begins

    def _check_time_axis(self, record: Record):
        steps = np.diff(record.time)
        if not self.description.any_step and np.ptp(steps) > 1e-6 * steps.mean():
            raise DataError(
                f"{record.name}: {self.name} takes one step size only, the record has steps from {steps.min():g} s to "
                f"{steps.max():g} s. Resample the record: record.resample(period=...)."
            )

    def _require_possible(self):
        """DeclarationError for an FMU of another system, or one whose clocks the importer must tick."""
        if self.description.elsewhere:
            raise DeclarationError(f"{self.path}: {self.description.elsewhere}.")
        if self.description.clocks:
            names = ", ".join(self.description.clocks[:NAMED])
            raise DeclarationError(
                f"{self.path}: the FMU has input clocks ({names}), and hydrotwin ticks none, so what belongs to them "
                "would stand still. Export it without clocks."
            )

    def require_outputs(self):
        """DeclarationError for an FMU that says nothing, with what could be named instead."""
        if self.outputs:
            return
        md = self.description.source
        states = [row.variable.derivative.name for row in md.derivatives if row.variable.derivative is not None]
        local = [v.name for v in md.modelVariables if v.causality == "local" and is_scalar(v) and v.name not in states]
        local = [*states, *local] or ["variable"]
        names, file = ", ".join(local[:NAMED]), Path(self.path).name
        more = f" and {len(local) - NAMED} more" if len(local) > NAMED else ""
        raise DeclarationError(
            f"{self.path}: the FMU has no outputs, so there is nothing to compare. Name local variables: "
            f"{file}:{local[0]} on the command line, read_fmu(..., outputs=['{local[0]}']) in Python. "
            f"It has: {names}{more}."
        )

    def in_own_units(self, variable: str, record: Record, name: str, rows: slice = slice(None)) -> np.ndarray:
        """Values of a column, as the FMU has them."""
        factor, offset = self.description.scales[variable]
        values = (np.asarray(record[name][rows]) - offset) / factor
        whole = self.description.whole.get(variable)
        if whole is None:
            return values
        source, no = record.source or record.name, f"is no {whole.kind}, which '{variable}' of {self.name} is"
        return whole.rounded(values, lambda k: f"{source}: row {k + 1} (t = {record.time[k]:g} s) of '{name}' {no}")

    def _record(self, record: Record, y: np.ndarray) -> Record:
        signals, units = {}, {}
        for k, s in enumerate(self.outputs):
            factor, offset = self.description.scales[self.description.fmu_names[s.name]]
            signals[s.name], units[s.name] = factor * y[:, k] + offset, s.unit
        return Record(record.time, signals, units, self.name)


def _seen_as_mean(signal: Signal) -> Signal:
    """The input with a word about what an FMU sees of it where it moves between samples."""
    why = signal.why.removesuffix(MEAN).rstrip("; ")
    return replace(signal, why=why if signal.held else "; ".join(filter(None, (why, MEAN))))


def read_fmu(
    path: str | os.PathLike,
    *,
    name: str | None = None,
    names: Mapping[str, str] = MappingProxyType({}),
    units: Mapping[str, str] = MappingProxyType({}),
    starts: Mapping[str, str] = MappingProxyType({}),
    values: Mapping[str, float] = MappingProxyType({}),
    outputs: Sequence[str] | None = None,
    interpolation: str | Mapping[str, str] | None = None,
    time_limit: float = TIME_LIMIT,
) -> FmuBlock:
    """Any FMU of FMI 2.0 or 3.0, Co-Simulation (preferred) or Model Exchange, as a contender.

    names : FMU variable -> name in the records; others keep their own.
    units : FMU variable -> unit, for FMUs that give none or a wrong one.
    starts : start parameter -> record name of the output it takes its value from; an FMU of hydrotwin brings its own.
    values : variables to set before initialization, in the FMU's units.
    outputs : FMU variables to predict, local ones too; its outputs by default.
    interpolation : what the inputs do between samples, "hold" or "linear", for all or by name in the records; the
        recordings show it where it is not given. Discrete inputs are held.

    Integer, Boolean and Enumeration inputs take what is whole to within 1e-6, else DataError says where it is not.
    Nothing of the FMU's code runs here: it runs in a child process with ``time_limit`` [s] at each free run.
    Raises DataError for a file that is not an FMU, DeclarationError for unknown variables.
    """
    description = describe_fmu(Path(path), names, units)
    known = list(description.scales)
    for variable in (*names, *units, *starts, *values, *(outputs or ())):
        if variable not in known:
            raise DeclarationError(f"{path}: no variable '{variable}'. {nearest(variable, known)}")
    md = description.source
    predicted = _outputs(path, md, outputs)
    check_settable(path, md, (*starts, *values))
    for variable in values:
        if whole := description.whole.get(variable):
            where = f"{path}: values: '{variable}' is no {whole.kind}, which it must be"
            whole.rounded(np.array([values[variable]], float), lambda _, said=where: said)
    block = FmuBlock(
        name=name or md.modelName, path=str(Path(path).absolute()),
        inputs=tuple(_signal(v, description) for v in inputs_of(md)),
        outputs=tuple(_signal(v, description) for v in predicted),
        parameters=tuple(_parameter(v, description) for v in md.modelVariables if _is_parameter(v)),
        description=description, starts={**description.measured, **description.starts, **starts},
        values=dict(values), time_limit=time_limit,
        provenance=_provenance(Path(path), description, [v.name for v in predicted]), named=tuple(outputs or ()),
        notes=_notes(description, outputs),
    )  # fmt: skip
    if isinstance(interpolation, str):
        interpolation = {s.name: interpolation for s in block.inputs if s.interpolation is None}
    return block.with_inputs(told(block.inputs, interpolation or {}, str(path)))


def _notes(description: Description, outputs: Sequence[str] | None) -> tuple[str, ...]:
    """What it has and no recording can hold."""
    fed = [f"no column can feed input {text}: its start value serves" for text in description.unfed]
    left = description.left_out if outputs is None else ()
    left = [f"outputs that hold no single number are left out: {', '.join(left)}"] if left else []
    return (*description.redefined, *fed, *left)


def _outputs(path, md, names: Sequence[str] | None) -> list:
    """The variables to predict."""
    if names is None:
        return outputs_of(md)
    known = {v.name: v for v in md.modelVariables}
    for name in names:
        if not is_scalar(known[name]):
            kind = kind_of(known[name])
            raise DeclarationError(f"{path}: '{name}' holds no single number (it is {kind}). Name another.")
    return [known[name] for name in names]


def _resting(signal: Signal, own: float, variable: str, description: Description) -> Signal:
    factor, offset = description.scales[variable]
    return replace(signal, default=factor * own + offset, interpolation="hold", chosen_by="model", why="")


def _signal(variable, description: Description) -> Signal:
    nominal = abs(float(variable.nominal) * description.scales[variable.name][0]) if variable.nominal else 1.0
    moving = variable.type in FLOATS and variable.variability != "discrete"
    return Signal(
        description.record_names[variable.name], description.units[variable.name], variable.description or "", nominal,
        interpolation=None if moving else "hold", chosen_by=None if moving else "model",
        default=description.starting.get(description.record_names[variable.name], 0.0),
        written_in=DIFFERENCE if variable.name in description.differences else "",
    )  # fmt: skip


def _is_parameter(variable) -> bool:
    return variable.causality == "parameter" and variable.type in FLOATS and variable.start not in (None, "")


def _parameter(variable, description: Description) -> ParameterValue:
    (factor, offset), own = description.scales[variable.name], float(str(variable.start).split()[0])
    unit, about = description.units[variable.name], variable.description or ""
    bounds = sorted(factor * float(said) + offset for said in (variable.min or "-inf", variable.max or "inf"))
    return ParameterValue(variable.name, factor * own + offset, unit, tuple(bounds), description=about)


def _provenance(path: Path, description: Description, outputs: Sequence[str]) -> dict:
    md = description.source
    facts = {"tool": md.generationTool, "date": md.generationDateAndTime, "guid": md.guid, "fmi": md.fmiVersion}
    if late := late_outputs(md, outputs, [v.name for v in inputs_of(md)]):
        facts[LATE] = ", ".join(late)
    facts |= {LEFT_OUT: ", ".join(description.left_out), REDEFINED: "; ".join(description.redefined)}
    facts |= {"units taken as 1": ", ".join(description.unknown_units)} | made_from_inside(path, outputs)
    return {k: v for k, v in facts.items() if v}
