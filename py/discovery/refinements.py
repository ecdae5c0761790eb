"""Refinements: the finer forms of what was named that the recordings cannot exclude.

A simple effect is named before its refinements, for those always fit as well. That says nothing against a refinement
that is more likely, though not surely, nor against one that does as well and stands for something else: dry friction
that is all excess at low speed, or grows with the pressure, where the recordings show but a force against the motion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from hydrotwin.models.effects import Candidate

from .answering import Found, Step
from .choose import Choice, label, worth_refining
from .decide import CLEARLY, INEXACT, PART, T_NEEDED, TOGETHER, Evidence, closed, compared, share_closed
from .search import Search
from .structure import Structure, Tried

MATERIAL = 0.1  # of a parameter that both have: what the refinement's own part takes over when it is more than a trifle


def one_for_two(search: Search, found: Found) -> Found:
    """What was found, with a finer form of one of two effects in their place where it does the work of both.

    A bias and an overlap are an overlap that differs by direction: which was named first is chance. Finer forms with
    more parameters than both are no simpler.
    """
    last, base = found.last, found.base
    if len(last.members) != 2:
        return found
    values, size = last.fitted.values, sum(len(m.free) for m in last.members)
    finer = [(c, m) for c in search.candidates for m in last.members if c.refines(m) and len(c.free) <= size]
    starts = [[{**values, **c.neutral, **c.containing(m, values)}] for c, m in finer]
    tried = search.refitted(base, [((c,), start) for (c, _), start in zip(finer, starts, strict=True)])
    alone = [t for t in tried if t.structure and not t.implausible and _as_well(t, last, search)]
    if not alone:
        return found
    best, first = min(alone, key=lambda t: t.structure.fitted.likelihood), found.steps[0]
    others = tuple(t for t in first.tried if label(t) != label(best))
    step = Step(Choice(best, (best,), {label(best): 1.0}), first.ranked, (best, *others), base)
    return dataclasses.replace(found, last=best.structure, steps=(step,))


def _as_well(tried: Tried, now: Structure, search: Search) -> bool:
    """Whether it passes alone, and ``now`` explains no more."""
    over = compared(now.fitted, tried.structure.fitted, search.question)
    return tried.evidence.passes(len(search.candidates)) and over.bic_gain < TOGETHER and not over.paired_t > T_NEEDED


def more_of_the_same(search: Search, now: Structure, base: Structure, tried: Sequence[Tried]) -> list[Tried]:
    """``tried`` with the simple effects beside those that add to a named effect what it holds already.

    Friction that rises along the way holds dry friction. Another one beside it, that depends on the direction by
    hardly anything, is a second dry friction. One that is after a small part of the gap of ``base`` and leaves some
    that the sensors see is but the form of the first, and told so: where nothing explains more, there is no further
    effect.
    """
    pairs = [(t, s) for t in tried if (s := _held_already(search, now, t)) is not None]
    simple = search.refitted(now, [((s,), [_as_simple(t, s)]) for t, s in pairs])
    small, told, found = 1 - closed(now.fitted, base.fitted, search.question) < PART, {}, {}
    for (t, s), again in zip(pairs, simple, strict=True):
        if again.structure is None:
            continue
        if not small or not search.leaves(again.structure, CLEARLY, search.sensors):
            found[label(again)] = again
        elif not worth_refining(compared(t.structure.fitted, again.structure.fitted, search.question)):
            told[id(t)] = f"no more than {s.effect.title} a second time: the form of what is named, no further effect"
    known = [dataclasses.replace(t, reason=told.get(id(t), t.reason)) for t in tried if label(t) not in found]
    return [*known, *found.values()]


def _held_already(search: Search, now: Structure, t: Tried) -> Candidate | None:
    """The simple effect that what passes beside ``now`` refines at the place of a member that refines it, too."""
    if len(t.members) != 1 or not t.evidence or not t.evidence.passes(len(search.candidates)):
        return None
    simple = (s for s in search.candidates if t.members[0].refines(s) and s not in now.members)
    return next((s for s in simple if now.holds(s)), None)


def _as_simple(t: Tried, simple: Candidate) -> dict[str, float]:
    """Where the simple effect in the place of its refinement begins: with the largest of what stands for it there."""
    values, (finer,) = t.structure.fitted.values, t.members
    own = {f"{simple.name}.{theirs}": [] for theirs in finer.effect.refines[simple.id].values()}
    for ours, theirs in finer.effect.refines[simple.id].items():
        own[f"{simple.name}.{theirs}"].append(values[f"{finer.name}.{ours}"])
    return {**values, **{name: max(found, key=abs) for name, found in own.items()}}


def with_refinements(search: Search, found: Found) -> Found:
    """What was found, with every refinement of a named effect that may as well be it beside that effect."""
    now = found.last
    finer = search.refining(now)
    if not found.steps or not finer:
        return found
    _, ranked = search.screened(now, finer)
    tried = [t for t in search.singles(now, search.refinements(now, ranked)) if t.evidence]
    told = [t for t in tried if leans(t, now, found.base, search) or may_be(t, now)]
    return dataclasses.replace(found, steps=tuple(_beside(step, told) for step in found.steps))


def leans(tried: Tried, now: Structure, base: Structure, search: Search) -> bool:
    """Whether a refinement explains more than the simple effect in ``now``, but not surely: no inexact form alone."""
    more = more_than_inexact(tried, now, base, search) and _is_more(tried.evidence)
    return more and not worth_refining(tried.evidence) and not tried.implausible


def may_be(tried: Tried, now: Structure) -> bool:
    """Whether a refinement does as well as the simple effect in ``now`` with other physics than that."""
    e = tried.evidence
    as_well = e.bic_gain > -TOGETHER and e.paired_t > -T_NEEDED
    return as_well and own_part(tried, now) > MATERIAL and not tried.implausible


def more_than_inexact(tried: Tried, now: Structure, base: Structure, search: Search) -> bool:
    """Whether ``now`` leaves more of the gap that it closes than the inexact form of an effect may leave."""
    return 1 - share_closed(base.fitted, now.fitted, tried.structure.fitted, search.question) > INEXACT


def own_part(tried: Tried, now: Structure) -> float:
    """How far, relatively, a parameter that a refinement shares with the simple effect in ``now`` has moved in it."""
    (finer,) = tried.members
    simple = next(m for m in now.members if finer.refines(m))
    values = tried.structure.fitted.values
    pairs = [(values[name], before) for name, before in finer.containing(simple, now.fitted.values).items()]
    return max((abs(after / before - 1) for after, before in pairs if before), default=0.0)


def _is_more(over: Evidence) -> bool:
    """Whether a refinement explains more, be it surely or not."""
    return over.bic_gain > TOGETHER and over.paired_t > 0 and over.closed > 0


def _beside(step: Step, told: Sequence[Tried]) -> Step:
    """The step, and what was made of it again, with the refinements of their effects beside them."""
    again = {name: _beside(one, told) for name, one in step.revised.items()}
    best = step.choice.best
    finer = [t for t in told if len(best.members) == 1 and t.members[0].refines(best.members[0])]
    finer = [t for t in finer if t.members not in [m.members for m in step.choice.members]]
    if not finer:
        return dataclasses.replace(step, revised=again)
    tried = (*(t for t in step.tried if t.members not in [f.members for f in finer]), *finer)
    return dataclasses.replace(step, choice=step.choice.beside(finer), tried=tried, revised=again)
