"""The network with hidden states: equations, derivatives, and what it finds in machines whose states are known."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned import learn_state_network
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.state_network.climbing import Run, section_at
from hydrotwin.learned.state_network.equations import STATE_NETWORK, StateShape, array_shapes, network_states
from hydrotwin.learned.state_network.sensitivities import Network, errors, free_run, normal_equations
from hydrotwin.learned.state_network.subspace import rescaled
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import TrainingDomain, simulate
from tests.learned.toy_machine import ANGLE, COMMAND, PERIOD

SHAPE = StateShape(inputs=1, outputs=1, hidden_states=2, hidden=3, past=2, encoder_hidden=2)
LEVEL, PUMP, FORCE, PLACE = Signal("level", "m"), Signal("pump", "V"), Signal("force", "N"), Signal("place", "m")
QUICK = {"starts": 1, "effort": 0.4, "hidden": 4}


def random_state_network(shape: StateShape = SHAPE):
    """A block with random weights, some of whose states meet their bounds."""
    rng = np.random.default_rng(0)
    arrays = {n: rng.normal(size=s) for n, s in array_shapes(shape.structure(), shape.inputs, shape.outputs).items()}
    arrays |= {"input_scale": np.array([2.0]), "output_scale": np.array([0.5]), "rate": np.full(shape.order, 0.3)}
    arrays |= {"state_lower": np.full(shape.order, -1.5), "state_upper": np.full(shape.order, 1.2)}
    return assemble(
        STATE_NETWORK,
        arrays,
        shape.structure(),
        name="random",
        inputs=(COMMAND,),
        outputs=(ANGLE,),
        states=network_states(shape, (ANGLE,)),
        parameters=(),
        period=PERIOD,
        domain=TrainingDomain(("command", "arm_angle"), (-1.0, 0.0), (1.0, 2.0)),
        provenance={"kind": "state_network"},
    )


def two_tanks(seed: int, n: int = 400) -> Record:
    """Level of the lower of two tanks, whose outflow goes with the root of the level; that of the upper is not told."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.5, 3.0, n // 20 + 1), 20)[:n]
    level, upper, lower = np.empty(n), 1.0, 1.0
    u[:60] = 1.0  # at rest
    for k in range(n):
        level[k] = lower
        for _ in range(4):
            into, through = 0.1 * u[k], 0.1 * np.sqrt(max(upper, 0.0))
            upper, lower = upper + 0.25 * (into - through), lower + 0.25 * (through - 0.1 * np.sqrt(max(lower, 0.0)))
    return Record(np.arange(n) * 1.0, {"pump": u, "level": level}, {"pump": "V", "level": "m"}, f"tanks {seed}")


