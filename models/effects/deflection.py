"""What gives between a sensor and what it measures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np

from hydrotwin.models.language import Flange, HydraulicPort, Input, Output, Parameter, RotationalFlange
from hydrotwin.models.language.places import Node, Places
from hydrotwin.models.language.units import compatible

from .effect import Effect, Site
from .sites import driving_port, model_outputs

SAME = 1e-6  # relative: what moves in one direction to that moves together
POINTS = 6  # states at which that is looked at
STIFFNESS = "stiffness of frames and brackets 1e6-1e8 N/m"


class LoadDeflection(Effect):
    """What carries the sensor bends under the load, or what lies between it and what it measures.

        y = u + c F,   F the force, or the torque, that drives what is measured

    The machine moves as before: `structural_compliance` lies between drive and load and moves the load itself.
    Source: J. Fraden, Handbook of Modern Sensors, 2016 (mounting); R. Roark, Formulas for Stress and Strain.
    """

    id, title = "load_deflection", "deflection under load between the sensor and what it measures"
    equation = "y = u + c F"
    source = "J. Fraden, Handbook of Modern Sensors, 2016; R. Roark, Formulas for Stress and Strain"
    typical = {"compliance": (-1e-5, 1e-5)}
    probes = ({"compliance": 1e-6}, {"compliance": -1e-6}, {"compliance": 1e-5}, {"compliance": -1e-5})
    confused_with = ("structural_compliance", "sensor_scale", "linkage_error", "sensor_bias")
    experiment = "hold in several positions under two loads, with pressures: a reading that follows the load at rest"
    order = 0

    u = Input("signal", "what moves")
    y = Output("signal", "what reaches the sensor")
    load = Input("N", "force on what drives: minus the force that it gives", nominal=1e3)
    compliance = Parameter(0.0, "signal/N", "c", bounds=(-1e-2, 1e-2), nominal=1e-6, source=STIFFNESS, free=True)

    @classmethod
    def sites(cls, places: Places) -> Iterator[Site]:
        moving = [node for kind in (Flange, RotationalFlange) for node in places.nodes_of(kind)]
        driven = [(node, _driver(places, node)) for node in moving if driving_port(places, node)]
        for site in model_outputs(places):
            if any(compatible(site.unit, unit) for unit in ("m", "rad")):
                found = [(n, port) for n, port in driven if _moves_with(places, site.through, n)]
                for node, port in found:
                    name = site.name if len(found) == 1 else f"{site.name}-{node.name}"
                    yield replace(site, name=name, reads={"load": f"{port}.{node.kind('').flow[0]}"})

    @classmethod
    def at(cls, site: Site):
        """The part for a force or for a torque."""
        turns = site.reads and site.reads["load"].endswith(".tau")
        return super(LoadDeflection, TorqueDeflection if turns else cls).at(site)

    def equations(self):
        yield self.y == self.u - self.compliance * self.load


class TorqueDeflection(LoadDeflection):
    """The same under a torque."""

    id = ""
    load = Input("N.m", "torque on what drives: minus the torque that it gives", nominal=1.0)
    compliance = replace(LoadDeflection.compliance, unit="signal/(N.m)")


def _driver(places: Places, node: Node) -> str:
    """The port of what drives a node: that of a part with oil, else the last, of a part without states if any."""
    parts = {port: places.part(port.rpartition(".")[0]) for port in node.ports}
    return next((p for p, part in parts.items() if part and part.ports_of(HydraulicPort)), node.ports[-1])


def _moves_with(places: Places, output: str, node: Node) -> bool:
    """Whether an output is a function of the position of a node alone: both have one direction in the states."""
    model = places.model
    flat, k = model.flat, [o.name for o in model.flat.outputs].index(output)
    t, x, u, p = flat.ode.sx_in()
    position = model.observe([f"{node.name}.{node.kind('').potential[0]}"])(t, x, u, p)
    both = ca.jacobian(ca.vertcat(flat.ode(t, x, u, p)[1][k], position), x)
    directions = ca.Function("directions", [t, x, u, p], [ca.densify(both)])
    values, draw = flat.parameter_vector(), np.random.default_rng(0)
    inputs = [i.default for i in flat.inputs]
    start = np.nan_to_num(flat.start_given()(inputs, values, []).full().ravel())
    nominal = np.array([s.nominal for s in flat.states])
    for _ in range(POINTS):
        one, other = directions(0, start + draw.uniform(-1, 1, len(start)) * nominal, inputs, values).full() * nominal
        size = np.linalg.norm(one) * np.linalg.norm(other)
        if not size > 0 or abs(abs(one @ other) / size - 1) > SAME:
            return False
    return True
