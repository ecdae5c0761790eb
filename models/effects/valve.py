"""Valves and what supplies them: edges, spools, flow."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from hydrotwin.models.language import Component, HydraulicPort, Input, Output, Parameter, State, der

from .effect import Effect, Site
from .sites import commands, inside_signals, sources, valve_signals, valve_spools
from .stepping import Lagged, followed, stepped

MERRITT = "H. Merritt, Hydraulic Control Systems, 1967"
JELALI = "M. Jelali and A. Kroll, Hydraulic Servo-systems, 2003"
MOST_LOST = 0.95  # of the flow of an edge
NOTHING = 1e-16  # keeps the power of a share differentiable where there is none


class ValveOverlap(Effect):
    """The spool covers its edges: nothing flows near the centre.

        y = u - D clip(u / D, -1, 1)

    Where the input of the model moves the valve itself, this is `CommandDeadband`. Source: Merritt 1967, section 5.5.
    """

    id, title = "valve_overlap", "overlap of the valve"
    equation = "y = 0 for |u| < D, else u - D sign(u)"
    source = MERRITT
    typical = {"overlap": (0.005, 0.22)}
    probes = ({"overlap": 0.02}, {"overlap": 0.1})
    confused_with = ("command_deadband", "coulomb_friction", "asymmetric_overlap")
    experiment = "slow triangles of the spool through its centre at two loads, with the spool's position measured"
    order = 6

    u = Input("signal", "position of the spool")
    y = Output("signal", "opening of the edges")
    overlap = Parameter(0.0, "signal", "overlap D", bounds=(0, 0.8), nominal=0.02, source=MERRITT, free=True)

    sites = staticmethod(valve_spools)

    def equations(self):
        yield self.y == ca.fmax(self.u - self.overlap, 0) + ca.fmin(self.u + self.overlap, 0)


class AsymmetricOverlap(Effect):
    """The spool covers its edges, more on one side than on the other; a negative overlap would be an open centre.

    y = max(u - D_1, 0) + min(u + D_2, 0)
    """

    id, title = "asymmetric_overlap", "overlap that differs by side"
    equation = "y = max(u - D_1, 0) + min(u + D_2, 0)"
    source = MERRITT
    typical = {"positive": (0.0, 0.22), "negative": (0.0, 0.22)}
    probes = ({"positive": 0.05, "negative": 0.01}, {"positive": 0.01, "negative": 0.05})
    refines = {"valve_overlap": {"positive": "overlap", "negative": "overlap"}}
    confused_with = ("valve_overlap", "command_deadband", "null_bias", "direction_asymmetry")
    experiment = "slow triangles of the spool through its centre at two loads, with the spool's position measured"
    order = 6

    u = Input("signal", "position of the spool")
    y = Output("signal", "opening of the edges")
    positive = Parameter(0.0, "signal", "overlap D_1", bounds=(0, 0.8), nominal=0.02, source=MERRITT, free=True)
    negative = Parameter(0.0, "signal", "overlap D_2", bounds=(0, 0.8), nominal=0.02, source=MERRITT, free=True)

    sites = staticmethod(valve_signals)

    def equations(self):
        yield self.y == ca.fmax(self.u - self.positive, 0) + ca.fmin(self.u + self.negative, 0)


def _first_signals(places):
    """Where a chain of signals that ends at a valve enters its moving part: each chain once."""
    seen = set()
    for site in valve_signals(places):
        sender = next(iter(places.upstream(site.through)), None)
        if sender and sender not in seen and any(w.path == sender and w.role == "inside" for w in places.wires):
            declared = places.variables[sender]
            site = Site(sender, through=sender, unit=declared.unit, nominal=declared.nominal)
        if site.through not in seen:
            seen.add(site.through)
            yield site


def _hysteretic(places):
    """Where moving parts of valves get their signals, then every other command and signal inside."""
    usual = list(_first_signals(places))
    known = {site.through for site in usual}
    yield from usual
    others = (*commands(places), *inside_signals(places))
    yield from (replace(site, further=bool(usual)) for site in others if site.through not in known)


class SpoolHysteresis(Lagged):
    """A spool follows its signal with play, from the magnet's hysteresis and from friction; so may any signal.

        y stays where it is while |u - y| < h

    Written as y = u + (z - w), T_p w' = u - w, T_p z' = deadzone(u - z, h): with h = 0, z is w and y is u.
    ``offset`` is where in its play it starts, -1 to 1. Source: Jelali and Kroll 2003.
    """

    id, title = "spool_hysteresis", "hysteresis of the spool or of a signal"
    equation = "y stays while |u - y| < h, else follows at distance h"
    source = JELALI
    typical = {"half_width": (0.0025, 0.03)}
    probes = ({"half_width": 0.01}, {"half_width": 0.04})
    confused_with = ("backlash", "valve_overlap", "coulomb_friction", "spool_lag")
    experiment = "slow triangles of several heights that do not cross the centre"
    order = 4

    u = Input("signal", "wanted position of the spool")
    y = Output("signal", "what it does")
    followed = State(lambda part: 0.0, "signal", "w", fixed=False)
    dragged = State(lambda part: 0.0, "signal", "z", fixed=False)
    half_width = Parameter(
        0.0, "signal", "half width h of the play", bounds=(0, 0.3), nominal=0.01, source=JELALI, free=True
    )
    offset = Parameter(0.0, "1", "start within the play", bounds=(-1, 1), nominal=1.0, source="unknown: centre")
    resolution = Parameter(1e-3, "s", "T_p", bounds=(1e-5, 0.1), source="numerical")

    sites = stepped(_hysteretic)

    def equations(self):
        u, w, z, h, T = self.u, self.followed, self.dragged, self.half_width, self.resolution
        yield T * der(w) == u - w
        yield T * der(z) == ca.fmax(u - z - h, 0) + ca.fmin(u - z + h, 0)
        yield self.y == u + (z - w)

    def initial_equations(self):
        yield self.followed == self.u
        yield self.dragged == self.u + self.offset * self.half_width


def _slow_spools(places):
    """Valve signals, or the natural frequency of what sends them where the model fixes one."""
    for site in valve_spools(places):
        movers = {path.rpartition(".")[0] for path in places.upstream(site.through) if "." in path}
        own = [
            p
            for p in places.model.flat.parameters
            if p.unit == "rad/s" and p.name.rpartition(".")[0] in movers and not p.free and p.value
        ]
        if own:
            yield from (Site(p.name, frees=p.name, unit=p.unit, nominal=p.nominal) for p in own)
        else:
            yield site


class SpoolLag(Lagged):
    """The spool is slower than stated: its natural frequency where that is fixed, else a lag ``T y' + y = u``.

    Written as in `followed`.
    """

    id, title = "spool_lag", "lag of the spool"
    equation = "T y' + y = u"
    source = JELALI
    typical = {"time_constant": (0.002, 0.05)}
    probes = ({"time_constant": 0.005}, {"time_constant": 0.02})
    confused_with = ("actuator_lag", "dead_time", "sensor_lag")
    experiment = "small steps sampled fast, with the spool's position measured"
    order = 5
    shortest = 0.5

    u = Input("signal", "position of the spool")
    y = Output("signal", "what follows it")
    lagging = State(lambda part: 0.0, "signal", "w", fixed=False)
    time_constant = Parameter(0.0, "s", "lag T", bounds=(0, 0.5), nominal=0.01, source=JELALI, free=True)
    resolution = Parameter(2.5e-4, "s", "T_0", bounds=(1e-5, 0.1), source="numerical")

    sites = stepped(_slow_spools)

    @classmethod
    def freed(cls, value):
        return (0.6 * value, 0.8 * value, 1.3 * value), (0.3 * value, 1.5 * value)

    def equations(self):
        rate, y = followed(self.u, self.lagging, self.time_constant, self.resolution)
        yield der(self.lagging) == rate
        yield self.y == y

    def initial_equations(self):
        yield self.lagging == self.u


class FlowSaturation(Effect):
    """The flow grows less and less with the opening: a passage or a line lies in series, or the edges end.

        y = u / (1 + c^(n/2) |u/u_0|^n)^(1/n)

    With n = 2 exact for two sharp edges in series and for turbulent friction in both lines, c = (k_q / k_fixed)^2; a
    larger n bends more suddenly, as edges do that end. The largest equivalent opening is u_0 / sqrt(c).
    Source: Merritt 1967, section 3.3.
    """

    id, title = "flow_saturation", "flow that saturates with the opening: a passage or line in series"
    equation = "y = u / (1 + c^(n/2) |u/u_0|^n)^(1/n)"
    source = MERRITT
    typical = {"ratio": (0.05, 3.0), "sharpness": (2.0, 8.0)}
    probes = (
        {"ratio": 0.2, "sharpness": 2.0},
        {"ratio": 1.0, "sharpness": 2.0},
        {"ratio": 1.5, "sharpness": 5.0},
        {"ratio": 6.0, "sharpness": 5.0},
    )
    confused_with = ("line_friction", "supply_droop", "command_saturation", "load_dependent_flow")
    experiment = "constant openings up to the largest at one load, with the supply's pressure measured"
    order = 8

    u = Input("signal", "opening")
    y = Output("signal", "opening that would pass the same flow without the fixed passage")
    ratio = Parameter(0.0, "1", "ratio c at full opening", bounds=(0, 50), nominal=0.2, source=MERRITT, free=True)
    sharpness = Parameter(2.0, "1", "n", bounds=(2, 50), nominal=1.0, source=MERRITT, free=True)
    full = Parameter(1.0, "signal", "full opening u_0", bounds=(1e-6, 1e6), source="nominal of the signal")

    sites = staticmethod(valve_signals)

    def equations(self):
        n = self.sharpness
        share = self.ratio * (self.u / self.full) ** 2 + NOTHING
        yield self.y == self.u / (1 + share ** (n / 2)) ** (1 / n)


class SupplyDroop(Effect):
    """A supply that gives way, or a return line that backs up: the pressure behind it changes with the flow.

        p = p_s - R q_s,   T q_s' = q - q_s

    T stands for the supply's accumulator or pressure controller. Source: Jelali and Kroll 2003.
    """

    id, title = "supply_droop", "supply that gives way"
    equation = "p = p_s - R q"
    source = JELALI
    typical = {"resistance": (1e8, 2e10)}
    probes = ({"resistance": 1e9}, {"resistance": 8e9})
    confused_with = ("flow_saturation", "load_dependent_flow", "command_saturation", "line_friction")
    experiment = "large and small openings at one load, with the supply's pressure measured"

    a = HydraulicPort("supply")
    b = HydraulicPort("what it supplies")
    drawn = State(0.0, "m3/s", "flow q_s drawn of late", nominal=1e-4)
    resistance = Parameter(
        0.0, "Pa.s/m3", "pressure lost per flow R", bounds=(0, 5e10), nominal=1e9, source=JELALI, free=True
    )
    time_constant = Parameter(0.01, "s", "T", bounds=(1e-3, 10), source="assumed")

    sites = staticmethod(sources)

    def equations(self):
        yield self.a.q + self.b.q == 0
        yield self.time_constant * der(self.drawn) == self.a.q - self.drawn
        yield self.b.p == self.a.p - self.resistance * self.drawn


def _opened_sources(places):
    """Supplies and tanks with the signal that opens a valve on their node."""
    opened = [(site, places.part(site.through.rpartition(".")[0])) for site in valve_signals(places)]
    for source in sources(places):
        node = places.node_at(source.between)
        fed = [site for site, part in opened if {f"{part.path}.{p}" for p in part.ports} & set(node.ports)]
        for site in fed:
            name = source.name if len(fed) == 1 else f"{source.name}-{site.through}"
            reads = {"opening": site.through}
            yield Site(name, reads=reads, between=source.between, unit=site.unit, nominal=site.nominal)


class OpeningDroop(Effect):
    """A supply that gives way, or a return line that backs up, as the valve opens, whatever flows.

        p = p_s - D o,   T o' = |u|/u_0 - o

    The set pressure of a pump's controller follows what is asked of it, not what is drawn; D < 0 backs up.
    Source: Jelali and Kroll 2003.
    """

    id, title = "opening_droop", "supply that gives way with the opening"
    equation = "p = p_s - D |u|/u_0"
    source = JELALI
    typical = {"loss": (-5e6, 5e6)}
    probes = ({"loss": 5e5}, {"loss": 4e6}, {"loss": -5e5})
    confused_with = ("supply_droop", "flow_saturation", "load_dependent_flow", "line_friction")
    experiment = "the same opening at two loads, so that other flows pass it, with the supply's pressure measured"

    a = HydraulicPort("supply")
    b = HydraulicPort("what it supplies")
    opening = Input("signal", "opening of the valve")
    asked = State(0.0, "1", "opening o asked of late")
    loss = Parameter(0.0, "Pa", "pressure D lost at u_0", bounds=(-3e7, 3e7), nominal=1e6, source=JELALI, free=True)
    time_constant = Parameter(0.01, "s", "T", bounds=(1e-3, 10), source="assumed")
    full = Parameter(1.0, "signal", "full opening u_0", bounds=(1e-6, 1e6), source="nominal of the signal")

    sites = staticmethod(_opened_sources)

    def equations(self):
        yield self.a.q + self.b.q == 0
        yield self.time_constant * der(self.asked) == ca.fabs(self.opening) / self.full - self.asked
        yield self.b.p == self.a.p - self.loss * self.asked


def _load_sites(places):
    """Where a valve is opened, and the valve itself: one that lies between two work ports, a supply and a tank."""
    for site in valve_signals(places):
        part = places.part(site.through.rpartition(".")[0])
        ports = {f"{part.path}.{name}": places.node_at(f"{part.path}.{name}") for name in part.ports_of(HydraulicPort)}
        work = [p for p, node in ports.items() if node and not places.is_prescribed(node)]
        held = [p for p, node in ports.items() if node and places.is_prescribed(node)]
        if len(work) == 2:
            yield replace(site, reads={"p_a": f"{work[0]}.p", "p_b": f"{work[1]}.p"})
        if len(work) == len(held) == 2:
            ties = dict(zip(("a", "b", "one", "other"), (*work, *held), strict=True))
            yield Site(part.path, ties=ties, reads={"q_a": f"{work[0]}.q", "q_b": f"{work[1]}.q"})


class LoadDependentFlow(Effect):
    """The flow depends on the load otherwise than as the root of the pressure drop: the opening gives way to the load

        y = u + |u| tanh(c (p_a - p_b) / p_0)

    or to the flow forces that go with it, or every edge passes less at its own drop than it should (`EdgesUnderLoad`).
    With c > 0 a resisting load opens it, with c < 0 it closes it. Source: Merritt 1967, section 5.6 (flow forces).
    """

    id, title = "load_dependent_flow", "flow of a valve that depends on the load"
    equation = "y = u + |u| tanh(c (p_a - p_b) / p_0), or q = q_0 (1 - c dp / p_0) at every edge"
    source = MERRITT
    typical = {"share": (-0.3, 0.3)}
    probes = ({"share": 0.1}, {"share": -0.1})
    confused_with = ("supply_droop", "flow_saturation", "internal_leakage", "area_error")
    experiment = "the same openings against several loads, with both pressures and the supply's"
    order = 9

    u = Input("signal", "opening")
    y = Output("signal", "opening under load")
    p_a = Input("Pa", "pressure at the first work port", nominal=1e6)
    p_b = Input("Pa", "pressure at the second work port", nominal=1e6)
    share = Parameter(
        0.0, "1", "change c of the flow at p_0", bounds=(-0.9, 0.9), nominal=0.1, source=MERRITT, free=True
    )
    reference = Parameter(1e7, "Pa", "load pressure p_0", bounds=(1e5, 1e9), source="100 bar")

    sites = staticmethod(_load_sites)

    @classmethod
    def at(cls, site: Site):
        """The part for an opening, or for the edges of a valve."""
        return EdgesUnderLoad() if site.ties else super().at(site)

    def equations(self):
        bent = ca.tanh(self.share * (self.p_a - self.p_b) / self.reference)
        yield self.y == self.u + ca.fabs(self.u) * bent


class EdgesUnderLoad(Component):
    """Flow coefficients that fall with the pressure drop of their own edge: ``q = q_0 (1 - c dp / p_0)``.

    What the valve passes at a work port comes from or goes to the one of the other two ports that the pressures allow;
    the share that is lost flows back there. Source: Merritt 1967 (discharge coefficients).
    """

    a = HydraulicPort("first work port")
    b = HydraulicPort("second work port")
    one = HydraulicPort("supply or tank")
    other = HydraulicPort("the other of them")
    q_a = Input("m3/s", "flow into the valve at a", nominal=1e-4)
    q_b = Input("m3/s", "flow into the valve at b", nominal=1e-4)
    share = LoadDependentFlow.share
    reference = LoadDependentFlow.reference

    def equations(self):
        p_s, p_t = ca.fmax(self.one.p, self.other.p), ca.fmin(self.one.p, self.other.p)
        c = self.share / self.reference
        back, drawn = 0, 0
        for port, q in ((self.a, self.q_a), (self.b, self.q_b)):
            lost = ca.fmin(c * (p_s - port.p), MOST_LOST) * ca.fmax(-q, 0)
            kept = ca.fmin(c * (port.p - p_t), MOST_LOST) * ca.fmax(q, 0)
            yield port.q == lost - kept
            back, drawn = back + lost, drawn + kept
        from_one = ca.if_else(self.one.p > self.other.p, back, -drawn)
        yield self.one.q == -from_one
        yield self.other.q == -(back - drawn - from_one)
