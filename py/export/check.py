"""check_fmu: is this FMU good? One row for each thing that was tried, ours or anybody's."""

from __future__ import annotations

import json
import os
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from fmpy import supported_platforms
from fmpy.validation import validate_fmu

from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.records import Record, read_record
from hydrotwin.records.between import told

from .child_process import start_child
from .fmu_process.gates import applicable
from .fmu_process.master import FLOATS, inputs_of, outputs_of
from .foreign import Description, describe_fmu, unit_name
from .reader import FmuBlock, read_fmu
from .writer import REFERENCE_FILE

AGREEMENT = 1e-6
"""Largest difference to the reference, relative to the range of the signal, that passes."""
OTHER_SOLVER = 1e-2
"""The same for Model Exchange in an FMU with both: the reference is of the solver inside, not of the importer's."""

PROBES = (
    "runs", "reset", "second instance", "state", "intermediate update", "dependencies", "directional derivatives",
    "NaN input", "unknown value reference", "step before initialization",
)  # fmt: skip


EXCHANGE_PROBES = ("order of setting", "any order of calls", "reset", "state", "directional derivatives", "NaN input")
SHARE = 0.1  # of nominal: how far inputs are moved
SECOND = " (Model Exchange)"  # after the name of a row: of the other half of an FMU that offers both


@dataclass(frozen=True)
class CheckRow:
    """One thing tried: passed is None where it does not apply or is only worth a remark."""

    name: str
    passed: bool | None
    detail: str


