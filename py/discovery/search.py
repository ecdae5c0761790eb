"""The search: forward from the identified model, one effect or pair at a time, with a look back."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.model import Model

from .decide import CLEARLY, MEASURABLE, bic_needed, compared, has_gap
from .probing import ProbeJob, amplitudes, best_amplitude, probe, seen_by_parts
from .refit import Question, RefitJob, refit
from .screen import Screen, Screened
from .structure import Structure, Tried, label_of

SHORTLIST = 14
PER_EFFECT = 2  # sites of one effect in a shortlist
LEAST_EVIDENCE = 3.0  # predicted, of L with effective samples: a third of what passing takes
LEAST_OF_BEST = 0.02
LARGE_GAIN = 0.3  # of the best plain gain: a slow drift is worth few samples until something explains it
PAIRED = 6  # candidates of which pairs are tried
PAIRS = 6
ALMOST = 0.1  # of the gap: how much less than the most an effect explains whose refinements are tried
CONVINCING = 0.8  # closed by one effect alone: pairs need not be tried
REFINED = 0.1  # of the simple effect's evidence: what a refinement must promise beyond it
HEAVY = 5.0  # times the operations of the base
SEVERAL = 3  # starts followed for limits, thresholds and refinements, whose first cost says little
NEAR = 2.0  # times the noise: where the hollows of a cost are as deep as what is to be told apart


@dataclass(eq=False)
class Search:
    """What a search knows: the base model, its candidates, the recordings, and how jobs are run."""

    base: Model
    free: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    question: Question
    run: Callable[[Callable, Sequence, str], list]
    report: Callable[[str, int, int, str], None]
    told: tuple[bool, ...] = ()  # outputs whose noise the user gave
    first: Mapping[str, float] = field(default_factory=dict)  # base parameters where the identification began
    first_size: np.ndarray | None = None  # (ny,) what a residual cost there
    sensors: np.ndarray = None  # noise (ny,) of the sensors, SI; the question's may hold more
    unusable: dict[str, str] = field(default_factory=dict)  # label -> why it cannot be added
    not_testable: dict[str, Screened] = field(default_factory=dict)
    hints: dict[tuple[str, ...], Mapping[str, float]] = field(default_factory=dict)  # where fits may begin, too
    _big: FlatModel | None = None
    _models: dict[tuple[str, ...], Model] = field(default_factory=dict)
    _known: dict[tuple[str, ...], Structure | str] = field(default_factory=dict)
    _seen: tuple = (None, None)  # the structure and the question that were screened last, which candidates, and how

    def __post_init__(self):
        self.sensors = self.question.noise if self.sensors is None else self.sensors
        self.told = self.told or (False,) * len(self.question.noise)
        self.first = self.first or {p.name: p.value for p in self.base.flat.parameters if p.name in self.free}
        missing = [o.name for o, n in zip(self.base.flat.outputs, self.question.counts, strict=True) if not n]
        unseen = [c for c in self.candidates if c.site.through in missing]  # faults of sensors that are not there
        self.candidates = tuple(c for c in self.candidates if c not in unseen)
        self.not_testable |= {c.label: Screened(c, 0.0, 0.0, 0.0, 0.0, c.neutral, np.zeros(0)) for c in unseen}

    def ask(self, noise: np.ndarray) -> bool:
        """Go on with another noise (ny,); fits under the old one are not comparable. Whether it is another one."""
        if np.array_equal(noise, self.question.noise, equal_nan=True):
            return False
        inexact = not np.array_equal(noise, self.sensors, equal_nan=True)
        self.question = dataclasses.replace(self.question, noise=noise, inexact=inexact)
        return self.forget()

    def asking(self, question: Question) -> Search:
        """A search of the same model and candidates that begins with another question."""
        return dataclasses.replace(
            self, question=question, sensors=question.noise, unusable=dict(self.unusable), not_testable={}, hints={},
            _known={}, _seen=(None, None),
        )  # fmt: skip

    def forget(self) -> bool:
        """Fit every structure anew from here on. True."""
        self._known.clear()
        return True

    # -- models -------------------------------------------------------------------------------------------------
    def model(self, members: Sequence[Candidate]) -> Model:
        """The base with candidates added, in the order of the catalogue."""
        order = {c.label: i for i, c in enumerate(self.candidates)}
        chosen = sorted(members, key=lambda c: order[c.label])
        key = tuple(c.label for c in chosen)
        if key not in self._models:
            self._models[key] = self.base.plus([c.addition for c in chosen], sought=True) if chosen else self.base
        return self._models[key]

    @property
    def big(self) -> FlatModel:
        """Every usable candidate at neutral in one model; what does not fit beside the others is left out."""
        if self._big is None:
            usable = list(self.candidates)
            try:
                self._big = self.model(usable).flat
            except HydrotwinError:
                usable = [c for c in usable if self._fits(c)]
                self.candidates = tuple(usable)
                self._big = self.model(usable).flat
        return self._big

    def models_ahead(self) -> Iterator[None]:
        """Make, one at a time, the models a screen is sure to need: of all candidates, then of each to be probed."""
        _ = self.big
        for candidate in [c for c in self.candidates if hasattr(c.effect, "probes_for")]:
            yield
            with contextlib.suppress(HydrotwinError):  # told where it is used
                _ = self.model((candidate,)).flat

    def _fits(self, candidate: Candidate) -> bool:
        try:
            _ = self.model([candidate]).flat
        except HydrotwinError as error:
            self.unusable[candidate.label] = str(error)
            return False
        return True

    def names(self, members: Sequence[Candidate]) -> tuple[str, ...]:
        """Free parameters of a structure."""
        return tuple(dict.fromkeys([*self.free, *(n for c in members for n in c.free)]))

    # -- one step -----------------------------------------------------------------------------------------------
    def screened(self, now: Structure, among: Sequence[Candidate] | None = None) -> tuple[Screen, list[Screened]]:
        """All candidates (or those ``among`` them) that are not in the structure yet, the most promising first.

        Nor is what a member refines: of a finer form it is a part.
        """
        _ = self.big
        rest = {c.label: c for c in (self.candidates if among is None else among) if not now.holds(c)}
        if self._seen[:2] != (now, self.question) or not rest.keys() <= self._seen[2]:
            beside = None if among is None else [*now.members, *rest.values()]
            self._seen = (now, self.question, rest.keys(), *self._screened(now, list(rest.values()), beside))
        *_, screen, ranked = self._seen
        return screen, [s for s in ranked if s.candidate.label in rest]

    def _screened(
        self, now: Structure, rest: Sequence[Candidate], among: Sequence[Candidate] | None = None
    ) -> tuple[Screen, list[Screened]]:
        """Those in ``rest``, in one model with ``among``; with all candidates, whose model is made once, when None."""
        self.report("screen", 0, len(rest), "")
        model = self.model(self.candidates if among is None else among)
        screen = Screen(model.flat, self.names(now.members), rest, now.fitted, self.question)
        rest = rest if now.members else self._lean(rest, screen)
        probing = [c for c in rest if hasattr(c.effect, "probes_for")]
        seen = seen_by_parts(model, screen, probing)
        plain = {c.label: screen.by_derivative(c) for c in rest}
        blind = [c for c in rest if c.label in seen or not plain[c.label].visible > 0]
        jobs = [self._probe_job(now, c, amplitudes(c, seen.get(c.label))) for c in blind]
        for c, job, runs in zip(blind, jobs, self.run(probe, jobs, "probe"), strict=True):
            plain[c.label] = best_amplitude(screen, plain[c.label], job, runs)
        found = list(plain.values())
        for s in found:
            if not s.testable:
                self.not_testable[s.candidate.label] = s
        return screen, sorted(found, key=lambda s: -s.evidence)

    def _lean(self, rest: Sequence[Candidate], screen: Screen) -> list[Candidate]:
        """The candidates without what they look for only where the recordings show it; here they do not."""
        lean = {}
        for c in rest:
            hidden = {f"{c.name}.{p}" for p in c.site.also_free} & set(c.free)
            hidden = {n for n in hidden if not screen.seen_alone(c, n)}
            kept = tuple(n for n in c.free if n not in hidden)
            lean[c.label] = dataclasses.replace(c, free=kept, neutral={n: c.neutral[n] for n in kept}) if hidden else c
        self.candidates = tuple(lean.get(c.label, c) for c in self.candidates)
        return list(lean.values())

    def _probe_job(self, now: Structure, candidate: Candidate, values: Sequence[Mapping[str, float]]) -> ProbeJob:
        flat = self.model([*now.members, candidate]).flat
        return ProbeJob(flat, self.question, now.fitted, tuple(values), candidate.label)

    def shortlist(self, ranked: Sequence[Screened]) -> list[Screened]:
        """The candidates worth a refit, and the simpler effects that they refine."""
        chosen: list[Screened] = []
        least = max(LEAST_EVIDENCE, LEAST_OF_BEST * max((s.evidence for s in ranked), default=0.0))
        most = max((s.gain for s in ranked), default=0.0)
        by_gain = sorted(ranked, key=lambda s: (not s.beyond, -s.gain))
        promising = [s for s in by_gain if s.beyond or s.gain > LARGE_GAIN * most][: SHORTLIST // 2]
        for s in (*promising, *(s for s in ranked if s.evidence > least)):
            same = 0 if s in promising else sum(k.candidate.id == s.candidate.id for k in chosen)
            if s not in chosen and same < PER_EFFECT and len(chosen) < SHORTLIST:
                chosen.append(s)
        for s in ranked:
            if s not in chosen and any(c.candidate.refines(s.candidate) for c in chosen):
                chosen.append(s)
        return [s for s in chosen if not self._no_better_than_simple(s, chosen)]

    @staticmethod
    def _no_better_than_simple(one: Screened, chosen: Sequence[Screened]) -> bool:
        """A refinement that promises no more than the simple effect at its site waits until that is named."""
        simple = [s for s in chosen if one.candidate.refines(s.candidate)]
        if not simple:
            return False
        evidence, gain = max(s.evidence for s in simple), max(s.gain for s in simple)
        more = one.evidence > evidence + max(LEAST_EVIDENCE, REFINED * evidence)
        return not (more or one.gain > (1 + REFINED) * gain + LEAST_EVIDENCE)

    # -- refits -------------------------------------------------------------------------------------------------
    def refitted(self, now: Structure, groups: Sequence[tuple[Sequence[Candidate], Sequence[Mapping]]]) -> list[Tried]:
        """``now`` with each group of candidates added, fitted; starts are values by path."""
        jobs, index = [], []
        for k, (group, starts) in enumerate(groups):
            members = self.joined(now, group)
            key = tuple(sorted(c.label for c in members))
            if key not in self._known:
                jobs.append(self._job(now, members, [*starts, *([self.hints[key]] if key in self.hints else [])]))
                index.append(k)
        answers = self.run(refit, jobs, "refit")
        for k, answer in zip(index, answers, strict=True):
            members = self.joined(now, groups[k][0])
            key = tuple(sorted(c.label for c in members))
            self._known[key] = answer if isinstance(answer, str) else Structure(members, answer)
        tried = []
        for group, _ in groups:
            key = tuple(sorted(c.label for c in self.joined(now, group)))
            known = self._known[key]
            if isinstance(known, str):
                tried.append(Tried(tuple(group), None, reason=known))
            else:
                tried.append(Tried(tuple(group), None, known, compared(known.fitted, now.fitted, self.question)))
        return tried

    @staticmethod
    def joined(now: Structure, group: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Members with a group added; a refinement takes the place of the simple effect."""
        return (*(m for m in now.members if not any(c.refines(m) for c in group)), *group)

    def _job(self, now: Structure, members: Sequence[Candidate], starts: Sequence[Mapping[str, float]]) -> RefitJob:
        flat = self.model(members).flat
        known, free = {p.name for p in flat.parameters}, self.names(members)
        base = {n: v for n, v in now.fitted.values.items() if n in free}  # not what only ``now`` frees
        neutral = {n: v for c in members for n, v in c.neutral.items() if n not in base}
        points = tuple({**neutral, **base, **_known(start, known)} for start in starts) or ({**neutral, **base},)
        label = " + ".join(c.label for c in members)
        added = [c for c in members if c not in now.members]
        several = any(hasattr(c.effect, "probes_for") or c.effect.refines for c in added) and not self._heavy(flat)
        return RefitJob(
            flat, free, self.question, points, now.fitted.states, now.fitted.size,
            follow=SEVERAL if several else 1, label=label,
        )  # fmt: skip

    def refit_of(self, structure: Structure, values: Mapping[str, float] | None = None, **settings) -> RefitJob:
        """A structure's fit once more, from where it (or a larger one) stands, or from other ``values`` by path."""
        members, fitted = structure.members, structure.fitted
        settings = {"states": fitted.states, "size": fitted.size, **settings}
        flat, names = self.model(members).flat, self.names(members)
        start = _known({**fitted.values, **(values or {})}, names)
        return RefitJob(flat, names, self.question, (start,), label=label_of(members), **settings)

    def _heavy(self, flat: FlatModel) -> bool:
        """Whether its equations cost many times those of the base: a loop is solved at every step."""
        base = self.base.flat
        return not base.black_box and flat.ode.n_instructions() > HEAVY * base.ode.n_instructions()

    def keep(self, structure: Structure) -> Structure:
        """Remember a better fit of a structure."""
        self._known[tuple(sorted(structure.key))] = structure
        return structure

    def lower(self, structure: Structure) -> Structure:
        """This fit of a structure, or the one known where that is lower."""
        known = self._known.get(tuple(sorted(structure.key)))
        stays = isinstance(known, Structure) and known.fitted.likelihood <= structure.fitted.likelihood
        return known if stays else self.keep(structure)

    def judged(self, tried: Tried, now: Structure) -> Tried:
        """The evidence of a candidate against another structure."""
        if tried.structure is None:
            return tried
        evidence = compared(tried.structure.fitted, now.fitted, self.question)
        return dataclasses.replace(tried, evidence=evidence)

    def starts_of(self, screened: Screened) -> list[Mapping[str, float]]:
        """Where refits of a candidate begin: the screen's proposal, then its probes.

        Never at neutral itself: where the derivative is nil there, a refit would not leave it.
        """
        c = screened.candidate
        if not screened.gain > 0:
            return [*c.probes]
        return [{**screened.beside, **screened.start}, screened.start, *c.probes]

    def singles(self, now: Structure, shortlist: Sequence[Screened]) -> list[Tried]:
        """Every shortlisted candidate alone."""
        groups = [((s.candidate,), self._starts_in(now, s)) for s in shortlist]
        tried = self.refitted(now, groups)
        return [dataclasses.replace(t, screened=s) for t, s in zip(tried, shortlist, strict=True)]

    def _starts_in(self, there: Structure, screened: Screened) -> list[Mapping[str, float]]:
        """Starts of a candidate beside or, when it refines one of them, in the place of a structure's members."""
        c, starts = screened.candidate, self.starts_of(screened)
        simple = next((m for m in there.members if c.refines(m)), None)
        if simple is None:
            return starts
        same = c.containing(simple, there.fitted.values)
        moved = {n: v + same.get(n, 0.0) for n, v in screened.start.items()}
        points = ({**c.neutral, **same}, moved, *({**probe, **same} for probe in c.probes))
        return [{**there.fitted.values, **point} for point in points]

    def finer(self, now: Structure, ranked: Sequence[Screened], tried: Sequence[Tried]) -> list[Tried]:
        """Refinements of effects that explain almost as much as the most: they may explain more than any."""
        passing = [t for t in tried if t.evidence and t.evidence.passes(len(self.candidates)) and len(t.members) == 1]
        most = max((t.evidence.closed for t in passing), default=0.0)
        near = [t for t in passing if most - ALMOST < t.evidence.closed < most]
        known = {t.members[0].label for t in tried}
        found = [(s, t) for t in near for s in ranked if s.candidate.refines(t.members[0])]
        found = [(s, t) for s, t in found if s.candidate.label not in known]
        groups = [((s.candidate,), self._starts_in(t.structure, s)) for s, t in found]
        refitted = self.refitted(now, groups)
        return [dataclasses.replace(t, screened=s) for t, (s, _) in zip(refitted, found, strict=True)]

    def pairs(
        self, now: Structure, screen: Screen, ranked: Sequence[Screened], singles: Sequence[Tried]
    ) -> list[Tried]:
        """The pairs whose linear prediction gains most beyond the better of the two."""
        simple = {s.candidate.id for s in ranked}
        usable = [s for s in ranked if s.evidence > 0 and not set(s.candidate.effect.refines) & simple][: 2 * PAIRED]
        fitted = {t.members[0].label: t for t in singles if t.structure}
        scored = []
        for one, other in itertools.combinations(usable, 2):
            scored.append((screen.joint_gain(one, other), one, other))
        scored.sort(key=lambda row: -row[0])
        groups = []
        for beyond, one, other in scored[:PAIRS]:
            if beyond < LEAST_EVIDENCE:
                break
            starts = [{**one.start, **other.start}]
            for a, b in ((one, other), (other, one)):
                known = fitted.get(a.candidate.label)
                if known:
                    own = {n: known.structure.fitted.values[n] for n in a.candidate.free}
                    starts.append({**known.structure.fitted.values, **own, **b.start})
            groups.append(((one.candidate, other.candidate), starts))
        return self.refitted(now, groups)

    def explained(self, now: Structure) -> bool:
        """No measurable gap is left on the recordings of the search; after a first name it must ask for a reason.

        No equation of the catalogue is exactly the machine's: what is left of it is coloured, and no further effect.
        """
        return not self.leaves(now, CLEARLY if now.members else MEASURABLE)

    def leaves(self, now: Structure, more: float, noise: np.ndarray | None = None) -> bool:
        """Whether some output leaves ``more`` than the noise (ny,) squared (the question's if None), and not white."""
        residuals = (*now.fitted.residuals_fit, *now.fitted.residuals_select)
        return bool(has_gap(residuals, self.question.noise if noise is None else noise, more).any())

    def spotless(self, tried: Tried) -> bool:
        """Whether it leaves nothing that can be measured."""
        return tried.structure is not None and not self.leaves(tried.structure, MEASURABLE)

    def near_noise(self, now: Structure) -> bool:
        """Whether every output leaves little more than noise."""
        with np.errstate(invalid="ignore"):
            return bool(np.nanmax(now.fitted.rmse / self.question.noise) < NEAR)

    def refining(self, now: Structure) -> list[Candidate]:
        """The finer forms of named effects that the catalogue holds."""
        return [c for c in self.candidates if any(c.refines(m) for m in now.members)]

    def refinements(self, now: Structure, ranked: Sequence[Screened]) -> list[Screened]:
        """The candidates that refine a member of the structure and promise something."""
        return [s for s in ranked if s.candidate in self.refining(now) and s.evidence > LEAST_EVIDENCE]

    @property
    def needed(self) -> float:
        """BIC that a name must gain."""
        return bic_needed(len(self.candidates))


def _known(values: Mapping[str, float], names: Collection[str]) -> dict[str, float]:
    return {n: v for n, v in values.items() if n in names}
