"""Scores by operating condition: one table per tag of the recordings, the worst condition first."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydrotwin.comparison import Comparison

from .comparison_tables import HEADLINE_OUTPUTS
from .figure import Style
from .page import Section
from .tables import Table, counts, numbers, table, texts


def conditions_section(comparison: Comparison, shown: Mapping[str, str], look: Mapping[str, Style]) -> Section:
    """A table per tag and output; without tags the section has no parts."""
    tags = dict.fromkeys(tag for r in comparison.records for tag in r.tags)
    outputs = [s for s in comparison.outputs if comparison.ranking(s.name, comparison.modes[0])][:HEADLINE_OUTPUTS]
    parts = [_by_tag(comparison, tag, signal, shown) for tag in tags for signal in outputs]
    lead = (
        f"Mean RMSE in {comparison.modes[0]} over the recordings of each condition, the worst of the best model first."
    )
    return Section("conditions", "By operating condition", tuple(parts), lead)


def _by_tag(comparison: Comparison, tag: str, signal, shown: Mapping[str, str]) -> Table:
    mode, names = comparison.modes[0], {r.name: r.tags.get(tag, "not told") for r in comparison.records}
    models = [s.model for s in comparison.ranking(signal.name, mode)]
    means = {}
    for s in comparison.scores:
        if (s.output, s.mode) == (signal.name, mode):
            means.setdefault((names[s.record], s.model), []).append(s.rmse)
    values = sorted(
        dict.fromkeys(names.values()), key=lambda v: -float(np.mean(means.get((v, models[0]), [float("inf")])))
    )
    columns = [
        texts(tag, tag, values),
        counts("recordings", "Recordings", [sum(v == n for n in names.values()) for v in values]),
    ]
    for model in models:
        errors = [float(np.mean(means[v, model])) if (v, model) in means else None for v in values]
        columns.append(numbers(model, model, errors, signal.unit, shown[signal.name]))
    return table(f"by_{tag}_{signal.name}", f"{signal.name} by {tag}", columns)
