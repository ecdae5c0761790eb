"""Effects on valves and supplies, held against what their equations say."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models import spool_valve
from hydrotwin.models.components import FourEdgeValve
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, connect
from hydrotwin.models.language.places import Places
from hydrotwin.simulation import prepare
from tests.effects.benches import ValveBench, play, run, seen, valve_bench

OPENING = "valve.spool"
CAP, ROD = "cylinder__cap_pressure", "cylinder__rod_pressure"


class Amplifier(Component):
    """An amplifier in front of the valve."""

    u = Input("1", "in")
    y = Output("1", "out")
    gain = Parameter(1.0, "1", bounds=(0, 10))

    def equations(self):
        yield self.y == self.gain * self.u


class ToldValve(FourEdgeValve):
    """A valve that tells how far it is open."""

    opened = Output("1", "position of its spool")

    def equations(self):
        yield from super().equations()
        yield self.opened == self.spool


class AmplifiedBench(ValveBench):
    """The valve bench with an amplifier between input and valve."""

    valve = ToldValve()

    opening = Output("1", "opening of the valve")
    amplifier = Amplifier()

    def equations(self):
        yield from (e for k, e in enumerate(super().equations()) if k)
        yield connect(self.spool, self.amplifier.u)
        yield connect(self.amplifier.y, self.valve.spool)
        yield self.opening == self.valve.opened


def amplified() -> Model:
    return Model(AmplifiedBench(), "amplified", step=5e-4)


def opening(effect, time, signal, /, **values):
    """Opening of the valve behind the amplifier for a signal (n,)."""
    return run(add_effect(amplified(), effect, values=values), time, signal)[:, 1]


def flow(model, spool, p_a=4e6, p_b=3e6, **states):
    """Flow into port a of the valve."""
    return seen(model, ["valve.a.q"], [spool], **{CAP: p_a, ROD: p_b}, **states)[0]


TIME = np.arange(0.0, 4.0, 1e-3)
TRIANGLE = 0.5 * (1 - 4 * np.abs((TIME / 2 + 0.75) % 1 - 0.5))


def test_an_overlap_closes_the_valve_near_its_centre():
    left = opening("valve_overlap", TIME, TRIANGLE, overlap=0.1)
    np.testing.assert_allclose(left, np.sign(TRIANGLE) * np.maximum(np.abs(TRIANGLE) - 0.1, 0), atol=1e-9)


def test_an_overlap_may_differ_by_side():
    left = opening("asymmetric_overlap", TIME, TRIANGLE, positive=0.2, negative=0.05)
    np.testing.assert_allclose(left, np.maximum(TRIANGLE - 0.2, 0) + np.minimum(TRIANGLE + 0.05, 0), atol=1e-9)


def test_a_spool_with_hysteresis_follows_like_a_play():
    h = 0.05
    followed = opening("spool_hysteresis", TIME, TRIANGLE, half_width=h)
    np.testing.assert_allclose(followed, play(TRIANGLE, h), atol=3e-3)  # 1/s of slope times lag and sample of 1 ms


def test_behind_the_sensor_of_a_spool_what_opens_the_valve_may_differ_by_direction_and_the_reading_stays():
    """The flow opening of the valve, 1 + e on one side and 1 - e on the other; the spool is where it was."""
    model = spool_valve.model()
    labels = [c.label for c in candidates(model, ["direction_asymmetry"])]
    assert labels == ["direction_asymmetry at current", "direction_asymmetry at valve.spool"]
    uneven = add_effect(model, "direction_asymmetry", "valve.spool", {"asymmetry": 0.2})
    for x in (0.4, -0.4):
        states = {"slide__position": x, CAP: 6e6, ROD: 6e6}
        base, more = (seen(m, ["valve.a.q", "spool"], [0.0], **states) for m in (model, uneven))
        assert more[0] == pytest.approx((1.2 if x > 0 else 0.8) * base[0]) and more[1] == base[1] == x


def test_a_signal_inside_arrives_late_by_the_delay():
    time = np.arange(0.0, 2.0, 1e-3)
    model = add_effect(amplified(), "dead_time", "valve.spool", {"time": 0.05})
    late = run(model, time, 0.3 * np.sin(2 * np.pi * time))[:, 1]
    expected = 0.3 * np.sin(2 * np.pi * (time - 0.05 - 5e-4))  # held samples are half a millisecond late themselves
    np.testing.assert_allclose(late[500:], expected[500:], atol=2e-3)


def test_a_spool_with_hysteresis_may_start_anywhere_in_its_play():
    time, still = np.arange(0, 0.1, 1e-3), np.zeros(100)
    np.testing.assert_allclose(opening("spool_hysteresis", time, still, half_width=0.05, offset=-1.0), -0.05, atol=1e-9)


def test_hysteresis_acts_where_the_moving_part_of_a_valve_gets_its_signal_and_behind_it():
    before, behind = candidates(spool_valve.model(), ["spool_hysteresis"])
    assert (before.site.name, behind.site.name) == ("slide.target", "valve.spool")
    assert before.twins == ("spool_hysteresis at current",)  # a gain of one lies between them
    assert [c.site.name for c in candidates(amplified(), ["spool_hysteresis"])] == ["valve.spool"]
    assert [c.site.name for c in candidates(valve_bench(), ["spool_hysteresis"])] == ["valve.spool"]


def test_a_spool_of_fixed_natural_frequency_has_that_one_freed_and_another_one_gets_a_lag():
    fixed = spool_valve.model().with_settings({"slide.natural_frequency": {"free": False}})
    (found,) = candidates(fixed, ["spool_lag"])
    assert found.site.frees == "slide.natural_frequency"
    assert [probe["slide.natural_frequency"] for probe in found.probes] == pytest.approx([72.0, 96.0, 156.0])
    assert next(p for p in fixed.plus([found.addition]).flat.parameters if p.name == found.site.frees).free
    (found,) = candidates(spool_valve.model(), ["spool_lag"])
    assert found.site.through == "valve.spool"


def test_a_lag_of_the_spool_is_behind_a_ramp_by_itself():
    time = np.arange(0, 1, 1e-3)
    behind = (time - opening("spool_lag", time, time, time_constant=0.02))[-1]
    assert behind == pytest.approx(0.02 + 0.0005, abs=5e-5)  # a held ramp is half a sample late itself


@pytest.mark.parametrize("spool", [0.1, 0.5, 1.0])
def test_a_valve_that_saturates_passes_what_two_edges_in_series_pass(spool):
    c, k, dp = 0.8, 6e-8, 1e7 - 4e6
    through = -flow(add_effect(valve_bench(), "flow_saturation", values={"ratio": c}), spool)
    first, second = (through / (k * spool)) ** 2, (through / (k / np.sqrt(c))) ** 2
    assert first + second == pytest.approx(dp, rel=1e-4)


def test_a_supply_that_gives_way_loses_pressure_in_proportion_to_the_flow():
    model = add_effect(valve_bench(), "supply_droop", "supply.port", {"resistance": 5e9})
    behind, source = seen(model, ["valve.supply.p", "supply.port.p"], [0.5], supply_droop_supply_port__drawn=1e-4)
    assert source == 1e7
    assert behind == pytest.approx(1e7 - 5e9 * 1e-4)


def test_a_supply_settles_where_flow_and_pressure_agree():
    model = add_effect(valve_bench(), "supply_droop", "supply.port", {"resistance": 5e9})
    flat, time = model.flat, np.arange(0, 0.4, 1e-3)
    u, p = np.full((len(time), 1), 0.3), flat.parameter_vector()
    x = np.asarray(flat.start_given()(u[0], p, [])).ravel()
    states = np.asarray(prepare(flat, method="vm").run(time, u, p, x)[1])
    end = states[-1] if len(states) == len(time) else states.T[-1]
    drawn, q, behind = np.asarray(
        model.observe(["supply_droop_supply_port.drawn", "supply.port.q", "valve.supply.p"])(0.4, end, u[0], p)
    ).ravel()
    assert drawn == pytest.approx(-q, rel=0.02) and drawn > 1e-6
    assert behind == pytest.approx(1e7 - 5e9 * -q, rel=0.01)


@pytest.mark.parametrize("spool", (0.25, -0.5))
def test_a_supply_gives_way_with_the_opening_whatever_flows(spool):
    """T o' = |u| - o: after a step the pressure falls as an exponential, at any pressures of the chambers."""
    model = add_effect(valve_bench(), "opening_droop", "supply.port", {"loss": 3e6})
    behind = ["valve.supply.p", "der(opening_droop_supply_port.asked)"]
    for p_a in (2e6, 9e6):
        p, rate = seen(model, behind, [spool], opening_droop_supply_port__asked=0.2, **{CAP: p_a})
        assert p == pytest.approx(1e7 - 3e6 * 0.2)
        assert rate == pytest.approx((abs(spool) - 0.2) / 0.01)


