"""check_fmu: is this FMU good? One row for each thing that was tried, ours or anybody's, judged by the standard."""

from __future__ import annotations

import itertools
import os
import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError, UnitError
from hydrotwin.records import Record, read_record
from hydrotwin.records.between import told

from .archive import file_names, read_file
from .check_plan import SECOND, offers_both, plan_of, tried_rows
from .fmu_process.master import FLOATS, inputs_of, outputs_of
from .fmu_process.verdicts import FAIL, GOOD, NOT_TRIED, PASS, REMARK
from .foreign import Description, describe_fmu
from .reader import FmuBlock, read_fmu
from .related import MANIFEST
from .replay import FILES, REPLAY, Replay, carried_rows
from .rules import read_or_say, rule_rows
from .rules.declared import Declared
from .standard import paragraph
from .unit_meanings import unit_name
from .writer import AGREEMENT, OTHER_SOLVER, REFERENCE_FILE


@dataclass(frozen=True)
class CheckRow:
    """One thing tried.

    verdict : "pass"; "FAIL", a required rule is broken; "remark", worth knowing and no rule; "not tried", and why.
    rule : edition and section of the standard behind it, "" where there is none.
    """

    name: str
    verdict: str
    detail: str
    rule: str = ""

    @property
    def passed(self) -> bool | None:
        """True, False where a rule is broken, None where nothing can be said for or against."""
        return {PASS: True, FAIL: False}.get(self.verdict)


