"""Air, hoses, pressure losses and valves in the circuit, against closed forms and the conservation of oil."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models import cehA
from hydrotwin.models.components import FlowSource, LineVolume, Plug
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.effects.effect import Site
from hydrotwin.models.effects.fluid import (
    Cavitation,
    CheckValveCracking,
    LineFriction,
    ReliefSaturation,
    ReturnCheckValve,
)
from hydrotwin.models.language import Component, Input, Model, Output, State, connect
from hydrotwin.models.laws import AirLadenBulkModulus, ConstantBulkModulus
from tests.components.bench import at, bench, run
from tests.effects import benches

BETA, VOLUME = 1.4e9, 2e-4
CAP, ROD = "der(cylinder.cap_pressure)", "der(cylinder.rod_pressure)"


class Bottle(Component):
    """A closed volume into which oil is pushed."""

    flow = Input("m3/s", "flow into it", nominal=1e-5)
    pressure = Output("Pa", "pressure", nominal=1e6)
    source = FlowSource()
    bottle = LineVolume(
        volume=VOLUME, oil=ConstantBulkModulus(bulk_modulus=BETA), pressure=State(1e6, "Pa", nominal=1e6)
    )
    plug = Plug()

    def equations(self):
        yield connect(self.flow, self.source.flow)
        yield connect(self.source.port, self.bottle.a)
        yield connect(self.bottle.b, self.plug.port)
        yield self.pressure == self.bottle.pressure


def bottle():
    return Model(Bottle(), "bottle")


def rates(model, **pressures):
    states = {"load.position": 0.0, "load.velocity": 0.1} | {f"cylinder.{k}": v for k, v in pressures.items()}
    y = at(model, states, command=0.0)
    return y[CAP], y[ROD]


@pytest.mark.parametrize("p", (1.2e5, 5e5, 3e6, 2e7))
@pytest.mark.parametrize("fraction", (0.001, 0.02))
def test_air_softens_both_chambers_as_its_pressure_says(p, fraction):
    model = benches.pump_bench()
    beta = next(q.value for q in model.flat.parameters if q.name == "cylinder.oil.bulk_modulus")
    airy = add_effect(model, "entrained_air", values={"fraction": fraction})
    softer = 1 + beta * fraction / (1.4 * p) * (1.013e5 / p) ** (1 / 1.4)
    plain, soft = (rates(m, cap_pressure=p, rod_pressure=p) for m in (model, airy))
    assert np.array(soft) * softer == pytest.approx(plain, rel=1e-9)


def test_air_is_judged_by_the_bulk_modulus_that_the_oil_has_now():
    """An identification moves both; the share of air must not be one of a modulus that nobody believes any more."""
    airy = add_effect(benches.pump_bench(), "entrained_air", values={"fraction": 0.01})
    pressures = {"cap_pressure": 5e5, "rod_pressure": 5e5}
    for beta in (0.7e9, 2.1e9):
        model = airy.with_parameters({"cylinder.oil.bulk_modulus": beta})
        softer = 1 + beta * 0.01 / (1.4 * 5e5) * (1.013e5 / 5e5) ** (1 / 1.4)
        plain = rates(benches.pump_bench().with_parameters({"cylinder.oil.bulk_modulus": beta}), **pressures)
        assert np.array(rates(model, **pressures)) * softer == pytest.approx(plain, rel=1e-9)


def test_the_effect_of_air_is_that_of_the_law_of_oil_with_air():
    model, law = bottle(), AirLadenBulkModulus(bulk_modulus=BETA, air_fraction=0.01)
    by_law = Model(Bottle(bottle=Bottle.bottle.but(oil=law)), "bottle")
    by_effect = add_effect(model, "entrained_air", values={"fraction": 0.01})
    time = np.linspace(0, 1, 101)
    a, b = (run(m, time, flow=1e-6)["pressure"] for m in (by_law, by_effect))
    assert np.allclose(a, b, rtol=0.02) and a[-1] < 0.95 * run(model, time, flow=1e-6)["pressure"][-1]


def test_air_is_in_all_oil_of_a_machine_and_the_third_order_form_has_none_to_show():
    (found,) = candidates(cehA.model(), ["entrained_air"])
    assert set(found.site.reads.values()) == {
        "cylinder.cap_pressure", "cylinder.rod_pressure", "cylinder.oil.bulk_modulus"
    }  # fmt: skip
    assert set(found.free) == {"entrained_air.fraction", "entrained_air.exponent"}, "between slow and quick is fitted"
    assert not candidates(cehA.third_order(), ["entrained_air"])


def test_a_hose_takes_its_share_of_the_flow():
    soft = add_effect(bottle(), "line_compliance", "bottle.a", {"compliance": 3e-13})
    y = run(soft, np.linspace(0, 1, 11), flow=1e-6)
    assert y["pressure"][-1] - 1e6 == pytest.approx(1e-6 / (VOLUME / BETA + 3e-13), rel=1e-6)


def test_hoses_of_one_kind_on_both_chambers_are_the_sum_of_either():
    model = benches.pump_bench()
    cap, both = (
        add_effect(model, "line_compliance", site, {"compliance": 1e-12}) for site in ("cylinder.cap", "lines")
    )
    pressures = {"cap_pressure": 2e6, "rod_pressure": 1e6}
    plain, one, two = (rates(m, **pressures) for m in (model, cap, both))
    assert one[0] == pytest.approx(two[0]) and abs(one[0]) < 0.9 * abs(plain[0])
    assert one[1] == pytest.approx(plain[1]) and abs(two[1]) < 0.9 * abs(plain[1])


@pytest.mark.parametrize("q", (-2e-4, 1e-5, 2e-4))
def test_a_line_loses_pressure_in_the_direction_of_flow(q):
    line = LineFriction.at(Site("line", between={"0": "port"})).but(laminar=2e9, turbulent=3e13)
    y = run(bench(line, a_0="potential", b_0="flow"), np.linspace(0, 0.1, 101), a_0=1e6, b_0=q)
    assert y["b_0_p"][-1] - 1e6 == pytest.approx(2e9 * q + 3e13 * q * abs(q), rel=1e-6)
    assert y["a_0_q"][-1] == pytest.approx(-q)


def test_lines_of_one_kind_on_both_chambers_lose_what_either_does_at_its_own_flow():
    model, time = benches.valve_bench(), np.linspace(0, 1, 1001)
    values, name = {"turbulent": 1e15, "laminar": 0.0}, "line_friction"
    cap, annulus, both = (add_effect(model, name, f, values) for f in ("cylinder.cap", "cylinder.annulus", "lines"))
    chained = add_effect(cap, name, "cylinder.annulus", values)
    ends = {k: run(m, time, spool=0.5)["position"][-1] for k, m in enumerate((model, cap, annulus, both, chained))}
    assert ends[3] == pytest.approx(ends[4], rel=1e-9)
    assert ends[3] < min(ends[1], ends[2]) < 0.95 * ends[0]


def test_a_check_valve_in_the_return_keeps_a_pressure_while_oil_returns():
    model = bench(ReturnCheckValve(cracking=2e5), a="potential", b="flow")
    time = np.linspace(0, 0.1, 101)
    assert run(model, time, a=1e5, b=1e-4)["b_p"][-1] == pytest.approx(3e5)
    assert run(model, time, a=1e5, b=-1e-4)["b_p"][-1] == pytest.approx(1e5)


def test_the_check_valve_in_the_return_is_at_the_tank_and_lifts_both_chambers():
    model = benches.valve_bench()
    (found,) = candidates(model, ["return_check_valve"])
    assert found.site.between == "tank.port" and not candidates(cehA.model(), ["return_check_valve"])
    time = np.linspace(0, 1, 101)
    plain, kept = (run(m, time, spool=0.3) for m in (model, add_effect(model, found.id, values={"cracking": 5e5})))
    assert kept["position"][-1] < plain["position"][-1]


def there_and_back(model, volume=2e-7):
    """Pressure while so much oil is drawn in 1 s and given back in the next [m3]."""
    time = np.linspace(0, 2, 2001)
    return run(model, time, flow=np.where(time < 1, -volume, volume))["pressure"]


def test_torn_oil_keeps_its_pressure_and_comes_together_only_when_refilled():
    p = there_and_back(add_effect(bottle(), "cavitation", values={"pressure": 2e4}))
    assert there_and_back(bottle()).min() < -3e5  # without it: tension
    assert 0 < p.min() < 2e4
    assert p[-1] == pytest.approx(1e6, rel=5e-3)  # no oil was gained
    assert np.sum(p[:1000] < 5e4) == pytest.approx(np.sum(p[1000:] < 5e4), abs=5)  # as long to fill as to tear


def test_a_check_valve_feeds_oil_that_stays():
    """Drawn at a constant flow the pressure settles where the valve lets as much in: q = G (p_o - p)."""
    model = add_effect(bottle(), "check_valve_cracking", "bottle.a", values={"pressure": 2e5, "conductance": 1e-11})
    p = there_and_back(model)
    rate = 2e-7 * BETA / VOLUME
    assert p.min() == pytest.approx(2e5 - 2e-7 / 1e-11, rel=1e-3)
    assert p[-1] == pytest.approx(p.min() + rate, rel=1e-2)
    assert p[-1] > 1.3e6


def test_a_relief_valve_holds_the_pressure_and_lets_it_fall_again():
    """Filled at a constant flow the pressure settles at the override: q = G (p - p_r)."""
    model = add_effect(bottle(), "relief_saturation", "bottle.a", values={"pressure": 1.5e6, "conductance": 1e-12})
    time = np.linspace(0, 2, 2001)
    p = run(model, time, flow=np.where(time < 1, 2e-7, -2e-7))["pressure"]
    rate = 2e-7 * BETA / VOLUME
    assert p.max() == pytest.approx(1.5e6 + 2e-7 / 1e-12, rel=1e-2)
    lag = VOLUME / (BETA * 1e-12)
    assert p[-1] == pytest.approx(1.5e6 - rate * (1 - lag * np.log(2)), rel=1e-2)  # it closes at p_r


def test_thresholds_are_looked_for_among_the_pressures_seen():
    p = np.linspace(1e6, 5e6, 1001)
    assert all(3e6 <= probe["pressure"] < 5e6 for probe in ReliefSaturation.probes_for({"port.p": p}))
    assert all(1e6 < probe["pressure"] <= 3e6 for probe in CheckValveCracking.probes_for({"port.p": p}))
    seen = [q["pressure"] for q in Cavitation.probes_for({"p_0": p, "p_1": p + 1e6, "u_0": 0 * p})]
    assert seen[: len(Cavitation.probes)] == [q["pressure"] for q in Cavitation.probes]
    assert all(1e6 < q < 3e6 for q in seen[len(Cavitation.probes) :])
