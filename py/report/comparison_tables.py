"""The tables of a comparison."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from hydrotwin.comparison import FREE_RUN, Comparison, Residual, Score
from hydrotwin.learned.bands import GOOD

from .figure import Style
from .format import NONE, common_decimals, difference_to_shown, number_text, shown_unit, to_shown
from .tables import Cell, Column, Table, counts, numbers, table, texts, warned

HEADLINE_OUTPUTS = 4
FOLDED = 20  # rows


def headline(comparison: Comparison, shown: Mapping[str, str], look: Mapping[str, Style]) -> Table:
    """One row per model: RMSE of the first outputs in the first mode, fit, run time; best first."""
    mode = comparison.modes[0]
    first = [s for s in comparison.outputs if comparison.ranking(s.name, mode)][:HEADLINE_OUTPUTS]
    models = _by_rank(comparison, first[0].name if first else "", mode)
    columns = [_models(models, look), texts("kind", "Kind", [_kind(comparison, m) for m in models])]
    for signal in first:
        of = {s.model: s for s in comparison.ranking(signal.name, mode)}
        complete = _complete(of.values())
        values = [of[m].rmse if m in of else None for m in models]
        among = [m in complete for m in models]
        unit = shown[signal.name]
        columns.append(numbers(signal.name, signal.name, values, signal.unit, unit, best="min", among=among))
    if first:
        of = {s.model: s for s in comparison.ranking(first[0].name, mode)}
        fits = [of[m].fit_percent if m in of else None for m in models]
        among = [m in _complete(of.values()) for m in models]
        columns.append(
            numbers("fit_percent", f"Fit of {first[0].name}", fits, "%", decimals=2, best="max", among=among)
        )
        if any(s.recordings < len(comparison.records) for s in of.values()):
            columns.append(texts("recordings", "Recordings", [_coverage(of.get(m), comparison) for m in models]))
    seconds = comparison.seconds_per_simulated_second
    speed = [1.0 / seconds[m] if m in seconds and m not in comparison.yardsticks else None for m in models]
    columns.append(
        numbers(
            "real_time_factor",
            "× real time",
            speed,
            best="max",
            among=[m not in comparison.yardsticks for m in models],
            common=False,
            digits=2,
        )
    )
    left = len([s for s in comparison.outputs if comparison.ranking(s.name, mode)]) - len(first)
    more = f" {left} more output{'s are' if left > 1 else ' is'} below." if left > 0 else ""
    count = len(comparison.records)
    named = {r.name for r in comparison.train_records if not r.digest}
    known = sum(r.name in named or comparison.follows(r, comparison.train_rows) for r in comparison.records)
    role = "training" if known == count else "" if known else "validation"
    over = f"mean over the {count} {role} recordings".replace("  ", " ") if count > 1 else f"on the {role} recording"
    over += f" ({known} of them trained on)" if 0 < known < count else ""
    note = f"RMSE in {mode}, {over}; the best is bold.{more}"
    return table("headline", "", columns, note)


def score_tables(comparison: Comparison, shown: Mapping[str, str], look: Mapping[str, Style], mode: str) -> list[Table]:
    """For each output the means over the recordings, best first, and folded below it every recording."""
    found = []
    for signal in comparison.outputs:
        ranking = comparison.ranking(signal.name, mode)
        if not ranking:
            continue
        name = f"{mode.replace(' ', '_')}_{signal.name}"
        title = f"{signal.name}, {mode}"
        found.append(_mean_table(f"scores_{name}", title, ranking, shown[signal.name], look, comparison))
        rows = [s for s in comparison.scores if s.output == signal.name and s.mode == mode]
        order = {r.name: k for k, r in enumerate(comparison.records)}
        rows.sort(key=lambda s: (order[s.record], s.rmse))
        if len(comparison.records) > 1:
            found.append(_record_table(f"recordings_{name}", f"{title}: by recording", rows, shown[signal.name], look))
    return found


def run_times(comparison: Comparison, look: Mapping[str, Style]) -> Table:
    """Wall time per simulated second, fastest first."""
    timings = [t for t in comparison.timings if t.model not in comparison.yardsticks]
    rows = sorted(timings, key=lambda t: (comparison.modes.index(t.mode), t.seconds_per_simulated_second))
    values = [t.seconds_per_simulated_second for t in rows]
    first = [t.mode == comparison.modes[0] for t in rows]
    columns = [
        _models([t.model for t in rows], look),
        texts("mode", "Mode", [t.mode for t in rows]),
        numbers("seconds", "Median", values, "s", "ms", best="min", among=first, common=False),
        numbers("fastest", "Fastest", [t.fastest for t in rows], "s", "ms", common=False),
        numbers("slowest", "Slowest", [t.slowest for t in rows], "s", "ms", common=False),
        numbers("real_time_factor", "× real time", [1.0 / v for v in values], common=False),
        counts("runs", "Timed runs", [t.runs for t in rows]),
    ]
    note = "Wall time per simulated second on this machine. First runs, which may compile, are left out."
    return table("run_times", "", columns, note)


def domain_table(comparison: Comparison, look: Mapping[str, Style]) -> Table | None:
    """Share of each recording inside each model's training domain, or None when no domain is known."""
    rows = comparison.domains
    if not rows:
        return None
    inside = [d.inside_percent for d in rows]
    columns = [
        _models([d.model or "training recordings" for d in rows], look, "Seen by"),
        texts("record", "Recording", [d.record for d in rows]),
        warned(numbers("inside", "Inside", inside, "%"), [v < 95.0 for v in inside]),
        numbers("farthest", "Farthest outside, in widths", [d.farthest for d in rows]),
        texts(
            "beyond",
            "Leaves the domain",
            [", ".join(d.beyond) or ("nothing" if d.farthest <= 0 else "not told by an FMU") for d in rows],
        ),
    ]
    return table("domain", "", columns)


