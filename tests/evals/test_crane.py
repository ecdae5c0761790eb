"""The crane of the examples: its geometry, its dynamics, and the circle it drives without feedback."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from examples.crane import inverses, kinematics, track
from examples.crane.model import Crane, TwoLinks, crane, plant
from examples.crane.rehearsal import AXES, holding_forces, recordings, steady_points
from hydrotwin.learned import write_block
from hydrotwin.learned.inverse.learn import learn_inverse
from hydrotwin.models.components import Freewheel
from hydrotwin.models.language import Component, Model, Output, connect
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.spool_valve import quasi_static
from hydrotwin.records import Record
from hydrotwin.simulation import lower, simulate

CIRCLE = kinematics.Circle()


@cache
def machine() -> Model:
    return plant()


@cache
def tracks() -> dict[str, track.Track]:
    return {way.name: track.drive(machine(), way) for way in track.ways(machine(), quick=True)}


@cache
def staircases(axis: str) -> tuple[Record, ...]:
    return tuple(recordings(machine(), axis, count=4))


def moved() -> Record:
    time = np.arange(0.0, 4.0, 0.01)
    currents = {"boom_current": 0.4 * np.sin(2 * time), "jib_current": -0.5 * np.sin(1.5 * time)}
    return simulate(machine(), Record(time, currents, dict.fromkeys(currents, "1")))


# -- geometry ------------------------------------------------------------------------------------------------------
def test_the_tip_of_the_moving_crane_is_where_the_chain_of_its_links_ends():
    run = moved()
    angles, (L1, L2) = run.array(["boom_angle", "jib_angle"]), kinematics.DRAWING.length
    chain = L1 * np.exp(1j * angles[:, 0]) + L2 * np.exp(1j * angles.sum(axis=1))
    assert np.ptp(chain.imag) > 0.1
    assert np.abs(kinematics.tip(angles) - np.column_stack([chain.real, chain.imag])).max() < 1e-12
    assert np.abs(kinematics.joint_angles(kinematics.tip(angles)) - angles).max() < 1e-9


def test_the_strokes_of_the_moving_crane_are_those_of_the_triangles():
    run = moved()
    angles, strokes = run.array(["boom_angle", "jib_angle"]), run.array(["boom_stroke", "jib_stroke"])
    assert np.abs(kinematics.strokes(angles) - strokes).max() < 1e-6
    assert np.abs(kinematics.angles_of(strokes) - angles).max() < 1e-5
    slope = (kinematics.strokes(angles + 1e-6) - kinematics.strokes(angles - 1e-6)) / 2e-6
    assert np.abs(kinematics.levers(angles) - slope).max() < 1e-8


def test_the_wanted_cylinder_velocities_carry_the_tip_around_the_circle():
    time = np.linspace(0, 27, 27001)
    v = kinematics.cylinder_velocities(CIRCLE, time)
    strokes = kinematics.strokes(kinematics.joint_angles(CIRCLE.place(time[:1])))
    travelled = strokes + np.vstack([[0, 0], np.cumsum((v[1:] + v[:-1]) / 2 * 1e-3, axis=0)])
    place = kinematics.tip(kinematics.angles_of(travelled))
    assert np.linalg.norm(place - CIRCLE.place(time), axis=1).max() < 1e-6
    assert np.linalg.norm(place - CIRCLE.centre, axis=1) == pytest.approx(np.full(len(time), CIRCLE.radius), abs=1e-6)
    assert np.abs(v).max() < 0.07


def test_a_place_out_of_reach_is_refused():
    with pytest.raises(ValueError, match=r"reaches 0\.5 m to 4\.5 m"):
        kinematics.joint_angles(np.array([[5.0, 1.0]]))


# -- dynamics ------------------------------------------------------------------------------------------------------
def test_at_rest_the_cylinders_carry_what_statics_says():
    for angles in ([0.3, -0.8], [0.8, -1.4]):
        start = {"links.boom_angle": angles[0], "links.jib_angle": angles[1]}
        x = dict(zip((s.name for s in machine().flat.states), machine().equilibrium({}, start), strict=True))
        values = {p.name: p.value for p in machine().flat.parameters}
        push = [
            x[f"{a}.cylinder.cap_pressure"] * values[f"{a}.cylinder.cap_area"]
            - x[f"{a}.cylinder.rod_pressure"] * values[f"{a}.cylinder.rod_area"]
            for a in AXES
        ]
        masses = tuple(values[f"links.{name}"] for name in ("boom_mass", "jib_mass", "payload"))
        expected = holding_forces(kinematics.strokes(np.array([angles])), masses)[0]
        assert push == pytest.approx(expected, rel=1e-6)


class Swinging(Component):
    """The two links without actuators: a double pendulum."""

    links = TwoLinks()
    ends = Freewheel()
    other = Freewheel()
    boom_angle = Output("rad", "theta_1")
    jib_angle = Output("rad", "theta_2")
    boom_rate = Output("rad/s", "w_1")
    jib_rate = Output("rad/s", "w_2")

    def equations(self):
        yield connect(self.links.boom_pin, self.ends.flange)
        yield connect(self.links.jib_pin, self.other.flange)
        for name in ("boom_angle", "jib_angle", "boom_rate", "jib_rate"):
            yield getattr(self, name) == getattr(self.links, name)


def test_swinging_freely_the_links_keep_their_energy():
    model = Model(Swinging(), step=1e-4)
    time = np.arange(0.0, 2.0, 0.01)
    run = simulate(model, Record(time, {}, {}), start={"links.boom_angle": -0.2, "links.jib_angle": -0.5})
    q, w = run.array(["boom_angle", "jib_angle"]), run.array(["boom_rate", "jib_rate"])
    (m1, m2, m), (L1, L2), g = (120.0, 60.0, 100.0), kinematics.DRAWING.length, 9.80665
    inner, outer = L1 * np.exp(1j * q[:, 0]), np.exp(1j * q.sum(axis=1))
    inner_speed, outer_speed = 1j * w[:, 0] * inner, 1j * w.sum(axis=1) * outer
    energy = m1 * (np.abs(inner_speed) ** 2 / 6 + g * inner.imag / 2)
    energy += m * (np.abs(inner_speed + L2 * outer_speed) ** 2 / 2 + g * (inner + L2 * outer).imag)
    energy += m2 * (np.abs(inner_speed + L2 / 2 * outer_speed) ** 2 / 2 + (L2 * np.abs(outer_speed)) ** 2 / 24)
    energy += m2 * g * (inner + L2 / 2 * outer).imag
    assert np.ptp(q[:, 1]) > 1.0
    assert np.ptp(energy) < 1e-6 * np.ptp(m * g * (inner + L2 * outer).imag)


# -- what is learnt ------------------------------------------------------------------------------------------------
def test_the_data_sheet_knows_neither_overlap_nor_play_nor_dead_time_of_the_plant():
    sheet, truth = ({p.name: p.value for p in m.flat.parameters} for m in (crane(), machine()))
    assert isinstance(machine().root, Crane)
    for name in ("boom.valve.supply_to_a.overlap", "jib.solenoid.dead_time", "jib.solenoid.offset", "links.boom_mass"):
        assert sheet[name] != truth[name]
    assert min(truth[f"spool_hysteresis_{a}_slide_target.half_width"] for a in AXES) >= 0.01


@pytest.mark.parametrize(("axis", "half_width", "dead_time"), [("boom", 0.010, 0.045), ("jib", 0.012, 0.06)])
def test_the_staircases_show_the_play_of_the_spool_and_how_late_it_is(axis, half_width, dead_time):
    records = list(recordings(machine(), axis))
    points = steady_points(records, axis)
    assert inverses.loaded_valve(points, axis).half_width == pytest.approx(half_width, abs=4e-3)
    late = inverses.lateness(records, axis, inverses.curve(points, axis))
    assert dead_time < late < dead_time + 0.06  # the spool's lag is part of it


@pytest.mark.proof
def test_the_identified_model_finds_the_deadband_of_a_valve_with_unequal_edges():
    model, currents = inverses.identified(list(staircases("jib")), "jib")
    found = {p.name: p.value for p in model.flat.parameters}
    assert 0.11 < found["command_deadband.width"] < 0.17
    u = currents(np.array([-1e-3, 1e-3]), np.zeros((2, 2)))
    assert u[0] < -0.1 and u[1] > 0.1


# -- the circle ----------------------------------------------------------------------------------------------------
def test_every_compensation_brings_the_tip_closer_to_the_circle():
    error = {name: t.rms for name, t in tracks().items()}
    assert error["table, dead time"] < 0.6 * error["straight line, dead time"]
    assert error["table, dead time, play"] < error["table, dead time"]
    assert error["valve under load, dead time"] < 0.7 * error["table, dead time"]
    assert error["valve under load, dead time, play"] < 0.8 * error["valve under load, dead time"]


def test_without_feedback_the_tip_stays_within_centimetres():
    best = tracks()["valve under load, dead time, play"]
    assert best.rms < 0.04 and best.largest < 0.08
    assert best.mean <= best.rms <= best.largest and best.error[0] < 1e-6


def test_a_forward_block_of_an_axis_gives_the_inverse_of_its_velocity():
    forward = lower(quasi_static(), 0.01)
    currents, v = inverses.learned_from_block(forward, "boom"), np.array([-0.05, 0.02, 0.08])
    time = np.arange(0.0, 1.0, 0.01)
    for wanted, u in zip(v, currents(v, np.zeros((3, 2))), strict=True):
        run = simulate(forward, Record(time, {"current": np.full_like(time, u)}, {"current": "1"}))
        assert run["velocity"][-1] == pytest.approx(wanted, abs=5e-4)


def test_what_is_no_forward_block_of_an_axis_is_refused(tmp_path, capsys):
    block = learn_inverse(inverses.curve(steady_points(list(staircases("boom")), "boom"), "boom"))
    with pytest.raises(DataError, match="not a forward block of one axis"):
        inverses.learned_from_block(block, "boom")
    path, _ = write_block(block, tmp_path / "inverse.toml")
    asked = ["--quick", "--forward", f"boom={path}", "--forward"]
    for other, sentence in ((f"jibe={path}", "needed for each of boom, jib"), ("jib=none.toml", "no such file")):
        with pytest.raises(SystemExit):
            track.main([*asked, other])
        assert sentence in capsys.readouterr().err


def test_the_figure_shows_every_path_and_every_error(tmp_path):
    shown = list(tracks().values())
    track.write_figure(shown, tmp_path / "track.html")
    page = (tmp_path / "track.html").read_text(encoding="utf-8")
    assert all(page.count(t.way) >= 2 for t in shown) and "error of the tip [cm]" in page
    assert "6.85" in track.told(shown) and track.told(shown).count("\n") == len(shown) + 1
