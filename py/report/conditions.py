"""Scores by operating condition: a plot and tables for each tag of the recordings, the worst condition first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.comparison import FREE_RUN, Comparison, Score
from hydrotwin.models.language.flat import Signal

from .comparison_tables import HEADLINE_OUTPUTS
from .figure import Dot, Figure, FigureGroup, Style, dots
from .format import difference_to_shown, pretty_unit
from .page import Section
from .tables import Column, Table, counts, numbers, table, texts


def conditions_section(comparison: Comparison, shown: Mapping[str, str], look: Mapping[str, Style]) -> Section:
    """A plot of every recording and a table per tag and output; without tags the section has no parts."""
    tags = dict.fromkeys(tag for r in comparison.records for tag in r.tags)
    outputs = [s for s in comparison.outputs if comparison.ranking(s.name, comparison.modes[0])][:HEADLINE_OUTPUTS]
    parts = []
    for tag in tags:
        parts += _drawn(comparison, tag, outputs, (shown, look))
        parts += [_by_tag(comparison, tag, signal, shown) for signal in outputs]
    lead = (
        f"Mean RMSE in {comparison.modes[0]} over the recordings of each condition, the worst of the best model first. "
        "Where a model failed, it says on how many recordings it was scored."
    )
    return Section("conditions", "By operating condition", tuple(parts), lead)


@dataclass(frozen=True)
class _Told:
    """One output by one tag, in the first mode.

    names : value of the tag by recording. models : the best first. scores : by value of the tag and model. held : how
    many recordings of a value hold the output. values : of the tag, the one that is worst for the best model first.
    """

    names: Mapping[str, str]
    models: Sequence[str]
    scores: Mapping[tuple[str, str], Sequence[Score]]
    held: Counter
    values: Sequence[str]


def _told(comparison: Comparison, tag: str, output: str) -> _Told:
    mode, names = comparison.modes[0], {r.name: r.tags.get(tag, "not told") for r in comparison.records}
    models = [s.model for s in comparison.ranking(output, mode)]
    found: dict[tuple[str, str], list[Score]] = {}
    for s in comparison.scores:
        if (s.output, s.mode) == (output, mode):
            found.setdefault((names[s.record], s.model), []).append(s)
    held = Counter(names[r.name] for r in comparison.records if output in r.signals)
    worst = {v: _mean([s.rmse for s in found.get((v, models[0]), [])], held[v]) for v in dict.fromkeys(names.values())}
    return _Told(names, models, found, held, sorted(worst, key=lambda v: -worst[v]))


def _drawn(
    comparison: Comparison, tag: str, outputs: Sequence[Signal], how: tuple[Mapping[str, str], Mapping[str, Style]]
) -> list[FigureGroup]:
    """Every recording as a dot, an output a tab; none where the tag has one value."""
    shown, look = how
    hidden = comparison.yardsticks if comparison.modes[0] == FREE_RUN else frozenset()
    figures = []
    for signal in outputs:
        told, unit = _told(comparison, tag, signal.name), shown[signal.name]
        if len(told.values) < 2:
            continue
        models = {
            model: [
                Dot(k, value, f"{s.record}: {value:.3g} {pretty_unit(unit)}")
                for k, v in enumerate(told.values)
                for s in told.scores.get((v, model), ())
                if (value := float(difference_to_shown(s.rmse, s.unit, unit))) > 0.0
            ]
            for model in told.models
        }
        titles = tag, f"RMSE of {signal.name} [{pretty_unit(unit)}]"
        figures.append(Figure(f"by-{tag}-{signal.name}", signal.name, dots(told.values, models, look, titles, hidden)))
    caption = "Every recording is a dot. The worst condition of the best model first."
    return [FigureGroup(f"by-{tag}", f"By {tag}", tuple(figures), caption)] if figures else []


def _by_tag(comparison: Comparison, tag: str, signal: Signal, shown: Mapping[str, str]) -> Table:
    told = _told(comparison, tag, signal.name)
    names, values, held = told.names, told.values, told.held
    columns = [
        texts(tag, tag, values),
        counts("recordings", "Recordings", [sum(v == n for n in names.values()) for v in values]),
    ]
    for model in told.models:
        scored = [[s.rmse for s in told.scores.get((v, model), ())] for v in values]
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
