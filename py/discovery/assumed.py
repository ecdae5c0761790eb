"""What was assumed about the recordings is doubted before a name stands.

Where the base, or what would be named, leaves a gap that another input between samples or another start explains, the
search begins anew with that: see `hydrotwin.identification.assumptions`. So it does without samples that stand
alone, where nothing but noise is left then: see `hydrotwin.identification.outliers`.
"""

from __future__ import annotations

import dataclasses
import time
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

from .answer.standing import Standing, standing
from .evidence.gaps import CLEARLY, LARGE, MEASURABLE, has_gap
from .fits.job import Job, not_below, task_of
from .fits.whole import FIRST, given, residuals_of
from .structures.search import Search
from .structures.table import Entry

if TYPE_CHECKING:
    from .asked import Asked
    from .recordings import Split

STAGE = "what was assumed"
THOROUGH = 100  # iterations of a fit without samples that stand alone: squares had led the base far away
FURTHER = 5  # iterations from where a fit has ended, under weights that may have changed
BESIDE = 0.5  # of what named effects leave: what another input between samples must explain


def fairly(
    asked: Asked, again: Callable[[object, str], Asked], begin: Callable[[Asked], Search]
) -> tuple[Search, Asked, tuple[Change, ...]]:
    """A search that does not rest on a wrong assumption, what it was asked at last, and the assumptions given up.

    again : what is asked of another model under other initial states; begin : a search whose base is identified.
    """
    given_up: list[Change] = []
    search = begin(asked)
    moving = Change() if search.table.explained() else _questioned_of_starts(search)
    if moving.free_starts and not moving.inputs:  # before any effect is named: nobody measured where it began
        given_up.append(moving)
        asked = again(asked.model, "free")
        search = begin(asked)
    strays, known = None, (search, asked, 0)
    for left in range(PATIENCE - len(given_up), -1, -1):
        change = _searched(search, bool(left))
        if not change.used:
            if not left or not _in_doubt(search, standing(search.table)):
                break
            if strays is None and not search.table.explained():  # no effect explains what stands alone
                strays = _stray_samples(search, asked.data)
                asked = asked.without(strays)
                if strays.left_out:
                    given_up.append(Change(sentences=strays.sentences))
                    search = begin(asked)
                    continue
            change, sentences = _doubt(search)
            if not change.used or time.monotonic() > search.until:  # what was found is worth more than a new beginning
                asked = asked if standing(search.table).kept.members else asked.telling(sentences)
                break
        known = search, asked, len(given_up)
        given_up.append(change)
        model = asked.model.with_inputs(change.inputs) if change.inputs else asked.model
        asked = again(model, "free" if change.free_starts else asked.initial_states)
        asked, before = asked.without(strays) if strays else asked, search
        search = begin(asked)
        if not change.inputs:
            search.take_looks(before)
    if not search.complete and _says_more(known[0], search):
        search, asked, many = known
        search.complete = False
        del given_up[many:]
    judges = _stray_samples_of_judges(search, asked.data)
    if judges.left_out:
        given_up.append(Change(sentences=judges.sentences))
    return search, asked.without(judges), tuple(given_up)


def _says_more(one: Search, other: Search) -> bool:
    """Whether a search found something, and another, which had no time to end, nothing."""
    return bool(standing(one.table).kept.members and not standing(other.table).kept.members)


def _searched(search: Search, asking: bool) -> Change:
    """Go on with a search to its end, or to free starts that a structure needs which windows say is right."""
    while surprise := search.go():
        change = _questioned(search, surprise) if asking else Change()
        if change.free_starts and time.monotonic() < search.until:
            return change
    return Change()


def _doubt(search: Search) -> tuple[Change, tuple[str, ...]]:
    """What the base should give up at the end of a search, or else what comes closest; and what to tell of the base."""
    hint, closest = _questioned(search, search.table.entry()), standing(search.table).best
    return hint if hint.used or closest is None else _questioned(search, closest), hint.sentences


def _in_doubt(search: Search, said: Standing) -> bool:
    """Whether an assumption may be what the gap comes from: not where an effect explains all of it otherwise.

    What acts by a time alone is what an input between its samples would look like.
    """
    if not (search.complete and said.kept.members and search.table.explained()):
        return search.complete
    units = {p.name: p.unit for p in search.table.model(said.kept).flat.parameters}
    return any(units[n] == "s" for c in said.kept.members for n in c.free)


def _leaves(search: Search, entry: Entry, more: float) -> bool:
    """Whether some output leaves ``more`` than the noise squared."""
    with np.errstate(invalid="ignore"):
        return bool(np.nanmax((entry.fitted.rmse / search.table.noise) ** 2) > more)


