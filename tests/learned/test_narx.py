"""Polynomial NARX: the terms of a known law found again, as many as it has, and a block as all others."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import learn, learn_narx, read_block, write_block
from hydrotwin.learned.network.narx import NarxShape
from hydrotwin.learned.polynomial.selection import select
from hydrotwin.learned.polynomial.terms import MOST, candidates, factors_of, polynomial, values, words
from hydrotwin.learned.symbolic.block import evaluate
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

PERIOD = 0.1


def machine(seed: int, noise: float = 0.0, samples: int = 900) -> Record:
    """y[k+1] = y[k] + 0.1 u[k-1] - 0.05 y[k]^2 u[k-1] - 0.08 y[k], steps of six samples, at rest before."""
    rng = np.random.default_rng(seed)
    u = np.concatenate([np.zeros(20), np.repeat(rng.uniform(-1.5, 1.5, samples // 6), 6)])
    y = np.zeros(len(u))
    for k in range(1, len(u) - 1):
        y[k + 1] = y[k] + 0.1 * u[k - 1] - 0.05 * y[k] ** 2 * u[k - 1] - 0.08 * y[k]
    y = y + noise * np.ptp(y) * rng.normal(size=len(y))
    return Record(PERIOD * np.arange(len(u)), {"u": u, "y": y}, {"u": "V", "y": "m"}, f"machine_{seed}")


def rms(block, records) -> float:
    return float(np.sqrt(np.mean(np.concatenate([simulate(block, r)["y"] - r["y"] for r in records]) ** 2)))


@pytest.fixture(scope="module")
def block():
    return learn_narx([machine(1), machine(2)], ["u"], ["y"], period=PERIOD, terms=8)


def test_a_term_that_one_step_ahead_does_not_show_is_found_in_free_run():
    """A slow drift with the square of the input: a hundredth of an increment, and most of where a run ends."""
    records = [drifting(seed) for seed in range(1, 4)]
    asked = {"period": PERIOD, "lags": (1, 1), "delay": 0, "degree": 2, "terms": 2}
    block = learn_narx(records, ["u"], ["y"], **asked)
    assert "u[k]^2" in [t["term"] for t in block.provenance["narx"]["y"]["terms"]]
    assert rms(block, [drifting(9)]) < 0.02


def drifting(seed: int, samples: int = 600) -> Record:
    """y[k+1] = y[k] + 0.1 u[k] + 0.002 u[k]^2, read with noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.5, 1.5, samples // 6), 6)
    y = np.concatenate([[0.0], np.cumsum(0.1 * u + 0.002 * u**2)[:-1]]) + 0.005 * rng.normal(size=samples)
    return Record(PERIOD * np.arange(samples), {"u": u, "y": y}, {"u": "V", "y": "m"}, f"drifting_{seed}")


