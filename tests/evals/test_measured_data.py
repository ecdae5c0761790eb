"""The examples on real recordings, held to the figures in their README files.

The recordings are not part of the project: HYDROTWIN_MEASURED_DATA names the folder that holds them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hydrotwin.comparison import PhysicalContender
from hydrotwin.discovery import discover
from hydrotwin.identification import identify
from hydrotwin.loading import load
from hydrotwin.records import Record, read_record
from hydrotwin.simulation import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"
FOLDER = Path(os.environ.get("HYDROTWIN_MEASURED_DATA", "") or "/nonexistent")
UNEXPLAINED = {"position": 3e-3, "pressure_a": 3e5, "pressure_b": 3e5}
BAR, MM = 1e5, 1e-3


def needs(folder: str):
    return pytest.mark.skipif(
        not (FOLDER / folder).is_dir(),
        reason=f"HYDROTWIN_MEASURED_DATA does not name a folder with {folder}/: the recordings are not in the project",
    )


def bench(factory: str):
    return load(f"{EXAMPLES / 'eha_bench' / 'model.py'}:{factory}")


def axis(factory: str):
    return load(f"{EXAMPLES / 'emps' / 'model.py'}:{factory}")


@cache
def recordings(pattern: str) -> tuple[Record, ...]:
    found = tuple(read_record(path) for path in sorted(FOLDER.glob(pattern)))
    assert found, pattern
    return found


@cache
def bench_fit(factory: str):
    return identify(
        bench(factory),
        recordings("eha_bench/load1*.csv") + recordings("eha_bench/load2*.csv"),
        validate=recordings("eha_bench/load3*.csv"),
        initial_states="free",
        noise=UNEXPLAINED,
        windows=(),
        starts=1,
    )


@cache
def axis_fit(factory: str):
    return identify(
        axis(factory),
        recordings("emps/train.csv"),
        validate=recordings("emps/test_pulses.csv"),
        initial_states="fixed",
        noise={"position": 1e-3},
        starts=1,
    )


@cache
def tanks_gap(names: int = 3):
    """What the plain tanks lack, at most so many effects."""
    folder = "cascaded_tanks"
    return discover(
        load(f"{EXAMPLES / folder / 'model.py'}:model"),
        recordings(f"{folder}/train.csv"),
        validate=recordings(f"{folder}/validate.csv"),
        initial_states="free",
        max_effects=names,
    )


@cache
def axis_gap():
    """What the axis without dry friction lacks."""
    return discover(axis("axis"), recordings("emps/train.csv"), validate=recordings("emps/test_pulses.csv"))


def driven(speed, direction, seconds: float = 2.0) -> Record:
    """A recording of inputs alone: motor speed [rad/s] and valve direction as functions of time."""
    time = np.arange(0.0, seconds, 0.004)
    signals = {"motor_speed": speed(time), "valve_direction": direction(time)}
    return Record(time, signals, {"motor_speed": "rad/s", "valve_direction": "1"}, "driven")


@pytest.mark.parametrize("factory", ["model", "soft", "leaking", "soft_and_leaking"])
def test_the_bench_turns_a_revolution_into_its_displacement(factory):
    extending = driven(lambda t: np.full_like(t, 100.0), np.ones_like)
    model = bench(factory).with_parameters({"cylinder.oil.bulk_modulus": 1e9})
    run = simulate(model, extending, parameters={"load.usual_force": 0.0})
    delivered = 1.6e-6 / (2 * np.pi) * 100.0 * 2.0 / 1963.5e-6
    assert 0.85 < run["position"][-1] / delivered < 1.0


def test_the_driven_chamber_keeps_its_pressure_until_the_valve_switches():
    run = simulate(
        bench("model"),
        driven(lambda t: np.where(t < 0.5, 100.0, 0.0), lambda t: np.where(t < 1.5, 1.0, -1.0)),
        parameters={"load.usual_force": 4000.0},
    )
    held, released = run["pressure_a"][200:370], run["pressure_a"][450:]
    assert np.ptp(held) < 0.01 * BAR
    assert held[0] > 25 * BAR
    assert released[-1] == pytest.approx(5 * BAR, rel=0.01)


def driving_pressure(direction: float, force: float) -> float:
    """Pressure [Pa] of the driven chamber after a second at 100 rad/s against a load [N]."""
    record = driven(lambda t: np.full_like(t, direction * 100.0), lambda t: np.full_like(t, direction), 1.0)
    run = simulate(bench("model"), record, start={"load.position": 0.03, "load.force": force})
    return run["pressure_a" if direction > 0 else "pressure_b"][-1]


def test_the_load_brakes_extension_and_leaves_retraction_alone():
    rise = driving_pressure(1.0, 5000.0) - driving_pressure(1.0, 0.0)
    assert rise == pytest.approx(5000.0 / 1963.5e-6, rel=0.01)
    assert driving_pressure(-1.0, 5000.0) == pytest.approx(driving_pressure(-1.0, 0.0), rel=1e-3)


@needs("eha_bench")
def test_the_plain_bench_misses_the_position_of_load_3_by_9_mm():
    force = {r.name: {"load.force": r.start["load.force"]} for r in bench_fit("model").records}
    plain = PhysicalContender(bench("model"), start=force)
    errors = [plain.free_run(r)["position"] - r["position"] for r in recordings("eha_bench/load3*.csv")]
    assert np.mean([np.sqrt(np.mean(e**2)) for e in errors]) == pytest.approx(9.3 * MM, rel=0.05)


LEFT_ON_LOAD_3 = [
    ("model", (8.0, 8.8), (4.7, 5.3), (2.5, 3.0)),
    ("soft", (3.4, 5.3), (4.0, 4.6), (2.5, 3.0)),
    ("leaking", (1.2, 1.6), (9.7, 10.9), (3.5, 4.1)),
    ("soft_and_leaking", (2.0, 2.6), (3.3, 4.0), (3.2, 3.7)),
]


@needs("eha_bench")
@pytest.mark.parametrize(("factory", "position", "pressure_a", "pressure_b"), LEFT_ON_LOAD_3)
def test_the_bench_leaves_what_its_readme_says_on_the_load_it_never_saw(factory, position, pressure_a, pressure_b):
    left = bench_fit(factory).rmse["validate"]
    assert position[0] < left["position"] / MM < position[1]
    assert pressure_a[0] < left["pressure_a"] / BAR < pressure_a[1]
    assert pressure_b[0] < left["pressure_b"] / BAR < pressure_b[1]


@needs("eha_bench")
def test_slip_alone_swallows_the_compression_and_is_too_large():
    held = 3.6e-13  # m3/(s.Pa), the largest that four holds show
    alone, both = (bench_fit(f).values["pump.loss.slip_conductance"] for f in ("leaking", "soft_and_leaking"))
    assert alone > 1.4 * both > 5 * held


@needs("eha_bench")
def test_every_parameter_of_the_plain_bench_is_plausible_and_the_fit_says_which_one_it_wants_beyond_reason():
    fit = bench_fit("model")
    assert fit.converged
    assert fit.parameter("pump.loss.efficiency").at_bound
    assert fit.values["pump.loss.efficiency"] == pytest.approx(0.85, abs=1e-6)
    assert any(f.parameters == ("pump.loss.efficiency",) for f in fit.findings)
    assert 3 * BAR < fit.values["accumulator.pressure"] < 6 * BAR
    assert 500 < fit.values["load.coulomb"] < 2000
    assert 5e4 < fit.values["load.viscous"] < 2e5
    assert 5e-9 < fit.values["valve.orifice.flow_coefficient"] < 2e-8


@needs("eha_bench")
def test_each_recording_gets_the_load_that_its_pressures_show():
    force = {r.name: r.start["load.force"] for r in bench_fit("model").records}
    assert force["load1_stroke4"] == pytest.approx(-440, abs=100)
    assert force["load2_stroke4"] == pytest.approx(1990, abs=150)
    for stroke in (1, 2, 4):
        assert force[f"load3_stroke{stroke}"] == pytest.approx(3750, abs=150)


@needs("eha_bench")
def test_the_command_of_the_readme_identifies_the_bench(tmp_path):
    folder = FOLDER / "eha_bench"
    command = [sys.executable, "-m", "hydrotwin", "identify", f"{EXAMPLES / 'eha_bench' / 'model.py'}:model"]
    command += [str(folder / name) for name in ("load1_stroke4.csv", "load2_stroke4.csv")]
    command += ["--validate", str(folder / "load3_stroke4.csv"), "--initial-states", "free", "--starts", "1", "--json"]
    command += [word for name, value in UNEXPLAINED.items() for word in ("--noise", f"{name}={value}")]
    done = subprocess.run(
        [*command, "--out", str(tmp_path / "bench.toml")], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["converged"]
    assert answer["rmse"]["validate"]["position"] == pytest.approx(10.8 * MM, rel=0.15)
    assert "pump.loss.efficiency" in (tmp_path / "bench.toml").read_text()


@needs("emps")
@pytest.mark.parametrize(("factory", "position", "velocity"), [("axis", 6.6, 14.8), ("axis_with_coulomb", 6.1, 5.5)])
def test_the_axis_leaves_what_its_readme_says_on_the_pulse_test(factory, position, velocity):
    fit, (pulses,) = axis_fit(factory), recordings("emps/test_pulses.csv")
    error = simulate(fit.flat, pulses)["position"] - pulses["position"]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(position * MM, rel=0.08)
    assert np.sqrt(np.mean(np.gradient(error, pulses.time) ** 2)) == pytest.approx(velocity * MM, rel=0.05)


@needs("emps")
def test_the_axis_comes_near_its_published_parameters_only_with_dry_friction():
    published = {"carriage.mass": 95.1089, "carriage.friction.viscous": 203.5034, "carriage.load_force": -3.1648}
    wet, dry = axis_fit("axis").values, axis_fit("axis_with_coulomb").values
    for name, value in published.items():
        assert dry[name] == pytest.approx(value, rel=0.08), name
    assert dry["carriage.friction.coulomb"] == pytest.approx(20.3935, rel=0.1)
    assert wet["carriage.mass"] > 1.2 * published["carriage.mass"]
    assert wet["carriage.friction.viscous"] > 2 * published["carriage.friction.viscous"]


@needs("emps")
def test_dry_friction_is_the_first_that_the_axis_is_told_to_lack():
    first = axis_gap().steps[0]
    assert (first.effect, first.site) == ("coulomb_friction", "carriage.flange")
    (force,) = first.parameters
    assert force.value == pytest.approx(20.3935, rel=0.1)


@needs("emps")
def test_the_axis_with_what_it_lacked_keeps_to_the_pulses():
    (pulses,) = recordings("emps/test_pulses.csv")
    error = simulate(axis_gap().fit_after.flat, pulses)["position"] - pulses["position"]
    assert np.sqrt(np.mean(error**2)) <= 6.5 * MM
    assert np.sqrt(np.mean(np.gradient(error, pulses.time) ** 2)) <= 6.0 * MM


@needs("cascaded_tanks")
def test_overflow_is_the_first_that_the_tanks_are_told_to_lack():
    assert tanks_gap().steps[0].effect == "overflow"


@needs("cascaded_tanks")
@pytest.mark.parametrize(("names", "left"), [(2, 0.40), (3, 0.28)])
def test_each_name_brings_the_tanks_nearer_to_levels_never_used(names, left):
    found = tanks_gap(names)
    (level,) = found.outputs["validate"]
    assert len(found.steps) == names
    assert level.rmse_before == pytest.approx(0.67, rel=0.05)
    assert level.rmse_after <= left