def _stray_samples(search: Search, data: Split) -> Strays:
    """Samples of the recordings to learn from that stand alone, as the fit of the base sees them."""
    base = search.table.entry()
    return _asked(search, base, question_samples, data.train) if _leaves(search, base, MEASURABLE) else Strays()


def _stray_samples_of_judges(search: Search, data: Split) -> Strays:
    """The same of those that judge, where the search has left nothing that an error of the noise does not explain."""
    kept = standing(search.table).kept
    if not data.report or _leaves(search, kept, LARGE):
        return Strays()
    return _asked(search, kept, judge_samples, data.report)


def _asked(search: Search, entry: Entry, function: Callable[[Job], Strays], others) -> Strays:
    known = {r.name for r in search.table.question.fit}
    select = tuple(r for r in others if r.name not in known)
    (strays,) = search.run(function, [_job(search, entry, select)], STAGE)
    return strays


def _job(search: Search, entry: Entry, select=()) -> Job:
    """A structure where its fit has ended, under the noise that all fits show."""
    table, fitted = search.table, entry.fitted
    job = search.jobs.of(entry, [fitted.values], states=fitted.states, size=fitted.rmse)
    question = dataclasses.replace(table.question, noise=table.noise, select=select)
    return dataclasses.replace(job, question=question, seconds=search.afterwards)


def question_samples(job: Job) -> Strays:
    """`spared` of a job's fit, where it ended, and of what selects then; none where its seconds do not do.

    Pure and picklable.
    """
    job = job.beginning()

    def report(*_) -> None:
        if time.process_time() > job.seconds:
            raise SolveError("The search without samples that stand alone has had its time.")

    try:
        task, found = _ended(job)
        task = dataclasses.replace(task, report=report)
        effort, adaptable = Effort(None, 1, THOROUGH), np.isfinite(job.question.noise)
        task, minima, strays = outliers.spared(task, [found], effort, adaptable, _at_noise)
        if not (strays.left_out or _at_noise(task, minima[0])):
            return strays
        return outliers.with_others(task, minima[0], strays, job.question.select)
    except SolveError:
        return Strays()


def judge_samples(job: Job) -> Strays:
    """Of what selects alone, as a job's fit sees it. Pure and picklable; what judges is in no memory."""
    try:
        return outliers.with_others(*_ended(job.beginning()), Strays(), job.question.select)
    except SolveError:
        return Strays()


def _questioned(search: Search, entry: Entry, asked: Callable[[Job], Change] | None = None) -> Change:
    """The assumption that explains what a structure leaves; none is used where nothing is left, or none does."""
    if not _leaves(search, entry, CLEARLY if entry.members else MEASURABLE):
        return Change()
    asked = asked or (question_beside if entry.members else question)
    (answer,) = search.run(asked, [_job(search, entry)], STAGE)
    return answer


def _questioned_of_starts(search: Search) -> Change:
    """Whether what the base leaves comes from starts that nobody measured.

    A wrong start shows in the beginnings of long recordings, which cost less; but over so short a time a start hides
    other things, too, so all of them have to say the same.
    """
    found = Change()
    for each in (search.part, search):
        if each:
            found = _questioned(each, each.table.entry(), question_starts)
            if not found.free_starts:
                break
    return found


def question_starts(job: Job) -> Change:
    """The start states alone, before any effect is tried."""
    return question(job, only_starts=True)


def question_beside(job: Job) -> Change:
    """The same beside effects whose laws are not quite the machine's: a half of what they leave is enough."""
    return question(job, enough=BESIDE)


def question(job: Job, enough: float = FAR_MORE, only_starts: bool = False) -> Change:
    """`doubted` of a job's first start, where a fit has ended. Pure and picklable."""
    try:
        task, found = _ended(job.beginning())
        adaptable = np.isfinite(job.question.noise)
        return doubted(task, found, adaptable, loads=False, enough=enough, only_starts=only_starts) or Change()
    except SolveError:
        return Change()


def _at_noise(task: Task, found: Minimum) -> bool:
    return not has_gap(residuals_of(task, found), task.noise).any()


def _ended(job: Job) -> tuple[Task, Minimum]:
    """The task of a job and the minimum beside its start; every start state may be asked for.

    The job has begun (`Job.beginning`): whatever is asked of the task ends with its seconds, where it is then.
    """
    task = task_of(job, job.starts[0], not_below(job.question.noise, job.size), [s.name for s in job.flat.states])
    task = dataclasses.replace(task, until=job.seconds)
    shooting, z = whole_runs(task)
    start = task.free.scaled(task.free.start)
    return task, minimise(shooting, start, given(shooting, z, job.states), **FIRST, most=FURTHER)


def with_assumptions(discovery, given_up: tuple[Change, ...]):
    """The answer with what was given up for it, which its sentence says."""
    return dataclasses.replace(discovery, assumptions=tuple(s for change in given_up for s in change.sentences))
