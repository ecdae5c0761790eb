"""The formula: its tokens in CasADi, the search with the paper's operators, and the choice by free runs."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import domain_share, read_block, write_block
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.network.narx import NarxShape, network_states
from hydrotwin.learned.symbolic.block import (
    ADD,
    CONSTANT,
    COSINE,
    MULTIPLY,
    SINE,
    SUBTRACT,
    SYMBOLIC,
    TANH,
    VARIABLE,
    Formula,
    evaluate,
)
from hydrotwin.learned.symbolic.data import prepare
from hydrotwin.learned.symbolic.learn import learn_symbolic
from hydrotwin.learned.symbolic.refit import FreeRun, Series, laid_out
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.simulation import simulate
from tests.learned.toy_machine import ANGLE, COMMAND, PERIOD, SPEED, toy_record

QUICK = {"period": PERIOD, "lags": (1, 3), "starts": 1, "generations": 40, "population": 600, "budget": 3600.0}
BRIEF = QUICK | {"generations": 10, "population": 200}
# d = 0.5 d1 + 2 sin(0.2 u1) - 0.1 : features y, d1, u0, u1, u2
SUM = (ADD, MULTIPLY, CONSTANT, VARIABLE + 1, MULTIPLY, CONSTANT, SINE, MULTIPLY, CONSTANT, VARIABLE + 3)
PLAIN = Formula((SUBTRACT, *SUM, CONSTANT), (0.5, 2.0, 0.2, 0.1))


def formula_block(formula: Formula, **changes):
    shape = NarxShape(1, 1, 1, 3, 0)
    arrays = {
        "tokens": np.array(formula.tokens, float),
        "constants": np.array(formula.constants, float),
        "input_centre": [0.1],
        "input_scale": [0.7],
        "output_centre": [0.4],
        "output_scale": [0.2],
        "increment_scale": [0.004],
        "increment_limit": [5.0],
        "output_lower": [-0.5],
        "output_upper": [1.2],
    }
    counts = {"tokens": len(formula.tokens), "constants": len(formula.constants)}
    return assemble(
        SYMBOLIC,
        arrays | changes,
        {"output_lags": 1, "input_lags": 3} | counts,
        name="plain",
        inputs=(COMMAND,),
        outputs=(ANGLE,),
        states=network_states(shape, (COMMAND,), (ANGLE,)),
        parameters=(),
        period=PERIOD,
    )


def rmse_deg(block, record):
    return float(np.degrees(np.sqrt(np.mean((simulate(block, record)["arm_angle"] - record["arm_angle"]) ** 2))))


@pytest.fixture(scope="module")
def recordings():
    return [toy_record(s) for s in (1, 2, 3)]


@pytest.fixture(scope="module")
def brief_recording():
    return toy_record(1, duration=6.0)


@pytest.fixture(scope="module")
def validation():
    return toy_record(9, name="validation")


@pytest.fixture(scope="module")
def learned(recordings):
    pytest.importorskip("pyoperon")
    return learn_symbolic(recordings, [COMMAND], [ANGLE], **QUICK)


def test_the_step_is_the_written_formula():
    block, rng = formula_block(PLAIN), np.random.default_rng(0)
    for y, d1, u0, u1, u2 in rng.uniform(-1, 1, (20, 5)) * [0.8, 0.01, 2, 2, 2]:
        f = 0.5 * d1 / 0.004 + 2 * np.sin(0.2 * (u1 - 0.1) / 0.7) - 0.1
        d = 0.004 * np.clip(f, -5, 5)
        after, now = block.step([y, d1, u1, u2], u0, [])
        assert np.allclose(after.full().ravel(), [np.clip(y + d, -0.5, 1.2), d, u0, u1], rtol=1e-13)
        assert float(now) == y


def test_a_free_run_of_a_formula_stays_in_its_bounds_whatever_it_says():
    wild = formula_block(Formula((MULTIPLY, CONSTANT, MULTIPLY, VARIABLE, MULTIPLY, VARIABLE, VARIABLE), (1e9,)))
    record = toy_record(1, duration=10.0)
    angle = simulate(wild, record.with_signals({"command": 1e6 * record["command"]}))["arm_angle"][1:]
    assert angle.min() >= -0.5 and angle.max() <= 1.2


@pytest.mark.parametrize(
    ("tokens", "constants", "sentence"),
    [
        ((ADD, VARIABLE), (), "token 0 lacks an operand"),
        ((VARIABLE + 5,), (), r"token 0 asks for feature 5 \(there are 5\)"),
        ((CONSTANT,), (), "token 0 asks for constant -1"),
        ((VARIABLE,), (1.0,), "1 constants are never used"),
        ((9,), (), r"token 0 is none \(got 9\)"),
        ((0.5, VARIABLE, VARIABLE), (), r"token 0 is none \(got 0.5\)"),
        ((-1,), (), r"token 0 is none \(got -1\)"),
        ((VARIABLE, VARIABLE), (), "2 expressions for 1 outputs"),
        ((), (), "0 expressions for 1 outputs"),
    ],
)
def test_a_file_with_a_wrong_token_is_refused_in_a_sentence(tokens, constants, sentence):
    with pytest.raises(DataError, match=sentence):
        formula_block(Formula(tokens, constants))


def test_counts_that_are_none_are_refused():
    block = formula_block(PLAIN)
    for wrong in ({"tokens": -1}, {"constants": 2.5}, {"output_lags": -1}, {"tokens": 10**9}):
        with pytest.raises(DataError, match="not the counts of a symbolic"):
            assemble(SYMBOLIC, block.arrays, dict(block.structure) | wrong, name="x", inputs=(COMMAND,),
                     outputs=(ANGLE,), states=block.states, parameters=(), period=PERIOD)  # fmt: skip


def test_the_derivatives_of_a_free_run_agree_with_differences(recordings):
    data = prepare(recordings[:2], [], (COMMAND,), (ANGLE,), PERIOD, (1, 3), False)
    run, runs = FreeRun(PLAIN, [0], data.shape, data.bounds), laid_out(data.series, data.fit, [0], data.shape)
    c, slopes = np.array(PLAIN.constants), run.derivatives(PLAIN.constants, runs)
    for k, h in enumerate(1e-6 * np.eye(len(c))):
        difference = (run.outputs(c + h, runs) - run.outputs(c - h, runs)) / 2e-6
        assert np.allclose(slopes[..., k], difference, rtol=1e-4, atol=1e-4 * np.abs(difference).max())
    clipped = np.abs(run.outputs(c, runs)) > np.abs(data.bounds.upper[0])
    assert not clipped.any()


def test_a_free_run_of_the_search_is_the_free_run_of_the_block(learned, recordings):
    data = prepare(recordings, recordings[:1], (COMMAND,), (ANGLE,), PERIOD, (1, 3), False)
    formula = Formula(tuple(int(t) for t in learned.arrays["tokens"]), tuple(learned.arrays["constants"]))
    run, runs = FreeRun(formula, [0], data.shape, data.bounds), laid_out(data.series, data.judged, [0], data.shape)
    angle = run.outputs(formula.constants, runs)[0, :, 0] * data.scales["output_scale"] + data.scales["output_centre"]
    assert np.allclose(angle, simulate(learned, recordings[0])["arm_angle"], rtol=0, atol=1e-12)


def test_the_refit_finds_the_constants_that_made_the_recording(recordings):
    truth = formula_block(PLAIN)
    made = [r.with_signals({"arm_angle": simulate(truth, r)["arm_angle"]}) for r in recordings[:2]]
    data = prepare(made, [], (COMMAND,), (ANGLE,), PERIOD, (1, 3), False)
    scales = data.scales | {name: truth.arrays[name] for name in data.scales}
    data = type(data)(data.shape, scales, data.series, data.fit, data.judged)
    columns = [((r["arm_angle"] - 0.4) / 0.2).reshape(-1, 1) for r in made]
    u = [(r["command"] - 0.1) / 0.7 for r in made]
    z = [np.column_stack([y, 0 * y, *(np.r_[[v[0]] * k, v[: len(v) - k]] for k in range(3))]) for y, v in
         zip(columns, u, strict=True)]  # fmt: skip
    series = [type(data.series[0])(a, b) for a, b in zip(z, columns, strict=True)]
    start = Formula(PLAIN.tokens, (0.4, 1.7, 0.25, 0.15))
    found = FreeRun(start, [0], data.shape, data.bounds).refit(laid_out(series, data.fit, [0], data.shape), 60)
    product = found.constants[1] * found.constants[2]
    assert found.constants[0] == pytest.approx(0.5, rel=1e-2) and product == pytest.approx(0.4, rel=1e-2)
    assert found.constants[3] == pytest.approx(0.1, rel=1e-2)


def test_a_formula_whose_values_overflow_runs_at_its_bounds_and_survives_a_refit(recordings):
    data = prepare(recordings[:1], [], (COMMAND,), (ANGLE,), PERIOD, (1, 3), False)
    nothing = Formula((SUBTRACT, MULTIPLY, CONSTANT, VARIABLE, MULTIPLY, CONSTANT, VARIABLE), (1e308, 1e308))
    huge = Formula((MULTIPLY, CONSTANT, *nothing.tokens), (1e308, *nothing.constants))
    huge = Formula((SUBTRACT, *huge.tokens, *huge.tokens), huge.constants * 2)
    run = FreeRun(huge, [0], data.shape, data.bounds)
    runs = laid_out([Series(1e6 * s.z, s.y) for s in data.series], data.fit, [0], data.shape)
    assert np.isfinite(run.outputs(huge.constants, runs)).all()
    with np.errstate(all="ignore"):
        assert run.error(run.refit(runs, 5).constants, runs) <= run.error(huge.constants, runs)


def test_pyoperon_and_the_tokens_compute_the_same():
    op = pytest.importorskip("pyoperon")
    from hydrotwin.learned.symbolic.search import Rules, _Population

    x = np.random.default_rng(0).normal(size=(50, 3))
    population = _Population(x, x[:, 0], False, Rules(), 1)
    random = op.RandomGenerator(np.uint64(3))
    lengths = set()
    for _ in range(40):
        tree = population.first(random)
        population.values(random, tree)
        formula = population.formula(tree)
        value = np.broadcast_to(evaluate(formula.tokens, formula.constants, x.T)[0], 50)
        single = op.Evaluate(population.table, tree, population.data, population.problem.TrainingRange)
        assert np.allclose(value, single, rtol=1e-3, atol=1e-4)
        lengths.add(tree.Length)
    assert max(lengths) > 15


def test_a_quarter_of_the_population_survives_and_nothing_grows_beyond_twenty_nodes():
    op = pytest.importorskip("pyoperon")
    from hydrotwin.learned.symbolic.search import NODES, Rules, _Population

    x = np.random.default_rng(0).normal(size=(200, 3))
    population = _Population(x, np.tanh(x[:, 0] * x[:, 1]), False, Rules(population=200), 1)
    generations = []

    def look():
        parents = list(population.search.Individuals)[:200]
        generations.append(sorted(p.GetFitness(0) for p in parents))
        assert max(p.Genotype.Length for p in parents) <= NODES

    population.search.Run(op.RandomGenerator(np.uint64(1)), look, 1, False)
    assert len(generations) > 5
    for before, after in pairwise(generations):
        assert set(before[:50]) <= set(after)


def test_the_learned_formula_follows_an_unseen_recording_within_a_degree(learned, validation):
    assert rmse_deg(learned, validation) < 1.0
    assert np.degrees(np.std(validation["arm_angle"])) > 5.0


def test_free_runs_choose_better_than_the_paper_s_one_step_error(learned, recordings, validation):
    paper = learn_symbolic(recordings, [COMMAND], [ANGLE], fit="paper", generations=40, population=600, budget=3600)
    assert paper.period == PERIOD and paper.structure["output_lags"] == 0
    assert paper.certificate.holds
    assert rmse_deg(paper, validation) > 3 * rmse_deg(learned, validation)


def test_the_formula_can_be_read_with_its_units(learned):
    text, latex = learned.provenance["equation"], learned.provenance["latex"]
    assert text == learned.description and text.startswith("arm_angle[k+1] = arm_angle[k] + 0.00")
    assert " rad * (" in text and "command[k" in text and " V)" in text
    assert r"\mathrm{arm\_angle}[k+1] =" in latex and r"\,\mathrm{V}" in latex


def test_a_pure_number_is_printed_without_a_unit_and_a_centre_with_its_own():
    pytest.importorskip("sympy")
    from hydrotwin.learned.symbolic.text import equation_text

    valve, formula = Signal("valve", "1"), Formula((MULTIPLY, CONSTANT, VARIABLE + 1), (0.25,))
    scales = {"input_centre": [0.5], "input_scale": [0.2], "output_centre": [0.0], "output_scale": [0.3]}
    scales |= {"increment_scale": [0.01]}
    text, latex = equation_text(formula, (valve,), (ANGLE,), NarxShape(1, 1, 0, 1, 0), scales)
    assert text == "arm_angle[k+1] = arm_angle[k] + 0.01 rad * (0.25*x1); x1 = (valve[k] - 0.5)/(0.2)"
    assert latex.endswith(r"x_{1} = (\mathrm{valve}[k] - 0.5)/(0.2)")


def test_the_printed_formula_is_the_deployed_one(learned):
    sympy = pytest.importorskip("sympy")
    text = learned.provenance["equation"].split("; ")
    expression = sympy.parse_expr(text[0].split(" rad * ", 1)[1])
    meanings = dict(part.split(" = ", 1) for part in text[1:])
    a, y, d, u = learned.arrays, 0.55, 0.003, (0.8, -0.5, 0.3)
    read = {"arm_angle[k]": y, "arm_angle[k-1]": y - d, "command[k]": u[0], "command[k-1]": u[1], "command[k-2]": u[2]}

    def value(meaning):
        for name, number in read.items():
            meaning = meaning.replace(name, f"({number})")
        return sympy.parse_expr(meaning.replace(" rad", "").replace(" V", ""))

    increment = float(expression.subs({name: value(m) for name, m in meanings.items()})) * a["increment_scale"][0]
    after, _ = learned.step([y, d, u[1], u[2]], u[0], [])
    assert float(after[0]) - y == pytest.approx(increment, rel=5e-3)


def test_the_certificate_holds_and_catches_a_changed_constant(learned):
    from hydrotwin.learned.symbolic.learn import certify

    assert learned.certificate.holds and learned.certificate.difference <= 1e-12
    tokens, constants = (learned.arrays[name].tolist() for name in ("tokens", "constants"))
    formula = Formula(tuple(int(t) for t in tokens), tuple(constants))
    assert certify(learned, formula) == learned.certificate
    assert not certify(learned, Formula(formula.tokens, (constants[0] + 1e-6, *constants[1:]))).holds


def test_a_learned_formula_comes_back_from_its_file(learned, validation, tmp_path):
    again = read_block(write_block(learned, tmp_path / "arm.toml")[0])
    assert np.array_equal(simulate(again, validation)["arm_angle"], simulate(learned, validation)["arm_angle"])
    assert again.provenance["equation"] == learned.provenance["equation"]


def test_the_fmu_of_a_formula_runs_as_the_block_does(learned, validation, tmp_path):
    fmu = read_fmu(export_fmu(learned, tmp_path / "formula.fmu"))
    short = validation.window(None, 4.0)
    apart = simulate(learned, short)["arm_angle"] - fmu.free_run(short)["arm_angle"]
    assert np.abs(apart).max() < 1e-9


def test_a_formula_runs_without_what_trained_it():
    lines = "import sys, hydrotwin.learned.symbolic.block, hydrotwin.learned.symbolic.learn\n"
    lines += "assert not {'pyoperon', 'sympy', 'torch'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", lines], check=True)


def test_the_same_seed_gives_the_same_formula_in_another_process(brief_recording):
    pytest.importorskip("pyoperon")
    block = learn_symbolic([brief_recording], [COMMAND], [ANGLE], seed=3, **BRIEF)
    lines = "from tests.learned.test_symbolic import *\nrecord = toy_record(1, duration=6.0)\n"
    lines += "b = learn_symbolic([record], [COMMAND], [ANGLE], seed=3, **BRIEF)\nprint(b.arrays['constants'])"
    again = subprocess.run([sys.executable, "-c", lines], check=True, capture_output=True, text=True)
    assert again.stdout.strip() == str(block.arrays["constants"])


def test_another_seed_searches_elsewhere():
    pytest.importorskip("pyoperon")
    from hydrotwin.learned.symbolic.search import Archive, Rules, search

    x, found = np.random.default_rng(0).normal(size=(200, 2)), []
    for seed in (1, 1, 2):
        archive = Archive()
        rules = Rules(100, 10)
        search(x, np.sin(3 * x[:, 0]), archive, seed=seed, rules=rules, scaled=True, until=np.inf)
        found.append([f.formula for f in archive.all()])
    assert found[0] == found[1] != found[2]


def test_interrupting_the_search_keeps_the_best_so_far(brief_recording):
    pytest.importorskip("pyoperon")
    seen = []

    def interrupt(step):
        seen.append(step)
        if len(seen) == 5:
            raise KeyboardInterrupt

    block = learn_symbolic([brief_recording], [COMMAND], [ANGLE], progress=interrupt, **BRIEF)
    assert block.provenance["stopped"] == "interrupted" and block.certificate.holds
    assert block.provenance["held_out_error"] < 0.5


def test_interrupting_the_selection_keeps_the_best_so_far(brief_recording):
    pytest.importorskip("pyoperon")

    def interrupt(step):
        if getattr(step, "done", 0) == 3:
            raise KeyboardInterrupt

    block = learn_symbolic([brief_recording], [COMMAND], [ANGLE], progress=interrupt, **BRIEF)
    assert block.provenance["stopped"] == "interrupted" and block.certificate.holds


def test_the_time_budget_ends_the_work_early(brief_recording):
    pytest.importorskip("pyoperon")
    block = learn_symbolic([brief_recording], [COMMAND], [ANGLE], **BRIEF | {"budget": 1e-3})
    assert "time budget" in block.provenance["stopped"]


def test_progress_reports_every_generation_with_a_falling_error(brief_recording):
    pytest.importorskip("pyoperon")
    steps = []
    learn_symbolic([brief_recording], [COMMAND], [ANGLE], progress=steps.append, **BRIEF)
    found = [s for s in steps if hasattr(s, "generation")]
    assert [s.generation for s in found] == list(range(11))
    assert [s.best for s in found] == sorted((s.best for s in found), reverse=True)
    assert found[-1].evaluations == 200 + 10 * 150 - 10  # in each generation one place is kept for the best
    assert all(hasattr(s, "candidates") for s in steps[11:]) and len(steps) > 15


def test_the_three_criteria_end_a_search():
    pytest.importorskip("pyoperon")
    from hydrotwin.learned.symbolic.search import Archive, Rules, search

    x = np.random.default_rng(0).normal(size=(200, 2))
    ends = {}
    for word, rules in {
        "generations": Rules(100, 10, patience=50),
        "good enough": Rules(100, 500, good_enough=1e9),
        "converged": Rules(100, 500, patience=10),
    }.items():
        archive = Archive()
        search(x, np.sin(3 * x[:, 0]), archive, seed=1, rules=rules, scaled=False, until=np.inf)
        ends[word] = archive.stopped
    assert all(word == ended for word, ended in ends.items())


def test_two_outputs_are_learnt_together(recordings, validation):
    pytest.importorskip("pyoperon")
    options = BRIEF | {"validate": [toy_record(5, duration=8.0)], "lags": (1, 2)}
    block = learn_symbolic(recordings[:1], ["command"], ["arm_angle", "motor_speed"], **options)
    run = simulate(block, validation)
    assert rmse_deg(block, validation) < 2.0
    error = np.sqrt(np.mean((run["motor_speed"] - validation["motor_speed"]) ** 2))
    assert error < 0.1 * np.std(validation["motor_speed"])
    assert block.outputs[1].unit == SPEED.unit and block.provenance["selected_on"][0]["name"] == "toy_5"


def test_the_domain_is_the_training_range(learned, recordings):
    assert domain_share(learned, recordings[0]).inside == 1.0


def test_a_formula_is_simplified_without_changing_it():
    pytest.importorskip("sympy")
    from hydrotwin.learned.symbolic.text import simplified

    nested = Formula(
        (MULTIPLY, CONSTANT, MULTIPLY, CONSTANT, ADD, TANH, VARIABLE, ADD, TANH, VARIABLE, COSINE, CONSTANT),
        (2.0, 3.0, 0.5),
    )
    short, x = simplified(nested, 1), ca.SX.sym("x")
    assert len(short.tokens) < len(nested.tokens)
    for value in (-1.0, 0.3, 2.0):
        both = [evaluate(f.tokens, f.constants, [value])[0] for f in (nested, short)]
        assert both[0] == pytest.approx(both[1], rel=1e-14)
    assert evaluate(short.tokens, short.constants, [x], library=ca)[0].is_symbolic() is False


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"outputs": ["arm_angel"]}, "Did you mean 'arm_angle'"),
        ({"outputs": ["command"]}, "named both as input and output"),
        ({"period": 2.0}, "too few samples"),
        ({"records": []}, "no recordings"),
    ],
)
def test_what_no_formula_can_be_learnt_from_is_refused(recordings, change, sentence):
    pytest.importorskip("pyoperon")
    asked = {"records": recordings[:1], "inputs": ["command"], "outputs": ["arm_angle"], **BRIEF} | change
    with pytest.raises(DataError, match=sentence):
        learn_symbolic(asked.pop("records"), asked.pop("inputs"), asked.pop("outputs"), **asked)


@pytest.mark.parametrize(
    "option", [{"fit": "papier"}, {"starts": 0}, {"population": 3}, {"lags": (-1, 2)}, {"tolerance": -1}, {"budget": 0}]
)
def test_impossible_options_of_a_search_are_refused(recordings, option):
    pytest.importorskip("pyoperon")
    with pytest.raises(DeclarationError, match=next(iter(option))):
        learn_symbolic(recordings[:1], ["command"], ["arm_angle"], **BRIEF | option)
