"""Several networks with hidden states as one: their mean moves the outputs, each keeps its own hidden states."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned import learn_state_network
from hydrotwin.learned.refit import refitted
from hydrotwin.learned.state_network.committee import committee
from hydrotwin.learned.state_network.equations import StateShape
from hydrotwin.learned.state_network.sensitivities import Network, Sections, encode, free_run
from tests.learned.test_state_network import QUICK, two_tanks

NAMES, FEW = (["pump"], ["level"]), QUICK | {"hidden_states": 1, "hidden": 3}


def random_net(seed: int, hidden_states: int, hidden: int) -> Network:
    rng, shape = np.random.default_rng(seed), StateShape(1, 2, hidden_states, hidden, 2, 0)
    flat = rng.normal(size=shape.size)
    rate = np.concatenate([[0.3, 0.2], rng.uniform(0.1, 0.4, hidden_states)])
    return Network(shape, rate, np.full(shape.order, -9.0), np.full(shape.order, 9.0), flat)


def sections(steps: int) -> Sections:
    rng = np.random.default_rng(9)
    shapes = {"encoder": (3, 9), "first": (3, 2), "inputs": (steps, 3, 1), "targets": (steps, 3, 2)}
    parts = {name: rng.normal(size=size) for name, size in shapes.items()}
    return Sections(**parts, weights=np.ones((steps, 3)))


def test_the_outputs_move_by_the_mean_and_hidden_states_by_their_own_network():
    nets, s = [random_net(1, 2, 3), random_net(2, 1, 4), random_net(3, 2, 2)], sections(1)
    one, own = free_run(committee(nets), s), [free_run(net, s) for net in nets]
    assert one[1, :, :2] == pytest.approx(np.mean([z[1, :, :2] for z in own], axis=0), abs=1e-12)
    hidden = np.hstack([z[1, :, 2 : net.shape.order] for z, net in zip(own, nets, strict=True)])
    assert one[1, :, 2:7] == pytest.approx(hidden, abs=1e-12)
    begun = np.hstack([encode(net, s)[:, 2:] for net in nets])
    assert encode(committee(nets), s)[:, 2:] == pytest.approx(begun, abs=1e-12)


def test_a_committee_of_alike_is_each_of_them():
    net, s = random_net(1, 2, 3), sections(30)
    assert free_run(committee([net, net]), s)[:, :, :2] == pytest.approx(free_run(net, s)[:, :, :2], abs=1e-9)
    assert committee([net]) is net


@pytest.fixture(scope="module")
def record():
    return two_tanks(1, 220)


@pytest.fixture(scope="module")
def half(record):
    return learn_state_network([record.window(None, 150.0)], *NAMES, **FEW)


def test_candidates_near_the_best_are_one_network(half, record):
    errors = [one["held_out_error"] for one in half.provenance["members"]]
    assert 2 <= len(errors) <= 3 and half.provenance["held_out_error"] <= 1.5 * max(errors)
    assert half.structure["hidden"] == FEW["hidden"] * len(errors)
    alone = learn_state_network([record], *NAMES, **FEW, members=1)
    assert len(alone.provenance["members"]) == 1 and alone.structure["hidden"] == FEW["hidden"]


def test_trained_again_on_all_it_is_the_network_that_was_judged_a_little_further(half, record):
    again = refitted(half, "state_nn", [record], *NAMES)
    assert again.structure == half.structure and again.provenance["members"] == half.provenance["members"]
    for name, before in half.arrays.items():
        if name.endswith(("weights", "bias")):
            assert np.array_equal(again.arrays[name] == 0, before == 0), "what one network hears, others do not"
        elif name.endswith(("centre", "scale", "rate")):
            assert np.array_equal(again.arrays[name], before)
    assert again.certificate.holds
    assert not np.array_equal(again.arrays["output_weights"], half.arrays["output_weights"])
