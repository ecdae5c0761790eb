"""Whether the equations of a model determine what they shall: with numbers, once it is flat.

What has a solution on paper may have none, or many, at the values it is given: a loop of signals with gain one, a mass
of zero. Then something is divided by nothing, and what comes out is no answer.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from .errors import TopologyError
from .flat import FlatModel
from .flattening import Solved, replace
from .solving import LinearBlock, NonlinearBlock

POINTS = 5  # the declared start and points around it, up to one nominal value away
OTHER = 0.3  # by how much parameters are moved to see how large a divisor usually is
BITS = 12  # a small divisor with so few significant bits wherever one looks is what rounding left of nothing
SMALL = 1e-9  # what is small there
ZERO = 1e-10  # of its usual size: a divisor is nothing
LARGEST_LAST_STEP = 1e-8  # of nominal, of Newton's iteration at the start
TRIES = 6  # other first guesses of a nonlinear loop
STEPS = 20  # of Newton's iteration from each


def check_solvable(solved: Solved, flat: FlatModel) -> None:
    """Refuse loops that have no solution, or more than one that nothing tells apart.

    Raises
    ------
    TopologyError : names the unknowns, the equations with their lines, and what to do.
    """
    _check_linear(solved, flat)
    if not solved.nonlinear:
        return
    x = flat.start_given()([i.default for i in flat.inputs], flat.parameter_vector(), []).full().ravel()
    for block in solved.nonlinear:
        _check_newton(solved, flat, x, block)
        _check_unique(solved, flat, x, block)


def loops_of(solved: Solved) -> tuple[tuple[str, ca.Function], ...]:
    """What `FlatModel.loops` holds."""
    return tuple((", ".join(b.unknowns), _function(solved, [solved.of(b.solved)])) for b in solved.nonlinear)


def _function(solved: Solved, ends: list[ca.SX], *more: ca.SX) -> ca.Function:
    """Expressions of a block as a function of ``(t, x, u, p)``, and of ``more``."""
    e = solved.elaboration
    independent = [q for q in e.parameters if q.symbol.element_hash() not in solved.bindings]
    groups = [ca.SX(ca.vertcat(*(s.symbol for s in group))) for group in (e.states, e.inputs, independent)]
    return ca.Function("block", [e.time, *groups, *more], ends)


def _check_linear(solved: Solved, flat: FlatModel) -> None:
    blocks = [(block, pivot) for block in solved.linear for pivot in block.pivots]
    if not blocks:
        return
    pivots = _function(solved, [solved.of(ca.vertcat(*(pivot for _, pivot in blocks)))])
    draw, p = np.random.default_rng(0), flat.parameter_vector()
    starts = [s.declaration.start for s in solved.elaboration.states]
    start = np.array([0.0 if callable(value) else value for value in starts])
    x_size, u_size = (np.array([s.nominal for s in some]) for some in (flat.states, flat.inputs))
    u_rest = np.array([i.default for i in flat.inputs])
    p_size = np.where(p == 0, [q.nominal for q in flat.parameters], np.abs(p))
    here, usual = [], []
    for k in range(POINTS):
        x = start + (k > 0) * x_size * draw.uniform(-1, 1, len(start))
        u = u_rest + (k > 0) * u_size * draw.uniform(-1, 1, len(u_rest))
        other = p + OTHER * p_size * draw.uniform(-1, 1, len(p))
        here.append(np.abs(pivots(0, x, u, p).full().ravel()))
        usual.append(np.abs(pivots(0, x, u, other).full().ravel()))
    here, usual = np.array(here), np.array(usual)
    never = _is_rounding(usual).all(axis=0)
    singular = (here <= ZERO * np.nanmax(usual, axis=0, initial=0.0)).all(axis=0) | never
    for (block, _), is_nothing, always in zip(blocks, singular, never, strict=True):
        if is_nothing:
            raise TopologyError(_singular(flat, block, always))


def _is_rounding(values: np.ndarray) -> np.ndarray:
    """Zero, or so small and with so few bits as only the difference of two equal numbers has."""
    mantissa, _ = np.frexp(values)
    return (np.ldexp(mantissa, BITS) % 1 == 0) & (values < SMALL)


def _singular(flat: FlatModel, block: LinearBlock, always: bool) -> str:
    when = "whatever the values" if always else "at the parameter values given"
    return (
        f"{flat.name}: the equations for {', '.join(block.unknowns)} are singular {when}, they have no unique "
        f"solution: {block.describe()}. A loop that gives back what it takes, or a mass, an area or a gain of zero, is "
        "the usual cause. Put a lag, a mass or a volume into the loop, or correct the value."
    )


def _check_newton(solved: Solved, flat: FlatModel, x: np.ndarray, block: NonlinearBlock) -> None:
    """Nonlinear loops must converge at the start values, or the model is refused by name."""
    check = _function(solved, [solved.of(block.error)])
    error = float(check(0, x, [i.default for i in flat.inputs], flat.parameter_vector()))
    if not error < LARGEST_LAST_STEP:
        raise TopologyError(
            f"{flat.name}: the nonlinear loop of {', '.join(block.unknowns)} does not converge at the start "
            f"values (last Newton step {error:g} of nominal). Give its variables a better start, or break it "
            "with a small volume, an inertia or a lag."
        )


def _check_unique(solved: Solved, flat: FlatModel, x: np.ndarray, block: NonlinearBlock) -> None:
    """From other first guesses no solution may be found around which others lie as close as one likes."""
    own = {s.element_hash() for s in ca.vertsplit(block.symbols)}
    known: Mapping[int, ca.SX] = {key: e for key, e in solved.expressions.items() if key not in own}
    ends = [replace(replace(e, known), solved.bindings) for e in (block.residual, block.jacobian)]
    both = _function(solved, [*ends, solved.of(block.symbols)], block.symbols)
    at = (0, x, [i.default for i in flat.inputs], flat.parameter_vector())
    sizes, draw = np.array(block.nominals), np.random.default_rng(0)
    found = both(*at, np.zeros(len(sizes)))[2].full().ravel()
    for _ in range(TRIES):
        z = found + sizes * draw.uniform(-1, 1, len(sizes))
        for _ in range(STEPS):
            r, j = (v.full() for v in both(*at, z)[:2])
            if not (np.isfinite(r).all() and np.isfinite(j).all()):
                break
            rows = np.maximum(np.abs(j * sizes).max(axis=1, keepdims=True), 1e-300)
            scaled, left = j * sizes / rows, r / rows
            if np.abs(left).max() < LARGEST_LAST_STEP:
                if np.linalg.svd(scaled, compute_uv=False).min() < ZERO:
                    raise TopologyError(_many(flat, block))
                break
            z = z - sizes * np.linalg.lstsq(scaled, left.ravel(), rcond=None)[0]


def _many(flat: FlatModel, block: NonlinearBlock) -> str:
    return (
        f"{flat.name}: the nonlinear loop of {', '.join(block.unknowns)} is singular: it has solutions without number "
        f"at the start values. It is made of: {block.describe()}. Put a lag, a mass or a volume into it, or say what "
        "else determines it."
    )
