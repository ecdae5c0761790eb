"""Oil that takes another way, and pumps that deliver less than they should."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from hydrotwin.models.language import Component, HydraulicPort, Input, Parameter
from hydrotwin.models.language.units import compatible
from hydrotwin.models.laws.orifice import signed_root

from .effect import Effect, Site
from .exceeded import exceeded
from .sites import hydraulic_nodes, hydraulic_pairs, open_tank_node, pumps

MERRITT = "H. Merritt, Hydraulic Control Systems, 1967"
IVANTYSYN = "J. and M. Ivantysynova, Hydrostatic Pumps and Motors, 2001"
NOTHING = 1e-100  # keeps the power of a share differentiable where there is none


class InternalLeakage(Effect):
    """Laminar leak between two volumes, such as past the piston seal.

        q = G (p_a - p_b)

    To a tank, too, if that is not open: else it is `ExternalLeakage`. Source: Merritt 1967.
    """

    id, title = "internal_leakage", "internal leakage"
    equation = "q = G (p_a - p_b)"
    source = MERRITT
    typical = {"conductance": (1e-14, 1e-11)}
    probes = ({"conductance": 1e-13}, {"conductance": 2e-12})
    confused_with = ("external_leakage", "pump_slip", "turbulent_leakage", "motor_droop", "null_bias")
    experiment = "hold under load, in several positions and at several pressures"

    a = HydraulicPort("one side")
    b = HydraulicPort("other side")
    conductance = Parameter(
        0.0, "m3/(s.Pa)", "leak conductance G", bounds=(0, 1e-9), nominal=1e-13, source=MERRITT, free=True
    )

    @classmethod
    def sites(cls, places):
        tank = open_tank_node(places)
        yield from (s for s in hydraulic_pairs(places) if not (tank and tank.name in s.ties.values()))

    def equations(self):
        yield self.a.q == self.conductance * (self.a.p - self.b.p)
        yield self.a.q + self.b.q == 0


class ExternalLeakage(Effect):
    """Laminar leak out of the circuit: to the surroundings, or a tank that is open to them.

        q = G (p - p_0)

    Into a tank under pressure oil gets within the machine alone: that is `InternalLeakage`. Source: Merritt 1967.
    """

    id, title = "external_leakage", "external leakage"
    equation = "q = G (p - p_0)"
    source = MERRITT
    typical = {"conductance": (1e-14, 1e-11)}
    probes = ({"conductance": 1e-13}, {"conductance": 2e-12})
    confused_with = ("internal_leakage", "pump_slip", "turbulent_leakage", "motor_droop", "null_bias")
    experiment = "hold under load and without, with both pressures: an internal leak feeds the other side"

    port = HydraulicPort("what leaks")
    conductance = Parameter(
        0.0, "m3/(s.Pa)", "leak conductance G", bounds=(0, 1e-9), nominal=1e-13, source=MERRITT, free=True
    )
    outside = Parameter(0.0, "Pa", "pressure outside p_0", bounds=(0, 1e7), nominal=1e5, source="surroundings, gauge")

    @classmethod
    def sites(cls, places):
        tank = open_tank_node(places)
        for site in hydraulic_nodes(places):
            yield replace(site, reads={"outside": f"{tank.name}.p"}) if tank else site

    @classmethod
    def at(cls, site: Site):
        return LeakToTank() if site.reads else cls()

    def equations(self):
        yield self.port.q == self.conductance * (self.port.p - self.outside)


class LeakToTank(Component):
    """External leak against the pressure of an open tank: ``q = G (p - p_tank)``. Source: Merritt 1967."""

    port = HydraulicPort("what leaks")
    outside = Input("Pa", "pressure of the tank", nominal=1e5)
    conductance = ExternalLeakage.conductance

    def equations(self):
        yield self.port.q == self.conductance * (self.port.p - self.outside)


class TurbulentLeakage(Effect):
    """Leak through a sharp edge, such as a seat that does not close.

        q = k sign(dp) sqrt|dp|

    Linear below ``transition_pressure``. Source: Merritt 1967, Eq. 3-4.
    """

    id, title = "turbulent_leakage", "turbulent leakage"
    equation = "q = k sign(dp) sqrt|dp|"
    source = MERRITT
    typical = {"coefficient": (1e-11, 1e-8)}
    probes = ({"coefficient": 2e-10}, {"coefficient": 4e-9})
    confused_with = ("internal_leakage", "external_leakage", "pump_slip", "motor_droop", "null_bias")
    experiment = "hold at a small and at a large load: the laminar leak is proportional to the pressure"

    a = HydraulicPort("one side")
    b = HydraulicPort("other side")
    coefficient = Parameter(
        0.0, "m3/(s.sqrt(Pa))", "flow coefficient k", bounds=(0, 1e-6), nominal=1e-10, source=MERRITT, free=True
    )
    transition_pressure = Parameter(5e4, "Pa", "where the flow turns laminar", bounds=(1, 1e7), source=MERRITT)

    sites = staticmethod(hydraulic_pairs)

    def equations(self):
        dp = self.a.p - self.b.p
        yield self.a.q == self.coefficient * signed_root(dp, self.transition_pressure)
        yield self.a.q + self.b.q == 0


def _loss_sites(places):
    """Pumps, with the flow at their second port as ``q_b`` too."""
    for site in pumps(places):
        yield replace(site, reads={**site.reads, "q_b": f"{site.ties['b']}.q"})


def _slip_sites(places):
    """Pumps and the speed of their shaft."""
    for site in pumps(places):
        yield replace(site, reads={"w": site.reads["w"]})


class PumpSlip(Effect):
    """Gap flow back through the pump; it grows with the pressure and falls with the speed.

        q = G (p_a - p_b) / (1 + |w| / w_0)

    With w_0 far above all speeds it is an `InternalLeakage`. Source: Ivantysyn and Ivantysynova 2001; the fall with
    speed stands for gaps that fill from the film in motion.
    """

    id, title = "pump_slip", "slip of the pump"
    equation = "q = G dp / (1 + |w| / w_0)"
    source = IVANTYSYN
    typical = {"conductance": (1e-14, 1e-11), "reference_speed": (5.0, 500.0)}
    probes = (
        {"conductance": 3e-13, "reference_speed": 10.0},
        {"conductance": 3e-13, "reference_speed": 100.0},
        {"conductance": 4e-12, "reference_speed": 50.0},
    )
    confused_with = ("internal_leakage", "external_leakage", "speed_dependent_efficiency", "motor_droop")
    experiment = "hold under load with the pump at rest, then lift the same load at several speeds"

    a = HydraulicPort("side that is filled at positive speed")
    b = HydraulicPort("other side")
    w = Input("rad/s", "speed of the pump", nominal=100.0)
    conductance = Parameter(
        0.0, "m3/(s.Pa)", "slip conductance at rest G", bounds=(0, 1e-9), nominal=1e-13, source=IVANTYSYN, free=True
    )
    reference_speed = Parameter(
        50.0, "rad/s", "speed w_0 that halves it", bounds=(1, 1e4), nominal=50.0, source="assumed", free=True
    )

    sites = staticmethod(_slip_sites)

    def equations(self):
        dp = self.a.p - self.b.p
        yield self.a.q == self.conductance * dp / (1 + ca.fabs(self.w) / self.reference_speed)
        yield self.a.q + self.b.q == 0


class SpeedDependentEfficiency(Effect):
    """A share of the flow is not delivered; it falls with the speed.

        eta = 1 - e (1 + |w| / (n w_0))^-n

    A hyperbola for n = 1, nearly an exponential for n = 10: gaps differ in how fast they fill.
    Source: Ivantysyn and Ivantysynova 2001: filling and slip weigh most at low speed. Validity: while it pumps.
    """

    id, title = "speed_dependent_efficiency", "efficiency that depends on speed"
    equation = "q = q_ideal (1 - e (1 + |w| / (n w_0))^-n)"
    source = IVANTYSYN
    typical = {"loss": (0.02, 0.3), "reference_speed": (10.0, 300.0), "shape": (0.5, 10.0)}
    probes = (
        {"loss": 0.05, "reference_speed": 50.0, "shape": 1.0},
        {"loss": 0.2, "reference_speed": 50.0, "shape": 3.0},
        {"loss": 0.1, "reference_speed": 200.0, "shape": 1.0},
    )
    confused_with = ("pump_slip", "internal_leakage", "displacement_error", "motor_droop")
    experiment = "the same load at several speeds in both directions, then another load"

    a = HydraulicPort("side that is filled at positive speed")
    b = HydraulicPort("other side")
    w = Input("rad/s", "speed of the pump", nominal=100.0)
    q = Input("m3/s", "flow into the pump at a", nominal=1e-4)
    q_b = Input("m3/s", "flow into the pump at b", nominal=1e-4)
    loss = Parameter(0.0, "1", "share e lost at rest", bounds=(0, 0.9), nominal=0.05, source=IVANTYSYN, free=True)
    reference_speed = Parameter(50.0, "rad/s", "speed w_0 over which it falls", (2, 2000), 50.0, IVANTYSYN, True)
    shape = Parameter(1.0, "1", "how steeply it falls n", (0.5, 20), 1.0, "assumed", True)

    sites = staticmethod(_loss_sites)

    def equations(self):
        falls = 1 + ca.fabs(self.w) / (self.shape * self.reference_speed)
        share = self.loss * falls**-self.shape
        yield self.a.q == -share * self.q
        yield self.b.q == -share * self.q_b


class FillingLoss(Effect):
    """Chambers that fill the less, the faster the pump turns: efficiency falls with rising speed, from suction on.

        q = q_ideal (1 + (c |w| / w_r)^n)^(-1/n)

    n = 1 falls from the start, q = q_ideal / (1 + c |w| / w_r); a large n holds up to the speed w_r / c, from which on
    no more comes, however fast it turns. Source: Ivantysyn and Ivantysynova 2001 (filling and suction). Validity: no
    pressure helps to fill it.
    """

    id, title = "filling_loss", "filling that falls with rising speed"
    equation = "q = q_ideal (1 + (c |w| / w_r)^n)^(-1/n)"
    source = IVANTYSYN
    typical = {"ratio": (0.01, 1.0), "sharpness": (1.0, 8.0)}
    probes = (
        {"ratio": 0.02, "sharpness": 1.0},
        {"ratio": 0.1, "sharpness": 1.0},
        {"ratio": 0.4, "sharpness": 4.0},
    )
    confused_with = ("speed_dependent_efficiency", "command_saturation", "motor_droop", "displacement_error")
    experiment = "steady speeds up to the highest at one load, with the flow or the speed of the cylinder measured"

    a = HydraulicPort("side that is filled at positive speed")
    b = HydraulicPort("other side")
    w = Input("rad/s", "speed of the pump", nominal=100.0)
    q = Input("m3/s", "flow into the pump at a", nominal=1e-4)
    q_b = Input("m3/s", "flow into the pump at b", nominal=1e-4)
    ratio = Parameter(0.0, "1", "share c of w_r", bounds=(0, 50), nominal=0.1, source=IVANTYSYN, free=True)
    sharpness = Parameter(1.0, "1", "n", bounds=(1, 50), nominal=1.0, source=IVANTYSYN, free=True)
    reference_speed = Parameter(100.0, "rad/s", "w_r", bounds=(1e-3, 1e5), source="a usual speed")

    sites = staticmethod(_loss_sites)

    @classmethod
    def probes_for(cls, seen):
        """Speeds from which on no more comes among the highest seen, and a tenth lost at the highest."""
        speeds = np.abs(np.asarray(seen["w"], float))
        if not speeds.max() > 0:
            return []
        usual = cls.reference_speed.value
        sudden = [{"ratio": usual / speed, "sharpness": 8.0} for speed in exceeded([0.0, *speeds]) if speed > 0]
        return [{"ratio": 0.1 * usual / float(speeds.max()), "sharpness": 1.0}, *sudden]

    def equations(self):
        n, share = self.sharpness, self.ratio * ca.fabs(self.w) / self.reference_speed
        lost = 1 - (1 + (share + NOTHING) ** n) ** (-1 / n)
        yield self.a.q == -lost * self.q
        yield self.b.q == -lost * self.q_b


class DisplacementError(Effect):
    """A flow per turn, or per opening, that is not what the data sheet says; the parameter becomes free."""

    id, title = "displacement_error", "displacement or flow coefficient other than stated"
    equation = "c = c_stated (1 + e)"
    source = "tolerances of the data sheet"
    typical = {"value": (0.85, 1.15)}
    probes = ({"value": 1.05}, {"value": 0.95})
    confused_with = ("area_error", "sensor_scale", "speed_dependent_efficiency", "linkage_error")
    experiment = "pressures and position together, at two loads and several speeds"

    @classmethod
    def sites(cls, places):
        for p in places.model.flat.parameters:
            turns = compatible(p.unit, "m3/rad")
            added = any(p.name.startswith(f"{a.name}.") for a in places.model.additions if a.part is not None)
            if (turns or compatible(p.unit, "m3/(s.sqrt(Pa))")) and not (p.free or added) and p.value:
                yield Site(p.name, frees=p.name, unit=p.unit, nominal=p.nominal)


class DisplacementAsymmetry(Effect):
    """A pump that delivers more in one direction than in the other, as gear pumps with suction on one side do.

    q = q_ideal (1 + e sign(w)),   sign smoothed as tanh(w / w_s)
    """

    id, title = "displacement_asymmetry", "displacement that differs by direction"
    equation = "q = q_ideal (1 + e sign(w))"
    source = IVANTYSYN
    typical = {"asymmetry": (-0.15, 0.15)}
    probes = ({"asymmetry": 0.05}, {"asymmetry": -0.05})
    confused_with = ("direction_asymmetry", "area_error", "pump_slip", "asymmetric_friction")
    experiment = "the same speeds in both directions at two loads"

    a = HydraulicPort("side that is filled at positive speed")
    b = HydraulicPort("other side")
    w = Input("rad/s", "speed of the pump", nominal=100.0)
    q = Input("m3/s", "flow into the pump at a", nominal=1e-4)
    q_b = Input("m3/s", "flow into the pump at b", nominal=1e-4)
    asymmetry = Parameter(
        0.0, "1", "half the difference e of the flows", bounds=(-0.5, 0.5), nominal=0.05, source=IVANTYSYN, free=True
    )
    smoothing_speed = Parameter(1.0, "rad/s", "w_s", bounds=(1e-3, 100), source="numerical")

    sites = staticmethod(_loss_sites)

    def equations(self):
        more = self.asymmetry * ca.tanh(self.w / self.smoothing_speed)
        yield self.a.q == more * self.q
        yield self.b.q == more * self.q_b
