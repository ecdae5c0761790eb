"""Findings: what is to be said of the candidates, the search and the verdict; why there is no name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hydrotwin.identification.problem import Recording
from hydrotwin.models.language.flat import FlatModel

from ..recordings import Split
from ..structures.extent import testable
from ..structures.search import Search
from .standing import Standing, closed
from .words import capitalised, joined, lowered, percent

FURTHER = 0.1  # of the range that was fitted: beyond it a model is not what was tested
WORTH = 0.5  # of what the base leaves: a structure that leaves less is told where it is not named


def reason_of(search: Search, said: Standing, data: Split, elsewhere: Sequence[str], refuted: float | None) -> str:
    """Why a gap gets no name, where more is known than the verdict says; else empty."""
    if said.verdict != "unknown":
        return ""
    if elsewhere:
        return _not_excited(said.table.base.flat, data, elsewhere)
    best, table, several, names = said.best, said.table, len(said.order) > 1, _words(said.order)
    if refuted is not None:
        return (
            f"Something is missing that gets no name yet: {names} would explain it where the model was "
            f"fitted, but closes only {100 * max(refuted, 0.0):.0f} % of the gap in the recordings that judge. Record "
            "more runs that move like those, and give them to be fitted to."
        )
    unfinished = (
        "" if search.complete else " The time limit ended the search; a longer one would try more (--time-limit)."
    )
    if said.part:
        verb = "are parts" if several else "is a part"
        others = sum(len(said.members(c)) - 1 for c in said.order)
        names += f" (or one of {others} others that close as much)" if others > 1 else ""
        names += " (or another that closes as much)" if others == 1 else ""
        return (
            f"{capitalised(names)} {verb} of what is missing: {percent(closed(table, best))} of the gap "
            f"closes. What is left where it was fitted, {_times(said):.3g} times the noise, has no name in the "
            f"catalogue.{unfinished}"
        )
    if said.unasked:
        return (
            f"{capitalised(names)} {'explain' if several else 'explains'} all that is missing, but most other effects "
            f"were not asked whether they explain as much ({percent(said.posterior.unseen)}). It gets no name yet."
            f"{unfinished}"
        )
    if best is not None and table.share(best) < WORTH:
        closest = "come closest, and leave" if several else "comes closest, and leaves"
        return (
            f"Something is missing, and no effect of the catalogue explains all of it: {names} {closest} "
            f"{_times(said):.3g} times the noise. It gets no name.{unfinished}"
        )
    return f"Something is missing, and nothing that was fitted explains it.{unfinished}" if unfinished else ""


def _times(said: Standing) -> float:
    """The most that the best structure leaves of any output, in units of its noise."""
    with np.errstate(invalid="ignore"):
        return float(np.nanmax(said.best.fitted.rmse / said.table.noise))


def _words(members: Iterable) -> str:
    return joined([lowered(f"{c.effect.title} at {c.site.name}") for c in members])


def findings_of(search: Search, said: Standing, doubts: Iterable[str]) -> list[str]:
    """What is to be said with the answer; doubts: labels of effects that the recordings which judge speak against."""
    table = said.table
    alone = [(c, table.entries.get((c.label,))) for c in table.candidates]
    found = [
        f"gap: {c.label} cannot be tried here ({e.failed}). The answer does not count it; correct that, or exclude it."
        for c, e in alone
        if e and e.failed
    ]
    tested = [c for c, e in alone if e and not e.failed and testable(e.fitted or e.look, c)]
    if said.verdict != "none" and not tested:
        found.append(
            "gap: none of the effects could be seen in these recordings, whatever its size. Record faster and larger "
            "motion in both directions, with pauses."
        )
    if not search.complete:
        looked = sum(bool(e and e.seen) for _, e in alone)
        found.append(
            f"gap: the time limit ended the search: {looked} of {len(alone)} candidates were looked at, "
            f"{len(table.fitted) - 1} structures fitted. The answer is the best of those. Give --time-limit more, or "
            "--effects the ones that you suspect."
        )
    found += [
        f"gap: {label} is named by what was learned from, but the recordings that judge are explained better without "
        "it. They choose nothing: it stays, and is less probable. The law of what is named may be the cause. Learn "
        "from one of those recordings, too, to decide it."
        for label in doubts
    ]
    if said.verdict == "class" and table.base.flat.black_box:
        found.append(
            "gap: no experiment was designed to tell the class apart: it would run the FMU hundreds of times. What "
            "separates its members stands with each of them."
        )
    base = table.entry().fitted
    if said.verdict == "unknown" and base.at_bound:
        found.append(
            f"gap: the base rests on a bound ({', '.join(base.at_bound)}): it may stand in for what is missing. Check "
            "these values."
        )
    return found


def _not_excited(flat: FlatModel, data: Split, elsewhere: Sequence[str]) -> str:
    """The answer when nothing but these recordings shows a gap."""
    further = further_out(flat, data.train, [r for r in data.report if r.name in elsewhere])
    return (
        f"Something is missing that shows in {', '.join(elsewhere)} only, kept to judge by: what the model was fitted "
        f"to shows none of it.{' ' * bool(further)}{further} Record more runs that move like that, and give them to be "
        "fitted to."
    )


def further_out(flat: FlatModel, fitted: Sequence[Recording], others: Sequence[Recording]) -> str:
    """The signals of ``others`` that most leave the range they had in ``fitted``, SI; empty when none does."""
    said = {}
    signals = [(s, "u", j) for j, s in enumerate(flat.inputs)] + [(s, "y", j) for j, s in enumerate(flat.outputs)]
    for signal, kind, j in signals:
        here, there = (np.concatenate([getattr(r, kind)[:, j] for r in some]) for some in (fitted, others))
        if not (np.isfinite(here).any() and np.isfinite(there).any()):
            continue
        low, high = np.nanmin(here), np.nanmax(here)
        reached = np.array([np.nanmin(there), np.nanmax(there)])
        outside = max(low - reached[0], reached[1] - high)
        if outside > FURTHER * (high - low):
            words = f"{signal.name} goes from {reached[0]:.3g} to {reached[1]:.3g} {signal.unit} there"
            said[f"{words} (fitted: {low:.3g} to {high:.3g})"] = outside / max(high - low, 1e-9 * abs(high), 1e-300)
    most = sorted(said, key=said.__getitem__, reverse=True)[:2]
    return f"The model was never tried so far out: {'; '.join(most)}." if most else ""
