"""What a sensor makes of what it measures."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Input, Output, Parameter, State, der, time

from .command import clipped, limits
from .effect import Effect
from .late import Late
from .sites import model_outputs, signed_outputs
from .stepping import Lagged, closely_followed, stepped

FRADEN = "J. Fraden, Handbook of Modern Sensors, 2016"


class SensorLag(Lagged):
    """The reading follows the quantity with a lag: ``T y' + y = u``; written as in `closely_followed`."""

    id, title = "sensor_lag", "lag of the sensor"
    equation = "T y' + y = u"
    source = FRADEN
    typical = {"time_constant": (0.002, 0.1)}
    probes = ({"time_constant": 0.005}, {"time_constant": 0.03})
    confused_with = ("sensor_delay", "actuator_lag", "dead_time", "spool_lag")
    experiment = "steps sampled fast, with a second sensor: a lag of the drive shows in all outputs, this in one"
    order = 1
    shortest = 0.5

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    lagging = State(lambda part: 0.0, "signal", "w", fixed=False)
    further = State(lambda part: 0.0, "signal", "v", fixed=False)
    time_constant = Parameter(0.0, "s", "lag T", bounds=(0, 1.0), nominal=0.01, source=FRADEN, free=True)
    resolution = Parameter(2.5e-4, "s", "T_0", bounds=(1e-5, 0.1), source="numerical")

    sites = stepped(model_outputs)

    def equations(self):
        w, v, T, T_0 = self.lagging, self.further, self.time_constant, self.resolution
        rate, second, y = closely_followed(self.u, w, v, T, T_0)
        yield der(w) == rate
        yield der(v) == second
        yield self.y == y

    def initial_equations(self):
        yield self.lagging == self.u
        yield self.further == self.u


class SensorHysteresis(Lagged):
    """The reading follows the quantity with play: slack in what drives the sensor, or hysteresis of its material.

        y stays where it is while |u - y| < h

    Written as T_p z' = deadzone(u - z, h), y = u + h clip((z - u)/(h + h_0), -1, 1): with h = 0, y is u; with h_0 far
    below h, y is z where that lies inside the play and at its edge where z lags behind it. ``offset`` is where in its
    play it starts, -1 to 1. Sources: Fraden 2016; M. Krasnosel'skii and A. Pokrovskii, Systems with Hysteresis, 1989
    (the play operator).
    """

    id, title = "sensor_hysteresis", "hysteresis of the sensor"
    equation = "y stays while |u - y| < h, else follows at distance h"
    source = FRADEN
    typical = {"half_width": (0.0005, 0.02)}
    probes = ({"half_width": 0.005}, {"half_width": 0.02})
    confused_with = ("coulomb_friction", "presliding_friction", "backlash", "spool_hysteresis", "quantisation")
    experiment = "slow reversals, with a second sensor on the same motion: what sticks stops in both, play in one"
    order = 1

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    dragged = State(lambda part: 0.0, "signal", "z", fixed=False)
    half_width = Parameter(
        0.0, "signal", "half width h of the play", bounds=(0, 0.3), nominal=0.005, source=FRADEN, free=True
    )
    offset = Parameter(0.0, "1", "start within the play", bounds=(-1, 1), nominal=1.0, source="unknown: centre")
    resolution = Parameter(1e-3, "s", "T_p", bounds=(1e-5, 0.1), source="numerical")
    smallest = Parameter(1e-7, "signal", "h_0", bounds=(1e-12, 1.0), source="numerical")

    sites = stepped(model_outputs)

    def equations(self):
        u, z, h = self.u, self.dragged, self.half_width
        yield self.resolution * der(z) == ca.fmax(u - z - h, 0) + ca.fmin(u - z + h, 0)
        yield self.y == u + h * clipped((z - u) / (h + self.smallest), 1)

    def initial_equations(self):
        yield self.dragged == self.u + self.offset * self.half_width


class SensorScale(Effect):
    """The reading is too large or too small by a share: ``y = (1 + e) u``."""

    id, title = "sensor_scale", "scale of the sensor"
    equation = "y = (1 + e) u"
    source = FRADEN
    typical = {"error": (-0.05, 0.05)}
    probes = ({"error": 0.02}, {"error": -0.02})
    confused_with = ("displacement_error", "area_error", "linkage_error", "sensor_bias")
    experiment = "two known positions far apart, or two known loads"
    order = 2

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    error = Parameter(0.0, "1", "error e of the scale", bounds=(-0.5, 1.0), nominal=0.01, source=FRADEN, free=True)

    sites = staticmethod(model_outputs)

    def equations(self):
        yield self.y == (1 + self.error) * self.u


