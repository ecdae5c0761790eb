"""The experiment of the C-EHA paper in short: its recordings, some of its models, its scenario."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.learned.table_2 import HOLD, scored
from examples.table_2 import learn as example
from examples.table_2.make_recordings import KINDS, QUANTUM, make, record
from hydrotwin import load
from hydrotwin.comparison import read_scenario, run_scenario

pytestmark = pytest.mark.proof
SECONDS = 6.0
QUICK = {  # options that make seconds of the minutes of learning
    "dynamic": {"iterations": 10},
    "symbolic": {"starts": 1, "population": 100, "generations": 10, "budget": 3600.0},
    "network_from_command": {"starts": 1, "hidden": 0, "effort": 0.3, "lags": (2, 4), "budget": 3600.0},
    "hybrid": {"starts": 1, "hidden": 2, "effort": 0.2, "budget": 3600.0},
    "eq17": {},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("table_2") / "out"
    make(place, seed=2, seconds=SECONDS)
    train, slow = example.read(place, "train"), example.read(place, "slow")
    for name, options in QUICK.items():
        example.LEARNERS[name](train, slow, place, name, **options)
    return place


@pytest.fixture(scope="module")
def rows(folder):
    judged = example.read(folder, "validate")
    paths = {name: folder / f"{name}.toml" for name in QUICK} | {HOLD: None}
    return {name: scored(name, path, judged, 0.0) for name, path in paths.items()}


def test_the_arm_is_recorded_every_millisecond_in_steps_of_its_encoder(folder):
    runs = example.read(folder, "train") + example.read(folder, "validate")
    assert len(runs) == sum(len(shapes) for shapes in KINDS.values())
    for run in runs:
        assert run.uniform and run.period == pytest.approx(1e-3) and run.duration == pytest.approx(SECONDS)
        steps = run["arm_angle"] / QUANTUM
        assert np.abs(steps - np.round(steps)).max() < 0.02  # the file keeps so many digits
        assert np.ptp(run["arm_angle"]) > 0.1
    assert len({run["command"].tobytes() for run in runs}) == len(runs)


def test_a_seed_is_one_experiment_and_another_seed_another():
    one, same, other = (record("validate", 2, seed, 1.0) for seed in (3, 3, 4))
    assert all(np.array_equal(one[name], same[name]) for name in one)
    assert not np.array_equal(one["command"], other["command"])


def test_slow_recordings_are_every_tenth_sample(folder):
    for run, few in zip(example.read(folder, "train"), example.read(folder, "slow"), strict=True):
        for name in run.names:
            assert np.array_equal(run[name][::10], few[name])


def test_the_machine_has_what_the_dynamic_model_lacks(rows):
    assert rows["dynamic"].mean > 3 * np.degrees(QUANTUM)  # drift, not noise
    assert rows["dynamic"].mean < 0.2 * rows[HOLD].mean


def test_a_learned_residual_takes_a_good_part_of_what_the_dynamic_model_leaves(rows):
    assert rows["hybrid"].mean <= 0.7 * rows["dynamic"].mean


def test_a_formula_found_in_seconds_follows_the_arm(rows):
    assert rows["symbolic"].mean < 0.3 * rows[HOLD].mean


def test_a_linear_model_of_the_command_still_beats_the_published_formula_of_another_machine(rows):
    assert rows["network_from_command"].mean < rows["eq17"].mean


def test_the_scenario_compares_the_files_that_learning_writes(folder):
    told = Path(example.__file__).with_name("scenario.toml").read_text(encoding="utf-8")
    rows = [line for line in told.splitlines() if line.strip().startswith('{ model = "out/')]
    made = {row: row.split('"')[1] for row in rows}
    lines = [line for line in told.splitlines() if line not in made or (folder.parent / made[line]).exists()]
    scenario = folder.parent / "scenario.toml"
    scenario.write_text("\n".join(lines), encoding="utf-8")
    found = run_scenario(read_scenario(scenario), lambda spec: load(str(spec)), repeats=1)
    assert not found.failures
    assert {e.name for e in found.entrants} >= {"identified dynamic model", "formula", "hybrid"}
    assert {d.record for d in found.domains} == {"validate_1", "validate_2", "validate_3"}
    assert set(made.values()) == {f"out/{name}.toml" for name in example.LEARNERS}
