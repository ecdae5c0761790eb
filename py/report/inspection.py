"""The page of `hydrotwin inspect`: what is in recordings, plotted, and what a model can learn from them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from hydrotwin.records import Record

from .figure import Figure, FigureGroup, layout, line, styles
from .format import pretty_unit
from .page import Note, Page, Section, write_page
from .provenance import command_line, made_table
from .tables import Table, counts, numbers, texts

MOST_FILES, POINTS = 12, 1500  # recordings in one plot, and samples of each that are drawn


def write_inspection(found, records: Sequence[Record], folder: str | Path) -> dict[str, Path]:
    """Write inspection.html, .md and .json; found: what `inspect` found, records: what it looked at."""
    date = datetime.now().astimezone()
    files = found.files
    remarks = [f"{f.name}: {r}" for f in files for r in f.remarks]
    remarks += [f"{f.name}, {c.name}: {r}" for f in files for c in f.channels for r in c.remarks]
    seconds = sum(f.duration for f in files)
    page = Page(
        title="What is in the recordings",
        eyebrow=f"{len(files)} recordings · {seconds:.4g} s · {date:%-d %B %Y}",
        answer=_answer(found, remarks),
        headline=_files(files),
        notices=tuple(found.failed.values()),
        facts=tuple(found.remarks),
        sections=(
            *_model(found),
            Section("plots", "Every column over time", (_figures(records),)),
            Section("channels", "Columns", tuple(_channels(f) for f in files)),
            *([Section("remarks", "What to look at", (Note(tuple(remarks)),))] if remarks else []),
            *_ignored(files),
            Section("import", "How the files are read", (Note(tuple(found.toml.strip().splitlines())),),
                    "This is the import.toml; beside the recordings every command finds it."),
            Section("provenance", "Provenance", (made_table(command_line(), date),)),
        ),
    )  # fmt: skip
    return write_page(page, folder, stem="inspection", data_name="inspection.json")


def _answer(found, remarks: Sequence[str]) -> str:
    if found.failed:
        return f"{len(found.failed)} of {len(found.failed) + len(found.files)} files cannot be read."
    lacking = [m.signal.name for m in found.matches if not m.column]
    words = f"{found.model} finds all its signals." if found.model and not lacking else ""
    words = f"{found.model} does not find {', '.join(lacking)}." if lacking else words
    count = len(remarks)
    looks = f"{count} things to look at." if count > 1 else "One thing to look at." if count else "Nothing looks odd."
    return f"{words} {looks}".strip()


def _files(files) -> Table:
    return Table(
        "files",
        "",
        (
            texts("name", "Recording", [f.name for f in files]),
            counts("samples", "Samples", [f.samples for f in files]),
            numbers("duration", "Duration", [f.duration for f in files], "s"),
            numbers("period", "Step", [f.period for f in files], "s"),
            counts("columns", "Columns", [len(f.channels) for f in files]),
            texts("read", "Read as", [f.understood for f in files]),
        ),
    )


def _channels(one) -> Table:
    rows = one.channels
    return Table(
        f"channels_{one.name}",
        one.name,
        (
            texts("name", "Column", [c.name for c in rows]),
            texts("unit", "Unit", [pretty_unit(c.unit) for c in rows]),
            numbers("minimum", "Minimum", [c.minimum for c in rows]),
            numbers("maximum", "Maximum", [c.maximum for c in rows]),
            numbers("noise", "Noise (1 sigma)", [c.noise for c in rows]),
            numbers("step", "Step", [c.step for c in rows]),
            counts("missing", "Missing", [c.missing for c in rows]),
        ),
    )


def _model(found) -> tuple[Section, ...]:
    if not found.model:
        return ()
    rows = found.matches
    which = Table(
        "matches",
        "Which column is what",
        (
            texts("signal", "Signal", [m.signal.name for m in rows]),
            texts("unit", "Unit", [pretty_unit(m.signal.unit) for m in rows]),
            texts("column", "Column", [m.column or "none" for m in rows]),
            texts("why", "Why", [m.said for m in rows]),
        ),
    )
    parts: list = [which, Note(tuple(m.problem for m in rows if m.problem))]
    if found.excited:
        shown = found.excited
        parts.append(
            Table(
                "excited",
                "What the recordings say of its parameters",
                (
                    texts("name", "Parameter", [e.name for e in shown]),
                    numbers("value", "Now", [e.value for e in shown]),
                    texts("sigma", "One sigma", [e.said for e in shown]),
                    texts("unit", "Unit", [pretty_unit(e.unit) for e in shown]),
                    texts("verdict", "Seen", [e.verdict for e in shown]),
                ),
                note="At the values that the model has now, with the noise the sensors show: a preview, not a fit.",
            )
        )
    parts.append(Note(tuple(found.said)))
    parts = [part for part in parts if not isinstance(part, Note) or part.paragraphs]
    return (Section("model", f"What {found.model} makes of them", tuple(parts)),)


def _figures(records: Sequence[Record]) -> FigureGroup:
    shown = records[:MOST_FILES]
    style = styles([r.name for r in shown])
    names = list(dict.fromkeys(name for r in shown for name in r.names))
    figures = []
    for name in names:
        having = [r for r in shown if name in r.names]
        unit = having[0].display_units.get(name, having[0].units[name])
        how = {"points": POINTS, "recorded": True}
        lines = [line(r.time - r.time[0], _shown(r, name, unit), r.name, style[r.name].colour, **how) for r in having]
        look = layout("time [s]", [f"{name} [{pretty_unit(unit)}]"])
        figures.append(Figure(f"plot_{name}", name, {"data": lines, "layout": look}))
    left = f" The first {MOST_FILES} of {len(records)} recordings." if len(records) > MOST_FILES else ""
    return FigureGroup("plots", "", tuple(figures), f"Time begins where each recording does.{left}")


def _shown(record: Record, name: str, unit: str) -> np.ndarray:
    from hydrotwin.models.language.units import convert

    return convert(record[name], record.units[name], unit)


def _ignored(files) -> tuple[Section, ...]:
    rows = [(f.name, n, why.removeprefix(f"{f.path}: ")) for f in files for n, why in f.refused.items()]
    if not rows:
        return ()
    names, columns, reasons = zip(*rows, strict=True)
    left = Table(
        "ignored", "",
        (texts("file", "Recording", names), texts("column", "Column", columns), texts("why", "Why", reasons)),
    )  # fmt: skip
    return (Section("ignored", "Columns that cannot be used as they are", (left,)),)
