"""Stiffness of the oil in a volume."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Law, Parameter


class BulkModulusLaw(Law):
    """``beta = effective(p)`` [Pa] at absolute pressure ``p`` [Pa]."""

    def effective(self, p):
        """Effective bulk modulus [Pa] at pressure ``p`` [Pa]."""
        raise NotImplementedError


class ConstantBulkModulus(BulkModulusLaw):
    """beta_e does not depend on the pressure. Source: C-EHA paper, Eq. 1."""

    bulk_modulus = Parameter(
        1.747e9, "Pa", "effective bulk modulus beta_e", bounds=(1e7, 1e10), source="C-EHA paper, Table 1"
    )

    def effective(self, p):
        return self.bulk_modulus


class AirLadenBulkModulus(BulkModulusLaw):
    """Oil with undissolved air, compressed polytropically.

    The volume of the mixture is that of oil and of gas, and ``beta_e = -V dp/dV``:

        V/V_0 = o + g,   o = exp(-(p - p0)/beta),   g = a (p0/p)^(1/n)
        beta_e = (o + g) / (o/beta + g/(n p))

    Validity: the air neither dissolves nor leaves the oil; below a hundredth of ``reference_pressure`` the pressure
    counts as that floor. Source: Merritt, Hydraulic Control Systems (1967), section 2.3; Nykaenen et al. (2000).
    """

    bulk_modulus = Parameter(
        1.747e9, "Pa", "bulk modulus of the oil alone", bounds=(1e8, 1e10), source="C-EHA paper, Table 1"
    )
    air_fraction = Parameter(0.01, "1", "volume of free air per volume of oil at p0", bounds=(0, 0.3), source="Merritt")
    polytropic_exponent = Parameter(1.4, "1", "n: 1 isothermal, 1.4 adiabatic", bounds=(1.0, 1.67), source="Merritt")
    reference_pressure = Parameter(1.013e5, "Pa", "p0 of the air fraction", bounds=(1e4, 1e6), source="atmosphere")

    def effective(self, p):
        beta, p0, n = self.bulk_modulus, self.reference_pressure, self.polytropic_exponent
        p = ca.fmax(p, 0.01 * p0)
        oil = ca.exp((p0 - p) / beta)
        gas = self.air_fraction * (p0 / p) ** (1 / n)
        return (oil + gas) / (oil / beta + gas / (n * p))
