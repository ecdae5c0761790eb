"""Scores by operating condition: one table per tag of the recordings, the worst condition first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hydrotwin.comparison import Comparison

from .comparison_tables import HEADLINE_OUTPUTS
from .figure import Style
from .page import Section
from .tables import Column, Table, counts, numbers, table, texts


def conditions_section(comparison: Comparison, shown: Mapping[str, str], look: Mapping[str, Style]) -> Section:
    """A table per tag and output; without tags the section has no parts."""
    tags = dict.fromkeys(tag for r in comparison.records for tag in r.tags)
    outputs = [s for s in comparison.outputs if comparison.ranking(s.name, comparison.modes[0])][:HEADLINE_OUTPUTS]
    parts = [_by_tag(comparison, tag, signal, shown) for tag in tags for signal in outputs]
    lead = (
        f"Mean RMSE in {comparison.modes[0]} over the recordings of each condition, the worst of the best model first. "
        "Where a model failed, it says on how many recordings it was scored."
    )
    return Section("conditions", "By operating condition", tuple(parts), lead)


def _by_tag(comparison: Comparison, tag: str, signal, shown: Mapping[str, str]) -> Table:
    mode, names = comparison.modes[0], {r.name: r.tags.get(tag, "not told") for r in comparison.records}
    models = [s.model for s in comparison.ranking(signal.name, mode)]
    found: dict[tuple[str, str], list[float]] = {}
    for s in comparison.scores:
        if (s.output, s.mode) == (signal.name, mode):
            found.setdefault((names[s.record], s.model), []).append(s.rmse)
    held = Counter(names[r.name] for r in comparison.records if signal.name in r.signals)
    worst = {v: _mean(found.get((v, models[0]), []), held[v]) for v in dict.fromkeys(names.values())}
    values = sorted(worst, key=lambda v: -worst[v])
    columns = [
        texts(tag, tag, values),
        counts("recordings", "Recordings", [sum(v == n for n in names.values()) for v in values]),
    ]
    for model in models:
        scored = [found.get((v, model), []) for v in values]
        means = [float(np.mean(some)) if some else None for some in scored]
        column = numbers(model, model, means, signal.unit, shown[signal.name])
        columns.append(_partial(column, [(len(some), held[v]) for some, v in zip(scored, values, strict=True)]))
    return table(f"by_{tag}_{signal.name}", f"{signal.name} by {tag}", columns)


def _mean(errors: Sequence[float], count: int) -> float:
    """Infinite where a recording is missing: nothing is worse than a run that failed."""
    return float(np.mean(errors)) if errors and len(errors) == count else float("inf") if count else -1.0


def _partial(column: Column, counted: Sequence[tuple[int, int]]) -> Column:
    """The column with a warning where a model was scored on fewer recordings of a condition than there are."""
    cells = tuple(
        replace(c, text=f"{c.text} ({some} of {count})", tone="warning") if some < count else c
        for c, (some, count) in zip(column.cells, counted, strict=True)
    )
    return replace(column, cells=cells)
