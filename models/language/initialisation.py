"""Start values: fixed ones, and those that static equilibrium (the initial equations) determines."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from .errors import TopologyError
from .flattening import Solved, replace
from .solving import Unknown, solve_block
from .structure import match


def initialisation(solved: Solved, u: ca.SX, p: ca.SX, rates: list[ca.SX]) -> Callable[[tuple[str, ...]], ca.Function]:
    """A function that gives, for any set of given states, the start ``(u, p, z) -> x``.

    A given state that the initial equations would have determined drops the equation that determined it.
    """
    name = solved.elaboration.name
    states = solved.elaboration.states
    symbols = [s.symbol for s in states]
    rate = solved.elaboration.derivatives
    rate_of = {rate[s.element_hash()][1].element_hash(): r for s, r in zip(symbols, rates, strict=True)}
    residuals = [
        solved.of(replace(solved.of(e.left - e.right), rate_of)) for e in solved.elaboration.initial_equations
    ]
    residuals = [ca.substitute([r], [solved.elaboration.time], [ca.SX(0)])[0] for r in residuals]
    loose = [i for i, s in enumerate(states) if not s.declaration.fixed]
    determines = _assignment(name, states, loose, residuals, solved.elaboration.initial_equations)
    fixed = {}
    for i, s in enumerate(states):
        if s.declaration.fixed:
            start = s.declaration.start
            fixed[i] = solved.of(ca.SX(start(s.owner) if callable(start) else start))

    def start_given(given: tuple[str, ...]) -> ca.Function:
        z = ca.SX.sym("z", len(given))
        values: dict[int, ca.SX] = dict(fixed)
        for k, path in enumerate(given):
            values[[s.path for s in states].index(path)] = z[k]
        free = [i for i in loose if i not in values]
        kept = [residuals[determines[i]] for i in free]
        known = {symbols[i].element_hash(): ca.SX(v) for i, v in values.items()}
        if free:
            members = [
                Unknown(f"start of {states[i].path}", symbols[i], states[i].declaration.nominal, _guess(states[i]))
                for i in free
            ]
            solution, _ = solve_block(
                name, members, [replace(r, known) for r in kept], lambda: "the initial equations"
            )
            values.update(zip(free, solution, strict=True))
        x = ca.vertcat(*(values[i] for i in range(len(states)))) if states else ca.SX.zeros(0)
        return ca.Function("start", [u, p, z], [x], ["u", "p", "z"], ["x"])

    return start_given


def _guess(state) -> float:
    start = state.declaration.start
    return 0.0 if callable(start) else float(start)


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
