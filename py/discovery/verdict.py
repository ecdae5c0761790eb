"""Verdict: named, class, none or unknown, by what a search left where, and what is to be said with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hydrotwin.models.effects import Candidate

from .choose import against, label
from .decide import (
    CLEARLY,
    LARGE,
    SHOWN,
    T_NEEDED,
    WORTH,
    beyond_noise,
    bic_gain,
    closed,
    compared,
    gap_closed,
    has_gap,
)
from .recordings import Split
from .refit import Concluded, Question, Refitted, pooled_rmse
from .search import Search
from .structure import Structure

if TYPE_CHECKING:
    from hydrotwin.identification.problem import Recording

    from .answering import Found

FLOOR = 1.1  # of a sensor's noise: a floor worth telling
CONFIRMED = 0.5  # of the gap on recordings that took no part at all: less takes a name back
FURTHER = 0.1  # of the range that was fitted: beyond it a model is not what was tested
AGAINST = "recordings that were left out of the fit are explained better without it"
DOUBTED = "the recordings that judge are explained better without it"
NAMED = 0.75  # of the gap on held-out recordings: less is no explanation where it leaves something in those fitted, too


def verdict_of(search: Search, found: Found) -> str:
    """What the recordings of the search say; those that judge may take it back."""
    q = search.question
    base = found.base.fitted
    if not found.steps:
        gap = has_gap((*base.residuals_fit, *base.residuals_select), q.noise, CLEARLY).any()
        return "unknown" if gap else "none"
    left = has_gap(found.last.fitted.residuals_fit, q.noise, CLEARLY).any()
    if closed(found.last.fitted, base, q) < (NAMED if left else CONFIRMED):
        return "unknown"
    choices = (choice for step in found.steps for choice in step.choices())
    several = any(len({c.id for t in choice.members for c in t.members[:1]}) > 1 for choice in choices)
    return "class" if several else "named"


def only_elsewhere(search: Search, base: Structure, before: Concluded, data: Split) -> list[str]:
    """Recordings that took no part in the fit and show a large gap, when those of the fit show none."""
    q, fitted = search.question, base.fitted
    if has_gap(fitted.residuals_fit, q.noise, CLEARLY).any():
        return []
    held_out = [
        *zip(q.select, fitted.residuals_select, strict=True),
        *zip(data.report, before.residuals_report, strict=True),
    ]
    return [recording.name for recording, r in held_out if has_gap([r], q.noise, LARGE).any()]


def not_excited(search: Search, data: Split, elsewhere: Sequence[str]) -> str:
    """The answer when nothing but these recordings shows a gap."""
    shown = [r for r in (*data.select, *data.report) if r.name in elsewhere]
    further = further_out(search.base.flat, search.question.fit, shown)
    return (
        f"Something is missing that shows in {', '.join(elsewhere)} only, kept to judge by: what the model was fitted "
        f"to shows none of it.{' ' * bool(further)}{further} Record more runs that move like that, and give them to be "
        "fitted to."
    )


def further_out(flat, fitted: Sequence[Recording], others: Sequence[Recording]) -> str:
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


def unconfirmed(search: Search, found: Found) -> str:
    """The answer when an effect explains what was fitted to and held-out recordings do not say so; else empty."""
    base, q, best = found.base.fitted, search.question, likeliest(search, found)
    share = best and _closed_on_fit(best.fitted, base, q.noise)
    if not share or share < NAMED:
        return ""
    left = beyond_noise(base.residuals_fit, q.noise)
    shows = [r.name for r, size in zip(q.fit, left, strict=True) if size >= SHOWN * max(left)]
    what = " and ".join(f"{c.effect.title} at {c.site.name}" for c in best.members)
    return (
        f"Something is missing that gets no name yet: {what} would explain {100 * share:.0f} % of it where the model "
        f"was fitted ({', '.join(shows)}), but recordings that it was not fitted to do not confirm it. Record more "
        "runs that move like those."
    )


def likeliest(search: Search, found: Found) -> Structure | None:
    """What explains most of what was fitted to: as found; without a verdict, of that and what was kept from a name."""
    if found.steps and verdict_of(search, found) != "unknown":
        return found.last
    tried = [t for _, _, each in found.screens for t in each if t.evidence and not t.implausible]
    library = len(search.candidates)
    kept = [t.structure for t in tried if t.evidence.bic_gain > search.needed and not t.evidence.passes(library)]
    known = [found.last, *kept] if found.steps else kept
    return max(known, key=lambda s: bic_gain(s.fitted, found.base.fitted, search.question), default=None)


def _closed_on_fit(better: Refitted, base: Refitted, noise: np.ndarray) -> float:
    """Share of the gap of the fit recordings, no noise being larger than what the better one leaves."""
    return gap_closed(base.rmse, better.rmse, np.where(np.isfinite(noise), np.fmin(noise, better.rmse), noise))


def closed_where_it_counts(before: Concluded, after: Concluded, data: Split) -> float:
    """Share of the gap closed on the recordings that took no part; 1 where they show no gap or there are none."""
    if not data.report:
        return 1.0
    was, now = pooled_rmse(before.residuals_report), pooled_rmse(after.residuals_report)
    return gap_closed(was, now, data.noise) if np.any(was**2 > LARGE * data.noise**2) else 1.0


def doubted(members: Sequence[Candidate], others: Mapping[str, Concluded], after: Concluded, q: Question) -> dict:
    """What is left of the probability of an effect, by label, where the recordings that judge speak against it.

    members : the effects that were named; others : among them the fits "without LABEL"; ``after`` has them all. They
    are told as found: what judges lowers how sure that is, by as much as what chose would have.
    """
    left = {}
    for c in members:
        other = others.get(f"without {c.label}")
        over = other and compared(other.refitted, after.refitted, q)
        if over and over.paired_t > T_NEEDED and over.closed > WORTH:
            left[c.label] = against(over.paired_t)
    return left


def findings_of(
    search: Search, found: Found, verdict: str, shown: float, changing: bool, doubts: Sequence[str] = ()
) -> list[str]:
    """What is to be said of candidates, noise and verdict, unless ``changing``: then the answer has the reason.

    doubts : labels of named effects that the recordings which judge speak against.
    """
    said = [f"gap: {name} cannot be added here ({why})." for name, why in search.unusable.items()]
    tested = [c for c in search.candidates if c.label not in search.not_testable]
    if not tested:
        said.append(
            "gap: none of the effects could be seen in these recordings, whatever its size. Record faster and larger "
            "motion in both directions, with pauses."
        )
    names = [o.name for o in search.base.flat.outputs]
    for name, noise, sensor in zip(names, search.question.noise, search.sensors, strict=True):
        if noise > FLOOR * sensor:
            said.append(
                f"gap: the smoothed sign of the friction leaves {np.sqrt(noise**2 - sensor**2) / sensor:.2g} times the "
                f"noise in {name} by itself (found on a twin that truly sticks). No effect was looked for below that."
            )
    refuted = [t for _, _, tried in found.screens for t in tried if t.reason == AGAINST and len(t.members) == 1]
    said += [
        f"gap: {label(t)} would explain a part of what is left where the model was fitted, but {AGAINST}. It was taken "
        "back; the law of what is named may be the cause."
        for t in refuted
    ]
    said += [
        f"gap: {name} is named by what was learned from, but {DOUBTED}. They choose nothing: it stays, and is less "
        "probable. The law of what is named may be the cause. Learn from one of those recordings, too, to decide it."
        for name in doubts
    ]
    if verdict in ("named", "class") and not search.question.held_out:
        said.append(
            "gap: what some recordings show the others do not, so none was kept to choose by: all were fitted to. The "
            "answer leaves nothing but noise in any of them."
        )
    if verdict == "class" and search.base.flat.black_box:
        said.append(
            "gap: no experiment was designed to tell the class apart: it would run the FMU hundreds of times. What "
            "separates its members stands with each of them."
        )
    if verdict == "unknown" and found.steps and not changing:
        names = ", ".join(label(step.choice.best) for step in found.steps)
        share = closed(found.last.fitted, found.base.fitted, search.question)
        also = f", but only {100 * shown:.0f} % on the recordings that judge" if shown < CONFIRMED <= share else ""
        said.append(
            f"gap: {names} would close {100 * share:.0f} % of the gap on held-out recordings{also}. That is too little "
            "for a name: something else is missing."
        )
    return said