class SensorCurvature(Effect):
    """The characteristic of the sensor is bent, right at zero and at full scale R, twice the signal's nominal.

    y = u + c u (|u| / R - 1)
    """

    id, title = "sensor_curvature", "curved characteristic of the sensor"
    equation = "y = u + c u (|u| / R - 1)"
    source = FRADEN
    typical = {"curvature": (-0.5, 0.5)}
    probes = ({"curvature": 0.2}, {"curvature": 0.5}, {"curvature": -0.2})
    confused_with = ("sensor_scale", "linkage_error", "flow_saturation")
    experiment = "known values over the whole range, one after the other"
    order = 2

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    curvature = Parameter(0.0, "1", "curvature c", bounds=(-0.95, 0.95), nominal=0.1, source=FRADEN, free=True)
    full_scale = Parameter(2.0, "signal", "full scale R", bounds=(1e-6, 1e6), source="twice the nominal")

    sites = staticmethod(model_outputs)

    def equations(self):
        u = self.u
        yield self.y == u + self.curvature * u * (ca.fabs(u) / self.full_scale - 1)


class SensorBias(Effect):
    """The reading is off by a constant: ``y = u + b``."""

    id, title = "sensor_bias", "offset of the sensor"
    equation = "y = u + b"
    source = FRADEN
    typical = {"offset": (-0.05, 0.05)}
    probes = ({"offset": 0.02}, {"offset": -0.02})
    confused_with = ("sensor_scale", "null_bias", "constant_load", "gravity_tilt")
    experiment = "a reading at a known zero: unloaded, at a stop, at rest"
    order = 3

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    offset = Parameter(0.0, "signal", "offset b", bounds=(-10, 10), nominal=0.01, source=FRADEN, free=True)

    sites = staticmethod(model_outputs)

    def equations(self):
        yield self.y == self.u + self.offset


class SensorDrift(Effect):
    """The reading creeps off while it is recorded: ``y = u + r t``; t counts from the recording's start."""

    id, title = "sensor_drift", "drift of the sensor"
    equation = "y = u + r t"
    source = FRADEN
    typical = {"rate": (-5e-3, 5e-3)}
    probes = ({"rate": 1e-3}, {"rate": -1e-3})
    confused_with = ("null_bias", "internal_leakage", "external_leakage", "turbulent_leakage", "sensor_bias")
    experiment = "a long pause at a stop or with the valves closed: what still creeps is the reading, not the machine"
    order = 3

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    rate = Parameter(0.0, "signal/s", "drift r", bounds=(-1, 1), nominal=1e-3, source=FRADEN, free=True)

    sites = staticmethod(model_outputs)

    def equations(self):
        yield self.y == self.u + self.rate * time()


class SensorSaturation(Effect):
    """The reading stays within the range of the sensor: ``y = clip(u, -L, L)``."""

    id, title = "sensor_saturation", "saturation of the sensor"
    equation = "y = clip(u, -L, L)"
    source = FRADEN
    typical = {"limit": (0.5, 3.0)}
    probes = ({"limit": 0.7}, {"limit": 1.0}, {"limit": 2.0})
    confused_with = ("overflow", "end_stop", "relief_saturation")
    experiment = "motion beyond the limit with a second sensor that follows from it: a flow, a speed, a pressure"
    order = 4

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    limit = Parameter(1e6, "signal", "largest reading L", bounds=(1e-3, 1e6), nominal=1.0, source=FRADEN, free=True)
    far = Parameter(1e6, "signal", "limit that nothing reaches", bounds=(1, 1e9), nominal=1e6, source="numerical")

    sites = staticmethod(model_outputs)

    @classmethod
    def probes_for(cls, seen):
        """Limits that the size of what is measured exceeds."""
        return limits(seen["u"], "limit")

    def equations(self):
        yield self.y == ca.if_else(self.limit < self.far, clipped(self.u, self.limit), self.u)


