"""A sign that truly sticks: bristles that give way a little, then slide."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca

from hydrotwin.models.language import Parameter, State, der

from .bodies import OnBody
from .effect import Site
from .stepping import Lagged

FIRM = 1.2  # rad in a step of the model, of what is held on its bristles: explicit steps still follow 2
LEAST = 2e-3  # of delta_1: what it gives where there is no friction, so that nothing is divided by zero


class Sticking(OnBody, Lagged):
    """What every dry friction has: sign(v) of the motion of a body, with rest, at a friction of level F.

        zeta' = (v - |v| zeta) / (delta + |v| T_0),   sign(v) = (delta zeta + T_0 v) / (delta + T_0 |v|)

    Sliding, it is the sign; at rest it is whatever holds the load, and the machine stands still, where a smoothed sign
    would creep. ``delta = F delta_1 / (F + k delta_1)`` is how far it gives before it slides: small friction is held by
    k, as stiff as the step of the model follows with the mass behind the flange; large friction gives delta_1 at most.
    Oil is stiff: what gives more is seen in the pressures at rest. T_0 keeps the bristles slower than the integration
    step at any speed and damps them where they hold; a constant F never does work (it stores F delta zeta^2 / 2).
    Sources: P. Dahl, A solid friction model, 1968; Canudas de Wit et al. 1995.
    """

    shortest = 0.5

    give = Parameter(5e-7, "m", "delta_1, most that it gives before sliding", bounds=(1e-9, 1e-2), source="numerical")
    stiffness = Parameter(1e8, "N/m", "k, stiffness that holds", bounds=(1e-3, 1e14), source="numerical")
    resolution = Parameter(2.5e-4, "s", "T_0", bounds=(1e-6, 0.1), source="numerical")
    bristles = State(0.0, "1", "zeta, mean deflection of the bristles", bounds=(-3, 3))

    @classmethod
    def at(cls, site: Site):
        """The part for a site, as stiff as the step of its model follows: to one digit, as masses are known."""
        part, mass, step = super().at(site), getattr(site, "mass", math.nan), getattr(site, "step", 0.0)
        if not (math.isfinite(mass) and step > 0):
            return part
        stiffness = float(f"{mass * (FIRM / step) ** 2:.0e}")
        return part.but(stiffness=replace(part.declared("stiffness"), value=stiffness))

    def sign(self, level):
        """sign(v), with what holds at rest."""
        give, v, lag = self._give(level), self.speed(), self.resolution
        return (give * self.bristles + lag * v) / (give + lag * ca.fabs(v))

    def sticking(self, level):
        """The equation of the bristles."""
        v = self.speed()
        speed = ca.fabs(v)
        return der(self.bristles) == (v - speed * self.bristles) / (self._give(level) + speed * self.resolution)

    def _give(self, level):
        firm, level = self.stiffness * self.give, ca.fmax(level, 0)
        return self.give * (level + LEAST * firm) / (level + firm)
