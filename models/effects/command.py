"""What happens to a command on its way to the machine."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from hydrotwin.models.language import Input, Output, Parameter, State, delay, der, time

from .effect import Effect, Site
from .exceeded import exceeded
from .late import Late
from .sites import (
    commands,
    every_command,
    every_signal,
    inside_signals,
    model_inputs,
    signals_of_fixed_gain,
    valve_spools,
)
from .stepping import Lagged, followed, stepped

ASTROM = "K. J. Astrom and T. Hagglund, PID Controllers, 1995"
MERRITT = "H. Merritt, Hydraulic Control Systems, 1967"


class DeadTime(Effect):
    """The command arrives late.

        y(t) = u(t - T)

    Exact for held and linear inputs. Where the model delays the input by a parameter of its own, that one is freed.
    Source: K. J. Astrom and T. Hagglund, PID Controllers, 1995.
    """

    id, title = "dead_time", "dead time"
    equation = "y(t) = u(t - T)"
    source = ASTROM
    typical = {"time": (0.002, 0.24)}
    probes = ({"time": 0.005}, {"time": 0.02}, {"time": 0.08})
    confused_with = ("sensor_delay", "actuator_lag", "structural_compliance")
    experiment = "steps, sampled fast: a dead time shifts the first movement, a lag rounds it"
    order = 0

    u = Input("signal", "command")
    y = Output("signal", "command, later")
    time = Parameter(0.0, "s", "dead time T", bounds=(0, 0.5), nominal=0.01, source="typical 2-240 ms", free=True)

    @classmethod
    def sites(cls, places):
        delayed = {wire.path for wire in places.wires if wire.delayed}
        yield from (site for site in model_inputs(places) if site.through not in delayed)
        yield from (site for site, parameter in _own_delays(places) if not parameter.free)
        yield from stepped(inside_signals).__func__(places)

    @classmethod
    def known(cls, places):
        yield from (site for site, parameter in _own_delays(places) if parameter.free)

    @classmethod
    def at(cls, site: Site):
        """The part for an input, or for a signal inside, which no exact delay can take."""
        return LateInside.at(site) if site.further else super().at(site)

    @classmethod
    def freed(cls, value):
        return tuple(value + probe["time"] for probe in cls.probes), cls.typical["time"]

    def equations(self):
        yield self.y == delay(self.u, self.time)


class LateInside(Late):
    """The same for a signal inside a model."""

    time = replace(DeadTime.time, source="typical 2-240 ms")


def _own_delays(places):
    """The delays of inputs that the model has already, with the parameter of each."""
    parameters = {p.name: p for p in places.model.flat.parameters}
    delayed = {wire.path for wire in places.wires if wire.delayed}
    for signal in places.model.flat.inputs:
        if signal.dead_time in parameters and signal.name in delayed:
            own = parameters[signal.dead_time]
            yield Site(signal.name, frees=own.name, unit="s", nominal=0.01), own


class ActuatorLag(Lagged):
    """The command is followed with a lag.

        T y' + y = u

    Written as in `followed`, with a small T_0: no stiff state where T is zero.
    """

    id, title = "actuator_lag", "lag of the drive"
    equation = "T y' + y = u"
    source = ASTROM
    typical = {"time_constant": (0.005, 0.3)}
    probes = ({"time_constant": 0.01}, {"time_constant": 0.05})
    confused_with = ("dead_time", "spool_lag", "sensor_lag")
    experiment = "steps, sampled fast: a dead time shifts the first movement, a lag rounds it"
    order = 1
    shortest = 0.5

    u = Input("signal", "command")
    y = Output("signal", "what follows it")
    lagging = State(lambda lag: 0.0, "signal", "w", fixed=False)
    time_constant = Parameter(0.0, "s", "lag T", bounds=(0, 2.0), nominal=0.01, source="typical", free=True)
    resolution = Parameter(2.5e-4, "s", "T_0", bounds=(1e-5, 0.1), source="numerical")

    sites = stepped(commands)

    def equations(self):
        rate, y = followed(self.u, self.lagging, self.time_constant, self.resolution)
        yield der(self.lagging) == rate
        yield self.y == y

    def initial_equations(self):
        yield self.lagging == self.u


class RateLimit(Lagged):
    """The command is followed no faster than at a rate R.

        z' = clip((u - z) / T_0, -R, R),   y = u - s(|u - z| / (R T_0)) (u - z),   s(x) = clip(2 x - 1/2, 0, 1)

    What is faster becomes a ramp, which arrives as late as the exact one in the mean: the integral of s from 0 to 1 is
    1/2, as that of what is left of a ramp. What is slower than R/4 passes unchanged, what is slower than R is no more
    than T_0 late.
    """

    id, title = "rate_limit", "limited rate"
    equation = "|y'| <= R"
    source = MERRITT
    typical = {"rate": (0.5, 50.0)}
    probes = ({"rate": 2.0}, {"rate": 10.0})
    confused_with = ("actuator_lag", "command_saturation", "spool_lag")
    experiment = "large and small steps: a lag scales with the step, a limited rate does not"
    order = 2
    shortest = 0.5

    u = Input("signal", "command")
    y = Output("signal", "what follows it")
    limited = State(lambda part: 0.0, "signal", "z", fixed=False)
    rate = Parameter(1e8, "signal/s", "rate R", bounds=(1e-2, 1e8), nominal=1.0, source="data sheet", free=True)
    resolution = Parameter(2.5e-4, "s", "T_0", bounds=(1e-5, 0.1), source="numerical")

    sites = stepped(commands)

    @classmethod
    def probes_for(cls, seen):
        """Rates that the steepness of the command, ``u`` over ``time``, exceeds; none where it stands still."""
        u, t = np.asarray(seen["u"], float), np.asarray(seen["time"], float)
        span, steep = np.ptp(u), np.abs(np.diff(u)) / np.maximum(np.diff(t), 1e-9)
        if span == 0:
            return []
        steep = np.minimum(steep[steep > 0], span / 0.02)  # a step is as steep as the sampling is fast
        rates = [*exceeded([0.0, *steep]), float(span / 0.2)]
        return [{"rate": rate} for rate in sorted(set(rates), reverse=True)]

    def equations(self):
        u, z, near = self.u, self.limited, self.rate * self.resolution
        yield self.resolution * der(z) == clipped(u - z, near)
        share = ca.fmin(ca.fmax(2 * ca.fabs(u - z) / near - 0.5, 0), 1)
        yield self.y == u - share * (u - z)

    def initial_equations(self):
        yield self.limited == self.u


class CommandSaturation(Effect):
    """Commands beyond a limit do no more than the limit: ``y = clip(u, -L, L)``."""

    id, title = "command_saturation", "saturation of the command"
    equation = "y = clip(u, -L, L)"
    source = ASTROM
    typical = {"limit": (0.3, 1.5)}
    probes = ({"limit": 0.5}, {"limit": 0.9})
    confused_with = ("flow_saturation", "rate_limit", "motor_droop", "relief_saturation")
    experiment = "steps of several heights up to the largest command, both directions"
    order = 3

    u = Input("signal", "command")
    y = Output("signal", "what is left of it")
    limit = Parameter(1e6, "signal", "limit L", bounds=(1e-3, 1e6), nominal=1.0, source="data sheet", free=True)

    sites = staticmethod(every_command)

    @classmethod
    def probes_for(cls, seen):
        """Limits that the size of the command exceeds."""
        return limits(seen["u"], "limit")

    def equations(self):
        yield self.y == clipped(self.u, self.limit)


class CommandDeadband(Effect):
    """Small commands do nothing, larger ones are short by the band.

    y = u - D clip(u / D, -1, 1)
    """

    id, title = "command_deadband", "deadband of the command"
    equation = "y = 0 for |u| < D, else u - D sign(u)"
    source = MERRITT
    typical = {"width": (0.005, 0.2)}
    probes = ({"width": 0.02}, {"width": 0.1})
    confused_with = ("coulomb_friction", "valve_overlap")
    experiment = "slow triangles through zero at two loads"
    order = 4

    u = Input("signal", "command")
    y = Output("signal", "what is left of it")
    width = Parameter(0.0, "signal", "half width D", bounds=(0, 0.8), nominal=0.02, source="typical", free=True)

    sites = staticmethod(every_command)

    def equations(self):
        yield self.y == ca.fmax(self.u - self.width, 0) + ca.fmin(self.u + self.width, 0)


class CommandGain(Effect):
    """The drive makes more or less of the command than the model says: ``y = (1 + g) u``.

    Only where no free parameter of the model is that gain.
    """

    id, title = "command_gain", "gain of the command"
    equation = "y = (1 + g) u"
    source = MERRITT
    typical = {"error": (-0.2, 0.2)}
    probes = ({"error": 0.05}, {"error": -0.05})
    confused_with = ("sensor_scale", "direction_asymmetry", "command_deadband")
    experiment = "steady commands of several sizes with what they drive measured by a second sensor"
    order = 5

    u = Input("signal", "command")
    y = Output("signal", "what the drive makes of it")
    error = Parameter(0.0, "1", "error g of the gain", bounds=(-0.9, 3.0), nominal=0.05, source="typical", free=True)

    sites = staticmethod(signals_of_fixed_gain)

    def equations(self):
        yield self.y == (1 + self.error) * self.u


class DirectionAsymmetry(Effect):
    """The drive gives more in one direction than in the other: ``y = (1 + g) (u + e |u|)``.

    g is zero where a free parameter of the model is that gain, or nothing recorded shows it.
    """

    id, title = "direction_asymmetry", "gain that differs by direction"
    equation = "y = (1 + g) (u + e |u|), g = 0 beside a free gain"
    source = MERRITT
    typical = {"asymmetry": (-0.2, 0.2), "gain": (-0.2, 0.2)}
    probes = ({"asymmetry": 0.05}, {"asymmetry": -0.05})
    confused_with = ("displacement_asymmetry", "null_bias", "area_error", "asymmetric_friction", "asymmetric_overlap")
    experiment = "the same speeds in both directions, at two heights, with the flow or the speed of the drive measured"
    order = 5

    u = Input("signal", "command")
    y = Output("signal", "what the drive makes of it")
    asymmetry = Parameter(
        0.0, "1", "half the difference e of the gains", bounds=(-0.9, 0.9), nominal=0.05, source="typical", free=True
    )
    gain = Parameter(0.0, "1", "error g of their mean", bounds=(-0.9, 3.0), nominal=0.05, source="typical")

    @classmethod
    def sites(cls, places):
        fixed = {site.name for site in signals_of_fixed_gain(places)}
        for site in every_signal(places):
            yield replace(site, also_free=("gain",)) if site.name in fixed else site

    def equations(self):
        yield self.y == (1 + self.gain) * (self.u + self.asymmetry * ca.fabs(self.u))


class NullBias(Effect):
    """The machine stands still at another command than zero: ``y = u + b``.

    A valve that no input of the model reaches through signals alone has a site of its own.
    """

    id, title = "null_bias", "null offset"
    equation = "y = u + b"
    source = MERRITT
    typical = {"offset": (-0.05, 0.05)}
    probes = ({"offset": 0.02}, {"offset": -0.02})
    confused_with = ("constant_load", "internal_leakage", "external_leakage", "sensor_bias", "asymmetric_overlap")
    experiment = "the command that holds still, at two loads and two positions"
    order = 6

    u = Input("signal", "command")
    y = Output("signal", "command and offset")
    offset = Parameter(0.0, "signal", "offset b", bounds=(-0.5, 0.5), nominal=0.02, source="typical", free=True)

    @classmethod
    def sites(cls, places):
        yield from model_inputs(places)
        inputs = {i.name for i in places.model.flat.inputs}
        yield from (site for site in valve_spools(places) if not inputs & set(places.upstream(site.through)))

    def equations(self):
        yield self.y == self.u + self.offset


class Drift(Effect):
    """The drive grows weaker or stronger while it runs: ``y = u (1 + r t)``; t counts from the recording's start.

    At a valve: more flows while the oil warms, and the spool stands where it stood.
    """

    id, title = "drift", "drift of the drive"
    equation = "y = u (1 + r t)"
    source = "warm oil, an emptying battery"
    typical = {"rate": (-5e-3, 5e-3)}
    probes = ({"rate": 1e-3}, {"rate": -1e-3})
    confused_with = ("viscous_friction", "pump_slip")
    experiment = "the same motion at the start and at the end of a long recording, with temperature and supply voltage"
    order = 7

    u = Input("signal", "command")
    y = Output("signal", "what the drive makes of it")
    rate = Parameter(
        0.0, "1/s", "change r of the gain per second", bounds=(-0.05, 0.05), nominal=1e-3, source="typical", free=True
    )

    @classmethod
    def sites(cls, places):
        yield from model_inputs(places)
        yield from valve_spools(places)

    def equations(self):
        yield self.y == self.u * (1 + self.rate * time())


def clipped(value: ca.SX, limit: ca.SX) -> ca.SX:
    """``value`` between -limit and limit."""
    return ca.fmin(ca.fmax(value, -limit), limit)


def limits(values, name: str) -> list[dict[str, float]]:
    """A start at each level that the size of what is seen exceeds, largest first; none where there is nothing."""
    return [{name: level} for level in exceeded([0.0, *np.abs(np.asarray(values, float))]) if level > 0]
