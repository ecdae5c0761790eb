"""A sign that truly sticks: bristles that give way a little, then slide."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Flange, Parameter, State, der

from .sites import flanges
from .stepping import Lagged, stepped


class Sticking(Lagged):
    """What every dry friction has: sign(v) of the motion of a flange, with rest.

        zeta' = (v - |v| zeta) / (delta + |v| T_0),   sign(v) = zeta + T_1 zeta'

    Sliding, zeta is the sign; at rest it is whatever holds the load, and the machine stands still, where a smoothed
    sign would creep. ``delta`` is how far it gives before it slides, 0.5 um: less than is measured. T_0 keeps the
    bristles slower than the integration step at any speed; T_1 damps them where they hold (sliding, zeta' is nil).
    Sources: P. Dahl, A solid friction model, 1968; Canudas de Wit et al. 1995 (the damping).
    """

    shortest = 0.5

    flange = Flange("where it rubs")
    give = Parameter(5e-7, "m", "delta, displacement before sliding", bounds=(1e-9, 1e-2), source="numerical")
    resolution = Parameter(2.5e-4, "s", "T_0", bounds=(1e-6, 0.1), source="numerical")
    damping_time = Parameter(2.5e-4, "s", "T_1", bounds=(0, 0.1), source="numerical")
    bristles = State(0.0, "1", "zeta, mean deflection of the bristles", bounds=(-3, 3))

    sites = stepped(flanges)

    def sign(self):
        """sign(v), with what holds at rest."""
        return self.bristles + self.damping_time * self._rate()

    def sticking(self):
        """The equation of the bristles."""
        return der(self.bristles) == self._rate()

    def _rate(self):
        v = der(self.flange.s)
        speed = ca.fabs(v)
        return (v - speed * self.bristles) / (self.give + speed * self.resolution)
