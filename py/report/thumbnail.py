"""Small still pictures of plots: what stands in their place until they are drawn, and where scripts are off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from .figure import outline, unpacked

WIDE, HIGH, POINTS = 400, 100, 160  # units of the picture, and points of a curve
MOST = 8  # curves


def thumbnail(spec: Mapping) -> Markup:
    """The lines on the first axis of a Plotly specification as an SVG; empty where it has none.

    It lies where Plotly will put the axis, and tells a screen reader nothing: the plot has a text.
    """
    axes = [spec["layout"].get(name, {}).get("type") for name in ("xaxis", "yaxis")]
    curves = [(trace["line"]["color"], *_points(trace, axes)) for trace in spec["data"] if _shows(trace)][:MOST]
    curves = [(colour, x, y) for colour, x, y in curves if len(x)]
    if not curves:
        return Markup("")
    across = [WIDE * x for x in _together([x for _, x, _ in curves])]
    up = [HIGH - HIGH * y for y in _together([y for *_, y in curves])]
    one = '<path d="{}" stroke="{}"/>'
    paths = [Markup(one).format(_path(x, y), c) for (c, *_), x, y in zip(curves, across, up, strict=True)]
    picture = '<svg class="thumb" aria-hidden="true" viewBox="0 0 {} {}" preserveAspectRatio="none" style="{}">{}</svg>'
    return Markup(picture).format(WIDE, HIGH, _place(spec["layout"]), Markup("").join(paths))


def _shows(trace: Mapping) -> bool:
    """A visible line on the first axis; sides of a band have no width."""
    line = trace.get("line") or {}
    plain = trace.get("type") == "scatter" and trace.get("mode") == "lines" and trace.get("yaxis", "y") == "y"
    return plain and trace.get("visible", True) is True and bool(line.get("width")) and "color" in line


def _points(trace: Mapping, axes: Sequence[str | None]) -> tuple[np.ndarray, np.ndarray]:
    x, y = (_numbers(trace[of], axis) for of, axis in zip("xy", axes, strict=True))
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    return outline(x[known], y[known], POINTS, np.flatnonzero(np.diff(known) > 1))


def _numbers(values: Mapping | Sequence, axis: str | None) -> np.ndarray:
    """Numbers of a trace, packed or not, as far along their axis; names stand for nothing."""
    if isinstance(values, Mapping):
        found = unpacked(values).astype(float)
    else:
        found = np.array([v if isinstance(v, float | int) else np.nan for v in values], dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.log10(found) if axis == "log" else found
    return np.where(np.isfinite(found), found, np.nan)


def _together(curves: Sequence[np.ndarray]) -> list[np.ndarray]:
    """All from 0 to 1 over the range that they have together."""
    low, high = (pick([pick(c) for c in curves]) for pick in (np.nanmin, np.nanmax))
    return [(c - low) / ((high - low) or 1.0) for c in curves]


def _path(x: np.ndarray, y: np.ndarray) -> str:
    """A line through the known points, broken where one is unknown."""
    known = np.isfinite(y)
    begins = np.r_[True, ~known[:-1]][known]
    return "".join(
        f"{'M' if b else 'L'}{px:.0f} {py:.0f}" for b, px, py in zip(begins, x[known], y[known], strict=True)
    )


def _place(plan: Mapping) -> str:
    """Where Plotly puts the first axis, in the words of a style sheet."""
    edge = plan.get("margin", {})
    sides = {side: int(edge.get(side, 60)) for side in "lrtb"}
    low, high = plan.get("yaxis", {}).get("domain", (0.0, 1.0))
    room = int(plan.get("height", 420)) - sides["t"] - sides["b"]
    top = sides["t"] + room * (1.0 - high)
    return (
        f"margin:{top:.0f}px 0 0 {sides['l']}px;width:calc(100% - {sides['l'] + sides['r']}px);"
        f"height:{room * (high - low):.0f}px"
    )
