"""Friction at a flange, or at whatever moves there."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Flange, Parameter, der

from .effect import Effect
from .sites import flanges

OLSSON = "H. Olsson et al., Friction models and friction compensation, 1998"


class CoulombFriction(Effect):
    """Dry friction: one force against the motion, whatever the speed.

        F = F_c sign(v),   sign smoothed as tanh(v / v_0)

    Validity: sliding; at rest it creeps with v_0. Source: Olsson et al. 1998.
    """

    id, title = "coulomb_friction", "Coulomb friction"
    equation = "F = F_c sign(v)"
    source = OLSSON
    typical = {"force": (10.0, 2000.0)}  # 1-10 % of the stall force
    probes = ({"force": 50.0}, {"force": 500.0})
    confused_with = ("stribeck_friction", "command_deadband", "pressure_dependent_friction")
    experiment = "slow motion at several constant speeds in both directions, with pressures"

    flange = Flange("where it rubs")
    force = Parameter(0.0, "N", "Coulomb friction F_c", bounds=(0, 1e5), nominal=100.0, source=OLSSON, free=True)
    smoothing_velocity = Parameter(1e-3, "m/s", "v_0", bounds=(1e-6, 0.1), source="numerical")

    sites = staticmethod(flanges)

    def equations(self):
        v = der(self.flange.s)
        yield self.flange.f == self.force * ca.tanh(v / self.smoothing_velocity)
