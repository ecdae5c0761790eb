"""What a port of a body moves: the mass or inertia that a force or torque on it feels at once."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from hydrotwin.models.language import Component, Flange, Parameter, RotationalFlange, Shaft, Variable, der
from hydrotwin.models.language.additions import Addition
from hydrotwin.models.language.places import Places

NAME = "push_of_a_flange"


class _Push(Component):
    """A force on a flange, and the speed of it."""

    port = Flange("where it pushes")
    force = Parameter(0.0, "N", "force towards larger s", source="none")
    speed = Variable("m/s", "speed of the flange")

    def equations(self):
        yield self.port.f == -self.force
        yield self.speed == der(self.port.s)


class _Twist(Component):
    """A torque on a rotational flange, and the speed of it."""

    port = RotationalFlange("where it twists")
    force = Parameter(0.0, "N.m", "torque towards larger angles", source="none")
    speed = Variable("rad/s", "speed of the flange")

    def equations(self):
        yield self.port.tau == -self.force
        yield self.speed == der(self.port.phi)


class _Drive(Component):
    """A torque on a shaft, and the speed of it."""

    port = Shaft("where it drives")
    force = Parameter(0.0, "N.m", "torque forwards", source="none")
    speed = Variable("rad/s", "speed of the shaft")

    def equations(self):
        yield self.port.tau == -self.force
        yield self.speed == self.port.w


PUSHES = {Flange: _Push, RotationalFlange: _Twist, Shaft: _Drive}


@lru_cache(maxsize=64)
def moved_mass(places: Places, port: str) -> float:
    """``1 / (d v'/dF)`` at a port of a body of a model at its start: a mass [kg], or an inertia [kg.m2] of what turns.

    With v a function of the states x alone: d v'/dF = (dv/dx) (dx'/dF). Behind a linkage it is the mass reduced to the
    flange; nan where a force moves nothing at once.
    """
    push = PUSHES[places.node_at(port).kind]()
    model = places.model.plus([Addition(NAME, push, ties={"port": port})], sought=True)
    flat = model.flat
    t, x, u, p = flat.ode.sx_in()
    rate, _ = flat.ode(t, x, u, p)
    speed = model.observe([f"{NAME}.speed"])(t, x, u, p)
    by_force = ca.jacobian(rate, p)[:, flat.index_of(f"{NAME}.force")]
    mobility = ca.Function("mobility", [t, x, u, p], [ca.densify(ca.mtimes(ca.jacobian(speed, x), by_force))])
    inputs, values = [i.default for i in flat.inputs], flat.parameter_vector()
    start = np.nan_to_num(flat.start_given()(inputs, values, []).full().ravel())
    moved = float(mobility(0, start, inputs, values))
    return 1 / moved if moved > 0 and np.isfinite(moved) else np.nan
