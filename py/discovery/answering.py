"""From the end of a search to a Discovery: final fits, verdict, and everything that shows it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.model import Model

from .choose import Choice, label
from .decide import CLEARLY, INEXACT, closed, has_gap, output_gap_closed, share_closed
from .discovery import Discovery, OutputGap, Overlay, RecordingGap, Rung, Shift
from .discovery import Step as NamedStep
from .experiment import next_experiment
from .lasting import Change, changing
from .locate import locations
from .ranking import concluded_values, ranking, untestable
from .recordings import Split
from .refit import Concluded, Question, RefitJob, conclude, pooled_rmse
from .regions import regions
from .screen import Screened
from .search import Search
from .structure import Structure, Tried
from .unknown import describe_unknown
from .verdict import (
    CONFIRMED,
    closed_where_it_counts,
    doubted,
    findings_of,
    likeliest,
    not_excited,
    only_elsewhere,
    unconfirmed,
    verdict_of,
)

MOST_RIVALS = 4  # fits of what is told beside what is named
SOUND = 0.95  # of names, those that prove right however sure the evidence is: from 89 of the benchmark, see its README


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the search: what was chosen out of what, and the structure before.

    revised : label of an effect -> the same made again with all the others in place.
    """

    choice: Choice
    ranked: tuple[Screened, ...]
    tried: tuple[Tried, ...]
    before: Structure
    revised: Mapping[str, Step] = field(default_factory=dict)

    def choices(self) -> list[Choice]:
        """The last choice of every effect of the step; of those named together, only where it was made again."""
        last = [self.revised[c.label].choice for c in self.choice.best.members if c.label in self.revised]
        return last or [self.choice]


@dataclass(frozen=True, eq=False)
class Found:
    """Where a search ended: the base, the last structure, the steps to it; per forward step the screen."""

    base: Structure
    last: Structure
    steps: tuple[Step, ...]
    screens: tuple


def answer(search: Search, data: Split, found: Found, model: Model) -> Discovery:
    """The Discovery of a finished search; ``model`` is what the user gave, with its own bounds."""
    q = search.question
    data = dataclasses.replace(data, fit=q.fit, select=q.select, noise=search.sensors)  # as the search left them
    verdict = verdict_of(search, found)
    likely = likeliest(search, found) if verdict != "none" else None
    change = changing(search, likely or found.base, found.base) if verdict != "none" else None
    verdict = "unknown" if change else verdict
    kept = found.last if verdict in ("named", "class") else found.base
    rivals = _rivals(found.steps) if verdict in ("named", "class") else {}
    parts = {f"without {c.label}": kept.without(c) for c in kept.members if data.report and len(kept.members) > 1}
    final = dataclasses.replace(q, fit=data.train, select=data.report)
    before, after, others = _concluded(search, final, found.base, kept, {**rivals, **parts})
    shown = closed_where_it_counts(before, after, data)
    elsewhere = only_elsewhere(search, found.base, before, data)
    verdict = "unknown" if verdict == "none" and elsewhere else verdict
    if kept is found.last and shown < CONFIRMED:
        verdict, kept, after = "unknown", found.base, before
    steps = found.steps if kept is found.last else ()
    doubts = doubted(kept.members, others, after, final)
    flat = search.base.flat
    view = View(flat, data, before, after)
    share = max(min(closed(found.last.fitted, found.base.fitted, search.question), shown), 0.0)
    known = {p.name: p for p in search.big.parameters} if found.screens or steps else {}
    members = [
        named
        for step in steps
        for named in _named(step, after, share * _weight(search, found.base, step), known, others, doubts)
    ]
    experiment = _experiment(search, data, steps) if verdict == "class" and not flat.black_box else None
    residual = after.refitted.residuals_fit
    unknown = ()
    if verdict == "unknown" or has_gap(residual, data.noise, CLEARLY).any():
        unknown = describe_unknown(flat, *_by_role(data, residual), data.noise)
    last = found.screens[-1] if found.screens else (None, (), ())
    named = any(c in kept.members for t in last[2] for c in t.members)  # what was looked at last was not in vain
    added = search.model(kept.members).additions[len(model.additions) :]  # an answer may be asked what it lacks
    final = model.plus(added) if added else model
    return Discovery(
        name=search.base.name,
        verdict=verdict,
        reason=_without_name(search, data, found, elsewhere, change) if verdict == "unknown" else "",
        steps=tuple(members),
        base=_with_fit(model, before),
        model=_with_fit(final, after),
        fit_before=before.fit,
        fit_after=after.fit,
        noise={n.name: float(s) for n, s in zip(flat.outputs, data.noise, strict=True) if np.isfinite(s)},
        outputs={"train": view.pooled("train"), "validate": view.pooled("report")},
        recordings=view.by_recording(),
        locations=locations(flat, data.train, before.refitted.residuals_fit, data.noise),
        regions=regions(flat, data.train, before.refitted.residuals_fit, residual, data.noise),
        overlays=view.overlays(),
        shifts=_shifts(search, before, after),
        waterfall=_waterfall(search, found, steps),
        last_ranked=() if named else ranking(last[1], last[2], None, known),
        unknown=tuple(unknown),
        experiment=experiment,
        findings=(
            *data.findings,
            *findings_of(search, found, verdict, shown, change is not None, [*doubts]),
            *_of_fit(after, verdict),
        ),
        not_testable=tuple(untestable(s) for s in search.not_testable.values()),
        screened=len(search.candidates),
        fitted=len(_fitted(found)),
        provenance={r.name: r.digest for r in (*data.train, *data.report) if r.digest},
    )


