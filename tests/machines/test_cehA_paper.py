"""What the C-EHA paper prints, held against what its own equations imply."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models import cehA
from hydrotwin.models.cehA.model import ForceActuator
from hydrotwin.models.language import Model, State, UnitError, der
from hydrotwin.simulation import simulate
from tests.components.bench import at, bench, jacobian
from tests.machines.recordings import rig_record

A_CAP, A_ROD, BETA, C_P, V0 = 8.042e-4, 6.319e-4, 1.747e9, 1.05e-7, 8e-5
L_PIN, D = 0.225, np.sqrt(0.3055**2 - 0.225**2)
H1, H2 = (46.7 + 1.64 / 3) * 0.488**2, (46.7 + 1.64 / 2) * 9.80665 * 0.488
FK, FS, FV, VS, SMOOTH = 1.87, 13.15, 741.36, 0.0028, 1e-3


def length(theta):
    return np.sqrt(L_PIN**2 + D**2 + 2 * L_PIN * D * np.sin(theta))


def lever(theta):
    """l sin(alpha), alpha between arm and actuator: by the law of sines d cos(theta)/s."""
    return L_PIN * D * np.cos(theta) / length(theta)


def lever_slope(theta):
    s = length(theta)
    return -L_PIN * D * np.sin(theta) / s - (L_PIN * D * np.cos(theta)) ** 2 / s**3


def friction(v):
    return (FK + (FS - FK) * np.exp(-((v / VS) ** 2))) * np.tanh(v / SMOOTH) + FV * v


def friction_rate(v, a):
    """Eq. 9, with the derivative of the smoothed sign."""
    bell = (FS - FK) * np.exp(-((v / VS) ** 2))
    sign, slope = np.tanh(v / SMOOTH), (1 - np.tanh(v / SMOOTH) ** 2) / SMOOTH
    return (-2 * bell * v / VS**2 * sign + (FK + bell) * slope + FV) * a


def equation_16(x, *, with_lever_rate=True):
    """theta''' from Eq. 16 with the consistent T1, T2 and l sin(alpha); x = speed, pressures, angle, rate."""
    w, p1, p2, theta, rate = x
    h, dh = lever(theta), lever_slope(theta)
    stroke, v = length(theta) - 0.3055, h * rate
    F = p1 * A_CAP - p2 * A_ROD
    acceleration = (h * (F - friction(v)) - H2 * np.cos(theta)) / H1
    a = h * acceleration + dh * rate**2
    V1, V2 = V0 + A_CAP * stroke, V0 - A_ROD * stroke
    T1 = BETA * (A_CAP**2 / V1 + A_ROD**2 / V2)
    T2 = BETA * C_P * (A_CAP / V1 + A_ROD**2 / (A_CAP * V2))
    jerk = H2 / H1 * np.sin(theta) * rate + h / H1 * (-T1 * v - friction_rate(v, a) + T2 * w)
    return jerk + with_lever_rate * dh * rate * (F - friction(v)) / H1


def jerk_of(model):
    """Time derivative of the angular acceleration along the model's own ODE."""
    t, x, u, p = model.flat.ode.sx_in()
    rates = model.flat.ode(t, x, u, p)[0]
    return ca.Function("jerk", [t, x, u, p], [ca.jtimes(rates[4], x, rates)])


def states_on_a_run():
    record = rig_record("cehA", "steps")
    y = simulate(cehA.model(), record)
    rate = np.gradient(y["arm_angle"], y.time)
    return np.stack([y["motor_speed"], y["pressure_cap"], y["pressure_rod"], y["arm_angle"], rate], axis=1)[5:-5:7]


def test_corrected_equation_16_is_the_jerk_of_the_full_model():
    model, states = cehA.model(), states_on_a_run()
    jerk, p = jerk_of(model), model.flat.parameter_vector()
    found = np.array([float(jerk(0, x, [0], p)) for x in states])
    assert np.array([equation_16(x) for x in states]) == pytest.approx(found, rel=1e-8, abs=1e-8 * np.abs(found).max())


def test_the_lever_rate_that_equation_15_drops_is_twice_the_gravity_term_it_keeps_yet_little_against_the_oil():
    """In quiet motion at full speed; the oil's T1 v is a thousand times either, so the angle hardly shows it."""
    theta, v = 0.3, 0.078
    rate, load = v / lever(theta), H2 * np.cos(theta) / lever(theta)
    kept = H2 / H1 * np.sin(theta) * rate
    dropped = lever_slope(theta) * rate * load / H1
    oil = lever(theta) / H1 * BETA * (A_CAP**2 + A_ROD**2) / V0 * v
    assert dropped / kept == pytest.approx(-2.19, abs=0.01)
    assert 3e-4 < abs(dropped) / oil < 1e-3
    x = np.array([480.0, 4e6, 2e6, theta, rate])
    F = x[1] * A_CAP - x[2] * A_ROD
    missing = lever_slope(theta) * rate * (F - friction(v)) / H1
    assert equation_16(x) - equation_16(x, with_lever_rate=False) == pytest.approx(missing)


class PrintedEquation7(ForceActuator):
    """Eq. 7 as printed: ``beta c_p (A1^2/V1 + A2^2/V2) x' + beta c_p (A1/V1 - A2^2/(V1 V2)) w``."""

    def printed(self, first, second, v):
        yield der(self.force) == first * v + second * self.shaft.w
        yield -self.rod.f == self.force - self.friction.force(v)
        yield self.shaft.tau == self.displacement * self.force / self.cap_area

    def equations(self):
        V1 = self.cap_dead_volume + self.cap_area * self.rod.s
        V2 = self.rod_dead_volume - self.rod_area * self.rod.s
        yield from self.printed(*self.terms(self.oil.bulk_modulus, self.displacement, V1, V2), der(self.rod.s))

    def terms(self, beta, c_p, V1, V2):
        A1, A2 = self.cap_area, self.rod_area
        return beta * c_p * (A1**2 / V1 + A2**2 / V2), beta * c_p * (A1 / V1 - A2**2 / (V1 * V2))


class PrintedT2(PrintedEquation7):
    """T1 of Eq. 16, which has no c_p, with the printed T2."""

    def terms(self, beta, c_p, V1, V2):
        A1, A2 = self.cap_area, self.rod_area
        return -beta * (A1**2 / V1 + A2**2 / V2), beta * c_p * (A1 / V1 - A2**2 / (V1 * V2))


class PrintedSign(PrintedEquation7):
    """Consistent units, but the velocity term without its minus sign, as in Eq. 7."""

    def terms(self, beta, c_p, V1, V2):
        A1, A2 = self.cap_area, self.rod_area
        return beta * (A1**2 / V1 + A2**2 / V2), beta * c_p * (A1 / V1 + A2**2 / (A1 * V2))


def arm_with(actuator):
    return Model(cehA.CehAThirdOrder(actuator=actuator), "printed")


def test_the_printed_t2_subtracts_one_over_square_metres_from_one_over_metres():
    with pytest.raises(UnitError, match=r"printed\.actuator: units do not balance.*m-1 is added to m-2"):
        assert arm_with(PrintedT2()).flat


def test_the_printed_equation_7_has_no_consistent_units_at_all():
    with pytest.raises(UnitError, match="units do not balance"):
        assert arm_with(PrintedEquation7()).flat


def test_with_the_printed_sign_the_oil_pushes_where_it_should_hold_back():
    """The oil spring becomes an oil anti-spring: no vibration but an escape within milliseconds."""
    model = arm_with(PrintedSign())
    x = model.equilibrium(states={"arm.angle": 0.0})
    poles = np.linalg.eigvals(jacobian(model)(0, x, [0], model.flat.parameter_vector()).full())
    assert poles.real.max() > 150
    assert np.abs(poles.imag).max() < 1e-6
    good = cehA.third_order()
    x = good.equilibrium(states={"arm.angle": 0.0})
    assert np.linalg.eigvals(jacobian(good)(0, x, [0], good.flat.parameter_vector()).full()).real.max() < 1e-6


def test_a_rod_that_runs_out_of_a_held_pump_loses_force():
    """F' = -T1 v: squeezed oil pushes back."""
    force = State(800.0, "N", "hydraulic force on the piston")
    for kind, sign in ((ForceActuator, -1), (PrintedSign, 1)):
        y = at(bench(kind(force=force), shaft="potential", rod="potential"), {"rod_end.speed": 0.01})
        assert y["der(part.force)"] == pytest.approx(sign * BETA * (A_CAP**2 + A_ROD**2) / V0 * 0.01, rel=1e-9)


def test_l_sin_theta_of_equation_16_is_no_lever():
    """It vanishes at zero angle and turns round below it, where l sin(alpha) is 15 cm and more."""
    theta = np.array([-0.2, 0.0, 0.12, 0.3, 0.5])
    assert lever(theta) == pytest.approx([0.1666, 0.1522, 0.1428, 0.1278, 0.1099], abs=1e-4)
    assert L_PIN * np.sin(theta) == pytest.approx([-0.0447, 0.0, 0.0269, 0.0665, 0.1079], abs=1e-4)


def test_the_lever_is_the_derivative_of_the_stroke():
    theta, h = np.linspace(-1, 1.3, 20), 1e-6
    assert lever(theta) == pytest.approx((length(theta + h) - length(theta - h)) / (2 * h), rel=1e-8)


def test_equation_18_called_rmse_is_the_mean_absolute_error():
    e = np.random.default_rng(3).normal(size=1000)
    printed = np.sum(np.sqrt(e**2)) / len(e)
    assert printed == pytest.approx(np.mean(np.abs(e)), rel=1e-12)
    assert printed / np.sqrt(np.mean(e**2)) == pytest.approx(np.sqrt(2 / np.pi), rel=0.03)
