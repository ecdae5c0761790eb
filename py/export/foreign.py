"""What the modelDescription.xml of any FMU says, in the terms of this project."""

from __future__ import annotations

import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fmpy import read_model_description
from fmpy.model_description import ModelDescription

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.units import DELTA

from .archive import read_file
from .fmu_process.master import inputs_of, interpolates, is_scalar, unfed_of
from .fmu_process.trial import start_of
from .rules import read_or_say
from .rules.archive_rules import why_not_here
from .rules.declared import Declared
from .unit_meanings import Meaning, is_difference, meaning_of, redefined
from .whole_numbers import Whole, whole_of

DESCRIPTION = "modelDescription.xml"
DIFFERENCE = f"{DELTA}degC"  # what a difference of temperatures is declared in
RELATIVE = "relativeQuantity"  # of a variable: it is a difference, and the zero of its unit does not count (FMI 2.2.7)


@dataclass(frozen=True, eq=False)
class Description:
    """Names, units and abilities of an FMU.

    scales : FMU variable -> (factor, offset), ``SI = factor * value + offset``. redefined : units that the FMU defines
        otherwise than their names say, in sentences. differences : variables that are differences of temperatures.
    starts : start parameter -> record name of the output whose first sample it takes.
    measured : the same of every start parameter that an output measures.
    states : state variables that have a ``<state>.start`` parameter; restarts: those are all there are.
    any_step : whether it takes communication steps of any size. slopes : whether its inputs may move during a step.
    period : s between the moves of a sampled block of hydrotwin, None for everything else.
    whole : the Integer, Boolean and Enumeration variables, and what each can take.
    starting : record name of an input -> its start value in SI.
    unfed : inputs that no column can feed, with their start values; clocks : input clocks; left_out : outputs that hold
        no single number; elsewhere : why it cannot run on this machine. All in words.
    """

    source: ModelDescription
    interface: str
    any_step: bool
    record_names: Mapping[str, str]
    units: Mapping[str, str]
    scales: Mapping[str, tuple[float, float]]
    unknown_units: tuple[str, ...]
    starts: Mapping[str, str]
    states: tuple[str, ...]
    restarts: bool
    period: float | None = None
    whole: Mapping[str, Whole] = field(default_factory=dict)
    measured: Mapping[str, str] = field(default_factory=dict)
    slopes: bool = True
    starting: Mapping[str, float] = field(default_factory=dict)
    unfed: tuple[str, ...] = ()
    clocks: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    elsewhere: str = ""
    redefined: tuple[str, ...] = ()
    differences: frozenset[str] = frozenset()

    @property
    def fmu_names(self) -> dict[str, str]:
        """Record name -> FMU variable."""
        return {record: fmu for fmu, record in self.record_names.items()}


def describe_fmu(path: Path, names: Mapping[str, str], units: Mapping[str, str]) -> Description:
    """Read the description; nothing of the FMU's code runs. DataError when the file is not an FMU of FMI 2 or 3."""
    md = read_description(path)
    if md.coSimulation is None and md.modelExchange is None:
        raise DeclarationError(
            f"{path}: it offers neither Co-Simulation nor Model Exchange. Ask its maker for one of the two."
        )
    meanings = {v.name: meaning_of(v, md, units.get(v.name)) for v in md.modelVariables}
    starts, measured, complete, period = _annotated(path)
    outputs = [v for v in md.modelVariables if v.causality == "output"]
    plain = [p.removesuffix(".start") for p in starts] if complete else []
    states = tuple(n if n in meanings and not _is_output(md, n) else f"state.{n}" for n in plain)
    return Description(
        source=md,
        interface="CoSimulation" if md.coSimulation is not None else "ModelExchange",
        any_step=md.coSimulation is None or bool(md.coSimulation.canHandleVariableCommunicationStepSize),
        slopes=md.coSimulation is None or interpolates(md),
        record_names={v.name: names.get(v.name, v.name) for v in md.modelVariables},
        units={n: m.si for n, m in meanings.items()},
        scales={n: (m.factor, m.offset) for n, m in meanings.items()},
        unknown_units=tuple(n for n, m in meanings.items() if m.guessed),
        redefined=redefined(meanings),
        differences=frozenset(
            v.name
            for v in md.modelVariables
            if meanings[v.name].si == "K" and (is_difference(v) or units.get(v.name, "").startswith(DELTA))
        ),
        starts={p: names.get(o, o) for p, o in starts.items() if o},
        measured={p: names.get(o, o) for p, o in measured.items() if o},
        states=states,
        restarts=complete and md.coSimulation is not None,
        period=period,
        whole={v.name: w for v in md.modelVariables if (w := whole_of(v)) is not None},
        starting={names.get(v.name, v.name): s for v in inputs_of(md) if (s := _start(v, meanings)) is not None},
        unfed=tuple(f"{v.name} ({kind_of(v)}, '{v.start}')" for v in unfed_of(md) if v.type != "Clock"),
        clocks=tuple(v.name for v in unfed_of(md) if v.type == "Clock"),
        elsewhere=why_not_here(path),
        left_out=tuple(f"{v.name} ({kind_of(v)})" for v in outputs if not is_scalar(v)),
    )


