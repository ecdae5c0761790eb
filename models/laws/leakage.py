"""Leakage through a gap: flow against pressure difference."""

from __future__ import annotations

from hydrotwin.models.language import Law, Parameter

from .orifice import signed_root


class LeakageLaw(Law):
    """``q = flow(dp)`` [m3/s] for a pressure difference [Pa]."""

    def flow(self, dp):
        """Leakage flow [m3/s] driven by ``dp`` [Pa]."""
        raise NotImplementedError


class NoLeakage(LeakageLaw):
    """q = 0."""

    def flow(self, dp):
        return 0 * dp


class LaminarLeakage(LeakageLaw):
    """q = G dp, a narrow sealing gap. Source: Merritt, Hydraulic Control Systems (1967), Eq. 2-15."""

    conductance = Parameter(
        1e-13, "m3/(s.Pa)", "leakage conductance G", bounds=(0, 1e-8), nominal=1e-13, source="typical 1e-14..1e-11"
    )

    def flow(self, dp):
        return self.conductance * dp


class TurbulentLeakage(LeakageLaw):
    """q = k sign(dp) sqrt|dp|, a short or damaged edge; linear below ``transition_pressure``.

    Source: Merritt, Hydraulic Control Systems (1967), Eq. 2-24.
    """

    coefficient = Parameter(
        1e-10, "m3/(s.sqrt(Pa))", "flow coefficient k", bounds=(0, 1e-5), nominal=1e-10, source="Merritt"
    )
    transition_pressure = Parameter(1e4, "Pa", "where the flow turns laminar", bounds=(1, 1e7), source="Merritt")

    def flow(self, dp):
        return self.coefficient * signed_root(dp, self.transition_pressure)