@dataclass(frozen=True)
class Check:
    """What was found out about an FMU; ``replays`` : every output of the experiments inside that were run again."""

    path: str
    rows: tuple[CheckRow, ...]
    replays: tuple[Replay, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether no rule is broken."""
        return not self.failures

    @property
    def failures(self) -> tuple[CheckRow, ...]:
        """The rows in which a rule is broken."""
        return tuple(row for row in self.rows if row.verdict == FAIL)

    @property
    def summary(self) -> str:
        """One sentence."""
        counts = Counter(row.verdict for row in self.rows)
        broken = f"{counts[FAIL]} rule{'s' if counts[FAIL] > 1 else ''} broken"
        verdict = f"FAIL: {broken}" if counts[FAIL] else "no rule broken"
        return f"{verdict}; {counts[PASS]} passed, {counts[REMARK]} remarks, {counts[NOT_TRIED]} not tried"

    @property
    def told(self) -> list[tuple[str, str, str]]:
        """Verdict, names and detail with its rule; neighbours that were not tried for one reason are one."""
        groups = itertools.groupby(self.rows, lambda row: row.detail if row.verdict == NOT_TRIED else row)
        found = [list(rows) for _, rows in groups]
        return [(r[0].verdict, ", ".join(row.name for row in r), _with_rule(r[0])) for r in found]

    def __getitem__(self, name: str) -> CheckRow:
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(name)

    def __str__(self) -> str:
        width = max((len(row.name) for row in self.rows), default=0)
        lines = [f"{verdict:>9}  {names:<{width}}  {detail}" for verdict, names, detail in self.told]
        return "\n".join([self.path, *lines, self.summary])


def _with_rule(row: CheckRow) -> str:
    return f"{row.detail} [{row.rule}]" if row.rule else row.detail


def check_fmu(
    path: str | os.PathLike,
    reference: Record | None = None,
    *,
    time_limit: float = 60.0,
    interpolation: Mapping[str, str] | None = None,
    replay: bool = False,
) -> Check:
    """Check an FMU of FMI 2 or 3, whoever made it, against the standard.

    Read without running its code: the schema and the encoding, interfaces, units, types, variables and whatever they
    refer to, names, model structure, sources, terminals, files, platforms. Run in a child process with a limit of
    ``time_limit`` [s] for each probe: loading, a short run, reading every variable, the start values that the binary
    has, reset, a second instance, saving the state, intermediate update and early return, declared dependencies against
    perturbed inputs, directional derivatives, and what it does with NaN, an unknown variable and a step too early.
    Of Model Exchange: a run with FMPy's CVode, nominal values, the number and the order of states, stale answers after
    setting time, states and inputs in any order, reset, saving the state, dependencies, directional derivatives and
    NaN. An FMU with both is tried as both.
    Other programs take it as well: FMPy's master for each kind, libcosimpy (FMI 2 Co-Simulation) and CasADi's importer
    (FMI 3 Model Exchange), where they are installed.
    With a ``reference`` record, or one inside the FMU, its inputs are replayed and the outputs compared, held between
    samples unless ``interpolation`` says "linear" for an input by name; they agree
    when they differ by less than 1e-6 of each signal's range (1e-2 in Model Exchange where there is both).
    Files that the FMU carries along by FMI-LS-REF are told, with the record of hydrotwin where it has one. With
    ``replay`` every experiment among them is run again and judged by what it says, or by 1e-2 of the range where it
    says nothing; what stands in the way, and a record that no longer holds, then fails.

    A row fails only where a required rule of the standard is broken, which it names, or where the numbers differ from
    the reference. Advice, what no importer may do, and what other programs make of it are remarks. What cannot be tried
    on this machine or with this FMU says why. Raises DataError when there is no file, or the ``reference`` cannot be
    replayed; DeclarationError where there is nothing to ``replay``.
    """
    path = Path(path)
    if not path.exists():
        raise DataError(f"{path}: no such file. Give the path of an .fmu.")
    declared = read_or_say(path)
    if not isinstance(declared, Declared):
        return Check(str(path), (CheckRow("readable", *declared),))
    if replay and MANIFEST not in file_names(path):
        raise DeclarationError(_nothing_to_replay(path, "it carries no experiments along"))
    rules = rule_rows(path, declared)
    read = _described(path, any(verdict == FAIL for _, (verdict, _) in rules))
    found = [("readable", read if isinstance(read, tuple) else (PASS, _summary(read))), *rules]
    replays: list[Replay] = []
    if not isinstance(read, tuple):
        found.append(("units", _units(read)))
        found += tried_rows(path, plan_of(read.source), read.elsewhere, time_limit)
        found += _references(path, read, dict(found), reference, time_limit, interpolation or {})
        carried, replays = carried_rows(path, read, dict(found)["loads"][0] in GOOD, replay, time_limit)
        found += carried
    if replay and not any(name.startswith(REPLAY) and rest[0] != NOT_TRIED for name, rest in found):
        raise DeclarationError(_nothing_to_replay(path, _why_not(found)))
    return Check(str(path), tuple(_row(name, *rest, declared.version) for name, rest in found), tuple(replays))


def _why_not(found: list[tuple[str, tuple[str, str]]]) -> str:
    """Why none of its experiments can be run again."""
    rows = {name: why for name, (_, why) in found}
    told = [f"{name.removeprefix(REPLAY).strip()}: {why}" for name, why in rows.items() if name.startswith(REPLAY)]
    return "; ".join(told) or rows.get(FILES) or rows["readable"]


def _nothing_to_replay(path: Path, why: str) -> str:
    return (
        f"{path}: there is nothing to run again ({why}). An FMU that hydrotwin exports has a smoke test inside; with "
        "--experiment REC recordings too. Or give a recording: --reference REC."
    )


def _described(path: Path, broken: bool) -> Description | tuple[str, str]:
    """What the description says in our terms; else why it cannot be read so, which is no fault of its own."""
    try:
        return describe_fmu(path, {}, {})
    except DeclarationError as reason:
        return NOT_TRIED, str(reason)
    except Exception as failure:
        why = "what is FAIL below stands in the way" if broken else f"FMPy or hydrotwin cannot read it ({failure})"
        return NOT_TRIED, f"it is not run: {why}"


def _row(name: str, verdict: str, detail: str, version: str) -> CheckRow:
    """A row with its section of the standard where it found something."""
    rule = paragraph(name.removesuffix(SECOND), version) if verdict in (FAIL, REMARK) else ""
    return CheckRow(name, verdict, detail, rule)


def _summary(description: Description) -> str:
    md = description.source
    counts = f"{len(inputs_of(md))} inputs, {len(outputs_of(md))} outputs, {len(md.modelVariables)} variables"
    kinds = f"{description.interface}{' and ModelExchange' if offers_both(md) else ''}"
    return f"{md.modelName}, FMI {md.fmiVersion} {kinds}, {counts}, by {md.generationTool or 'unknown'}"


def _units(description: Description) -> tuple[str, str]:
    md = description.source
    real = [v for v in (*inputs_of(md), *outputs_of(md)) if v.type in FLOATS]
    bare = [v.name for v in real if unit_name(v) is None]
    if not real:
        return NOT_TRIED, "no real inputs or outputs"
    if bare or description.unknown_units:
        strange = f"; not understood: {', '.join(description.unknown_units[:3])}" if description.unknown_units else ""
        return REMARK, f"{len(bare)} of {len(real)} inputs and outputs have no unit ({', '.join(bare[:3])}){strange}"
    if description.redefined:
        return REMARK, "; ".join(description.redefined)
    return PASS, f"all {len(real)} inputs and outputs have a unit"


def _references(
    path: Path,
    description: Description,
    found: Mapping[str, tuple[str, str]],
    reference: Record | None,
    limit: float,
    interpolation: Mapping[str, str],
) -> list[tuple[str, tuple[str, str]]]:
    record = reference if reference is not None else _embedded_reference(path)
    if record is None or found["loads"][0] not in GOOD:
        nothing = "no reference record was given and none is inside"
        why = nothing if record is None else description.elsewhere or "it does not load here, see 'loads'"
        return [("reference", (NOT_TRIED, why))]
    block = read_fmu(path, time_limit=limit, interpolation="hold")
    absent = [s.name for s in block.inputs if s.name not in record]
    if absent:
        return [("reference", (NOT_TRIED, f"the reference lacks inputs ({', '.join(absent[:3])})"))]
    block = block.with_inputs(told(block.inputs, interpolation if reference is not None else {}, str(path)))
    try:
        rows = [("reference", _replayed(block, record, AGREEMENT))]
        if offers_both(description.source):
            exchange = replace(block.description, interface="ModelExchange", any_step=True)
            rows.append((f"reference{SECOND}", _replayed(replace(block, description=exchange), record, OTHER_SOLVER)))
    except (DataError, UnitError) as reason:
        if reference is not None:
            raise
        return [("reference", (NOT_TRIED, f"what it carries along cannot be replayed: {reason}"))]
    return rows


def _embedded_reference(path: Path) -> Record | None:
    """The run that an FMU of hydrotwin carries along."""
    if REFERENCE_FILE not in file_names(path):
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / Path(REFERENCE_FILE).name
        file.write_bytes(read_file(path, REFERENCE_FILE))
        return read_record(file)


def _replayed(block: FmuBlock, record: Record, limit: float) -> tuple[str, str]:
    names = [s.name for s in block.outputs]
    shared = [name for name in names if name in record]
    if not shared:
        return NOT_TRIED, f"the reference has none of the outputs ({', '.join(names) or 'there are none'})"
    try:
        found = block.free_run(record)
    except SolveError as failure:
        return FAIL, str(failure)
    except DeclarationError as reason:
        return NOT_TRIED, str(reason)
    errors = {n: _relative_difference(found[n], record[n]) for n in shared}
    worst = max(errors, key=errors.__getitem__)
    moving = ", ".join(f"{s.name} {s.interpolation}" for s in block.inputs if not s.held)
    between = f"{moving or 'inputs held'} between samples"
    detail = f"{len(shared)} outputs, largest difference {errors[worst]:.2g} of the range at {worst}, {between}"
    return PASS if errors[worst] <= limit else FAIL, detail


def _relative_difference(found: np.ndarray, expected: np.ndarray) -> float:
    span = float(np.ptp(expected)) or max(float(np.abs(expected).max()), 1e-12)
    return float(np.abs(found - expected).max() / span)
