"""Roles: recordings change places where those that select show nothing of a gap that several others show.

A slide that reaches its stop in two of three recordings tells nothing in the third: an effect fitted to the two could
never prove itself there. Which recording has which role is decided by what the base leaves, before any effect is tried.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from .decide import LARGE, SHOWN, beyond_noise
from .refit import Question, Refitted, refit
from .search import Search
from .structure import Structure


def fairly_split(search: Search, base: Structure) -> Structure:
    """The base, fitted anew where recordings have to change places."""
    question = exchanged(search.question, base.fitted)
    if question is None:
        return base
    before, search.question = search.question, question
    search.forget()
    answer = search.run(refit, [search.refit_of(base, states=())], "identify the base")[0]
    if isinstance(answer, str):  # it diverges on the others
        search.question = before
        return base
    return Structure((), answer)


def exchanged(q: Question, fitted: Refitted) -> Question | None:
    """The question with one recording of each role in the place of the other, so that both roles show the gap.

    None where both do, or where fewer than two recordings show it.
    """
    fit, select = (beyond_noise(r, q.noise) for r in (fitted.residuals_fit, fitted.residuals_select))
    least = max(SHOWN * max((*fit, *select)), LARGE - 1)
    if (np.array([*fit, *select]) > least).sum() < 2 or not select:
        return None
    if max(select) < least:
        return _changed(q, int(np.argsort(fit)[-2]), int(np.argmin(select)))
    if max(fit) < least:
        return _changed(q, int(np.argmin(fit)), int(np.argmax(select)))
    return None


def _changed(q: Question, i: int, j: int) -> Question:
    """Fit recording ``i`` and select recording ``j`` change places."""
    fit, select = list(q.fit), list(q.select)
    fit[i], select[j] = select[j], fit[i]
    return dataclasses.replace(q, fit=tuple(fit), select=tuple(select))