def _start(variable, meanings: Mapping[str, Meaning]) -> float | None:
    """The start value of an input in SI."""
    one = meanings[variable.name]
    return None if variable.start in (None, "") else one.factor * start_of(variable) + one.offset


def kind_of(variable) -> str:
    """What a variable that holds no single number is, in words."""
    kind = f"an array of {variable.type}" if variable.dimensions else variable.type
    return f"{kind} of a clock" if variable.clocks else kind


def read_description(path: Path) -> ModelDescription:
    """FMPy's model description, unvalidated. DataError when there is none to read."""
    if not path.exists():
        raise DataError(f"{path}: no such file. Give the path of an .fmu.")
    try:
        md = read_model_description(str(path), validate=False)
    except Exception as failure:
        declared = read_or_say(path)
        if not isinstance(declared, Declared):
            raise DataError(declared[1]) from None
        raise DataError(
            f"{path}: its modelDescription.xml cannot be used ({type(failure).__name__}: {failure}). Which rule of the "
            f"standard it breaks says: hydrotwin check {path.name}"
        ) from None
    if not md.fmiVersion.startswith(("2", "3")):
        raise DataError(f"{path}: FMI {md.fmiVersion} is not supported. FMI 2.0 and 3.0 are.")
    _say_differences(md, read_file(path, DESCRIPTION))
    return md


def _say_differences(md: ModelDescription, text: bytes) -> None:
    """Which variables say themselves whether they are differences; FMPy 0.3.27 reads that of types alone."""
    if RELATIVE.encode() not in text:
        return
    said = {}
    for variable in ET.fromstring(text).iterfind("./ModelVariables/*"):
        own = variable.find("Real") if variable.tag == "ScalarVariable" else variable
        if own is not None and own.get(RELATIVE) is not None:
            said[variable.get("name")] = own.get(RELATIVE) in ("true", "1")
    for variable in (v for v in md.modelVariables if v.name in said):
        variable.relativeQuantity = said[variable.name]


def _is_output(md: ModelDescription, name: str) -> bool:
    return any(v.name == name and v.causality != "local" for v in md.modelVariables)


def _annotated(path: Path) -> tuple[dict[str, str], dict[str, str], bool, float | None]:
    """What an FMU of hydrotwin says of itself: start parameters and what measures them, whether they are all there is,
    its period."""
    try:
        text = read_file(path, DESCRIPTION)
        if b"hydrotwin" not in text:
            return {}, {}, False, None
        root = ET.fromstring(text)
    except (OSError, KeyError, zipfile.BadZipFile, ET.ParseError):
        return {}, {}, False, None
    places = (
        "./VendorAnnotations/Tool[@name='hydrotwin']/Starts",
        "./Annotations/Annotation[@type='hydrotwin']/Starts",
    )
    listed = next((found for place in places if (found := root.find(place)) is not None), None)
    if listed is None:
        return {}, {}, False, None
    rows = listed.findall("Start")
    starts, measured = ({e.get("parameter"): e.get(a) or "" for e in rows} for a in ("output", "measured"))
    period = listed.get("period")
    return starts, measured, listed.get("complete") == "true", float(period) if period else None
