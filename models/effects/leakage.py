"""Oil that takes another way, and pumps that deliver less than they should."""

from __future__ import annotations

from hydrotwin.models.language import HydraulicPort, Parameter

from .effect import Effect
from .sites import hydraulic_pairs

MERRITT = "H. Merritt, Hydraulic Control Systems, 1967"


class InternalLeakage(Effect):
    """Laminar leak between two volumes, such as past the piston seal.

        q = G (p_a - p_b)

    Source: Merritt 1967.
    """

    id, title = "internal_leakage", "internal leakage"
    equation = "q = G (p_a - p_b)"
    source = MERRITT
    typical = {"conductance": (1e-14, 1e-11)}
    probes = ({"conductance": 1e-14}, {"conductance": 1e-12})
    confused_with = ("external_leakage", "pump_slip", "turbulent_leakage")
    experiment = "hold under load, in several positions and at several pressures"

    a = HydraulicPort("one side")
    b = HydraulicPort("other side")
    conductance = Parameter(
        0.0, "m3/(s.Pa)", "leak conductance G", bounds=(0, 1e-9), nominal=1e-13, source=MERRITT, free=True
    )

    sites = staticmethod(hydraulic_pairs)

    def equations(self):
        yield self.a.q == self.conductance * (self.a.p - self.b.p)
        yield self.a.q + self.b.q == 0
