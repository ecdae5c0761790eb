"""Signal blocks against their formula, sensors against what they measure."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.components import (
    AngleSensor,
    Constant,
    Deadband,
    DeadTime,
    Difference,
    FirstOrderLag,
    FlowSensor,
    ForceSensor,
    Gain,
    PiController,
    PositionSensor,
    PressureSensor,
    Saturation,
    SpeedSensor,
)
from hydrotwin.models.language import Component, Input, Model, Output, connect
from tests.components.bench import at, bench, jacobian, run

TIME = np.linspace(0, 1, 201)


@pytest.mark.parametrize(
    ("part", "inputs", "y"),
    [
        (Constant(k=3.5), {}, 3.5),
        (Gain(k=-2.0), {"u": 1.5}, -3.0),
        (Difference(), {"plus": 4.0, "minus": 1.5}, 2.5),
        (Saturation(), {"u": 3.0}, 1.0),
        (Saturation(lower=-0.4), {"u": -3.0}, -0.4),
        (Saturation(), {"u": 0.3}, 0.3),
        (Deadband(width=0.1), {"u": 0.09}, 0.0),
        (Deadband(width=0.1), {"u": 0.3}, 0.2),
        (Deadband(width=0.1), {"u": -0.3}, -0.2),
    ],
)
def test_a_signal_block_computes_its_formula(part, inputs, y):
    assert at(bench(part), **inputs)["y"] == pytest.approx(y, abs=1e-15)


def test_a_first_order_lag_rises_exponentially():
    y = run(bench(FirstOrderLag(time_constant=0.2)), TIME, u=3.0)["y"]
    assert y == pytest.approx(3 * (1 - np.exp(-TIME / 0.2)), abs=1e-9)


@pytest.mark.parametrize("dead_time", [0.0, 0.0375, 0.2])
def test_a_dead_time_shifts_the_command_and_keeps_its_shape(dead_time):
    """A lag behind it makes the shift visible between samples too."""

    class Late(Component):
        """Dead time and lag in a row."""

        late, lag = DeadTime(dead_time=dead_time), FirstOrderLag(time_constant=0.1)
        u = Input("1", "in")
        y = Output("1", "out")

        def equations(self):
            yield connect(self.u, self.late.u)
            yield connect(self.late.y, self.lag.u)
            yield connect(self.y, self.lag.y)

    y = run(Model(Late(), "late"), TIME, u=np.where(TIME >= 0.1 - 1e-12, 1.0, 0.0))["y"]
    wait = np.maximum(TIME - 0.1 - dead_time, 0)
    assert y == pytest.approx(1 - np.exp(-wait / 0.1), abs=2e-5)


def test_a_pi_controller_answers_a_constant_error_with_a_step_and_a_ramp():
    y = run(bench(PiController(proportional_gain=4.0, reset_time=0.5)), TIME, reference=1.5, measured=1.0)["y"]
    assert y == pytest.approx(4 * (0.5 + 0.5 * TIME / 0.5), abs=1e-12)


def test_a_pi_loop_around_a_lag_leaves_no_error_and_has_the_poles_of_the_textbook():
    class Loop(Component):
        """PI controller around a first-order lag."""

        pi, plant = PiController(proportional_gain=3.0, reset_time=0.4), FirstOrderLag(time_constant=0.5)
        reference = Input("1", "wanted")
        y = Output("1", "reached")

        def equations(self):
            yield connect(self.reference, self.pi.reference)
            yield connect(self.pi.y, self.plant.u)
            yield connect(self.plant.y, self.pi.measured)
            yield connect(self.y, self.plant.y)

    model = Model(Loop(), "loop")
    assert run(model, np.linspace(0, 10, 1001), reference=2.0)["y"][-1] == pytest.approx(2, abs=1e-6)
    poles = np.linalg.eigvals(jacobian(model)(0, [0, 0], [0], model.flat.parameter_vector()).full())
    assert np.sort_complex(poles) == pytest.approx(np.sort_complex(np.roots([0.5 * 0.4, 0.4 * 4, 3.0])), rel=1e-9)


def test_sensors_read_their_port_and_take_nothing_from_it():
    y = at(bench(PressureSensor(), port="potential"), port=7e6)
    assert (y["pressure"], y["port_q"]) == (7e6, 0)
    y = at(bench(SpeedSensor(), shaft="potential"), shaft=90.0)
    assert (y["speed"], y["shaft_tau"]) == (90, 0)
    y = at(bench(PositionSensor(), flange="potential"), {"flange_end.place": 0.3})
    assert (y["position"], y["flange_f"]) == (0.3, 0)
    y = at(bench(AngleSensor(), flange="potential"), {"flange_end.place": 0.3})
    assert (y["angle"], y["flange_tau"]) == (0.3, 0)


def test_sensors_in_a_line_pass_on_what_they_measure():
    y = at(bench(FlowSensor(), a="flow", b="potential"), a=3e-5, b=4e6)
    assert (y["flow"], y["a_p"], y["b_q"]) == (3e-5, 4e6, -3e-5)
    y = at(bench(ForceSensor(), a="flow", b="potential"), {"b_end.place": 0.2}, a=50.0)
    assert (y["force"], y["a_s"], y["b_f"]) == (50.0, 0.2, -50.0)
