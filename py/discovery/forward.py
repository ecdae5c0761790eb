"""Forward: one effect after the other while something passes, pairs where that does not explain the gap."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np

from hydrotwin.identification.noise import floor
from hydrotwin.records.noise import channel_noise

from .answering import Found, Step
from .choose import Choice, as_good, choose, label, refines, worth_refining
from .decide import MEASURABLE, PART, T_NEEDED, WORTH, closed, compared
from .ends import both_ends, without_idle_ends
from .look_back import LOOK_BACK, along_valleys, from_the_beginning, pruned, settled
from .refinements import more_of_the_same, more_than_inexact, one_for_two, with_refinements
from .refit import Question, RefitJob, Refitted, refit
from .revise import revised
from .roles import fairly_split
from .search import CONVINCING, Search
from .structure import Structure, Tried, label_of
from .twin import TwinJob, floor_of, smoothed_signs, with_floor

SHARPENED = 3  # times in a row
SHARPER = 0.9  # of the noise: what the residuals must show to be believed instead
TURNS = 2  # others of a class that are followed at a dead end
PAIR_WORTH = 0.5  # of what single steps leave: what a search from a pair must close to be preferred


def begun(search: Search, base: Structure) -> Structure:
    """The identified base as a search begins with it: at rest, and with recordings in roles that can show its gap."""
    now = reconsidered(search, base)
    fair = fairly_split(search, now)
    return now if fair is now else reconsidered(search, fair)


def searched(search: Search, base: Structure, most: int) -> Found:
    """Forward steps while something passes; pairs from the base when that does not explain most of the gap.

    When not even a pair does, candidates take part in the identification of the base. Of several effects each is
    looked for again beside the others; where another stands then, the search goes on from there. At last a finer form
    that does the work of two takes their place, and those that may as well be what is named are put beside it.
    """
    found = _pruned(search, _best_of_singles_and_pairs(search, base, most))
    found, replaced = revised(search, found)
    if replaced:
        search.ask(search.sensors)
        last = reconsidered(search, found.last)
        further = _forward(search, found.base, last, most, found.steps, turning=False)
        found = _pruned(search, dataclasses.replace(further, screens=(*found.screens, *further.screens)))
    return with_refinements(search, one_for_two(search, found))


def _best_of_singles_and_pairs(search: Search, base: Structure, most: int) -> Found:
    found = _forward(search, base, base, most, ())
    base = found.base  # it may have come to a better rest
    if most < 2 or closed(found.last.fitted, base.fitted, search.question) > CONVINCING or not found.screens:
        return found
    screen, ranked, tried = found.screens[0]
    search.ask(search.sensors)
    others = search.pairs(base, screen, ranked, tried)
    others += _beside_a_near_miss(search, base, tried) if not found.steps else []
    others = both_ends(search, base, others)
    choice = choose(others, len(search.candidates) ** 2 // 2, search.question)
    if choice is None and not found.steps:
        found = dataclasses.replace(found, screens=((screen, ranked, (*tried, *others)), *found.screens[1:]))
        others = from_the_beginning(search, base)
        choice = choose(others, len(search.candidates), search.question)
    if choice is None:
        return found
    again = {label(t) for t in others}
    step = Step(choice, tuple(ranked), (*(t for t in tried if label(t) not in again), *others), base)
    other = _forward(search, base, reconsidered(search, choice.best.structure), most, (step,))
    over = compared(other.last.fitted, found.last.fitted, search.question)
    clearly = over.bic_gain > 0 and over.paired_t > T_NEEDED and over.closed > PAIR_WORTH
    if clearly or (not found.steps and other.steps):
        return dataclasses.replace(other, screens=(*found.screens, *other.screens))
    return found


def _beside_a_near_miss(search: Search, base: Structure, tried: Sequence[Tried]) -> list[Tried]:
    """Pairs of what almost passed alone with what the screen sees once that is in place.

    While two effects are missing, the base bends to stand in for both, and the screen sees the second beside the first
    only.
    """
    near = [t for t in tried if t.evidence and t.evidence.bic_gain > 0 and t.evidence.closed > WORTH]
    if not near:
        return []
    first = max(near, key=lambda t: t.evidence.bic_gain)
    _, ranked = search.screened(first.structure)
    second = search.singles(first.structure, search.shortlist(ranked))
    both = [Tried(t.structure.members, None, t.structure) for t in second if t.structure]
    return [search.judged(t, base) for t in both if len(t.members) == 2]


def _pruned(search: Search, found: Found) -> Found:
    """What was found without the steps, and without the members of a pair, that have become idle."""
    last = without_idle_ends(search, pruned(search, found.last, found.base))
    return found if last is found.last else reduced(search, found, last)


def reduced(search: Search, found: Found, last: Structure) -> Found:
    """What was found with ``last``, which has lost some of its effects, for its end."""
    gone = {c.label for step in found.steps for c in step.choice.best.members} - set(last.key)
    steps = [s for s in found.steps if any(c in last.members for c in s.choice.best.members)]
    steps = [dataclasses.replace(_without(s, gone), revised={}) for s in steps]  # made with the others in place
    if len(steps) == 1:  # it explains what all of them did
        step = _alone(search, steps[0], found.base, last)
        if len(found.steps) == 1:  # of a pair: nothing was ever compared with the other by itself
            return _compared_again(search, dataclasses.replace(found, last=last, steps=(step,)))
        steps = [step]
    return dataclasses.replace(found, last=last, steps=tuple(steps))


def _without(step: Step, gone: Collection[str]) -> Step:
    """A step whose pairs have lost these effects (labels); several that become the same count together."""
    if not gone & {c.label for c in step.choice.best.members}:
        return step
    members: dict[str, Tried] = {}
    probability: dict[str, float] = {}
    for t in step.choice.members:
        less = dataclasses.replace(t, members=tuple(c for c in t.members if c.label not in gone))
        if less.members:
            members.setdefault(label(less), less)
            probability[label(less)] = probability.get(label(less), 0.0) + step.choice.probability[label(t)]
    best, *others = members.values()
    alone = (t for t in step.tried if len(t.members) == 1 and label(t) not in members)
    return dataclasses.replace(step, choice=Choice(best, (best, *others), probability), tried=(best, *others, *alone))


def _compared_again(search: Search, found: Found) -> Found:
    """What is left of a pair beside all that was tried alone, as after any other choice."""
    (step,) = found.steps
    base, tried = settled(search, found.base, step.tried, step.choice)
    choice = choose(tried, len(search.candidates), search.question)
    if choice is None:
        screens = (*found.screens, (None, step.ranked, tuple(tried)))
        return dataclasses.replace(found, base=base, last=base, steps=(), screens=screens)
    step = Step(choice, step.ranked, tuple(tried), base)
    return dataclasses.replace(found, base=base, last=choice.best.structure, steps=(step,))


def _alone(search: Search, step: Step, base: Structure, last: Structure) -> Step:
    """A step from the base itself."""
    best = search.judged(dataclasses.replace(step.choice.best, structure=last), base)
    members = tuple(best if t is step.choice.best else t for t in step.choice.members)
    tried = tuple(best if t is step.choice.best else t for t in step.tried)
    choice = dataclasses.replace(step.choice, best=best, members=members)
    return dataclasses.replace(step, choice=choice, tried=tried, before=base)


def _forward(
    search: Search, base: Structure, now: Structure, most: int, steps: tuple[Step, ...], *, turning: bool = True
) -> Found:
    """Steps from ``now`` on. ``turning``: at a dead end, go on from the others of the last class."""
    screens, again = [], False
    if not now.members and search.explained(now):
        search.screened(now)  # nothing is missing; what could not have been seen is told
    while len(now.members) < most:
        explained = search.explained(now)
        finished = explained and not _part_is_left(search, now, base)
        if finished and not search.refining(now):
            break
        screen, ranked = search.screened(now, search.refining(now) if finished else None)
        tried = search.singles(now, search.refinements(now, ranked) if finished else search.shortlist(ranked))
        tried += () if finished else search.finer(now, ranked, tried)
        tried = more_of_the_same(search, now, base, both_ends(search, now, tried))
        screens.append((screen if not screens else None, ranked, tried))
        if explained:  # what is left asks for no reason, but the form of a named effect may be put right
            tried = [t for t in tried if _puts_right(search, t, now, base) or (not finished and search.spotless(t))]
        choice = choose(tried, len(search.candidates), search.question)
        if choice is None or choice.best.reason:
            if turning and not explained and (turned := _turned(search, base, most, steps)):
                return dataclasses.replace(turned, screens=(*screens, *turned.screens))
            break
        better, tried = settled(search, now, tried, choice)
        if better is not now:  # what was missing was, in part, a better fit of what is there
            now, steps, base = better, _refounded(steps, better), base if better.members else better
            if search.near_noise(now) and not again:  # all others began in the hollow that it has left
                again = search.forget()
                continue
        again = False
        tried = more_of_the_same(search, now, base, tried)
        choice = choose(tried, len(search.candidates), search.question)
        if choice is None:
            continue
        if choice.best.reason:
            break
        steps = (*steps, Step(choice, tuple(ranked), tuple(tried), now))
        now = reconsidered(search, choice.best.structure)
    return Found(base if now.members else now, now, steps, tuple(screens))


def _part_is_left(search: Search, now: Structure, base: Structure) -> bool:
    """Whether what is left, though small beside the noise, is more of a small gap than an inexact law would leave."""
    left = 1 - closed(now.fitted, base.fitted, search.question)
    return bool(now.members) and left > PART and search.leaves(now, MEASURABLE)


def _puts_right(search: Search, t: Tried, now: Structure, base: Structure) -> bool:
    """Whether it is a finer form of a named effect that explains clearly more."""
    finer = any(c.refines(m) for c in t.members for m in now.members)
    return bool(finer and t.evidence and worth_refining(t.evidence) and more_than_inexact(t, now, base, search))


def _turned(search: Search, base: Structure, most: int, steps: tuple[Step, ...]) -> Found | None:
    """Where another of the last class leads, when it leads on; a refinement of the best leads where the best does.

    Those that led nowhere stay members if, beside what was found then, they explain as much.
    """
    if not steps or len(steps[-1].choice.best.members) > 1:
        return None
    last, asked, sensors = steps[-1], search.question.noise, search.sensors
    others = [(i, t) for i, t in enumerate(last.choice.members) if i and not refines(t, last.choice.best)]
    for i, other in others[:TURNS]:
        before = (*steps[:-1], dataclasses.replace(last, choice=last.choice.without_first(i)))
        found = _forward(search, base, reconsidered(search, other.structure), most, before, turning=False)
        if len(found.steps) > len(steps):
            return _rejoined(search, found, len(steps) - 1, last.choice.members[:i])
        search.sensors = sensors
        search.ask(asked)
    return None


def _rejoined(search: Search, found: Found, number: int, left: Sequence[Tried]) -> Found:
    """What was found, with those of the candidates beside a step's best that do as well in its place."""
    q, step, base = search.question, found.steps[number], found.base
    best = step.choice.best.members[0]
    if best not in found.last.members:
        return found  # refined since
    last = search.judged(Tried(found.last.members, None, found.last), base)
    for t in (t for t in left if t.members[0] not in found.last.members):  # it may have been named beside the best
        members = tuple(t.members[0] if m is best else m for m in found.last.members)
        known = t.structure.fitted.values
        start = {**found.last.fitted.values, **{n: known[n] for n in t.members[0].free}}
        (again,) = search.refitted(base, [(members, [start])])
        if again.structure and as_good(again, last, q):
            step = dataclasses.replace(step, choice=step.choice.beside([t]))
    return dataclasses.replace(found, steps=(*found.steps[:number], step, *found.steps[number + 1 :]))


