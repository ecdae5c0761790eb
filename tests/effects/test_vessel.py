"""Vessels that run over: the level stays at the rim, and what is spilled is lost or caught."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.effects import CATALOGUE, add_effect, candidates
from tests.components.bench import at, run
from tests.effects import benches

TIME = np.linspace(0, 200, 2001)


def filled(effect=None, site=None, **values):
    """Tanks that an inflow fills to 0.8 m and 0.8 m, were there no rim."""
    model = benches.tanks() if effect is None else add_effect(benches.tanks(), effect, site, values)
    return run(model, TIME, inflow=0.08)["level"]


def test_levels_are_states_that_cannot_be_negative():
    sites = {c.site.name for c in candidates(benches.tanks(), ["overflow"])}
    assert sites == {"upper", "lower", "upper-lower", "lower-upper"}
    assert not candidates(benches.pump_bench(), ["overflow*"])


def test_a_full_vessel_stays_at_its_rim():
    assert filled()[-1] == pytest.approx(0.8, rel=1e-6)
    assert filled("overflow", "lower", limit=0.6)[-1] == pytest.approx(0.6, abs=1e-4)
    assert filled("overflow", "lower", limit=0.6).max() <= 0.6001


def test_what_an_upper_vessel_spills_does_not_reach_the_lower_one():
    assert filled("overflow", "upper", limit=0.7)[-1] == pytest.approx(0.7, abs=1e-3)


@pytest.mark.parametrize("share", (0.0, 0.4, 1.0))
def test_a_lower_vessel_catches_its_share_of_the_spill(share):
    level = filled("overflow", "upper-lower", limit=0.7, share=share)
    assert level[-1] == pytest.approx(0.7 + share * 0.1, abs=1e-3)  # in rest: inflow 0.8, of which 0.1 is spilled


def test_no_water_is_lost_when_all_of_the_spill_is_caught():
    model = add_effect(benches.tanks(), "overflow", "upper-lower", {"limit": 0.3, "share": 1.0})
    states, drained = {"upper": 0.35, "lower": 0.2}, 0.1 * 0.2
    y = at(model, states, inflow=0.08)
    assert y["der(upper)"] + y["der(lower)"] == pytest.approx(0.08 - drained)
    assert y["der(upper)"] < 0


def test_below_the_rim_nothing_is_spilled():
    model = add_effect(benches.tanks(), "overflow", "upper-lower", {"limit": 0.6, "share": 0.5})
    states = {"upper": 0.5, "lower": 0.5}
    assert at(model, states, inflow=0.03) == at(benches.tanks(), states, inflow=0.03)


def test_rims_are_looked_for_among_the_levels_seen():
    seen = {"h": np.linspace(0.2, 0.9, 1001)}
    for effect in ("overflow",):
        assert all(0.7 < probe["limit"] < 0.9 for probe in CATALOGUE[effect].probes_for(seen))


def test_spilling_is_never_faster_than_the_step_of_the_model():
    model = benches.tanks()
    model.step = 4.0
    (found,) = [c for c in candidates(model, ["overflow"]) if c.site.name == "upper"]
    flat = model.plus([found.addition]).with_parameters({f"{found.name}.limit": 0.3}).flat
    p, start = flat.parameter_vector(), [s.name for s in flat.states].index("upper")
    x = np.array([0.5, 0.4])
    fast = [float(flat.ode(0, x + step * np.eye(2)[start], [0.0], p)[0][start]) for step in (0.0, 0.1)]
    assert (fast[0] - fast[1]) / 0.1 == pytest.approx(1 / 4.0 + 0.1)
