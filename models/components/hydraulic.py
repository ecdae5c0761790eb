"""Pump, cylinder, volumes, passages and the ends of a hydraulic circuit."""

from __future__ import annotations

from hydrotwin.models.language import Component, Flange, HydraulicPort, Input, Parameter, Shaft, Slot, State, der
from hydrotwin.models.laws import (
    BulkModulusLaw,
    ConstantBulkModulus,
    FrictionLaw,
    LeakageLaw,
    NoLeakage,
    NoPumpLoss,
    OrificeLaw,
    PumpLossLaw,
    Stribeck,
    TurbulentOrifice,
)


class Pump(Component):
    """Fixed-displacement pump driven by a shaft: ``q = c_p w``, and ``return_ratio`` of it drawn from the other side.

    With ``return_ratio`` = A_rod/A_cap the automatic valves and the reservoir of a C-EHA are included (Eq. 6).
    The shaft torque is the one of an ideal pump, ``tau = c_p (p_cap - return_ratio p_rod)``.
    """

    shaft = Shaft("drive shaft")
    cap = HydraulicPort("side that is filled at positive speed")
    rod = HydraulicPort("side that is emptied at positive speed")
    loss = Slot(PumpLossLaw, default=NoPumpLoss())
    displacement = Parameter(
        1.05e-7, "m3/rad", "volumetric capacity c_p", bounds=(1e-10, 1e-3), source="C-EHA paper, Table 1"
    )
    return_ratio = Parameter(1.0, "1", "return flow over delivered flow", bounds=(0.1, 1.5), source="1: closed circuit")

    def equations(self):
        c_p, ratio = self.displacement, self.return_ratio
        dp = self.cap.p - ratio * self.rod.p
        delivered = self.loss.delivered(c_p * self.shaft.w, dp)
        yield self.cap.q == -delivered
        yield self.rod.q == ratio * delivered
        yield self.shaft.tau == c_p * dp


class Cylinder(Component):
    """Differential cylinder: two oil volumes on one piston. The housing is fixed.

    Continuity of each chamber (C-EHA paper, Eq. 1-3) and the force balance (Eq. 4):

        dp_cap/dt = beta/V_cap (q_cap - A_cap v),   V_cap = V0_cap + A_cap s
        dp_rod/dt = beta/V_rod (q_rod + A_rod v),   V_rod = V0_rod + A_rod (s_ref - s)
        p_cap A_cap - p_rod A_rod = F + F_friction(v)
    """

    cap = HydraulicPort("cap side")
    annulus = HydraulicPort("rod side")
    rod = Flange("piston rod; s grows as it extends")
    friction = Slot(FrictionLaw, default=Stribeck())
    oil = Slot(BulkModulusLaw, default=ConstantBulkModulus())
    leakage = Slot(LeakageLaw, default=NoLeakage())
    cap_area = Parameter(8.042e-4, "m2", "piston area, cap side", bounds=(1e-6, 1.0), source="C-EHA paper, Table 1")
    rod_area = Parameter(6.319e-4, "m2", "annulus area, rod side", bounds=(1e-6, 1.0), source="C-EHA paper, Table 1")
    cap_dead_volume = Parameter(8e-5, "m3", "cap-side volume at s = 0", bounds=(1e-7, 1.0), source="assumed")
    rod_dead_volume = Parameter(
        8e-5, "m3", "rod-side volume at s = rod_reference", bounds=(1e-7, 1.0), source="assumed"
    )
    rod_reference = Parameter(
        0.0,
        "m",
        "position s_ref at which the rod side holds its dead volume",
        bounds=(-10, 10),
        nominal=0.1,
        source="0: both dead volumes at s = 0",
    )
    cap_pressure = State(2e6, "Pa", "pressure, cap side", nominal=1e6)
    rod_pressure = State(2e6, "Pa", "pressure, rod side", nominal=1e6)

    def equations(self):
        A_cap, A_rod, s, v = self.cap_area, self.rod_area, self.rod.s, der(self.rod.s)
        p_cap, p_rod = self.cap_pressure, self.rod_pressure
        V_cap = self.cap_dead_volume + A_cap * s
        V_rod = self.rod_dead_volume + A_rod * (self.rod_reference - s)
        q_leak = self.leakage.flow(p_cap - p_rod)
        yield self.cap.p == p_cap
        yield self.annulus.p == p_rod
        yield der(p_cap) == self.oil.effective(p_cap) / V_cap * (self.cap.q - q_leak - A_cap * v)
        yield der(p_rod) == self.oil.effective(p_rod) / V_rod * (self.annulus.q + q_leak + A_rod * v)
        yield -self.rod.f == p_cap * A_cap - p_rod * A_rod - self.friction.force(v)


class LineVolume(Component):
    """Oil in a line between two ports: ``dp/dt = beta/V (q_a + q_b)``. Source: Merritt (1967), Eq. 3-30."""

    a = HydraulicPort("one end")
    b = HydraulicPort("other end")
    oil = Slot(BulkModulusLaw, default=ConstantBulkModulus())
    volume = Parameter(1e-4, "m3", "enclosed volume", bounds=(1e-9, 10.0), source="geometry")
    pressure = State(2e6, "Pa", "pressure in the line", nominal=1e6)

    def equations(self):
        yield self.a.p == self.pressure
        yield self.b.p == self.pressure
        yield der(self.pressure) == self.oil.effective(self.pressure) / self.volume * (self.a.q + self.b.q)


class Orifice(Component):
    """A fixed opening between two ports; the law says how flow follows pressure."""

    a = HydraulicPort("one side")
    b = HydraulicPort("other side")
    law = Slot(OrificeLaw, default=TurbulentOrifice())
    opening = Parameter(1.0, "1", "fraction of the full passage", bounds=(0, 1), source="setting")

    def equations(self):
        yield self.a.q == self.law.flow(self.opening, self.a.p - self.b.p)
        yield self.a.q + self.b.q == 0


class Passage(Component):
    """A leak or laminar passage between two ports; the law says how flow follows pressure."""

    a = HydraulicPort("one side")
    b = HydraulicPort("other side")
    law = Slot(LeakageLaw, default=NoLeakage())

    def equations(self):
        yield self.a.q == self.law.flow(self.a.p - self.b.p)
        yield self.a.q + self.b.q == 0


class Reservoir(Component):
    """A tank at constant pressure."""

    port = HydraulicPort("connection")
    pressure = Parameter(5e5, "Pa", "tank pressure", bounds=(0, 1e8), source="setting")

    def equations(self):
        yield self.port.p == self.pressure


class PressureSource(Component):
    """A supply that holds its pressure whatever it delivers."""

    port = HydraulicPort("connection")
    pressure = Parameter(180e5, "Pa", "supply pressure", bounds=(0, 1e9), source="setting")

    def equations(self):
        yield self.port.p == self.pressure


class FlowSource(Component):
    """A prescribed flow into the circuit."""

    port = HydraulicPort("connection")
    flow = Input("m3/s", "flow into the circuit", nominal=1e-4)

    def equations(self):
        yield self.port.q == -self.flow


class Plug(Component):
    """A closed end: no flow."""

    port = HydraulicPort("closed end")

    def equations(self):
        yield self.port.q == 0
