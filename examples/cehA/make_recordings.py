"""Make the recordings of this example with the truth rig: ``python examples/cehA/make_recordings.py [FOLDER]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tests import rig  # noqa: E402

SEED = 11
HIDDEN = {"internal_leakage": {"conductance": 1e-14}}  # m3/(s.Pa), from the cap side to the rod side


def make(folder: Path) -> list[Path]:
    """Write 3 + 2 recordings of the arm and the constant-speed friction test; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    units = rig.file_units("cehA")
    paths = []
    for kind in ("train", "validate"):
        recordings = rig.clean_recordings("cehA", kind, seed=SEED, effects=HIDDEN)
        for number, columns in enumerate(recordings, start=1):
            paths.append(rig.write_csv(columns, folder / f"{kind}_{number}.csv", units=units))
    test = rig.friction_test(seed=SEED, effects=HIDDEN)
    test_units = {"time": "s", "velocity": "m/s", "force": "N"}
    paths.append(rig.write_csv(test, folder / "friction_test.csv", units=test_units))
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent / "recordings")
    for path in make(parser.parse_args().folder):
        print(path)
