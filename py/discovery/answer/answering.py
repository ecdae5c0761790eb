"""From a searched table to a Discovery: final fits, verdict, and everything that shows it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.identification.evidence import made_by_fit
from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import fitted_beside
from hydrotwin.models.language.model import Model
from hydrotwin.models.language.provenance import IDENTIFIED, refitted

from ..diagnosis.experiment import next_experiment
from ..diagnosis.locate import locations
from ..diagnosis.regions import regions
from ..diagnosis.unknown import describe_unknown
from ..evidence.deciding import DECIDING
from ..evidence.gaps import CLEARLY, LARGE, gap_closed, has_gap, pooled_rmse
from ..fits.job import Job
from ..fits.whole import Concluded, conclude, judged
from ..recordings import Split
from ..structures.extent import testable
from ..structures.search import Search
from ..structures.table import Entry
from .discovery import Discovery, Ranked, Rung, Shift
from .discovery import Step as NamedStep
from .findings import findings_of, reason_of
from .rows import concluded_values, rows_of
from .standing import Standing, closed, standing
from .view import View

MOST_RIVALS = 4  # fits of what is told beside what is named
MEMBERS = 3  # of a class that an experiment is designed for


@dataclass(frozen=True, eq=False)
class Finals:
    """Final fits: of the base, of what is kept, and of rivals, by label.

    without : what the kept without one effect leaves of what judges, by its label.
    """

    before: Concluded
    after: Concluded
    rivals: Mapping[str, Concluded]
    without: Mapping[str, Sequence[np.ndarray]]


def answer(search: Search, data: Split, model: Model) -> Discovery:
    """The Discovery of a search as far as it went; ``model`` is what the user gave, with its own bounds."""
    table, said = search.table, standing(search.table)
    finals = _finals(search, data, said)
    elsewhere = _only_elsewhere(said, finals, data)
    shown = _closed_where_it_counts(finals, data)
    if said.verdict == "none" and elsewhere:
        said = dataclasses.replace(said, verdict="unknown", part=False)
    refuted = bool(said.kept.members) and shown < DECIDING.confirmed
    if refuted:
        said = dataclasses.replace(said, verdict="unknown", part=False)
        finals = dataclasses.replace(finals, after=finals.before)
    doubts = _doubts(said, finals, data) if said.kept.members else {}
    steps = _steps(said, finals, doubts) if said.kept.members else ()
    flat, kept = table.base.flat, said.kept
    view = View(flat, dataclasses.replace(data, noise=table.noise), finals.before, finals.after)
    added = table.model(kept).additions[len(model.additions) :]
    final, residual = model.plus(added) if added else model, finals.after.residuals_fit
    unknown = ()
    if said.verdict == "unknown" or has_gap(residual, table.noise, CLEARLY).any():
        half = max(1, len(data.train) // 2)
        unknown = describe_unknown(
            flat, data.train[:half], residual[:half], data.train[half:], residual[half:], table.noise
        )
    rows = () if steps else rows_of(said, (), None)
    return Discovery(
        name=table.base.name,
        verdict=said.verdict,
        reason=reason_of(search, said, data, elsewhere, shown if refuted else None),
        steps=steps,
        base=_with_fit(model, finals.before),
        model=_with_fit(final, finals.after),
        fit_before=finals.before.fit,
        fit_after=finals.after.fit,
        noise={n.name: float(s) for n, s in zip(flat.outputs, table.noise, strict=True) if np.isfinite(s)},
        outputs={"train": view.pooled("train"), "validate": view.pooled("report")},
        recordings=view.by_recording(),
        locations=locations(flat, data.train, finals.before.residuals_fit, table.noise),
        regions=regions(flat, data.train, finals.before.residuals_fit, residual, table.noise),
        overlays=view.overlays(),
        shifts=_shifts(finals),
        waterfall=_waterfall(said),
        last_ranked=rows,
        unknown=tuple(unknown),
        experiment=_experiment(search, said, data) if said.verdict == "class" and not flat.black_box else None,
        findings=(*data.findings, *findings_of(search, said, doubts), *_of_fit(finals.after, said.verdict)),
        not_testable=_not_testable(said),
        screened=sum(bool(e.seen and not e.failed) for e in table.entries.values() if len(e.key) == 1),
        fitted=len({label for e in table.fitted for label in e.key}),
        probabilities=said.told(),
        untried=tuple(" + ".join(e.key) for e in search.waiting()[:5]) if not search.complete else (),
        provenance={r.name: r.digest for r in (*data.train, *data.report) if r.digest},
    )


# -- final fits --------------------------------------------------------------------------------------------------------
def _finals(search: Search, data: Split, said: Standing) -> Finals:
    """The structures that are told, fitted once more with intervals, and run on the recordings that judge.

    A base that is not kept is told where it stands: it has no minimum worth the time while something is missing. So is
    all but what is kept once the time is over.
    """
    table, kept = search.table, said.kept
    base, needed = table.entry(), {}
    if kept.members:
        for effect in said.order:
            rest = [m for m in kept.members if m is not effect]
            for other in said.members(effect)[1:]:
                needed.setdefault(other.label, table.entry([*rest, other]))
        needed = dict(list(needed.items())[:MOST_RIVALS])
    entries = {"": base, **({"kept": kept} if kept is not base else {}), **needed}
    found = _answers(search, data, conclude, entries)
    for name in ("", "kept"):
        if isinstance(found.get(name), str):
            raise SolveError(found[name])
    good = {name: one for name, one in found.items() if not isinstance(one, str)}
    before = good.pop("")
    return Finals(before, good.pop("kept", before), good, _without_one(search, data, kept))


def _without_one(search: Search, data: Split, kept: Entry) -> dict[str, Sequence[np.ndarray]]:
    """What the kept without one of its effects leaves of what judges, by the label of that."""
    if len(kept.members) < 2 or not data.report:
        return {}
    parts = {c.label: search.table.entry(m for m in kept.members if m is not c) for c in kept.members}
    found = _answers(search, data, judged, parts)
    return {label: left for label, left in found.items() if not isinstance(left, str)}


def _answers(search: Search, data: Split, function: Callable, entries: Mapping[str, Entry]) -> dict:
    """What a function answers of structures that were fitted, from where they stand."""
    fitted = {name: e for name, e in entries.items() if e.fitted}
    late = not search.complete
    rest = {name: len(fitted) == 1 or (name == "kept" if late else bool(name)) for name in fitted}
    jobs = [_last(search, data, e, rest[name]) for name, e in fitted.items()]
    answers = search.run(function, jobs, "final fit")
    return dict(zip(fitted, answers, strict=True))


def _last(search: Search, data: Split, entry: Entry, rest: bool = True) -> Job:
    """The last fit of a structure, from where it stands. rest : to where it comes to rest, if there is time."""
    fitted = entry.fitted
    question = dataclasses.replace(search.table.question, noise=search.table.noise, select=data.report)
    job = search.jobs.of(entry, [fitted.values], states=fitted.states, size=fitted.rmse)
    iterations = job.iterations if rest else 0
    return dataclasses.replace(job, question=question, iterations=iterations, seconds=search.afterwards)


def _of_fit(after: Concluded, verdict: str) -> list[str]:
    """What the final fit says, but for how it was weighed: always by what is left.

    Where nothing is missing it does not say to look for it: a search has looked closer than one fit can.
    """
    known = {"weights", "unexplained"} if verdict == "none" else {"weights"}
    return [str(finding) for finding in after.fit.findings if finding.kind not in known]


def _with_fit(model: Model, concluded: Concluded) -> Model:
    """The model with fitted values and their sigmas."""
    settings = {}
    for p in concluded.fit.parameters:
        settings[p.name] = {"value": float(p.value), "unit": p.unit, "source": IDENTIFIED, "free": True}
        if np.isfinite(p.sigma):
            settings[p.name]["sigma"] = float(p.sigma)
    known = refitted(model.provenance, made_by_fit(concluded.fit), fitted_beside(model.flat, settings))
    return model.with_settings(settings, known)


# -- what judges -------------------------------------------------------------------------------------------------------
def _closed_where_it_counts(finals: Finals, data: Split) -> float:
    """Share of the gap closed on the recordings that took no part; 1 where they show no gap or there are none."""
    if not data.report or finals.after is finals.before:
        return 1.0
    was, now = pooled_rmse(finals.before.residuals_report), pooled_rmse(finals.after.residuals_report)
    return gap_closed(was, now, data.noise) if np.any(was**2 > LARGE * data.noise**2) else 1.0


def _only_elsewhere(said: Standing, finals: Finals, data: Split) -> list[str]:
    """Recordings that judge and show a large gap, when those of the fit show none."""
    if said.verdict != "none":
        return []
    judged = zip(data.report, finals.before.residuals_report, strict=True)
    return [recording.name for recording, r in judged if has_gap([r], data.noise, LARGE).any()]


def _doubts(said: Standing, finals: Finals, data: Split) -> dict[str, float]:
    """What is left of the probability of an effect, by label, where what judges is explained better without it."""
    left = {}
    for label, other in finals.without.items():
        with_it, without = pooled_rmse(finals.after.residuals_report), pooled_rmse(other)
        gain = float(np.nansum(np.log(np.fmax(with_it, data.noise) / np.fmax(without, data.noise))))
        if gain > 0.05:
            left[label] = float(np.exp(-2 * gain))
    return left


# -- what is told ------------------------------------------------------------------------------------------------------
def _steps(said: Standing, finals: Finals, doubts: Mapping[str, float]) -> tuple[NamedStep, ...]:
    """The named effects, the one that explains most alone first."""
    named, before = [], []
    for c in said.order:
        members = said.members(c)
        own = {**finals.rivals, c.label: finals.after}
        rows = rows_of(said, tuple(before), c, doubts, own)
        first = next(r for r in rows if r.fate == "named")
        named.append(
            NamedStep(
                effect=c.id,
                site=c.site.name,
                title=c.effect.title,
                equation=c.effect.equation,
                source=c.effect.source,
                members=tuple((m.id, m.site.name) for m in members),
                probability=said.probability(c.label) * doubts.get(c.label, 1.0),
                parameters=concluded_values(c, finals.after),
                gap_closed=_closed_by(said, [*before, c], first),
                ranked=rows,
                together=_together(said, c),
                sentence=c.effect.experiment,
                beside=tuple((m.id, m.site.name) for m in before),
            )
        )
        before.append(c)
    return tuple(named)


def _closed_by(said: Standing, members: Sequence[Candidate], row: Ranked) -> float:
    """Share of the base's gap that the effects so far close."""
    entry = said.table.entry(members)
    return closed(said.table, entry) if entry.fitted else row.gap_closed


