"""Experiments that an FMU carries along: settings, parameters, stimuli, expected results; written and read.

The XML is the Experiments Format of the Modelica Association (MA-HS-Experiments, draft of 2026), as its text says and
its example shows; files with the settings in <TransientSimulation>, as in its newest schema, are read too. Time series
are CSV: a row of names, the first ``time``; then numbers, each in the unit of its FMU variable, or in one in brackets
behind the name. What the format does not say stands in an annotation of hydrotwin: how far results may be apart, and
that inputs are held between samples.
"""

from __future__ import annotations

import csv
import io
import posixpath
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hydrotwin.models.language.errors import DataError

from .related import local, path_of, xml_of, xml_text

TYPE = "application/x-ma-hs-experiments"
TYPES = (TYPE, "application/x-ma-ls-experiments")  # the second: of the appendix of FMI-LS-REF before it became a draft
CSV, SSV = "text/csv", "application/x-ssp-parameter-set"
TRANSIENT = "TransientSimulation"
ANALYSES = (
    TRANSIENT, "SteadyState", "ParameterOptimization", "SetPointOptimization", "SensitivityAnalysis",
    "TrajectoryOptimization", "Linearization",
)  # fmt: skip
TOOL = "hydrotwin"
_WORDS = {"true": 1.0, "false": 0.0}


@dataclass(frozen=True)
class Experiment:
    """One experiment; times in s. Files by their path in the FMU, "" where there is none.

    agreement : how far results may be apart, relative to the range of each; None where the file does not say it.
    held : whether inputs are known to be held between their samples. fault : why it cannot be run, in a sentence.
    """

    name: str
    stimuli: str = ""
    references: str = ""
    parameters: str = ""
    description: str = ""
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    analysis: str = TRANSIENT
    agreement: float | None = None
    held: bool = False
    types: Mapping[str, str] = field(default_factory=dict)
    fault: str = ""


def experiments_text(name: str, experiments: Sequence[Experiment], folder: str) -> str:
    """The file of a set of experiments that lies in ``folder``."""
    root = ET.Element("Experiments", name=name)
    for one in experiments:
        times = {"startTime": one.start, "stopTime": one.stop, "stepSize": one.step}
        said = {key: repr(float(value)) for key, value in times.items() if value is not None}
        element = ET.SubElement(root, "Experiment", {"name": one.name, "description": one.description} | said)
        parts = (
            ("Parameters", one.parameters, SSV),
            ("Stimuli", one.stimuli, CSV),
            ("References", one.references, CSV),
        )
        for tag, path, kind in parts:
            if path:
                ET.SubElement(element, tag, type=kind, source=posixpath.relpath(path, folder))
        notes = ET.SubElement(ET.SubElement(element, "Annotations"), "Annotation", type=TOOL)
        ET.SubElement(notes, "Replay", agreement=repr(one.agreement), inputs="held")
    return xml_text(root)


def experiments_of(content: bytes, where: str) -> tuple[Experiment, ...]:
    """The experiments of a file at the path ``where`` in an FMU. Raises DataError where it cannot be read."""
    root = xml_of(content, where)
    if local(root.tag) != "Experiments":
        raise DataError(f"{where}: no experiments (its root is '{local(root.tag)}', not 'Experiments').")
    return tuple(_experiment(e, where) for e in root if local(e.tag) == "Experiment")


def _experiment(element: ET.Element, where: str) -> Experiment:
    name = element.get("name", "unnamed")
    parts = {local(child.tag): child for child in element}
    analysis = next((tag for tag in parts if tag in ANALYSES), TRANSIENT)
    settings = {**element.attrib, **(parts[TRANSIENT].attrib if TRANSIENT in parts else {})}
    files = {tag: parts[tag] for tag in ("Parameters", "Stimuli", "References") if tag in parts}
    paths = {tag: path_of(e.get("source", ""), posixpath.dirname(where)) for tag, e in files.items()}
    notes = next((e for e in element.iter() if local(e.tag) == "Replay"), None)
    numbers = {
        key: _number(settings, key, f"{where}: experiment '{name}'") for key in ("startTime", "stopTime", "stepSize")
    }
    found = Experiment(
        name, paths.get("Stimuli", ""), paths.get("References", ""), paths.get("Parameters", ""),
        element.get("description", ""), *numbers.values(), analysis,
        None if notes is None else _number(notes.attrib, "agreement", f"{where}: experiment '{name}'"),
        notes is not None and notes.get("inputs") == "held",
        {paths[tag]: e.get("type", SSV if tag == "Parameters" else CSV) for tag, e in files.items()},
    )  # fmt: skip
    outside = next((files[tag].get("source", "") for tag in files if not paths[tag]), None)
    return replace(found, fault=f"'{outside}' is no file inside the FMU" if outside is not None else _fault(found))


