"""What was assumed about the recordings is doubted before, and after, effects are looked for.

Where the base, or what was named at last, leaves a gap that another input between samples or another start explains,
the search begins anew with that: see `hydrotwin.identification.assumptions`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from hydrotwin.identification.assumptions import FAR_MORE, PATIENCE, Change, doubted
from hydrotwin.identification.descent import whole_runs
from hydrotwin.identification.least_squares import minimise
from hydrotwin.models.language.errors import SolveError

from .decide import CLEARLY, MEASURABLE
from .refit import FIRST, RefitJob, weighed
from .starts import given
from .structure import Structure

if TYPE_CHECKING:
    from .answering import Found
    from .asked import Asked
    from .search import Search

STAGE = "what was assumed"
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
    while True:
        search, base = begin(asked)
        patient = len(given_up) < PATIENCE
        change = questioned(search, base) if patient else None
        if change is None:
            found = search_on(search, base)
            change = questioned(search, found.last) if patient and found.steps else None
        if change is None:
            return search, asked, found, tuple(given_up)
        given_up.append(change)
        model = asked.model.with_inputs(change.inputs) if change.inputs else asked.model
        asked = again(model, "free" if change.free_starts else asked.initial_states)


def questioned(search: Search, structure: Structure) -> Change | None:
    """The assumption that explains what a structure leaves; None where nothing is left, or none does."""
    if not search.leaves(structure, CLEARLY if structure.members else MEASURABLE, search.sensors):
        return None
    asked = dataclasses.replace(search.question, noise=search.sensors)
    job = dataclasses.replace(search.refit_of(structure, coarse=True), question=asked)
    (answer,) = search.run(question_beside if structure.members else question, [job], STAGE)
    return answer if answer.used else None


def question_beside(job: RefitJob) -> Change:
    """The same beside effects whose laws are not quite the machine's: a half of what they leave is enough."""
    return question(job, enough=BESIDE)


def question(job: RefitJob, enough: float = FAR_MORE) -> Change:
    """`doubted` of a job's first start, where a fit has ended. Pure and picklable."""
    try:
        task = weighed(job, job.question.noise if job.size is None else np.fmax(job.size, job.question.noise))
        shooting, z = whole_runs(task)
        found = minimise(shooting, task.free.scaled(task.free.start), given(shooting, z, job.states), **FIRST)
        return doubted(task, found, np.isfinite(job.question.noise), loads=False, enough=enough) or Change()
    except SolveError:
        return Change()


def with_assumptions(discovery, given_up: tuple[Change, ...]):
    """The answer with what was given up for it, which its sentence says."""
    return dataclasses.replace(discovery, assumptions=tuple(s for change in given_up for s in change.sentences))
