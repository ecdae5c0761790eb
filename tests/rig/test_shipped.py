"""The recordings that ship are those their scripts make, and they say nothing of what they hide."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from tests import rig

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = {f"{kind}_{i}.csv" for kind, n in (("train", 3), ("validate", 2)) for i in range(1, n + 1)}
TEST_NOISE = {"velocity": 2e-4, "force": 1.5}


def script(machine):
    spec = importlib.util.spec_from_file_location(f"make_{machine}", EXAMPLES / machine / "make_recordings.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("machine", sorted(rig.MACHINES))
def test_the_script_makes_the_shipped_recordings_again(machine, tmp_path):
    made = script(machine).make(tmp_path)
    shipped = EXAMPLES / machine / "recordings"
    assert {p.name for p in made} == {p.name for p in shipped.glob("*.csv")} >= NAMES
    noise = {**rig.sensor_noise(machine), **TEST_NOISE, rig.MACHINES[machine].input: 0.01, "time": 1e-6}
    for path in made:
        again, kept = rig.read_csv(path), rig.read_csv(shipped / path.name)
        assert list(again) == list(kept)
        for name, values in kept.items():
            assert again[name] == pytest.approx(values, abs=0.05 * noise[name])


def test_the_shipped_recordings_are_small():
    files = [p for machine in rig.MACHINES for p in (EXAMPLES / machine / "recordings").iterdir()]
    assert sum(p.stat().st_size for p in files) < 6e6


@pytest.mark.parametrize("machine", sorted(rig.MACHINES))
def test_the_gap_is_many_times_the_noise_and_the_folder_does_not_name_it(machine):
    m, folder = rig.MACHINES[machine], EXAMPLES / machine / "recordings"
    noise = rig.sensor_noise(machine)
    for name in NAMES:
        run = rig.read_csv(folder / name)
        base = rig.record(machine, run[m.input], run["time"], start=run[m.start_output][0])
        gap = {n: np.sqrt(np.mean((run[n] - base[n]) ** 2)) / s for n, s in noise.items()}
        assert 5 < gap[m.start_output] < 60
    for hidden in script(machine).HIDDEN:
        for path in folder.iterdir():
            text = path.read_text(encoding="utf-8").lower()
            assert all(word not in text for word in (hidden, *hidden.split("_")[1:]))
