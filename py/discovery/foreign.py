"""around: what is asked of an FMU: which effect sits before its inputs or after its outputs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from hydrotwin.export.reader import FmuBlock
from hydrotwin.models.effects import Candidate, candidates
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import Parameter
from hydrotwin.records.between import settled

from .asked import Asked, Wanted, bounded, free_names
from .probing import ProbeJob, amplitudes, best_amplitude, cost_of, probe, seen_by_parts
from .recordings import split
from .refit import pooled_rmse
from .screen import Screen, Screened
from .search import Search
from .structure import Structure
from .surroundings import SurroundedFmu, around_only, ready, sized, surrounded

AMPLITUDES = 5  # of a candidate, over its usual range
USUAL_PERIOD, MUCH_SLOWER = 0.01, 5.0  # s, times it
SMALLEST = 0.1  # of the largest usual amplitude, where the usual range begins at or below zero
ITS_OWN = 1.25  # times the noise: what an FMU whose parameters are held may leave
CLOSER = 8  # further amplitudes around the best
SHORTLIST = 10  # each of them is a fit that runs the FMU again and again


def around(fmu: FmuBlock | SurroundedFmu, wanted: Wanted) -> Asked:
    """What is asked of an FMU: effects stand before its inputs and after its outputs.

    free : globs over the parameters of the FMU to identify along; None: none. Everything else as in `discover`.

    Raises DeclarationError for an FMU without inputs or outputs, DataError for recordings that lack a signal,
    SolveError where the FMU fails, crashes or hangs.
    """
    records, model = wanted.records, fmu if isinstance(fmu, SurroundedFmu) else surrounded(fmu)
    model = settled(model, records, wanted.interpolation)
    pieces, said, seconds = ready(model, records, wanted.validate, wanted.free)
    model = model if model.additions else sized(model, records)
    seen = {name for record in pieces for name in record.signals}
    period = min(float(np.median(np.diff(r.time))) for r in records)
    fitting = [at_pace(c, period) for c in around_only(model, candidates(model, wanted.effects, wanted.exclude), seen)]
    data = split(model.flat, pieces, wanted.validate, wanted.outputs, wanted.noise)
    data = dataclasses.replace(data, findings=(*said, *data.findings))
    names = free_names(model.flat, wanted.free or ())
    note = f"a run of the FMU takes {seconds:.2g} s, a search some hundred of them"
    within = bounded(model, names)
    return Asked(model, within, names, data, tuple(fitting), wanted.initial_states, AroundSearch, note)


def at_pace(candidate: Candidate, period: float) -> Candidate:
    """The candidate with times that suit recordings with a sample every ``period`` s.

    The catalogue's times are those of machines sampled every 10 ms; a plant that is sampled every minute has others.
    """
    factor = period / USUAL_PERIOD
    times = {k: p for k, p in declarations(candidate.effect).items() if isinstance(p, Parameter) and p.unit == "s"}
    times = {k: p for k, p in times.items() if p.free}
    if factor <= MUCH_SLOWER or not times:
        return candidate
    slower = {
        k: dataclasses.replace(p, bounds=(p.bounds[0], factor * p.bounds[1]), nominal=factor * (p.nominal or 1.0))
        for k, p in times.items()
    }
    paths = {f"{candidate.name}.{k}" for k in times}
    typical = {n: tuple(factor * v for v in t) if n in paths else t for n, t in candidate.typical.items()}
    probes = tuple({n: factor * v if n in paths else v for n, v in probe.items()} for probe in candidate.probes)
    effect = type(candidate.effect.__name__, (candidate.effect,), slower)
    return dataclasses.replace(candidate, effect=effect, typical=typical, probes=probes)


class AroundSearch(Search):
    """A search whose candidates are few and far from linear: each is run at amplitudes that close in on its best.

    What a dead time does to a step of a command is no multiple of what a small one does.
    """

    def _screened(
        self, now: Structure, rest: Sequence[Candidate], among: Sequence[Candidate] | None = None
    ) -> tuple[Screen, list[Screened]]:
        self.report("screen", 0, len(rest), "")
        model = self.model(self.candidates if among is None else among)
        screen = Screen(model.flat, self.names(now.members), rest, now.fitted, self.question)
        limits = [c for c in rest if hasattr(c.effect, "probes_for")]
        seen = seen_by_parts(model, screen, limits)
        tries = [amplitudes(c, seen[c.label]) if c.label in seen else over_usual_range(c) for c in rest]
        jobs = [self._probe_job(now, c, values) for c, values in zip(rest, tries, strict=True)]
        found = []
        for c, job, runs in zip(rest, jobs, self.run(closing_in, jobs, "probe"), strict=True):
            made = dataclasses.replace(job, amplitudes=tuple(values for values, _ in runs))
            found.append(best_amplitude(screen, screen.by_derivative(c), made, [ran for _, ran in runs]))
        self.not_testable.update({s.candidate.label: s for s in found if not s.testable})
        return screen, sorted(found, key=lambda s: -s.evidence)

    def explained(self, now: Structure) -> bool:
        """Little is left. Behind a first name a little more than noise is the FMU's own, of which nothing is fitted."""
        if super().explained(now) or self.free or not now.members:
            return super().explained(now)
        with np.errstate(invalid="ignore"):
            times = pooled_rmse((*now.fitted.residuals_fit, *now.fitted.residuals_select)) / self.question.noise
        return bool(np.nanmax(times) < ITS_OWN)

    def shortlist(self, ranked: Sequence[Screened]) -> list[Screened]:
        """The best of those worth a refit."""
        return super().shortlist(ranked)[:SHORTLIST]


def over_usual_range(candidate: Candidate) -> list[dict[str, float]]:
    """Amplitudes of a candidate with one parameter over its usual range; else its own probes."""
    if len(candidate.free) != 1 or candidate.free[0] not in candidate.typical:
        return [dict(p) for p in candidate.probes]
    name = candidate.free[0]
    low, high = candidate.typical[name]
    if low > 0:
        return [{name: float(v)} for v in np.geomspace(low, high, AMPLITUDES)]
    sizes = np.geomspace(SMALLEST * high, high, AMPLITUDES // 2 + 1)
    return [{name: float(sign * v)} for v in sizes for sign in (1.0, -1.0)]


def closing_in(job: ProbeJob) -> list[tuple[Mapping[str, float], tuple[np.ndarray, ...] | None]]:
    """Amplitudes and their residuals (n, ny) per recording, SI (None where a run diverges): those of the job, then,
    for a single parameter, more of them between the neighbours of the best."""
    made = [(dict(values), ran) for values, ran in zip(job.amplitudes, probe(job), strict=True)]
    names = {n for values, _ in made for n in values}
    if len(names) != 1 or all(ran is None for _, ran in made):
        return made
    (name,) = names
    cost = {values[name]: cost_of(ran, job.question) for values, ran in made}
    known = sorted({*cost, 0.0})
    best = min(cost, key=cost.get)
    k = known.index(best)
    low, high = known[max(k - 1, 0)], known[min(k + 1, len(known) - 1)]

    def more(value: float) -> float:
        (ran,) = probe(dataclasses.replace(job, amplitudes=({name: float(value)},)))
        made.append(({name: float(value)}, ran))
        return cost_of(ran, job.question)

    if high > low:
        minimize_scalar(more, bounds=(low, high), method="bounded", options={"maxiter": CLOSER, "xatol": 0.0})
    return made
