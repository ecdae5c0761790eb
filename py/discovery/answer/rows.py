"""Rows: every candidate beside what was named before it, with what speaks for and against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from hydrotwin.models.effects import Candidate

from ..evidence.deciding import DECIDING
from ..fits.whole import Concluded
from ..structures.extent import testable
from ..structures.table import Entry, Table
from .discovery import EffectParameter, Ranked
from .standing import Standing, closed

SHOWN = 12  # candidates of a step in the answer that were not fitted
NO_BETTER = "leaves more than what is told, or no less for more parameters"


def rows_of(
    standing: Standing,
    before: Sequence[Candidate],
    named: Candidate | None,
    doubts: Mapping[str, float] = MappingProxyType({}),
    concluded: Mapping[str, Concluded] = MappingProxyType({}),
) -> tuple[Ranked, ...]:
    """The candidates of a step, the ``named`` first, then its class, then by what they leave.

    before : the effects in place. doubts : factors of probability, by label. concluded : final fits by label.
    """
    table = standing.table
    members = [c.label for c in standing.members(named)] if named and standing.best else []
    found = []
    for c in table.candidates:
        entry = _entry(standing, before, named, c)
        if c in before or entry is None:
            continue
        fate, reason = _fate(table, entry, c, named, members)
        final = concluded.get(c.label)
        values = concluded_values(c, final) if final else _as_fitted(table, entry, c)
        probability = standing.probability(c.label) * doubts.get(c.label, 1.0)
        found.append(
            Ranked(
                c.id, c.site.name, c.effect.title, c.effect.equation, _share(table, entry),
                table.score(entry) if entry.fitted else np.nan, closed(table, entry), probability, fate, reason,
                values,
            )
        )  # fmt: skip
    order = {"named": 0, "in class": 1}
    found.sort(key=lambda r: (order.get(r.fate, 2), np.nan_to_num(r.left, nan=np.inf), -np.nan_to_num(r.share)))
    fitted = [r for r in found if np.isfinite(r.left) or r.fate == "cannot be added"]
    return tuple(fitted + [r for r in found if r not in fitted][:SHOWN])


def _entry(standing: Standing, before: Sequence[Candidate], named: Candidate | None, c: Candidate) -> Entry | None:
    """What is known of a candidate beside those before, in the place of the named one where all others stand."""
    entries, order = standing.table.entries, {x.label: i for i, x in enumerate(standing.table.candidates)}

    def of(members) -> Entry | None:
        return entries.get(tuple(sorted((m.label for m in members), key=order.__getitem__)))

    if named is not None:
        full = of([*(m for m in standing.best.members if m is not named and m is not c), c])
        if full is not None and full.fitted:
            return full
    return of([*before, c])


def _fate(table: Table, entry: Entry, c: Candidate, named: Candidate | None, members: Sequence[str]) -> tuple[str, str]:
    if named is not None and c is named:
        return "named", ""
    if c.label in members:
        return "in class", "explains the recordings as well"
    if entry.failed:
        return "cannot be added", entry.failed
    if not testable(entry.fitted or entry.look, c):
        return "not testable", "it would not show in these recordings, whatever its size"
    if not entry.fitted and entry.foreseen:
        return (
            "not fitted",
            "to first order it explains less than half of what the best explains, which first order foresaw",
        )
    if not (entry.fitted or entry.look or np.isnan(entry.early)):
        why = NO_BETTER if entry.asked else "promises less than what was fitted"
        return "not fitted", f"in the beginnings of the recordings it {why}"
    if not entry.fitted and entry.asked:
        return "not fitted", "a few steps from where the best ended, it leaves more of the gap than what was fitted"
    if not entry.fitted:
        return "not fitted", "in short windows it promises less than what was fitted" if entry.look else "not looked at"
    return "rejected", NO_BETTER


def _share(table: Table, entry: Entry) -> float:
    if not (entry.look or entry.asked):
        return float(np.clip(1 - entry.early, 0.0, 1.0))
    return float(np.clip(1 - (entry.beside if entry.asked else table.promise(entry)), 0.0, 1.0))


def _as_fitted(table: Table, entry: Entry, candidate: Candidate) -> tuple[EffectParameter, ...]:
    """Values of an effect from a fit of the search, which has no intervals."""
    if not entry.fitted:
        return ()
    known = {p.name: p for p in table.model(entry).flat.parameters}
    nan = (np.nan, np.nan, np.nan)
    return tuple(
        EffectParameter(
            n, entry.fitted.values[n], known[n].unit, *nan, known[n].description, candidate.typical.get(n),
            n in entry.fitted.at_bound,
        )
        for n in candidate.free
    )  # fmt: skip


def concluded_values(candidate: Candidate, after: Concluded) -> tuple[EffectParameter, ...]:
    """Values of an effect with their intervals, from the final fit; empty for one that is not in it.

    sigma is that of the fit, as if the law were exact; the interval also holds that it is none (`Deciding.law`).
    """
    rows = {p.name: p for p in after.fit.parameters}
    found = []
    for name in (n for n in candidate.free if n in rows):
        p = rows[name]
        moved = min(abs(p.value), abs(p.value - candidate.neutral[name]) or np.inf)
        reach = 1.96 * np.hypot(p.sigma, DECIDING.law * moved) if np.isfinite(p.sigma) else np.nan
        low, high = np.clip([p.value - reach, p.value + reach], *p.bounds)
        text = next((f.description for f in after.fit.flat.parameters if f.name == name), "")
        interval = float(p.sigma), float(low), float(high)
        typical = candidate.typical.get(name)
        found.append(EffectParameter(name, p.value, p.unit, *interval, text, typical, bool(p.at_bound)))
    return tuple(found)
