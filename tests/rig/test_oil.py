"""Oil that tears and lines that take pressure: checked by conservation and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests import rig

HARD = {"precharge": 3e5}  # a low precharge, so that hard steps pull the oil apart


@pytest.fixture(scope="module")
def steps():
    return rig.drive("cehA", 10.0, 100.0, seed=101, kind="steps", parameters=HARD)


@pytest.mark.parametrize("machine", sorted(rig.MACHINES))
def test_oil_that_is_never_pulled_apart_runs_as_if_it_could_not_tear(machine):
    time, command = rig.drive(machine, 10.0, seed=5)
    plain = rig.record(machine, command, time)
    whole = rig.record(machine, command, time, effects={"cavitation": {"pressure": 0.0}})
    for name, sigma in rig.sensor_noise(machine).items():
        assert whole[name] == pytest.approx(plain[name], abs=2e-3 * sigma)


def test_pressure_never_falls_below_the_one_at_which_oil_tears(steps):
    time, command = steps
    plain = rig.record("cehA", command, time, parameters=HARD)
    torn = rig.record("cehA", command, time, parameters=HARD, effects={"cavitation": {"pressure": 1e5}})
    assert plain["pressure_rod"].min() < -5e5
    assert torn["pressure_rod"].min() == pytest.approx(1e5, abs=1e-3)
    assert np.mean(torn["pressure_rod"] < 1.0001e5) > 0.001


def test_the_oil_of_a_torn_column_is_neither_made_nor_lost(steps):
    time, command = steps
    p = rig.MACHINES["cehA"].parameters
    run = rig.record("cehA", command, time, parameters=HARD, effects={"cavitation": {"pressure": 1e5}}, step=1e-5)
    beta, x = p["cylinder.oil.bulk_modulus"], run["rod_position"]
    room = p["cylinder.rod_dead_volume"] - p["cylinder.rod_area"] * x
    held = room * np.exp((run["pressure_rod"] - 1e5) / beta)
    whole = run["pressure_rod"] > 1.01e5
    ratio = p["cylinder.rod_area"] / p["cylinder.cap_area"]
    given = -ratio * p["pump.displacement"] * _integral(run, command, time)
    error = held - held[0] - given
    assert np.any(~whole)
    assert np.max(np.abs(error[whole])) < 3e-3 * np.ptp(given)
    assert np.max(error[~whole]) > 10 * np.max(np.abs(error[whole]))  # the void: room that oil does not fill


def _integral(run, command, time):
    """Revolutions [rad] of a motor that follows held commands by a lag: exact for the speed at the samples."""
    decay = np.exp(-np.diff(time) / 0.03)
    target = 120.0 * command[:-1]
    w, turned = 0.0, [0.0]
    for a, goal, h in zip(decay, target, np.diff(time), strict=True):
        turned.append(turned[-1] + goal * h + (w - goal) * 0.03 * (1 - a))
        w = goal + (w - goal) * a
    return np.array(turned)


def test_a_torn_column_moves_the_machine_away_from_where_solid_oil_holds_it(steps):
    time, command = steps
    plain = rig.record("cehA", command, time, parameters=HARD)
    torn = rig.record("cehA", command, time, parameters=HARD, effects={"cavitation": {"pressure": 1e5}})
    assert np.max(np.abs(torn["arm_angle"] - plain["arm_angle"])) > 10 * rig.sensor_noise("cehA")["arm_angle"]


@pytest.mark.parametrize("other", ["entrained_air", "line_compliance"])
def test_torn_oil_and_oil_with_gas_are_not_mixed(other):
    with pytest.raises(ValueError, match="beside"):
        rig.record("cehA", np.zeros(3), np.arange(3) / 10, effects={"cavitation": {}, other: {}})


def steady(effects):
    """Speed and pressures at a steady spool opening of one half, out, after four seconds."""
    time = np.arange(401) / 100
    run = rig.record("spool_valve", np.full(401, 0.5), time, effects=effects, start=0.2)
    return run["velocity"][-1], run["pressure_a"][-1], run["pressure_b"][-1]


def test_a_line_takes_its_pressure_off_the_flow_through_the_metering_edges():
    p, R, K = rig.MACHINES["spool_valve"].parameters, 2e9, 1e14
    v, pa, pb = steady({"line_friction": {"laminar": R, "turbulent": K}})
    g = 0.5 * p["valve.orifice.flow_coefficient"]
    for area, dp in ((p["cylinder.cap_area"], 180e5 - pa), (p["cylinder.rod_area"], pb - 5e5)):
        q = area * v
        assert R * q + K * q**2 + (q / g) ** 2 == pytest.approx(dp, rel=2e-4)
    assert v < 0.97 * steady(None)[0]


def test_a_line_that_takes_almost_nothing_is_no_line():
    time, command = rig.drive("spool_valve", 5.0, seed=2)
    plain = rig.record("spool_valve", command, time)
    free = rig.record("spool_valve", command, time, effects={"line_friction": {"laminar": 1.0, "turbulent": 1.0}})
    for name, sigma in rig.sensor_noise("spool_valve").items():
        assert free[name] == pytest.approx(plain[name], abs=1e-3 * sigma)