def explained_table(comparison: Comparison, look: Mapping[str, Style]) -> Table | None:
    """One row per model, one column per output: how far above the noise the error is, and what it follows."""
    rows = [r for r in comparison.residuals if r.model not in comparison.yardsticks]
    outputs = [s.name for s in comparison.outputs if any(r.output == s.name for r in rows)]
    models = [m for m in comparison.models if any(r.model == m for r in rows)]
    if not models:
        return None
    columns = [_models(models, look)]
    for output in outputs:
        worst = [_worst([r for r in rows if (r.model, r.output) == (m, output)]) for m in models]
        columns.append(Column(output, output, tuple(_explained(r) for r in worst)))
    note = "Worst recording of each: RMSE over the noise of the sensor, and the signal the error follows most."
    return table("explained", "", columns, note)


def _worst(rows: Sequence[Residual]) -> Residual | None:
    return max(rows, key=lambda r: r.times_noise if r.times_noise > 0.0 else 0.0, default=None)


def _explained(residual: Residual | None) -> Cell:
    if residual is None:
        return Cell(None, NONE)
    if residual.only_noise:
        return Cell(residual.times_noise, "only noise", best=True)
    size = f"{number_text(residual.times_noise, 2)} × noise" if residual.times_noise > 0.0 else "error"
    follows = f", follows {residual.follows}" if residual.follows else ""
    return Cell(residual.times_noise, size + follows)


def residual_tables(comparison: Comparison, look: Mapping[str, Style]) -> list[Table]:
    """For each output what each model leaves unexplained in free run."""
    found = []
    for signal in comparison.outputs:
        of = [r for r in comparison.residuals if r.output == signal.name and r.model not in comparison.yardsticks]
        rank = _by_rank(comparison, signal.name, FREE_RUN)
        rows = sorted(of, key=lambda r: rank.index(r.model))
        if not rows:
            continue
        white = [r.white_percent for r in rows]
        columns = [
            _models([r.model for r in rows], look),
            texts("record", "Recording", [r.record for r in rows]),
            numbers("explained", "Explained", [r.explained_percent for r in rows], "%", decimals=2),
            numbers("times_noise", "RMSE / noise", [r.times_noise for r in rows], common=False),
            numbers("white", "Lags like white noise", white, "%", common=False),
            numbers(
                "correlation_time", "Correlation time", [r.correlation_time for r in rows], "s", common=False, digits=2
            ),
            texts(
                "follows",
                "Error follows",
                [r.follows or ("nothing" if r.only_noise else "nothing recorded") for r in rows],
            ),
            numbers("strength", "Correlation", [r.strength if r.follows else None for r in rows], digits=2),
            numbers("lag", "After", [r.lag if r.follows else None for r in rows], "s", common=False, digits=2),
        ]
        found.append(table(f"residuals_{signal.name}", f"{signal.name} in detail", columns, folded=True))
    return found