class SensorDelay(Late):
    """The reading arrives late: ``y(t) = u(t - T)``, as the filter of `Late`."""

    id, title = "sensor_delay", "delay of the sensor"
    equation = "y(t) = u(t - T)"
    source = "G. A. Baker and P. Graves-Morris, Pade Approximants, 1996"
    typical = {"time": (0.001, 0.1)}
    probes = ({"time": 0.005}, {"time": 0.03})
    confused_with = ("dead_time", "sensor_lag", "actuator_lag")
    experiment = "motion with two sensors: a delay of the command shows in both, a delay of one sensor in one"
    order = 4

    sites = stepped(model_outputs)


class SensorAsymmetry(Effect):
    """The reading is too large in one direction and too small in the other: ``y = u + e |u|``.

    Where zero is a state of the machine and no mark on a scale: of a speed, a flow, a force, a voltage.
    """

    id, title = "sensor_asymmetry", "scale of the sensor that differs by direction"
    equation = "y = u + e |u|"
    source = FRADEN
    typical = {"asymmetry": (-0.1, 0.1)}
    probes = ({"asymmetry": 0.03}, {"asymmetry": -0.03})
    confused_with = ("direction_asymmetry", "sensor_scale", "sensor_bias", "displacement_asymmetry")
    experiment = "the same known speeds or loads in both directions, with a second sensor"
    order = 2

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    asymmetry = Parameter(
        0.0, "1", "half the difference e of the scales", bounds=(-0.9, 0.9), nominal=0.05, source=FRADEN, free=True
    )

    sites = staticmethod(signed_outputs)

    def equations(self):
        yield self.y == self.u + self.asymmetry * ca.fabs(self.u)


class SensorDeadband(Effect):
    """Little shows as nothing, more is read short by the band: ``y = u - D clip(u / D, -1, 1)``.

    Written with u / (D + D_0), so that y is u itself where D is zero. The threshold of a turbine, a bearing or an
    amplifier. Where as `SensorAsymmetry`.
    """

    id, title = "sensor_deadband", "threshold of the sensor"
    equation = "y = 0 for |u| < D, else u - D sign(u)"
    source = FRADEN
    typical = {"width": (0.002, 0.1)}
    probes = ({"width": 0.01}, {"width": 0.05})
    confused_with = ("command_deadband", "coulomb_friction", "sensor_hysteresis", "sensor_curvature")
    experiment = "slow motion through rest with a second sensor that follows from it: a position, a pressure"
    order = 3

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    width = Parameter(0.0, "signal", "half width D", bounds=(0, 0.8), nominal=0.02, source=FRADEN, free=True)

    smallest = Parameter(1e-7, "signal", "D_0", bounds=(1e-12, 1.0), source="numerical")

    sites = staticmethod(signed_outputs)

    def equations(self):
        yield self.y == self.u - self.width * clipped(self.u / (self.width + self.smallest), 1)


class Quantisation(Effect):
    """The reading comes in steps of q.

        y = q round(u / q)

    Written as u - q^2/(q + q_0) s(u / (q + q_0)) with a sawtooth s whose corners are slightly rounded, so that there is
    a derivative and q = 0 is no step at all. The noise floor of a recording contains q^2/12 already: this effect
    makes the steps visible in the model, it closes no gap that counts as one.
    """

    id, title = "quantisation", "steps of the sensor"
    equation = "y = q round(u / q)"
    source = FRADEN
    typical = {"step": (1e-4, 2e-2)}
    probes = ({"step": 1e-3}, {"step": 1e-2})
    confused_with = ("coulomb_friction", "spool_hysteresis")
    experiment = "very slow motion: steps of equal height, whatever the direction and the load"
    order = 5

    u = Input("signal", "what is measured")
    y = Output("signal", "reading")
    step = Parameter(0.0, "signal", "step q", bounds=(0, 0.2), nominal=1e-3, source=FRADEN, free=True)
    resolution = Parameter(1e-6, "signal", "q_0", bounds=(1e-12, 1.0), source="numerical")
    roundness = Parameter(0.005, "1", "1 - sharpness of the corners", bounds=(1e-4, 1.0), source="numerical")

    sites = staticmethod(model_outputs)

    def equations(self):
        q, u, s = self.step, self.u, 1 - self.roundness
        turn = 2 * ca.pi * u / (q + self.resolution)
        sawtooth = ca.atan2(s * ca.sin(turn), 1 + s * ca.cos(turn)) / ca.pi
        yield self.y == u - q * q / (q + self.resolution) * sawtooth
