"""The C core against the same equations written a second time in numpy and integrated by SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests import rig


def cehA_rates(t, state, u, p):
    w, pa, pb, theta, omega = state
    pin, base, a1, a2 = p["arm.pin_length"], p["arm.base_length"], p["cylinder.cap_area"], p["cylinder.rod_area"]
    s = np.sqrt(pin**2 + base**2 + 2 * pin * base * np.sin(theta))
    lever = pin * base * np.cos(theta) / s
    x, v = s - p["arm.retracted_length"], lever * omega
    fk, fs, vs = (p[f"cylinder.friction.{n}"] for n in ("kinetic", "static", "stribeck_velocity"))
    sign = np.tanh(v / p["cylinder.friction.smoothing_velocity"])
    friction = (fk + (fs - fk) * np.exp(-((v / vs) ** 2))) * sign + p["cylinder.friction.viscous"] * v
    beta, q = p["cylinder.oil.bulk_modulus"], p["pump.displacement"] * w
    m1, m2, length = p["arm.extra_mass"], p["arm.arm_mass"], p["arm.length"]
    torque = lever * (pa * a1 - pb * a2 - friction) - (m1 + m2 / 2) * 9.80665 * length * np.cos(theta)
    return [
        (p["motor.gain"] * u - w) / p["motor.time_constant"],
        beta / (p["cylinder.cap_dead_volume"] + a1 * x) * (q - a1 * v),
        beta / (p["cylinder.rod_dead_volume"] - a2 * x) * (a2 * v - a2 / a1 * q),
        omega,
        torque / ((m1 + m2 / 3) * length**2),
    ]


def spool_rates(t, state, u, p):
    s, rate, pa, pb, x, v = state
    wn, damping, a, b = p["slide.natural_frequency"], p["slide.damping"], p["cylinder.cap_area"], p["cylinder.rod_area"]
    kq, ps, pt = p["valve.orifice.flow_coefficient"], p["supply.pressure"], p["tank.pressure"]
    root = lambda dp: np.sign(dp) * np.sqrt(np.abs(dp))  # noqa: E731
    qa = kq * (max(s, 0) * root(ps - pa) - max(-s, 0) * root(pa - pt))
    qb = kq * (max(-s, 0) * root(ps - pb) - max(s, 0) * root(pb - pt))
    va = p["cylinder.cap_dead_volume"] + a * x
    vb = p["cylinder.rod_dead_volume"] + b * (p["cylinder.rod_reference"] - x)
    beta, friction = p["cylinder.oil.bulk_modulus"], p["cylinder.friction.viscous"] * v
    target = p["solenoid.gain"] * u + p["solenoid.offset"]
    return [
        rate,
        wn**2 * (target - s) - 2 * damping * wn * rate,
        beta / va * (qa - a * v),
        beta / vb * (qb + b * v),
        v,
        (pa * a - pb * b - friction - p["load.load_force"]) / p["load.mass"],
    ]


CASES = {
    "cehA": (cehA_rates, ("motor_speed", "pressure_cap", "pressure_rod", "arm_angle"), [1.0, 1e6, 1e6, 1e-2, 1e-2]),
    "spool_valve": (
        spool_rates,
        ("spool", None, "pressure_a", "pressure_b", "position", "velocity"),
        [1e-2, 1.0, 1e6, 1e6, 1e-2, 1e-2],
    ),
}


@pytest.mark.parametrize("machine", sorted(CASES))
def test_the_core_agrees_with_scipy_to_a_thousandth_of_the_noise(machine):
    rates, names, scale = CASES[machine]
    time, command = rig.drive(machine, 3.0, 50.0, seed=8)
    changes = {"cylinder.oil.bulk_modulus": 1.3e9}
    run = rig.record(machine, command, time, parameters=changes)
    p = {**rig.MACHINES[machine].parameters, **changes}
    state = np.array([run[name][0] if name else 0.0 for name in names] + [0.0] * (machine == "cehA"))
    states = [state]
    for u, begin, end in zip(command, time[:-1], time[1:], strict=False):
        piece = solve_ivp(
            rates, (begin, end), states[-1], "DOP853", args=(u, p), rtol=1e-9, atol=1e-10 * np.array(scale)
        )
        states.append(piece.y[:, -1])
    noise = rig.sensor_noise(machine)
    for i, name in enumerate(names):
        if name:
            error = np.max(np.abs(np.array(states)[:, i] - run[name]))
            assert error < 1e-3 * noise[name]