def axis_with_friction(seed: int, n: int = 600) -> Record:
    """Place of a mass with dry and viscous friction, driven by force: speed is hidden, place integrates."""
    rng, h = np.random.default_rng(seed), 0.02
    strokes = np.outer(rng.uniform(-3.0, 3.0, n // 80 + 1), np.repeat([1.0, -1.0], 40)).ravel()  # there and back
    u = np.concatenate([np.zeros(20), strokes])[:n]
    place, x, v = np.empty(n), 0.0, 0.0
    for k in range(n):
        place[k] = x
        for _ in range(10):
            v += h / 10 * (u[k] - v - 0.6 * np.tanh(30 * v))
            x += h / 10 * v
    return Record(np.arange(n) * h, {"force": u, "place": place}, {"force": "N", "place": "m"}, f"axis {seed}")


def missed(block, record: Record, name: str) -> float:
    """RMS error of a free run over the spread of the output."""
    return float(np.sqrt(np.mean((simulate(block, record)[name] - record[name]) ** 2)) / record[name].std())


@pytest.fixture(scope="module")
def tanks():
    return learn_state_network([two_tanks(1), two_tanks(2)], [PUMP], [LEVEL], hidden_states=1, **QUICK)


def test_the_step_is_the_written_equation():
    block, rng = random_state_network(), np.random.default_rng(1)
    a = block.arrays
    for _ in range(20):
        x, u = rng.normal(size=3), rng.normal(size=1)
        scale, centre = np.array([0.5, 1, 1]), np.array([a["output_centre"][0], 0, 0])
        normal = (x - centre) / scale
        z = np.concatenate([normal, (u - a["input_centre"]) / 2.0])
        h = np.tanh(a["hidden_weights"] @ z + a["hidden_bias"])
        moved = a["output_weights"] @ h + a["linear_weights"] @ z + a["output_bias"]
        expected = centre + scale * np.clip(normal + 0.3 * moved, -1.5, 1.2)
        x_next, y = block.step(x, u, [])
        assert np.allclose(x_next.full().ravel(), expected, rtol=1e-13)
        assert np.array_equal(y.full().ravel(), x[:1])


def test_the_start_is_the_first_sample_and_the_encoder_s_answer_to_a_past_that_stood_still():
    block = random_state_network()
    a = block.arrays
    y, u = (0.4 - a["output_centre"][0]) / 0.5, (0.7 - a["input_centre"][0]) / 2.0
    e = np.array([y, 0.0, 0.0, u, u, u])
    h = np.tanh(a["encoder_hidden_weights"] @ e + a["encoder_hidden_bias"])
    hidden = a["encoder_linear_weights"] @ e + a["encoder_bias"] + a["encoder_output_weights"] @ h
    found = block.start(0.7, 0.4, []).full().ravel()
    assert found[0] == 0.4
    assert np.allclose(found[1:], np.clip(hidden, -1.5, 1.2), rtol=1e-13)


@pytest.mark.parametrize("bound", [100.0, 0.8])
def test_the_derivatives_carried_along_are_those_of_the_free_run(bound):
    rng, shape = np.random.default_rng(0), StateShape(2, 2, 2, 3, 2, 2)
    u, y = rng.normal(size=(30, 2)), rng.normal(size=(30, 2))
    s = section_at(u, y, y, np.array([3, 10]), 12, 2, np.array([0.3, 0.4]), still=False)
    far, rate = np.array([2.0, 2.0, bound, bound]), np.array([0.3, 0.4, 0.2, 0.1])

    def missed_by(flat):
        return errors(Network(shape, rate, -far, far, flat), s).ravel()

    flat = 0.4 * rng.normal(size=shape.size)
    J = np.array([missed_by(flat + d) - missed_by(flat - d) for d in 1e-6 * np.eye(shape.size)]).T / 2e-6
    JJ, Je, ee = normal_equations(Network(shape, rate, -far, far, flat), s)
    e = missed_by(flat)
    assert np.allclose(JJ, J.T @ J, rtol=1e-6, atol=1e-6 * np.abs(JJ).max())
    assert np.allclose(Je, J.T @ e, rtol=1e-6, atol=1e-6 * np.abs(Je).max())
    assert ee == pytest.approx(e @ e)


def test_the_unit_of_a_hidden_state_is_free():
    rng, shape = np.random.default_rng(0), StateShape(1, 1, 2, 3, 2, 2)
    u, y = rng.normal(size=(30, 1)), rng.normal(size=(30, 1))
    s = section_at(u, y, y, np.array([3]), 12, 2, np.array([0.3]), still=False)
    far = np.full(3, 1e9)
    net = Network(shape, np.array([0.3, 0.2, 0.1]), -far, far, 0.4 * rng.normal(size=shape.size))
    other = rescaled(net, np.array([5.0, 0.1]))
    assert np.allclose(free_run(net, s)[..., 0], free_run(other, s)[..., 0], rtol=1e-10, atol=1e-12)
    assert not np.allclose(free_run(net, s)[..., 1], free_run(other, s)[..., 1])


def test_what_is_held_out_is_told_by_its_ends():
    used = np.array([1, 0, 0, 1, 1, 0], dtype=bool)
    assert Run(np.zeros((6, 1)), np.zeros((6, 1)), used).held_out() == [(1, 2), (5, 5)]


def test_a_tank_that_is_not_measured_is_found(tanks):
    fresh = two_tanks(9)
    linear = learn_state_network(
        [two_tanks(1), two_tanks(2)], [PUMP], [LEVEL], hidden_states=1, starts=1, hidden=0, effort=0.4
    )
    assert missed(tanks, fresh, "level") < 0.1
    assert missed(tanks, fresh, "level") < 0.5 * missed(linear, fresh, "level")


def test_the_deployed_step_is_the_trained_one_and_the_provenance_tells_what_was_tried(tanks):
    assert tanks.certificate.holds
    assert tanks.provenance["stopped"] == "finished"
    assert tanks.provenance["hidden_states"] == 1
    errors_ = [t["held_out_error"] for t in tanks.provenance["trials"]]
    assert tanks.provenance["held_out_error"] <= min(errors_)


def test_an_output_that_integrates_with_dry_friction_is_run_freely():
    block = learn_state_network(
        [axis_with_friction(1), axis_with_friction(2)], [FORCE], [PLACE], hidden_states=1, **QUICK
    )
    assert missed(block, axis_with_friction(9), "place") < 0.15


def test_the_same_seed_and_data_give_the_same_block_whatever_judges(tanks):
    again = learn_state_network(
        [two_tanks(1), two_tanks(2)], [PUMP], [LEVEL], hidden_states=1, validate=[two_tanks(5)], **QUICK
    )
    assert all(np.array_equal(again.arrays[name], tanks.arrays[name]) for name in tanks.arrays)


def test_few_samples_get_a_small_network():
    block = learn_state_network([two_tanks(1, 160)], [PUMP], [LEVEL], starts=1, effort=0.3)
    assert block.provenance["hidden"] == 2 and block.structure["hidden"] == 2 * len(block.provenance["members"])
    run = simulate(block, two_tanks(2, 160))
    assert np.isfinite(run["level"]).all()


def test_a_budget_that_bites_is_told():
    block = learn_state_network([two_tanks(1)], [PUMP], [LEVEL], budget=1e-6)
    assert block.provenance["stopped"] == "time budget of 1e-06 s"


@pytest.mark.parametrize(
    ("option", "value"),
    [("hidden", -1), ("hidden_states", 0.5), ("past", 0), ("starts", 0), ("effort", 0), ("budget", -1)],
)
def test_impossible_options_are_refused(option, value):
    with pytest.raises(DeclarationError, match=option):
        learn_state_network([two_tanks(1)], [PUMP], [LEVEL], **{option: value})


def test_too_few_samples_are_refused_with_their_number():
    with pytest.raises(DataError, match=r"too few samples to learn from \(got 50 at 1 s\)"):
        learn_state_network([two_tanks(1).window(60.0, 109.0)], [PUMP], [LEVEL])


def test_recordings_that_select_choose_and_are_not_trained_on():
    quick = {"starts": 1, "effort": 0.1, "hidden": 2, "hidden_states": 1}
    strange = two_tanks(5).with_signals({"level": two_tanks(6)["level"]})
    plain, chosen, same, other = (
        learn_state_network([two_tanks(1)], [PUMP], [LEVEL], select=select, **quick)
        for select in ([], [two_tanks(5)], [two_tanks(5)], [strange])
    )
    assert chosen.provenance["selected_on"][0]["name"] == two_tanks(5).name
    assert [r["name"] for r in chosen.provenance["trained_on"]] == [two_tanks(1).name]
    assert all(np.array_equal(chosen.arrays[n], same.arrays[n]) for n in same.arrays)
    assert all(np.array_equal(chosen.arrays[n], plain.arrays[n]) for n in ("output_centre", "output_scale"))
    assert any(not np.array_equal(chosen.arrays[n], other.arrays[n]) for n in other.arrays)
    assert chosen.domain == plain.domain, "what chooses is not what was learnt from"
