"""Write ``models/*/reference/reference.csv`` with the independent rig: ``python -m tests.machines.make_references``.

12 s at 50 Hz of a smooth drive command, no noise, nothing hidden.
"""

from __future__ import annotations

from pathlib import Path

from tests import rig

ROOT = Path(__file__).resolve().parents[2]
REFERENCES = {name: ROOT / "models" / name / "reference" / "reference.csv" for name in rig.MACHINES}


def make() -> None:
    for machine, path in REFERENCES.items():
        path.parent.mkdir(exist_ok=True)
        one = dict(seed=7, duration=12.0, rate=50.0, noise={})
        columns = rig.clean_recordings(machine, "validate", 1, **one)[0]
        rig.write_csv(columns, path, units=rig.file_units(machine))


if __name__ == "__main__":
    make()
