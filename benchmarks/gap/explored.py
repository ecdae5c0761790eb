"""The new search, not yet behind `discover`: the answer that its table of fits says, for the same cases.

What is told of the held-out recordings is what the fits of the search leave there, start states estimated as `discover`
does.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from .score import Answer, Named

LIMIT = 300.0  # s of one case


def explored(made, executor: Executor, effects: Sequence[str] | None = None) -> Answer:
    """The answer of `explore` on a case of the benchmark; effects: globs, None for all."""
    from hydrotwin.discovery.structures.explore import explore

    began = time.perf_counter()
    search, said = explore(made.model, made.fit, effects=effects, executor=executor, time_limit=LIMIT)
    seconds, table, named = time.perf_counter() - began, said.table, []
    for effect in said.order if said.kept.members else ():
        members = tuple((m.id, m.site.name) for m in said.members(effect))
        own = tuple((n, said.best.fitted.values[n], np.nan, np.nan) for n in effect.free)
        named.append(Named(effect.id, effect.site.name, members, said.probability(effect.label), own))
    noise = table.noise
    ranked = said.posterior.ranked()[:5]
    notes = {
        "complete": search.complete,
        "first": search.first,
        "looks": sum(bool(e.look) for e in table.entries.values()),
        "fits": len(table.fitted),
        "told": said.told(),
        "scores": {" + ".join(k) or "base": table.score(table.entries[k]) for k in ranked},
        "left": {" + ".join(k) or "base": float(np.nanmax(table.entries[k].fitted.rmse / noise)) for k in ranked},
    }
    before = held_out(search, table.entry(), made.held_out)
    after = before if said.kept is table.entry() else held_out(search, said.kept, made.held_out)
    return Answer(said.verdict, tuple(named), before, after, seconds, notes)


def held_out(search, entry, records) -> dict[str, float]:
    """RMSE, by output, SI, that a fit leaves of recordings which took no part."""
    from hydrotwin.discovery.evidence.score import spectrum
    from hydrotwin.discovery.fits.job import moving_starts, task_of
    from hydrotwin.identification.descent import held_out_run
    from hydrotwin.identification.problem import recordings

    flat, fitted = search.table.model(entry).flat, entry.fitted
    job = search.job(entry, [fitted.values])
    task = task_of(job, fitted.values, search.table.noise, moving_starts(job))
    q, left = task.free.scaled(task.free.start), []
    for recording in recordings(flat, records, None, "held out"):
        shooting, z = held_out_run(task, q, recording)
        run = shooting.residuals(0, q, z[0])
        unit = np.where(task.weights > 0, task.weights, np.nan)
        left.append(np.where(np.isfinite(recording.y), np.inf, np.nan) if run is None else run / unit)
    rmse = spectrum(left).rmse
    return {o.name: float(r) for o, r in zip(flat.outputs, rmse, strict=True) if not np.isnan(r)}
