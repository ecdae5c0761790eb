"""Products of features, the terms of a polynomial NARX, and polynomials of them as formulas of `symbolic.block`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement

import numpy as np

from ..network.narx import NarxShape
from ..symbolic.block import ADD, CONSTANT, MULTIPLY, VARIABLE, Formula

Term = tuple[int, ...]  # features that are multiplied, in rising order; () is the constant
MOST = 500  # terms to select from: beyond it, late input samples stand alone, not in products


def candidates(shape: NarxShape, delays: Sequence[int], degree: int) -> list[Term]:
    """All products of up to ``degree`` features; of each input those from ``delays`` (nu,) samples ago on.

    Where they would be more than `MOST`, the latest input samples are left out of products, as many as it takes.
    """
    fed = range(shape.fed_back)
    late = [shape.fed_back + lag * shape.inputs + i for lag in range(shape.input_lags)
            for i in range(shape.inputs) if lag >= delays[i]]  # fmt: skip
    core = [*fed, *late]
    while _count(len(core), degree) > MOST and len(core) > len(fed) + shape.inputs:
        core.pop()
    products = [t for n in range(2, degree + 1) for t in combinations_with_replacement(core, n)]
    return [(), *((i,) for i in [*fed, *late]), *products]


def _count(features: int, degree: int) -> int:
    from math import comb

    return comb(features + degree, degree)


def values(terms: Sequence[Term], z: np.ndarray) -> np.ndarray:
    """The terms (n, len(terms)) at features z (n, nf)."""
    answer = np.ones((len(z), len(terms)), order="F")
    for j, term in enumerate(terms):
        for i in term:
            answer[:, j] *= z[:, i]
    return answer


def polynomial(terms: Sequence[Term], factors: Sequence[float]) -> Formula:
    """The sum of ``factors`` times terms, as a formula."""
    tokens: list[int] = [ADD] * (len(terms) - 1)
    for term in terms:
        tokens += [MULTIPLY, CONSTANT] if term else [CONSTANT]
        tokens += [t for k, i in enumerate(term) for t in ([MULTIPLY, VARIABLE + i] if k < len(term) - 1
                                                           else [VARIABLE + i])]  # fmt: skip
    return Formula(tuple(tokens), tuple(float(f) for f in factors))


def factors_of(formula: Formula, features: int) -> list[dict[Term, float]]:
    """For every expression of a formula that is a polynomial, the factor of each of its terms."""
    import sympy

    from ..symbolic.text import as_expressions

    symbols = sympy.symbols(f"z:{features}", real=True)
    answer = []
    for expression in as_expressions(formula, symbols):
        found = sympy.Poly(expression, *symbols).as_dict()
        answer.append(
            {
                tuple(i for i, power in enumerate(powers) for _ in range(power)): float(factor)
                for powers, factor in found.items()
            }
        )
    return answer


def words(term: Term, names: Mapping[int, str]) -> str:
    """A term to read, as ``level[k]^2 pump[k-3]``."""
    if not term:
        return "1"
    powers = {i: term.count(i) for i in term}
    return " ".join(names[i] + (f"^{n}" if n > 1 else "") for i, n in powers.items())


def feature_names(shape: NarxShape, inputs: Sequence[str], outputs: Sequence[str]) -> dict[int, str]:
    """What every feature is: an output, an increment d, an input, each with its sample."""
    names = [f"{name}[k]" for name in outputs]
    names += [f"d_{name}[{'k' if lag == 0 else f'k-{lag}'}]" for lag in range(shape.output_lags) for name in outputs]
    names += [f"{name}[{'k' if lag == 0 else f'k-{lag}'}]" for lag in range(shape.input_lags) for name in inputs]
    return dict(enumerate(names))
