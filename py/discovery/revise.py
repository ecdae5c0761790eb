"""Revise: each of several named effects looked for again with all the others in place.

A forward search names the first effect while the others are still missing: what was chosen then, and what could not be
told from it, may be another once they are there. So one effect after the other is taken out, and the best of all
candidates put in its place.
Source: P. Pudil, J. Novovicova and J. Kittler, Floating search methods in feature selection, 1994.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from hydrotwin.models.effects import Candidate

from .answering import Found, Step
from .choose import Choice, choose, label
from .look_back import PROMISED, RIVALS, improved, promised, settled
from .refit import refit
from .screen import Screened
from .search import Search
from .structure import Structure, Tried

ROUNDS = 2
HARDLY = 0.5  # of the probability of the best: what the present effect must have to stay


def revised(search: Search, found: Found) -> tuple[Found, bool]:
    """What was found with the class of every effect computed anew, and whether an effect was replaced."""
    rounds = 0
    while len(found.last.members) > 1 and rounds < ROUNDS:
        found, replaced = _once(search, found, replaced=rounds > 0)
        if not replaced:
            break
        rounds += 1
    return found, rounds > 0


def _once(search: Search, found: Found, replaced: bool) -> tuple[Found, bool]:
    """One round; ``replaced``: an effect has been replaced since the last of the steps was chosen."""
    anything = False
    for number in range(len(found.steps)):
        for old in found.steps[number].choice.best.members:
            step = found.steps[number]
            known = number == len(found.steps) - 1 and len(step.choice.best.members) == 1 and not replaced
            if old not in found.last.members or known:  # refined since, or chosen with all the others in place
                continue
            others = _fitted(search, [m for m in found.last.members if m is not old], found.last)
            again = others and _chosen(search, others, old, found.last)
            if not again:
                continue
            if old in again.choice.best.members:
                step = dataclasses.replace(step, revised={**step.revised, old.label: again})
                found = _with_step(found, number, step)
            else:
                found, replaced, anything = _replaced(search, found, number, old, again), True, True
    return found, anything


def _chosen(search: Search, others: Structure, old: Candidate, now: Structure) -> Step | None:
    """What is best beside the others, the present effect among those tried."""
    _, ranked = search.screened(others)
    tried = search.singles(others, search.shortlist(ranked))
    tried = _with_present([*tried, *search.finer(others, ranked, tried)], old, now, ranked)
    tried = _from_the_present(search, others, [search.judged(t, others) for t in tried], old, now)
    choice = choose(tried, len(search.candidates), search.question)
    if choice and len(choice.probability) > 1:
        _, tried = settled(search, others, tried, choice)
        choice = choose(tried, len(search.candidates), search.question)
    return choice and Step(_keeping(choice, old), tuple(ranked), tuple(tried), others)


def _from_the_present(
    search: Search, others: Structure, tried: Sequence[Tried], old: Candidate, now: Structure
) -> Sequence[Tried]:
    """``tried``, those that promise as much as the present effect begun once more where the base stands beside it.

    Without it the base has bent as far as it may, and only the present effect is known on the other side of that.
    """
    present = next(t for t in tried if t.members == (old,))
    rivals = [t for t in tried if t is not present and t.structure and promised(t) > PROMISED * promised(present)]
    rivals = sorted(rivals, key=promised, reverse=True)[:RIVALS]
    base = {n: v for n, v in now.fitted.values.items() if n not in old.free}
    jobs = [search.refit_of(t.structure, base, states=now.fitted.states) for t in rivals]
    return improved(search, others, tried, rivals, search.run(refit, jobs, "look back")) if jobs else tried


def _keeping(choice: Choice, old: Candidate) -> Choice:
    """The choice with the present effect for the best where another is hardly more probable."""
    again = next((t for t in choice.members if t.members == (old,)), None)
    if again is None or choice.probability[label(again)] < HARDLY * choice.probability[label(choice.best)]:
        return choice
    return dataclasses.replace(choice, best=again, members=(again, *(t for t in choice.members if t is not again)))


def _with_present(tried: Sequence[Tried], old: Candidate, now: Structure, ranked: Sequence[Screened]) -> list[Tried]:
    """The candidates with the present effect as well fitted as it is."""
    again = next((t for t in tried if t.members == (old,)), None)
    if again and again.structure and again.structure.fitted.likelihood <= now.fitted.likelihood:
        return list(tried)
    screened = next((s for s in ranked if s.candidate is old), None)
    return [*(t for t in tried if t is not again), Tried((old,), screened, now)]


def _with_step(found: Found, number: int, step: Step) -> Found:
    return dataclasses.replace(found, steps=(*found.steps[:number], step, *found.steps[number + 1 :]))


def _replaced(search: Search, found: Found, number: int, old: Candidate, again: Step) -> Found:
    """What was found with another effect in the place of one, and the structures on the way there fitted again."""
    (new,) = again.choice.best.members
    last, steps, before = again.choice.best.structure, list(found.steps), found.steps[number].before
    for k in range(number, len(steps)):
        step = steps[k]
        members = tuple(new if m is old else m for m in step.choice.best.members)
        part = None if k == len(steps) - 1 else _fitted(search, search.joined(before, members), last)
        structure = part or last
        best = search.judged(Tried(members, again.choice.best.screened if k == number else None, structure), before)
        likely = {label(best): step.choice.probability[label(step.choice.best)]}
        steps[k] = dataclasses.replace(step, choice=Choice(best, (best,), likely), before=before)
        before = structure
    revised = {name: s for name, s in steps[number].revised.items() if name != old.label}
    steps[number] = dataclasses.replace(steps[number], revised={**revised, new.label: again})
    return dataclasses.replace(found, last=last, steps=tuple(steps))


def _fitted(search: Search, members: Sequence[Candidate], larger: Structure) -> Structure | None:
    """A part of a structure, fitted from where that ended; None when it diverges."""
    members = tuple(members)
    fitted = search.run(refit, [search.refit_of(Structure(members, larger.fitted))], "look back")[0]
    return None if isinstance(fitted, str) else search.keep(Structure(members, fitted))
