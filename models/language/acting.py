"""Whether what was added to a model acts on it: an effect that was asked for is in the equations, or refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from .additions import Addition
from .errors import TopologyError
from .flat import FlatModel
from .flattening import Solved


def refuse_idle(solved: Solved, additions: Sequence[Addition], flat: FlatModel) -> None:
    """Raise for an addition with a free parameter that no rate or output of the rest depends on.

    Raises
    ------
    TopologyError : names the addition, its place and the parameters without effect.
    """
    e = solved.elaboration
    rates = {s.symbol.element_hash(): e.derivatives[s.symbol.element_hash()][1] for s in e.states}
    needs = {key: ca.symvar(solved.of(rate)) for key, rate in rates.items()}
    seen = [s for o in e.outputs for s in ca.symvar(solved.of(o.symbol))]
    for addition in additions:
        prefix = f"{addition.name}."
        own = {s.symbol.element_hash() for s in e.states if addition.part is not None and s.path.startswith(prefix)}
        ends = [s for key, symbols in needs.items() if key not in own for s in symbols]
        reached = _reached([*seen, *ends], {key: needs[key] for key in own})
        idle = [name for name, key in _sought(solved, addition).items() if key not in reached]
        idle = [name for name in idle if name not in solved.dead_times.values() and not _moves_start(flat, name)]
        if idle:
            raise TopologyError(
                f"{e.name}: {_named(addition)} changes nothing: no rate and no output depends on {', '.join(idle)}. "
                "Choose another place, or leave it out."
            )


def _moves_start(flat: FlatModel, name: str) -> bool:
    """A parameter that the start values alone depend on."""
    start = flat.start_given()
    u, p = (ca.SX.sym(word, len(some)) for word, some in (("u", flat.inputs), ("p", flat.parameters)))
    return ca.depends_on(start(u, p, []), p[flat.index_of(name)])


def _named(addition: Addition) -> str:
    where = f" at '{addition.site}'" if addition.site else ""
    return f"'{addition.effect or addition.name or addition.frees}'{where}"


def _sought(solved: Solved, addition: Addition) -> Mapping[str, int]:
    """The free parameters of an addition, or the one that it frees: path -> hash."""
    if addition.part is None:
        wanted = {q.path: q for q in solved.elaboration.parameters if q.path == addition.frees}
    else:
        prefix = f"{addition.name}."
        wanted = {q.path: q for q in solved.elaboration.parameters if q.path.startswith(prefix) and q.declaration.free}
    return {path: q.symbol.element_hash() for path, q in wanted.items()}


def _reached(symbols: Sequence[ca.SX], needs: Mapping[int, Sequence[ca.SX]]) -> set[int]:
    """The symbols and what those of them need that are states of the addition, and so on."""
    found, waiting = set(), list(symbols)
    while waiting:
        key = waiting.pop().element_hash()
        if key not in found:
            found.add(key)
            waiting += needs.get(key, ())
    return found
