"""A model whose dead times are zero, without their parameters: Model Exchange knows no dead time."""

from __future__ import annotations

import dataclasses

import casadi as ca

from hydrotwin.models.language.flat import FlatModel


def without_idle_delays(flat: FlatModel) -> tuple[FlatModel, tuple[str, ...]]:
    """The model with every dead time of zero s left out, and the names of the parameters that went with them.

    The ode does not read a dead time: inputs reach it late already. A dead time above zero stays.
    """
    delays = {s.dead_time for s in flat.inputs if s.dead_time}
    idle = tuple(p.name for p in flat.parameters if p.name in delays and p.value == 0.0)
    if not idle:
        return flat, ()
    kept = [p for p in flat.parameters if p.name not in idle]

    def all_of(p):
        places = {parameter.name: k for k, parameter in enumerate(kept)}
        return ca.vertcat(*(p[places[q.name]] if q.name in places else 0.0 for q in flat.parameters))

    def initialisation(given: tuple[str, ...]) -> ca.Function:
        return _with_parameters(flat.initialisation(given), len(kept), all_of)

    inputs = tuple(dataclasses.replace(s, dead_time=None) if s.dead_time in idle else s for s in flat.inputs)
    changed = dataclasses.replace(
        flat, inputs=inputs, parameters=tuple(kept), ode=_with_parameters(flat.ode, len(kept), all_of),
        initialisation=initialisation, loops=(),
    )  # fmt: skip
    return changed, idle


def _with_parameters(f: ca.Function, count: int, all_of) -> ca.Function:
    """The function of ``count`` parameters, from which ``all_of`` makes those that it had."""
    sym = ca.SX if f.is_a("SXFunction") else ca.MX
    arguments = [sym.sym(n, count if n == "p" else f.size1_in(k)) for k, n in enumerate(f.name_in())]
    full = [all_of(a) if n == "p" else a for n, a in zip(f.name_in(), arguments, strict=True)]
    return ca.Function(f.name(), arguments, f.call(full), f.name_in(), f.name_out())
