"""Recordings: reproducible, inside the machine's span, with the noise and sampling that were asked for."""

from __future__ import annotations

import time as clock

import numpy as np
import pytest

from tests import rig
from tests.rig.excitation import KINDS


@pytest.fixture(scope="module", params=sorted(rig.MACHINES))
def recordings(request):
    train, validate = (rig.clean_recordings(request.param, kind, seed=1) for kind in ("train", "validate"))
    return request.param, train, validate


def test_three_to_train_and_two_to_validate_of_forty_seconds(recordings):
    machine, train, validate = recordings
    m = rig.MACHINES[machine]
    assert (len(train), len(validate)) == (3, 2)
    for run in train + validate:
        assert list(run) == ["time", m.input, *m.outputs]
        assert run["time"][-1] == 40.0
        assert len(run["time"]) == 4001
    commands = [run[m.input] for run in train + validate]
    pairs = [abs(np.corrcoef(a, b)[0, 1]) for i, a in enumerate(commands) for b in commands[:i]]
    assert max(pairs) < 0.5


def test_a_drive_command_starts_at_rest_pauses_and_stays_inside(recordings):
    machine, train, validate = recordings
    m = rig.MACHINES[machine]
    for run in train + validate:
        u, position = run[m.input], run[m.position]
        room = 0.15 * (m.span[1] - m.span[0])
        assert not u[:40].any()
        assert np.mean(u == 0) > 0.05
        assert m.span[0] - room < position.min() and position.max() < m.span[1] + room
        assert 0.3 * m.command_limit < np.max(np.abs(u)) <= m.command_limit
        assert np.max(np.abs(np.diff(u))) < 0.15 * m.command_limit
        if machine == "cehA":
            assert np.deg2rad(-25) < run["arm_angle"].min() and run["arm_angle"].max() < np.deg2rad(60)


def test_replaying_the_recorded_command_gives_the_recording_but_for_noise(recordings):
    machine, train, _ = recordings
    m = rig.MACHINES[machine]
    replay = rig.record(machine, train[0][m.input], train[0]["time"])
    for name, sigma in rig.sensor_noise(machine).items():
        error = train[0][name] - replay[name]
        assert np.std(error) == pytest.approx(sigma, rel=0.05)
        assert abs(np.mean(error)) < 4 * sigma / np.sqrt(len(error))


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(recordings, tmp_path):
    machine, train, _ = recordings
    units = rig.file_units(machine)
    files = []
    for i, seed in enumerate((1, 1, 2)):
        columns = rig.clean_recordings(machine, "train", 1, seed=seed)[0]
        files.append(rig.write_csv(columns, tmp_path / f"{i}.csv", units=units).read_bytes())
    assert files[0] == files[1] != files[2]
    back = rig.read_csv(tmp_path / "0.csv")
    assert np.array_equal(back["time"], train[0]["time"])
    for name, sigma in rig.sensor_noise(machine).items():
        assert back[name] == pytest.approx(train[0][name], abs=0.01 * sigma)


def test_noise_on_one_channel_leaves_the_others_as_they_were():
    time = np.arange(101) / 100
    both = rig.record("cehA", np.zeros(101), time, noise={"arm_angle": 1e-4, "motor_speed": 1.0}, seed=7)
    one = rig.record("cehA", np.zeros(101), time, noise={"motor_speed": 1.0}, seed=7)
    assert np.array_equal(both["motor_speed"], one["motor_speed"])
    assert np.ptp(one["arm_angle"]) < 1e-10


def test_quantisation_rounds_what_is_recorded():
    time = np.arange(101) / 100
    run = rig.record("cehA", np.ones(101), time, quantisation={"arm_angle": 1e-3}, noise={"arm_angle": 1e-4})
    assert run["arm_angle"] / 1e-3 == pytest.approx(np.round(run["arm_angle"] / 1e-3), abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("machine", sorted(rig.MACHINES))
def test_every_kind_of_command_stays_inside_with_jitter_too(machine, kind):
    m = rig.MACHINES[machine]
    time, command = rig.drive(machine, 10.0, kind=kind, seed=6, jitter=0.3)
    run = rig.record(machine, command, time)
    room = 0.16 * (m.span[1] - m.span[0])
    assert np.ptp(np.diff(time)) > 0.2 / 100
    assert np.std(command) > 0.05 * m.command_limit
    assert m.span[0] - room < run[m.position].min() and run[m.position].max() < m.span[1] + room


def test_the_command_found_for_a_machine_with_effects_keeps_that_machine_inside():
    hidden = {"motor_droop": {"resistance": 50.0}, "command_deadband": {"width": 0.1}}
    run = rig.clean_recordings("cehA", "train", 1, seed=3, effects=hidden, noise={})[0]
    low, high = rig.MACHINES["cehA"].span
    assert low - 0.016 < run["rod_position"].min() and run["rod_position"].max() < high + 0.016


@pytest.mark.parametrize("machine", sorted(rig.MACHINES))
def test_forty_seconds_take_a_tenth_of_them_at_most(machine):
    time, command = rig.drive(machine, 40.0, seed=1)
    begin = clock.process_time()
    rig.record(machine, command, time)
    assert clock.process_time() - begin < 4.0  # half a second on a free machine


def test_parameters_are_changed_by_name_and_the_base_length_follows():
    time = np.arange(11) / 10
    wide = rig.record("cehA", np.zeros(11), time, parameters={"arm.pin_length": 0.2}, start=0.0)
    assert wide["rod_position"] == pytest.approx(np.zeros(11), abs=1e-9)
    with pytest.raises(KeyError, match="no parameter"):
        rig.record("cehA", np.zeros(11), time, parameters={"motor.gian": 1.0})


def test_a_machine_that_leaves_its_volumes_is_reported_with_the_time():
    time = np.arange(1001) / 100
    with pytest.raises(RuntimeError, match="t ="):
        rig.record("cehA", np.full(1001, 5.0), time)


def test_time_must_rise_and_match_the_command():
    with pytest.raises(ValueError, match="time must rise"):
        rig.record("cehA", np.zeros(3), np.array([0.0, 0.0, 1.0]))


def test_the_friction_test_shows_the_stribeck_curve():
    run = rig.friction_test((0.002, 0.01, 0.05), noise=(0.0, 0.0))
    moving = np.isclose(run["velocity"], 0.01)
    expected = 1.87 + (13.15 - 1.87) * np.exp(-((0.01 / 0.0028) ** 2)) + 741.36 * 0.01
    assert run["force"][moving] == pytest.approx(np.full(moving.sum(), expected))
    assert moving.sum() >= 150
    dry = rig.friction_test((0.01,), noise=(0.0, 0.0), effects={"coulomb_friction": {"force": 50.0}})
    assert np.median(dry["force"][dry["velocity"] == dry["velocity"].max()]) == pytest.approx(expected + 50.0)
