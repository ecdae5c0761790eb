"""make fmus: build every shipped FMU and check it; ``python -m fmus.make [NAME...] [--platform NAME|all]``.

With ``--write``: write README.md and reference.csv of each anew instead.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hydrotwin.commands.shared import out, table
from hydrotwin.export import Check, check_fmu
from hydrotwin.export.build import platforms_named
from hydrotwin.export.check import SECOND
from hydrotwin.export.fmu_process.verdicts import NOT_TRIED
from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.records import read_record, write_record

from .readme import readme_of
from .shipped import HERE, Shipped, all_shipped

COLUMNS = ["", "file", "FMI", "kind", "kB", "build s", "check s", "checks", "Co-Simulation", "Model Exchange"]


def main(arguments: Sequence[str], root: Path = HERE) -> int:
    """The exit code: 0, or 1 when an FMU could not be built or fails a check, 2 for a name that is none."""
    parser = argparse.ArgumentParser(prog="python -m fmus.make", description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="folders; all by default")
    parser.add_argument(
        "--platform", action="append", metavar="NAME", help="linux64, win64 ... or all; this machine by default"
    )
    parser.add_argument("--write", action="store_true", help="write README.md and reference.csv anew instead")
    options = parser.parse_args(arguments)
    try:
        chosen = all_shipped(root, options.names)
        if options.platform:
            platforms_named(options.platform)
            chosen = [replace(shipped, platforms=options.platform) for shipped in chosen]
        if options.write:
            for shipped in chosen:
                write(shipped)
            return 0
    except HydrotwinError as error:
        print(f"failed: {error}", file=sys.stderr)
        return 2
    rows = [row for shipped in chosen for row in build_and_check(shipped)]
    table("shipped FMUs, and how far off the reference they are, of the range of each signal", COLUMNS, rows)
    return 1 if any(row[0] == "FAIL" for row in rows) else 0


def write(shipped: Shipped) -> None:
    """README.md and reference.csv of one folder."""
    write_record(shipped.reference_run(), shipped.reference)
    (shipped.folder / "README.md").write_text(readme_of(shipped), encoding="utf-8")
    out.print(f"written: {shipped.reference}, README.md")


def build_and_check(shipped: Shipped) -> list[list]:
    """One row of the table for each version of FMI; what fails is told in full."""
    rows = []
    for fmi in shipped.fmi:
        head = [shipped.file(fmi).name, f"{fmi}.0", shipped.kind]
        begun = time.perf_counter()
        try:
            reference = read_record(shipped.reference)
            path = shipped.build(fmi, reference)
        except HydrotwinError as error:
            out.print(f"failed: {error}")
            rows.append(["FAIL", *head, "", "", "", "not built", "", ""])
            continue
        built = time.perf_counter()
        check = check_fmu(path, reference)
        for row in check.failures:
            out.print(f"failed: {path.name}: {row.name}: {row.detail}")
        tried = [row for row in check.rows if row.verdict != NOT_TRIED]
        counts = f"{sum(bool(row.passed) for row in tried)} of {len(tried)} passed"
        times = [round(built - begun, 1), round(time.perf_counter() - built, 1)]
        size = round(path.stat().st_size / 1000)
        mark = "pass" if check.passed else "FAIL"
        rows.append([mark, *head, size, *times, counts, *_off(check)])
    return rows


def _off(check: Check) -> list[str]:
    """The largest difference to the reference in Co-Simulation and in Model Exchange."""
    found = []
    for name in ("reference", f"reference{SECOND}"):
        details = [row.detail for row in check.rows if row.name == name]
        found.append(details[0].rpartition("largest difference ")[2].replace(" of the range", "") if details else "-")
    return found


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
