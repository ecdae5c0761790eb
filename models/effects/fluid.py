"""Oil and lines: what softens, holds back or limits a pressure.

Effects on the oil of a volume change the rate of its pressure. Written on the rate they need neither the volume nor
what flows: a fraction of air acts on every volume of the machine alike, however large it is at the moment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from hydrotwin.models.language import HydraulicPort, Input, Output, Parameter, State, der
from hydrotwin.models.language.places import Places
from hydrotwin.models.language.units import compatible

from .effect import Effect, Site
from .exceeded import exceeded, fallen_below
from .sites import hydraulic_nodes, low_pressure_node
from .stepping import Lagged, stepped

MERRITT = "H. Merritt, Hydraulic Control Systems, 1967"
NYKAENEN = "T. Nykaenen et al., Comparison of different fluid models, 2000"
WATTON = "J. Watton, Fundamentals of Fluid Power Control, 2009"
BEYOND = 1e9  # Pa, a pressure that nothing reaches


def oil_pressures(places: Places) -> list[str]:
    """States that are the pressure of a part with hydraulic ports."""
    pressures = {s.path for s in places.states if compatible(s.unit, "Pa")}
    found = [s for part in places.parts if part.ports_of(HydraulicPort) for s in part.states if s in pressures]
    return list(dict.fromkeys(found))  # a part may hold another: one pressure, one rate


@dataclass(frozen=True)
class OilSite(Site):
    """All volumes of a machine: one oil."""

    count: int = 1


class OilEffect(Effect):
    """An effect on all oil of a machine: on the rate of each pressure, ``y_k == u_k / softer(p_k)``."""

    @classmethod
    def sites(cls, places: Places):
        found = dict(enumerate(oil_pressures(places)))
        if found:
            yield OilSite(
                "oil",
                reads={f"p_{k}": path for k, path in found.items()},
                through={str(k): f"der({path})" for k, path in found.items()},
                count=len(found),
            )

    @classmethod
    def at(cls, site: Site):
        """The part for so many volumes."""
        own = {"__module__": cls.__module__, "__doc__": cls.__doc__, "id": "", "count": site.count}
        return type(f"{cls.__name__}On{site.count}", (cls,), own | cls.content(site))()

    @classmethod
    def content(cls, site: OilSite) -> dict:
        """What it has for each volume."""
        content = {}
        for k in range(site.count):
            content[f"p_{k}"] = Input("Pa", "pressure", nominal=1e6)
            content[f"u_{k}"] = Input("Pa/s", "its rate without the effect", nominal=1e6)
            content[f"y_{k}"] = Output("Pa/s", "its rate", nominal=1e6)
        return content

    def softer(self, p):
        """By how much the oil is softer at absolute pressure p [Pa]."""
        raise NotImplementedError

    def equations(self):
        for k in range(self.count):
            yield getattr(self, f"y_{k}") == getattr(self, f"u_{k}") / self.softer(getattr(self, f"p_{k}"))


def _bulk_modulus(places: Places) -> dict[str, str]:
    """What the effect reads as the stiffness of the oil: the largest that the model calls a bulk modulus, if any."""
    named = [(p.value, p.name) for p in places.model.flat.parameters if p.name.endswith("bulk_modulus")]
    return {"stiffness": max(named)[1]} if named else {}


class EntrainedAir(OilEffect):
    """Free air in the oil, everywhere in the machine: soft at low pressure.

        dp/dt = (dp/dt without air) / (1 + a (beta/(n p)) (p_0/p)^(1/n))

    ``a`` is the volume of air per volume of oil at atmospheric pressure p_0; beta is the model's bulk modulus, that of
    mineral oil where it has none.
    Validity: as AirLadenBulkModulus. Source: Merritt 1967, section 2.3; Nykaenen et al. 2000.
    """

    id, title = "entrained_air", "entrained air"
    equation = "1/beta_e = 1/beta + a (p_0/p)^(1/n) / (n p)"
    source = NYKAENEN
    typical = {"fraction": (1e-3, 0.05), "exponent": (1.0, 1.4)}
    probes = ({"fraction": 2e-3, "exponent": 1.3}, {"fraction": 0.02, "exponent": 1.3})
    confused_with = ("line_compliance", "structural_compliance", "cavitation")
    experiment = "fast reversals at low and at high mean pressure, with pressures: air stiffens, a hose does not"

    fraction = Parameter(0.0, "1", "a, free air at p_0", bounds=(0, 0.3), nominal=0.01, source=NYKAENEN, free=True)
    stiffness = Parameter(1.4e9, "Pa", "beta of the oil alone", bounds=(1e6, 1e11), source=MERRITT)
    exponent = Parameter(1.4, "1", "n: 1 isothermal, 1.4 adiabatic", (1, 1.67), 1.0, MERRITT, True)
    reference = Parameter(1.013e5, "Pa", "p_0", bounds=(1e4, 1e6), source="atmosphere")

    @classmethod
    def sites(cls, places: Places):
        for site in super().sites(places):
            yield replace(site, reads={**site.reads, **_bulk_modulus(places)})

    @classmethod
    def content(cls, site: OilSite) -> dict:
        read = Input("Pa", "beta of the oil alone", nominal=1e9)
        return super().content(site) | ({"stiffness": read} if "stiffness" in site.reads else {})

    def softer(self, p):
        n, p_0 = self.exponent, self.reference
        p = ca.fmax(p, 0.01 * p_0)
        return 1 + self.fraction * self.stiffness / (n * p) * (p_0 / p) ** (1 / n)


class Cavitation(OilEffect):
    """Below a pressure the oil tears: the pressure stays, and the hollow has to be filled again before it rises.

        dp/dt = (dp/dt without it) / (1 + max(p_v - p, 0)/p_w)

    with a small p_w: below p_v a volume gives way without much change of pressure. No oil is gained or lost.
    Source: Nykaenen et al. 2000.
    """

    id, title = "cavitation", "cavitation"
    equation = "p >= p_v: below, the volume gives way"
    source = NYKAENEN
    typical = {"pressure": (0.0, 1e5)}
    probes = ({"pressure": 2e3}, {"pressure": 5e4}, {"pressure": 2e5})
    confused_with = ("check_valve_cracking", "entrained_air", "relief_saturation")
    experiment = "pull fast against the load with both pressures measured, and look whether motion comes back late"

    pressure = Parameter(-BEYOND, "Pa", "p_v", bounds=(-BEYOND, 2e6), nominal=1e5, source="far below: none", free=True)
    transition = Parameter(200.0, "Pa", "p_w", bounds=(1, 1e5), source="numerical")

    def softer(self, p):
        return 1 + ca.fmax(self.pressure - p, 0) / self.transition

    @classmethod
    def probes_for(cls, seen) -> list[dict]:
        """Vapour pressures that the lowest pressures seen fall below."""
        lowest = np.min([np.asarray(p) for name, p in seen.items() if name.startswith("p_")], axis=0)
        return [*cls.probes, *({"pressure": level} for level in fallen_below(lowest))]


class LineCompliance(Effect):
    """A hose or a soft line on a volume, or one of the same kind on each.

        q = C dp/dt

    Source: Merritt 1967.
    """

    id, title = "line_compliance", "compliance of a line"
    equation = "q = C dp/dt"
    source = MERRITT
    typical = {"compliance": (1e-14, 5e-12)}  # hoses: bulk modulus 0.05-0.5 GPa
    probes = ({"compliance": 1e-13}, {"compliance": 2e-12}, {"compliance": 5e-12})
    confused_with = ("entrained_air", "structural_compliance", "actuator_lag")
    experiment = "pressure steps with the cylinder blocked, at a low and at a high pressure"

    compliance = Parameter(0.0, "m3/Pa", "C", bounds=(0, 1e-9), nominal=1e-13, source=MERRITT, free=True)

    @classmethod
    def sites(cls, places: Places):
        nodes = _volume_nodes(places)
        if len(nodes) > 1:
            yield Site("lines", ties={f"port_{k}": name for k, name in enumerate(nodes)})
        yield from (Site(name, ties={"port_0": name}) for name in nodes)

    @classmethod
    def at(cls, site: Site):
        """The part for so many lines, all of one kind."""
        ports = {name: HydraulicPort("where a line is") for name in site.ties}
        content = {"__module__": cls.__module__, "__doc__": cls.__doc__, "id": "", "count": len(ports)}
        return type(f"{cls.__name__}On{len(ports)}", (cls,), {**content, **ports})()

    def equations(self):
        for port in (getattr(self, f"port_{k}") for k in range(self.count)):
            yield port.q == self.compliance * der(port.p)


def _volume_nodes(places: Places) -> list[str]:
    """Nodes on which a volume of oil lies."""
    holding = {path.rpartition(".")[0] for path in oil_pressures(places)}
    return [
        site.name
        for site in hydraulic_nodes(places)
        if holding & {port.rpartition(".")[0] for port in places.node_at(site.name).ports}
    ]


def _chamber_lines(places: Places):
    """Ports of volumes that something else feeds: all of them, then each."""
    names = _volume_nodes(places)
    if len(names) > 1:
        yield Site("lines", between={str(k): name for k, name in enumerate(names)})
    yield from (Site(name, between={"0": name}) for name in names)


class LineFriction(Lagged):
    """Pressure lost on the way to a volume, or to each of several by lines of one kind.

        p_b - p_a = R q + K q |q|,   T_0 q' = q_in - q

    laminar and turbulent share; the flow is taken after a small lag, so that no loop arises.
    Source: Merritt 1967, section 3.
    """

    id, title = "line_friction", "pressure loss of a line"
    equation = "dp = R q + K q |q|"
    source = MERRITT
    typical = {"laminar": (1e8, 5e10), "turbulent": (1e12, 1e15)}
    probes = (
        {"laminar": 1e9, "turbulent": 0.0},
        {"laminar": 2e10, "turbulent": 0.0},
        {"laminar": 0.0, "turbulent": 1e14},
    )
    confused_with = ("viscous_friction", "flow_saturation", "supply_droop")
    experiment = "constant speeds over a wide range at two loads, with the pressure at the pump or valve measured too"

    laminar = Parameter(0.0, "Pa.s/m3", "R", bounds=(0, 1e12), nominal=1e9, source=MERRITT, free=True)
    turbulent = Parameter(0.0, "Pa.s2/m6", "K", bounds=(0, 1e17), nominal=1e13, source=MERRITT, free=True)
    resolution = Parameter(2e-3, "s", "T_0", bounds=(1e-5, 0.1), source="numerical")

    sites = stepped(_chamber_lines)

    @classmethod
    def at(cls, site: Site):
        """The part for so many lines, all of one kind."""
        count = len(site.between)
        content = {"__module__": cls.__module__, "__doc__": cls.__doc__, "id": "", "count": count}
        for k in range(count):
            content[f"a_{k}"] = HydraulicPort("the port of a volume")
            content[f"b_{k}"] = HydraulicPort("where it was joined")
            content[f"flow_{k}"] = State(0.0, "m3/s", "flow to the volume", nominal=1e-4)
        return super(LineFriction, type(f"{cls.__name__}On{count}", (cls,), content)).at(site)

    def equations(self):
        for k in range(self.count):
            a, b, q = (getattr(self, f"{name}_{k}") for name in ("a", "b", "flow"))
            yield self.resolution * der(q) == b.q - q
            yield b.p - a.p == self.laminar * q + self.turbulent * q * ca.fabs(q)
            yield a.q + b.q == 0


def _tank_ports(places: Places):
    """The port of what holds the pressure of the tank."""
    node = low_pressure_node(places)
    for port in node.ports if node else ():
        part = places.part(port.rpartition(".")[0])
        if part and len(part.ports) == 1 and not part.states and not part.inputs:
            yield Site(port, between=port)


class ReturnCheckValve(Lagged):
    """A spring-loaded check valve in the return line keeps a pressure before the tank while oil flows out.

        p_b - p_a = p_c for flow towards the tank, over the first q_0 of it;   T_0 q' = q_in - q

    Against flow out of the tank it has no resistance here. Source: Watton 2009.
    """

    id, title = "return_check_valve", "check valve in the return line"
    equation = "p_return = p_tank + p_c while oil returns"
    source = WATTON
    typical = {"cracking": (3e4, 5e5)}
    probes = ({"cracking": 5e4}, {"cracking": 3e5})
    confused_with = ("constant_load", "check_valve_cracking", "line_friction")
    experiment = "slow motion both ways, with both pressures measured: the lower one never falls below the tank's"

    a = HydraulicPort("the port of the tank")
    b = HydraulicPort("the return line")
    cracking = Parameter(0.0, "Pa", "p_c", bounds=(0, 5e6), nominal=1e5, source="typical 0.3-5 bar", free=True)
    smallest_flow = Parameter(2e-6, "m3/s", "q_0", bounds=(1e-9, 1e-3), source="numerical")
    resolution = Parameter(2e-3, "s", "T_0", bounds=(1e-5, 0.1), source="numerical")
    flow = State(0.0, "m3/s", "flow towards the tank", nominal=1e-4)

    sites = stepped(_tank_ports)

    def equations(self):
        q = self.flow
        yield self.resolution * der(q) == self.b.q - q
        yield self.b.p - self.a.p == self.cracking * ca.fmax(ca.tanh(q / self.smallest_flow), 0)
        yield self.a.q + self.b.q == 0


class _Valve(Effect):
    """A valve that opens a volume beyond a set pressure, wider the further beyond."""

    port = HydraulicPort("the volume")
    conductance = Parameter(
        1e-11, "m3/(s.Pa)", "G once it is open", bounds=(1e-15, 1e-8), nominal=1e-11, source=WATTON, free=True
    )

    sites = staticmethod(hydraulic_nodes)

    @staticmethod
    def _at(pressures) -> list[dict]:
        """Every pressure with every size of valve."""
        return [{"pressure": float(p), "conductance": G} for p in pressures for G in (1e-13, 1e-11, 1e-10)]


class CheckValveCracking(_Valve):
    """A check valve feeds a volume from a low-pressure reservoir: anti-cavitation, make-up oil of a closed circuit.

        q = G max(p_o - p, 0) into the volume,   p_o = p_reservoir - p_cracking

    Only p_o can be told where the reservoir is not measured. Source: Watton 2009.
    """

    id, title = "check_valve_cracking", "check valve that feeds a volume"
    equation = "q = G max(p_o - p, 0) comes in, p_o = p_reservoir - p_cracking"
    source = WATTON
    typical = {"pressure": (0.0, 2e6), "conductance": (1e-13, 1e-9)}
    probes = ({"pressure": 5e4}, {"pressure": 3e5}, {"pressure": 1e6})
    confused_with = ("cavitation", "external_leakage", "return_check_valve")
    experiment = "pull so that the pressure falls, with it measured: after a feed the mean pressure is higher for good"

    pressure = Parameter(-BEYOND, "Pa", "p_o", bounds=(-BEYOND, 1e7), nominal=1e5, source="far below: none", free=True)

    def equations(self):
        yield self.port.q == -self.conductance * ca.fmax(self.pressure - self.port.p, 0)

    @classmethod
    def probes_for(cls, seen) -> list[dict]:
        """Opening pressures that the pressure seen falls below now and then."""
        return cls._at(fallen_below(seen["port.p"]))


class ReliefSaturation(_Valve):
    """A relief valve lets oil out of a volume above a pressure, the more the higher it is.

        q = G max(p - p_r, 0) out of the volume;   1/G is its override

    Source: Watton 2009.
    """

    id, title = "relief_saturation", "relief valve"
    equation = "q = G max(p - p_r, 0) leaves"
    source = WATTON
    typical = {"pressure": (2e6, 3.5e7), "conductance": (1e-13, 1e-9)}
    probes = ({"pressure": 3e6}, {"pressure": 1e7}, {"pressure": 2e7})
    confused_with = ("command_saturation", "end_stop", "turbulent_leakage")
    experiment = "push against a stop or a blocked load, with pressures: the pressure levels off"

    pressure = Parameter(BEYOND, "Pa", "p_r", bounds=(1e4, BEYOND), nominal=1e6, source="far above: none", free=True)

    def equations(self):
        yield self.port.q == self.conductance * ca.fmax(self.port.p - self.pressure, 0)

    @classmethod
    def probes_for(cls, seen) -> list[dict]:
        """Relief pressures that the pressure seen exceeds now and then."""
        return cls._at(np.clip(exceeded(seen["port.p"]), 1e4, BEYOND))
