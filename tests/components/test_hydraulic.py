"""Pumps, cylinders, volumes and passages against closed forms and the conservation of oil and energy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from hydrotwin.models.components import (
    Cylinder,
    FlowSource,
    LineVolume,
    Mass,
    Orifice,
    Passage,
    Plug,
    PressureSource,
    Pump,
    Reservoir,
    SpeedSource,
)
from hydrotwin.models.language import Component, Input, Model, Output, connect
from hydrotwin.models.laws import (
    AirLadenBulkModulus,
    Coulomb,
    LaminarLeakage,
    NoFriction,
    PumpSlip,
    Stribeck,
    TurbulentOrifice,
)
from tests.components.bench import at, bench, jacobian, observed, run

A_CAP, A_ROD, BETA, V0 = 8.042e-4, 6.319e-4, 1.747e9, 8e-5
POINTS = [dict(w=300.0, cap=6e6, rod=2e6), dict(w=-300.0, cap=6e6, rod=2e6), dict(w=500.0, cap=1e6, rod=9e6)]


def pump_bench(**changes):
    return bench(Pump(**changes), shaft="potential", cap="potential", rod="potential")


# -- pump -------------------------------------------------------------------------------------------------------------
def test_a_pump_moves_its_displacement_and_draws_the_area_ratio_of_it():
    y = at(pump_bench(return_ratio=A_ROD / A_CAP), shaft=100.0, cap=5e6, rod=2e6)
    assert y["cap_q"] == pytest.approx(-100 * 1.05e-7)
    assert y["rod_q"] == pytest.approx(100 * 1.05e-7 * A_ROD / A_CAP)


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("slip", [0.0, 2e-12])
def test_an_ideal_pump_turns_all_shaft_power_into_oil_and_a_slipping_one_heats_g_dp_squared(point, slip):
    model = pump_bench(loss=PumpSlip(slip_conductance=slip), return_ratio=0.8)
    y = at(model, shaft=point["w"], cap=point["cap"], rod=point["rod"])
    power_in = y["shaft_tau"] * y["shaft_w"] + y["cap_p"] * y["cap_q"] + y["rod_p"] * y["rod_q"]
    dp = point["cap"] - 0.8 * point["rod"]
    assert power_in == pytest.approx(slip * dp**2, abs=1e-9)


# -- cylinder ---------------------------------------------------------------------------------------------------
def cylinder_bench(**changes):
    return bench(Cylinder(**changes), cap="flow", annulus="flow", rod="potential")


STATE = {"part.cap_pressure": 5e6, "part.rod_pressure": 3e6, "rod_end.place": 0.03, "rod_end.speed": 0.05}


@pytest.mark.parametrize("leak", [0.0, 3e-12])
@pytest.mark.parametrize("speed", [0.05, -0.05])
def test_a_cylinder_loses_no_oil(leak, speed):
    """Inflow = compression + displacement on each side; what leaks out of one side arrives on the other."""
    model = cylinder_bench(leakage=LaminarLeakage(conductance=leak))
    y = at(model, STATE | {"rod_end.speed": speed}, cap=4e-5, annulus=-2e-5)
    V_cap, V_rod = V0 + A_CAP * 0.03, V0 - A_ROD * 0.03
    kept_cap = V_cap / BETA * y["der(part.cap_pressure)"] + A_CAP * speed
    kept_rod = V_rod / BETA * y["der(part.rod_pressure)"] - A_ROD * speed
    assert kept_cap == pytest.approx(4e-5 - leak * 2e6, rel=1e-12)
    assert kept_rod == pytest.approx(-2e-5 + leak * 2e6, rel=1e-12)


@pytest.mark.parametrize("friction", [NoFriction(), Stribeck(), Coulomb(coulomb=80.0)])
def test_a_cylinder_puts_out_the_pressures_times_their_areas_less_friction(friction):
    y = at(cylinder_bench(friction=friction), STATE)
    lost = {"NoFriction": 0.0, "Stribeck": 1.87 + 741.36 * 0.05, "Coulomb": 80.0}[type(friction).__name__]
    assert -y["rod_f"] == pytest.approx(5e6 * A_CAP - 3e6 * A_ROD - lost, rel=1e-9)


def test_the_power_into_a_cylinder_is_stored_in_oil_or_lost_in_friction_and_leakage():
    """p q + p q = F v + V/beta p p' of both sides + friction + leakage: nothing appears or vanishes."""
    model = cylinder_bench(leakage=LaminarLeakage(conductance=3e-12))
    y = at(model, STATE, cap=4e-5, annulus=-2e-5)
    power_in = 5e6 * 4e-5 - 3e6 * 2e-5 + y["rod_f"] * 0.05
    stored = (V0 + A_CAP * 0.03) / BETA * 5e6 * y["der(part.cap_pressure)"]
    stored += (V0 - A_ROD * 0.03) / BETA * 3e6 * y["der(part.rod_pressure)"]
    friction = at(cylinder_bench(friction=NoFriction()), STATE)["rod_f"] - y["rod_f"]
    assert power_in == pytest.approx(stored - friction * 0.05 + 3e-12 * 2e6**2, rel=1e-9)


