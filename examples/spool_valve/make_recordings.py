"""Make these recordings with the truth rig: ``python examples/spool_valve/make_recordings.py [FOLDER]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tests import rig  # noqa: E402

SEED = 12
HIDDEN = {"valve_overlap": {"share": 0.012}}  # of full spool travel, all four edges


def make(folder: Path) -> list[Path]:
    """Write 3 + 2 recordings of the valve-driven cylinder; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    units = rig.file_units("spool_valve")
    paths = []
    for kind in ("train", "validate"):
        recordings = rig.clean_recordings("spool_valve", kind, seed=SEED, effects=HIDDEN)
        for number, columns in enumerate(recordings, start=1):
            paths.append(rig.write_csv(columns, folder / f"{kind}_{number}.csv", units=units))
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent / "recordings")
    for path in make(parser.parse_args().folder):
        print(path)