def start_table(comparison: Comparison, look: Mapping[str, Style]) -> Table | None:
    """Estimated start states by model and recording, or None."""
    rows = [(s.model, s.estimate, state) for s in comparison.starts for state in s.estimate.states]
    if not rows:
        return None
    states = [s for _, _, s in rows]
    units = [shown_unit(s.unit, peak=abs(s.value)) for s in states]

    def shown(values: Sequence[float], digits: int, change=to_shown) -> list[str]:
        changed = [float(change(v, s.unit, u)) for v, s, u in zip(values, states, units, strict=True)]
        return [number_text(v, digits) for v in changed]

    columns = [
        _models([model for model, _, _ in rows], look),
        texts("record", "Recording", [e.record for _, e, _ in rows]),
        texts("state", "State", [s.name for s in states]),
        texts("value", "Estimated", shown([s.value for s in states], 5)),
        texts("sigma", "±", shown([s.sigma for s in states], 2, difference_to_shown)),
        texts("assumed", "Without an estimate", shown([s.assumed for s in states], 5)),
        texts("unit", "Unit", units),
        numbers("from", "From", [e.seconds[0] for _, e, _ in rows], "s"),
        numbers("until", "to", [e.seconds[1] for _, e, _ in rows], "s"),
        counts("samples", "Samples", [e.samples for _, e, _ in rows]),
    ]
    return table("starts", "", columns, folded=len(rows) > FOLDED)


def failure_table(comparison: Comparison, look: Mapping[str, Style]) -> Table | None:
    """What failed, and why, or None."""
    rows = comparison.failures
    if not rows:
        return None
    columns = [
        _models([f.model for f in rows], look),
        texts("record", "Recording", [f.record for f in rows]),
        texts("mode", "Mode", [f.mode for f in rows]),
        texts("sentence", "What happened", [f.sentence.removeprefix(f"{f.model}: ") for f in rows]),
    ]
    return table("failures", "Failed", columns)


def unscored_table(comparison: Comparison, look: Mapping[str, Style]) -> Table | None:
    """Outputs that could not be compared, and why, one row for each cause; or None."""
    where: dict[tuple[str, str, str], dict[str, None]] = {}
    for u in comparison.unscored:
        where.setdefault((u.model, u.record, u.reason), {})[u.output] = None
    rows: dict[tuple[str, tuple[str, ...], str], list[str]] = {}
    for (model, record, reason), outputs in where.items():
        rows.setdefault((model, tuple(outputs), reason), []).append(record)
    if not rows:
        return None
    columns = [
        _models([model for model, _, _ in rows], look),
        texts("record", "Recording", [", ".join(records) for records in rows.values()]),
        texts("output", "Output", [", ".join(outputs) for _, outputs, _ in rows]),
        texts("reason", "Not scored, because", [reason for _, _, reason in rows]),
    ]
    return table("unscored", "Not scored", columns, folded=True)


def _mean_table(id, title, ranking: Sequence[Score], unit: str, look, comparison: Comparison) -> Table:
    most = len(comparison.records)
    columns = [_models([s.model for s in ranking], look), *_metrics(ranking, unit)]
    if any(s.recordings < most for s in ranking):
        columns.append(texts("recordings", "Recordings", [_coverage(s, comparison) for s in ranking]))
    return table(id, title, columns)


def _record_table(id, title, rows: Sequence[Score], unit: str, look) -> Table:
    columns = [texts("record", "Recording", [s.record for s in rows]), _models([s.model for s in rows], look)]
    return table(id, title, [*columns, *_metrics(rows, unit, best=False)], folded=True)


