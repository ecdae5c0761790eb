"""What the standard requires of a modelDescription.xml beyond what its schema says; nothing of the FMU's code runs."""

from __future__ import annotations

import re
import zipfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import fmpy
from fmpy.model_description import ModelDescription
from lxml import etree

from .archive import read_file
from .fmu_process.master import FLOATS
from .fmu_process.verdicts import FAIL, NOT_TRIED, PASS, REMARK
from .standard import paragraph

SHOWN = 3  # findings of one kind in a sentence
DESCRIPTION = "modelDescription.xml"
HUGE = etree.XMLParser(huge_tree=True, resolve_entities=False)

_SET = ("exact",)
_FOUND = ("calculated", "approx")
_FREE = ("calculated", "exact", "approx")
COMBINATIONS = {
    ("structuralParameter", "fixed"): _SET, ("structuralParameter", "tunable"): _SET,
    ("parameter", "fixed"): _SET, ("parameter", "tunable"): _SET,
    ("calculatedParameter", "fixed"): _FOUND, ("calculatedParameter", "tunable"): _FOUND,
    ("input", "discrete"): _SET, ("input", "continuous"): _SET,
    ("output", "constant"): _SET, ("output", "discrete"): _FREE, ("output", "continuous"): _FREE,
    ("local", "constant"): _SET, ("local", "fixed"): _FOUND, ("local", "tunable"): _FOUND,
    ("local", "discrete"): _FREE, ("local", "continuous"): _FREE,
    ("independent", "continuous"): (None,),
}  # fmt: skip
"""(causality, variability) -> what initial may be, as FMPy fills in the defaults."""

_WORD = r"[A-Za-z_][A-Za-z_0-9]*"
_QUOTED = r"""'(?:[A-Za-z_0-9!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]|\\['"?\\abfnrtv])+'"""
_PART = rf"(?:{_WORD}|{_QUOTED})(?:\[\d+(?:,\d+)*\])?"
_PATH = rf"{_PART}(?:\.{_PART})*"
STRUCTURED = re.compile(rf"{_PATH}|der\({_PATH}(?:,\d+)?\)")
"""A name of the convention "structured", whole."""


@dataclass
class Findings:
    """What one row found: broken rules, and what is only worth knowing."""

    broken: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def verdict(self, good: str) -> tuple[str, str]:
        """Verdict and detail; ``good`` where nothing was found."""
        told = [*self.broken, *self.remarks]
        verdict = FAIL if self.broken else REMARK if self.remarks else PASS
        return verdict, "; ".join(told) or good


def description_rows(path: Path, md: ModelDescription) -> dict[str, tuple[str, str]]:
    """Row -> verdict and detail."""
    return {
        "schema": _schema(path, md).verdict("the schema of the standard is met"),
        "variables": _variables(md).verdict(f"{len(md.modelVariables)} variables, attributes and start values legal"),
        "names": _names(md).verdict(f"unique, of the convention '{md.variableNamingConvention or 'flat'}'"),
        "model structure": _structure(md).verdict("complete, with every entry where it belongs"),
    }


def unreadable(path: Path, reason: str) -> tuple[str, str, str]:
    """Verdict, detail and rule of an FMU that cannot be read: a rule that it breaks, else the reader's own limits."""
    try:
        root = etree.fromstring(read_file(path, DESCRIPTION), HUGE)
    except (KeyError, OSError, zipfile.BadZipFile, etree.XMLSyntaxError):
        return FAIL, reason, "FMI 2.0.5, 2.3 FMU Distribution; FMI 3.0.2, 2.5 FMU Distribution"
    version = root.get("fmiVersion", "")
    if not version.startswith(("2", "3")):
        return NOT_TRIED, reason, ""
    if errors := _schema_errors(root, version):
        return FAIL, _few("", errors), paragraph("schema", version)
    variables = root.iterfind("ModelVariables/*")
    pairs = {v.get("name"): (v.get("causality", "local"), v.get("variability")) for v in variables}
    if illegal := [f"{n} ({c}, {v})" for n, (c, v) in pairs.items() if v and (c, v) not in COMBINATIONS]:
        told = _few("causality and variability that do not go together: ", illegal)
        return FAIL, told, paragraph("variables", version)
    return NOT_TRIED, reason, ""


def _schema_errors(root, version: str) -> list[str]:
    edition = f"fmi{version[0]}"
    folder = Path(fmpy.__file__).parent / "schema" / edition
    schema = etree.XMLSchema(file=str(folder / f"{edition}ModelDescription.xsd"))
    return [] if schema.validate(root) else [f"line {e.line}: {e.message}" for e in schema.error_log]


def _schema(path: Path, md: ModelDescription) -> Findings:
    errors = _schema_errors(etree.fromstring(read_file(path, DESCRIPTION), HUGE), md.fmiVersion)
    return Findings([_few("", errors)] if errors else [])


