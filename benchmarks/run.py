"""make bench: run every benchmark of this folder, one after the other, and keep what it prints.

``python benchmarks/run.py [NAME...]`` runs those whose path contains a NAME; those of `LONG` only when
named. Times are of a shared, noisy machine: quote the ratios, each measured in one run.
What is printed also goes to out/benchmarks/.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
LONG = ("comparison/band_coverage.py",)  # has a target of its own in the Makefile
OUT = HERE.parent / "out" / "benchmarks"


def main(wanted: list[str]) -> int:
    scripts = sorted(p for p in HERE.glob("*/*.py") if not p.name.startswith("_") and _has_main(p))
    paths = {p: p.relative_to(HERE).as_posix() for p in scripts}
    chosen = [p for p, path in paths.items() if (any(n in path for n in wanted) if wanted else path not in LONG)]
    OUT.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {"PYTHONPATH": str(HERE.parent), "OMP_NUM_THREADS": "1"}
    failed = []
    for script in chosen:
        name = ".".join(script.relative_to(HERE).with_suffix("").parts)
        print(f"\n== {name}", flush=True)
        with open(OUT / f"{name}.txt", "w", encoding="utf-8") as kept:
            process = subprocess.Popen(
                [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=environment, cwd=HERE.parent
            )
            for line in process.stdout:
                print(line, end="", flush=True)
                kept.write(line)
        if process.wait():
            failed.append(name)
    if failed:
        print(f"failed: {', '.join(failed)}")
    return bool(failed)


def _has_main(script: Path) -> bool:
    return '__name__ == "__main__"' in script.read_text(encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
