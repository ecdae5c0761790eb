"""The compensator: a machine that follows the curve that was designed; its equations, its ramps on the rig."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned.block_file import read_block, write_block
from hydrotwin.learned.inverse.compensator import desired_curve, learn_compensator
from hydrotwin.learned.inverse.curve import least_slope, static_answer
from hydrotwin.learned.inverse.data import Characteristic
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests import rig

HIDDEN = {
    "valve_overlap": {"share": 0.08},
    "null_bias": {"value": 0.03},
    "direction_asymmetry": {"ratio": 0.8},
    "dead_time": {"seconds": 0.03},
    "spool_hysteresis": {"width": 0.01},
}
WAYPOINTS = [(0.25, 0.008), (0.5, 0.022), (0.75, 0.042), (1.0, 0.065)]
UNITS = {"current": "1", "position": "m"}


def as_record(columns, name) -> Record:
    return Record(columns["time"], {k: columns[k] for k in UNITS}, UNITS, name, digest="0" * 64)


def triangle(time: np.ndarray, quarter: float = 5.0) -> np.ndarray:
    """Up to 1, down to -1 and back to 0."""
    return np.interp(time, quarter * np.arange(5), [0, 1, 0, -1, 0])


def staircase(seed: int) -> Record:
    """Seven levels of one direction, a second each, in random order; the even ones go out, the odd ones back in."""
    sign, random = (-1) ** seed, np.random.default_rng(seed)
    levels = sign * random.permutation(np.linspace(0.02, 1.0, 7) - random.uniform(0, 0.14) * np.linspace(0, 1, 7))
    time = 0.01 * np.arange(701)
    command = np.repeat(levels, 100)[np.minimum(np.arange(701), 699)]
    noise, start = rig.sensor_noise("spool_valve"), 0.45 - 0.2 * sign
    columns = rig.record("spool_valve", command, time, effects=HIDDEN, noise=noise, seed=seed, start=start)
    return as_record(columns, f"staircase {seed}")


@pytest.fixture(scope="module")
def recordings() -> list[Record]:
    return [staircase(seed) for seed in range(14)]


def small_compensator():
    """Learnt from a straight line with a deadband, for the tests of every kind."""
    u = np.linspace(-1, 1, 41)
    line = Characteristic(
        Signal("current", "1"), Signal("velocity", "m/s"), u, np.sign(u) * np.maximum(abs(u) - 0.1, 0)
    )
    return learn_compensator(line, None, None, [(0.5, 0.2), (1.0, 0.6)])


@pytest.fixture(scope="module")
def compensator(recordings):
    return learn_compensator(recordings, "current", "position", WAYPOINTS, settle=0.25, window=0.3)


def ramp_velocity(command: np.ndarray, time: np.ndarray) -> np.ndarray:
    return rig.record("spool_valve", command, time, effects=HIDDEN, start=0.3)["velocity"]


def test_on_the_rig_ramps_through_the_compensator_follow_the_designed_curve(compensator):
    time = np.arange(0.0, 20.0, 0.01)
    wanted = triangle(time)
    curve = desired_curve(WAYPOINTS)(wanted)
    commanded = simulate(compensator, Record(time, {"wanted_current": wanted}, {"wanted_current": "1"}))["current"]
    with_it, without = (ramp_velocity(u, time) - curve for u in (commanded, wanted))
    rms, bare = (float(np.sqrt(np.mean(e**2))) / 0.065 for e in (with_it, without))
    assert rms < 0.04 and bare > 0.2 and rms < 0.2 * bare


def test_the_compensated_machine_has_no_deadband_and_is_the_same_both_ways(compensator):
    time = np.arange(0.0, 20.0, 0.01)
    wanted = triangle(time)
    v = ramp_velocity(static_answer(compensator, wanted), time)
    small = (np.abs(wanted) > 0.15) & (np.abs(wanted) < 0.3)
    assert (np.sign(v[small]) == np.sign(wanted[small])).mean() > 0.97
    bare = ramp_velocity(wanted, time)
    half = np.abs(np.abs(wanted) - 0.5) < 0.05

    def lopsided(velocity):
        out, back = velocity[half & (wanted > 0)].mean(), -velocity[half & (wanted < 0)].mean()
        return abs(out - back) / (out + back)

    assert lopsided(v) < 0.03 < lopsided(bare)


def test_the_command_is_the_inverse_of_the_polynomial_and_never_falls(compensator):
    assert compensator.certificate.holds and compensator.certificate.difference > 0
    assert least_slope(compensator)[0] >= 0
    assert compensator.inputs[0].name == "wanted_current" and compensator.outputs[0].name == "current"


def test_a_compensator_comes_back_from_its_file_and_its_fmu_equals_its_python_run(compensator, tmp_path):
    time = np.arange(0.0, 4.0, 0.01)
    record = Record(time, {"wanted_current": np.sin(2 * time)}, {"wanted_current": "1"})
    expected = simulate(compensator, record)["current"]
    again = read_block(write_block(compensator, tmp_path / "c.toml")[0])
    assert np.array_equal(simulate(again, record)["current"], expected)
    fmu = read_fmu(export_fmu(compensator, tmp_path / "c.fmu"))
    assert np.abs(fmu.free_run(record)["current"] - expected).max() < 1e-9


def test_a_curve_through_its_waypoints_is_odd_and_stays_beyond_full():
    curve = desired_curve(WAYPOINTS)
    s, r = np.array(WAYPOINTS).T
    assert np.allclose(curve(s), r, rtol=1e-9) and np.allclose(curve(-s), -r, rtol=1e-9)
    assert curve(np.array([0.0]))[0] == 0 and curve(np.array([2.0]))[0] == pytest.approx(0.065)
    assert len(desired_curve(WAYPOINTS, degree=2).coefficients) == 2


@pytest.mark.parametrize(
    ("waypoints", "sentence"),
    [([(0.5, 0.03), (1.0, 0.01)], "falls near"), ([(0.0, 0.0), (1.0, 1.0)], "both positive"), ([(1, 2, 3)], "pairs")],
)
def test_a_curve_that_cannot_be_is_refused(waypoints, sentence):
    with pytest.raises(DataError, match=sentence):
        desired_curve(waypoints)


def test_a_degree_above_the_number_of_waypoints_is_refused():
    with pytest.raises(DeclarationError, match="degree must be 1 to 4"):
        desired_curve(WAYPOINTS, degree=5)


def test_a_curve_beyond_what_the_machine_reaches_is_refused_with_the_scale_that_fits():
    u = np.linspace(-1, 1, 101)
    weak = Characteristic(Signal("current", "1"), Signal("velocity", "m/s"), u, np.where(u > 0, 0.1 * u, 0.03 * u))
    with pytest.raises(DataError, match=r"reaches -0.03 to 0.1 m/s.* Scale the waypoints by 0.5"):
        learn_compensator(weak, None, None, [(0.5, 0.02), (1.0, 0.06)])
    fitting = learn_compensator(weak, None, None, [(0.5, 0.01), (1.0, 0.03)])
    assert static_answer(fitting, [1.0, -1.0]) == pytest.approx([0.3, -1.0], abs=1e-6)
