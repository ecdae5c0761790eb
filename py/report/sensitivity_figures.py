"""The figures of a sensitivity report: indices, when each parameter acts, correlation, profiles, what is next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.identification import Profile, Profiles, Sensitivity
from hydrotwin.identification.influence.walk import LEVEL

from .figure import MEASURED, PALETTE, Figure, FigureGroup, layout, line, styles
from .format import difference_to_shown, pretty_unit, shown_unit, to_shown
from .gap_figures import lying_bars

FEW = 6  # parameters whose curves are shown at once; the others wait in the legend
BLUES = [[0.0, "#ffffff"], [0.25, "#cfe3f2"], [1.0, PALETTE[0]]]
BOTH = [[0.0, PALETTE[1]], [0.5, "#ffffff"], [1.0, PALETTE[0]]]


def index_group(found: Sensitivity) -> FigureGroup:
    """For each output, total and first-order indices as bars, with their 95 % intervals."""
    names = [p.name for p in found.parameters]
    whole, figures = found.sobol.whole, []
    for j, signal in enumerate(found.outputs):
        if not np.isfinite(whole.total[j]).all():
            continue
        order = np.argsort(whole.total[j])
        bars = [
            _bars("with all it acts in (total)", [names[k] for k in order], whole.total[j][order],
                  whole.total_half[j][order], PALETTE[0]),
            _bars("alone (first order)", [names[k] for k in order], whole.first[j][order],
                  whole.first_half[j][order], PALETTE[5]),
        ]  # fmt: skip
        plan = layout("share of the variance [%]", [""], height=150 + 42 * len(names))
        plan |= {"barmode": "group", "hovermode": "closest", "bargap": 0.3}
        plan["xaxis"] |= {"rangemode": "tozero"}
        figures.append(Figure(f"indices-{signal.name}", signal.name, {"data": bars, "layout": plan}))
    return FigureGroup("indices", "Sobol indices over the intervals", tuple(figures))


def _bars(name: str, labels: Sequence[str], values: np.ndarray, halves: np.ndarray, colour: str) -> dict:
    return {
        "type": "bar",
        "orientation": "h",
        "name": name,
        "y": list(labels),
        "x": (100 * values).tolist(),
        "error_x": {"type": "data", "array": (100 * halves).tolist(), "thickness": 1.3, "width": 3, "color": MEASURED},
        "marker": {"color": colour},
        "hovertemplate": "%{y}: %{x:.3g} % ± %{error_x.array:.2g}<extra>" + name + "</extra>",
    }


def share_figure(found: Sensitivity) -> Figure:
    """Outputs over parameters, the darker the more."""
    names, outputs = [p.name for p in found.parameters], [s.name for s in found.outputs]
    spec = _map(names, outputs[::-1], 100 * found.shares[::-1], "%", BLUES, (0.0, 100.0))
    return Figure("shares", "", spec, caption="White: nothing. Blue: all of the variance of the output.")


def correlation_figure(found: Sensitivity) -> Figure:
    """Correlation of the parameters as a fit to these recordings would have it."""
    names = [p.name for p in found.parameters]
    spec = _map(names, names[::-1], found.known.correlation[::-1], "", BOTH, (-1.0, 1.0))
    caption = "Near 1 or −1: the recordings show the two only together. Empty: the recordings do not show it at all."
    return Figure("correlation", "", spec, caption=caption)


def _map(x: Sequence[str], y: Sequence[str], z: np.ndarray, unit: str, colours, limits) -> dict:
    told = [["" if not np.isfinite(v) else f"{v:.0f}" if unit else f"{v:.2f}" for v in row] for row in z]
    data = {
        "type": "heatmap",
        "x": list(x),
        "y": list(y),
        "z": [[float(v) if np.isfinite(v) else None for v in row] for row in z],
        "colorscale": colours,
        "zmin": limits[0],
        "zmax": limits[1],
        "text": told,
        "texttemplate": "%{text}",
        "xgap": 2,
        "ygap": 2,
        "showscale": False,
        "hovertemplate": "%{y}, %{x}: %{z:.3g} " + unit + "<extra></extra>",
    }
    plan = layout("", [""], height=150 + 34 * len(y))
    plan |= {"hovermode": "closest"}
    plan["xaxis"] |= {"showgrid": False, "ticks": "", "tickangle": -25}
    plan["yaxis"] |= {"showgrid": False, "ticks": "", "zeroline": False}
    plan["margin"] = plan["margin"] | {"t": 16}
    return {"data": [data], "layout": plan}


def course_groups(found: Sensitivity) -> list[FigureGroup]:
    """For each output a group, one figure a recording: how far half the interval of each parameter moves it, over time.

    Below, the output itself, and where indices were estimated, who has which share of each stretch.
    """
    groups = []
    for j, signal in enumerate(found.outputs):
        if not found.local.moved[j].any():
            continue
        figures = tuple(_course(found, j, k) for k in range(len(found.records)))
        groups.append(FigureGroup(f"course-{signal.name}", signal.name, figures))
    return groups


def _course(found: Sensitivity, j: int, k: int) -> Figure:
    curve, signal, names = found.local.curves[k], found.outputs[j], [p.name for p in found.parameters]
    unit = shown_unit(signal.unit, peak=float(np.abs(curve.outputs[:, j]).max()))
    look, strongest = styles(names), np.argsort(-found.local.moved[j])[:FEW]
    told = pretty_unit(unit)
    label = f" [{told}]" if told else ""
    data = []
    for i, name in enumerate(names):
        moved = difference_to_shown(curve.moved[:, j, i], signal.unit, unit)
        data.append(line(curve.time, moved, name, look[name].colour, dash=look[name].dash, hidden=i not in strongest))
    shown = to_shown(curve.outputs[:, j], signal.unit, unit)
    rows = [f"moved{label}", f"{signal.name}<br>{label.strip()}"]
    data.append(line(curve.time, shown, signal.name, MEASURED, row=2, legend=False))
    if found.sobol:
        rows.append("share [%]")
        data += _stacked(found, j, k, look)
    plan = layout("time [s]", rows, [2.0, 1.3, 1.2][: len(rows)], height=600 if found.sobol else 480)
    plan["barmode"] = "stack"
    return Figure(f"course-{signal.name}-{curve.record}", curve.record, {"data": data, "layout": plan})


def _stacked(found: Sensitivity, j: int, k: int, look) -> list[dict]:
    """Shares of the total indices of every stretch, as bars that fill it."""
    edges = np.array(found.records[k].edges)
    total = np.array([part.total[j] for part in found.sobol.by_stretch[k]])
    total = np.clip(np.nan_to_num(total), 0.0, None)
    share = 100 * total / np.maximum(total.sum(axis=1, keepdims=True), 1e-12)
    return [
        {
            "type": "bar",
            "name": p.name,
            "legendgroup": p.name,
            "showlegend": False,
            "x": (0.5 * (edges[:-1] + edges[1:])).tolist(),
            "width": np.diff(edges).tolist(),
            "y": share[:, i].tolist(),
            "marker": {"color": look[p.name].colour, "line": {"color": "#ffffff", "width": 1}},
            "xaxis": "x",
            "yaxis": "y3",
            "hovertemplate": "%{y:.3g} %<extra>" + p.name + "</extra>",
        }
        for i, p in enumerate(found.parameters)
    ]


def profile_group(profiles: Profiles) -> FigureGroup:
    """For each parameter its profile, the parabola of the fit beside it, and the level."""
    figures = tuple(_profile(p) for p in profiles.profiles)
    return FigureGroup("profiles", "Profile likelihoods", figures)


def _profile(found: Profile) -> Figure:
    unit = shown_unit(found.unit, peak=abs(found.value))
    told = pretty_unit(unit)
    grid = to_shown(found.grid, found.unit, unit)
    points = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "profile",
        "x": grid.tolist(),
        "y": found.rise.tolist(),
        "line": {"color": PALETTE[0], "width": 2},
        "marker": {"size": 6},
        "hovertemplate": "%{y:.3g} at %{x:.5g}<extra></extra>",
    }
    data = [points]
    sigma = 0.5 * (found.quadratic[1] - found.quadratic[0]) / np.sqrt(LEVEL) if found.quadratic else 0.0
    if sigma > 0:
        centre = float(np.mean(found.quadratic))
        reach = 1.3 * np.sqrt(LEVEL) * sigma
        x = np.linspace(centre - reach, centre + reach, 80)
        data.append({
            "type": "scatter",
            "mode": "lines",
            "name": "quadratic",
            "x": to_shown(x, found.unit, unit).tolist(),
            "y": (((x - centre) / sigma) ** 2).tolist(),
            "line": {"color": PALETTE[1], "width": 1.6, "dash": "dash"},
            "hoverinfo": "skip",
        })  # fmt: skip
    plan = layout(f"{found.name} [{told}]" if told else found.name, ["rise of chi-square"], height=360)
    plan |= {"hovermode": "closest"}
    plan["yaxis"] |= {"range": [0.0, 2.2 * LEVEL]}
    plan["shapes"] = [
        {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": LEVEL, "y1": LEVEL,
         "line": {"color": "#57606a", "width": 1, "dash": "dot"}}
    ]  # fmt: skip
    return Figure(f"profile-{found.name}", found.name, {"data": data, "layout": plan})


def next_figure(found: Sensitivity) -> Figure:
    """Measurements by how much their best parameter or band would narrow, the best first."""
    rows = found.measurements
    narrowest = [min(m.narrowed.values()) for m in rows]
    labels = [m.label for m in rows]
    words = [f"{100 * w:.2g} % of its width" for w in narrowest]
    colours = [{"sensor": PALETTE[0], "repeat": "#c3c9cf"}.get(m.kind, PALETTE[2]) for m in rows]
    caption = (
        "What would be left of the interval of the parameter that gains most. Blue: another sensor. Green: another "
        "input. Grey: the same once more."
    )
    return lying_bars("next-bars", "width that is left [%]", labels, narrowest, words, colours, caption)