def _refounded(steps: tuple[Step, ...], better: Structure) -> tuple[Step, ...]:
    """The steps with the last structure fitted better."""
    if not steps:
        return steps
    last = steps[-1]
    best = dataclasses.replace(last.choice.best, structure=better)
    members = tuple(best if t is last.choice.best else t for t in last.choice.members)
    return (*steps[:-1], dataclasses.replace(last, choice=dataclasses.replace(last.choice, best=best, members=members)))


def reconsidered(search: Search, now: Structure) -> Structure:
    """``now`` judged by the noise that it reveals: what seemed to be noise was motion, which it follows.

    The better it follows, the less is left that looks like noise: until both come to rest. Near the noise it looks
    along its valleys, for whatever is tried next begins where it stands. What its smoothed signs leave by themselves
    counts as noise from here on.
    """
    looked = None
    for _ in range(SHARPENED):
        less = _noise_of_residuals(now.fitted, search.question, search.sensors)
        search.sensors = np.where(search.told, search.sensors, less)
        changed = search.ask(search.sensors)
        now = _again(search, now) if changed else now
        if now is looked or not search.near_noise(now) or search.explained(now):
            break
        lower = looked = _lower(search, now, along_valleys(search, now))
        if not lower.fitted.likelihood < now.fitted.likelihood - LOOK_BACK:
            break
        now = lower
    flat, names, fitted = search.model(now.members).flat, search.names(now.members), now.fitted
    smoothing = smoothed_signs(flat, now.members)
    if not smoothing or search.explained(now):
        return now
    job = TwinJob(flat, names, search.question, fitted, smoothing, label_of(now.members))
    floor = search.run(floor_of, [job], "twin")[0]
    changed = not isinstance(floor, str) and search.ask(with_floor(search.sensors, floor))
    return _again(search, now) if changed else now


def _again(search: Search, now: Structure) -> Structure:
    """``now`` fitted under the present noise from where it stands."""
    return _lower(search, now, [search.refit_of(now)])


def _lower(search: Search, now: Structure, jobs: Sequence[RefitJob]) -> Structure:
    """The lowest of several fits of ``now``."""
    answers = search.run(refit, jobs, "look back" if now.members else "identify the base")
    found = [f for f in answers if not isinstance(f, str)]
    return search.keep(Structure(now.members, min(found, key=lambda f: f.likelihood))) if found else now


def _noise_of_residuals(fitted: Refitted, q: Question, noise: np.ndarray) -> np.ndarray:
    """The noise (ny,) once the motion that a structure follows is taken out, where that is less. SI."""
    found = []
    for recording, residual in zip(q.fit, fitted.residuals_fit, strict=True):
        columns = [(r, np.isfinite(r)) for r in residual.T]
        found.append([channel_noise(recording.time[s], r[s]).sigma if s.any() else np.nan for r, s in columns])
    with np.errstate(invalid="ignore"):
        left = np.fmax(np.sqrt(np.mean(np.square(found), axis=0)), floor(q.fit))
        return np.where((left > 0) & (left < SHARPER * noise), left, noise)
