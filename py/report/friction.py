"""The page of a constant-speed friction test: the Stribeck curve through the points, as Fig. 7 of the C-EHA paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path

import numpy as np

from .figure import MEASURED, PALETTE, Figure, layout, line
from .format import number_text, pretty_unit
from .page import Note, Page, Section, write_page
from .provenance import command_line, made_table
from .tables import Table, numbers, texts

_MEANING = {
    "kinetic": "kinetic friction Fₖ",
    "static": "static friction Fₛ",
    "viscous": "viscous friction Fᵥ",
    "stribeck_velocity": "Stribeck velocity vₛ",
    "load": "constant load F₀",
    "drift": "drift of the force b",
}


def write_friction_test(fit, folder: str | Path, *, recordings: Sequence[str] = ()) -> dict[str, Path]:
    """Write friction.html, .md and .json of a `FrictionFit`; the paths by "html", "markdown", "json"."""
    date = datetime.now().astimezone()
    made = Section("provenance", "Provenance", (made_table(command_line(), date),))
    page = Page(
        title="Friction at constant speed",
        eyebrow=f"{len(fit.velocity)} speeds · {', '.join(recordings)} · {date:%-d %B %Y}",
        answer=f"The Stribeck curve meets the measured forces to {number_text(fit.rmse)} N.",
        headline=coefficients(fit),
        sections=(Section("curve", "Force against speed", (_figure(fit),)), *_findings(fit), *_left_out(fit), made),
        data={
            "values": {c.name: c.value for c in fit.told},
            "intervals": {c.name: c.interval for c in fit.told},
            "confidence": fit.confidence,
            "rmse": fit.rmse,
            "velocity": fit.velocity,
            "force": fit.force,
            "findings": fit.findings,
            "dropped": [asdict(stretch) for stretch in fit.dropped],
        },
    )
    return write_page(page, folder, stem="friction", data_name="friction.json")


def _findings(fit) -> tuple[Section, ...]:
    if not fit.findings:
        return ()
    return (Section("findings", "What the test cannot say", (Note(tuple(fit.findings)),)),)


def _left_out(fit) -> tuple[Section, ...]:
    if not fit.dropped:
        return ()
    rows = Table(
        "dropped",
        "",
        (
            texts("recording", "Recording", [s.recording for s in fit.dropped]),
            numbers("start", "From", [s.start for s in fit.dropped], "s"),
            numbers("end", "To", [s.end for s in fit.dropped], "s"),
            numbers("velocity", "Mean speed", [s.velocity for s in fit.dropped], "m/s", "m/s"),
            numbers("samples", "Samples", [s.samples for s in fit.dropped]),
            texts("reason", "Reason", [s.reason for s in fit.dropped]),
        ),
    )
    return (Section("dropped", "Stretches that give no point", (rows,)),)


def coefficients(fit) -> Table:
    """One row a coefficient of the curve, with its interval."""
    rows = fit.told
    return Table(
        "coefficients",
        "",
        (
            texts("name", "Coefficient", [_MEANING[c.name] for c in rows]),
            numbers("value", "Value", [c.value for c in rows]),
            numbers("lower", f"{100 * fit.confidence:.0f} % from", [c.interval[0] for c in rows]),
            numbers("upper", "to", [c.interval[1] for c in rows]),
            texts("unit", "Unit", [pretty_unit(c.unit) for c in rows]),
        ),
        note="F(v) = (Fₖ + (Fₛ − Fₖ) exp(−(v/vₛ)²)) sign(v) + Fᵥ v + F₀, Eq. 8 of the C-EHA paper and a load"
        + (", and b t" if fit.drift else ""),
    )


def _figure(fit) -> Figure:
    widest = np.abs(fit.velocity).max()
    side = np.geomspace(1e-4 * widest, 1.05 * widest, 400)
    v = np.concatenate([-side[::-1], side])
    points = {
        "type": "scatter",
        "mode": "markers",
        "name": "measured",
        "x": fit.velocity.tolist(),
        "y": fit.force.tolist(),
        "marker": {"color": MEASURED, "size": 7},
        "hovertemplate": "%{y:.4g} N at %{x:.4g} m/s<extra></extra>",
    }
    curve = line(v, fit.curve(v), "Stribeck curve", PALETTE[0], points=len(v))
    look = layout("velocity [m/s]", ["force [N]"]) | {"hovermode": "closest"}
    return Figure("stribeck", "force", {"data": [curve, points], "layout": look})
