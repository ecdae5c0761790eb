"""export_ssp: the models of a comparison as one SSP archive, all wired to the same inputs."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path

from hydrotwin.models.language.credibility import Credibility, with_made_from
from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import Signal, StateVariable
from hydrotwin.models.language.units import compatible
from hydrotwin.records import Record, write_record
from hydrotwin.simulation.block import Block

from .archive import file_names, write_archive
from .fmu_process.master import FLOATS, inputs_of, outputs_of
from .inside import RECORD_FILE
from .parameter_sets import own_unit
from .reader import FmuBlock, read_fmu
from .srmd import srmd_text
from .ssp_text import (
    NEWEST,
    VERSIONS,
    Component,
    Connection,
    Connector,
    Parameter,
    Unit,
    parameter_set,
    system_structure,
)
from .writer import export_fmu, tool_name


@dataclass(frozen=True, eq=False)
class SystemPart:
    """One model of a system.

    thing : a Model, FlatModel, Block or `FmuBlock`; anything else is left out.
    nominal : parameter -> value [SI] it was shipped with, where ``thing`` has others since.
    equations : what a learned block computes, in words, for the documentation of its FMU.
    credibility : of its model file, for the record of its FMU and the traceability of its values.
    starts : recording -> state -> start value [SI] that was estimated there; others start as measured.
    """

    name: str
    thing: object
    nominal: Mapping[str, float] = field(default_factory=dict)
    equations: str = ""
    credibility: Credibility | None = None
    starts: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def knows(self, state: StateVariable, record: Record) -> bool:
        """Whether a recording tells where a state starts: as estimated, or as measured."""
        return state.name in self.starts.get(record.name, {}) or state.measured_by in record.signals


@dataclass(frozen=True)
class SystemArchive:
    """What `export_ssp` wrote: the file, model -> its component, and a sentence for each model that is not in it."""

    path: Path
    components: Mapping[str, str]
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class _Edition:
    """The version of SSP, and the models whose FMU has a record inside."""

    version: str
    recorded: Set[str]


def export_ssp(
    parts: Sequence[SystemPart],
    path: str | os.PathLike,
    *,
    records: Sequence[Record] = (),
    title: str = "Comparison of models",
    platforms: Sequence[str] | None = None,
    version: str = VERSIONS[0],
) -> SystemArchive:
    """Write models side by side as an SSP archive.

    Every model is a component: models and blocks as Co-Simulation FMUs of FMI 2.0, an FMU as the file it is. The system
    has one input connector for each input, shared by all models that have it, and for each output of each model a
    connector ``<model>_<output>``: a dot would be read as the path to a connector of the component.

    Parameter sets, in ``resources/``: ``nominal.ssv`` has the shipped values of all physical models, ``identified.ssv``
    those found by identification; the second is bound where there is one. ``start_<recording>.ssv`` has the values with
    which the models start as they do in the comparison; the first recording's is bound. Start parameters stand for what
    all ``records`` measure, or what was estimated of all of them. The recordings lie beside them as CSV, inputs and
    measured outputs in SI.

    Identified values carry their interval of 95 % as an annotation.

    platforms : as of `export_fmu`, for the models that are exported.
    version : of SSP, "1.0" or "2.0". In 2.0 meta-data say where values come from: ``identified.srmd`` beside the
        parameter set (SSP Traceability), and of every component the record inside its FMU.

    The same arguments give the same bytes. Raises DeclarationError when no model can be a component, or two disagree on
    the unit of an input; SolveError when no compiler works.
    """
    if version not in VERSIONS:
        raise DeclarationError(f"{path}: no version '{version}' of SSP. {nearest(str(version), VERSIONS)}")
    names, left_out = _plain_names([p.name for p in parts], "model"), []
    files: dict[str, str | bytes] = {}
    fmus: dict[str, FmuBlock] = {}
    recorded: set[str] = set()
    with tempfile.TemporaryDirectory(prefix="hydrotwin-ssp-") as folder:
        for part in parts:
            reason = _reason_to_leave_out(part.thing)
            if reason:
                left_out.append(f"{part.name}: {reason}")
                continue
            fmu = _fmu_of(part, Path(folder) / f"{names[part.name]}.fmu", records, platforms)
            fmus[part.name] = fmu
            files[f"resources/{names[part.name]}.fmu"] = Path(fmu.path).read_bytes()
            recorded |= {part.name} if RECORD_FILE in file_names(Path(fmu.path)) else set()
    if not fmus:
        raise DeclarationError(
            f"{path}: no model of the comparison can be a component ({'; '.join(left_out) or 'none was given'}). "
            "Add a physical model, a learned block or an FMU."
        )
    inputs = _shared_inputs(fmus)
    bound = _put_parameter_sets(files, [p for p in parts if p.name in fmus], names, version)
    columns = dict.fromkeys([*inputs, *(s.name for fmu in fmus.values() for s in fmu.outputs)])
    starts = [(names[p.name], fmus[p.name], p.starts) for p in parts if p.name in fmus]
    bound += _put_records(files, records, list(columns), starts, version)
    files["SystemStructure.ssd"] = _structure(title, fmus, names, inputs, bound, records, _Edition(version, recorded))
    return SystemArchive(write_archive(path, files), {n: names[n] for n in fmus}, tuple(left_out))


def _reason_to_leave_out(thing) -> str:
    if isinstance(thing, (Block, FmuBlock)):
        return ""
    flat = getattr(thing, "flat", thing)
    if not hasattr(flat, "ode"):
        return "left out, it is no system: it has no equations to compute outputs with"
    if getattr(flat, "black_box", False):
        return "left out, an FMU with effects around it has no equations to write into an FMU of its own"
    return ""


def _fmu_of(part: SystemPart, path: Path, records: Sequence[Record], platforms) -> FmuBlock:
    if isinstance(part.thing, FmuBlock):
        return part.thing
    given = None
    if not isinstance(part.thing, Block) and records:
        states = getattr(part.thing, "flat", part.thing).states
        given = [s.name for s in states if all(part.knows(s, r) for r in records)]
    export_fmu(
        part.thing, path, given=given, platforms=platforms, equations=part.equations, credibility=part.credibility
    )
    return read_fmu(path)


def _plain_names(names: Sequence[str], otherwise: str) -> dict[str, str]:
    """Each name in letters, digits and ``_``: good for a file, and dots are free for paths."""
    found: dict[str, str] = {}
    for name in names:
        if name in found:
            raise DeclarationError(f"ssp: two are called '{name}'. Give one of them another name.")
        first = plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or otherwise
        count = 1
        while plain in found.values():
            count += 1
            plain = f"{first}_{count}"
        found[name] = plain
    return found


def _shared_inputs(fmus: Mapping[str, FmuBlock]) -> dict[str, Signal]:
    found: dict[str, tuple[str, Signal]] = {}
    for name, fmu in fmus.items():
        for signal in fmu.inputs:
            first, known = found.setdefault(signal.name, (name, signal))
            if not compatible(known.unit, signal.unit):
                raise DeclarationError(
                    f"ssp: the input '{signal.name}' is in {known.unit} for {first} and in {signal.unit} for {name}. "
                    "Models share an input of one dimension. Rename the input of one of them."
                )
    return {name: signal for name, (_, signal) in found.items()}


def _structure(title, fmus, names, inputs, bound, records, edition: _Edition) -> str:
    components, wires = [], []
    outside = [Connector(n, "input", unit=Unit(s.unit, s.unit)) for n, s in inputs.items()]
    taken = set(inputs)
    for model, fmu in fmus.items():
        element, description = names[model], fmu.description
        own = [_connector(v, "input", fmu) for v in inputs_of(description.source)]
        own += [_connector(v, "output", fmu) for v in outputs_of(description.source)]
        for connector in own:
            known = description.record_names[connector.name]
            if connector.kind == "input":
                wires.append(Connection(None, known, element, connector.name))
                continue
            name = f"{element}_{known}"
            while name in taken:
                name += "_"
            taken.add(name)
            unit = description.units[connector.name] if connector.unit else None
            outside.append(Connector(name, "output", unit=Unit(unit, unit) if unit else None))
            wires.append(Connection(element, connector.name, None, name))
        interface = "CoSimulation" if description.source.coSimulation is not None else "ModelExchange"
        said = model if model == fmu.name else f"{model}: {fmu.name}"
        record = RECORD_FILE if model in edition.recorded else ""
        components.append(Component(element, f"resources/{element}.fmu", interface, said, tuple(own), record))
    times = (float(records[0].time[0]), float(records[0].time[-1])) if records else None
    return system_structure(title, tool_name(), outside, components, wires, bound, times, edition.version)


def _connector(variable, kind: str, fmu: FmuBlock) -> Connector:
    """A variable of an FMU in the FMU's own unit; none where the unit is missing or has no meaning."""
    if variable.type not in FLOATS:
        return Connector(variable.name, kind, "Boolean" if variable.type == "Boolean" else "Integer")
    return Connector(variable.name, kind, unit=own_unit(variable.name, fmu.description))


