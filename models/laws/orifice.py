"""Flow through an opening."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Law, Parameter


def signed_root(dp, transition):
    """sign(dp) sqrt|dp|, smooth through zero: ``dp / (dp^2 + transition^2)^(1/4)``; odd, monotone."""
    return dp / ca.sqrt(ca.sqrt(dp**2 + transition**2))


class OrificeLaw(Law):
    """``q = flow(opening, dp)`` [m3/s] at opening 0..1 and pressure difference [Pa]."""

    def flow(self, opening, dp):
        """Flow [m3/s] through the fraction ``opening`` [1] of the full passage, driven by ``dp`` [Pa]."""
        raise NotImplementedError


class TurbulentOrifice(OrificeLaw):
    """q = k_q o sign(dp) sqrt|dp|, linear below ``transition_pressure``.

    Source: Merritt, Hydraulic Control Systems (1967), Eq. 3-4.
    """

    flow_coefficient = Parameter(
        6.0e-8, "m3/(s.sqrt(Pa))", "k_q at full opening", bounds=(1e-12, 1e-3), source="valve data sheet"
    )
    transition_pressure = Parameter(1e4, "Pa", "where the flow turns laminar", bounds=(1, 1e7), source="Merritt")

    def flow(self, opening, dp):
        return self.flow_coefficient * opening * signed_root(dp, self.transition_pressure)


class SharpEdgedOrifice(OrificeLaw):
    """q = C_d A o sqrt(2 dp / rho), linear below ``transition_pressure``.

    Source: Merritt, Hydraulic Control Systems (1967), Eq. 2-24.
    """

    discharge_coefficient = Parameter(0.61, "1", "C_d", bounds=(0.1, 1.0), source="Merritt")
    area = Parameter(1e-6, "m2", "area A of the full passage", bounds=(1e-12, 1e-1), source="geometry")
    density = Parameter(870.0, "kg/m3", "oil density rho", bounds=(500, 2000), source="mineral oil")
    transition_pressure = Parameter(1e4, "Pa", "where the flow turns laminar", bounds=(1, 1e7), source="Merritt")

    def flow(self, opening, dp):
        coefficient = self.discharge_coefficient * self.area * ca.sqrt(2 / self.density)
        return coefficient * opening * signed_root(dp, self.transition_pressure)