@dataclass(frozen=True)
class Check:
    """What was found out about an FMU."""

    path: str
    rows: tuple[CheckRow, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing failed."""
        return all(row.passed is not False for row in self.rows)

    @property
    def failures(self) -> tuple[CheckRow, ...]:
        """The rows that failed."""
        return tuple(row for row in self.rows if row.passed is False)

    def __getitem__(self, name: str) -> CheckRow:
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(name)

    def __str__(self) -> str:
        words = {True: "ok", False: "FAILED", None: "-"}
        width = max((len(row.name) for row in self.rows), default=0)
        lines = [f"{words[row.passed]:>6}  {row.name:<{width}}  {row.detail}" for row in self.rows]
        return "\n".join([self.path, *lines])


def check_fmu(
    path: str | os.PathLike,
    reference: Record | None = None,
    *,
    time_limit: float = 60.0,
    interpolation: Mapping[str, str] | None = None,
) -> Check:
    """Check an FMU of FMI 2 or 3, whoever made it.

    Read without running its code: FMPy's validation, platforms, files, units. Run in a child process with a limit of
    ``time_limit`` [s]: a short run, reset, a second instance, saving the state, intermediate update and early
    return, declared dependencies against perturbed inputs, directional derivatives, and what it does with NaN, an
    unknown variable and a step too early.
    Of Model Exchange: a run with FMPy's CVode, stale answers after setting time, states and inputs in any order, reset,
    saving the state, directional derivatives and NaN. An FMU with both is tried as both.
    Other programs take it as well: FMPy's master for each kind, libcosimpy (FMI 2 Co-Simulation) and CasADi's importer
    (FMI 3 Model Exchange), where they are installed.
    With a ``reference`` record, or one inside the FMU, its inputs are replayed and the outputs compared, held between
    samples unless ``interpolation`` says "linear" for an input by name; they agree
    when they differ by less than 1e-6 of each signal's range (1e-2 in Model Exchange where there is both).

    A row fails only where the standard is broken or the numbers are wrong. Raises DataError when there is no file.
    """
    path = Path(path)
    try:
        description = describe_fmu(path, {}, {})
    except HydrotwinError as failure:
        if not path.exists():
            raise
        return Check(str(path), (CheckRow("readable", False, str(failure)),))
    rows = [
        CheckRow("readable", True, _summary(description)), _validation(path), _files(path), _platforms(path),
        _units(description), *_probes(path, description, time_limit),
        *_in_child(path, applicable(description.source), "gates", time_limit),
        *_references(path, description, reference, time_limit, interpolation or {}),
    ]  # fmt: skip
    return Check(str(path), tuple(rows))


def _summary(description: Description) -> str:
    md = description.source
    counts = f"{len(inputs_of(md))} inputs, {len(outputs_of(md))} outputs, {len(md.modelVariables)} variables"
    kinds = f"{description.interface}{' and ModelExchange' if _offers_both(description) else ''}"
    return f"{md.modelName}, FMI {md.fmiVersion} {kinds}, {counts}, by {md.generationTool or 'unknown'}"


def _offers_both(description: Description) -> bool:
    return description.source.coSimulation is not None and description.source.modelExchange is not None


def _validation(path: Path) -> CheckRow:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problems = validate_fmu(str(path))
    if not problems:
        return CheckRow("FMPy validation", True, "no problem found")
    more = f" and {len(problems) - 3} more" if len(problems) > 3 else ""
    return CheckRow("FMPy validation", False, " | ".join(p.strip() for p in problems[:3]) + more)


def _files(path: Path) -> CheckRow:
    if path.is_dir():
        return CheckRow("files", None, "an unpacked folder")
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    bad = [n for n in names if "\\" in n or n.startswith("/") or ".." in n.split("/")]
    if bad:
        return CheckRow("files", False, f"paths that other systems cannot unpack: {', '.join(bad[:3])}")
    size = f"{path.stat().st_size / 1000:.0f} kB, {len(names)} files"
    extras = [w for w in ("documentation", "sources", "resources") if any(n.startswith(f"{w}/") for n in names)]
    return CheckRow("files", True, f"{size}, with {', '.join(extras) or 'no extras'}")


def _platforms(path: Path) -> CheckRow:
    found = supported_platforms(str(path))
    return CheckRow("platforms", bool(found), ", ".join(found) or "no binary and no sources for any platform")


def _units(description: Description) -> CheckRow:
    real = [v for v in description.source.modelVariables if v.type in FLOATS and v.causality in ("input", "output")]
    bare = [v.name for v in real if unit_name(v) is None]
    if not real:
        return CheckRow("units", None, "no real inputs or outputs")
    if bare or description.unknown_units:
        strange = f"; not understood: {', '.join(description.unknown_units[:3])}" if description.unknown_units else ""
        missing = f"{len(bare)} of {len(real)} inputs and outputs have no unit ({', '.join(bare[:3])})"
        return CheckRow("units", None, missing + strange)
    return CheckRow("units", True, f"all {len(real)} inputs and outputs have a unit")


def _probes(path: Path, description: Description, limit: float) -> list[CheckRow]:
    """Each probe's row, of both kinds where both are offered. After a crash the rest goes on in a new process."""
    rows = _in_child(path, PROBES, "CoSimulation", limit) if description.interface == "CoSimulation" else []
    if description.source.modelExchange is None:
        return rows
    own = [_model_exchange_run(path, description, limit), *_in_child(path, EXCHANGE_PROBES, "ModelExchange", limit)]
    return [*rows, *(replace(row, name=row.name + SECOND) for row in own)] if rows else own


def _in_child(path: Path, probes: Sequence[str], interface: str, limit: float) -> list[CheckRow]:
    """One row for each probe, in as many child processes as it takes."""
    rows, left = [], list(probes)
    while left:
        with tempfile.TemporaryDirectory(prefix="hydrotwin-check-", ignore_cleanup_errors=True) as folder:
            job = {"task": "probe", "path": str(path.absolute()), "probes": left, "interface": interface}
            failure = start_child(job, {}, limit, Path(folder))
            done, begun = _read_rows(Path(folder) / "rows.jsonl")
        rows += done
        if failure:
            rows.append(CheckRow(begun or left[0], False, failure))
        finished = {row.name for row in rows}
        left = [name for name in left if name not in finished] if failure else []
    return rows


def _read_rows(path: Path) -> tuple[list[CheckRow], str | None]:
    """Rows that were finished, and the name of the probe that was not."""
    rows, begun = [], None
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        entry = json.loads(line)
        if "begin" in entry:
            begun = entry["begin"]
        else:
            rows.append(CheckRow(entry["name"], entry["passed"], entry["detail"]))
            begun = None
    return rows, begun


def _model_exchange_run(path: Path, description: Description, limit: float) -> CheckRow:
    """A second of simulation with FMPy's CVODES; real inputs move a tenth of nominal within its steps."""
    time = np.linspace(0.0, 1.0, 51)
    own = [v.name for v in outputs_of(description.source)]
    rates = [row.variable.name for row in description.source.derivatives]
    block = _exchanging(read_fmu(path, outputs=own or rates, interpolation="linear", time_limit=limit))
    moved = {s.name: _moved(description, s.name, time) for s in block.inputs}
    record = Record(time, moved, {s.name: s.unit for s in block.inputs}, "inputs that move")
    return _tried("runs", lambda: _all_finite(block, record))


def _moved(description: Description, name: str, time: np.ndarray) -> np.ndarray:
    variable = next(v for v in description.source.modelVariables if v.name == description.fmu_names[name])
    factor, offset = description.scales[variable.name]
    share = SHARE * float(variable.nominal or 1.0) if variable.type in FLOATS else 0.0
    start = {"true": 1.0, "false": 0.0}.get(str(variable.start), variable.start)
    return factor * (float(start or 0.0) + share * np.sin(4 * np.pi * time)) + offset


def _all_finite(block: FmuBlock, record: Record) -> tuple[bool, str]:
    found = block.free_run(record)
    finite = all(np.isfinite(v).all() for v in found.signals.values())
    count = f"{len(found.signals)} outputs {'finite' if finite else 'not finite'}"
    return finite, f"{record.duration:g} s simulated, {count}"


def _exchanging(block: FmuBlock) -> FmuBlock:
    """The FMU as Model Exchange, also where it offers Co-Simulation."""
    return replace(block, description=replace(block.description, interface="ModelExchange", any_step=True))


def _references(
    path: Path, description: Description, reference: Record | None, limit: float, interpolation: Mapping[str, str]
) -> list[CheckRow]:
    record = reference if reference is not None else _embedded_reference(path)
    if record is None:
        return [CheckRow("reference", None, "no reference record was given and none is inside")]
    block = read_fmu(path, time_limit=limit, interpolation="hold")
    block = block.with_inputs(told(block.inputs, interpolation if reference is not None else {}, str(path)))
    rows = [_tried("reference", lambda: _replay(block, record, AGREEMENT))]
    if _offers_both(description):
        rows.append(_tried("reference" + SECOND, lambda: _replay(_exchanging(block), record, OTHER_SOLVER)))
    return rows


def _embedded_reference(path: Path) -> Record | None:
    if path.is_dir():
        inside = path / REFERENCE_FILE
        return read_record(inside) if inside.exists() else None
    with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory() as folder:
        if REFERENCE_FILE not in archive.namelist():
            return None
        return read_record(archive.extract(REFERENCE_FILE, folder))


def _replay(block: FmuBlock, record: Record, limit: float) -> tuple[bool, str]:
    found = block.free_run(record)
    shared = [s.name for s in block.outputs if s.name in record]
    if not shared:
        return False, f"the reference has none of the outputs {', '.join(s.name for s in block.outputs)}"
    errors = {n: _relative_difference(found[n], record[n]) for n in shared}
    worst = max(errors, key=errors.__getitem__)
    moving = ", ".join(f"{s.name} {s.interpolation}" for s in block.inputs if not s.held)
    between = f"{moving or 'inputs held'} between samples"
    detail = f"{len(shared)} outputs, largest difference {errors[worst]:.2g} of the range at {worst}, {between}"
    return errors[worst] <= limit, detail


def _relative_difference(found: np.ndarray, expected: np.ndarray) -> float:
    span = float(np.ptp(expected)) or max(float(np.abs(expected).max()), 1e-12)
    return float(np.abs(found - expected).max() / span)


def _tried(name: str, work: Callable[[], tuple[bool, str]]) -> CheckRow:
    try:
        return CheckRow(name, *work())
    except HydrotwinError as failure:
        return CheckRow(name, False, str(failure))
