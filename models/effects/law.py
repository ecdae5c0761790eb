"""What an effect makes of a signal by itself, seen from its own equations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from hydrotwin.models.language import Component, Input, Model, Output, State, der
from hydrotwin.models.language.additions import Addition

from .effect import Effect, Site

DRAWS = 5  # points at which a law is tried


@dataclass(frozen=True)
class Law:
    """What is seen of an effect on a signal by itself.

    linear : the same combination of signals and states, whatever they are and whenever.
    shifts : what comes in with an offset goes on with that offset, and otherwise alike.
    """

    linear: bool = False
    shifts: bool = False


class _Path(Component):
    """A signal that an effect is put into."""

    u = Input("1", "in")
    y = Output("1", "out")
    memory = State(0.0, "s", "a model has a state")

    def equations(self):
        yield der(self.memory) == self.u
        yield self.y == self.u


@lru_cache(maxsize=256)
def law_of(kind: type[Effect], further: bool) -> Law:
    """The law of an effect on a signal at its first amplitude; ``further`` as in `Site`."""
    site = Site("u", through="u", further=further)
    name, part = "effect", kind.at(site)
    values = {f"{name}.{k}": v for k, v in (kind.probes[0] if kind.probes else {}).items()}
    flat = Model(_Path(), "path").plus([Addition(name, part, through="u")], sought=True).flat
    known = {p.name for p in flat.parameters}
    p = flat.parameter_vector({path: v for path, v in values.items() if path in known})
    start = flat.start_given()
    moved = start([1.0], p, []).full().ravel() - start([0.0], p, []).full().ravel()
    own = np.array([s.name != "memory" for s in flat.states])

    def ends(x, u, t=0.0):
        rates, outputs = flat.ode(t, x, [u], p)
        return np.concatenate([rates.full().ravel()[own], outputs.full().ravel()])

    draw = np.random.default_rng(0)
    points = [(draw.normal(size=len(flat.states)), float(draw.normal())) for _ in range(DRAWS)]
    zero, output = np.zeros(len(flat.states)), np.append(np.zeros(own.sum()), 1.0)
    linear = np.allclose(ends(zero, 0.0), 0) and all(
        np.allclose(ends(x + z, u + v, t=9.0), ends(x, u) + ends(z, v)) for (x, u), (z, v) in pairwise(points)
    )
    shifts = all(np.allclose(ends(x + 2.0 * moved, u + 2.0), ends(x, u) + 2.0 * output) for x, u in points)
    return Law(bool(linear), bool(shifts))
