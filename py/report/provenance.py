"""Where the numbers come from: files, hashes, versions, command, date."""

from __future__ import annotations

import platform
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hydrotwin.models.language.provenance import MARKED
from hydrotwin.models.language.writing import printable
from hydrotwin.records import Record

from .format import number_text
from .page import Section
from .tables import Table, counts, numbers, table, texts

PACKAGES = ("hydrotwin", "casadi", "numpy", "scipy", "plotly", "torch", "gpytorch", "pyoperon", "fmpy")


def versions() -> dict[str, str]:
    """Versions of Python, the platform and the packages whose numbers are in a report."""
    found = {"python": platform.python_version(), "platform": f"{platform.system()} {platform.machine()}"}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def command_line() -> str:
    """The command that is running, the program without its folder; ``python -m hydrotwin`` is ``hydrotwin``."""
    if not sys.argv or not sys.argv[0]:
        return ""
    program = Path(sys.argv[0])
    name = program.parent.name if program.name == "__main__.py" else program.name
    return printable(shlex.join([name, *sys.argv[1:]]))


def recording_table(validate: Sequence[Record], train: Sequence[Record]) -> Table:
    """Every recording with its role, length and content hash."""
    words = {"validate": "validation", "train": "training"}
    rows = [(r, words[role]) for r, role in used(validate, train)]
    columns = [
        texts("record", "Recording", [r.name for r, _ in rows]),
        texts("role", "Used for", [role for _, role in rows]),
        texts("file", "File", [printable(Path(str(r.source)).name) if r.source else "in memory" for r, _ in rows]),
        numbers("duration", "Duration", [r.duration for r, _ in rows], "s", common=False, digits=4),
        counts("samples", "Samples", [len(r.time) for r, _ in rows]),
        numbers("period", "Period", [r.period for r, _ in rows], "s", "ms", common=False),
        texts("sha256", "SHA-256", [r.digest or "" for r, _ in rows]),
    ]
    return table("recordings", "Recordings", columns)


def used(compared: Sequence[Record], train: Sequence[Record]) -> list[tuple[Record, str]]:
    """Every recording once, with what it was used for: one that was trained on validates nothing."""
    trained_on = {r.digest or r.name for r in train}
    unseen = [r for r in compared if (r.digest or r.name) not in trained_on]
    return [*((r, "validate") for r in unseen), *((r, "train") for r in train)]


def model_table(entrants: Sequence) -> Table | None:
    """What each model says about its own origin, or None when none says anything."""
    rows = [(e.name, *item) for e in entrants for k, v in e.provenance.items() for item in _items(str(k), v)]
    if not rows:
        return None
    model, key, value = zip(*rows, strict=True)
    columns = [texts("model", "Model", model), texts("key", "Item", key), texts("value", "Value", value)]
    return table("model_provenance", "Models", columns, folded=True)


def digest_table(records: Sequence) -> Table:
    """The recordings of a fit (`Fit.records`) with role, samples and content hash."""
    columns = [
        texts("record", "Recording", [r.name for r in records]),
        texts("role", "Role", [r.role for r in records]),
        counts("samples", "Samples", [r.samples for r in records]),
        texts("sha256", "SHA-256", [r.digest or "" for r in records]),
    ]
    return table("digests", "Recordings of the fit", columns)


def item_table(provenance: Mapping, id: str = "origin", title: str = "Origin") -> Table | None:
    """A provenance, whatever it holds, in rows for people; None when it is empty."""
    rows = [item for k, v in provenance.items() for item in _items(str(k), v)]
    if not rows:
        return None
    key, value = zip(*rows, strict=True)
    return table(id, title, [texts("item", "Item", key), texts("value", "Value", value)], folded=len(rows) > 12)


def _items(key: str, value) -> Iterator[tuple[str, str]]:
    """Rows of the table for one entry: a tree opens into dotted keys, a list of files into one row for each."""
    if isinstance(value, Mapping) and any(isinstance(v, Mapping) for v in value.values()):
        for name, part in value.items():
            yield from _items(f"{key}.{name}", part)
    elif isinstance(value, (list, tuple)):
        for part in value:
            yield key, _text(part)
    else:
        yield key, _text(value)


def _text(value) -> str:
    """One value for a reader: files by name and digest, numbers with four digits."""
    if isinstance(value, Mapping):
        shown = {k: v for k, v in value.items() if k not in ("source", MARKED)}  # a folder of somebody's; for programs
        return ", ".join(_text(v) if k in ("name", "role") else f"{k} {_text(v)}" for k, v in shown.items())
    if isinstance(value, float):
        return number_text(value, 4)
    return str(value)


def made_table(command: str, date: datetime) -> Table:
    """When, with which command and which versions a page was made."""
    items = {"date": date.isoformat(timespec="seconds"), "command": command} | versions()
    items = {k: v for k, v in items.items() if v}
    return table(
        "made", "Made with", [texts("item", "Item", list(items)), texts("value", "Value", list(items.values()))]
    )


def provenance_section(comparison, command: str, date: datetime) -> Section:
    """The last section of a comparison."""
    models = model_table(comparison.entrants)
    parts = [
        recording_table(comparison.records, comparison.train_records),
        *([models] if models else []),
        made_table(command, date),
    ]
    return Section("provenance", "Provenance", tuple(parts))
