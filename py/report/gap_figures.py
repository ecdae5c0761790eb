"""The figures of a gap report: residual maps, overlays, the waterfall, the parameter shifts, the proposed input."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from hydrotwin.discovery.answer.discovery import Discovery, Experiment, Overlay, Ranked, Region, Shift
from hydrotwin.discovery.answer.words import percent, placed

from .figure import MEASURED, PALETTE, Figure, FigureGroup, layout, line
from .format import difference_to_shown, number_text, shown_unit, to_shown
from .gap_text import capital, largest, unit_label
from .gap_words import AT_NOISE, ROLES

BEFORE, AFTER = PALETTE[1], PALETTE[0]
FAINT, AS_WELL = "#c3c9cf", "#56B4E9"  # turned down; explains the recordings as well
BYTES_PER_POINT = 10.7  # two 32-bit floats in base64
BUDGET = 1.6e6  # bytes of curves in one page
MOST, FEWEST = 2000, 250  # points of one curve
BARS = 14  # candidates drawn
PICTURE = 440  # height of the figure at the top: with the answer above it on the first screen
UNSEEN = ("report", "validate")  # roles of recordings never used for fitting


def region_groups(discovery: Discovery, shown: Mapping[str, str]) -> list[FigureGroup]:
    """For each output a group: the mean residual over one quantity after the other."""
    changed = bool(discovery.steps)
    outputs = dict.fromkeys(r.output for r in discovery.regions)
    groups = []
    for output in outputs:
        rows = [r for r in discovery.regions if r.output == output]
        figures = tuple(_region(r, shown.get(output, r.unit), changed) for r in rows)
        groups.append(FigureGroup(f"map-{output}", output, figures))
    return groups


def _region(region: Region, unit: str, changed: bool) -> Figure:
    over = shown_unit(region.over_unit, peak=largest(region.edges))
    edges = to_shown(region.edges, region.over_unit, over)
    named = [
        (
            "before" if changed else "base model",
            BEFORE,
            region.mean_before,
            region.error_before,
            region.significant_before,
        )
    ]
    if changed:
        named.append(("after", AFTER, region.mean_after, region.error_after, region.significant_after))
    data = []
    for k, (name, colour, mean, error, significant) in enumerate(named):
        mean, error = (difference_to_shown(v, region.unit, unit) for v in (mean, error))
        nudge = (k - (len(named) - 1) / 2) * 0.16
        data += _binned(name, colour, edges, mean, error, np.asarray(significant, bool), nudge)
    plan = layout(f"{region.over}{unit_label(over)}", [f"mean error{unit_label(unit)}"], height=360)
    plan |= {"hovermode": "closest"}
    plan["yaxis"] |= {"zerolinecolor": "#57606a"}
    caption = f"{int(np.sum(region.significant_before))} of {len(edges) - 1} bins differ from zero"
    caption += f" before, {int(np.sum(region.significant_after))} after." if changed else "."
    return Figure(f"map-{region.output}-{region.over}", region.over, {"data": data, "layout": plan}, caption=caption)


def _binned(name, colour, edges, mean, error, significant, nudge) -> list[dict]:
    """Steps over the bins, and on each a marker with its standard error, filled where it differs from zero."""
    centres, width = (edges[:-1] + edges[1:]) / 2, np.diff(edges)
    steps = {
        "type": "scatter",
        "mode": "lines",
        "line": {"color": colour, "width": 1.2, "shape": "hv"},
        "x": edges.tolist(),
        "y": [*mean.tolist(), float(mean[-1])],
        "opacity": 0.45,
        "hoverinfo": "skip",
        "showlegend": False,
        "legendgroup": name,
    }
    sure = ", differs from zero"
    told = [
        f"{m:.3g} ± {e:.2g} in {a:.4g} … {b:.4g}{sure if s else ''}" if math.isfinite(m) else ""
        for m, e, a, b, s in zip(mean, error, edges[:-1], edges[1:], significant, strict=True)
    ]
    points = {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "legendgroup": name,
        "x": (centres + nudge * width).tolist(),
        "y": mean.tolist(),
        "error_y": {"type": "data", "array": error.tolist(), "color": colour, "thickness": 1.6, "width": 4},
        "marker": {
            "size": [11 if s else 8 for s in significant],
            "color": [colour if s else "#ffffff" for s in significant],
            "line": {"color": colour, "width": 1.8},
        },
        "text": told,
        "hovertemplate": "%{text}<extra>" + name + "</extra>",
        "showlegend": False,
    }
    key = {"type": "scatter", "mode": "markers", "name": name, "legendgroup": name, "x": [None], "y": [None]}
    return [steps, points, key | {"marker": {"size": 10, "color": colour}}]


def overlay_groups(discovery: Discovery, shown: Mapping[str, str]) -> list[FigureGroup]:
    """For each output a group: one figure per recording, rows by role; measured, before and after, errors below."""
    points, drawn = overlay_plan(discovery)
    units = _units(discovery)
    groups = []
    for output in dict.fromkeys(name for o in drawn for name in o.measured):
        figures = [
            _overlay(discovery, o, output, units.get(output, "1"), shown.get(output, "1"), points)
            for o in drawn
            if output in o.measured and output in o.before
        ]
        if figures:
            groups.append(FigureGroup(f"plot-{output}", output, tuple(figures)))
    return groups


def picture(discovery: Discovery, shown: Mapping[str, str]) -> Figure | None:
    """The overlay that shows most, for the top of the page: of recordings never used where these show a gap."""
    points, drawn = overlay_plan(discovery)
    sizes = [(_times_noise(discovery, o, name), o, name) for o in drawn for name in o.measured if name in o.before]
    fresh = [s for s in sizes if s[1].role in UNSEEN and s[0] > AT_NOISE]
    sizes = fresh or sizes
    if not sizes:
        return None
    _, o, output = max(sizes, key=lambda s: s[0])
    figure = _overlay(discovery, o, output, _units(discovery).get(output, "1"), shown.get(output, "1"), points)
    spec = {**figure.spec, "layout": figure.spec["layout"] | {"height": PICTURE}}
    role = ROLES.get(o.role, o.role)
    gap = "the gap shows most" if discovery.verdict != "none" else "the difference is largest"
    caption = f"{output} of {o.record} ({role}), where {gap}. The error below is model minus measurement."
    return Figure("picture", "", spec, caption=caption)


def _times_noise(discovery: Discovery, o: Overlay, output: str) -> float:
    """RMSE of the model before over the noise of the sensor (the spread of the signal where it is not known)."""
    measured = np.asarray(o.measured[output], float)
    error = np.asarray(o.before[output], float) - measured
    known = np.isfinite(error)
    if not known.any():
        return 0.0
    noise = discovery.noise.get(output, math.nan)
    size = noise if math.isfinite(noise) and noise > 0.0 else float(np.std(measured[known]))
    return float(np.sqrt(np.mean(error[known] ** 2))) / size if size > 0.0 else 0.0


def overlay_plan(discovery: Discovery) -> tuple[int, tuple[Overlay, ...]]:
    """Points per curve and the recordings drawn, those never used first, such that all curves fit into BUDGET."""
    order = {"report": 0, "validate": 0, "fit": 1, "train": 1}
    overlays = sorted(discovery.overlays, key=lambda o: order.get(o.role, 3))
    curves = 6 if discovery.steps else 4
    each = max(1, curves * max((len(o.measured) for o in overlays), default=1))
    count = max(1, min(len(overlays), int(BUDGET / BYTES_PER_POINT / FEWEST) // each))
    points = int(BUDGET / BYTES_PER_POINT / (each * count))
    return max(FEWEST, min(MOST, points)), tuple(overlays[:count])


def _overlay(discovery: Discovery, o: Overlay, output: str, si: str, unit: str, points: int) -> Figure:
    measured = np.asarray(o.measured[output], float)
    runs = [("before" if discovery.steps else "base model", BEFORE, 1.8, np.asarray(o.before[output], float))]
    if discovery.steps and output in o.after:
        runs.append(("after", AFTER, 1.5, np.asarray(o.after[output], float)))
    data = [line(o.time, to_shown(measured, si, unit), "measured", MEASURED, width=3.0, points=points)]
    for name, colour, width, values in runs:
        data.append(line(o.time, to_shown(values, si, unit), name, colour, width=width, points=points))
    for name, colour, width, values in runs:
        error = difference_to_shown(values - measured, si, unit)
        data.append(line(o.time, error, name, colour, width=width, points=points, row=2, legend=False))
    label = unit_label(unit)
    titles, shares = [f"{output}{label}", f"error{label}"], [0.6, 0.4]
    for name, values in list(o.inputs.items())[:1]:
        title, values = _input(discovery, name, np.asarray(values, float))
        data.append(line(o.time, values, name, "#57606a", width=1.2, points=points, row=3, legend=False))
        titles, shares = [*titles, title], [*shares, 0.22]
    plan = layout("time [s]", titles, shares=shares, height=500 if len(shares) == 2 else 580)
    return Figure(f"plot-{output}-{o.record}", o.record, {"data": data, "layout": plan}, row=ROLES.get(o.role, o.role))


def _input(discovery: Discovery, name: str, values: np.ndarray) -> tuple[str, np.ndarray]:
    """Axis title and shown values of an input of the model."""
    si = next((s.unit for s in discovery.base.flat.inputs if s.name == name), "1")
    unit = shown_unit(si, peak=largest(values))
    return f"{name}{unit_label(unit)}", to_shown(values, si, unit)


def waterfall_figure(discovery: Discovery) -> Figure:
    """What is left after each effect, in noises; the drop of each, and the noise itself as a line at 1."""
    rungs = discovery.waterfall
    left = [r.times_noise for r in rungs]
    first, *later = rungs
    labels = [first.label, *(r.label for r in later), "what is left"]
    base = [0.0, *left[1:], 0.0]
    size = [left[0], *(a - b for a, b in pairwise(left)), left[-1]]
    colours = [BEFORE, *(AS_WELL for _ in later), AFTER]
    words = [_size(left[0]), *(f"{'−' if s >= 0 else '+'}{_size(abs(s))}" for s in size[1:-1]), _size(left[-1])]
    bars = {
        "type": "bar",
        "x": list(range(len(labels))),
        "y": size,
        "base": base,
        "marker": {"color": colours},
        "text": words,
        "textposition": "outside",
        "cliponaxis": False,
        "width": 0.62,
        "hovertemplate": "%{text} times the noise<extra></extra>",
        "showlegend": False,
    }
    plan = layout("", ["error over noise"], height=360)
    plan |= {"hovermode": "closest"}
    ticks = {"tickvals": list(range(len(labels))), "ticktext": [_wrapped(t) for t in labels]}
    plan["xaxis"] |= ticks | {"showgrid": False, "zeroline": False, "range": [-0.6, len(labels) - 0.4]}
    plan["yaxis"] |= {"range": [0, 1.15 * max(left)]}
    level = {"type": "scatter", "mode": "lines", "name": "noise of the sensors", "x": [-0.6, len(labels) - 0.4]}
    level |= {"y": [1, 1], "line": {"color": MEASURED, "width": 1.2, "dash": "dash"}, "hoverinfo": "skip"}
    return Figure("waterfall", "", {"data": [bars, level], "layout": plan | {"showlegend": True}})


def _size(value: float) -> str:
    return f"{value:.3g}" if value < 1e4 else number_text(value)


def shift_figure(shifts: tuple[Shift, ...]) -> Figure:
    """How far each parameter moved in sigmas of the difference; one that rests on a bound is a cross."""
    rows = [s for s in shifts[::-1] if math.isfinite(moved(s))]
    data = []
    for bound, name, colour, symbol in ((False, "moved", AFTER, "circle"), (True, "rests on a bound", BEFORE, "x")):
        of = [s for s in rows if s.at_bound is bound]
        if not of:
            continue
        marker = {"size": 11, "color": colour, "symbol": symbol}
        trace = {"type": "scatter", "mode": "markers", "name": name, "marker": marker}
        trace |= {"x": [moved(s) for s in of], "y": [s.name for s in of]}
        data.append(trace | {"hovertemplate": "%{y}: %{x:.3g} sigma<extra></extra>"})
    plan = layout("moved [σ]", [""], height=130 + 34 * len(rows))
    plan |= {"hovermode": "closest"}
    stems = [
        {"type": "line", "x0": 0, "x1": moved(s), "y0": s.name, "y1": s.name, "line": {"color": FAINT, "width": 2}}
        for s in rows
    ]
    band = {"type": "rect", "x0": -1.96, "x1": 1.96, "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    plan["shapes"] = [band | {"fillcolor": "#eef3f7", "line": {"width": 0}}, *(s | {"layer": "below"} for s in stems)]
    plan["yaxis"] |= {"categoryorder": "array", "categoryarray": [s.name for s in rows], "zeroline": False}
    caption = "After minus before, in standard deviations of the difference. Shaded: 95 % of chance."
    return Figure("shifts", "", {"data": data, "layout": plan}, caption=caption)


def moved(shift: Shift) -> float:
    """The move in standard deviations of the difference; nan when neither sigma is known."""
    squares = [s**2 for s in (shift.sigma_before, shift.sigma_after) if math.isfinite(s)]
    size = math.sqrt(sum(squares))
    return (shift.after - shift.before) / size if size > 0.0 else math.nan


def experiment_figure(experiment: Experiment) -> Figure:
    """The proposed input over time."""
    values = np.asarray(experiment.values, float)
    unit = shown_unit(experiment.unit, peak=largest(values))
    trace = line(experiment.time, to_shown(values, experiment.unit, unit), experiment.input, AFTER, legend=False)
    plan = layout("time [s]", [f"{experiment.input}{unit_label(unit)}"], height=320)
    return Figure("experiment", "", {"data": [trace], "layout": plan})


def candidate_figure(ranked: tuple[Ranked, ...], id: str) -> Figure | None:
    """Gap closed by each fitted candidate; what was named or could be as well is coloured. None without any."""
    rows = [r for r in ranked if math.isfinite(r.gap_closed)][:BARS]
    if not rows:
        return None
    colour = {"named": AFTER, "in class": AS_WELL}
    sizes, words = [max(r.gap_closed, -0.2) for r in rows], [percent(r.gap_closed) for r in rows]
    labels, colours = [capital(placed(r)) for r in rows], [colour.get(r.fate, FAINT) for r in rows]
    caption = "Of the fits of the search. Dark: named. Light blue: explains the recordings as well. Grey: turned down."
    return lying_bars(id, "gap closed [%]", labels, sizes, words, colours, caption)


def lying_bars(
    id: str,
    title: str,
    labels: Sequence[str],
    shares: Sequence[float],
    words: Sequence[str],
    colours: Sequence[str],
    caption: str,
) -> Figure:
    """Shares as bars from left to right, the first at the top, each under its label."""
    places = list(range(len(labels)))
    bars = {
        "type": "bar",
        "orientation": "h",
        "y": places,
        "x": [100.0 * s for s in shares][::-1],
        "width": 0.42,
        "marker": {"color": list(colours)[::-1]},
        "text": list(words)[::-1],
        "textposition": "outside",
        "cliponaxis": False,
        "hovertemplate": "%{text}<extra></extra>",
        "showlegend": False,
    }
    plan = layout(title, [""], height=100 + 46 * len(labels))
    plan |= {"hovermode": "closest", "annotations": [_over_bar(t, k) for k, t in enumerate(labels[::-1])]}
    plan["margin"] = plan["margin"] | {"l": 20, "t": 16}
    plan["xaxis"] |= {"range": [min(0.0, *bars["x"], 0.0) * 1.25, max(*bars["x"], 10.0) * 1.25]}
    plan["yaxis"] |= {"showticklabels": False, "showgrid": False, "zeroline": False, "ticks": ""}
    plan["yaxis"] |= {"range": [-0.6, len(labels) - 0.2]}
    return Figure(id, "", {"data": [bars], "layout": plan}, caption=caption)


def _over_bar(text: str, place: int) -> dict:
    """A label above a lying bar, from the left edge of the plot: long names leave the bars their room."""
    shown = {"text": text, "showarrow": False, "font": {"size": 12}}
    return shown | {"x": 0, "y": place + 0.23, "xanchor": "left", "yanchor": "bottom", "xref": "paper", "yref": "y"}


def _units(discovery: Discovery) -> dict[str, str]:
    units = {r.output: r.unit for r in discovery.regions}
    units |= {o.output: o.unit for r in discovery.recordings for o in r.outputs}
    return units | {o.output: o.unit for rows in discovery.outputs.values() for o in rows}


def _wrapped(label: str) -> str:
    return label.replace(" at ", "<br>at ")