def _together(said: Standing, c: Candidate) -> tuple[tuple[str, str], ...]:
    """The others that are needed beside an effect: those without which it was never fitted, or explains nothing."""
    alone = said.table.entry([c])
    closes = alone.fitted and said.table.share(alone) < 0.9
    others = [m for m in said.best.members if m is not c]
    return () if closes or not others else tuple((m.id, m.site.name) for m in others)


def _experiment(search: Search, said: Standing, data: Split):
    """The input that separates the members of the class best."""
    entries = [search.table.entries[k] for k in said.class_[:MEMBERS]]
    members = [(" + ".join(e.key), search.table.model(e).flat, dict(e.fitted.values), e.fitted.states) for e in entries]
    return next_experiment(members, search.table.base.flat.inputs, data.train, search.table.question)


def _not_testable(said: Standing) -> tuple[Ranked, ...]:
    """Candidates that would not show in these recordings, whatever their size."""
    found = []
    for c in said.table.candidates:
        entry = said.table.entries.get((c.label,))
        if entry and not entry.failed and not testable(entry.fitted or entry.look, c) and entry is not said.kept:
            nan, why = float("nan"), "it would not show in these recordings, whatever its size"
            found.append(
                Ranked(c.id, c.site.name, c.effect.title, c.effect.equation, 0.0, nan, nan, 0.0, "not testable", why)
            )
    return tuple(found)


def _shifts(finals: Finals) -> tuple[Shift, ...]:
    rows = {p.name: p for p in finals.after.fit.parameters}
    both = [(p, rows[p.name]) for p in finals.before.fit.parameters if p.name in rows]
    return tuple(Shift(p.name, p.unit, p.value, p.sigma, new.value, new.sigma, new.at_bound) for p, new in both)


def _waterfall(said: Standing) -> tuple[Rung, ...]:
    """What the search left in units of the sensors' noise, base first, after every effect."""
    table = said.table

    def left(entry: Entry) -> float:
        return float(np.sqrt(np.nanmean((entry.fitted.rmse / table.noise) ** 2)))

    rungs = [Rung("identified base", left(table.entry()))]
    order = said.order if said.kept.members else ()
    for k in range(1, len(order) + 1):
        entry = table.entry(order[:k])
        if entry.fitted:
            rungs.append(Rung(order[k - 1].label, left(entry)))
    return tuple(rungs)
