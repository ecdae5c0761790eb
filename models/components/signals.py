"""Signal blocks. Signals are pure numbers unless a subclass declares them with another unit."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Component, Input, Output, Parameter, State, delay, der


class Constant(Component):
    """y = k."""

    y = Output("1", "constant signal")
    k = Parameter(1.0, "1", "value", bounds=(-1e9, 1e9), source="setting")

    def equations(self):
        yield self.y == self.k


class Gain(Component):
    """y = k u."""

    u = Input("1", "signal in")
    y = Output("1", "signal out")
    k = Parameter(1.0, "1", "gain", bounds=(-1e9, 1e9), source="setting")

    def equations(self):
        yield self.y == self.k * self.u


class Difference(Component):
    """y = plus - minus."""

    plus = Input("1", "added")
    minus = Input("1", "subtracted")
    y = Output("1", "difference")

    def equations(self):
        yield self.y == self.plus - self.minus


class FirstOrderLag(Component):
    """T dy/dt + y = u."""

    u = Input("1", "signal in")
    y = Output("1", "signal out")
    time_constant = Parameter(0.01, "s", "lag T", bounds=(1e-6, 1e4), source="setting")
    x = State(0.0, "1", "lagged signal")

    def equations(self):
        yield self.time_constant * der(self.x) + self.x == self.u
        yield self.y == self.x


class DeadTime(Component):
    """y(t) = u(t - T); u must be an input of the model."""

    u = Input("1", "signal in")
    y = Output("1", "signal out, late")
    dead_time = Parameter(0.0, "s", "dead time T", bounds=(0, 10), nominal=0.01, source="setting")

    def equations(self):
        yield self.y == delay(self.u, self.dead_time)


class Saturation(Component):
    """y = u between two limits."""

    u = Input("1", "signal in")
    y = Output("1", "signal out")
    lower = Parameter(-1.0, "1", "lower limit", bounds=(-1e9, 1e9), source="setting")
    upper = Parameter(1.0, "1", "upper limit", bounds=(-1e9, 1e9), source="setting")

    def equations(self):
        yield self.y == ca.fmin(ca.fmax(self.u, self.lower), self.upper)


class Deadband(Component):
    """y = u outside a band of half width ``width``, shifted to start at zero there; 0 inside."""

    u = Input("1", "signal in")
    y = Output("1", "signal out")
    width = Parameter(0.02, "1", "half width of the band", bounds=(0, 10), nominal=0.02, source="setting")

    def equations(self):
        yield self.y == ca.fmax(self.u - self.width, 0) + ca.fmin(self.u + self.width, 0)


class PiController(Component):
    """y = K_p (e + 1/T_i integral of e dt), e = reference - measured."""

    reference = Input("1", "wanted value")
    measured = Input("1", "measured value")
    y = Output("1", "command")
    proportional_gain = Parameter(1.0, "1", "K_p", bounds=(0, 1e6), source="setting")
    reset_time = Parameter(1.0, "s", "T_i", bounds=(1e-4, 1e6), source="setting")
    integral = State(0.0, "1", "integral of the error over the reset time")

    def equations(self):
        e = self.reference - self.measured
        yield self.reset_time * der(self.integral) == e
        yield self.y == self.proportional_gain * (e + self.integral)
