"""Motors and their supply."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.components import DcMotor, ElectricGround, SpeedControlledMotor, TorqueSource, VoltageSource
from hydrotwin.models.language import Component, Input, Model, Output, connect
from tests.components.bench import at, bench, jacobian, run

R, L, K, J, B = 0.5, 1e-3, 0.05, 1e-4, 1e-5


def test_a_speed_controlled_motor_reaches_63_percent_after_its_lag_whatever_the_load():
    model, time = bench(SpeedControlledMotor(), shaft="flow"), np.linspace(0, 0.3, 301)
    for torque in (0.0, -5.0):
        w = run(model, time, command=5.0, shaft=torque)["shaft_w"]
        assert w == pytest.approx(600 * (1 - np.exp(-time / 0.03)), abs=1e-4)


@pytest.mark.parametrize("load", [0.0, -0.3, 0.2])
def test_a_dc_motor_settles_at_the_crossing_of_its_speed_torque_line_and_the_load(load):
    model = bench(DcMotor(), positive="potential", negative="potential", shaft="flow")
    y = run(model, np.linspace(0, 1, 101), positive=24.0, negative=4.0, shaft=load)
    w = (K * 20 / R + load) / (B + K**2 / R)
    assert y["shaft_w"][-1] == pytest.approx(w, rel=1e-6)
    assert y["positive_i"][-1] == pytest.approx((20 - K * w) / R, rel=1e-6)


def test_a_dc_motor_turns_all_electric_power_into_heat_stored_energy_and_shaft_power():
    model = bench(DcMotor(), positive="potential", negative="potential", shaft="flow")
    i, w, load = 7.0, 150.0, -0.2
    y = at(model, {"part.current": i, "part.speed": w}, positive=20.0, shaft=load)
    stored = L * i * y["der(part.current)"] + J * w * y["der(part.speed)"]
    power_in = y["positive_v"] * y["positive_i"] + y["negative_v"] * y["negative_i"] + load * w
    assert power_in == pytest.approx(stored + R * i**2 + B * w**2, rel=1e-12)


def test_a_dc_motor_has_the_poles_of_its_armature_and_rotor():
    model = bench(DcMotor(), positive="potential", negative="potential", shaft="flow")
    poles = np.linalg.eigvals(jacobian(model)(0, [0, 0], [0, 0, 0], model.flat.parameter_vector()).full())
    expected = np.roots([L * J, L * B + R * J, R * B + K**2])
    assert np.sort_complex(poles) == pytest.approx(np.sort_complex(expected), rel=1e-9)


def test_a_voltage_source_drives_a_motor_against_ground():
    class Drive(Component):
        """Source, ground, a motor whose rotor is too heavy to start, a load."""

        source, ground, motor, load = VoltageSource(), ElectricGround(), DcMotor(inertia=1e3), TorqueSource()
        supply = Input("V", "supply")
        current = Output("A", "current")

        def equations(self):
            yield connect(self.supply, self.source.voltage)
            yield connect(self.source.positive, self.motor.positive)
            yield connect(self.source.negative, self.motor.negative)
            yield connect(self.ground.pin, self.source.negative)
            yield connect(self.motor.shaft, self.load.shaft)
            yield self.load.torque == 0
            yield self.current == self.motor.current

    time = np.linspace(0, 0.01, 101)
    y = run(Model(Drive(), "drive"), time, supply=12.0)
    assert y["current"] == pytest.approx(12 / R * (1 - np.exp(-R / L * time)), rel=1e-6, abs=1e-9)


def test_sources_and_ground_hold_their_voltage():
    y = at(bench(VoltageSource(), positive="flow", negative="potential"), voltage=12.0, negative=3.0, positive=-2.0)
    assert (y["positive_v"], y["negative_i"]) == (15.0, 2.0)
    assert at(bench(ElectricGround(), pin="flow"), pin=5.0)["pin_v"] == 0
