"""Recordings on the command line: the options that say how they are read, on every command that reads some."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Collection, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, get_type_hints

import typer

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Reading, Record, copies, read_record, reading_of, require_once, turned_back
from hydrotwin.records.between import shown_otherwise
from hydrotwin.records.reading import check_constants
from hydrotwin.records.sizes import far_from_usual

from .shared import err, mark

ALIKE = 0.8  # of 1: likeness of two names from which on one may be meant by the other
_PANEL = "How recordings are read (also in import.toml beside them)"


def _option(flag: str, metavar: str, text: str):
    return typer.Option(flag, metavar=metavar, help=text, rich_help_panel=_PANEL)


Several, Text = list[str] | None, str | None
OPTIONS = {
    "columns": Annotated[Several, _option("--column", "NAME=COLUMN", "which column is it: command=Ventil_Soll, or #3")],
    "renamed": Annotated[Several, _option("--rename", "COLUMN=NAME", "the same, the other way round")],
    "units": Annotated[Several, _option("--unit", "COLUMN=UNIT", "its unit, in place of the file's: 'Druck A=bar'")],
    "scale": Annotated[Several, _option("--scale", "COLUMN='V U/W'", "scale a column: command='0.05 V/%'")],
    "constants": Annotated[Several, _option("--set", "NAME=VALUE", "what was not recorded: supply_pressure=35bar")],
    "time": Annotated[Text, _option("--time", "COLUMN", "the column that is the time")],
    "rate": Annotated[Text, _option("--rate", "HZ", "samples per second, where there is no time column")],
    "clock": Annotated[
        Text, _option("--clock", "HOW", "mend the time: spread, first, last (doubled stamps), unwrap, sort")
    ],
    "missing": Annotated[
        Text,
        _option("--missing", "HOW", "empty cells: error, 'drop rows', or keep (a sensor's samples may be unknown)"),
    ],
    "decimal": Annotated[Text, _option("--decimal", "SIGN", "decimal sign of a text file, where it does not tell")],
    "delimiter": Annotated[Text, _option("--delimiter", "SIGN", "what parts the cells of a text file")],
    "encoding": Annotated[Text, _option("--encoding", "NAME", "of a text file: utf-8, cp1252, ...")],
    "sheet": Annotated[Text, _option("--sheet", "NAME", "of a workbook")],
}


def reads(command: Callable) -> Callable:
    """The command with the options that say how recordings are read, given to it as ``reading``.

    An option of its own by the same flag stays its own.
    """
    signature = inspect.signature(command)
    hints = get_type_hints(command, include_extras=True)
    own = [p.replace(annotation=hints.get(n, p.annotation)) for n, p in signature.parameters.items() if n != "reading"]
    flags = {flag for p in own for flag in _flags(p.annotation)}
    added = {name: kind for name, kind in OPTIONS.items() if not _flags(kind) & flags}

    @functools.wraps(command)
    def with_options(**given):
        said = {name: given.pop(name) for name in added}
        columns = [*(said.pop("columns", None) or []), *map(_turned, said.pop("renamed", None) or [])]
        return command(**given, reading=reading_of(**said, columns=columns or None))

    kinds = inspect.Parameter.KEYWORD_ONLY
    more = [inspect.Parameter(n, kinds, default=None, annotation=kind) for n, kind in added.items()]
    with_options.__signature__ = signature.replace(parameters=[*(p.replace(kind=kinds) for p in own), *more])
    with_options.__annotations__ = {p.name: p.annotation for p in (*own, *more)}
    return with_options


def _flags(annotation) -> set[str]:
    """The flags of an annotated option; Typer keeps the first one as its default."""
    options = [o for o in getattr(annotation, "__metadata__", ()) if hasattr(o, "param_decls")]
    return {flag for o in options for flag in (o.default, *(o.param_decls or ())) if isinstance(flag, str)}


def _turned(pair: str) -> str:
    """``COLUMN=NAME`` the other way round."""
    column, equals, name = pair.rpartition("=")
    if not (equals and column and name):
        raise DeclarationError(f"--rename {pair}: no 'column=name'. Write --rename Ventil_Soll=command.")
    return f"{name}={column}"


def told_in(reading: Reading | None) -> list[str]:
    """The options that a reading comes from."""
    own = {"columns": "--column", "units": "--unit", "constants": "--set"}
    said = [f.name for f in fields(Reading) if reading and getattr(reading, f.name)]
    return [own.get(name, f"--{name}") for name in said]


def read_all(
    paths: Sequence[Path] | None, reading: Reading | None = None, measured: Collection[str] | None = None
) -> list[Record]:
    """Read recordings, each once, and tell of them what `tell_read` does.

    measured : columns by which two of the same commands are told apart, see `shares_samples`.
    """
    records = [read_record(path, reading) for path in paths or []]
    require_once(records, copies(records, measured))
    tell_read(records)
    return records


def tell_read(records: Sequence[Record]) -> None:
    """How each recording was understood, and its gaps, unknown samples, and angles that begin anew."""
    understood: dict[str, list] = {}
    for record in records:
        path = record.source or record.name
        understood.setdefault(record.understood, []).append(path)
        for doubt in (*record.holes, *turned_back(record)):
            mark(err, "note", f"{path}: {doubt}")
    for words, files in understood.items():
        if words:
            more = f" and {len(files) - 1} more" if len(files) > 1 else ""
            err.print(f"read {files[0]}{more}: {words}", style="dim")


def constants_among(
    settings: Sequence[str] | None, names: Collection[str], reading: Reading | None
) -> tuple[list[str], Reading]:
    """The ``name=value`` of --set that are no constant of a recording, and the reading with those that are.

    names : of signals; every other name is a parameter of a model, or an option of a kind.
    """
    settings = settings or []
    given = [text for text in settings if text.partition("=")[0].strip() in names]
    return [text for text in settings if text not in given], reading_of(constants=given or None).over(
        reading or Reading()
    )


def check_set(reading: Reading | None, flat) -> None:
    """What --set says is of a signal of the model. Raises DeclarationError where nothing would read it."""
    signals, parameters = {s.name for s in (*flat.inputs, *flat.outputs)}, {p.name for p in flat.parameters}
    check_constants(reading or Reading(), signals, parameters, "its value stands in the model or its file.")


def tell_columns(records: Sequence[Record], signals: Sequence[Signal], model: str, said: Collection[str] = ()) -> None:
    """Columns that the model does not know are named once, those that could not be used too, those that are far larger
    than it expects, and those that do something else between their samples; ``said`` : of which a user says it."""
    doubts = shown_otherwise([s for s in signals if s.name not in said], records)
    for doubt in [*far_from_usual(records, signals), *doubts]:
        mark(err, "note", doubt)
    used = {s.name for s in signals}
    here = {name for r in records for name in (*r.signals, *r.refused)}
    ignored = sorted(here - used)
    if ignored:
        err.print(f"ignored columns (neither input nor output of {model}): {', '.join(ignored)}", style="dim")
    for name in ignored:
        if meant := difflib.get_close_matches(name, sorted(used - here), n=1, cutoff=ALIKE):
            mark(err, "note", f"did you mean {meant[0]} by the column {name}? Say so: --column '{meant[0]}={name}'.")


def require_columns(records: Sequence[Record], columns: Sequence[str], hint: str = "") -> None:
    """Every record has every column, or the first that lacks one is named."""
    for record in records:
        for column in columns:
            if column not in record:
                raise DeclarationError(f"{record.source}: no column '{column}'. {nearest(column, record.names)}{hint}")
