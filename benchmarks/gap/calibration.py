"""Are stated probabilities right, and how long do answers take: by style of command and machine, from finished rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .score import brier

BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)  # of stated probability; a bin holds its lower edge, the last both
LENGTHS = (30.0, 60.0, 120.0, 300.0)  # s, between the columns of the times
GROUPS = ("excitation", "machine")


@dataclass(frozen=True)
class Bin:
    """Names stated with a probability between two edges: how many, their mean probability, how many were right."""

    low: float
    high: float
    names: int
    stated: float
    right: float


def statements(rows: Sequence[Mapping]) -> list[tuple[float, bool]]:
    """(stated probability, whether it was right) of every name in finished rows."""
    return [(float(p), bool(hit)) for r in rows for p, hit in r["stated"]]


def reliability(said: Sequence[tuple[float, bool]]) -> list[Bin]:
    """Stated probability against hit rate, in five bins; a bin without names has nan."""
    probability, right = (np.array([pair[k] for pair in said], dtype=float) for k in (0, 1))
    where = np.clip(np.searchsorted(BINS, probability, side="right") - 1, 0, len(BINS) - 2)
    found = []
    for k, (low, high) in enumerate(pairwise(BINS)):
        here = where == k
        means = (float(v[here].mean()) if here.any() else np.nan for v in (probability, right))
        found.append(Bin(low, high, int(here.sum()), *means))
    return found


def times(rows: Sequence[Mapping]) -> dict[str, float]:
    """Seconds of finished rows: median, 90th percentile, most, and how many lie between the `LENGTHS`."""
    seconds = np.array([r["seconds"] for r in rows if r.get("seconds") is not None], dtype=float)
    if not len(seconds):
        return {}
    counts = np.histogram(seconds, [0.0, *LENGTHS, np.inf])[0]
    between = [f"to {LENGTHS[0]:g} s", *(f"to {high:g} s" for high in LENGTHS[1:]), f"over {LENGTHS[-1]:g} s"]
    summary = {"median": np.median(seconds), "90th %": np.quantile(seconds, 0.9), "most": seconds.max()}
    return {k: float(v) for k, v in {**summary, **dict(zip(between, counts, strict=True))}.items()}


def markdown(rows: Sequence[Mapping], title: str) -> list[str]:
    """Tables of one method: all rows, then by style of command and by machine."""
    done = [r for r in rows if "verdict" in r]
    groups = {"all": done}
    for key in GROUPS:
        groups |= {f"{value}": [r for r in done if r[key] == value] for value in sorted({r[key] for r in done})}
    told, took = f"### {title}: probabilities", f"### {title}: seconds"
    return [told, "", *_reliability(groups), "", took, "", *_times(groups), ""]


def _reliability(groups) -> list[str]:
    heads = [f"{low:.1f}-{high:.1f}" for low, high in pairwise(BINS)]
    lines = [f"| stated: right (names) | {' | '.join(heads)} | Brier | names |", "|---" * (len(heads) + 3) + "|"]
    for name, rows in groups.items():
        said = statements(rows)
        cells = [f"{b.stated:.2f}: {b.right:.2f} ({b.names})" if b.names else "-" for b in reliability(said)]
        score = f"{brier(said):.3f}" if said else "-"
        lines.append(f"| {name} | {' | '.join(cells)} | {score} | {len(said)} |")
    return lines


def _times(groups) -> list[str]:
    found = {name: times(rows) for name, rows in groups.items()}
    heads = list(next((f for f in found.values() if f), {}))
    lines = [f"| seconds | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"] if heads else []
    return lines + [f"| {name} | {' | '.join(f'{v:.0f}' for v in f.values())} |" for name, f in found.items() if f]