def _fitted(found: Found) -> set[str]:
    """The candidates that were fitted, alone or with others, in any look."""
    looks = [*(tried for _, _, tried in found.screens), *(s.tried for s in found.steps)]
    looks += [again.tried for s in found.steps for again in s.revised.values()]
    return {c.label for tried in looks for t in tried if t.structure for c in t.members}


def _without_name(search: Search, data: Split, found: Found, elsewhere: Sequence[str], change: Change | None) -> str:
    """What to say of a gap that gets no name, where it is known why."""
    if change:
        return change.told()
    return not_excited(search, data, elsewhere) if elsewhere else unconfirmed(search, found)


# -- final fits --------------------------------------------------------------------------------------------------------
def _rivals(steps: Sequence[Step]) -> dict[str, Structure]:
    """The other members of the classes, by label: what is told of them must come with intervals, too."""
    choices = [choice for step in steps for choice in step.choices()]
    others = [t for choice in choices for t in choice.members if label(t) != label(choice.best) and t.structure]
    return {label(t): t.structure for t in others[:MOST_RIVALS]}


def _concluded(search: Search, q: Question, base: Structure, last: Structure, others: Mapping[str, Structure]):
    """Structures fitted to the recordings of ``q`` and run on those that judge: base, last, and others by name."""
    needed = [base] if last is base else [base, last]
    jobs = [fitted_to(search, q, structure) for structure in (*needed, *others.values())]
    answers = search.run(conclude, jobs, "final fit")
    for one in answers[: len(needed)]:
        if isinstance(one, str):
            raise SolveError(one)
    named = zip(others, answers[len(needed) :], strict=True)
    return answers[0], answers[len(needed) - 1], {name: one for name, one in named if not isinstance(one, str)}


def fitted_to(search: Search, q: Question, structure: Structure) -> RefitJob:
    """Its fit to the recordings of ``q``, from where it stands in those of the search."""
    known = dict(zip((r.name for r in search.question.fit), structure.fitted.states, strict=True))
    states = tuple(known.get(r.name, {}) for r in q.fit)
    return dataclasses.replace(search.refit_of(structure, states=states), question=q)


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
        settings[p.name] = {"value": float(p.value), "unit": p.unit, "source": "identified", "free": True}
        if np.isfinite(p.sigma):
            settings[p.name]["sigma"] = float(p.sigma)
    return model.with_settings(settings, {"recordings": dict(concluded.fit.provenance)})


def _by_role(data: Split, left: Sequence[np.ndarray]):
    """Recordings and what is ``left`` of them, of those that were fitted to; the same of those that only chose.

    Those that judge choose no description either.
    """
    of = dict(zip((r.name for r in data.train), left, strict=True))
    chose = tuple(r for r in data.select if r.name not in {f.name for f in data.fit})
    return data.fit, [of[r.name] for r in data.fit], chose, [of[r.name] for r in chose]


# -- steps -------------------------------------------------------------------------------------------------------------
def _weight(search: Search, base: Structure, step: Step) -> float:
    """How sure it is that a step's effect is none of what the inexact forms of those before it leave.

    Some part remains for what no catalogue has, and for what another minimum of the fits would have shown.
    """
    after = step.choice.best.structure
    left = 1 - share_closed(base.fitted, step.before.fitted, after.fitted, search.question)
    return SOUND * left / (left + INEXACT) if left > 0 else 0.0


def _named(
    step: Step,
    after: Concluded,
    explained: float,
    known: Mapping,
    rivals: Mapping[str, Concluded],
    doubts: Mapping[str, float],
) -> list[NamedStep]:
    """The named effect of a step; two for a pair, the one that explains more alone first."""
    best = step.choice.best
    alone = {t.members[0].label: t for t in step.tried if len(t.members) == 1 and t.structure}

    def by_itself(c) -> float:
        return alone[c.label].evidence.closed if c.label in alone else -np.inf

    there = [c for c in best.members if not c.free or any(n in after.fit.values for n in c.free)]
    order = sorted(there, key=by_itself, reverse=True)
    named = []
    for c in order:
        closed_alone = by_itself(c) if c is not order[-1] and np.isfinite(by_itself(c)) else best.evidence.closed
        last = step.revised.get(c.label, step)
        choice = last.choice
        final = {**rivals, label(choice.best): after}
        sure = explained * doubts.get(c.label, 1.0)
        alike = [t for t in choice.members if len(t.members) == 1]
        members = [(t.members[0].id, t.members[0].site.name) for t in alike] or [(c.id, c.site.name)]
        named.append(
            NamedStep(
                effect=c.id,
                site=c.site.name,
                title=c.effect.title,
                equation=c.effect.equation,
                source=c.effect.source,
                members=tuple(members),
                probability=choice.probability[label(choice.best)] * sure,
                parameters=concluded_values(c, after),
                gap_closed=closed_alone,
                ranked=ranking(last.ranked, last.tried, choice, known, sure, final),
                together=tuple((o.id, o.site.name) for o in order if o is not c),
                sentence=c.effect.experiment,
                beside=tuple((m.id, m.site.name) for m in last.before.members),
            )
        )
    return named


