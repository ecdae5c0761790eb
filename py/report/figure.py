"""Figures: Plotly specifications as plain data, small enough to put into the page."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.records.steps import holes_at

# Okabe and Ito, Color Universal Design (2008): told apart with any colour vision. Without yellow: too pale on white.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F5539")
MEASURED = "#1b1b1b"
_DASHES = ("solid", "dash", "dot", "dashdot")
FINE = 1e-5  # of the range of an array: what rounding may move it in a plot, a fiftieth of the pixels of a wide screen


@dataclass(frozen=True)
class Figure:
    """One plot: ``spec`` is {"data", "layout"} for Plotly.

    ``label`` is its tab when several share a place, ``row`` names its row of tabs.
    """

    id: str
    label: str
    spec: dict
    caption: str = ""
    row: str = ""

    @property
    def heading(self) -> str:
        """Its tab with the row of tabs it is in."""
        return ", ".join(filter(None, (self.row, self.label)))

    @property
    def text(self) -> str:
        """What a screen reader says in place of the plot: its axes and its curves."""
        plan = self.spec["layout"]
        over, values = (_titles(plan, axis) for axis in ("xaxis", "yaxis"))
        names = dict.fromkeys(t["name"] for t in self.spec["data"] if t.get("name") and t.get("showlegend", True))
        what = f"Plot of {', '.join(values) or 'values'}" + (f" over {', '.join(over)}" if over else "")
        return f"{what}: {', '.join(names)}." if names else f"{what}."


@dataclass(frozen=True)
class FigureGroup:
    """Figures that share one place on the page, one tab each."""

    id: str
    title: str
    figures: tuple[Figure, ...]
    caption: str = ""

    @property
    def rows(self) -> dict[str, list[Figure]]:
        """The figures by row of tabs."""
        found: dict[str, list[Figure]] = {}
        for figure in self.figures:
            found.setdefault(figure.row, []).append(figure)
        return found


@dataclass(frozen=True)
class Style:
    """How one model is drawn, everywhere the same."""

    colour: str
    dash: str = "solid"
    width: float = 1.6


def styles(names: Sequence[str]) -> dict[str, Style]:
    """A style for each model in order; past the palette the colours return dashed.

    Each is a little thinner than the one before, so that curves that coincide all show.
    """
    return {
        name: Style(PALETTE[k % len(PALETTE)], _DASHES[(k // len(PALETTE)) % len(_DASHES)], max(1.1, 2.3 - 0.35 * k))
        for k, name in enumerate(names)
    }


def decimate(time: np.ndarray, values: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """At most ``points`` samples that keep the outline: minimum and maximum of each of points/2 buckets, in order.

    Ends are kept; gaps (NaN) stay gaps at bucket resolution.
    """
    n = len(time)
    if n <= points:
        return time, values
    edges = np.linspace(1, n - 1, max(1, (points - 2) // 2) + 1).astype(int)
    starts, widths = edges[:-1], np.diff(edges)
    within = np.arange(widths.max())
    seen = values[np.minimum(starts[:, None] + within, n - 1)]
    none = (within >= widths[:, None]) | np.isnan(seen)
    lowest = starts + np.argmin(np.where(none, np.inf, seen), axis=1)
    highest = starts + np.argmax(np.where(none, -np.inf, seen), axis=1)
    keep = np.unique(np.concatenate([[0], lowest, highest, [n - 1]]))
    return time[keep], values[keep]


def outline(x: np.ndarray, values: np.ndarray, points: int, breaks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Known values (n,), decimated to at most ``points``, with a NaN behind each of ``breaks``, where a line ends."""
    at, v = decimate(np.arange(len(x)), values, points)
    x, ends = x[at], np.unique(np.searchsorted(at, breaks, side="right"))
    return np.insert(x, ends, (x[ends - 1] + x[ends]) / 2), np.insert(v, ends, np.nan)


def _drawn(x: np.ndarray, values: np.ndarray, points: int, recorded: bool) -> tuple[np.ndarray, np.ndarray]:
    """What is drawn of a curve: a slow sensor among fast ones has a value in every tenth row, and is a line as well."""
    known = ~np.isnan(values)
    if not known.any() or (known.all() and not recorded):
        return decimate(x, values, points)
    x, values = x[known], values[known]
    return outline(x, values, points, holes_at(x) if (np.diff(x) > 0).all() else np.zeros(0, dtype=int))