def _vouching(part: SystemPart) -> Credibility | None:
    """What is said of the values of a part, as the record inside its FMU says it."""
    return part.credibility and with_made_from(part.credibility, getattr(part.thing, "flat", part.thing).provenance)


def _put_parameter_sets(files: dict, parts: Sequence[SystemPart], names: Mapping[str, str], version: str) -> list[str]:
    """Write nominal.ssv and identified.ssv, in 2.0 with identified.srmd; returns the one that applies."""
    nominal, identified = [], []
    for part in parts:
        if isinstance(part.thing, (Block, FmuBlock)):
            continue
        for p in getattr(part.thing, "flat", part.thing).parameters:
            name, unit = f"{names[part.name]}.{p.name}", Unit(p.unit, p.unit)
            nominal.append(Parameter(name, float(part.nominal.get(p.name, p.value)), unit))
            if part.nominal:
                identified.append(Parameter(name, float(p.value), unit, p.sigma))
    told = {names[p.name]: _vouching(p) for p in parts if p.nominal}
    known = {name: one for name, one in told.items() if one and one.evidence}
    traced = "identified.srmd" if known and version == NEWEST else ""
    bound = []
    for name, parameters, source in (("nominal", nominal, ""), ("identified", identified, traced)):
        if parameters:
            files[f"resources/{name}.ssv"] = parameter_set(name, tool_name(), parameters, version, source)
            bound = [f"resources/{name}.ssv"]
    if traced:
        content = files["resources/identified.ssv"]
        files[f"resources/{traced}"] = srmd_text("identified values", "identified.ssv", content, tool_name(), known)
    return bound


