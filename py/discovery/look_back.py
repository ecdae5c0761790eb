"""Look back: both sides of a choice fitted again before a name stands, and members dropped that have become idle."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from hydrotwin.identification.valley import AVERAGED
from hydrotwin.models.effects import Candidate

from .choose import Choice, choose
from .decide import INEXACT, WORTH, bic_gain, compared, share_closed
from .refit import RefitJob, refit
from .search import LEAST_EVIDENCE, PER_EFFECT, Search
from .structure import Structure, Tried

FROM_BEGINNING = 10  # candidates
CONTENDERS = 12  # fitted again beside the best: nine effects on one pressure can be alike
RIVALS = 6  # fitted once more in the hollow of the most likely
ROUNDS = 2  # of it, when another has become the most likely
CONFUSABLE = 8  # candidates that the screen passed over
ALMOST_ALIKE = 0.05  # of the gap: how much less than the best a contender closes
PROMISED = 0.9  # of the drop of L that the screen expected of the best
SMALL = 0.3  # of its largest probe
LOOK_BACK = 3.0  # of L: what a second fit of the same structure must gain to count


def settled(
    search: Search, now: Structure, tried: Sequence[Tried], choice: Choice
) -> tuple[Structure, tuple[Tried, ...]]:
    """All sides of a choice fitted again: ``now`` from where the best ended, the contenders from the beginning.

    Any may have come to rest too early: a larger one would then be praised for a better fit of what was there already,
    leave something for the next effect to explain, or be held for worse than another. Effects that are known to leave
    the same traces take part though the screen saw nothing of them: it looks from a base that stands in for the best.
    They begin beside the best, and, where that says little, from the beginning: a hose that gives and a rod that gives
    are each fitted well by a base that the other would never lead to. Near the noise, where the hollows of a cost
    matter, the most likely looks along its valleys for lower minima; its rivals go on from where its base came to rest,
    for the hollows are those of the base.
    """
    best, near = choice.best, search.near_noise(now)
    fitted = best.structure.fitted
    back = search.refit_of(now, fitted.values, states=fitted.states)
    alike = _confusable(search, now, tried, best)
    tried = (*tried, *alike)
    again = _contenders(search, tried, choice, near)
    if near or _at_bound(now, best):
        again += [t for t in alike if t.structure and t not in again]
    begun = [(t, t.members[0].probes[0] if t in alike else {}) for t in again]
    jobs = [_from_first(search, t.structure, start) for t, start in begun]
    small = [t for t in again if near and _small(t)]
    again = [*again, *small]
    jobs += [_held(search, t) for t in small]
    *larger, smaller = search.run(refit, [*jobs, back], "look back")  # the longest first
    if not isinstance(smaller, str) and smaller.likelihood < now.fitted.likelihood - LOOK_BACK:
        now = search.keep(Structure(now.members, smaller))
    tried = improved(search, now, tried, again, larger)
    for t in _passing(search, tried[len(tried) - len(alike) :]):  # it shows, whatever the screen predicted
        search.not_testable.pop(t.members[0].label, None)
    if near and (passing := _passing(search, tried)):
        looks = along_valleys(search, passing[0].structure)
        tried = improved(search, now, tried, [passing[0]] * len(looks), search.run(refit, looks, "look back"))
    return now, _in_one_hollow(search, now, tried, near)


def _passing(search: Search, tried: Sequence[Tried]) -> list[Tried]:
    """What passes, the most likely first."""
    found = [t for t in tried if t.evidence and t.evidence.passes(len(search.candidates))]
    return sorted(found, key=lambda t: t.structure.fitted.likelihood)


def _in_one_hollow(search: Search, now: Structure, tried: tuple[Tried, ...], near: bool) -> tuple[Tried, ...]:
    """Rivals fitted once more, each from where the base of the most likely came to rest, and again if one is it then.

    Near the noise all that pass are rivals: which of them found the better hollow says nothing about the effects.
    Elsewhere what cannot be told apart.
    """
    before = None
    for _ in range(ROUNDS):
        choice = choose(tried, len(search.candidates), search.question)
        rivals = _passing(search, tried if near else choice.members)[: 1 + RIVALS] if choice else []
        if len(rivals) < 2 or rivals[0].members == before:
            break
        likely, *others = rivals
        there, base, before = likely.structure.fitted, search.names(now.members), likely.members
        values = {n: v for n, v in there.values.items() if n in base}
        jobs = [search.refit_of(t.structure, values, states=there.states) for t in others]
        tried = improved(search, now, tried, others, search.run(refit, jobs, "look back"))
    return tried


def improved(search: Search, now: Structure, tried: Sequence[Tried], again: Sequence[Tried], fits: Sequence):
    """``tried`` with those fitted ``again`` that are better for it."""
    better: dict[int, Tried] = {}
    for t, found in zip(again, fits, strict=True):
        known = better.get(id(t), t).structure
        if not isinstance(found, str) and found.likelihood < known.fitted.likelihood:
            better[id(t)] = dataclasses.replace(t, structure=search.keep(Structure(known.members, found)))
    return tuple(search.judged(better.get(id(t), t), now) for t in tried)


def _confusable(search: Search, now: Structure, tried: Sequence[Tried], best: Tried) -> list[Tried]:
    """What is listed as easily confused with the best and was not fitted yet, from where the base stands beside it.

    What the base does as well by itself is left out, unless one of its parameters rests on a bound.
    """
    if len(best.members) > 1:
        return []
    (chosen,), known = best.members, {c.label for t in tried for c in t.members} | set(now.key)
    absorbed = {name for name, s in search.not_testable.items() if not s.visible > np.finfo(float).tiny}
    same = set() if _at_bound(now, best) else absorbed
    alike = [
        c for c in search.candidates
        if c.label not in known | same and not c.refines(chosen) and not now.holds(c)
        and (c.id in chosen.effect.confused_with or chosen.id in c.effect.confused_with)
        and not _seen_beyond(search, now, best.structure, c)
    ][:CONFUSABLE]  # fmt: skip
    beside = {n: v for n, v in best.structure.fitted.values.items() if n not in chosen.free}
    groups = [((c,), [{**beside, **probe} for probe in c.probes]) for c in alike]
    found = search.refitted(Structure(now.members, best.structure.fitted), groups) if groups else []
    return [search.judged(t, now) for t in found]


def _at_bound(now: Structure, best: Tried) -> bool:
    """Whether the base stands in for an effect as far as it may go."""
    return bool(now.fitted.at_bound or best.structure.fitted.at_bound)


def _largest(candidate: Candidate) -> Mapping[str, float]:
    """The probe that is farthest from where the effect is absent."""
    return max(candidate.probes, key=lambda probe: max(abs(v - candidate.neutral[n]) for n, v in probe.items()))


def _small(t: Tried) -> bool:
    """Whether an effect came out far smaller than it may well be: the base may have taken the most of it.

    Two lags in a row can change places. A drive that the base holds for quick and an effect for slow fits as well as
    the opposite, and a fit that begins at one of them never sees the other.
    """
    (*_, added), values = t.members, t.structure.fitted.values
    absent = added.neutral
    return all(abs(values[n] - absent[n]) < SMALL * abs(v - absent[n]) for n, v in _largest(added).items())


def _seen_beyond(search: Search, now: Structure, best: Structure, candidate: Candidate) -> bool:
    """Whether the best explains more than a fault of this sensor could: something that other outputs show."""
    own = np.array([candidate.site.through == o.name for o in search.base.flat.outputs])
    if not own.any():
        return False
    others = dataclasses.replace(search.question, noise=np.where(own, np.inf, search.question.noise))
    return bic_gain(best.fitted, now.fitted, others) > search.needed


def _contenders(search: Search, tried: Sequence[Tried], choice: Choice, near: bool) -> list[Tried]:
    """The best, then those of its class or that explain almost as much, near the noise all that pass.

    There, too, those of which the screen expected almost as much as of the best: where the base has taken most of a
    late sensor, which of them finds a way out of its hollow is chance.
    """
    best = choice.best
    least = best.evidence.closed - ALMOST_ALIKE
    others = [t for t in _passing(search, tried) if near or t in choice.members or t.evidence.closed > least]
    if near:
        hidden = (t for t in tried if t.structure and promised(t) > PROMISED * promised(best))
        others += [t for t in hidden if t not in others]
    return [best, *(t for t in others if t is not best)][: 1 + CONTENDERS]


def promised(t: Tried) -> float:
    """What the screen expected of it, by L."""
    return t.screened.gain if t.screened else 0.0


def _from_first(search: Search, structure: Structure, effect: Mapping[str, float] = MappingProxyType({})) -> RefitJob:
    """A structure's fit again, its base parameters from where the identification began, an effect's from others."""
    again = {"states": (), "size": search.first_size, "coarse": True, "iterations": 40}
    return search.refit_of(structure, {**search.first, **effect}, **again)


def _held(search: Search, t: Tried) -> RefitJob:
    """Its fit from the beginning with a large effect, which stays until the base has given back what it took of it.

    Better too large than too small: a base that is far too quick beside it follows as soon as the effect is free, one
    that still stands in for the half of it takes it all back.
    """
    added = t.members[-1]
    job = _from_first(search, t.structure, _much(added))
    return dataclasses.replace(job, held=added.free)


def _much(candidate: Candidate) -> Mapping[str, float]:
    """The largest probe, each of its parameters as far from where the effect is absent as the catalogue calls usual."""
    found = {}
    for n, v in _largest(candidate).items():
        absent, usual = candidate.neutral[n], candidate.typical.get(n, (v, v))[v > candidate.neutral[n]]
        found[n] = max(v, usual, key=lambda value: abs(value - absent)) if v != absent else v
    return found


def along_valleys(search: Search, structure: Structure) -> list[RefitJob]:
    """A structure's fit again, each with a look along its valleys as averages over other times show them."""
    return [search.refit_of(structure, valley=periods) for periods in AVERAGED]