def line(
    time: np.ndarray,
    values: np.ndarray,
    name: str,
    colour: str,
    *,
    points: int = 2000,
    dash: str = "solid",
    width: float = 1.6,
    row: int = 1,
    legend: bool = True,
    hidden: bool = False,
    recorded: bool = False,
) -> dict:
    """A decimated line on axis row 1, 2, ... of a figure made by `layout`.

    recorded : it is over the time of a recording, and ends at its holes. Where values are unknown it ends at a hole in
    what is known alone.
    """
    t, v = _drawn(np.asarray(time, float), np.asarray(values, float), points, recorded)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "legendgroup": name,
        "showlegend": legend,
        "visible": "legendonly" if hidden else True,
        "x": packed(t),
        "y": packed(v),
        "line": {"color": colour, "width": width, "dash": dash},
        "xaxis": "x",
        "yaxis": "y" if row == 1 else f"y{row}",
        "hovertemplate": "%{y:.5g}<extra>" + _plain(name) + "</extra>",
    }


def band(
    time: np.ndarray, sides: Sequence[np.ndarray], name: str, colour: str, *, row: int, points: int, hidden: bool
) -> dict:
    """The area between two curves, low and high, in a pale colour; it comes and goes with the line of that name.

    It ends at holes of the recording, each side with every peak, as lines do.
    """
    t, *both = (np.asarray(v, float) for v in (time, *sides))
    known = np.isfinite(both[0] + both[1])
    t, both = t[known], [side[known] for side in both]
    edges = [np.split(v, holes_at(t) + 1) for v in (t, *both)]
    areas = [_around(*piece, max(2, points * len(piece[0]) // max(1, len(t)))) for piece in zip(*edges, strict=True)]
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "legendgroup": name,
        "showlegend": False,
        "visible": "legendonly" if hidden else True,
        "x": packed(np.concatenate([x for x, _ in areas])),
        "y": packed(np.concatenate([y for _, y in areas])),
        "xaxis": "x",
        "yaxis": "y" if row == 1 else f"y{row}",
        "hoverinfo": "skip",
        "line": {"width": 0, "color": colour},
        "fill": "toself",
        "fillcolor": _faded(colour, 0.16),
    }


def _around(t: np.ndarray, low: np.ndarray, high: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """The way along the one side and back along the other, and a NaN, behind which the next area begins."""
    (there, low), (back, high) = (decimate(t, side, points) for side in (low, high))
    return np.concatenate([there, back[::-1], [np.nan]]), np.concatenate([low, high[::-1], [np.nan]])


def packed(values: np.ndarray) -> dict:
    """An array as Plotly's base64 of 32-bit floats: four times smaller than text.

    Of 64 bits where its range is small beside its size: seconds since 1970 would all be one instant.
    """
    kind = "f4" if _survives(np.asarray(values, float)) else "f8"
    return {"dtype": kind, "bdata": base64.b64encode(np.asarray(values, f"<{kind}").tobytes()).decode("ascii")}


def unpacked(values: Mapping) -> np.ndarray:
    """The array that `packed` was given, rounded as it was."""
    return np.frombuffer(base64.b64decode(values["bdata"]), np.dtype(values["dtype"]).newbyteorder("<"))


def _survives(values: np.ndarray) -> bool:
    """Whether 32 bits tell the values of an array apart as far as a plot does."""
    known = values[np.isfinite(values)]
    largest = float(np.abs(known).max()) if len(known) else 0.0
    if largest > np.finfo(np.float32).max:
        return False
    return bool(np.spacing(np.float32(largest)) <= FINE * np.ptp(known)) if len(known) and np.ptp(known) else True


def layout(x_title: str, y_titles: Sequence[str], shares: Sequence[float] | None = None, height: int = 420) -> dict:
    """Layout of one column of plots over a shared x axis, top first; ``shares`` are their heights."""
    shares = list(shares or [1.0] * len(y_titles))
    gap = 0.07 if len(shares) > 1 else 0.0
    room = 1.0 - gap * (len(shares) - 1)
    answer = {
        "height": height,
        "margin": {"l": 64, "r": 44, "t": 44, "b": 46},
        "modebar": {"orientation": "v", "bgcolor": "rgba(0,0,0,0)", "color": "#b5bcc3", "activecolor": "#57606a"},
        "hovermode": "x unified",
        "dragmode": "zoom",
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "font": {"size": 13}},
        "font": {"family": "system-ui, -apple-system, 'Segoe UI', sans-serif", "size": 13, "color": "#33393f"},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "xaxis": _axis(x_title) | {"anchor": "y" if len(shares) == 1 else f"y{len(shares)}"},
    }
    top = 1.0
    for k, (title, share) in enumerate(zip(y_titles, shares, strict=True), 1):
        size = room * share / sum(shares)
        domain = [max(0.0, top - size), top]
        answer["yaxis" if k == 1 else f"yaxis{k}"] = _axis(title) | {"domain": domain, "anchor": "x"}
        top -= size + gap
    return answer


def error_bars(
    groups: Sequence[str],
    models: Mapping[str, Sequence[tuple[float, float, float, float] | None]],
    look: dict,
    unit: str,
) -> dict:
    """Error bars of each model side by side for each group (recording).

    ``models[name][k]`` is (bias, deviation, lowest, highest) of group k in the shown unit, or None: dot and thick bar
    are mean and standard deviation, the thin line is the range.
    """
    data, count = [], len(models)
    for j, (name, bars) in enumerate(models.items()):
        offset = 0.8 * ((j + 0.5) / count - 0.5)
        known = [(k + offset, bar) for k, bar in enumerate(bars) if bar is not None]
        x, y = [k for k, _ in known], [bar[0] for _, bar in known]
        shared = {"type": "scatter", "mode": "markers", "x": x, "y": y, "legendgroup": name, "name": name}
        colour = look[name].colour
        spread = {"type": "data", "array": [b[1] for _, b in known], "color": colour, "thickness": 6, "width": 0}
        reach = {
            "type": "data",
            "symmetric": False,
            "array": [b[3] - b[0] for _, b in known],
            "arrayminus": [b[0] - b[2] for _, b in known],
            "color": colour,
            "thickness": 1.2,
            "width": 5,
        }
        words = [f"{b[0]:.3g} ± {b[1]:.3g}, {b[2]:.3g} … {b[3]:.3g} {unit}" for _, b in known]
        quiet = {"showlegend": False, "hoverinfo": "skip", "marker": {"size": 1, "color": colour}}
        data.append(shared | quiet | {"error_y": reach})
        data.append(shared | quiet | {"error_y": spread | {"color": _faded(colour)}})
        marker = {"size": 8, "color": colour, "line": {"color": "#ffffff", "width": 1}}
        told = {"text": words, "hovertemplate": "%{text}<extra>" + _plain(name) + "</extra>"}
        data.append(shared | told | {"marker": marker})
    plan = layout("", [f"error [{unit}]" if unit else "error"], height=340)
    plan["hovermode"] = "closest"
    ticks = {"tickvals": list(range(len(groups))), "ticktext": list(groups), "range": [-0.6, len(groups) - 0.4]}
    plan["xaxis"] |= ticks | {"showgrid": False, "zeroline": False}
    return {"data": data, "layout": plan}


@dataclass(frozen=True)
class Dot:
    """One value (as shown) of a model in a group, and what is said of it."""

    group: int
    value: float
    words: str


def dots(
    groups: Sequence[str], models: Mapping[str, Sequence[Dot]], look: dict, titles: tuple[str, str], hidden: frozenset
) -> dict:
    """The values of each model side by side for each group, on a logarithmic axis; titles : of both axes."""
    data, count = [], len(models)
    for j, (name, found) in enumerate(models.items()):
        offset = 0.6 * ((j + 0.5) / count - 0.5)
        data.append({
            "type": "scatter", "mode": "markers", "name": name, "legendgroup": name,
            "visible": "legendonly" if name in hidden else True,
            "x": [one.group + offset for one in found], "y": [one.value for one in found],
            "text": [one.words for one in found], "hovertemplate": "%{text}<extra>" + _plain(name) + "</extra>",
            "marker": {"size": 9, "color": look[name].colour, "line": {"color": "#ffffff", "width": 1}},
        })  # fmt: skip
    plan = layout(titles[0], [titles[1]], height=340)
    plan["hovermode"] = "closest"
    ticks = {"tickvals": list(range(len(groups))), "ticktext": list(groups), "range": [-0.6, len(groups) - 0.4]}
    plan["xaxis"] |= ticks | {"showgrid": False, "zeroline": False}
    plan["yaxis"] |= {"type": "log"}
    return {"data": data, "layout": plan}


def _axis(title: str) -> dict:
    return {
        "title": {"text": title, "standoff": 8},
        "gridcolor": "#e9ecef",
        "zerolinecolor": "#c3c9cf",
        "linecolor": "#c3c9cf",
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": "#c3c9cf",
        "automargin": True,
    }


def _titles(plan: dict, axis: str) -> list[str]:
    """Titles of all x or y axes of a layout that have one."""
    titles = (of.get("title") or {} for key, of in plan.items() if key.startswith(axis))
    texts = (title if isinstance(title, str) else title.get("text", "") for title in titles)
    return list(dict.fromkeys(filter(None, texts)))


def _faded(colour: str, share: float = 0.38) -> str:
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({red},{green},{blue},{share})"


def _plain(text: str) -> str:
    return text.replace("<", "‹").replace(">", "›").replace("%{", "% {")