def _experiment(search: Search, data: Split, steps: Sequence[Step]):
    """The input that separates the members of the last class best."""
    choice = next(choice for step in reversed(steps) for choice in step.choices() if len(choice.members) > 1)
    members = [
        (label(t), search.model(t.structure.members).flat, dict(t.structure.fitted.values), t.structure.fitted.states)
        for t in choice.members[:3]
    ]
    return next_experiment(members, search.base.flat.inputs, data.fit, search.question)


# -- figures -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class View:
    """Residuals before and after, by role and recording."""

    flat: object
    data: Split
    before: Concluded
    after: Concluded

    def _pairs(self, role: str):
        d = self.data
        if role == "train":
            return list(
                zip(d.train, self.before.refitted.residuals_fit, self.after.refitted.residuals_fit, strict=True)
            )
        return list(zip(d.report, self.before.residuals_report, self.after.residuals_report, strict=True))

    def _gaps(self, before: np.ndarray, after: np.ndarray) -> tuple[OutputGap, ...]:
        rows = zip(self.flat.outputs, self.data.noise, before, after, strict=True)
        return tuple(
            OutputGap(s.name, s.unit, float(n), float(b), float(a), output_gap_closed(b, a, n))
            for s, n, b, a in rows
            if np.isfinite(n) and not np.isnan(b)  # infinite: a run diverged, and that must be seen
        )

    def pooled(self, role: str) -> tuple[OutputGap, ...]:
        """Over all recordings of a role."""
        pairs = self._pairs(role)
        if not pairs:
            return ()
        _, before, after = zip(*pairs, strict=True)
        return self._gaps(pooled_rmse(before), pooled_rmse(after))

    def by_recording(self) -> tuple[RecordingGap, ...]:
        """Each recording, with the role it had."""
        selecting = {r.name for r in self.data.select} - {r.name for r in self.data.fit}
        rows = []
        for role in ("train", "report"):
            for recording, before, after in self._pairs(role):
                kind = "report" if role == "report" else "select" if recording.name in selecting else "fit"
                rows.append(RecordingGap(recording.name, kind, self._gaps(pooled_rmse([before]), pooled_rmse([after]))))
        return tuple(rows)

    def overlays(self) -> tuple[Overlay, ...]:
        """Measured, before and after on every recording, those never used first."""
        rows = []
        for role in ("report", "train"):
            for recording, before, after in self._pairs(role):
                seen = [j for j in range(len(self.flat.outputs)) if np.isfinite(recording.y[:, j]).any()]
                names = [self.flat.outputs[j].name for j in seen]
                columns = (recording.y, recording.y + before, recording.y + after)
                measured, old, new = ({n: c[:, j] for n, j in zip(names, seen, strict=True)} for c in columns)
                inputs = {s.name: recording.u[:, j] for j, s in enumerate(self.flat.inputs)}
                rows.append(Overlay(recording.name, role, recording.time, measured, old, new, inputs))
        return tuple(rows)


def _shifts(search: Search, before: Concluded, after: Concluded) -> tuple[Shift, ...]:
    rows = {p.name: p for p in after.fit.parameters}
    found = []
    for p in before.fit.parameters:
        if p.name in rows:
            new = rows[p.name]
            found.append(Shift(p.name, p.unit, p.value, p.sigma, new.value, new.sigma, new.at_bound))
    return tuple(found)


def _waterfall(search: Search, found: Found, steps: Sequence[Step]) -> tuple[Rung, ...]:
    """What the search left in units of the sensors' noise, base first, after every step, on the recordings that chose.

    Behind the last step stands where the search ended: what became idle on the way is not in it any more.
    """
    noise = search.sensors

    def left(structure: Structure) -> float:
        residuals = structure.fitted.residuals_select or structure.fitted.residuals_fit
        ratio = pooled_rmse(residuals) / noise
        return float(np.sqrt(np.nanmean(ratio**2)))

    rungs = [Rung("identified base", left(found.base))]
    for step in steps:
        best = step.choice.best
        alone = [t for t in step.tried if t.structure and len(t.members) == 1 and t.members[0] in best.members]
        if len(best.members) > 1 and alone:
            first = max(alone, key=lambda t: t.evidence.closed)
            rungs.append(Rung(label(first), left(first.structure)))
        rungs.append(Rung(label(best), left(found.last if step is steps[-1] else best.structure)))
    return tuple(rungs)
