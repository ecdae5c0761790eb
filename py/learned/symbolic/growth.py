"""Terms that a formula lacks, found by what they take from the error of its free run.

    y(k; c, a) = run of f(z; c) + sum_j a_j g_j(z)       s_j(k) = dy(k)/da_j at a = 0
    gain of g_j = (s~_j . r)^2 / (|s~_j|^2 |r|^2)         r = measured - run;  s~_j: without what c can do as well

One step ahead the noise of a sensor hides a term by whose sum a long run drifts. In the free run it does not. The gain
is the share of the squared error that the term takes there, to first order, when the constants of f follow it.

Sources: Chen, Billings, Luo, International Journal of Control 50 (1989) 1873-1896 (the ratio, one step ahead); Piroddi,
Spinelli, International Journal of Control 76 (2003) 1767-1781 (terms by what they take from a simulation's error).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .block import ADD, CONSTANT, MULTIPLY, SQUARE, TANH, VARIABLE, Formula
from .data import Prepared
from .refit import Runs, own_features

STEEP = (3.0, 30.0)  # slopes over a signal's scale with which a tanh begins: saturation, and a deadband or a change of
# sign; the refit goes on from there
AT_ONCE = 12  # terms in one run: more states cost more than runs
ALIKE = 0.95  # correlation of the effects of two terms on the run, from which on the second is no other
INDEPENDENT = 1e-6  # of a term's effect on the run: what must be left when the constants do what they can


@dataclass(frozen=True)
class Term:
    """A term in prefix order, without its factor."""

    tokens: tuple[int, ...]
    constants: tuple[float, ...] = ()


def terms_for(data: Prepared, i: int, functions: Sequence[str]) -> list[Term]:
    """What may be added to the increment of output ``i``, of functions that are allowed.

    Of every feature x: x, x^2, tanh(k x), and of every feature y that the output feeds back: x y, x^2 y.
    """
    features, fed = range(data.shape.features), own_features(data.shape, [i])
    found: dict[tuple, Term] = {}
    for j in features:
        x = (VARIABLE + j,)
        square = (SQUARE, *x) if "square" in functions else (MULTIPLY, *x, *x) if "mul" in functions else ()
        made = [Term(x), *([Term(square)] if square else [])]
        if "tanh" in functions:
            made += [Term((TANH, MULTIPLY, CONSTANT, *x), (slope,)) for slope in STEEP]
        if "mul" in functions:
            made += [Term((MULTIPLY, VARIABLE + min(y, j), VARIABLE + max(y, j))) for y in fed if y != j]
            made += [Term((MULTIPLY, VARIABLE + y, *square)) for y in fed if y != j and square]
        found |= {term.tokens + term.constants: term for term in made}
    return list(found.values())


def with_terms(formula: Formula, terms: Sequence[Term]) -> Formula:
    """The formula of one output plus terms, their factors 0."""
    tokens, constants = formula.tokens, formula.constants
    for term in terms:
        tokens = (ADD, *tokens, MULTIPLY, CONSTANT, *term.tokens)
        constants = (*constants, 0.0, *term.constants)
    return Formula(tokens, constants)


def most_telling(data: Prepared, formula: Formula, i: int, terms: Sequence[Term], count: int) -> list[tuple]:
    """Up to ``count`` terms with their gains in the free run of output ``i``, the largest first.

    Of terms that do nearly the same (`ALIKE`), as one at neighbouring lags does, only the first.
    """
    runs, run = data.laid_out(data.fit, [i]), data.run(formula, [i])
    left = (runs.target - run.outputs(formula.constants, runs))[runs.inside].ravel()
    own = run.derivatives(formula.constants, runs)[runs.inside].reshape(len(left), -1)
    basis, _ = np.linalg.qr(_unit(own))
    left = left - basis @ (basis.T @ left)
    slopes = np.hstack([_slopes(data, formula, i, part, runs) for part in _parted(terms)])
    slopes -= basis @ (basis.T @ slopes)
    says = np.isfinite(slopes).all(axis=0) & (np.linalg.norm(np.nan_to_num(slopes), axis=0) > INDEPENDENT)
    slopes = _unit(np.where(says, slopes, 0.0))
    shares = (slopes.T @ left) ** 2 / max(left @ left, 1e-300)
    found: list[int] = []
    for j in np.argsort(-shares, kind="stable"):
        if len(found) == count or not shares[j] > 0:
            break
        if all(abs(slopes[:, j] @ slopes[:, k]) < ALIKE for k in found):
            found.append(int(j))
    return [(terms[j], float(shares[j])) for j in found]


def _slopes(data: Prepared, formula: Formula, i: int, terms: Sequence[Term], runs: Runs) -> np.ndarray:
    """How the run moves with the factor of each term, (samples, n), each over its norm."""
    more = with_terms(formula, terms)
    found = data.run(more, [i]).derivatives(more.constants, runs)[runs.inside].reshape(int(runs.inside.sum()), -1)
    counts = [1 + len(term.constants) for term in terms]
    return _unit(found[:, len(formula.constants) + np.cumsum([0, *counts[:-1]])])


def _parted(terms: Sequence[Term]) -> list[Sequence[Term]]:
    return [terms[k : k + AT_ONCE] for k in range(0, len(terms), AT_ONCE)]


def _unit(columns: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
