"""Terms that a formula lacks, found by what they take from the error of its free run."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned.symbolic.block import ADD, CONSTANT, MULTIPLY, SQUARE, TANH, VARIABLE, Formula
from hydrotwin.learned.symbolic.data import prepare
from hydrotwin.learned.symbolic.growth import Term, most_telling, terms_for, with_terms
from hydrotwin.learned.symbolic.select import Choice, Selection
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

PERIOD, SAMPLES = 0.1, 1500
U, Y = Signal("u", "V"), Signal("y", "m")
LEVEL, COMMAND = VARIABLE, VARIABLE + 2  # y[k], d[k-1], u[k], u[k-1]
ALL = ("add", "mul", "square", "tanh")


def machine(seed: int, noise: float = 2e-3) -> Record:
    """An output that settles, with a gain that falls with it: y' = -0.3 y + (1 - 0.5 y) u, read with noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, SAMPLES // 10), 10)
    y = np.zeros(SAMPLES)
    for k in range(SAMPLES - 1):
        y[k + 1] = y[k] + PERIOD * (-0.3 * y[k] + (1 - 0.5 * y[k]) * u[k])
    measured = y + noise * rng.normal(size=SAMPLES)
    return Record(PERIOD * np.arange(SAMPLES), {"u": u, "y": measured}, {"u": "V", "y": "m"}, f"run {seed}")


@pytest.fixture(scope="module")
def data():
    return prepare([machine(1), machine(2)], [], (U,), (Y,), PERIOD, (1, 2), False)


@pytest.fixture(scope="module")
def linear(data):
    """The increment from the level and the command alone, its constants fitted in free run."""
    tokens = (ADD, ADD, CONSTANT, MULTIPLY, CONSTANT, LEVEL, MULTIPLY, CONSTANT, COMMAND)
    first = Formula(tokens, (0.0, -0.1, 0.5))
    return data.run(first, [0]).refit(data.laid_out(data.fit, [0]), 30)


def rms(data, formula) -> float:
    return data.run(formula, [0]).errors(formula.constants, data.laid_out(data.fit, [0]))[1]


def test_the_term_that_is_missing_takes_most_of_the_error(data, linear):
    found = most_telling(data, linear, 0, terms_for(data, 0, ALL), 3)
    assert found[0][0].tokens == (MULTIPLY, LEVEL, COMMAND) and found[0][1] > 0.8
    assert [gain for _, gain in found] == sorted((gain for _, gain in found), reverse=True)


def test_what_the_constants_can_do_and_what_another_term_does_is_no_term_to_try(data, linear):
    twice = [Term((MULTIPLY, LEVEL, COMMAND)), Term((MULTIPLY, COMMAND, LEVEL)), Term((COMMAND,)), Term((LEVEL,))]
    found = most_telling(data, linear, 0, twice, 4)
    assert [term for term, gain in found if gain > 1e-6] == twice[:1]


def test_a_gain_is_what_a_refit_with_the_term_takes(data, linear):
    ((term, gain),) = most_telling(data, linear, 0, [Term((MULTIPLY, LEVEL, COMMAND))], 1)
    grown = with_terms(linear, [term])
    assert rms(data, grown) == pytest.approx(rms(data, linear), rel=1e-9), "with the factor 0 it runs as before"
    after = rms(data, data.run(grown, [0]).refit(data.laid_out(data.fit, [0]), 30))
    assert 1 - (after / rms(data, linear)) ** 2 == pytest.approx(gain, abs=0.1)


def test_terms_are_made_of_the_functions_that_are_allowed(data):
    tokens = {t for term in terms_for(data, 0, ()) for t in term.tokens}
    assert tokens == {VARIABLE + j for j in range(4)}
    assert {t for term in terms_for(data, 0, ("tanh",)) for t in term.tokens if t < VARIABLE} == {
        TANH,
        MULTIPLY,
        CONSTANT,
    }
    squares = [term for term in terms_for(data, 0, ("mul",)) if term.tokens == (MULTIPLY, LEVEL, LEVEL)]
    assert squares and all(SQUARE not in term.tokens for term in terms_for(data, 0, ("mul",)))


@pytest.mark.parametrize("terms", [0, 4])
def test_a_formula_grows_by_terms_that_surely_help_and_by_no_more_than_it_may(data, linear, terms):
    selection = Selection(data, ["y"], Choice(0.05, terms, ALL))
    before = selection._candidate(linear, 0, brief=False)
    grown = selection._grown([before], 0)[1:]
    assert (len(grown) == 0) if terms == 0 else (0 < len(grown) <= terms)
    if grown:
        assert grown[0].error < 0.3 * before.error
        assert all(b.error < a.error for a, b in zip([before, *grown], grown, strict=False))
        assert selection._grown([grown[-1]], 0)[1:] == [] or len(grown) == terms, "it ended where nothing helps"
