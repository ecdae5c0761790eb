"""What a flange moves: the mass that a force on it feels at once."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from hydrotwin.models.language import Component, Flange, Parameter, Variable, der
from hydrotwin.models.language.additions import Addition
from hydrotwin.models.language.places import Places

NAME = "push_of_a_flange"


class _Push(Component):
    """A force on a flange, and the speed of it."""

    flange = Flange("where it pushes")
    force = Parameter(0.0, "N", "force towards larger s", source="none")
    speed = Variable("m/s", "speed of the flange")

    def equations(self):
        yield self.flange.f == -self.force
        yield self.speed == der(self.flange.s)


@lru_cache(maxsize=64)
def moved_mass(places: Places, port: str) -> float:
    """``1 / (d v'/dF)`` [kg] at a flange of a model at its start; nan where a force moves nothing at once.

    With v a function of the states x alone: d v'/dF = (dv/dx) (dx'/dF). Behind a linkage it is the mass reduced to the
    flange.
    """
    model = places.model.plus([Addition(NAME, _Push(), ties={"flange": port})], sought=True)
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