def _fault(one: Experiment) -> str:
    """What makes its settings say nothing; "" where they do."""
    begin = one.start or 0.0
    if one.stop is not None and not begin < one.stop < np.inf:
        return f"it ends at {one.stop:g} s and begins at {begin:g} s"
    if one.step is not None and not 0.0 < one.step < np.inf:
        return f"its step is {one.step:g} s"
    if one.agreement is not None and not 0.0 < one.agreement < np.inf:
        return f"its agreement is {one.agreement:g}, and results are never as near as that, or always"
    return ""


def _number(settings: Mapping[str, str], key: str, where: str) -> float | None:
    text = settings.get(key)
    try:
        return None if text is None else float(text)
    except ValueError:
        raise DataError(f"{where}: '{key}' is no number (got '{text}'). Ask who made the FMU.") from None


@dataclass(frozen=True, eq=False)
class Series:
    """A table of numbers over time: time (n,) s, columns (n,) by name in their units ("" for that of the variable).

    others : columns that begin with something else, texts or arrays, with their first cell.
    """

    path: str
    time: np.ndarray
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    others: Mapping[str, str] = field(default_factory=dict)


def series_text(time: np.ndarray, columns: Mapping[str, np.ndarray]) -> str:
    """CSV that gives every bit of its numbers back."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["time", *columns])
    writer.writerows([repr(float(v)) for v in row] for row in zip(time, *columns.values(), strict=True))
    return out.getvalue()


def series_of(content: bytes, path: str) -> Series:
    """A table from CSV; of rows with the same time the last counts, as an importer reads it after an event.

    Raises DataError for a table that is cut off, a cell that is no number in a column of numbers, time that runs back.
    """
    try:
        rows = [row for row in csv.reader(io.StringIO(content.decode("utf-8-sig"))) if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: this is no CSV ({error}). Ask who made the FMU.") from None
    if len(rows) < 3 or rows[0][0].strip().lower() != "time":
        raise DataError(f"{path}: no table over time (a row of names, the first 'time', and two rows of numbers).")
    names = [_named(cell) for cell in rows[0][1:]]
    twice = next((name for k, (name, _) in enumerate(names) if name in dict(names[:k])), None)
    if twice is not None or not names:
        what = f"'{twice}' stands in two columns" if names else "no column but the time"
        raise DataError(f"{path}: {what}. Ask who made the FMU.")
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(rows[0]):
            raise DataError(
                f"{path}: row {number} has {len(row)} of {len(rows[0])} numbers, so the table was cut off or damaged. "
                "Take the FMU anew from where it was made."
            )
    time = _column(rows, 0, path)
    if (np.diff(time) < 0).any():
        raise DataError(f"{path}: time runs back after {time[int(np.argmax(np.diff(time) < 0))]:g} s.")
    last = np.r_[np.diff(time) > 0, True]
    others = {name: rows[1][k] for k, (name, _) in enumerate(names, 1) if _number_of(rows[1][k]) is None}
    columns = {name: _column(rows, k, path)[last] for k, (name, _) in enumerate(names, 1) if name not in others}
    return Series(path, time[last], columns, dict(names), others)


def _named(cell: str) -> tuple[str, str]:
    """Name and unit of ``name [unit]``; brackets that touch a name belong to it."""
    name, bracket, unit = cell.strip().partition(" [")
    return (name, unit.removesuffix("]")) if bracket and unit.endswith("]") else (cell.strip(), "")


def _column(rows: Sequence[Sequence[str]], k: int, path: str) -> np.ndarray:
    """The numbers of a column below its name."""
    values = [_number_of(row[k]) for row in rows[1:]]
    if None in values:
        at = values.index(None) + 2
        raise DataError(f"{path}: row {at} holds '{rows[at - 1][k]:.40}', which is no number. Ask who made the FMU.")
    if not np.isfinite(values).all():
        at = int(np.argmin(np.isfinite(values))) + 2
        raise DataError(f"{path}: row {at} of '{rows[0][k]}' holds no finite number. Ask who made the FMU.")
    return np.array(values)


def _number_of(text: str) -> float | None:
    try:
        return float(_WORDS.get(text.strip().lower(), text))
    except ValueError:
        return None
