"""What happens to a command on its way to the machine."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Input, Output, Parameter, State, delay, der

from .effect import Effect
from .sites import model_inputs


class DeadTime(Effect):
    """The command arrives late.

        y(t) = u(t - T)

    Exact for held and linear inputs. Source: K. J. Astrom and T. Hagglund, PID Controllers, 1995.
    """

    id, title = "dead_time", "dead time"
    equation = "y(t) = u(t - T)"
    source = "K. J. Astrom and T. Hagglund, PID Controllers, 1995"
    typical = {"time": (0.002, 0.24)}
    probes = ({"time": 0.02},)
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

    def equations(self):
        yield self.y == delay(self.u, self.time)


class ActuatorLag(Effect):
    """The command is followed with a lag.

        T y' + y = u

    Written as u + T/(T + T_0) (w - u), (T + T_0) w' + w = u, with a small T_0: no stiff state where T is zero, the
    same delay T for slow signals, the same lag for T much longer than T_0.
    """

    id, title = "actuator_lag", "lag of the drive"
    equation = "T y' + y = u"
    source = "K. J. Astrom and T. Hagglund, PID Controllers, 1995"
    typical = {"time_constant": (0.005, 0.3)}
    probes = ({"time_constant": 0.03},)
    confused_with = ("dead_time", "spool_lag", "sensor_lag")
    experiment = "steps, sampled fast: a dead time shifts the first movement, a lag rounds it"
    order = 1

    u = Input("signal", "command")
    y = Output("signal", "what follows it")
    lagging = State(lambda lag: 0.0, "signal", "w", fixed=False)
    time_constant = Parameter(0.0, "s", "lag T", bounds=(0, 2.0), nominal=0.01, source="typical", free=True)
    resolution = Parameter(1e-3, "s", "T_0", bounds=(1e-5, 0.1), source="numerical")

    sites = staticmethod(model_inputs)

    def equations(self):
        T, T_0, u, w = self.time_constant, self.resolution, self.u, self.lagging
        yield (T + T_0) * der(w) == u - w
        yield self.y == u + T / (T + T_0) * (w - u)

    def initial_equations(self):
        yield self.lagging == self.u


class CommandDeadband(Effect):
    """Small commands do nothing, larger ones are short by the band.

    y = u - D clip(u / D, -1, 1)
    """

    id, title = "command_deadband", "deadband of the command"
    equation = "y = 0 for |u| < D, else u - D sign(u)"
    source = "H. Merritt, Hydraulic Control Systems, 1967"
    typical = {"width": (0.005, 0.2)}
    probes = ({"width": 0.05},)
    confused_with = ("coulomb_friction", "valve_overlap")
    experiment = "slow triangles through zero at two loads"
    order = 4

    u = Input("signal", "command")
    y = Output("signal", "what is left of it")
    width = Parameter(0.0, "signal", "half width D", bounds=(0, 0.8), nominal=0.02, source="typical", free=True)

    sites = staticmethod(model_inputs)

    def equations(self):
        yield self.y == ca.fmax(self.u - self.width, 0) + ca.fmin(self.u + self.width, 0)
