"""A heat map: rows by columns, a number in every cell, dark where it is large."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .figure import Figure, layout
from .format import number_text, pretty_unit

SCALE = ((0.0, "#f4f8fb"), (0.5, "#8fbbdc"), (1.0, "#0b3c66"))  # one hue: told apart in grey and by any eyes
ROW, ABOVE = 30, 90  # px
TICKS = (1.0, 2.0, 5.0)  # of every decade on the bar
MARKS = 6  # on the bar, which may be a few rows high
LONG = 44  # characters of a label


def heat_map(id: str, label: str, axes: tuple[Sequence[str], Sequence[str]], values: np.ndarray, unit: str) -> Figure:
    """``values`` (rows, columns) above zero, in ``unit`` as shown, nan for nothing, under the names of ``axes``.

    Colours are by the logarithm, so that good cells are told apart beside bad ones.
    """
    rows, columns = axes
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.log10(np.where(values > 0, values, np.nan))
    words = [[number_text(v, 3) if np.isfinite(v) else "" for v in row] for row in values]
    trace = {
        "type": "heatmap",
        "name": label,
        "z": [[float(v) if np.isfinite(v) else None for v in row] for row in size],
        "x": _cut(columns),
        "y": _cut(rows),
        "text": words,
        "texttemplate": "%{text}",
        "textfont": {"size": 12},
        "colorscale": [list(step) for step in SCALE],
        "colorbar": _bar(size, unit),
        "hovertemplate": "%{y}<br>%{x}: %{text}<extra></extra>",
        "xgap": 1,
        "ygap": 1,
    }
    plan = layout("", [""], height=ABOVE + 60 + ROW * len(rows))
    plan["hovermode"], plan["dragmode"] = "closest", False
    plan["margin"] |= {"t": ABOVE, "l": 20, "r": 20}
    plan["xaxis"] |= {"type": "category", "side": "top", "showgrid": False, "tickangle": -30 if len(columns) > 3 else 0}
    plan["yaxis"] |= {"type": "category", "autorange": "reversed", "showgrid": False}
    return Figure(id, label, {"data": [trace], "layout": plan}, caption="")


def _bar(size: np.ndarray, unit: str) -> dict:
    known = size[np.isfinite(size)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    decades = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    for ticks in (TICKS, TICKS[:1]):  # over several decades those of every decade would lie on each other
        marks = [m for k in decades for t in ticks if low <= (m := k + np.log10(t)) <= high]
        if len(marks) <= MARKS:
            break
    marks = marks[:: -(-len(marks) // MARKS) or 1]
    marks = marks if len(marks) > 1 else sorted({low, high})
    texts = [number_text(10.0**m, 2) for m in marks]
    title = {"text": pretty_unit(unit), "side": "top"}
    return {"tickvals": marks, "ticktext": texts, "title": title, "thickness": 12, "outlinewidth": 0}


def _cut(names: Sequence[str]) -> list[str]:
    """Labels of bearable length, each still its own."""
    short = [n if len(n) <= LONG else f"{n[: LONG - 1]}…" for n in names]
    return [s if short.count(s) == 1 else n for s, n in zip(short, names, strict=True)]
