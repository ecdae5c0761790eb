"""Solving one block of equations symbolically: elimination when it is linear, unrolled Newton when it is small.

A block is a set of equations that determine the same set of unknowns together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from .errors import TopologyError
from .jumps import jumps

NEWTON_STEPS = 12
LARGEST_NONLINEAR_BLOCK = 4
UNSOLVED = 1e-3  # last of the steps, over the nominal value or the unknown's size: from here on there is no solution
ROUNDING = 1e-8  # of nominal: a last step that is none
AWAY = 1.0, -1.0, 10.0, -10.0, 0.1, -0.1  # nominal values from the start: where Newton's iteration may begin instead
PARTS = 1.0, 0.5, 0.25, 0.125  # of a step that would end where nothing is a number
GOLDEN = 0.6180339887498949  # its multiples differ from each other, and so do differences of them


@dataclass(frozen=True, eq=False)
class Unknown:
    """A symbol to be solved for, with the scale and first guess that a Newton solve needs."""

    path: str
    symbol: ca.SX
    nominal: float = 1.0
    start: float | ca.SX = 0.0


@dataclass(frozen=True, eq=False)
class NonlinearBlock:
    """What a Newton solve left behind, so that its convergence can be checked with numbers.

    residual, jacobian : of the unknowns ``symbols`` and everything they depend on.
    """

    unknowns: tuple[str, ...]
    error: ca.SX  # last Newton step over the nominal values
    solved: ca.SX  # 1 where the steps ended at a solution; elsewhere the unknowns are NaN
    symbols: ca.SX
    nominals: tuple[float, ...]
    residual: ca.SX
    jacobian: ca.SX
    describe: Callable[[], str]


@dataclass(frozen=True, eq=False)
class LinearBlock:
    """What an elimination divided by: where one of its pivots is zero the equations have no unique solution."""

    unknowns: tuple[str, ...]
    pivots: tuple[ca.SX, ...]
    describe: Callable[[], str]


def solve_block(
    model: str,
    unknowns: Sequence[Unknown],
    residuals: Sequence[ca.SX],
    describe: Callable[[], str],
    values: Mapping[int, float] | None = None,
) -> tuple[list[ca.SX], NonlinearBlock | LinearBlock | None]:
    """Expressions for ``unknowns`` that make all ``residuals`` zero, and what is to be checked with numbers, if any.

    values : numbers of known symbols by hash, at which nothing may be divided by zero.

    Raises
    ------
    TopologyError : the block is singular, or nonlinear and too large; the unknowns are named.
    """
    symbols = ca.vertcat(*(u.symbol for u in unknowns))
    residual = ca.vertcat(*residuals)
    jacobian = ca.simplify(ca.jacobian(residual, symbols))
    if not (ca.depends_on(jacobian, symbols) or jumps(residual, symbols)):
        offset = ca.substitute(residual, symbols, ca.SX.zeros(len(unknowns)))
        solution, pivots = _eliminate(model, unknowns, jacobian, -offset, describe, values)
        names = tuple(u.path for u in unknowns)
        return solution, LinearBlock(names, pivots, describe) if pivots else None
    left, residuals, explicit = (
        _torn(unknowns, residuals) if len(unknowns) > LARGEST_NONLINEAR_BLOCK else (unknowns, residuals, [])
    )
    if len(left) > LARGEST_NONLINEAR_BLOCK:
        names = ", ".join(u.path for u in left)
        raise TopologyError(
            f"{model}: a nonlinear loop ties {names} (got {len(left)} unknowns; at most {LARGEST_NONLINEAR_BLOCK} "
            f"are solved). It is made of: {describe()}. Break it with a small volume, an inertia or a lag."
        )
    torn = ca.vertcat(*(u.symbol for u in left))
    solution, record = _newton(model, left, ca.vertcat(*residuals), torn, describe, values or {})
    found = dict(zip((u.path for u in left), solution, strict=True))
    for unknown, value in reversed(explicit):
        known = [u for u in unknowns if u.path in found]
        symbols = [u.symbol for u in known]
        (found[unknown.path],) = ca.substitute([value], symbols, [found[u.path] for u in known])
    return [found[u.path] for u in unknowns], record


def _torn(unknowns: Sequence[Unknown], residuals: Sequence[ca.SX]):
    """Unknowns that an equation gives outright (linear, with a number before them) need no Newton's iteration.

    Gives the unknowns and equations that are left, and the others as expressions, each of those that follow and of
    what is left. Connections, and forces as a function of speed, go this way.
    """
    left, equations, explicit = list(unknowns), list(residuals), []
    while len(left) > 1:
        found = next(((i, u) for i, e in enumerate(equations) for u in left if _is_given(e, u.symbol)), None)
        if found is None:
            break
        i, unknown = found
        equation = equations.pop(i)
        slope = ca.simplify(ca.jacobian(equation, unknown.symbol))
        value = -ca.substitute(equation, unknown.symbol, ca.SX(0)) / slope
        left.remove(unknown)
        explicit.append((unknown, value))
        equations = [ca.substitute(e, unknown.symbol, value) for e in equations]
    return left, equations, explicit


def _is_given(equation: ca.SX, symbol: ca.SX) -> bool:
    slope = ca.simplify(ca.jacobian(equation, symbol))
    return slope.is_constant() and not slope.is_zero() and not jumps(equation, symbol)


def _eliminate(model, unknowns, matrix: ca.SX, right: ca.SX, describe, values=None):
    """Gaussian elimination on expressions; constant pivots first, so that nothing is divided without need.

    Gives the solution and the pivots that are no constants.
    """
    n = len(unknowns)
    a = [[matrix[i, j] for j in range(n)] for i in range(n)]
    b = [right[i] for i in range(n)]
    rows, order, pivots = list(range(n)), [], []
    columns = set(range(n))
    while rows:
        row, column = _pivot(a, rows, columns, values or {})
        if row is None:
            stuck = ", ".join(unknowns[j].path for j in sorted(columns))
            raise TopologyError(
                f"{model}: the equations for {stuck} are singular: {describe()}. "
                "One of them says the same as another, or a rigid connection leaves one state too many."
            )
        rows.remove(row)
        columns.remove(column)
        order.append((row, column))
        if not (pivot := a[row][column]).is_constant():
            pivots.append(pivot)
        for i in rows:
            if a[i][column].is_zero():
                continue
            factor = a[i][column] / a[row][column]
            for j in columns:
                if not a[row][j].is_zero():
                    a[i][j] = ca.simplify(a[i][j] - factor * a[row][j])
            b[i] = b[i] - factor * b[row]
            a[i][column] = ca.SX(0)
    solution: list[ca.SX] = [ca.SX(0)] * n
    for row, column in reversed(order):
        known = sum((a[row][j] * solution[j] for j in range(n) if j != column and not a[row][j].is_zero()), ca.SX(0))
        solution[column] = (b[row] - known) / a[row][column]
    return solution, tuple(pivots)


def _pivot(a, rows, columns, values):
    """The entry to divide by: a number before an expression, one that stays off zero, then the one that fills least.

    A compliance is zero until it is looked for: what is a number times it must not be divided by.
    """
    fills = {}
    for i in rows:
        filled = [j for j in columns if not a[i][j].is_zero()]
        for j in filled:
            fills[i, j] = (len(filled) - 1) * (sum(not a[k][j].is_zero() for k in rows) - 1)
    numbers = {entry: fill for entry, fill in fills.items() if a[entry[0]][entry[1]].is_constant()}
    if numbers or not fills:
        return min(numbers, key=numbers.__getitem__, default=(None, None))
    zeros = _zeros([a[i][j] for i, j in fills], values)
    return min(zip(fills, zeros, fills.values(), strict=True), key=lambda row: row[1:])[0]


def _zeros(entries: Sequence[ca.SX], values: Mapping[int, float]) -> list[int]:
    """At how many of two points every entry is zero or no number; what has no value is zero at one of them."""
    together = ca.vertcat(*entries)
    symbols = ca.symvar(together)
    evaluate = ca.Function("entries", [ca.vertcat(*symbols)], [together])
    anywhere = 1.0 + np.modf(np.arange(1, len(symbols) + 1) * GOLDEN)[0]
    points = [[values.get(s.element_hash(), 0.0) for s in symbols]]
    points.append([values.get(s.element_hash(), x) for s, x in zip(symbols, anywhere, strict=True)])
    found = np.array([evaluate(p) for p in points]).reshape(len(points), -1)
    return ((found == 0) | ~np.isfinite(found)).sum(axis=0).tolist()


def _newton(model, unknowns, residual, symbols, describe, values):
    """Newton's iteration written out; exact derivatives follow from differentiating it.

    Where its steps do not end, or end where the slope is no number though something is left (a square root at zero),
    the equations have lost their solution and the unknowns are NaN: every run stops there. The last step is held
    against the nominal value, or against the size of start and end where that is less.
    """
    matrix = ca.jacobian(residual, symbols)
    sought = {s.element_hash() for s in ca.vertsplit(symbols)}
    given = [s for s in ca.symvar(residual) if s.element_hash() not in sought]
    evaluate = ca.Function("residual", [symbols, ca.vertcat(ca.SX(0, 1), *given)], [residual, matrix])
    given = ca.vertcat(ca.SX(0, 1), *given)
    z, guarded = _first_guess(unknowns, evaluate, given, values)
    update, start = ca.SX.zeros(len(unknowns)), ca.fabs(z)
    for _ in range(NEWTON_STEPS):
        r, j = evaluate(z, given)
        try:
            update = ca.vertcat(*_eliminate(model, unknowns, ca.SX(j), ca.SX(r), describe)[0])
        except TopologyError:
            names = ", ".join(u.path for u in unknowns)
            raise TopologyError(
                f"{model}: the nonlinear loop of {names} cannot be solved from its start values: nothing changes with "
                f"them there. It is made of: {describe()}. Give its variables another start."
            ) from None
        finite, ends = _is_finite(j), _is_zero(r)
        if guarded:
            stays = ca.logic_and(ends, ca.logic_not(finite))  # elsewhere a step of zero still has its derivatives
            update = ca.if_else(stays, 0, _shortened(evaluate, z, update, given))
        z = z - update
    nominal = ca.DM([u.nominal for u in unknowns])
    names, sizes = tuple(u.path for u in unknowns), tuple(u.nominal for u in unknowns)
    error = ca.norm_inf(update / nominal)
    ended = ca.fabs(update) < UNSOLVED * ca.fmin(nominal, start + ca.fabs(z)) + ROUNDING * nominal
    regular = ca.logic_or(ends, finite)  # a step over an infinite slope is none
    solved, error = ca.logic_and(regular, _all(ended)), ca.if_else(regular, error, np.inf)
    record = NonlinearBlock(names, error, solved, symbols, sizes, residual, matrix, describe)
    known = ca.if_else(solved, 1, np.nan)  # as a factor, so that derivatives are NaN with it
    return [value * known for value in ca.vertsplit(z)], record


def _first_guess(unknowns, evaluate: ca.Function, given: ca.SX, values: Mapping[int, float]):
    """Where Newton's iteration begins, and whether it can come to where a residual or a slope is no number.

    A root of zero has no slope there, and a step over an infinite slope goes nowhere: where the start is such a place
    and no solution, it begins about a nominal value away, every unknown elsewhere, for roots of differences.
    """
    z = ca.vertcat(*(ca.SX(u.start) for u in unknowns))
    nominal = np.array([u.nominal for u in unknowns])
    symbols = ca.symvar(ca.veccat(given, z))
    numbers = ca.Function("start", [ca.vertcat(ca.SX(0, 1), *symbols)], [given, z])
    anywhere = 1.0 + np.modf(np.arange(1, len(symbols) + 1) * GOLDEN)[0]
    points = [
        [values.get(s.element_hash(), other * x) for s, x in zip(symbols, anywhere, strict=True)] for other in (0, 1)
    ]
    known = [numbers(point) for point in points]

    def lacking(away: np.ndarray) -> int:
        """At how many points there is no number."""
        found = [[v.full() for v in evaluate(at + away, others)] for others, at in known]
        return sum(not all(np.isfinite(v).all() for v in both) for both in found)

    falling = nominal / (1 + np.arange(len(nominal)))
    rising = nominal / (1 + np.arange(len(nominal)))[::-1]
    tries = [0 * nominal, *(away * order for away in AWAY for order in (falling, rising))]
    missing = [lacking(away) for away in tries]
    best = int(np.argmin(missing))  # the first of equals
    moved = ca.if_else(_is_zero(evaluate(z, given)[0]), z, z + ca.DM(tries[best])) if best else z
    return moved, any(missing)


def _shortened(evaluate: ca.Function, z: ca.SX, update: ca.SX, given: ca.SX) -> ca.SX:
    """The longest part of a step that ends where residual and slope are numbers, or at a solution."""
    part = ca.SX(PARTS[-1])
    for shorter in reversed(PARTS[:-1]):
        part = ca.if_else(_has_numbers(evaluate, z - shorter * update, given), shorter, part)
    return part * update


def _has_numbers(evaluate: ca.Function, z: ca.SX, given: ca.SX) -> ca.SX:
    """Whether residual and slope are numbers there, or it is a solution."""
    r, j = evaluate(z, given)
    return ca.logic_or(_is_zero(r), ca.logic_and(_is_finite(r), _is_finite(j)))


def _is_zero(r: ca.SX) -> ca.SX:
    return _all(ca.SX(r) == 0)


def _is_finite(v: ca.SX) -> ca.SX:
    return _all(ca.fabs(ca.SX(v)) < np.finfo(float).max)


def _all(conditions: ca.SX) -> ca.SX:
    found = ca.SX(1)
    for one in ca.vertsplit(ca.vec(ca.densify(conditions))):
        found = ca.logic_and(found, one)
    return found
