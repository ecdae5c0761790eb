"""Run the experiments that an FMU carries along again, and read its record: rows for `check_fmu`."""

from __future__ import annotations

import posixpath
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError, HydrotwinError, SolveError, nearest
from hydrotwin.records import Record

from .experiments import CSV, SSV, TRANSIENT, TYPES, Experiment, Series, experiments_of, series_of
from .fmu_process.master import is_scalar
from .fmu_process.verdicts import FAIL, NOT_TRIED, PASS, REMARK
from .foreign import Description
from .inside import RECORD_FILE, Inside, added_files, changed_files, record_of
from .parameter_sets import in_own_unit, parameters_of
from .reader import FmuBlock, StartValueWarning, read_fmu
from .reference_files import parameters_digest
from .related import EXPERIMENT, RESULT, Related, content_of, missing, related_of

OTHERS = 1e-2  # of the range of an output: how far results of another solver may be apart, where a file does not say it
ENDED = ("ended the simulation", "discard")  # what a run says whose FMU asks to end
SAME = 1e-9  # of a run or a step: times that are closer are one
SHOWN = 4  # outputs and files in a sentence
FILES, RECORD, REPLAY = "related files", "record", "replay"

Row = tuple[str, tuple[str, str]]


@dataclass(frozen=True)
class Replay:
    """One output of an experiment that was run again.

    difference : the largest, relative to the range of the expected output; allowed : how large it may be.
    """

    experiment: str
    output: str
    difference: float
    allowed: float

    @property
    def passed(self) -> bool:
        """Whether it is small enough; NaN is not."""
        return bool(self.difference <= self.allowed)

    @property
    def margin(self) -> float:
        """The room that is left, as a share of what is allowed; negative outside."""
        return (self.allowed - self.difference) / self.allowed

    def __str__(self) -> str:
        word = "to spare" if self.passed else "TOO MUCH"
        return f"{self.output} {self.difference:.2g} of its range, {self.allowed:g} allowed ({word})"


def carried_rows(
    path: Path, description: Description, loads: bool, again: bool, limit: float
) -> tuple[list[Row], list]:
    """Rows on the related files, the record and, ``again``, on every experiment; and the `Replay` of every output.

    Without FMI-LS-REF inside there is no row. What is wrong is a remark: the layered standard is no rule of FMI; and a
    failure where it is asked to be run ``again``.
    """
    wrong = FAIL if again else REMARK
    try:
        related = related_of(path)
        if related is None:
            return [], []
        experiments, unread = _experiments(path, related)
    except DataError as reason:
        return [(FILES, (wrong, str(reason)))], []
    rows = [(FILES, _told(path, related, experiments))]
    rows += [(RECORD, _record(path, description, wrong))] if any(r.path == RECORD_FILE for r in related) else []
    rows += [(f"{REPLAY} {name}", (verdict or wrong, why)) for name, (verdict, why) in unread]
    if not again:
        return rows, []
    found: list[Replay] = []
    for one in (*experiments, *_results(related, experiments, description)):
        rows.append((f"{REPLAY} {one.name}", _replayed(path, one, loads, limit, found)))
    return rows, found


class _NotReadHere(DataError):
    """A format that hydrotwin does not read: no fault of the FMU."""


def _check_type(source: str, kind: str, known: Sequence[str]) -> None:
    if kind not in known:
        raise _NotReadHere(f"{source}: of type {kind}, and only {known[0]} is read here")


def _experiments(path: Path, related: Sequence[Related]) -> tuple[list[Experiment], list[Row]]:
    """The experiments of all files that hold some, and why others could not be read."""
    found, unread = [], []
    for one in related:
        if one.main_role == EXPERIMENT:
            try:
                _check_type(one.source, one.type, TYPES)
                found += experiments_of(content_of(path, one.path), one.path)
            except DataError as reason:
                verdict = NOT_TRIED if isinstance(reason, _NotReadHere) else ""
                unread.append((posixpath.basename(one.source), (verdict, str(reason))))
    return found, unread


def _results(related: Sequence[Related], known: Sequence[Experiment], description: Description) -> list[Experiment]:
    """Results of the FMU's default experiment that no experiments file has, such as those of the Reference FMUs."""
    used = {one.references for one in known}
    default = description.source.defaultExperiment
    step = float(default.stepSize) if default is not None and default.stepSize else None
    return [
        Experiment(posixpath.basename(one.path), references=one.path, step=step, analysis=RESULT)
        for one in related
        if one.main_role == RESULT and one.type == CSV and one.path and one.path not in used
    ]