# -- selection of terms ------------------------------------------------------------------------------------------------
def test_ratios_are_those_of_classical_orthogonalisation():
    """Gram-Schmidt by hand, column by column, on what is chosen."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(200, 6)) @ rng.normal(size=(6, 6))
    t = A @ np.array([0, 3.0, 0, -1.0, 0, 0.2]) + 0.1 * rng.normal(size=200)
    found, kept = select(A, t, 6), []
    for column, ratio in zip(found.columns, found.ratios, strict=True):
        w = A[:, column].copy()
        for v in kept:
            w -= v * (v @ w) / (v @ v)
        kept.append(w)
        assert ratio == pytest.approx((w @ t) ** 2 / (w @ w) / (t @ t), rel=1e-8)
    left = t - A[:, found.columns] @ found.factors[-1]
    assert 1 - sum(found.ratios) == pytest.approx(left @ left / (t @ t), rel=1e-8)


def test_bic_stops_where_the_law_ends_and_aic_not_before():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(500, 40))
    t = A[:, [4, 17, 30]] @ np.array([2.0, -1.0, 0.5]) + 0.2 * rng.normal(size=500)
    found = select(A, t, 12)
    assert found.by_bic == 3 and set(found.columns[:3]) == {4, 17, 30}
    assert int(np.argmin(found.aic)) + 1 >= found.by_bic
    n, k = 500, 3
    assert found.bic[2] - found.aic[2] == pytest.approx(k * (np.log(n) - 2))


def test_columns_that_say_the_same_are_taken_once():
    rng = np.random.default_rng(1)
    a = rng.normal(size=(100, 2))
    found = select(np.column_stack([a, a @ [1.0, 2.0], a]), a @ [1.0, -1.0] + rng.normal(size=100), 5)
    assert len(found.columns) == 2


def test_terms_are_all_products_behind_the_delay_and_no_more_than_can_be_searched():
    shape = NarxShape(1, 1, 1, 3, 0)
    found = candidates(shape, [1], 3)
    assert len(found) == len(set(found)) == 35, "four features up to the third degree"
    assert not any(2 in term for term in found), "the newest sample of the input is before the delay"
    many = candidates(NarxShape(3, 2, 3, 12, 0), [0, 0, 0], 3)
    assert len(many) <= MOST + 44 and all((i,) in many for i in range(44))


def test_a_polynomial_is_the_same_as_a_formula():
    terms, factors = [(), (0,), (0, 0, 2), (1, 2)], [0.5, -1.0, 2.0, 3.0]
    z = np.random.default_rng(0).normal(size=(20, 3))
    formula = polynomial(terms, factors)
    (found,) = evaluate(formula.tokens, formula.constants, z.T)
    assert found == pytest.approx(values(terms, z) @ factors, rel=1e-12)
    assert factors_of(formula, 3) == [pytest.approx(dict(zip(terms, factors, strict=True)))]
    assert words((0, 0, 2), {0: "y[k]", 2: "u[k-1]"}) == "y[k]^2 u[k-1]"


# -- what is learnt ----------------------------------------------------------------------------------------------------
def test_a_polynomial_law_is_found_again(block):
    told = block.provenance["narx"]["y"]
    assert {"y[k]", "u[k-1]", "y[k]^2 u[k-1]"} <= {row["term"] for row in told["terms"]}
    fresh = machine(9)
    assert rms(block, [fresh]) < 1e-9 * np.ptp(fresh["y"]) and len(told["terms"]) == 3
    assert block.certificate.holds and told["degree"] == 3


def test_the_table_of_terms_says_what_each_explains(block):
    told = block.provenance["narx"]["y"]
    assert len(told["err"]) == len(told["selected"]) == len(told["aic"]) == len(told["bic"])
    assert all(ratio >= 0 for ratio in told["err"]) and sum(told["err"]) <= 1 + 1e-9
    assert all(row["factor"] != 0 and (row["err"] is None or row["err"] >= 0) for row in told["terms"])


def test_noise_costs_little():
    records, fresh = [machine(1, 0.005), machine(2, 0.005)], machine(9)
    noisy, linear = (learn_narx(records, ["u"], ["y"], period=PERIOD, terms=8, degree=n) for n in (3, 1))
    assert rms(noisy, [fresh]) < 0.015 * np.ptp(fresh["y"])
    assert rms(noisy, [fresh]) < 0.6 * rms(linear, [fresh])


def test_it_stands_where_other_kinds_do(block, tmp_path):
    write_block(block, tmp_path / "narx.toml")
    again, fresh = read_block(tmp_path / "narx.toml"), machine(9, samples=200)
    assert np.array_equal(simulate(again, fresh)["y"], simulate(block, fresh)["y"])
    found = read_fmu(export_fmu(again, tmp_path / "narx.fmu")).free_run(fresh)["y"]
    assert found == pytest.approx(simulate(block, fresh)["y"], abs=1e-9)


def test_the_same_seed_gives_the_same_block_and_it_has_a_card():
    records = [machine(1, samples=400)]
    options = {"period": PERIOD, "terms": 3, "degree": 2, "lags": (0, 2)}
    one, two = (learn("narx", records, ["u"], ["y"], **options) for _ in range(2))
    assert all(np.array_equal(one.arrays[k], two.arrays[k]) for k in one.arrays)
    card = one.provenance["free_run"]
    assert card["outputs"]["y"]["rmse"] > 0 and "ARX" in card["outputs"]["y"]["yardsticks"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"period": 0.0}, "period must be positive"),
        ({"degree": 4}, r"degree is 3 at most \(got 4\)"),
        ({"degree": 0}, "degree must be a whole number from 1 up"),
        ({"lags": (1,)}, "past increments, and samples of every input"),
        ({"terms": 0}, "terms must be a whole number from 1 up"),
        ({"delay": -1}, "delay must be a whole number from 0 up"),
        ({"tolerance": -0.1}, "tolerance must be 0 or more"),
    ],
)
def test_impossible_options_are_refused(options, says):
    with pytest.raises(DeclarationError, match=says):
        learn_narx([machine(1, samples=200)], ["u"], ["y"], **options)


def test_too_little_is_refused_with_the_number():
    with pytest.raises(DataError, match="too few samples"):
        learn_narx([machine(1).window(3.0, 5.0)], ["u"], ["y"])
