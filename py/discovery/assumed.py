"""What was assumed about the recordings is doubted before, and after, effects are looked for.

Where the base, or what was named at last, leaves a gap that another input between samples or another start explains,
the search begins anew with that: see `hydrotwin.identification.assumptions`. So it does without samples that stand
alone, where nothing but noise is left then: see `hydrotwin.identification.outliers`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from hydrotwin.identification import outliers
from hydrotwin.identification.assumptions import PATIENCE, Change, doubted
from hydrotwin.identification.descent import Task, whole_runs
from hydrotwin.identification.least_squares import Minimum, minimise
from hydrotwin.identification.outliers import Strays
from hydrotwin.identification.search import Effort
from hydrotwin.identification.trials import FAR_MORE
from hydrotwin.models.language.errors import SolveError

from .decide import CLEARLY, MEASURABLE, has_gap
from .refit import FIRST, RefitJob, residuals_of, weighed
from .starts import given
from .structure import Structure

if TYPE_CHECKING:
    from .answering import Found
    from .asked import Asked
    from .recordings import Split
    from .search import Search

STAGE = "what was assumed"
THOROUGH = 100  # iterations of a fit without samples that stand alone: squares had led the base far away
BESIDE = 0.5  # of what named effects leave: what another input between samples must explain


def fairly(
    asked: Asked,
    again: Callable[[object, str], Asked],
    begin: Callable[[Asked], tuple[Search, Structure]],
    search_on: Callable[[Search, Structure], Found],
) -> tuple[Search, Asked, Found, tuple[Change, ...]]:
    """A search that does not rest on a wrong assumption, what it was asked at last, and the assumptions given up.

    again : what is asked of another model under other initial states; begin : the search and its identified base;
    search_on : what a search finds from there.
    """
    given_up: list[Change] = []
    search, base = begin(asked)
    strays = stray_samples(search, base, asked.data)
    asked = asked.without(strays)
    if strays.left_out:
        given_up.append(Change(sentences=strays.sentences))
        search, base = begin(asked)
    for left in range(PATIENCE, -1, -1):
        change = hint = questioned(search, base) if left else Change()
        if not change.used:
            found = search_on(search, base)
            change = questioned(search, found.last) if left and found.steps else Change()
        if not change.used:
            asked = asked if found.steps else asked.telling(hint.sentences)
            break
        given_up.append(change)
        model = asked.model.with_inputs(change.inputs) if change.inputs else asked.model
        asked = again(model, "free" if change.free_starts else asked.initial_states).without(strays)
        search, base = begin(asked)
    judges = stray_samples_of_judges(search, found.last, asked.data)
    if judges.left_out:
        given_up.append(Change(sentences=judges.sentences))
    return search, asked.without(judges), found, tuple(given_up)


def stray_samples(search: Search, base: Structure, data: Split) -> Strays:
    """Samples of the recordings to learn from that stand alone, as the fit of the base sees them."""
    if not search.leaves(base, MEASURABLE, search.sensors):
        return Strays()
    return _asked(search, base, question_samples, data.train)


def stray_samples_of_judges(search: Search, last: Structure, data: Split) -> Strays:
    """The same of those that judge, where the search has left nothing but noise."""
    if not data.report or search.leaves(last, MEASURABLE, search.sensors):
        return Strays()
    return _asked(search, last, judge_samples, data.report)


def _asked(search: Search, structure: Structure, function: Callable[[RefitJob], Strays], others) -> Strays:
    known = {r.name for r in search.question.fit}
    select = tuple(r for r in others if r.name not in known)
    asked = dataclasses.replace(search.question, noise=search.sensors, select=select)
    job = dataclasses.replace(search.refit_of(structure, coarse=True), question=asked)
    (strays,) = search.run(function, [job], STAGE)
    return strays


def question_samples(job: RefitJob) -> Strays:
    """`spared` of a job's fit, where it ended, and of what selects then. Pure and picklable."""
    try:
        task, found = _ended(job)
        effort, adaptable = Effort(None, 1, THOROUGH), np.isfinite(job.question.noise)
        task, minima, strays = outliers.spared(task, [found], effort, adaptable, _at_noise)
        if not (strays.left_out or _at_noise(task, minima[0])):
            return strays
        return outliers.with_others(task, minima[0], strays, job.question.select)
    except SolveError:
        return Strays()


def judge_samples(job: RefitJob) -> Strays:
    """Of what selects alone, as a job's fit sees it. Pure and picklable; what judges is in no memory."""
    try:
        return outliers.with_others(*_ended(job), Strays(), job.question.select)
    except SolveError:
        return Strays()


def questioned(search: Search, structure: Structure) -> Change:
    """The assumption that explains what a structure leaves; none is used where nothing is left, or none does."""
    if not search.leaves(structure, CLEARLY if structure.members else MEASURABLE, search.sensors):
        return Change()
    asked = dataclasses.replace(search.question, noise=search.sensors)
    job = dataclasses.replace(search.refit_of(structure, coarse=True), question=asked)
    (answer,) = search.run(question_beside if structure.members else question, [job], STAGE)
    return answer


def question_beside(job: RefitJob) -> Change:
    """The same beside effects whose laws are not quite the machine's: a half of what they leave is enough."""
    return question(job, enough=BESIDE)


def question(job: RefitJob, enough: float = FAR_MORE) -> Change:
    """`doubted` of a job's first start, where a fit has ended. Pure and picklable."""
    try:
        task, found = _ended(job)
        return doubted(task, found, np.isfinite(job.question.noise), loads=False, enough=enough) or Change()
    except SolveError:
        return Change()


def _at_noise(task: Task, found: Minimum) -> bool:
    return not has_gap(residuals_of(task, found), task.noise).any()


def _ended(job: RefitJob) -> tuple[Task, Minimum]:
    """The task of a job and the minimum beside its first start."""
    task = weighed(job, job.question.noise if job.size is None else np.fmax(job.size, job.question.noise))
    shooting, z = whole_runs(task)
    return task, minimise(shooting, task.free.scaled(task.free.start), given(shooting, z, job.states), **FIRST)


def with_assumptions(discovery, given_up: tuple[Change, ...]):
    """The answer with what was given up for it, which its sentence says."""
    return dataclasses.replace(discovery, assumptions=tuple(s for change in given_up for s in change.sentences))
