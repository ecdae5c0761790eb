"""Friction between piston and cylinder, or in a slide: force against velocity."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Law, Parameter

OLSSON = "Olsson et al., Friction models and friction compensation, Eur. J. Control 4 (1998) 176-195"
CEHA = "C-EHA paper, Eq. 8"


class FrictionLaw(Law):
    """``F = force(v)`` [N], opposing the motion: positive for positive velocity [m/s]."""

    def force(self, v):
        """Friction force [N] at velocity ``v`` [m/s]."""
        raise NotImplementedError


class NoFriction(FrictionLaw):
    """F = 0."""

    def force(self, v):
        return 0 * v


class Viscous(FrictionLaw):
    """F = F_v v. Valid for a fully lubricated seal. Source: C-EHA paper, Eq. 8."""

    viscous = Parameter(741.36, "N.s/m", "viscous friction F_v", bounds=(0, 1e8), source="C-EHA paper, Table 1")

    def force(self, v):
        return self.viscous * v


class Coulomb(Viscous):
    """F = F_c sign(v) + F_v v, the sign smoothed over ``smoothing_velocity``.

    The smoothed law creeps where true dry friction sticks. Source: Olsson et al. 1998.
    """

    viscous = Parameter(0.0, "N.s/m", "viscous friction F_v", bounds=(0, 1e8), nominal=1e3, source=OLSSON)
    coulomb = Parameter(50.0, "N", "Coulomb friction F_c", bounds=(0, 1e6), source=OLSSON)
    smoothing_velocity = Parameter(1e-3, "m/s", "width of the smoothed sign", bounds=(1e-7, 0.1), source="numerical")

    def force(self, v):
        return self.coulomb * ca.tanh(v / self.smoothing_velocity) + self.viscous * v


class Stribeck(Viscous):
    """F = (F_k + (F_s - F_k) exp(-(v/v_s)^2)) sign(v) + F_v v, the sign smoothed over ``smoothing_velocity``.

    Source: C-EHA paper, Eq. 8 and Table 1.
    """

    kinetic = Parameter(1.87, "N", "kinetic friction F_k", bounds=(0, 1e6), source="C-EHA paper, Table 1")
    static = Parameter(13.15, "N", "static friction F_s", bounds=(0, 1e6), source="C-EHA paper, Table 1")
    stribeck_velocity = Parameter(
        0.0028, "m/s", "Stribeck velocity v_s", bounds=(1e-5, 1.0), source="C-EHA paper, Table 1"
    )
    smoothing_velocity = Parameter(1e-3, "m/s", "width of the smoothed sign", bounds=(1e-7, 0.1), source="numerical")

    def force(self, v):
        F_k, F_s, v_s = self.kinetic, self.static, self.stribeck_velocity
        level = F_k + (F_s - F_k) * ca.exp(-((v / v_s) ** 2))
        return level * ca.tanh(v / self.smoothing_velocity) + self.viscous * v