def test_squeezing_a_closed_cylinder_raises_its_pressure_by_beta_ln_of_the_volume_ratio():
    model = cylinder_bench()
    time = np.linspace(0, 1, 201)
    y = run(model, time, start={"rod_end.speed": 1e-3})
    assert y["cap_p"][-1] == pytest.approx(2e6 + BETA * np.log(V0 / (V0 + A_CAP * 1e-3)), rel=1e-9)
    assert y["annulus_p"][-1] == pytest.approx(2e6 + BETA * np.log(V0 / (V0 - A_ROD * 1e-3)), rel=1e-9)


def test_leakage_alone_brings_the_two_sides_of_a_held_cylinder_together_without_losing_oil():
    model = cylinder_bench(leakage=LaminarLeakage(conductance=1e-13))
    tau = V0 / BETA / (2 * 1e-13)  # two equal capacities V0/beta joined by one conductance
    time = np.linspace(0, 5 * tau, 501)
    y = run(model, time, start={"part.cap_pressure": 8e6, "part.rod_pressure": 2e6})
    assert y["cap_p"] - y["annulus_p"] == pytest.approx(6e6 * np.exp(-time / tau), rel=1e-6)
    assert y["cap_p"] + y["annulus_p"] == pytest.approx(np.full(501, 1e7), rel=1e-12)


def test_the_rod_side_holds_its_dead_volume_at_the_reference_position():
    """rod_reference = stroke makes V_rod = V0 + A (stroke - s), as in the spool valve."""
    model = cylinder_bench(rod_reference=0.9)
    y = at(model, STATE, annulus=1e-5)
    rate = BETA / (V0 + A_ROD * (0.9 - 0.03)) * (1e-5 + A_ROD * 0.05)
    assert y["der(part.rod_pressure)"] == pytest.approx(rate, rel=1e-12)


@pytest.mark.parametrize("oil", [None, AirLadenBulkModulus(air_fraction=0.02)])
def test_a_mass_on_a_closed_cylinder_rings_at_the_root_of_k_over_m(oil):
    class Ringing(Component):
        """A mass on two closed oil columns."""

        cylinder = Cylinder(friction=NoFriction(), **({"oil": oil} if oil else {}))
        cap, annulus, mass = Plug(), Plug(), Mass(mass=490.0)

        def equations(self):
            yield connect(self.cap.port, self.cylinder.cap)
            yield connect(self.annulus.port, self.cylinder.annulus)
            yield connect(self.cylinder.rod, self.mass.flange)

    model = Model(Ringing(), "ringing")
    x = model.equilibrium()
    poles = np.linalg.eigvals(jacobian(model)(0, x, [], model.flat.parameter_vector()).full())
    beta = BETA
    if oil:
        o, g = np.exp((1.013e5 - 2e6) / BETA), 0.02 * (1.013e5 / 2e6) ** (1 / 1.4)
        beta = (o + g) / (o / BETA + g / (1.4 * 2e6))
        assert beta < 0.5 * BETA
    k = beta * (A_CAP**2 + A_ROD**2) / V0
    assert np.max(poles.imag) == pytest.approx(np.sqrt(k / 490), rel=1e-6)
    assert np.abs(poles.real).max() < 1e-4


# -- volumes and passages ----------------------------------------------------------------------------------------------
def test_a_line_volume_keeps_its_oil():
    model = bench(LineVolume(volume=2e-4), a="flow", b="flow")
    time = np.linspace(0, 0.5, 101)
    y = run(model, time, a=3e-6, b=-1e-6)
    assert y["a_p"] == pytest.approx(2e6 + BETA / 2e-4 * 2e-6 * time, rel=1e-9)
    assert y["b_p"] == pytest.approx(y["a_p"])


def test_an_air_laden_line_stores_oil_by_the_mixture_it_holds():
    """The oil that went in equals V ln(rho ratio), from the closed volume of the mixture."""
    law = AirLadenBulkModulus(air_fraction=0.05)
    model = bench(LineVolume(oil=law, pressure=2e5), a="flow", b="flow")
    p = run(model, np.linspace(0, 1, 2001), a=4e-6)["a_p"][-1]

    def mixture(p):
        return np.exp((1.013e5 - p) / BETA) + 0.05 * (1.013e5 / p) ** (1 / 1.4)

    assert 1e-4 * np.log(mixture(2e5) / mixture(p)) == pytest.approx(4e-6, rel=1e-5)
    assert p > 1e6