def _told(path: Path, related: Sequence[Related], experiments: Sequence[Experiment]) -> tuple[str, str]:
    counts: dict[str, int] = {}
    for one in related:
        counts[one.role] = counts.get(one.role, 0) + 1
    listed = ", ".join(f"{n} {role}" for role, n in counts.items()) or "none"
    names = f"; experiments: {', '.join(e.name for e in experiments[:SHOWN])}" if experiments else ""
    more = f" and {len(experiments) - SHOWN} more" if len(experiments) > SHOWN else ""
    gone = missing(path, related)
    if gone:
        return REMARK, f"FMI-LS-REF: {listed}{names}{more}; not in the FMU: {', '.join(r.source for r in gone[:SHOWN])}"
    return PASS, f"FMI-LS-REF: {listed}{names}{more}"


def _record(path: Path, description: Description, wrong: str) -> tuple[str, str]:
    try:
        inside = record_of(path)
    except DataError as reason:
        return wrong, str(reason)
    if inside.contents != parameters_digest(description):
        return wrong, (
            "it no longer holds: parameter values of the FMU were edited after it was made. Export the model again, or "
            f"judge the FMU: hydrotwin compare --model FMU --validate REC. It said: {_sentences(inside)}"
        )
    if changed := changed_files(path, inside):
        return (
            wrong,
            f"files of the FMU were changed or are gone: {', '.join(changed[:SHOWN])}. Export the model again.",
        )
    if added := added_files(path, inside):
        return wrong, (
            f"files that it computes with were added after it was made: {', '.join(added[:SHOWN])}. The record "
            "knows nothing of what they compute. Export the model where they are needed."
        )
    failed = [one for one in inside.credibility.evidence if one.passed is False]
    return (wrong if failed else PASS), f"{inside.model}, by {inside.made_by}: {_sentences(inside)}"


def _sentences(inside: Inside) -> str:
    told = "; ".join(one.told for one in inside.credibility.evidence)
    return told or "nobody has fitted or judged the model as it is"


def _replayed(path: Path, one: Experiment, loads: bool, limit: float, found: list[Replay]) -> tuple[str, str]:
    """The verdict on one experiment; the outputs are added to ``found``."""
    if one.analysis not in (TRANSIENT, RESULT):
        return NOT_TRIED, f"a {one.analysis}, and only transient simulations are run again here"
    if one.start:
        return NOT_TRIED, f"it starts at {one.start:g} s, and runs begin at 0 here"
    if one.fault:
        return FAIL, f"cannot be run: {one.fault}. Take the FMU anew from where it was made."
    if not one.references:
        return NOT_TRIED, "it has no expected results"
    if not loads:
        return FAIL, "the FMU does not load here, see 'loads'"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StartValueWarning)  # what the stimuli lack keeps its start value
            rows, left_out = _run(path, one, limit)
    except _NotReadHere as reason:
        return NOT_TRIED, str(reason)
    except HydrotwinError as reason:
        return FAIL, f"cannot be run again: {reason}"
    found += rows
    missed = [str(row) for row in rows if not row.passed]
    if missed and one.analysis == RESULT and not one.stimuli and read_fmu(path).inputs:
        del found[-len(rows) :]
        return (
            NOT_TRIED,
            "results differ, but the FMU has inputs, and nothing says what they were",
        )
    told = "; ".join((missed or [str(max(rows, key=lambda row: row.difference))])[:SHOWN])
    rest = f"; not compared: {', '.join(left_out[:SHOWN])}" if left_out else ""
    return (FAIL if missed else PASS), f"{len(rows)} outputs, {'missed' if missed else 'furthest off'}: {told}{rest}"


def _run(path: Path, one: Experiment, limit: float) -> tuple[list[Replay], list[str]]:
    expected = _series(path, one, one.references)
    stimuli = _series(path, one, one.stimuli) if one.stimuli else None
    block, left_out = _block(path, one, expected, limit)
    _check_end(one, expected)
    ran = _ran(block, _record_to_run(block, expected, stimuli, one), expected)
    until = expected.time <= ran.time[-1]
    left_out = left_out if until.all() else ["the last result, at which the FMU asks to end", *left_out]
    at = np.searchsorted(ran.time, expected.time[until])
    allowed = one.agreement if one.agreement else OTHERS
    rows = []
    for signal in block.outputs:
        name = block.description.fmu_names[signal.name]
        own = in_own_unit(expected.columns[name], expected.units[name], name, expected.path, block.description)
        answer = block.in_own_units(name, ran, signal.name, at)
        rows.append(Replay(one.name, name, _difference(answer, own[until]), allowed))
    return rows, left_out


def _ran(block: FmuBlock, record: Record, expected: Series) -> Record:
    """Its run; to the result before the last where the FMU asks to end at the last, as it may."""
    try:
        return block.free_run(record)
    except SolveError as stopped:
        if len(expected.time) < 3 or not any(word in str(stopped) for word in ENDED):
            raise
        kept = record.time <= expected.time[-2]
        return block.free_run(
            Record(record.time[kept], {n: record[n][kept] for n in record}, record.units, record.name)
        )


