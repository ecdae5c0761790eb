"""Start values: fixed ones, and those that static equilibrium (the initial equations) determines."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

import casadi as ca
import numpy as np

from .component import given_in_si
from .errors import DeclarationError, TopologyError
from .flattening import Solved, replace
from .solving import LinearBlock, NonlinearBlock, Unknown, solve_block
from .structure import match, ordered_blocks
from .user_code import numbers_refused

LARGEST_LAST_STEP = 1e-6  # of nominal


def initialisation(solved: Solved, u: ca.SX, p: ca.SX, rates: list[ca.SX]) -> Callable[[tuple[str, ...]], ca.Function]:
    """A function that gives, for any set of given states, the start ``(u, p, z) -> x``.

    A given state that the initial equations would have determined drops the equation that determined it. Where Newton's
    iteration finds no equilibrium, or they are singular, the states it sought are NaN.
    """
    name = solved.elaboration.name
    states = solved.elaboration.states
    symbols = [s.symbol for s in states]
    rate = solved.elaboration.derivatives
    rate_of = {rate[s.element_hash()][1].element_hash(): r for s, r in zip(symbols, rates, strict=True)}
    residuals = [solved.of(replace(solved.of(e.left - e.right), rate_of)) for e in solved.elaboration.initial_equations]
    residuals = [ca.substitute([r], [solved.elaboration.time], [ca.SX(0)])[0] for r in residuals]
    loose = [i for i, s in enumerate(states) if not s.declaration.fixed]
    determines = _assignment(name, states, loose, residuals, solved.elaboration.initial_equations)
    starts = {s.element_hash(): _declared_start(solved, state) for s, state in zip(symbols, states, strict=True)}
    position = {s.path: i for i, s in enumerate(states)}

    @functools.cache
    def start_given(given: tuple[str, ...]) -> ca.Function:
        z = ca.SX.sym("z", len(given))
        taken = {position[path]: z[k] for k, path in enumerate(given)}
        free = [i for i in loose if i not in taken]
        known = {symbols[i].element_hash(): taken.get(i, starts[symbols[i].element_hash()]) for i in range(len(states))}
        guesses = {i: _followed(name, known[symbols[i].element_hash()], known, "the guess of its start") for i in free}
        for i in free:
            del known[symbols[i].element_hash()]
        known = {key: _followed(name, value, known, "its start") for key, value in known.items()}
        kept = [replace(residuals[determines[i]], known) for i in free]
        members = [
            Unknown(f"start of {states[i].path}", symbols[i], states[i].declaration.nominal, guesses[i]) for i in free
        ]
        known |= _solved_in_order(name, members, kept)
        x = ca.vertcat(*(_followed(name, s, known, "its start") for s in symbols)) if states else ca.SX.zeros(0)
        return ca.Function("start", [u, p, z], [x], ["u", "p", "z"], ["x"])

    return start_given


def _solved_in_order(name: str, members: list[Unknown], residuals: list[ca.SX]) -> dict[int, ca.SX]:
    """Start values of the loose states, by hash; residual k determines member k. Only true loops are solved at once."""
    index = {m.symbol.element_hash(): k for k, m in enumerate(members)}
    incidence = [{index[s.element_hash()] for s in ca.symvar(r) if s.element_hash() in index} for r in residuals]
    found: dict[int, ca.SX] = {}
    for block in ordered_blocks(incidence, np.arange(len(members))):
        own = [members[k] for k in block]
        left = [replace(residuals[k], found) for k in block]
        solution, record = solve_block(name, own, left, lambda: "the initial equations")
        if isinstance(record, NonlinearBlock):
            solution = [ca.if_else(record.error < LARGEST_LAST_STEP, value, np.nan) for value in solution]
        for pivot in record.pivots if isinstance(record, LinearBlock) else ():
            solution = [ca.if_else(pivot == 0, np.nan, value) for value in solution]
        found |= {m.symbol.element_hash(): value for m, value in zip(own, solution, strict=True)}
    return found


def _declared_start(solved: Solved, state) -> ca.SX:
    start = state.declaration.start
    if not callable(start):
        return ca.SX(start)
    with numbers_refused():
        return solved.of(given_in_si(solved.elaboration, start, state.owner, state))


def _followed(name: str, expression: ca.SX, known: Mapping[int, ca.SX], role: str) -> ca.SX:
    """``expression`` once every state in it is replaced by its own start value."""
    found = expression
    for _ in range(len(known) + 1):
        found = replace(found, known)
    circle = [str(s) for s in ca.symvar(found) if s.element_hash() in known]
    if circle:
        raise DeclarationError(f"{name}.{circle[0]}: {role} follows itself. Give it a number.")
    return found


def _assignment(name, states, loose, residuals, equations) -> dict[int, int]:
    """Which initial equation determines which loose state."""
    if len(residuals) != len(loose):
        named = ", ".join(states[i].path for i in loose) or "none"
        raise TopologyError(
            f"{name}: {len(residuals)} initial equations for {len(loose)} states with fixed=False ({named}). "
            "Each such state needs one initial equation."
        )
    if not loose:
        return {}
    index = {states[i].symbol.element_hash(): k for k, i in enumerate(loose)}
    incidence = [{index[s.element_hash()] for s in ca.symvar(r) if s.element_hash() in index} for r in residuals]
    state_of, unmatched, _ = match(incidence, len(loose))
    if unmatched:
        raise TopologyError(
            f"{name}: the initial equations do not determine {', '.join(states[loose[k]].path for k in unmatched)}: "
            f"{'; '.join(str(e) for e in equations)}. Fix its start value, or state what holds for it at the start."
        )
    return {loose[int(k)]: i for i, k in enumerate(state_of)}
