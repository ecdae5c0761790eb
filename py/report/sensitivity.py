"""The page of a sensitivity study: what drives what and when, what cannot be told apart, what to measure next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from hydrotwin.identification import Profiles, Sensitivity

from .figure import Figure
from .format import difference_to_shown, number_text, pretty_unit, shown_unit, to_shown
from .page import Note, Page, Section, write_page
from .provenance import command_line, made_table
from .sensitivity_figures import (
    correlation_figure,
    course_groups,
    index_group,
    next_figure,
    profile_group,
    share_figure,
)
from .tables import Cell, Column, Table, counts, numbers, table, texts, warned

STEM = "sensitivity"


def write_sensitivity(
    found: Sensitivity,
    folder: str | Path,
    *,
    profiles: Profiles | None = None,
    stem: str = STEM,
    command: str | None = None,
) -> dict[str, Path]:
    """Write ``stem``.html, .md and .json into ``folder``; the paths by "html", "markdown", "json"."""
    page = sensitivity_page(found, profiles=profiles, command=command)
    return write_page(page, folder, stem=stem, data_name=f"{stem}.json")


def sensitivity_page(
    found: Sensitivity,
    *,
    profiles: Profiles | None = None,
    command: str | None = None,
    date: datetime | None = None,
) -> Page:
    """The page, not yet written."""
    date = date or datetime.now().astimezone()
    made = made_table(command_line() if command is None else command, date)
    sections = (
        _drivers(found),
        Section("when", "When each acts", tuple(course_groups(found)), _WHEN),
        _apart(found),
        _profiles(profiles),
        _next(found),
        Section("asked", "What was asked", (interval_table(found), output_table(found), record_table(found))),
        Section("provenance", "Provenance", (made,)),
    )
    many = len(found.records) > 1
    return Page(
        title=f"Sensitivity of {found.name}",
        eyebrow=f"{len(found.parameters)} parameters · {len(found.records)} recording{'s' * many} · {date:%-d %B %Y}",
        answer=" ".join(found.sentences()),
        facts=_facts(found),
        notices=tuple(_plain(f) for f in found.findings if f.kind in ("diverged", "unsure")),
        headline=share_table(found),
        sections=tuple(s for s in sections if s.parts),
        data=found.as_data() | ({"profiles": profiles.as_data()} if profiles else {}),
    )


_WHEN = (
    "How far half the interval of each parameter moves an output, by the exact derivatives of the run. Below it the "
    "output itself, and the share that each parameter has in the variance of each stretch of time."
)


def share_table(found: Sensitivity) -> Table:
    """Parameters by outputs: the share of the variance in percent; those that drive an output are bold."""
    shares = found.shares
    strongest = {
        (j, int(np.argmax(row))) for j, row in enumerate(shares) if np.isfinite(row).any() and np.nanmax(row) > 0
    }
    columns = [texts("parameter", "Parameter", [p.name for p in found.parameters])]
    for j, signal in enumerate(found.outputs):
        cells = (
            Cell(
                float(s) if np.isfinite(s) else None,
                number_text(100 * float(s), 2) if s >= 0.0005 else ("–" if not np.isfinite(s) else "0"),
                best=(j, k) in strongest,
            )
            for k, s in enumerate(shares[j])
        )
        columns.append(Column(signal.name, f"{signal.name} [%]", tuple(cells), numeric=True))
    if found.sobol:
        note = (
            "Total Sobol indices: the share of the variance of an output that would go if the parameter were known, "
            "with all it acts in. Of parameters that act together the shares add up to more than 100 %."
        )
    else:
        note = "Shares of the squared local sensitivities over the intervals: no indices were asked for."
    return table("shares", "Shares of the variance", columns, note)


def _each(key: str, title: str, values, units: Sequence[tuple[str, str]], how=to_shown, digits: int = 4) -> Column:
    """A column whose rows have units of their own, each (SI, shown)."""
    cells = []
    for value, (unit, shown) in zip(values, units, strict=True):
        value = float(value)
        cells.append(Cell(value if np.isfinite(value) else None, number_text(float(how(value, unit, shown)), digits)))
    return Column(key, title, tuple(cells), numeric=True)


def interval_table(found: Sensitivity) -> Table:
    """The parameters and where they moved."""
    rows = found.parameters
    units = [(p.unit, shown_unit(p.unit, peak=abs(p.value))) for p in rows]
    columns = [
        texts("parameter", "Parameter", [p.name for p in rows]),
        texts("unit", "Unit", [pretty_unit(u) for _, u in units]),
        _each("value", "Value", [p.value for p in rows], units),
        _each("low", "From", [p.low for p in rows], units),
        _each("high", "To", [p.high for p in rows], units),
        texts("source", "Interval", [p.source for p in rows]),
    ]
    return table("intervals", "Intervals", columns)


def output_table(found: Sensitivity) -> Table:
    """The outputs, how far they range, how they are moved, and the noise of their sensors."""
    rows = found.outputs
    spread = found.sobol.whole.spread if found.sobol else np.sqrt(np.sum(found.local.moved**2, axis=1) / 3)
    units = [(s.unit, shown_unit(s.unit, peak=float(r))) for s, r in zip(rows, found.local.range, strict=True)]

    def column(key: str, title: str, values) -> Column:
        return _each(key, title, values, units, difference_to_shown, 3)

    columns = [
        texts("output", "Output", [s.name for s in rows]),
        texts("unit", "Unit", [pretty_unit(u) for _, u in units]),
        column("range", "Range", found.local.range),
        column("spread", "Moved over the intervals (rms)", spread),
        column("noise", "Noise of its sensor", found.known.noise),
    ]
    return table("outputs", "Outputs", columns)


def record_table(found: Sensitivity) -> Table:
    """The recordings with their hashes."""
    columns = [
        texts("record", "Recording", [r.name for r in found.records]),
        counts("samples", "Samples", [r.samples for r in found.records]),
        texts("sha256", "SHA-256", [r.digest or "" for r in found.records]),
    ]
    return table("recordings", "Recordings", columns)


def _drivers(found: Sensitivity) -> Section:
    parts: list = [share_figure(found)]
    told = [_plain(f) for f in found.findings if f.kind in ("together", "without_effect", "correlated")]
    if found.sobol:
        parts += [index_group(found), index_table(found)]
    parts += [Note(tuple(told), tone="warning")] if told else []
    return Section("drivers", "What drives what", tuple(parts), _lead(found))


def _lead(found: Sensitivity) -> str:
    if not found.sobol:
        return "Local: what the exact derivatives at the values of the model say of the intervals."
    far = found.sobol
    return (
        f"{far.sets} parameter sets, spread evenly over the intervals, each taken as independent. "
        f"{'Outputs over time' if far.sampling.of == 'course' else 'The rms distance from the nominal run'}; "
        "bars with their 95 % intervals."
    )


def index_table(found: Sensitivity) -> Table:
    """Every index with its half width."""
    whole, names = found.sobol.whole, [p.name for p in found.parameters]
    rows = [(s.name, name, j, k) for j, s in enumerate(found.outputs) for k, name in enumerate(names)]

    def column(key: str, title: str, values: np.ndarray) -> Column:
        return numbers(key, title, [float(values[j, k]) for _, _, j, k in rows], common=False, digits=2)

    columns = [
        texts("output", "Output", [r[0] for r in rows]),
        texts("parameter", "Parameter", [r[1] for r in rows]),
        column("first", "First order", whole.first),
        column("first_half", "±", whole.first_half),
        column("total", "Total", whole.total),
        column("total_half", "±", whole.total_half),
    ]
    return table("index_values", "All indices", columns, folded=True)


def _apart(found: Sensitivity) -> Section:
    if not np.isfinite(found.known.worth).any():
        return Section("apart", "", ())
    told = tuple(_plain(f) for f in found.findings if f.kind in ("indistinguishable", "no_effect"))
    words = Note(told, tone="warning") if told else Note(("These recordings tell all parameters apart.",))
    lead = "The correlation that a fit to these recordings would leave between the parameters."
    return Section("apart", "What cannot be told apart", (words, correlation_figure(found)), lead)


def _profiles(profiles: Profiles | None) -> Section:
    if profiles is None:
        return Section("profiles", "", ())
    lead = (
        "Each parameter is moved outward and the others are fitted again. Where the curve crosses the dotted line, the "
        "recordings contradict the value at 95 %; the dashed parabola is what the standard deviation of the fit says."
    )
    open_ = any(not p.identifiable for p in profiles.profiles)
    said = Note(tuple(profiles.sentences()), tone="warning" if open_ or profiles.lower else "")
    return Section("profiles", "Profiles", (profile_table(profiles), said, profile_group(profiles)), lead)


def profile_table(profiles: Profiles) -> Table:
    """Both intervals of every parameter."""
    rows = profiles.profiles
    units = [(p.unit, shown_unit(p.unit, peak=abs(p.value))) for p in rows]

    def column(key: str, title: str, values) -> Column:
        return _each(key, title, values, units, digits=5)

    quadratic = [p.quadratic or (np.nan, np.nan) for p in rows]
    said = ["quadratic" if p.quadratic_holds else "not quadratic" if p.identifiable else "open" for p in rows]
    columns = [
        texts("parameter", "Parameter", [p.name for p in rows]),
        texts("unit", "Unit", [pretty_unit(u) for _, u in units]),
        column("value", "Value", [p.value for p in rows]),
        column("low", "95 % from", [p.low for p in rows]),
        column("high", "to", [p.high for p in rows]),
        _none_told(column("quadratic_low", "Quadratic from", [low for low, _ in quadratic])),
        _none_told(column("quadratic_high", "to", [high for _, high in quadratic])),
        warned(texts("verdict", "It is", said), [not p.identifiable for p in rows]),
    ]
    return table("profile_intervals", "", columns)


def _none_told(column: Column) -> Column:
    """With a word where there is no number; the sentences below the table say why."""
    return replace(column, cells=tuple(replace(c, text="none") if c.value is None else c for c in column.cells))


def _next(found: Sensitivity) -> Section:
    rows = found.measurements
    if not rows:
        return Section("next", "", ())
    told = texts("measurement", "Measurement", [m.sentence for m in rows])
    left = [100 * min(m.narrowed.values()) for m in rows]
    best = [min(m.narrowed, key=m.narrowed.get) for m in rows]
    columns = [
        told,
        texts("kind", "Kind", [m.kind for m in rows]),
        texts("parameter", "Tells most of", best),
        numbers("left", "Width that is left [%]", left, common=False, digits=2),
        numbers("gain", "Gain of information [nat]", [m.gain for m in rows], common=False, digits=2),
    ]
    lead = (
        "How much narrower the intervals of a fit would be, by the Fisher information: to first order, at the values "
        "of the model, with errors that are independent from sample to sample. Take the order more seriously than the "
        "numbers. Sensors that are not there are taken to be as good as the others, or of class 0.5."
    )
    figure: Figure = next_figure(found)
    return Section("next", "What to measure next", (figure, table("measure_next", "", columns)), lead)


def _facts(found: Sensitivity) -> tuple[str, ...]:
    told = []
    if found.measurements:
        told.append(f"What would tell most next: {found.measurements[0].sentence}")
    return tuple(told)


def _plain(finding) -> str:
    """A finding as a sentence of the page, without the verb in front; a name keeps its first letter."""
    text = str(finding).removeprefix("sensitivity: ")
    return text if text.startswith(tuple(finding.parameters)) else text[:1].upper() + text[1:]
