"""Structures fitted to a case by the project's own fits: the base, and the oracle that knows what is missing."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import product

import numpy as np

from hydrotwin.discovery.evidence.gaps import pooled_rmse
from hydrotwin.discovery.evidence.score import Floor, score
from hydrotwin.discovery.fits.job import Job, Question
from hydrotwin.discovery.fits.whole import Concluded, conclude, fit
from hydrotwin.discovery.fits.windows import look
from hydrotwin.identification.horizon import horizons
from hydrotwin.identification.problem import free_parameters, recordings
from hydrotwin.models.effects import CATALOGUE, Candidate, candidates

from .cases import Made
from .score import PARAMETERS, is_it

STARTS = 6
SECONDS = 60.0  # processor time of a fit [s]


class Bench:
    """One case, its identified base model, and fits of it with effects added."""

    def __init__(self, made: Made):
        self.made, self.model = made, made.model

    @cached_property
    def free(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.model.flat.parameters if p.free)

    @cached_property
    def question(self) -> Question:
        flat = self.model.flat
        train, held_out = (recordings(flat, r, None, "record") for r in (self.made.fit, self.made.held_out))
        noise = np.array([self.made.noise.get(s.name, np.nan) for s in flat.outputs])
        start = free_parameters(flat, self.free)
        lengths = horizons(flat, train, start.vector(start.scaled(start.start)))
        return Question(tuple(train), noise, select=tuple(held_out), lengths=tuple(lengths))

    @cached_property
    def base(self) -> Concluded:
        """The base model from its nominal values."""
        found = self._led(self.model, self.free, [{}])
        if isinstance(found, str):
            raise RuntimeError(found)
        return found

    @cached_property
    def candidates(self) -> tuple[Candidate, ...]:
        return candidates(self.model)

    def fitted(self, chosen: Sequence[Candidate], base: Mapping[str, float], own: Mapping[str, float]):
        """The base model with candidates added, everything free, a `Concluded` or a sentence.

        base: values of the base parameters to start from. own: values of the candidates' parameters to start from
        besides their probes.
        """
        model = self.model.plus([c.addition for c in chosen], sought=True)
        free = tuple(dict.fromkeys([*self.free, *(name for c in chosen for name in c.free)]))
        probes = product(*((*c.probes, dict(c.neutral)) for c in chosen))
        points = [dict(own)] if own else []
        points += [{k: v for probe in several for k, v in probe.items()} for several in probes]
        return self._led(model, free, [{**base, **point} for point in points[:STARTS]])

    def _led(self, model, free: Sequence[str], starts: Sequence[Mapping[str, float]]) -> Concluded | str:
        """Through short windows to whole recordings, from the cheapest of the starts and of what windows came by."""
        q = self.question
        job = Job(model.flat, tuple(free), q, tuple(starts), seconds=SECONDS, stages=(0, len(q.lengths)))
        seen = look(job) if q.lengths else "no windows"
        job = dataclasses.replace(job, stages=None)
        if not isinstance(seen, str):
            begin = (seen.values, *seen.trail, *starts)
            job = dataclasses.replace(job, starts=begin, states=seen.states, size=seen.size)
        found = fit(job)
        if isinstance(found, str):
            return found
        last = dataclasses.replace(job, starts=(found.values,), states=found.states, size=found.rmse)
        return conclude(last)

    def rmse(self, found: Concluded) -> dict[str, float]:
        """Held-out RMSE by recorded output, SI."""
        names = [s.name for s in self.model.flat.outputs]
        left = pooled_rmse(found.residuals_report)
        return {n: float(v) for n, v in zip(names, left, strict=True) if n in self.made.noise}

    def score(self, found: Concluded) -> float:
        """Nats that it leaves of the recordings fitted to, beyond noise."""
        return score(found.fitted.left, Floor(self.question.noise, np.zeros_like(self.question.noise)))


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
    for pairs, base in product(product(*sets), (bench.base.fitted.values, made.truth)):
        own = {name: value for _, values in pairs for name, value in values.items()}
        found.append(bench.fitted([c for c, _ in pairs], base, own))
    found = [r for r in found if not isinstance(r, str)]
    return bench.rmse(min(found, key=bench.score)) if found else None


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
