"""Effects on sensors, held against what their equations say."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models import cehA
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.effects.sensor import SensorSaturation
from hydrotwin.models.language import Model
from tests.effects.benches import axis, pass_on, passed, play, seen, turning_table

TIME = np.arange(0.0, 2.0, 1e-3)
STEP = np.where(TIME < 0.1, 0.0, 3.0)


def sine(frequency):
    return 3.0 * np.sin(2 * np.pi * frequency * TIME)


def test_a_bias_is_added_to_the_reading():
    np.testing.assert_allclose(passed("sensor_bias", "reading", TIME, sine(2), offset=-0.3), sine(2) - 0.3, atol=1e-12)


def test_a_drift_grows_with_time():
    np.testing.assert_allclose(
        passed("sensor_drift", "reading", TIME, sine(2), rate=-0.3), sine(2) - 0.3 * TIME, atol=1e-12
    )


def test_a_wrong_scale_multiplies_the_reading():
    np.testing.assert_allclose(passed("sensor_scale", "reading", TIME, sine(2), error=0.04), 1.04 * sine(2), atol=1e-12)


def test_a_curved_characteristic_is_right_at_zero_and_at_full_scale_and_steepest_there():
    ramp = np.linspace(-4.0, 4.0, len(TIME))
    reading = passed("sensor_curvature", "reading", TIME, ramp, curvature=0.4)
    assert reading[[0, -1]] == pytest.approx([-4.0, 4.0])
    slope = np.gradient(reading, ramp)
    assert slope[1000] == pytest.approx(0.6, abs=0.01) and slope[-1] == pytest.approx(1.4, abs=0.01)
    np.testing.assert_allclose(reading, -reading[::-1], atol=1e-9)


def test_a_reading_stays_within_the_range_of_the_sensor():
    reading = passed("sensor_saturation", "reading", TIME, sine(2), limit=2.0)
    np.testing.assert_allclose(reading, np.clip(sine(2), -2.0, 2.0), atol=1e-12)
    assert all(0 < probe["limit"] < 3.0 for probe in SensorSaturation.probes_for({"u": sine(2)}))


def test_a_slow_sensor_follows_a_step_exponentially():
    reading = passed("sensor_lag", "reading", TIME, STEP, time_constant=0.05)
    expected = 3.0 * (1 - np.exp(-np.maximum(TIME - 0.0995, 0) / 0.05))
    np.testing.assert_allclose(reading, expected, atol=0.02 * 3.0)


@pytest.mark.parametrize("time_constant", [2e-4, 5e-4, 1e-3, 5e-3])
def test_a_fast_sensor_is_a_lag_for_fast_motion_too(time_constant):
    """Below the smallest lag that the step of the model follows, at 40 Hz; written as in `followed` it is 1.6 % off."""
    flat = add_effect(pass_on(), "sensor_lag", "reading", {"time_constant": time_constant}).flat
    p, unit = flat.parameter_vector(), np.eye(3)
    columns = [flat.ode(0, x, [u], p) for x, u in (*((x, 0.0) for x in unit), (np.zeros(3), 1.0))]
    rates, readings = (np.column_stack([np.array(c[k]).ravel() for c in columns]) for k in (0, 1))
    s = 2j * np.pi * 40.0
    states = np.linalg.solve(s * unit - rates[:, :3], rates[:, 3])
    assert readings[0, :3] @ states + readings[0, 3] == pytest.approx(1 / (1 + s * time_constant), abs=2.5e-3)


@pytest.mark.parametrize("delay", [0.001, 0.005, 0.02, 0.1])
def test_a_late_sensor_shows_a_slow_motion_as_it_was(delay):
    reading = passed("sensor_delay", "reading", TIME, sine(1.0), time=delay)
    expected = 3.0 * np.sin(2 * np.pi * 1.0 * (TIME - delay))
    np.testing.assert_allclose(reading[1000:], expected[1000:], atol=2e-3 * 3.0)


@pytest.mark.parametrize(("frequency", "off"), [(5.0, 1e-3), (10.0, 2e-3)])
def test_a_late_sensor_keeps_the_height_of_faster_motion_and_its_delay(frequency, off):
    """At 10 Hz and 50 ms it is half a turn late."""
    delay = 0.05
    reading = passed("sensor_delay", "reading", TIME, sine(frequency), time=delay)[1000:]
    turn = np.exp(-2j * np.pi * frequency * TIME[1000:])
    ratio = np.sum(reading * turn) / np.sum(sine(frequency)[1000:] * turn)
    assert ratio == pytest.approx(np.exp(-2j * np.pi * frequency * delay), abs=off)


@pytest.mark.parametrize(("step", "lag"), [(1e-4, 4e-3), (1e-2, 4e-2)])
def test_no_state_of_a_late_sensor_is_faster_than_the_step_of_the_model_follows(step, lag):
    """The fastest has 6.8 / T_0; Runge-Kutta of order four follows up to 2.7 / step."""
    coarse = Model(axis().root, step=step)
    flat = add_effect(coarse, "sensor_delay", "position").flat
    assert {p.name: p.value for p in flat.parameters}["sensor_delay_position.resolution"] == pytest.approx(lag)
    assert 6.8 / lag < 2.7 / step


def test_a_quantised_reading_is_a_multiple_of_the_step_almost_everywhere():
    q = 0.2
    reading = passed("quantisation", "reading", TIME, sine(1.0), step=q)
    off = np.abs(reading / q - np.round(reading / q))
    assert np.mean(off < 0.02) > 0.9
    assert np.max(np.abs(reading - sine(1.0))) <= q / 2 * (1 + 1e-6)


def test_a_quantised_reading_follows_the_signal_on_average_and_has_a_finite_slope():
    model = add_effect(axis(), "quantisation", "position", {"step": 0.01})
    flat = model.flat
    p = flat.parameter_vector()
    places = np.linspace(0.0, 0.1, 2001)
    seen = np.array([float(flat.ode(0, [s, 0.0], [0.0], p)[1][0]) for s in places])
    slope = np.diff(seen) / np.diff(places)
    assert np.isfinite(slope).all()
    assert slope.mean() == pytest.approx(1.0, rel=1e-3)


def test_a_quantised_reading_has_the_variance_that_the_noise_floor_allows_for():
    q = 0.02
    error = passed("quantisation", "reading", TIME, sine(1.3), step=q) - sine(1.3)
    assert np.var(error) == pytest.approx(q**2 / 12, rel=0.1)


@pytest.mark.parametrize(("h", "offset"), [(0.3, 0.0), (0.3, 1.0), (0.02, -1.0), (0.6, 0.0)])
def test_a_sensor_with_hysteresis_reads_what_the_play_operator_gives(h, offset):
    """Reversals inside the play included: of the largest the reading does not move at all."""
    signal = sine(2) + 0.5 * np.sin(2 * np.pi * 9 * TIME)
    reading = passed("sensor_hysteresis", "reading", TIME, signal, half_width=h, offset=offset)
    fine = np.interp(np.arange(0.0, TIME[-1], 1e-5), TIME, signal)
    expected = np.interp(TIME, np.arange(0.0, TIME[-1], 1e-5), play(fine, h, offset))
    np.testing.assert_allclose(reading, expected, atol=2e-3 * 3.0)


def test_a_small_play_leaves_the_reading_behind_the_motion():
    small = 1e-3
    rate = np.cos(2 * np.pi * 2 * TIME)
    behind = passed("sensor_hysteresis", "reading", TIME, sine(2), half_width=small) - sine(2)
    clear = (np.abs(rate) > 0.1) & (TIME > 0.01)
    np.testing.assert_allclose(behind[clear], -small * np.sign(rate[clear]), atol=1e-6)


@pytest.mark.parametrize(("lead", "slope"), [(0.01, -1.0), (-0.01, 1.0)])
def test_the_derivative_by_a_play_that_is_not_there_is_that_of_a_small_one(lead, slope):
    """By it the screen finds the effect: one way while the quantity leads, the other way where it goes back."""
    flat = add_effect(pass_on(), "sensor_hysteresis", "reading").flat
    t, x, u, p = flat.ode.sx_in()
    by_parameters = ca.Function("by_parameters", [t, x, u, p], [ca.jacobian(flat.ode(t, x, u, p)[1], p)])
    where = [q.name for q in flat.parameters].index("sensor_hysteresis.half_width")
    state = [-lead if s.name == "sensor_hysteresis.dragged" else 0.0 for s in flat.states]
    assert float(by_parameters(0.0, state, [0.0], flat.parameter_vector())[0, where]) == pytest.approx(slope)


@pytest.mark.parametrize(
    "effect",
    ["sensor_lag", "sensor_delay", "sensor_bias", "sensor_drift", "sensor_scale", "sensor_hysteresis", "quantisation"],
)
def test_a_state_that_a_doubtful_sensor_measures_starts_from_its_first_sample_nonetheless(effect):
    model = add_effect(axis(), effect, "position")
    assert {s.name: s.measured_by for s in model.flat.states}["carriage.position"] == "position"


def test_a_reading_that_arrives_late_starts_where_the_machine_stands():
    reading = passed("sensor_delay", "reading", TIME, np.full(len(TIME), 2.0), time=0.1)
    np.testing.assert_allclose(reading, 2.0, atol=1e-9)


def test_a_sensor_may_read_more_in_one_direction_and_nothing_of_little():
    uneven = passed("sensor_asymmetry", "reading", TIME, sine(2), asymmetry=0.1)
    np.testing.assert_allclose(uneven, np.where(sine(2) > 0, 1.1, 0.9) * sine(2), atol=1e-12)
    short = passed("sensor_deadband", "reading", TIME, sine(2), width=0.5)
    np.testing.assert_allclose(short, np.sign(sine(2)) * np.maximum(np.abs(sine(2)) - 0.5, 0), atol=1e-6)


def test_positions_and_pressures_have_no_zero_that_a_sensor_could_miss():
    for effect in ("sensor_asymmetry", "sensor_deadband"):
        assert [c.site.name for c in candidates(cehA.model(), [effect])] == ["motor_speed", "piston_force"]
        assert [c.site.name for c in candidates(axis(), [effect])] == ["velocity"]


def test_a_sensor_whose_frame_bends_reads_more_by_the_compliance_times_the_force():
    """The force is that of the piston less its friction: A_cap p_cap - A_rod p_rod - b v."""
    model = cehA.model()
    places = {c.site.name: c for c in candidates(model, ["load_deflection"])}
    assert list(places) == ["arm_angle", "rod_position"]
    states = {"arm__angle": 0.3, "cylinder__cap_pressure": 5e6, "cylinder__rod_pressure": 1e6}
    (force,) = seen(model, ["piston_force"], [0.0], **states)
    for output, compliance in (("arm_angle", 2e-6), ("rod_position", 1e-7)):
        bent = add_effect(model, "load_deflection", output, {"compliance": compliance})
        straight, read = (seen(m, [output], [0.0], **states)[0] for m in (model, bent))
        assert read - straight == pytest.approx(compliance * force, rel=1e-9)
        others = [o.name for o in model.flat.outputs if o.name != output]
        np.testing.assert_array_equal(*(seen(m, others, [0.0], **states) for m in (model, bent)))


def test_an_angle_sensor_bends_under_the_torque():
    bent = add_effect(turning_table(), "load_deflection", values={"compliance": 1e-3})
    (reading,) = seen(bent, ["angle"], [12.0], table__angle=0.4)
    assert reading == pytest.approx(0.4 + 1e-3 * 12.0)
    (found,) = candidates(turning_table(), ["load_deflection"])
    assert found.addition.part.declared("compliance").unit == "rad/(N.m)"