def from_the_beginning(search: Search, base: Structure) -> list[Tried]:
    """Candidates fitted together with the base from where that began, as the answer to a gap that nothing explains.

    The base identified without the effect may have bent until the screen no longer sees it: less volume for air. So
    candidates are screened where the base has hardly moved, and the most promising take part in an identification.
    """
    first = search.first
    job = RefitJob(search.base.flat, search.free, search.question, (first,), iterations=1, label=search.base.name)
    near = search.run(refit, [job], "look back")[0]
    if isinstance(near, str):
        return []
    _, ranked = search.screened(Structure((), near))
    jobs, chosen = [], []
    for s in sorted(ranked, key=lambda s: -s.gain):
        same = sum(k.candidate.id == s.candidate.id for k in chosen)
        if len(chosen) < FROM_BEGINNING and same < PER_EFFECT and s.gain > LEAST_EVIDENCE:
            chosen.append(s)
            start = {**first, **dict(s.candidate.probes[-1])}
            flat, names = search.model((s.candidate,)).flat, search.names((s.candidate,))
            label = s.candidate.label
            again = {"size": search.first_size, "coarse": True, "iterations": 40, "label": label}
            jobs.append(RefitJob(flat, names, search.question, (start,), **again))
    tried = []
    for s, fitted in zip(chosen, search.run(refit, jobs, "look back"), strict=True):
        if not isinstance(fitted, str):
            structure = search.lower(Structure((s.candidate,), fitted))
            tried.append(search.judged(Tried((s.candidate,), s, structure), base))
    return tried


def pruned(search: Search, now: Structure, base: Structure) -> Structure:
    """``now`` without the members that have become idle since others were added.

    Idle is also what closes no more of the gap of ``base`` than the inexact form of another effect may leave.
    """
    while len(now.members) > 1:
        smaller = [tuple(m for m in now.members if m is not left) for left in now.members]
        jobs = [search.refit_of(Structure(members, now.fitted)) for members in smaller]
        idle = []
        for members, fitted in zip(smaller, search.run(refit, jobs, "look back"), strict=True):
            if not isinstance(fitted, str):
                over = compared(now.fitted, fitted, search.question)
                share = 1 - share_closed(base.fitted, fitted, now.fitted, search.question)
                if not (over.bic_gain > search.needed and over.closed > WORTH and share > INEXACT):
                    idle.append((over.bic_gain, Structure(members, fitted)))
        if not idle:
            break
        now = min(idle, key=lambda pair: pair[0])[1]
    return now
