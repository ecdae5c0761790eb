"""Every law against its closed form."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.laws import (
    AirLadenBulkModulus,
    ConstantBulkModulus,
    ConstantVolumetricEfficiency,
    Coulomb,
    LaminarLeakage,
    NoFriction,
    NoLeakage,
    NoPumpLoss,
    OverlappedEdge,
    PumpSlip,
    SharpEdgedOrifice,
    Stribeck,
    TurbulentLeakage,
    TurbulentOrifice,
    Viscous,
    ZeroOverlapEdge,
)
from tests.laws.probe import slopes, values

SPEEDS = np.array([-0.08, -0.02, 0.02, 0.08])


# -- friction ---------------------------------------------------------------------------------------------------
def test_no_friction_is_no_force():
    assert np.all(values(NoFriction(), SPEEDS) == 0)


def test_viscous_friction_is_a_straight_line():
    assert values(Viscous(viscous=300.0), SPEEDS) == pytest.approx(300 * SPEEDS)


def test_coulomb_friction_is_the_dry_level_plus_the_viscous_line_outside_the_smoothing():
    law = Coulomb(coulomb=40.0, viscous=500.0, smoothing_velocity=1e-3)
    assert values(law, SPEEDS) == pytest.approx(40 * np.sign(SPEEDS) + 500 * SPEEDS, rel=1e-9)
    assert slopes(law, 0.0) == pytest.approx(40 / 1e-3 + 500)


def test_stribeck_friction_of_table_1_is_equation_8_outside_the_smoothing():
    v = np.array([0.005, 0.01, 0.03, 0.08])
    paper = 1.87 + (13.15 - 1.87) * np.exp(-((v / 0.0028) ** 2)) + 741.36 * v
    assert values(Stribeck(), v) == pytest.approx(paper, rel=1e-4)
    assert values(Stribeck(), -v) == pytest.approx(-paper, rel=1e-4)


def test_the_sharper_the_sign_the_nearer_the_stribeck_peak_comes_to_static_friction():
    v = np.linspace(1e-6, 0.002, 400)
    for smoothing, missing in ((1e-3, 0.281), (1e-4, 0.014), (1e-6, 0.0)):
        dry = values(Stribeck(viscous=0.0, smoothing_velocity=smoothing), v)
        assert 1 - dry.max() / 13.15 == pytest.approx(missing, abs=2e-3)


def test_stribeck_friction_falls_after_its_peak_and_rises_again_with_the_viscous_part():
    """With F_s - F_k large against F_v v_s the curve has the dip of Fig. 4."""
    law = Stribeck(smoothing_velocity=1e-5)
    assert slopes(law, 0.002) < 0 < slopes(law, 0.02)
    assert slopes(law, 0.05) == pytest.approx(741.36, rel=1e-6)


def test_figure_7_shows_about_60_newton_at_full_speed():
    assert values(Stribeck(), 0.078) == pytest.approx(60, abs=2)


# -- orifice and leakage ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("dp", [1e6, 1e7, -1e7])
def test_a_sharp_edged_orifice_is_bernoulli_with_a_discharge_coefficient(dp):
    law = SharpEdgedOrifice(discharge_coefficient=0.7, area=2e-6, density=850.0)
    q = 0.7 * 2e-6 * 0.5 * np.sqrt(2 * abs(dp) / 850) * np.sign(dp)
    assert values(law, 0.5, dp) == pytest.approx(q, rel=3e-5)


def test_the_two_orifices_agree_when_the_flow_coefficient_is_cd_a_sqrt_2_over_rho():
    k = 0.61 * 1e-6 * np.sqrt(2 / 870)
    dp = np.linspace(-2e7, 2e7, 21)
    one = values(TurbulentOrifice(flow_coefficient=k), 0.3, dp)
    assert one == pytest.approx(values(SharpEdgedOrifice(), 0.3, dp), rel=1e-12)


@pytest.mark.parametrize("law", [TurbulentOrifice(transition_pressure=1e4), TurbulentLeakage(transition_pressure=1e4)])
def test_turbulent_flow_is_laminar_below_its_transition_and_a_root_above(law):
    def q(dp):
        return values(law, 1.0, dp) if isinstance(law, TurbulentOrifice) else values(law, dp)

    k = 6e-8 if isinstance(law, TurbulentOrifice) else 1e-10
    assert q(100.0) == pytest.approx(k * 100 / np.sqrt(1e4), rel=1e-4)
    assert q(1e4) == pytest.approx(k * np.sqrt(1e4) / 2**0.25, rel=1e-12)
    assert q(1e7) == pytest.approx(k * np.sqrt(1e7), rel=1e-6)
    assert q(4e7) / q(1e7) == pytest.approx(2, rel=1e-6)


def test_laminar_leakage_is_proportional_and_no_leakage_is_none():
    dp = np.array([-2e7, 0.0, 1e3, 3e7])
    assert values(LaminarLeakage(conductance=2e-12), dp) == pytest.approx(2e-12 * dp, rel=1e-14)
    assert np.all(values(NoLeakage(), dp) == 0)


# -- oil ----------------------------------------------------------------------------------------------------------
def test_constant_bulk_modulus_is_the_same_at_every_pressure():
    assert np.all(values(ConstantBulkModulus(bulk_modulus=1.2e9), np.array([0, 1e5, 3e7])) == 1.2e9)


@pytest.mark.parametrize("air", [0.0, 0.002, 0.01, 0.1])
@pytest.mark.parametrize("n", [1.0, 1.4])
def test_air_laden_bulk_modulus_is_minus_v_dp_over_dv_of_the_mixture(air, n):
    beta, p0 = 1.747e9, 1.013e5
    p = np.array([2e4, 1.013e5, 5e5, 2e6, 1e7, 4e7])

    def volume(p):
        return np.exp(-(p - p0) / beta) + air * (p0 / p) ** (1 / n)

    h = 1e-4 * p
    numeric = -volume(p) * 2 * h / (volume(p + h) - volume(p - h))
    law = AirLadenBulkModulus(air_fraction=air, polytropic_exponent=n)
    assert values(law, p) == pytest.approx(numeric, rel=1e-6)


def test_a_percent_of_air_halves_the_stiffness_at_ten_bar_and_matters_little_at_two_hundred():
    beta = values(AirLadenBulkModulus(air_fraction=0.01), np.array([1e6, 2e7])) / 1.747e9
    assert beta[0] < 0.5
    assert 0.97 < beta[1] < 1


def test_below_the_floor_of_absolute_pressure_the_stiffness_stays():
    law = AirLadenBulkModulus()
    assert values(law, -1e6) == values(law, 1e3) == values(law, 1013.0)


# -- pump and valve -------------------------------------------------------------------------------------------------
def test_pump_losses_take_their_part_of_the_ideal_flow():
    ideal, dp = np.array([-6e-5, 0.0, 6e-5]), np.array([1e6, 5e6, 2e7])
    assert values(NoPumpLoss(), ideal, dp) == pytest.approx(ideal)
    assert values(ConstantVolumetricEfficiency(efficiency=0.9), ideal, dp) == pytest.approx(0.9 * ideal)
    assert values(PumpSlip(slip_conductance=3e-13), ideal, dp) == pytest.approx(ideal - 3e-13 * dp)


def test_a_slipping_pump_at_standstill_lets_oil_flow_back():
    assert values(PumpSlip(), 0.0, 1e7) == pytest.approx(-1e-13 * 1e7)


def test_a_metering_edge_opens_beyond_its_overlap_and_never_closes_below_zero():
    x = np.array([-1.0, -0.05, 0.0, 0.05, 0.2, 1.0])
    assert values(ZeroOverlapEdge(), x) == pytest.approx([0, 0, 0, 0.05, 0.2, 1.0])
    assert values(OverlappedEdge(overlap=0.05), x) == pytest.approx([0, 0, 0, 0, 0.15, 0.95])
    assert values(OverlappedEdge(overlap=-0.05), x) == pytest.approx([0, 0, 0.05, 0.1, 0.25, 1.05])
