"""Proportional spool valve: solenoid, spool and four metering edges."""

from __future__ import annotations

from hydrotwin.models.language import Component, HydraulicPort, Input, Output, Parameter, Slot, State, delay, der
from hydrotwin.models.laws import MeteringEdgeLaw, OrificeLaw, TurbulentOrifice, ZeroOverlapEdge


class ProportionalSolenoid(Component):
    """Solenoid and its amplifier: the wanted spool position ``gain u(t - T_d) + offset``."""

    current = Input("1", "normalised solenoid current")
    target = Output("1", "wanted spool position")
    gain = Parameter(1.0, "1", "spool position per current", bounds=(0.01, 10), source="normalised")
    offset = Parameter(
        0.0, "1", "spool position without current", bounds=(-0.5, 0.5), nominal=0.02, source="symmetric valve"
    )
    dead_time = Parameter(0.0, "s", "dead time T_d", bounds=(0, 0.5), nominal=0.01, source="typical 2-240 ms")

    def equations(self):
        yield self.target == self.gain * delay(self.current, self.dead_time) + self.offset


class Spool(Component):
    """Sliding spool as a second-order lag: ``x'' + 2 D w0 x' + w0^2 x = w0^2 target``."""

    target = Input("1", "wanted position")
    displacement = Output("1", "position, 1 = fully open towards a")
    natural_frequency = Parameter(120.0, "rad/s", "natural frequency w0", bounds=(1, 1e4), source="data sheet")
    damping = Parameter(0.8, "1", "damping ratio D", bounds=(0.05, 5), source="data sheet")
    position = State(0.0, "1", "spool position")
    velocity = State(0.0, "1/s", "spool velocity", nominal=10.0)

    def equations(self):
        w0, D, x, v = self.natural_frequency, self.damping, self.position, self.velocity
        yield der(x) == v
        yield der(v) == w0**2 * (self.target - x) - 2 * D * w0 * v
        yield self.displacement == x


class FourEdgeValve(Component):
    """Four metering edges on one spool; positive spool opens supply to a and b to tank.

    ``q = k_q o(x) sqrt(dp)`` at each edge (Merritt 1967, Eq. 5-1...5-4); each edge has its own opening law.
    """

    supply = HydraulicPort("pressure supply")
    tank = HydraulicPort("tank")
    a = HydraulicPort("work port a")
    b = HydraulicPort("work port b")
    spool = Input("1", "spool position")
    orifice = Slot(OrificeLaw, default=TurbulentOrifice())
    supply_to_a = Slot(MeteringEdgeLaw, default=ZeroOverlapEdge())
    supply_to_b = Slot(MeteringEdgeLaw, default=ZeroOverlapEdge())
    a_to_tank = Slot(MeteringEdgeLaw, default=ZeroOverlapEdge())
    b_to_tank = Slot(MeteringEdgeLaw, default=ZeroOverlapEdge())

    def equations(self):
        x, flow = self.spool, self.orifice.flow
        p_s, p_t, p_a, p_b = self.supply.p, self.tank.p, self.a.p, self.b.p
        q_sa = flow(self.supply_to_a.opening(x), p_s - p_a)
        q_sb = flow(self.supply_to_b.opening(-x), p_s - p_b)
        q_at = flow(self.a_to_tank.opening(-x), p_a - p_t)
        q_bt = flow(self.b_to_tank.opening(x), p_b - p_t)
        yield self.supply.q == q_sa + q_sb
        yield self.tank.q == -(q_at + q_bt)
        yield self.a.q == q_at - q_sa
        yield self.b.q == q_bt - q_sb
