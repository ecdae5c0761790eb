"""Linear state space: the machine found again where it is linear, its start from the first samples, its derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import learn_linear
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.linear.gauss_newton import minimum
from hydrotwin.learned.linear.regressors import Scales
from hydrotwin.learned.linear.state_space import Form, StateSpace, scanned
from hydrotwin.learned.linear.state_space_block import LINEAR, state_space_arrays, state_space_states
from hydrotwin.learned.linear.subspace import dynamics, hankel_factor, observability
from hydrotwin.learned.linear.whole_runs import Way
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.simulation import predict_one_step, simulate
from tests.learned.test_arx import brief, only, rested, rms
from tests.learned.test_integrating import PERIOD, integral, late, recording, settled, steps

SCALES = Scales(np.array([0.5, -1.0]), np.array([2.0, 0.3]), np.array([1e5, 0.2]), np.array([2e4, 0.05]))


def random_model(form: Form, n: int = 4, seed: int = 0) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    ny, nu = len(form.rates), 2
    D = rng.normal(size=(ny, nu)) * form.fed[:, None]
    return StateSpace(form, A, rng.normal(size=(n, nu)), rng.normal(size=(ny, n)), D, rng.normal(size=ny))


def block_of(model: StateSpace, way: Way):
    structure, arrays = state_space_arrays(model, way, SCALES)
    inputs, outputs = (Signal("u", "V"), Signal("v", "A")), (Signal("pressure", "Pa"), Signal("position", "m"))
    return assemble(
        LINEAR, arrays, structure, name="written", inputs=inputs, outputs=outputs, parameters=(), period=PERIOD,
        states=state_space_states(structure, inputs, outputs),
    )  # fmt: skip


def written_block():
    form = Form((False, True), False, 2)
    gain = np.random.default_rng(3).normal(size=(4, 2))
    return block_of(random_model(form), Way(gain, np.array(form.rates)))


FORMS = [Form(r, d, 0 if d else 2) for r in ((False, False), (False, True), (True, True)) for d in (False, True)]


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_derivatives_of_a_run_are_those_of_finite_differences(form):
    model, rng = random_model(form), np.random.default_rng(1)
    u, x0, first = rng.normal(size=(50, 2)), rng.normal(size=4), rng.normal(size=2)
    J, at = model.derivatives(u, x0), np.concatenate([model.parameters, x0])
    for k in range(len(at)):
        ends = []
        for step in (1e-6, -1e-6):
            there = at.copy()
            there[k] += step
            ends.append(model.with_parameters(there[:-4]).run(u, first, there[-4:]))
        assert J[:, :, k] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-5 * max(1, np.abs(J[:, :, k]).max()))


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_the_block_runs_as_the_model_in_si_and_meets_the_first_output(form):
    """The gain of the way meets what settles: a right inverse of C."""
    model, rng = random_model(form), np.random.default_rng(2)
    known = ~np.array(form.rates)
    gain = np.zeros((4, 2))
    gain[:, known] = np.linalg.pinv(model.C[known])
    way = Way(gain, np.array(form.rates))
    u = np.repeat(rng.normal(size=(20, 2)), 5, axis=0)
    first = rng.normal(size=2)
    delayed = u[np.maximum(np.arange(len(u)) - form.delay, 0)]
    expected = model.run(delayed, first, way.start(model, u[0], first)) * SCALES.output_scale + SCALES.output_centre
    values = [*(u * SCALES.input_scale + SCALES.input_centre).T]
    start = first * SCALES.output_scale + SCALES.output_centre
    columns = dict(zip("uv", values, strict=True))
    columns |= {n: np.full(len(u), y) for n, y in zip(("pressure", "position"), start, strict=True)}
    block = block_of(model, way)
    run = simulate(block, only(columns, {"u": "V", "v": "A", "pressure": "Pa", "position": "m"}))
    for j, name in enumerate(("pressure", "position")):
        assert run[name] == pytest.approx(expected[:, j], rel=1e-9, abs=1e-9 * np.abs(expected[:, j]).max())
        assert run[name][0] == pytest.approx(start[j], rel=1e-9)
    assert any(s.measured_by == "pressure" for s in block.states) is not form.direct


def test_the_scan_is_the_recursion():
    rng = np.random.default_rng(0)
    A, v = 0.4 * rng.normal(size=(3, 3)), rng.normal(size=(37, 3))
    x = [v[0]]
    for row in v[1:]:
        x.append(A @ x[-1] + row)
    assert scanned(A, v) == pytest.approx(np.array(x), abs=1e-12)


def test_the_subspace_finds_the_poles_of_pieces_of_a_run():
    rng = np.random.default_rng(0)
    u = rng.normal(size=3000)
    w = lfilter([0.0, 1.0, 0.5], np.poly([0.9, 0.6]), u) + 0.05 * lfilter([1.0], [1.0, -0.95], rng.normal(size=3000))
    pieces = [hankel_factor([(u[a : a + 1000, None], w[a : a + 1000, None])], 10) for a in (0, 1000, 2000)]
    A, _ = dynamics(observability(pieces, 1, 1, 10), 2, 1)
    assert np.sort(np.linalg.eigvals(A).real) == pytest.approx([0.6, 0.9], abs=0.02)


def test_gauss_newton_ends_in_the_minimum_also_where_directions_change_nothing():
    def residual(q):
        return None if q[0] < -2 else np.array([q[0] * q[1] - 2.0, 10 * (q[0] + q[2] - 1)])

    def jacobian(q):
        return np.array([[q[1], q[0], 0.0], [10.0, 0.0, 10.0]])

    found = minimum(residual, jacobian, np.array([0.5, 0.5, 0.0]), 50)
    assert found.cost < 1e-12
    assert minimum(residual, jacobian, np.array([-3.0, 0.0, 0.0]), 50).cost == np.inf


SWINGS = np.poly([0.97 * np.exp(0.2j), 0.97 * np.exp(-0.2j)]).real
LINEAR_MACHINES = {
    "one that settles": lambda u: settled(settled(u, 0.1), 0.05) + 3.0,
    "one that integrates": lambda u: integral(settled(u, 0.1)),
    "one that swings": lambda u: lfilter([0.0, 0.02, 0.02], SWINGS, u),
    "at once": lambda u: 2 * u + settled(u, 0.2),
    "after a dead time": lambda u: settled(late(u, 6), 0.1),
}  # fmt: skip


@pytest.mark.parametrize("name", LINEAR_MACHINES)
def test_a_linear_machine_is_found_again(name):
    machine = LINEAR_MACHINES[name]
    block = learn_linear([rested(machine, k) for k in (1, 2)], ["u"], ["y"])
    fresh = rested(machine, 7)
    assert rms(block, [fresh]) < 1e-6 * np.ptp(fresh["y"]), block.description
    assert block.certificate.holds


def test_with_noise_it_is_better_than_the_noise():
    machine = LINEAR_MACHINES["one that swings"]
    block = learn_linear([rested(machine, k, noise=0.02) for k in (1, 2)], ["u"], ["y"])
    fresh = rested(machine, 7)
    assert rms(block, [fresh]) < 0.01 * np.ptp(fresh["y"])


def test_two_inputs_two_outputs_that_share_what_moves_them():
    u, v = (np.concatenate([np.zeros(20), steps(k)]) for k in (1, 2))
    inner = settled(u + 0.5 * v, 0.15)
    z = integral(inner - 0.2 * v)
    record = only({"u": u, "v": v, "y": inner, "z": z}, {"u": "V", "v": "A", "y": "1", "z": "m"})
    half = PERIOD * len(u) / 2
    block = learn_linear([record.window(None, half)], ["u", "v"], ["y", "z"])
    short = record.window(None, half)
    for name in "yz":
        assert rms(block, [short], name) < 1e-9 * np.ptp(record[name])


def test_it_starts_where_the_first_output_says_also_away_from_rest():
    train = [rested(LINEAR_MACHINES["one that settles"], k, noise=1e-3) for k in (1, 2)]
    block = learn_linear(train, ["u"], ["y"])
    fresh = recording(lambda u: settled(np.r_[np.ones(50), u], 0.2)[50:] + 3.0, 5, noise=0)
    assert simulate(block, fresh)["y"][0] == pytest.approx(fresh["y"][0], abs=1e-9)


def test_one_step_ahead_is_better_than_the_free_run():
    train = [rested(lambda u: integral(np.tanh(3 * settled(u, 0.1))), k, noise=1e-4) for k in (1, 2)]
    block, fresh = learn_linear(train, ["u"], ["y"]), rested(lambda u: integral(np.tanh(3 * settled(u, 0.1))), 8)
    assert any(s.measured_by == "y" for s in block.states)
    ahead = np.sqrt(np.mean((predict_one_step(block, fresh)["y"] - fresh["y"]) ** 2))
    assert ahead < 0.3 * rms(block, [fresh])


def test_few_samples_are_enough_for_a_small_model():
    assert rms(learn_linear([brief(120)], ["u"], ["y"]), [recording(lambda u: settled(u, 0.1), 9)]) < 0.1


def test_the_same_recordings_give_the_same_block_and_validation_changes_nothing():
    train = [brief(300)]
    blocks = [learn_linear(train, ["u"], ["y"], validate=v) for v in ([], [], [recording(lambda u: u, 5)])]
    for other in blocks[1:]:
        assert all(np.array_equal(blocks[0].arrays[k], other.arrays[k]) for k in blocks[0].arrays)


def test_what_chooses_may_be_given_and_is_not_fitted():
    machine = LINEAR_MACHINES["one that settles"]
    train = [rested(machine, k, noise=0.01) for k in (1, 2)]
    other = rested(lambda u: 2 * machine(u) - 3.0, 4)  # of twice the gain: it would ruin any fit
    block = learn_linear(train, ["u"], ["y"], select=[other], rate=False, period=PERIOD)
    assert [r["name"] for r in block.provenance["selected_on"]] == [other.name]
    assert rms(block, [rested(machine, 7)]) < 0.1 < 0.2 < rms(block, [other])


def test_the_exported_code_runs_as_the_block_does(tmp_path):
    block = learn_linear([rested(LINEAR_MACHINES["after a dead time"], 1, noise=0.01)], ["u"], ["y"], order=2)
    fresh = rested(LINEAR_MACHINES["after a dead time"], 2)
    found = read_fmu(export_fmu(block, tmp_path / "linear.fmu")).free_run(fresh)["y"]
    assert found == pytest.approx(simulate(block, fresh)["y"], abs=1e-9)


@pytest.mark.parametrize(("options", "says"), [({"period": -1}, "period must be"), ({"order": 0}, "order must be")])
def test_impossible_options_are_refused(options, says):
    with pytest.raises(DeclarationError, match=says):
        learn_linear([brief(200)], ["u"], ["y"], **options)