def test_a_return_line_may_back_up_with_the_opening():
    assert {c.site.name for c in candidates(valve_bench(), ["opening_droop"])} == {"supply.port", "tank.port"}
    model = add_effect(valve_bench(), "opening_droop", "tank.port", {"loss": -1e6})
    (p,) = seen(model, ["valve.tank.p"], [0.5], opening_droop_tank_port__asked=0.5)
    assert p == pytest.approx(2e5 + 1e6 * 0.5)


def test_a_return_line_backs_up_when_oil_flows_to_the_tank():
    model = add_effect(valve_bench(), "supply_droop", "tank.port", {"resistance": 5e9})
    behind, tank = seen(model, ["valve.tank.p", "tank.port.p"], [0.5], supply_droop_tank_port__drawn=-1e-4)
    assert behind > tank == 2e5


def test_a_resisting_load_opens_a_valve_whose_flow_depends_on_it_so():
    model = add_effect(valve_bench(), "load_dependent_flow", OPENING, values={"share": 0.5})
    more, same = flow(model, 0.5, 4e6, 1e6), flow(valve_bench(), 0.5, 4e6, 1e6)
    assert more / same == pytest.approx(1 + np.tanh(0.5 * 0.3), rel=1e-6)
    back, as_before = flow(model, -0.5, 4e6, 1e6), flow(valve_bench(), -0.5, 4e6, 1e6)
    assert back / as_before == pytest.approx(1 - np.tanh(0.5 * 0.3), rel=1e-6)


