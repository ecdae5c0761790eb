"""The search with the paper's operators, and the free runs in which constants are fitted."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hydrotwin.learned.symbolic.block import CONSTANT, MULTIPLY, SUBTRACT, VARIABLE, Formula, evaluate
from hydrotwin.learned.symbolic.data import prepare
from hydrotwin.learned.symbolic.refit import FreeRun, Series, laid_out
from hydrotwin.simulation import simulate
from tests.learned.test_formula_block import PLAIN, formula_block
from tests.learned.toy_machine import ANGLE, COMMAND, PERIOD, toy_record


@pytest.fixture(scope="module")
def recordings():
    return [toy_record(s) for s in (1, 2)]


def test_pyoperon_and_the_tokens_compute_the_same():
    op = pytest.importorskip("pyoperon")
    from hydrotwin.learned.symbolic.search import FUNCTIONS, PAPER, _Population

    x = np.random.default_rng(0).normal(size=(50, 3))
    population = _Population(x, x[:, 0], replace(PAPER, functions=tuple(FUNCTIONS)), 1)
    random = op.RandomGenerator(np.uint64(3))
    lengths, seen, alike = set(), set(), []
    for _ in range(40):
        tree = population.first(random)
        population.values(random, tree)
        formula = population.formula(tree)
        value = np.broadcast_to(evaluate(formula.tokens, formula.constants, x.T)[0], 50)
        single = op.Evaluate(population.table, tree, population.data, population.problem.TrainingRange)
        alike.append(np.isclose(value, single, rtol=1e-3, atol=1e-3) | ~np.isfinite(single))
        lengths.add(tree.Length)
        seen |= set(formula.tokens)
    assert max(lengths) > 15
    assert np.mean(alike) > 0.97  # in single precision the sine of an exponential may be anything
    assert seen >= {code for _, code in FUNCTIONS.values()}


def test_a_quarter_of_the_population_survives_and_nothing_grows_beyond_twenty_nodes():
    op = pytest.importorskip("pyoperon")
    from hydrotwin.learned.symbolic.search import PAPER, _Population

    x = np.random.default_rng(0).normal(size=(200, 3))
    population = _Population(x, np.tanh(x[:, 0] * x[:, 1]), replace(PAPER, population=200), 1)
    generations = []

    def look():
        parents = list(population.search.Individuals)[:200]
        generations.append(sorted(p.GetFitness(0) for p in parents))
        assert max(p.Genotype.Length for p in parents) <= PAPER.nodes == 20

    population.search.Run(op.RandomGenerator(np.uint64(1)), look, 1, False)
    assert len(generations) > 5
    for before, after in pairwise(generations):
        assert set(before[:50]) <= set(after)


def test_least_squares_on_the_constants_finds_what_the_paper_s_operators_do_not():
    pytest.importorskip("pyoperon")
    from hydrotwin.learned.symbolic.search import PAPER, Archive, Rules, search

    x = np.random.default_rng(0).uniform(1, 5, (200, 2))
    y, best = np.sin(1.37 * x[:, 0]) + 2.6 / (0.4 + x[:, 1]), {}
    for word, rules in {"new": Rules(generations=20), "old": replace(PAPER, scaled=True, generations=60)}.items():
        archive = Archive()
        search(x, y, archive, seed=1, rules=replace(rules, population=100))
        best[word] = archive.best
    assert best["new"] < 1e-4 and best["old"] > 10 * best["new"]


def test_another_seed_searches_elsewhere():
    pytest.importorskip("pyoperon")
    from hydrotwin.learned.symbolic.search import Archive, Rules, search

    x, found = np.random.default_rng(0).normal(size=(200, 2)), []
    for seed in (1, 1, 2):
        archive = Archive()
        search(x, np.sin(3 * x[:, 0]), archive, seed=seed, rules=Rules(population=100, generations=10))
        found.append([f.formula for f in archive.all()])
    assert found[0] == found[1] != found[2]


def test_the_three_criteria_end_a_search():
    pytest.importorskip("pyoperon")
    from hydrotwin.learned.symbolic.search import PAPER, Archive, search

    x = np.random.default_rng(0).normal(size=(200, 2))
    ends = {}
    for word, rules in {
        "generations": {"generations": 10, "patience": 50},
        "good enough": {"generations": 500, "good_enough": 1e9},
        "converged": {"generations": 500, "patience": 10},
    }.items():
        archive = Archive()
        search(x, np.sin(3 * x[:, 0]), archive, seed=1, rules=replace(PAPER, population=100, **rules))
        ends[word] = archive.stopped
    assert all(word == ended for word, ended in ends.items())


def test_the_derivatives_of_a_free_run_agree_with_differences(recordings):
    data = prepare(recordings[:2], [], (COMMAND,), (ANGLE,), PERIOD, (1, 3), False)
    run, runs = FreeRun(PLAIN, [0], data.shape, data.bounds), laid_out(data.series, data.fit, [0], data.shape)
    c, slopes = np.array(PLAIN.constants), run.derivatives(PLAIN.constants, runs)
    for k, h in enumerate(1e-6 * np.eye(len(c))):
        difference = (run.outputs(c + h, runs) - run.outputs(c - h, runs)) / 2e-6
        assert np.allclose(slopes[..., k], difference, rtol=1e-4, atol=1e-4 * np.abs(difference).max())
    clipped = np.abs(run.outputs(c, runs)) > np.abs(data.bounds.upper[0])
    assert not clipped.any()


def test_the_refit_finds_the_constants_that_made_the_recording(recordings):
    truth = formula_block(PLAIN)
    made = [r.with_signals({"arm_angle": simulate(truth, r)["arm_angle"]}) for r in recordings[:2]]
    data = prepare(made, [], (COMMAND,), (ANGLE,), PERIOD, (1, 3), False)
    scales = data.scales | {name: truth.arrays[name] for name in data.scales}
    data = type(data)(data.shape, scales, data.series, data.fit, data.folds)
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
        assert run.errors(run.refit(runs, 5).constants, runs)[1] <= run.errors(huge.constants, runs)[1]
