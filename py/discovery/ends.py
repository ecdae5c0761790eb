"""Ends: where a limit was found on one side, the other side is looked for beside it.

A stop that is far away does nothing, and no derivative leads there. What the part does with the first end in place says
how far the second one may be.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.models.effects import Candidate

from .probing import ProbeJob, amplitudes, cost_of, probe, seen_by_parts
from .refit import likelihood, refit
from .screen import Screen
from .search import Search
from .structure import Structure, Tried


def both_ends(search: Search, now: Structure, tried: Sequence[Tried]) -> list[Tried]:
    """``tried`` with those fitted again that left a side of theirs where it does nothing, and should not have."""
    jobs = [(t, job) for t in tried if (job := _other_end(search, t)) is not None]
    if not jobs:
        return list(tried)
    starts = []
    for (t, job), runs in zip(jobs, search.run(probe, [job for _, job in jobs], "probe"), strict=True):
        costs = [cost_of(r, search.question) for r in runs]
        cost, values = min(zip(costs, job.amplitudes, strict=True), key=lambda pair: pair[0])
        if cost < likelihood(t.structure.fitted.rmse, search.question):
            again = [search.refit_of(t.structure, values, coarse=coarse) for coarse in (False, True)]
            starts += [(t, job) for job in again]  # the base may have bent as far as whole recordings lead back
    better: dict[int, Structure] = {}
    for (t, _), found in zip(starts, search.run(refit, [job for _, job in starts], "refit"), strict=True):
        known = better.get(id(t), t.structure)
        if not isinstance(found, str) and found.likelihood < known.fitted.likelihood:
            better[id(t)] = search.keep(Structure(known.members, found))
    return [
        search.judged(dataclasses.replace(t, structure=better[id(t)]), now) if id(t) in better else t for t in tried
    ]


def without_idle_ends(search: Search, now: Structure) -> Structure:
    """``now`` with the sides of its limits far away again that explain nothing: found while the rest still moved."""
    for c in now.members:
        found = [n for n in _sides(c) if not _absent(now, c, n)]
        if len(found) > 1:
            jobs = [search.refit_of(now, {n: c.neutral[n]}) for n in found]
            fits = [f for f in search.run(refit, jobs, "look back") if not isinstance(f, str)]
            least = min(fits, key=lambda f: f.likelihood, default=None)
            if least and 2 * (least.likelihood - now.fitted.likelihood) < search.needed:
                now = search.keep(Structure(now.members, least))
    return now


def _sides(candidate: Candidate) -> list[str]:
    """Parameters of a limit each of which acts alone, as the two ends of a stroke; of others none."""
    if not hasattr(candidate.effect, "probes_for"):
        return []
    absent = candidate.neutral
    moved = [[n for n, v in p.items() if n in absent and v != absent[n]] for p in candidate.probes]
    alone = sorted({names[0] for names in moved if len(names) == 1})
    return alone if len(alone) > 1 else []


def _absent(structure: Structure, candidate: Candidate, name: str) -> bool:
    """Whether this side lies where nothing comes."""
    return bool(np.isclose(structure.fitted.values[name], candidate.neutral[name], rtol=1e-6))


def _other_end(search: Search, t: Tried) -> ProbeJob | None:
    """Runs of a fitted structure with the other side of what was added at several places; None where it has none."""
    if not t.evidence or not t.evidence.bic_gain > search.needed:
        return None
    fitted = t.structure.fitted
    for c in t.members:
        idle = {n for n in _sides(c) if _absent(t.structure, c, n)}
        if idle:
            model = search.model(t.structure.members)
            screen = Screen(model.flat, search.names(t.structure.members), (), fitted, search.question)
            values = _only(amplitudes(c, seen_by_parts(model, screen, [c])[c.label]), idle, c.neutral)
            return ProbeJob(model.flat, search.question, fitted, tuple(values), c.label) if values else None
    return None


def _only(values: Sequence[Mapping[str, float]], idle: set[str], absent: Mapping[str, float]) -> list[dict[str, float]]:
    """Different settings of these parameters alone, other than where they do nothing."""
    found = []
    for v in values:
        own = {n: x for n, x in v.items() if n in idle and x != absent[n]}
        if own and own not in found:
            found.append(own)
    return found