def _series(path: Path, one: Experiment, name: str) -> Series:
    _check_type(name, one.types.get(name, CSV), (CSV,))
    return series_of(content_of(path, name), name)


def _block(path: Path, one: Experiment, expected: Series, limit: float) -> tuple[FmuBlock, list[str]]:
    """The FMU as it is to run, with the expected columns as its outputs; and those that hold no single number."""
    plain = read_fmu(path, time_limit=limit)
    variables = {v.name: v for v in plain.description.source.modelVariables}
    for name in (*expected.columns, *expected.others):
        _check_known(name, expected.path, variables)
    for name, cell in expected.others.items():
        if is_scalar(variables[name]):
            raise DataError(f"{expected.path}: '{name}' is '{cell:.40}' in row 2, which is no number.")
    scalar = [name for name in expected.columns if is_scalar(variables[name])]
    if not scalar:
        raise _NotReadHere(f"{expected.path}: it holds no single numbers to compare")
    _check_type(one.parameters, one.types.get(one.parameters, SSV), (SSV,))
    content = content_of(path, one.parameters) if one.parameters else None
    values = parameters_of(content, one.parameters, plain.description) if content else {}
    how = "hold" if one.held else "linear"
    block = read_fmu(path, outputs=scalar, values=values, interpolation=how, time_limit=limit)
    own = [plain.description.fmu_names[s.name] for s in plain.outputs]
    left_out = [n for n in (*expected.columns, *expected.others, *own) if n not in scalar]
    return replace(block, starts={}), list(dict.fromkeys(left_out))


def _check_known(name: str, where: str, variables: Mapping) -> None:
    if name not in variables:
        raise DataError(f"{where}: no variable '{name}' in the FMU. {nearest(name, variables)}")


def _check_end(one: Experiment, expected: Series) -> None:
    """A table that ends before its experiment was cut off."""
    if one.stop is not None and expected.time[-1] < one.stop - (one.step or 0.0) - 1e-9 * abs(one.stop):
        raise DataError(
            f"{one.references}: it ends at {expected.time[-1]:g} s and the experiment at {one.stop:g} s, so it was cut "
            "off. Take the FMU anew from where it was made."
        )


def _record_to_run(block: FmuBlock, expected: Series, stimuli: Series | None, one: Experiment) -> Record:
    """The inputs in SI on the times of the results and of the experiment's steps, on their own where the FMU takes any.

    An FMU that computes once in a communication step gives other results with longer ones.
    """
    grid = expected.time if one.held or not one.step else _stepped(expected.time, one.step)
    if stimuli is None:
        return Record(grid, {}, {}, expected.path)
    known = {v.name: v for v in block.description.source.modelVariables}
    inputs = {block.description.fmu_names[s.name]: s for s in block.inputs}
    for name in stimuli.columns:
        _check_known(name, stimuli.path, known)
        if name not in inputs:
            raise DataError(f"{stimuli.path}: '{name}' is no input of the FMU. {nearest(name, inputs)}")
    own = block.description.any_step and stimuli.time[-1] <= grid[-1]
    time = _merged(grid, stimuli.time) if own else grid
    signals = {}
    for name, values in stimuli.columns.items():
        factor, offset = block.description.scales[name]
        shown = factor * in_own_unit(values, stimuli.units[name], name, stimuli.path, block.description) + offset
        stays = one.held or inputs[name].held
        row = np.maximum(np.searchsorted(stimuli.time, time, side="right") - 1, 0)
        signals[inputs[name].name] = shown[row] if stays else np.interp(time, stimuli.time, shown)
    return Record(time, signals, {s.name: s.unit for s in block.inputs if s.name in signals}, stimuli.path)


def _stepped(time: np.ndarray, step: float) -> np.ndarray:
    """Times with those of the steps between them; as they are where they lie no further apart."""
    return time if np.diff(time).max() <= step * (1 + SAME) else _merged(time, np.arange(time[0], time[-1], step))


def _merged(time: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Both, without those of ``more`` that are one of ``time`` but for rounding."""
    near = time[np.minimum(np.searchsorted(time, more - SAME * np.ptp(time)), len(time) - 1)]
    return np.union1d(time, more[np.abs(near - more) > SAME * np.ptp(time)])


def _difference(found: np.ndarray, expected: np.ndarray) -> float:
    """The largest difference relative to the range, or to the size of what does not move."""
    span = float(np.ptp(expected)) or max(float(np.abs(expected).max()), 1e-12)
    return float(np.abs(found - expected).max() / span)
