"""The gate table: every shipped FMU, by version of FMI and kind, through every program that can judge it.

``python -m fmus.gates [NAME...]`` prints it as Markdown; ``--write`` keeps it as GATES.md beside this file.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import re
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from fmpy.validation import validate_fmu

from hydrotwin.export import Check, CheckRow, check_fmu
from hydrotwin.export.build import native_platform
from hydrotwin.export.fmu_process.verdicts import NOT_TRIED
from hydrotwin.models.language.errors import DeclarationError, HydrotwinError
from hydrotwin.records import read_record

from .machines import machine_for, replayed
from .shipped import HERE, Shipped, all_shipped

KEPT = HERE / "GATES.md"
THERE = {"win64": "win64 under wine", "aarch64-linux": "aarch64 under qemu"}
COLUMNS = (
    "FMU", "FMI", "kind", "FMPy validation", "FMPy, off the reference", "libcosimpy (FMI 2 cs)",
    "CasADi (FMI 3 me)", "contract", "derivatives", *THERE.values(),
)  # fmt: skip
EQUAL = 1e-9  # of the largest output: between machines
PACKAGES = ("fmpy", "libcosimpy", "casadi", "ziglang")
_SIMULATED = {"cs": "FMPy Co-Simulation", "me": "FMPy Model Exchange"}
_OUTSIDE = (
    "readable", "schema", "interfaces", "unit definitions", "type definitions", "other definitions", "variables",
    "names", "model structure", "sources", "terminals", "files", "platforms", "units", "loads",
    "directional derivatives", "reference", "related files", "libcosimpy", "CasADi importer", *_SIMULATED.values(),
)  # fmt: skip
FAILED = "FAIL"


def main(arguments: Sequence[str], root: Path = HERE) -> int:
    """The exit code: 0, 1 when a gate failed, 2 for a name that is none."""
    parser = argparse.ArgumentParser(prog="python -m fmus.gates", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--write", action="store_true", help=f"keep the table as {KEPT.name}")
    chosen = parser.parse_args(arguments)
    try:
        shipped = all_shipped(root, chosen.names)
    except HydrotwinError as error:
        print(f"failed: {error}", file=sys.stderr)
        return 2
    rows = [row_of(one, fmi, kind) for one in shipped for fmi in one.fmi for kind in ("cs", "me")]
    text = page(rows)
    print(text)
    if chosen.write:
        KEPT.write_text(text, encoding="utf-8")
    return 1 if any(FAILED in cell for row in rows for cell in row) else 0


def row_of(shipped: Shipped, fmi: int, kind: str) -> list[str]:
    """One row of the table: the FMU of one kind alone, built for this machine and those that can be imitated."""
    head = [shipped.folder.name, f"{fmi}.0", kind]
    platforms = [native_platform(), *(p for p in THERE if not machine_for(p).missing)]
    reference = read_record(shipped.reference)
    with tempfile.TemporaryDirectory(prefix="gates-") as folder:
        one = replace(shipped, kind=kind, platforms=list(dict.fromkeys(platforms)))
        try:
            fmu = one.build(fmi, reference, Path(folder) / f"{shipped.folder.name}.fmu")
        except DeclarationError as refusal:
            mark = FAILED if shipped.kind in (kind, "both") else "-"
            return [*head, f"{mark} ({refusal})", *[""] * (len(COLUMNS) - 4)]
        check = check_fmu(fmu, reference)
        print(f"{' '.join(head)}: {check.failures or 'passed'}", file=sys.stderr)
        validated = _mark(not validate_fmu(str(fmu)))
        elsewhere = [_elsewhere(fmu, platform, kind) for platform in THERE]
    return [*head, validated, *_cells(check, kind), *elsewhere]


def _cells(check: Check, kind: str) -> list[str]:
    """From the rows of `check_fmu`: reference, libcosimpy, CasADi, contract, derivatives."""
    found = {row.name: row for row in check.rows}
    simulated, reference = found[_SIMULATED[kind]], found["reference"]
    contract = [row for row in check.rows if row.name not in _OUTSIDE and row.verdict != NOT_TRIED]
    done = sum(bool(row.passed) for row in contract)
    return [
        _mark(simulated.passed and reference.passed, _figure(reference.detail)),
        _other(found.get("libcosimpy")),
        _other(found.get("CasADi importer")),
        _mark(done == len(contract), f"{done} of {len(contract)}"),
        _other(found["directional derivatives"]),
    ]


def _other(row: CheckRow | None) -> str:
    if row is None:
        return "-"
    if row.verdict == NOT_TRIED:
        return f"- ({row.detail})"
    return _mark(bool(row.passed), _figure(row.detail))


def _figure(detail: str) -> str:
    """The number after "largest difference ...", "" where there is none."""
    found = re.search(r"difference (?:to (?:our master|finite differences) )?(\d[\d.e+-]*)", detail)
    return found[1] if found else ""


def _elsewhere(fmu: Path, platform: str, kind: str) -> str:
    machine = machine_for(platform)
    if machine.missing:
        return f"- ({machine.missing})"
    try:
        there, here = (replayed(fmu, p, kind) for p in (platform, native_platform()))
    except (RuntimeError, OSError) as failure:
        return f"{FAILED} ({str(failure).splitlines()[0]})"
    off = float(np.abs(there - here).max() / np.abs(here).max())
    return _mark(off <= EQUAL and np.ptp(here, axis=0).any(), f"{off:.1g}" if off else "same bits")


def _mark(passed: bool, figure: str = "") -> str:
    return f"{'pass' if passed else FAILED} {figure}".strip()


def page(rows: Sequence[Sequence[str]]) -> str:
    """The table with the programs that it was made with."""
    lines = [COLUMNS, ["---"] * len(COLUMNS), *rows]
    told = [f"{p} {importlib.metadata.version(p)}" for p in PACKAGES if importlib.util.find_spec(p)]
    told += [machine_for(p).version for p in THERE if machine_for(p).version]
    return f"""# Gates

Every shipped FMU, of either kind alone. Off the reference: the largest difference to `reference.csv`, of the range of
each signal. Contract: what `hydrotwin check` tries of the interface; `tests/export/test_contract.py` tries more.
Importers and machines: the largest relative difference to the same FMU called directly, and here; "-" where a program
does not read such FMUs. Derivatives: the largest difference to finite differences, of nominal; 0 where nothing answers
to an input at once.

{chr(10).join(f"| {' | '.join(line)} |" for line in lines)}

Made by `python -m fmus.gates --write` with {", ".join(told)}.
"""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
