"""The formula as a block: its tokens in CasADi, its text, and files that are wrong."""

from __future__ import annotations

import subprocess
import sys

import casadi as ca
import numpy as np
import pytest

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
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.simulation import simulate
from tests.learned.toy_machine import ANGLE, COMMAND, PERIOD, toy_record

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
        ((99,), (), r"token 0 is none \(got 99\)"),
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


def test_a_pure_number_is_printed_without_a_unit_and_a_centre_with_its_own():
    pytest.importorskip("sympy")
    from hydrotwin.learned.symbolic.text import equation_text

    valve, formula = Signal("valve", "1"), Formula((MULTIPLY, CONSTANT, VARIABLE + 1), (0.25,))
    scales = {"input_centre": [0.5], "input_scale": [0.2], "output_centre": [0.0], "output_scale": [0.3]}
    scales |= {"increment_scale": [0.01]}
    text, latex = equation_text(formula, (valve,), (ANGLE,), NarxShape(1, 1, 0, 1, 0), scales)
    assert text == "arm_angle[k+1] = arm_angle[k] + 0.01 rad * (0.25*x1); x1 = (valve[k] - 0.5)/(0.2)"
    assert latex.endswith(r"x_{1} = (\mathrm{valve}[k] - 0.5)/(0.2)")


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


def test_a_formula_runs_without_what_trained_it():
    lines = "import sys, hydrotwin.learned.symbolic.block, hydrotwin.learned.symbolic.learn\n"
    lines += "assert not {'pyoperon', 'sympy', 'torch'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", lines], check=True)
