"""Ranking: every candidate of a step with the evidence for and against it, and why it was not named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from hydrotwin.models.language.flat import ParameterValue

from .choose import Choice, label
from .discovery import EffectParameter, Ranked
from .refit import Concluded
from .screen import TESTABLE, Screened
from .structure import Tried

SHOWN = 12  # candidates of a step in the answer that were not refitted
FORM = 0.02  # of what an effect's parameter moved: machines keep to a law no better; from the benchmark's tuning seeds


def ranking(
    ranked: Sequence[Screened],
    tried: Sequence[Tried],
    choice: Choice | None,
    known: Mapping[str, ParameterValue],
    explained: float = 1.0,
    concluded: Mapping[str, Concluded] = MappingProxyType({}),
) -> tuple[Ranked, ...]:
    """Every candidate of a step, the named first; ``known`` are the declarations of their parameters by path.

    explained : how sure it is that the answer is among them; the rest of the probability is that of something else.
    concluded : final fits by label, for the intervals of those that have one.
    """
    members = [] if choice is None else list(choice.members)
    rows, done = [], set()
    for t in sorted(tried, key=lambda t: -(t.evidence.bic_gain if t.evidence else -np.inf)):
        rows.append(_ranked_tried(t, choice, members, known, explained, concluded.get(label(t))))
        done.add(label(t))
    for s in [s for s in ranked if s.candidate.label not in done][:SHOWN]:
        rows.append(
            Ranked(
                s.candidate.id, s.candidate.site.name, s.candidate.effect.title, s.candidate.effect.equation, s.share,
                np.nan, np.nan, np.nan, 0.0, "not refitted",
                _held_back(s, [r.effect for r in rows]),
            )
        )  # fmt: skip
    order = {"named": 0, "in class": 1}
    return tuple(sorted(rows, key=lambda r: (order.get(r.fate, 2), -np.nan_to_num(r.bic_gain, nan=-np.inf))))


def _held_back(s: Screened, tried: Sequence[str]) -> str:
    """Why a candidate was not refitted."""
    if not s.testable:
        return "it would not show in these recordings"
    simple = [name for name in s.candidate.effect.refines if name in tried]
    if simple:
        return f"it refines {simple[0]} and waits until that is named"
    return "the screen promises too little"


def _ranked_tried(
    t: Tried,
    choice: Choice | None,
    members: Sequence[Tried],
    known: Mapping,
    explained: float,
    final: Concluded | None,
) -> Ranked:
    first = t.members[0]
    share = t.screened.share if t.screened else 0.0
    title = " and ".join(c.effect.title for c in t.members)
    equation = "; ".join(c.effect.equation for c in t.members)
    site = " + ".join(c.site.name for c in t.members) if len(t.members) == 1 else first.site.name
    name = " + ".join(c.id for c in t.members)
    if t.evidence is None:
        return Ranked(name, site, title, equation, share, np.nan, np.nan, np.nan, 0.0, "cannot be added", t.reason)
    probability = explained * choice.probability.get(label(t), 0.0) if choice else 0.0
    fate, reason = _fate(t, choice, members)
    e = t.evidence
    values = tuple(v for c in t.members for v in (concluded_values(c, final) if final else _as_fitted(t, c, known)))
    return Ranked(
        name, site, title, equation, share, e.bic_gain, e.paired_t, e.closed, probability, fate, reason, values
    )


def _as_fitted(t: Tried, candidate, known: Mapping) -> tuple[EffectParameter, ...]:
    """Values of an effect from a fit of the search, which has no intervals."""
    return tuple(
        EffectParameter(
            n, t.structure.fitted.values[n], known[n].unit, np.nan, np.nan, np.nan, known[n].description,
            candidate.typical.get(n),
        )
        for n in candidate.free
    )  # fmt: skip


def concluded_values(candidate, after: Concluded) -> tuple[EffectParameter, ...]:
    """Values of an effect with their intervals, from the final fit; empty for one that is not in it.

    sigma is that of the fit, as if the law were exact; the interval also holds that it is none (`FORM`).
    """
    rows = {p.name: p for p in after.fit.parameters}
    found = []
    for name in candidate.free:
        if name in rows:
            p = rows[name]
            moved = min(abs(p.value), abs(p.value - candidate.neutral[name]) or np.inf)
            reach = 1.96 * np.hypot(p.sigma, FORM * moved) if np.isfinite(p.sigma) else np.nan
            low, high = np.clip([p.value - reach, p.value + reach], *p.bounds)
            text = next((f.description for f in after.fit.flat.parameters if f.name == name), "")
            typical = candidate.typical.get(name)
            interval = float(p.sigma), float(low), float(high)
            found.append(EffectParameter(name, p.value, p.unit, *interval, text, typical, bool(p.at_bound)))
    return tuple(found)


def _fate(t: Tried, choice: Choice | None, members: Sequence[Tried]) -> tuple[str, str]:
    if choice is not None and label(t) == label(choice.best):
        return "named", ""
    if label(t) in [label(m) for m in members]:
        return "in class", "explains the recordings as well"
    if t.implausible:
        return "implausible", t.implausible
    if t.reason:
        return "rejected", t.reason
    e = t.evidence
    if choice is not None and label(t) in choice.probability:
        return "rejected", "passes alone, but another explains more, or the same more simply"
    if not e.bic_gain > 0:
        return "rejected", "explains no more than its parameters cost"
    if not e.paired_t > 2:
        return "rejected", "no better on held-out recordings"
    return "rejected", "too little evidence, or too small a part of the gap"


def untestable(s: Screened) -> Ranked:
    """A candidate that would not show in these recordings."""
    c = s.candidate
    reason = f"at its largest usual size it would show with |t| = {s.visible:.1f} (needed {TESTABLE:g})"
    if not s.column.size:
        reason = f"{c.site.name} was not recorded"
    return Ranked(
        c.id, c.site.name, c.effect.title, c.effect.equation, 0.0, np.nan, np.nan, np.nan, 0.0, "not testable", reason
    )
