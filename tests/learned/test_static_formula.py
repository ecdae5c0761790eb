"""Formulas of data without dynamics: recognised, found, printed, certified, kept and exported."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import learn_symbolic, read_block, write_block
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.symbolic.block import (
    ABSOLUTE,
    ADD,
    CONSTANT,
    DIVIDE,
    EXP,
    LOG,
    MULTIPLY,
    SQRT,
    SQUARE,
    TINY,
    VARIABLE,
    Formula,
    evaluate,
)
from hydrotwin.learned.symbolic.data import prepare_static
from hydrotwin.learned.symbolic.refit import StaticRun
from hydrotwin.learned.symbolic.static_block import STATIC
from hydrotwin.learned.symbolic.static_data import is_static
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests.learned.toy_machine import ANGLE, COMMAND, toy_record

FLOW, OPENING, PRESSURE = Signal("flow", "m3/s"), Signal("opening", "1"), Signal("pressure", "Pa")
UNITS = {s.name: s.unit for s in (FLOW, OPENING, PRESSURE)}
QUICK = {"starts": 1, "generations": 30, "population": 150}
LAW = Formula((MULTIPLY, CONSTANT, MULTIPLY, VARIABLE, SQRT, VARIABLE + 1), (0.8,))


def orifice(seed: int, count: int = 300, name: str = "orifice") -> Record:
    """Flow through an orifice, opening and pressure drop drawn at random: no dynamics."""
    rng = np.random.default_rng(seed)
    opening, pressure = rng.uniform(0.1, 1.0, count), rng.uniform(1e6, 2e7, count)
    return Record(np.arange(count) * 1.0, {"opening": opening, "pressure": pressure,
                                           "flow": 2.5e-7 * opening * np.sqrt(pressure)}, UNITS, name)  # fmt: skip


def static_block(formula: Formula = LAW):
    arrays = {"tokens": np.array(formula.tokens, float), "constants": np.array(formula.constants)}
    arrays |= {"input_centre": [0.1, 0.0], "input_scale": [1.0, 2.0], "output_centre": [0.5], "output_scale": [3.0]}
    return assemble(
        STATIC, arrays, {"tokens": len(formula.tokens), "constants": len(formula.constants)}, name="law",
        inputs=(OPENING, PRESSURE), outputs=(FLOW,), states=(), parameters=(), period=1.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def learned():
    pytest.importorskip("pyoperon")
    return learn_symbolic([orifice(0)], ["opening", "pressure"], ["flow"], functions=("mul", "sqrt", "add"), **QUICK)


def test_the_output_is_the_written_formula():
    block = static_block()
    for opening, pressure in np.random.default_rng(0).uniform(0, 5, (20, 2)):
        after, now = block.step([], [opening, pressure], [])
        assert float(now) == pytest.approx(0.5 + 3 * 0.8 * (opening - 0.1) * np.sqrt(pressure / 2), rel=1e-14)
        assert after.numel() == 0


def test_every_function_has_a_value_and_a_slope_for_every_number():
    tokens = {
        DIVIDE: (DIVIDE, CONSTANT, VARIABLE),
        EXP: (EXP, MULTIPLY, CONSTANT, VARIABLE),
        LOG: (LOG, MULTIPLY, CONSTANT, VARIABLE),
        SQRT: (SQRT, MULTIPLY, CONSTANT, VARIABLE),
        SQUARE: (SQUARE, MULTIPLY, CONSTANT, VARIABLE),
        ABSOLUTE: (ABSOLUTE, MULTIPLY, CONSTANT, VARIABLE),
    }
    plain = {
        DIVIDE: lambda x: 2 / x,
        EXP: lambda x: np.exp(2 * x),
        LOG: lambda x: np.log(abs(2 * x)),
        SQRT: lambda x: np.sqrt(abs(2 * x)),
        SQUARE: lambda x: 4 * x * x,
        ABSOLUTE: lambda x: abs(2 * x),
    }
    data = prepare_static([orifice(0)], [], (OPENING, PRESSURE), (FLOW,))
    runs = data.laid_out(data.fit, [0])
    runs.known[0, :5, 0] = -3.0, -0.5, 0.0, 0.7, 1e9
    for token, whole in tokens.items():
        run = StaticRun(Formula(whole, (2.0,)), 2)
        found = run.outputs([2.0], runs)[0, :5, 0]
        assert np.isfinite(found).all() and np.isfinite(run.derivatives([2.0], runs)).all()
        for x, value in zip((-3.0, -0.5, 0.7), found[[0, 1, 3]], strict=True):
            assert value == pytest.approx(plain[token](x), rel=1e-12)
            assert evaluate(whole, [2.0], [x])[0] == pytest.approx(value, rel=1e-14)
    assert evaluate(tokens[LOG], [0.0], [1.0])[0] == np.log(TINY)


def test_the_slopes_of_the_constants_agree_with_differences():
    data = prepare_static([orifice(0)], [], (OPENING, PRESSURE), (FLOW,))
    formula = Formula((ADD, CONSTANT, DIVIDE, CONSTANT, ADD, CONSTANT, VARIABLE), (0.3, 1.2, 0.8))
    run, runs, c = StaticRun(formula, 2), data.laid_out(data.fit, [0]), np.array(formula.constants)
    slopes = run.derivatives(c, runs)
    for k, h in enumerate(1e-6 * np.eye(3)):
        assert np.allclose(slopes[..., k], (run.outputs(c + h, runs) - run.outputs(c - h, runs)) / 2e-6, rtol=1e-6)


def test_samples_in_no_order_are_found_to_be_static_and_a_machine_is_not():
    assert is_static([orifice(0)], (OPENING, PRESSURE), (FLOW,))
    assert not is_static([toy_record(1)], (COMMAND,), (ANGLE,))
    assert not is_static([toy_record(1, noise=1e-2)], (COMMAND,), (ANGLE,))


def test_a_law_is_found_exactly(learned):
    unseen = orifice(1)
    apart = simulate(learned, unseen)["flow"] - unseen["flow"]
    assert np.abs(apart).max() < 1e-9 * unseen["flow"].max()
    assert learned.kind == "static_formula" and learned.states == () and learned.certificate.holds
    assert learned.provenance["static"] and learned.provenance["functions"] == ["mul", "sqrt", "add"]
    assert learned.description.startswith("flow = ") and "sqrt(" in learned.description


def test_recordings_that_select_choose_among_static_formulas():
    pytest.importorskip("pyoperon")
    options = {**QUICK, "generations": 5, "static": True}
    block = learn_symbolic([orifice(0)], ["opening", "pressure"], ["flow"], select=[orifice(3, name="more")], **options)
    assert block.provenance["selected_on"][0]["name"] == "more"


def test_a_static_formula_comes_back_from_its_file_and_runs_as_an_fmu(learned, tmp_path):
    again, unseen = read_block(write_block(learned, tmp_path / "law.toml")[0]), orifice(1)
    assert np.array_equal(simulate(again, unseen)["flow"], simulate(learned, unseen)["flow"])
    assert again.provenance["front"] == learned.provenance["front"]
    fmu = read_fmu(export_fmu(learned, tmp_path / "law.fmu"))
    short = unseen.window(None, 20.0)
    assert np.allclose(fmu.free_run(short)["flow"], simulate(learned, short)["flow"], rtol=1e-12, atol=0)


def test_counts_that_are_none_are_refused():
    block = static_block()
    for wrong in ({"tokens": -1}, {"constants": 2.5}, {"lags": 1}):
        with pytest.raises(DataError, match="not the counts of a static_formula"):
            assemble(STATIC, block.arrays, dict(block.structure) | wrong, name="x", inputs=block.inputs,
                     outputs=block.outputs, states=(), parameters=(), period=1.0)  # fmt: skip


@pytest.mark.parametrize("text", ["sqrt(abs(x))**3 + 1/x", "exp(-x/2)*x**5", "log(abs(x))/abs(2*x+1)", "abs(x)**2.3",
                                  "x/(1+exp(-x))**2 - sqrt(abs(cos(x)))", "1/sqrt(abs(x)+1)"])  # fmt: skip
def test_what_sympy_makes_of_a_formula_can_be_written_as_tokens(text):
    sympy = pytest.importorskip("sympy")
    from hydrotwin.learned.symbolic.text import _as_tokens

    x = sympy.Symbol("x", real=True)
    expression = sympy.parse_expr(text, local_dict={"x": x, "abs": sympy.Abs})
    tokens = _as_tokens(expression, {x: VARIABLE})
    for value in (-2.3, -0.4, 0.7, 3.1):
        found = evaluate(tokens.tokens, tokens.constants, [value])[0]
        assert found == pytest.approx(float(expression.subs(x, value)), rel=1e-12)


@pytest.mark.parametrize("lag", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("held", [0.2, 1.0, 4.0])
@pytest.mark.parametrize(
    "law", [lambda u: np.sign(u) * np.sqrt(np.abs(u)), lambda u: np.tanh(30 * u), lambda u: np.sin(9 * u)]
)
def test_a_law_of_any_shape_is_static_where_it_is_right_at_the_first_sample_of_a_hold(law, held, lag):
    random, period = np.random.default_rng(1), 0.01
    u = np.repeat(random.uniform(-1, 1, round(40 / held)), round(held / period))
    y, x, kept = np.zeros(len(u)), law(u[0]), np.exp(-period / lag) if lag else 0.0
    for k in range(len(u)):
        x = kept * x + (1 - kept) * law(u[k])
        y[k] = x
    y += 0.01 * random.normal(size=len(u))
    record = Record(period * np.arange(len(u)), {"u": u, "y": y}, {"u": "V", "y": "m"})
    assert is_static([record], [Signal("u", "V")], [Signal("y", "m")]) == (lag == 0.0)
