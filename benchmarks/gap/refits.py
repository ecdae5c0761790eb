"""What baselines need of a case: its base identified, and the oracle, the true structure fitted from the truth."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import product

import numpy as np

from hydrotwin.discovery.evidence.gaps import pooled_rmse
from hydrotwin.discovery.fits.job import Fitted, Question
from hydrotwin.discovery.fits.whole import Concluded, conclude, fit
from hydrotwin.discovery.structures.jobs import EFFORTS
from hydrotwin.discovery.structures.search import Search
from hydrotwin.discovery.structures.table import Entry, Table
from hydrotwin.identification.problem import recordings
from hydrotwin.models.effects import CATALOGUE, Candidate, candidates

from .cases import Made
from .score import PARAMETERS, is_it, times_noise

EFFORT = dataclasses.replace(EFFORTS["normal"], iterations=30, seconds=120.0)
STARTS = 6


class Bench:
    """One case, its identified base model, and fits of it with effects added."""

    def __init__(self, made: Made):
        self.made, self.model = made, made.model

    @cached_property
    def search(self) -> Search:
        """The fits of `discover`, with the noise told and the base within the bounds of its model."""
        flat = self.model.flat
        noise = np.array([self.made.noise.get(s.name, np.nan) for s in flat.outputs])
        free = tuple(p.name for p in flat.parameters if p.free)
        asked = Question(recordings(flat, self.made.fit, None, "record"), noise)
        none, told = np.zeros_like(noise), np.ones(len(noise), bool)
        table = Table(self.model, free, candidates(self.model), asked, none, told)
        return Search(table, lambda function, jobs, _: [function(job) for job in jobs], EFFORT)

    @cached_property
    def base(self) -> Concluded:
        """The base from its nominal values, through windows, as `discover` identifies it."""
        entry = self.search.identify()
        return self._concluded(entry, entry.fitted)

    def fitted(self, chosen: Sequence[Candidate], starts: Sequence[Mapping[str, float]], states=()) -> Fitted | None:
        """The base with effects added, everything free, from the cheapest start; None where it diverges."""
        found = fit(self.search.jobs.of(self.search.table.entry(chosen), starts, states=states))
        return found if isinstance(found, Fitted) else None

    def concluded(self, chosen: Sequence[Candidate], found: Fitted) -> Concluded:
        """What a fit leaves of the held-out recordings, too."""
        return self._concluded(self.search.table.entry(chosen), found)

    def _concluded(self, entry: Entry, found: Fitted) -> Concluded:
        job = self.search.jobs.of(entry, [found.values], states=found.states, size=found.rmse)
        held_out = recordings(self.model.flat, self.made.held_out, None, "record")
        one = conclude(dataclasses.replace(job, question=dataclasses.replace(job.question, select=held_out)))
        if isinstance(one, str):
            raise RuntimeError(one)
        return one

    def by_output(self, values: np.ndarray) -> dict[str, float]:
        """Of the recorded outputs."""
        names = [s.name for s in self.model.flat.outputs]
        return {n: float(v) for n, v in zip(names, values, strict=True) if n in self.made.noise}

    def rmse(self, found: Concluded) -> dict[str, float]:
        """Held-out RMSE by recorded output, SI."""
        return self.by_output(pooled_rmse(found.residuals_report))


def oracle(bench: Bench, without: int | None = None) -> dict[str, float] | None:
    """Held-out RMSE of the true structure fitted; None where the catalogue cannot express it.

    It starts from the truth, as far as it can be compared, and from the fitted base with the effects at their probes:
    it is the best that can be, not a rival. ``without``: the number of a hidden effect to leave out, to see whether it
    is needed.
    """
    made, sets = bench.made, []
    if made.case.kind == "none":
        return bench.rmse(bench.base)
    for h, (effect, _) in enumerate(made.hidden):
        if h == without:
            continue
        if effect not in CATALOGUE:
            return None
        fitting = [c for c in bench.search.table.candidates if c.id == effect and is_it(made, h, c.id, c.site.name)]
        if not fitting:
            return None
        sets.append([(c, at_truth(made, h, c)) for c in fitting])
    found, base = [], bench.base.fitted
    for pairs in product(*sets):
        chosen = [c for c, _ in pairs]
        own = {name: value for _, values in pairs for name, value in values.items()}
        probes = list(product(*((*c.probes, dict(c.neutral)) for c in chosen)))[:STARTS]
        points = [{k: v for probe in several for k, v in probe.items()} for several in probes]
        true = [{**point, **made.truth, **own} for point in points]
        for starts, states in ((true, ()), ([{**base.values, **p} for p in points], base.states)):
            fitted = bench.fitted(chosen, starts, states)
            found += [(chosen, fitted)] if fitted else []
    left = [times_noise(bench.by_output(fitted.rmse), made.noise) for _, fitted in found]
    return bench.rmse(bench.concluded(*found[int(np.argmin(left))])) if found else None


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
