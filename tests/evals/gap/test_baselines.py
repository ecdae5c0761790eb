"""The baselines and the oracle on one short case: what they predict and what they name."""

from __future__ import annotations

import pytest

from benchmarks.gap import baselines
from benchmarks.gap.baselines import gaussian_process, residuals
from benchmarks.gap.cases import Case, make
from benchmarks.gap.refits import Bench, at_truth, oracle
from benchmarks.gap.score import row_of, times_noise
from hydrotwin.models.effects import candidates

SENSORS = "position+pressures"


@pytest.fixture(scope="module")
def bench():
    return Bench(make(Case("spool_valve", "single", ("valve_overlap",), 30.0, "position", "drive", 101, 5.0)))


@pytest.mark.proof
def test_the_true_structure_refitted_reaches_the_noise_and_the_base_does_not(bench):
    best, base = (times_noise(rmse, bench.made.noise) for rmse in (oracle(bench), bench.rmse(bench.base)))
    assert best == pytest.approx(1.0, abs=0.06)
    assert base > 1.5 * best


def test_the_true_structure_begins_at_the_truth_too_so_that_limits_are_reached():
    """No derivative leads to an opening pressure from where nothing reaches it."""
    bench = Bench(make(Case("spool_valve", "single", ("check_valve_cracking",), 5.0, SENSORS, "sweep", 101, 5.0)))
    ((effect, options),) = bench.made.hidden
    (feeding, *_) = candidates(bench.model, [effect])
    assert sorted(at_truth(bench.made, 0, feeding).values()) == sorted(options.values())
    best, base = (times_noise(rmse, bench.made.noise) for rmse in (oracle(bench), bench.rmse(bench.base)))
    assert best == pytest.approx(1.0, abs=0.06) and base > 3 * best


def test_residuals_are_measured_minus_simulated_over_the_noise(bench):
    fit, held_out = residuals(bench)
    assert (len(fit), len(held_out)) == (3, 2)
    assert (sum((r**2).sum() for r in fit) / sum(r.size for r in fit)) ** 0.5 == pytest.approx(
        times_noise(bench.by_output(bench.base.fitted.rmse), bench.made.noise), rel=1e-6
    )


def test_a_gaussian_process_predicts_part_of_the_gap_and_names_nothing(bench, monkeypatch):
    pytest.importorskip("gpytorch")
    monkeypatch.setattr(baselines, "POINTS", 150)
    row = row_of(bench.made, gaussian_process(bench), method="gp")
    assert row["named"] == [] and row["verdict"] == "unknown"
    assert row["gap_closed"] is not None and row["after"] < 5 * row["before"]


def test_sparse_regression_says_a_term(bench):
    pytest.importorskip("pysindy", reason="pip install pysindy, for the baseline")
    from benchmarks.gap.sindy import FAMILY, sparse_regression

    answer = sparse_regression(bench)
    assert answer.notes["term"] in (*FAMILY, None)
    assert answer.rmse_after is None


def test_a_base_that_cannot_be_identified_is_said(bench, monkeypatch):
    monkeypatch.setattr("benchmarks.gap.refits.conclude", lambda job: "every run diverges")
    again = Bench(bench.made)
    again.__dict__["search"] = bench.search
    with pytest.raises(RuntimeError, match="every run diverges"):
        _ = again.base
