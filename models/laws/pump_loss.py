"""What a pump delivers of its ideal flow."""

from __future__ import annotations

from hydrotwin.models.language import Law, Parameter


class PumpLossLaw(Law):
    """``q = delivered(ideal, dp)`` [m3/s]: flow that leaves the pump."""

    def delivered(self, ideal, dp):
        """Delivered flow [m3/s] of the ``ideal`` flow [m3/s] against the pressure rise ``dp`` [Pa]."""
        raise NotImplementedError


class NoPumpLoss(PumpLossLaw):
    """q = c_p w. Source: C-EHA paper, Eq. 6."""

    def delivered(self, ideal, dp):
        return ideal


class ConstantVolumetricEfficiency(PumpLossLaw):
    """q = eta_v c_p w. Source: Merritt (1967), section 4.3.

    Validity: near one operating point at which the machine pumps; driven as a motor it would create energy.
    """

    efficiency = Parameter(0.92, "1", "volumetric efficiency eta_v", bounds=(0.3, 1.0), source="typical 0.85-0.98")

    def delivered(self, ideal, dp):
        return self.efficiency * ideal


class PumpSlip(PumpLossLaw):
    """q = c_p w - G dp: gap flow from the high to the low side. Source: Merritt (1967), Eq. 4-8."""

    slip_conductance = Parameter(
        1e-13, "m3/(s.Pa)", "slip conductance G", bounds=(0, 1e-8), nominal=1e-13, source="typical 1e-14..1e-11"
    )

    def delivered(self, ideal, dp):
        return ideal - self.slip_conductance * dp