def test_a_volume_empties_through_a_gap_with_the_time_constant_v_over_beta_g():
    class Emptying(Component):
        """Plug, volume, laminar passage, reservoir."""

        plug, line, gap = Plug(), LineVolume(volume=1e-3, pressure=6e6), Passage(law=LaminarLeakage(conductance=1e-12))
        tank = Reservoir(pressure=1e6)
        pressure = Output("Pa", "pressure in the line")

        def equations(self):
            yield connect(self.plug.port, self.line.a)
            yield connect(self.line.b, self.gap.a)
            yield connect(self.gap.b, self.tank.port)
            yield self.pressure == self.line.pressure

    time = np.linspace(0, 2, 201)
    y = run(Model(Emptying(), "emptying"), time)
    assert y["pressure"] == pytest.approx(1e6 + 5e6 * np.exp(-time * BETA * 1e-12 / 1e-3), rel=1e-8)


@pytest.mark.parametrize("part", [Orifice(opening=0.25), Passage(law=LaminarLeakage(conductance=2e-12))])
@pytest.mark.parametrize("dp", [8e6, -8e6])
def test_a_passage_passes_what_enters_and_only_loses_energy(part, dp):
    y = at(bench(part, a="potential", b="potential"), a=1e6 + dp, b=1e6)
    q = 2e-12 * dp if isinstance(part, Passage) else 6e-8 * 0.25 * np.sqrt(8e6) * np.sign(dp)
    assert y["a_q"] == pytest.approx(q, rel=1e-5)
    assert y["b_q"] == -y["a_q"]
    assert y["a_q"] * y["a_p"] + y["b_q"] * y["b_p"] > 0


def test_two_equal_orifices_in_series_share_the_pressure_drop_evenly():
    class Series(Component):
        """Source, two orifices with a small volume between, tank."""

        source, first, between, second, tank = (
            PressureSource(pressure=1e7),
            Orifice(law=TurbulentOrifice(flow_coefficient=1e-8)),
            LineVolume(volume=1e-6, pressure=3e6),
            Orifice(law=TurbulentOrifice(flow_coefficient=1e-8)),
            Reservoir(pressure=0.0),
        )
        middle = Output("Pa", "pressure between")

        def equations(self):
            yield connect(self.source.port, self.first.a)
            yield connect(self.first.b, self.between.a)
            yield connect(self.between.b, self.second.a)
            yield connect(self.second.b, self.tank.port)
            yield self.middle == self.between.pressure

    y = run(Model(Series(), "series"), np.linspace(0, 0.5, 501))
    assert y["middle"][-1] == pytest.approx(5e6, rel=1e-6)


def test_sources_hold_what_they_are_told_whatever_the_circuit_asks():
    assert at(bench(PressureSource(), port="flow"), port=1e-3)["port_p"] == 180e5
    assert at(bench(Reservoir(), port="flow"), port=-1e-3)["port_p"] == 5e5
    assert at(bench(FlowSource(), port="potential"), port=3e7, flow=2e-5)["port_q"] == -2e-5
    assert at(bench(Plug(), port="potential"), port=3e7)["port_q"] == 0


def test_a_pumped_closed_circuit_keeps_its_mass_of_oil_while_it_moves():
    """Drawn into the cap side = displaced + compressed, over a whole run and not only at a point."""

    class Circuit(Component):
        """Pump at a measured speed, cylinder, mass."""

        drive, pump, cylinder, mass = SpeedSource(), Pump(return_ratio=A_ROD / A_CAP), Cylinder(), Mass(mass=100.0)
        speed = Input("rad/s", "pump speed")
        moved = Output("m", "stroke")
        cap = Output("Pa", "cap pressure")

        def equations(self):
            yield connect(self.pump.cap, self.cylinder.cap)
            yield connect(self.pump.rod, self.cylinder.annulus)
            yield connect(self.cylinder.rod, self.mass.flange)
            yield connect(self.speed, self.drive.speed)
            yield connect(self.drive.shaft, self.pump.shaft)
            yield self.moved == self.mass.position
            yield self.cap == self.cylinder.cap_pressure

    time = np.linspace(0, 1.0, 1001)
    model = Model(Circuit(), "circuit")
    y = run(model, time, speed=200.0)
    density = np.exp((y["cap"] - 2e6) / BETA)  # over that at the start
    gained = (V0 + A_CAP * y["moved"]) * density - V0
    assert gained == pytest.approx(cumulative_trapezoid(200 * 1.05e-7 * density, time, initial=0), abs=1e-11)
    assert gained[-1] == pytest.approx(2.1e-5, rel=2e-3)
    assert observed(model, ["cylinder.cap.q"], {"mass.position": 0.0}, speed=200.0) == pytest.approx(200 * 1.05e-7)