def test_every_edge_passes_less_at_its_own_pressure_drop_and_what_it_keeps_does_not_get_lost():
    model = add_effect(valve_bench(), "load_dependent_flow", "valve", values={"share": 0.3})
    part = "load_dependent_flow_valve"
    for spool, drops in ((0.5, (1e7 - 4e6, 1e6 - 2e5)), (-0.5, (4e6 - 2e5, 1e7 - 1e6))):
        names = ["valve.a.q", "valve.b.q", *(f"{part}.{port}.q" for port in ("a", "b", "one", "other"))]
        through_a, through_b, *own = seen(model, names, [spool], **{CAP: 4e6, ROD: 1e6})
        assert own[0] == pytest.approx(-0.3 * drops[0] / 1e7 * through_a, rel=1e-9)
        assert own[1] == pytest.approx(-0.3 * drops[1] / 1e7 * through_b, rel=1e-9)
        assert sum(own) == pytest.approx(0.0, abs=1e-18)
        assert own[2] < 0 < own[3]  # back to the supply, and less into the tank


def test_a_valve_that_the_input_moves_itself_has_no_overlap_of_its_own_beside_the_commands_deadband():
    assert not candidates(valve_bench(), ["valve_overlap"])
    assert candidates(valve_bench(), ["command_deadband"])


def test_a_signal_is_traced_back_through_the_parts_that_make_it():
    places = Places(spool_valve.model())
    assert places.upstream("valve.spool") == ("slide.target", "solenoid.current", "current")
    assert Places(valve_bench()).upstream("valve.spool") == ("spool",)


def test_the_flow_of_edges_that_end_bends_more_suddenly_than_through_a_passage_in_series():
    def share(spool, n):
        bent = add_effect(valve_bench(), "flow_saturation", values={"ratio": 4.0, "sharpness": n})
        return flow(bent, spool) / flow(valve_bench(), spool)

    for spool in (0.1, 0.2, 0.3):
        assert share(spool, 2.0) < share(spool, 12.0) == pytest.approx(1.0, abs=1e-3)
    assert share(1.0, 12.0) == pytest.approx(0.5, rel=1e-2)  # u_0 / sqrt(c) is the largest equivalent opening
