"""The tables and the heat maps of an overview over the variants of a scenario, the worst first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.comparison import Comparison, Matrix, Score, VariantRun
from hydrotwin.models.language.flat import Signal

from .comparison_tables import HEADLINE_OUTPUTS
from .figure import Figure, FigureGroup, Style
from .format import NONE, difference_to_shown
from .heat_map import heat_map
from .tables import Cell, Column, Table, counts, linked, numbers, quiet, table, texts

MOST_ROWS, MOST_COLUMNS = 60, 24  # of a heat map: more nobody reads
MOST_CASES = 20  # the worst single runs
PAGE = "report.html"


@dataclass(frozen=True)
class Shown:
    """How things are shown: unit of each output, style of each model."""

    units: Mapping[str, str]
    look: Mapping[str, Style]


def page_of(run: VariantRun) -> str:
    """The way from the overview to the page of a variant; "" where nothing of it could be scored."""
    return f"{run.folder}/{PAGE}" if run.comparison.scores else ""


def outputs_of(matrix: Matrix) -> list[Signal]:
    """The first outputs that are scored in the first mode of any variant."""
    mode = matrix.base.modes[0]
    return [s for s in matrix.base.outputs if any(r.comparison.ranking(s.name, mode) for r in matrix.runs)]


def judged_model(matrix: Matrix) -> str:
    """The model that rows are ordered by: that of the criteria, else the first that is no yardstick."""
    if matrix.accepted:
        return matrix.accepted.model
    base = matrix.base
    return next((m for m in base.models if m not in base.yardsticks), base.models[0])


def headline(matrix: Matrix, how: Shown) -> Table:
    """A row for each variant: the mean RMSE of each model on the first output, the criteria, the detailed page."""
    outputs = outputs_of(matrix)
    signal, mode, judged = outputs[0], matrix.base.modes[0], judged_model(matrix)
    mean = {(r.name, s.model): s.rmse for r in matrix.runs for s in r.comparison.ranking(signal.name, mode)}
    runs = sorted(matrix.runs, key=lambda r: -mean.get((r.name, judged), float("inf")))
    columns = [_variants(runs)]
    models = [m for m in matrix.base.models if any((r.name, m) in mean for r in runs)]
    for model in models:
        values = [mean.get((r.name, model)) for r in runs]
        own = [model not in r.left for r in runs]
        column = numbers(model, model, values, signal.unit, how.units[signal.name], best="min", among=own)
        columns.append(quiet(column, [not one for one in own]))
    if matrix.accepted and matrix.accepted.judged:
        columns.append(Column("criteria", "Criteria", tuple(_verdict(r) for r in runs)))
    lost = [len({(f.model, f.record) for f in r.comparison.failures}) for r in runs]
    if any(lost):
        columns.append(counts("failed", "Failed runs", lost))
    note = (
        f"Mean RMSE of {signal.name} in {mode}, the variant in which {judged} is worst first; the best of each model "
        "is bold. Names lead to the detailed pages."
    )
    if any(r.left for r in runs):
        note += " Pale, in text in brackets: the variant leaves this model as it is, or comes to the same as another."
    return table("matrix", "", columns, note)


def _verdict(run: VariantRun) -> Cell:
    if not run.accepted or not run.accepted.judged:
        return Cell(None, NONE)
    missed, count = sum(not one.passed for one in run.accepted.judged), len(run.accepted.judged)
    if missed:
        return Cell(False, f"FAIL ({missed} of {count})", tone="warning")
    return Cell(True, f"PASS ({count})")


def variants_table(matrix: Matrix) -> Table:
    """What each variant changes, which models it leaves as they are, and why it could not be run."""
    runs = matrix.runs
    columns = [
        _variants(runs),
        texts(
            "changes",
            "Changes",
            [f"{r.variant} (comes to the same as {r.same_as})" if r.same_as else str(r.variant) for r in runs],
        ),
        texts(
            "as_base",
            "Leaves as they are",
            [", ".join(r.as_base) or "none" if r.variant.changes else NONE for r in runs],
        ),
    ]
    if any(r.failed for r in runs):
        told = Column("failed", "Failed", tuple(Cell(r.failed, r.failed or "no") for r in runs))
        columns.append(told)
    return table("variants", "", columns)


def every_table(matrix: Matrix, how: Shown) -> list[Table]:
    """For each of the first outputs every model in every variant, worst first, with its worst recording."""
    first, *others = outputs_of(matrix)[:HEADLINE_OUTPUTS]
    found = [_every(matrix, signal, how) for signal in (first, *others)]
    return [found[0], *(replace(t, folded=True) for t in found[1:])]


def _every(matrix: Matrix, signal: Signal, how: Shown) -> Table:
    mode = matrix.base.modes[0]
    base = {s.model: s.rmse for s in matrix.base.ranking(signal.name, mode)}
    rows = [(r, s) for r in matrix.runs for s in r.comparison.ranking(signal.name, mode) if s.model not in r.left]
    rows.sort(key=lambda row: -row[1].rmse)
    worst = _worst_recordings(matrix, signal.name, mode)
    unit, cases = how.units[signal.name], [worst[r.name, s.model] for r, s in rows]
    columns = [
        _variants([r for r, _ in rows]),
        _models([s.model for _, s in rows], how),
        numbers("rmse", "RMSE", [s.rmse for _, s in rows], signal.unit, unit),
        numbers("times_base", "× base", [_ratio(s, base) for _, s in rows], common=False),
        numbers("fit_percent", "Fit", [s.fit_percent for _, s in rows], "%", decimals=2),
        numbers("maximum", "Maximum", [s.maximum for _, s in rows], signal.unit, unit),
        texts("record", "Worst recording", [c.record for c in cases]),
        numbers("record_rmse", "RMSE there", [c.rmse for c in cases], signal.unit, unit),
    ]
    note = (
        "Models that a variant leaves as they are stand once, under base." if any(r.left for r in matrix.runs) else ""
    )
    return table(f"every_{signal.name}", f"{signal.name}, {mode}", columns, note, folded=len(rows) > MOST_ROWS)


def worst_table(matrix: Matrix, how: Shown) -> Table:
    """The worst single runs of the judged model by the RMSE of the first output."""
    signal, mode, judged = outputs_of(matrix)[0], matrix.base.modes[0], judged_model(matrix)
    tags = {r.name: r.tags for r in matrix.base.records}
    told = any(tags.values())
    rows = [(r, s) for r in matrix.runs for s in _own(r, signal.name, mode) if s.model == judged]
    rows = sorted(rows, key=lambda row: -row[1].rmse)[:MOST_CASES]
    base = {s.record: s.rmse for s in _own(matrix.runs[0], signal.name, mode) if s.model == judged}
    ratios = [s.rmse / base[s.record] if base.get(s.record) else None for _, s in rows]
    columns = [
        _variants([r for r, _ in rows]),
        texts("record", "Recording", [s.record for _, s in rows]),
        *([texts("condition", "Condition", [_condition(tags[s.record]) for _, s in rows])] if told else []),
        numbers("rmse", "RMSE", [s.rmse for _, s in rows], signal.unit, how.units[signal.name]),
        numbers("times_base", "× base", ratios, common=False),
    ]
    return table("worst", f"{judged}, {signal.name}, {mode}", columns)


def tag_tables(matrix: Matrix, how: Shown) -> list[Table]:
    """For each tag and the first output: variants and models by condition, the worst condition of a row marked."""
    signal, mode = outputs_of(matrix)[0], matrix.base.modes[0]
    found = []
    for tag in dict.fromkeys(tag for r in matrix.base.records for tag in r.tags):
        rows, columns, values = grouped(
            matrix, signal.name, mode, lambda record, tag=tag: record.tags.get(tag, "not told")
        )
        order = sorted(range(len(rows)), key=lambda k: -_largest(values[k]))
        cells = [
            numbers(name, f"{tag} = {name}", [values[k, j] for k in order], signal.unit, how.units[signal.name])
            for j, name in enumerate(columns)
        ]
        marked = [_marked(c, [values[k, j] == _largest(values[k]) for k in order]) for j, c in enumerate(cells)]
        some = [rows[k] for k in order]
        front = [_variants([r for r, _ in some]), _models([m for _, m in some], how)]
        title = f"{signal.name} by {tag}"
        found.append(table(f"variants_by_{tag}", title, [*front, *marked], folded=len(rows) > MOST_ROWS))
    return found


def failed_table(matrix: Matrix) -> Table | None:
    """What failed in which variant, each cause once; None where nothing did."""
    causes: dict[tuple[str, str, str, str], list[str]] = {}
    for run in matrix.runs:
        for f in run.comparison.failures:
            key = (run.name, f.model, f.mode, f.sentence.removeprefix(f"{f.model}: "))
            causes.setdefault(key, []).append(f.record)
    if not causes:
        return None
    names, models, modes, sentences = zip(*causes, strict=True)
    columns = [
        _variants([matrix[n] for n in names]),
        texts("model", "Model", models),
        texts("mode", "Mode", modes),
        counts("recordings", "Recordings", [len(r) for r in causes.values()]),
        texts("record", "The first", [r[0] for r in causes.values()]),
        texts("sentence", "What happened", sentences),
    ]
    return table("failed", "", columns)


def heat_maps(matrix: Matrix, how: Shown) -> FigureGroup | None:
    """For each of the first outputs: variants and models down, conditions (without tags recordings) across."""
    mode, figures = matrix.base.modes[0], []
    for signal in outputs_of(matrix)[:HEADLINE_OUTPUTS]:
        rows, columns, values = grouped(matrix, signal.name, mode, _label(matrix.base))
        down = sorted(range(len(rows)), key=lambda k: -_largest(values[k]))[:MOST_ROWS]
        across = sorted(range(len(columns)), key=lambda j: -_largest(values[:, j]))[:MOST_COLUMNS]
        shown = difference_to_shown(values[np.ix_(down, across)], signal.unit, how.units[signal.name])
        names = [f"{rows[k][1]} · {rows[k][0].name}" for k in down]
        axes = names, [columns[j] for j in across]
        figures.append(_drawn(signal, axes, shown, how, (len(rows), len(columns))))
    return FigureGroup("heat", "", tuple(figures)) if figures else None


def _drawn(signal: Signal, axes, values: np.ndarray, how: Shown, all_of: tuple[int, int]) -> Figure:
    figure = heat_map(f"heat-{signal.name}", signal.name, axes, values, how.units[signal.name])
    left = [f"{len(axis)} of {n} {what}" for axis, n, what in zip(axes, all_of, ("rows", "columns"), strict=True)
            if len(axis) < n]  # fmt: skip
    return replace(figure, caption=f"The worst {' and '.join(left)}." if left else "")


def grouped(matrix: Matrix, output: str, mode: str, group: Callable):
    """Rows (variant run, model), groups of recordings, and mean RMSE (rows, groups), SI, nan where there is none.

    Where a model failed on a recording of a group there is none: the mean of the others would hide it.
    group : recording -> name of its group. Models that a variant leaves as they are stand under the base alone.
    """
    of = {r.name: group(r) for r in matrix.base.records}
    columns = list(dict.fromkeys(of.values()))
    found: dict[tuple[int, str], dict[str, list[float]]] = {}
    for k, run in enumerate(matrix.runs):
        for s in _own(run, output, mode):
            found.setdefault((k, s.model), {}).setdefault(of[s.record], []).append(s.rmse)
    most = Counter(of[r.name] for r in matrix.base.records if output in r.signals)
    values = np.array(
        [
            [float(np.mean(one[c])) if len(one.get(c, ())) == most[c] > 0 else np.nan for c in columns]
            for one in found.values()
        ]
    )
    rows = [(matrix.runs[k], model) for k, model in found]
    return rows, columns, values.reshape(len(rows), len(columns))


def _own(run: VariantRun, output: str, mode: str) -> list[Score]:
    """Scores of what the variant changes, without yardsticks."""
    out = {*run.left, *run.comparison.yardsticks}
    return [s for s in run.comparison.scores if (s.output, s.mode) == (output, mode) and s.model not in out]


def _label(base: Comparison) -> Callable:
    """The condition of a recording; where none is told, or nearly each has its own, its name."""
    told = {_condition(r.tags) for r in base.records}
    return (lambda r: _condition(r.tags) or r.name) if any(told) else (lambda r: r.name)


def _condition(tags: Mapping[str, str]) -> str:
    return ", ".join(f"{tag}={value}" for tag, value in tags.items())


def _largest(values: np.ndarray) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else -1.0


def _worst_recordings(matrix: Matrix, output: str, mode: str) -> dict[tuple[str, str], Score]:
    found: dict[tuple[str, str], Score] = {}
    for run in matrix.runs:
        for s in run.comparison.scores:
            if (s.output, s.mode) == (output, mode):
                before = found.get((run.name, s.model))
                found[run.name, s.model] = s if before is None or s.rmse > before.rmse else before
    return found


def _ratio(score: Score, base: Mapping[str, float]) -> float | None:
    return score.rmse / base[score.model] if base.get(score.model) else None


def _marked(column: Column, where: Sequence[bool]) -> Column:
    cells = tuple(replace(c, tone="warning" if w else c.tone) for c, w in zip(column.cells, where, strict=True))
    return replace(column, cells=cells)


def _variants(runs: Sequence[VariantRun]) -> Column:
    return linked(texts("variant", "Variant", [r.name for r in runs]), [page_of(r) for r in runs])


def _models(names: Sequence[str], how: Shown) -> Column:
    return texts("model", "Model", list(names), [how.look[n].colour if n in how.look else "" for n in names])
