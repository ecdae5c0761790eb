"""Under a controller: the command that it puts out, replayed, gives the recording that it saw."""

from __future__ import annotations

import numpy as np
import pytest

from tests import rig

SECONDS = 6.0


def effects_of(limit):
    """Effects of the command, alone and in a row."""
    dead, play = {"dead_time": {"seconds": 0.0137}}, {"spool_hysteresis": {"width": 0.05 * limit}}
    band, rate = {"command_deadband": {"width": 0.02 * limit}}, {"rate_limit": {"rate": limit}}
    return {"none": {}, "dead_time": dead, "play": play, "rate": rate, "all": {**dead, **play, **band, **rate}}


@pytest.mark.parametrize("which", effects_of(1.0))
@pytest.mark.parametrize("machine", ["cehA", "spool_valve", "winch", "lift_boom"])
def test_the_command_that_was_put_out_gives_what_the_controller_saw(machine, which):
    m, time, seen = rig.machine_of(machine), np.arange(round(SECONDS * 100) + 1) / 100, []
    controller, hidden = rig.tracking(machine, time, 1), effects_of(m.command_limit)[which]

    def watched(k, outputs):
        seen.append([outputs[name] for name in m.outputs])
        return controller(k, outputs)

    run = rig.record_closed_loop(machine, watched, time, effects=hidden)
    replayed = np.column_stack([run[name] for name in m.outputs])
    assert np.max(np.abs(replayed - seen) / m.noise) < 1e-6
    plain = rig.record(machine, run[m.input], time)
    shown = max(np.max(np.abs(run[n] - plain[n]) / s) for n, s in rig.sensor_noise(machine).items())
    assert shown > 1 if hidden else shown == 0


@pytest.mark.parametrize("machine", ["cehA", "spool_valve", "winch", "lift_boom"])
def test_a_tracking_controller_moves_the_machine_and_works_against_a_leak(machine):
    m, time = rig.machine_of(machine), np.arange(1501) / 100
    free, leaking = (
        rig.record_closed_loop(machine, rig.tracking(machine, time, 2), time, effects=effects)
        for effects in (None, {"internal_leakage": {}})
    )
    assert m.span[0] < free[m.position].min() and free[m.position].max() < m.span[1]
    assert np.std(free[m.input]) > 0.05 * m.command_limit
    open_loop = rig.record(machine, free[m.input], time, effects={"internal_leakage": {}})[m.position]
    away = [np.max(np.abs(x - free[m.position])) for x in (leaking[m.position], open_loop)]
    assert away[0] < 0.7 * away[1]


def test_a_controller_sees_the_truth_and_its_sensor_is_written_down():
    time = np.arange(301) / 100
    biased = {"sensor_bias": {"output": "rod_position", "value": 1e-3}}
    plain, run = (
        rig.record_closed_loop("cehA", rig.tracking("cehA", time, 1), time, effects=e) for e in (None, biased)
    )
    assert np.array_equal(run["command"], plain["command"])
    assert run["rod_position"] - plain["rod_position"] == pytest.approx(np.full(301, 1e-3))


def test_what_has_no_place_in_a_loop_is_said():
    time = np.arange(11) / 100
    with pytest.raises(ValueError, match="controller of its own"):
        rig.tracking("test_cylinder", time)
    with pytest.raises(ValueError, match="not in a loop"):
        rig.record_closed_loop("cehA", lambda k, y: 0.0, time, effects={"packet_loss": {}})


def test_a_machine_lost_in_a_loop_is_an_error_or_keeps_its_last_command():
    time = np.arange(1001) / 100
    with pytest.raises(RuntimeError, match="left its volumes"):
        rig.record_closed_loop("cehA", lambda k, y: 5.0, time)
    held = rig.record_closed_loop("cehA", lambda k, y: 5.0, time, hold_after_loss=True)
    assert np.all(held["command"] == 5.0) and np.ptp(held["arm_angle"][-100:]) == 0