def _metrics(rows: Sequence[Score], unit: str, best: bool = True) -> list[Column]:
    among = [s.model in _complete(rows) for s in rows] if best else [s.relative == 1.0 for s in rows]
    low, high = ("min", "max") if best else ("", "")
    decimals = common_decimals([float(difference_to_shown(s.rmse, s.unit, unit)) for s in rows])

    def errors(key: str, title: str, mark: str) -> Column:
        return numbers(
            key, title, [getattr(s, key) for s in rows], rows[0].unit, unit, best=mark, among=among, decimals=decimals
        )

    columns = [
        errors("rmse", "RMSE", low),
        errors("mae", "MAE", low),
        errors("maximum", "Maximum", low),
        numbers("fit_percent", "Fit", [s.fit_percent for s in rows], "%", decimals=2, best=high, among=among),
        errors("bias", "Mean error", ""),
        numbers("relative", "× best RMSE", [s.relative for s in rows], common=False),
        *_bands(rows, unit),
    ]
    return columns if best else [_marked(c, among) if c.key == "rmse" else c for c in columns]


def _bands(rows: Sequence[Score], unit: str) -> list[Column]:
    """How the 95 % bands hold, where a model has one: too narrow or too wide is warned of."""
    if not any(math.isfinite(s.coverage) for s in rows):
        return []
    low, high = GOOD
    inside = numbers("coverage", "Inside the 95 % band", [100 * s.coverage for s in rows], "%", common=False)
    return [
        warned(inside, [math.isfinite(s.coverage) and not low <= s.coverage <= high for s in rows]),
        numbers("crps", "CRPS", [s.crps for s in rows], rows[0].unit, unit, common=False),
        numbers("nlpd", "NLPD", [s.nlpd for s in rows], common=False),
    ]


def band_table(comparison: Comparison, look: Mapping[str, Style]) -> Table | None:
    """What the band of every model and output is made of, and whether it is trusted; None where no model has one.

    A model without any has one row: it says so.
    """
    scored, words = {s.name for s in comparison.outputs}, {True: "yes", False: "no", None: "not judged"}
    rows = []
    for entrant in (e for e in comparison.entrants if e.name not in comparison.yardsticks):
        had = [b for b in entrant.bands if b.output in scored]
        rows += [(entrant.name, b.output, b.source, words[b.trusted], _sentence(b.why)) for b in had]
        lacking = [s.name for s in entrant.outputs if s.name in scored - {b.output for b in had}]
        rows += [(entrant.name, ", ".join(lacking), "none", "", "")] if lacking else []
    if all(row[2] == "none" for row in rows):
        return None
    models, *others = zip(*rows, strict=True)
    keys = (("output", "Output"), ("source", "Band"), ("trusted", "Trusted"), ("why", "Why"))
    columns = [texts(key, title, list(cells)) for (key, title), cells in zip(keys, others, strict=True)]
    return table("bands", "What the bands are", [_models(models, look), *columns], folded=len(rows) > FOLDED)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


def _marked(column: Column, where: Sequence[bool]) -> Column:
    return replace(column, cells=tuple(replace(c, best=w) for c, w in zip(column.cells, where, strict=True)))


def _coverage(score: Score | None, comparison: Comparison) -> str:
    return f"{score.recordings if score else 0} of {len(comparison.records)}"


def _models(names: Sequence[str], look: Mapping[str, Style], title: str = "Model") -> Column:
    return texts("model", title, list(names), [look[n].colour if n in look else "" for n in names])


def _kind(comparison: Comparison, model: str) -> str:
    return next(e.kind for e in comparison.entrants if e.name == model)


def _complete(rows) -> set[str]:
    rows = list(rows)
    most = max((s.recordings for s in rows), default=0)
    return {s.model for s in rows if s.recordings == most}


def _by_rank(comparison: Comparison, output: str, mode: str) -> list[str]:
    ranked = [s.model for s in comparison.ranking(output, mode)]
    return ranked + [m for m in comparison.models if m not in ranked]
