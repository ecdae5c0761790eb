"""The figures of a comparison: overlays, errors and error bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.comparison import FREE_RUN, Comparison
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .copies import copies
from .figure import MEASURED, Figure, FigureGroup, Style, band, error_bars, layout, line
from .format import difference_to_shown, pretty_unit, to_shown

BYTES_PER_POINT = 10.7  # two 32-bit floats in base64
BUDGET = 2.4e6  # bytes of curves in one page
FAR = 10.0  # times the smallest error: what is larger may leave the error axis
WIDE = 1.96  # standard deviations: a band of 95 %
MOST, FEWEST = 2400, 200  # points of one curve
CURVES = int(BUDGET / BYTES_PER_POINT / FEWEST) // 2  # predicted ones that fit, each with its error: no more are needed


def overlay_groups(comparison: Comparison, shown: Mapping[str, str], look: Mapping[str, Style]) -> list[FigureGroup]:
    """For each output a group: one figure per recording and mode, measurement and models above, errors below."""
    points, plotted = plan(comparison)
    copied = frozenset(c.fmu for c in copies(comparison))
    hidden = {mode: (comparison.yardsticks | copied) if mode == FREE_RUN else frozenset() for mode in comparison.modes}
    groups = []
    for signal in comparison.outputs:
        figures = [
            _overlay(comparison, signal, record, mode, shown[signal.name], look, points, hidden[mode])
            for mode in comparison.modes
            for record in plotted
            if signal.name in record.signals and _predictions(comparison, signal, record, mode)
        ]
        if figures:
            groups.append(FigureGroup(f"plot-{signal.name}", signal.name, tuple(figures), signal.description))
    return groups


def plan(comparison: Comparison) -> tuple[int, tuple[Record, ...]]:
    """Points per curve, and the recordings plotted, such that all curves fit into BUDGET."""
    lines = 2 * len(comparison.models) * len(comparison.modes) + len(comparison.modes)
    lines += 4 * len({(t.model, t.mode) for t in comparison.trajectories if t.deviation})
    per_record = len(comparison.outputs) * lines
    most_curves = int(BUDGET / BYTES_PER_POINT / FEWEST)
    kept = {t.record for t in comparison.trajectories}
    records = tuple(r for r in comparison.records if r.name in kept) or comparison.records
    count = max(1, min(len(records), most_curves // max(1, per_record)))
    points = int(BUDGET / BYTES_PER_POINT / max(1, per_record * count))
    return max(FEWEST, min(MOST, points)), records[:count]


def error_bar_groups(comparison: Comparison, shown: Mapping[str, str], look: Mapping[str, Style]) -> list[FigureGroup]:
    """For each mode a group: one figure of error bars per output. Yardsticks would dwarf the rest of a free run."""
    groups = []
    for mode in comparison.modes:
        figures = []
        for signal in comparison.outputs:
            bars = _bars(comparison, signal, mode, shown[signal.name])
            if bars:
                names = [r.name for r in comparison.records]
                spec = error_bars(names, bars, look, pretty_unit(shown[signal.name]))
                reach = error_range([np.array([b[2:] for b in of if b is not None]) for of in bars.values()])
                if reach is not None:
                    spec["layout"]["yaxis"]["range"] = list(reach)
                figures.append(Figure(f"bars-{mode.replace(' ', '-')}-{signal.name}", signal.name, spec))
        if figures:
            groups.append(FigureGroup(f"bars-{mode.replace(' ', '-')}", mode, tuple(figures)))
    return groups


def _overlay(comparison, signal: Signal, record: Record, mode: str, unit: str, look, points: int, hidden) -> Figure:
    predictions = _predictions(comparison, signal, record, mode)
    measured = record[signal.name]
    of_measured = {"width": 3.0, "points": points, "recorded": True}
    data = [line(record.time, to_shown(measured, signal.unit, unit), "measured", MEASURED, **of_measured)]
    errors = []
    for name, values in predictions.items():
        style, error = look[name], difference_to_shown(values - measured, signal.unit, unit)
        drawn = {
            "dash": style.dash,
            "width": style.width,
            "points": points,
            "hidden": name in hidden,
            "recorded": True,
        }
        data.append(line(record.time, to_shown(values, signal.unit, unit), name, style.colour, **drawn))
        deviation = comparison.deviation(name, record.name, signal.name, mode)
        if deviation is not None:
            wide = [side * WIDE * deviation for side in (-1, 1)]
            around, alone = ([to_shown(values + w, signal.unit, unit) for w in wide],
                             [difference_to_shown(w, signal.unit, unit) for w in wide])  # fmt: skip
            how = {"points": points, "hidden": name in hidden}
            data.append(band(record.time, around, name, style.colour, row=1, **how))
            errors.append(band(record.time, alone, name, style.colour, row=2, **how))
        errors.append(line(record.time, error, name, style.colour, row=2, legend=False, **drawn))
    data += errors
    label = pretty_unit(unit)
    titles = [f"{signal.name} [{label}]", f"error [{label}]"] if label else [signal.name, "error"]
    plan = layout("time [s]", titles, shares=(0.62, 0.38), height=520)
    reach = error_range([v - measured for name, v in predictions.items() if name not in hidden])
    if reach is not None:
        plan["yaxis2"]["range"] = difference_to_shown(reach, signal.unit, unit).tolist()
    spec = {"data": data, "layout": plan}
    row = mode if len(comparison.modes) > 1 else ""
    return Figure(f"{signal.name}-{mode.replace(' ', '-')}-{record.name}", record.name, spec, row=row)


def error_range(errors: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """Range of an error axis when some errors dwarf the rest, else None: the axis then fits all of them.

    It fits every error up to FAR times the smallest one, so that a model that ran away hides nothing.
    """
    sizes = [float(np.nanmax(np.abs(e))) for e in errors]
    near = [e for e, size in zip(errors, sizes, strict=True) if size <= FAR * min(sizes)]
    if len(near) == len(errors):
        return None
    low, high = min(float(np.nanmin(e)) for e in near), max(float(np.nanmax(e)) for e in near)
    margin = 0.06 * (high - low)
    return (low - margin, high + margin) if margin > 0.0 else None


def _predictions(comparison: Comparison, signal: Signal, record: Record, mode: str) -> dict[str, np.ndarray]:
    """Curves of the models scored on this output, by model."""
    scored = {s.model for s in comparison.scores if (s.record, s.output, s.mode) == (record.name, signal.name, mode)}
    return {m: comparison.trajectory(m, record.name, mode)[signal.name] for m in comparison.models if m in scored}


def _bars(comparison: Comparison, signal: Signal, mode: str, unit: str) -> dict[str, list]:
    found: dict[str, list] = {}
    known = {(s.model, s.record): s for s in comparison.scores if (s.output, s.mode) == (signal.name, mode)}
    for model in comparison.models:
        if mode == FREE_RUN and model in comparison.yardsticks:
            continue
        scores = [known.get((model, r.name)) for r in comparison.records]
        if any(scores):
            found[model] = [
                None
                if s is None
                else tuple(
                    float(difference_to_shown(v, s.unit, unit)) for v in (s.bias, s.deviation, s.lowest, s.highest)
                )
                for s in scores
            ]
    return found


def peak(comparison: Comparison, signal: Signal) -> float:
    """Largest measured magnitude of an output, SI, over all recordings that hold it."""
    sizes = [np.nanmax(np.abs(r[signal.name])) for r in comparison.records if signal.name in r.signals]
    return float(max(sizes, default=signal.nominal))