def _variables(md: ModelDescription) -> Findings:
    found, variables = Findings(), md.modelVariables
    whole = [v.name for v in variables if v.type not in FLOATS and v.variability == "continuous"]
    illegal = [
        f"{v.name} ({v.causality}, {v.variability}, initial {v.initial or 'none'})" for v in variables
        if v.initial not in COMBINATIONS.get((v.causality, v.variability), ())
    ]  # fmt: skip
    needed = [v.name for v in variables if _needs_start(v) and v.start is None]
    forbidden = [v.name for v in variables if v.start and (v.initial == "calculated" or v.causality == "independent")]
    found.broken += _told("only real variables may be continuous", whole)
    found.broken += _told("causality, variability and initial that do not go together", illegal)
    found.broken += _told("a start value is required", needed)
    found.broken += _told("a start value is forbidden for what is calculated or independent", forbidden)
    if md.fmiVersion.startswith("3"):
        references = Counter(v.valueReference for v in variables if not v.alias)
        double = [v.name for v in variables if not v.alias and references[v.valueReference] > 1]
        found.broken += _told("one value reference for several variables", double)
        if sum(v.causality == "independent" for v in variables) != 1:
            found.broken.append("there must be exactly one independent variable")
    found.broken += _told("units that are used and not defined", _undefined_units(md))
    unitless = [v.name for v in variables if v.displayUnit and not _unit_of(v)]
    found.broken += _told("a display unit without a unit", unitless)
    strange = _told("display units that are not defined", _undefined_display_units(md))
    if md.fmiVersion.startswith("3"):
        found.broken += strange
    else:
        found.remarks += strange  # FMI 2 has them ignored
    return found


def _needs_start(variable) -> bool:
    return variable.type != "Clock" and (variable.initial in ("exact", "approx") or variable.causality == "input")


def _unit_of(variable) -> str | None:
    return variable.unit or (variable.declaredType.unit if variable.declaredType is not None else None)


def _undefined_units(md: ModelDescription) -> list[str]:
    defined = {unit.name for unit in md.unitDefinitions}
    used = {unit: v.name for v in reversed(md.modelVariables) if (unit := _unit_of(v))}
    return [f"'{unit}' of {name}" for unit, name in used.items() if unit not in defined]


def _undefined_display_units(md: ModelDescription) -> list[str]:
    defined = {(unit.name, shown.name) for unit in md.unitDefinitions for shown in unit.displayUnits}
    used = {(_unit_of(v), v.displayUnit): v.name for v in reversed(md.modelVariables) if v.displayUnit and _unit_of(v)}
    return [f"'{s}' of {name}" for (unit, s), name in used.items() if s != unit and (unit, s) not in defined]


def _names(md: ModelDescription) -> Findings:
    found, names = Findings(), [v.name for v in md.modelVariables]
    found.broken += _told("names that are not unique", [n for n, count in Counter(names).items() if count > 1])
    if md.variableNamingConvention == "structured":
        strange = [n for n in names if not STRUCTURED.fullmatch(n)]
        found.broken += _told("no names of the convention 'structured' that is declared", strange)
    else:
        found.broken += _told("names with a line break or a tab", [repr(n) for n in names if re.search(r"[\t\r\n]", n)])
    return found


def _structure(md: ModelDescription) -> Findings:
    found, is3 = Findings(), md.fmiVersion.startswith("3")
    outputs = {v.name for v in md.modelVariables if v.causality == "output" and not v.alias}
    listed = Counter(u.variable.name for u in md.outputs)
    found.broken += _told("outputs that are not listed", outputs - set(listed))
    found.broken += _told("listed as outputs and none", set(listed) - outputs)
    found.broken += _told("outputs listed twice", [n for n, count in listed.items() if count > 1])
    rates = [u.variable for u in md.derivatives]
    found.broken += _told("listed as derivatives and of no state", [v.name for v in rates if v.derivative is None])
    for name, unknowns in (("outputs", md.outputs), ("derivatives", md.derivatives), ("unknowns", md.initialUnknowns)):
        found.broken += _told(f"{name} whose dependenciesKind and dependencies differ in number", _unpaired(unknowns))
    states = [v.derivative for v in rates if v.derivative is not None]
    allowed = {*outputs, *(v.name for v in (*rates, *states))}
    allowed |= {v.name for v in md.modelVariables if v.causality == "calculatedParameter" or (is3 and v.clocks)}
    initial = Counter(u.variable.name for u in md.initialUnknowns)
    known = [u.variable.name for u in md.initialUnknowns if u.variable.initial == "exact"]
    known += [n for n in initial if n not in allowed and n not in known]
    found.remarks += _told("among the InitialUnknowns and known at the start", known)
    found.broken += _told("initial unknowns listed twice", [n for n, count in initial.items() if count > 1])
    missing = [n for n in _unknown_at_start(md, states, rates) if n not in initial]
    found.remarks += _told("calculated at the start and not among the InitialUnknowns", missing)
    return found


def _unknown_at_start(md: ModelDescription, states, rates) -> list[str]:
    """What the standard counts as an unknown of initialization mode, in the order of the variables."""
    moving = {v.name for v in (*states, *rates)}
    return [
        v.name for v in md.modelVariables
        if v.causality == "calculatedParameter"
        or (v.initial in _FOUND and not v.alias and not v.clocks and (v.causality == "output" or v.name in moving))
    ]  # fmt: skip


def _unpaired(unknowns) -> list[str]:
    pairs = [(u, u.dependencies, u.dependenciesKind) for u in unknowns if u.dependenciesKind is not None]
    return [u.variable.name for u, on, kinds in pairs if on is None or len(on) != len(kinds)]


def _told(what: str, names: Iterable[str]) -> list[str]:
    names = list(names)
    return [_few(f"{what}: ", names)] if names else []


def _few(head: str, items: list[str]) -> str:
    more = f" and {len(items) - SHOWN} more" if len(items) > SHOWN else ""
    return head + ", ".join(items[:SHOWN]) + more
