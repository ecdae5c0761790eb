"""Many columns at once by NumPy are what CasADi answers column by column."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.simulation import columns
from hydrotwin.simulation.columns import OPERATIONS, by_columns


@pytest.mark.parametrize("name", ["cehA", "spool_valve"])
def test_rates_and_outputs_of_a_machine_are_the_same(name):
    flat, random = ht.load(name).flat, np.random.default_rng(0)
    n = 200
    x = random.normal(size=(len(flat.states), n)) * np.array([[s.nominal] for s in flat.states])
    u = random.normal(size=(len(flat.inputs), n)) * np.array([[s.nominal] for s in flat.inputs])
    arguments = random.uniform(0.0, 1.0, (1, n)), x, u, flat.parameter_vector({})
    for own, known in zip(by_columns(flat.ode)(*arguments), flat.ode(*arguments), strict=True):
        assert own == pytest.approx(known.full(), rel=1e-12, abs=1e-12, nan_ok=True)


ONE = [
    ca.OP_ASSIGN,
    ca.OP_NEG,
    ca.OP_INV,
    ca.OP_SQ,
    ca.OP_TWICE,
    ca.OP_SQRT,
    ca.OP_EXP,
    ca.OP_LOG,
    ca.OP_SIN,
    ca.OP_COS,
]
ONE += [ca.OP_TAN, ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN, ca.OP_SINH, ca.OP_COSH, ca.OP_TANH, ca.OP_FABS, ca.OP_SIGN]
ONE += [ca.OP_FLOOR, ca.OP_CEIL, ca.OP_NOT]
TWO = sorted({*OPERATIONS} - {*ONE})


@pytest.mark.parametrize("operation", [*ONE, *TWO])
def test_every_operation_is_casadis(operation):
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    value = ca.SX.unary(operation, a) if operation in ONE else ca.SX.binary(operation, a, b)
    function = ca.Function("one", [a, b], [value])
    some = np.array([-2.5, -1.0, -0.3, 0.0, 0.3, 1.0, 2.5])
    pair = np.array([(p, q) for p in some for q in some]).T
    (own,), known = by_columns(function)(*pair[:, None, :]), function(*pair[:, None, :]).full()
    assert own == pytest.approx(known, rel=1e-14, nan_ok=True)


def test_values_that_are_always_zero_and_values_of_parameters_alone_have_their_places():
    x, p = ca.SX.sym("x"), ca.SX.sym("p", 2)
    value = ca.SX(4, 1)
    value[1], value[3] = x * p[0], p[1] + 1.0
    (own,) = by_columns(ca.Function("some", [x, p], [value]))(np.array([[1.0, 2.0]]), np.array([3.0, 4.0]))
    assert own.tolist() == [[0.0, 0.0], [3.0, 6.0], [0.0, 0.0], [5.0, 5.0]]


def test_what_numpy_has_no_operation_for_is_left_to_casadi(monkeypatch):
    x = ca.SX.sym("x")
    function, n = ca.Function("bell", [x], [ca.erf(x)]), 5
    asked = []
    real = columns._by_casadi
    monkeypatch.setattr(columns, "_by_casadi", lambda *a: asked.append(a) or real(*a))
    (own,) = by_columns(function)(np.linspace(-1, 1, n)[None, :])
    assert len(asked) == 1 and own == pytest.approx(function(np.linspace(-1, 1, n)[None, :]).full())


def test_no_value_is_no_row():
    x = ca.SX.sym("x")
    (own,) = by_columns(ca.Function("none", [x], [ca.SX(0, 1)]))(np.zeros((1, 3)))
    assert own.shape == (0, 3)


def test_a_function_of_matrices_is_left_to_casadi_and_one_column_may_be_a_vector():
    m, x = ca.MX.sym("m", 2), np.array([[0.1, 0.2, 0.3], [1.0, 2.0, 3.0]])
    assert by_columns(ca.Function("wave", [m], [ca.sin(m)]))(x)[0] == pytest.approx(np.sin(x))
    s = ca.SX.sym("s", 2)
    (own,) = by_columns(ca.Function("wave", [s], [ca.sin(s)]))(x[:, 0])
    assert own[:, 0] == pytest.approx(np.sin(x[:, 0]))
