"""Structures refitted to a case by the project's own refit: the oracle, and what the BIC baseline chooses from."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from functools import cached_property
from itertools import product

import numpy as np

from hydrotwin.discovery.refit import Question, RefitJob, Refitted, pooled_rmse, refit
from hydrotwin.identification.problem import recordings
from hydrotwin.models.effects import CATALOGUE, Candidate, candidates

from .cases import Made
from .score import PARAMETERS, is_it

STARTS = 6


class Bench:
    """One case, its identified base model, and refits of it with effects added."""

    def __init__(self, made: Made):
        self.made, self.model = made, made.model

    @cached_property
    def free(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.model.flat.parameters if p.free)

    @cached_property
    def question(self) -> Question:
        flat = self.model.flat
        fit, held_out = (recordings(flat, r, None, "record") for r in (self.made.fit, self.made.held_out))
        return Question(fit, held_out, np.array([self.made.noise.get(s.name, np.nan) for s in flat.outputs]))

    @cached_property
    def base(self) -> Refitted:
        """The base model from its nominal values: through short windows, and where they lead nowhere, without."""
        found = refit(RefitJob(self.model.flat, self.free, self.question, coarse=True))
        if isinstance(found, str):
            found = refit(RefitJob(self.model.flat, self.free, self.question))
        if isinstance(found, str):
            raise RuntimeError(found)
        return found

    @cached_property
    def candidates(self) -> tuple[Candidate, ...]:
        return candidates(self.model)

    def refitted(self, chosen: Sequence[Candidate], follow: int = 2, base=None, own=()) -> Refitted | str:
        """The base model with candidates added, everything free, from their probes (the best ``follow`` go on).

        base: values of the base parameters to start from, in place of those of the base model fitted.
        own: values of the candidates' parameters to start from besides.
        """
        model = self.model.plus([c.addition for c in chosen], sought=True)
        free = tuple(dict.fromkeys([*self.free, *(name for c in chosen for name in c.free)]))
        probes = product(*((*c.probes, dict(c.neutral)) for c in chosen))
        points = [dict(own)] if own else []
        points += [{k: v for probe in several for k, v in probe.items()} for several in probes]
        starts = tuple({**(base or self.base.values), **point} for point in points[:STARTS])
        return refit(RefitJob(model.flat, free, self.question, starts, follow=follow))

    def rmse(self, found: Refitted) -> dict[str, float]:
        """Held-out RMSE by recorded output, SI."""
        names = [s.name for s in self.model.flat.outputs]
        left = pooled_rmse(found.residuals_select)
        return {n: float(v) for n, v in zip(names, left, strict=True) if n in self.made.noise}


def oracle(bench: Bench, without: int | None = None) -> dict[str, float] | None:
    """Held-out RMSE of the true structure refitted; None where the catalogue cannot express it.

    It starts from the base model fitted and from the true base parameters, from probes and, where they can be compared,
    from the true parameters of the effects: it is the best that can be, not a rival.
    ``without``: the number of a hidden effect to leave out, to see whether it is needed.
    """
    made, sets = bench.made, []
    if made.case.kind == "none":
        return bench.rmse(bench.base)
    for h, (effect, _) in enumerate(made.hidden):
        if h == without:
            continue
        if effect not in CATALOGUE:
            return None
        fitting = [c for c in bench.candidates if c.id == effect and is_it(made, h, c.id, c.site.name)]
        if not fitting:
            return None
        sets.append([(c, at_truth(made, h, c)) for c in fitting])
    found = []
    for pairs, base in product(product(*sets), (None, made.truth)):
        own = {name: value for _, values in pairs for name, value in values.items()}
        found.append(bench.refitted([c for c, _ in pairs], base=base, own=own))
    found = [r for r in found if not isinstance(r, str)]
    return bench.rmse(min(found, key=lambda r: r.likelihood)) if found else None


def at_truth(made: Made, hidden: int, candidate: Candidate) -> dict[str, float]:
    """The true values of a candidate's parameters, by path, as far as truth and catalogue mean the same by them."""
    effect, options = made.hidden[hidden]
    values = {}
    for path in candidate.free:
        word = path.rpartition(".")[2]
        true = next((f(made, options) for w, f in PARAMETERS.get(effect, {}).items() if re.fullmatch(w, word)), None)
        true = options.get(word) if true is None else true
        if isinstance(true, (int, float)) and math.isfinite(true):
            values[path] = float(true)
    return values


def timed(work, *arguments):
    """``(answer, seconds)``."""
    began = time.perf_counter()
    return work(*arguments), time.perf_counter() - began