def _put_records(files: dict, records, columns: Sequence[str], starts: Sequence[tuple], version: str) -> list[str]:
    """Write the recordings and the start values they give; returns the start values of the first.

    starts : of every component its name, its FMU and what was estimated of it, as in `SystemPart`.
    """
    bound: list[str] = []
    for record, plain in zip(records, _plain_names([r.name for r in records], "recording").values(), strict=True):
        files[f"resources/{plain}.csv"] = _csv([n for n in columns if n in record.signals], record)
        values = [
            Parameter(f"{element}.{variable}", value, own_unit(variable, fmu.description))
            for element, fmu, estimated in starts
            for variable, value in _starts_of(fmu, record, estimated.get(record.name, {})).items()
        ]
        if values:
            path = f"resources/start_{plain}.ssv"
            files[path] = parameter_set(f"start of {record.name}", tool_name(), values, version)
            bound = bound or [path]
    return bound


def _starts_of(fmu: FmuBlock, record: Record, estimated: Mapping[str, float]) -> dict[str, float]:
    """Start parameters of an FMU for a recording; estimated : state -> value [SI], the unit of FMUs made here."""
    known = {v.name for v in fmu.description.source.modelVariables}
    own = {f"{state}.start": value for state, value in estimated.items() if f"{state}.start" in known}
    return fmu.starts_of(record) | own


def _csv(columns: Sequence[str], record: Record) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        chosen = {n: record[n] for n in columns}
        write_record(Record(record.time, chosen, {n: record.units[n] for n in columns}, record.name), path)
        return path.read_text(encoding="utf-8")
