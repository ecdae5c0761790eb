"""Arguments that several commands take, reading recordings, and printing."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from hydrotwin.models.language.errors import DataError, DeclarationError, HydrotwinError, nearest
from hydrotwin.models.language.flat import INTERPOLATIONS
from hydrotwin.models.language.quantities import Wanted, apart, in_unit
from hydrotwin.models.language.writing import json_values, target
from hydrotwin.records.between import sentences

ModelArgument = Annotated[
    str,
    typer.Argument(metavar="MODEL", help="cehA, spool_valve, a model file, a learned block, an .fmu, file.py:factory"),
]
RecordsArgument = Annotated[list[Path], typer.Argument(metavar="REC...", help="recordings (CSV, Parquet, MAT, MDF)")]
ValidateOption = Annotated[
    list[Path] | None, typer.Option("--validate", metavar="REC...", help="recordings to judge by, not to fit to")
]
InitialStatesOption = Annotated[
    str,
    typer.Option(
        help="start of physical models: measured (first samples count); or, from the first tenth of a recording, auto "
        "(states with a noisy sensor and, where it tells, with none) or free (all)"
    ),
]
InterpolationOption = Annotated[
    list[str] | None,
    typer.Option(
        "--interpolation",
        metavar="INPUT=HOW",
        help="an input between samples: hold (a command), linear or smooth (measured); the recordings show it else",
    ),
]


def step_in_seconds(text: str | float) -> float:
    """The time of ``--step`` in seconds: ``0.002`` or ``2ms``."""
    return in_unit(text, Wanted("--step", "s"), "--step 1ms")


def duration_of(option: str, least: float = 0.0) -> Callable[[str | float], float]:
    """What reads the time of an option in seconds, of ``least`` or more: ``90``, ``5min``, ``1.5h`` or ``1h30min``."""

    def seconds(text: str | float) -> float:
        parts = _DURATION.fullmatch(str(text).strip().lower())
        given = [f"{n} {unit}" for n, unit in zip(parts.groups(), ("h", "min", "s"), strict=True) if n] if parts else []
        found = 0.0
        with contextlib.suppress(HydrotwinError):
            found = sum(in_unit(part, Wanted(option, "s")) for part in given or [text])
        if not found > 0 or found < least:
            more = f" of {least:g} s or more" if least else ""
            raise DeclarationError(f"{option} {text}: no duration{more}. Write for example 90s, 5min, 1.5h or 1h30min.")
        return found

    return seconds


_PART = r"(\d+(?:\.\d+)?)"
_DURATION = re.compile(rf"(?:{_PART}\s*h)?\s*(?:{_PART}\s*m(?:in)?)?\s*(?:{_PART}\s*s)?")  # 1h30min

StepOption = Annotated[
    float | None,
    typer.Option(
        parser=step_in_seconds, metavar="TIME", help="longest internal step, seconds or 1ms; the model's own else"
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="print the machine-readable answer")]

WIDE = 160  # columns of a table that goes into a file or a pipe

PLAIN = {"highlight": False, "markup": False, "emoji": False}  # units may stand in [brackets], numbers between :100:
out = Console(soft_wrap=True, **PLAIN)
err = Console(stderr=True, soft_wrap=True, **PLAIN)


def examples(*lines: str) -> str:
    """The closing lines of a help text."""
    return "[bold]Example[/]\n\n" + "\n\n".join(f"  {line}" for line in lines)


def mark(console: Console, word: str, text: str, style: str = "yellow") -> None:
    """A line that begins with a coloured word: note, failed, done."""
    console.print(Text.assemble((word, style), f" {text}"))


def check_file(path: Path, *suffixes: str, sources: Sequence[Path] = ()) -> Path:
    """Refuse before a long run a file that could not be written after it, or that would replace one of ``sources``."""
    if path.is_dir():
        raise DataError(f"{path}: a folder, not a file. Name a file in it: {path / f'NAME{suffixes[0]}'}.")
    if path.suffix.lower() not in suffixes:
        raise DataError(
            f"{path}: not a name this command can write to (got '{path.suffix}'). It must end in "
            f"{' or '.join(suffixes)}. Write to {path.with_suffix(suffixes[0])}."
        )
    for source in sources:
        if path.exists() and source.exists() and path.samefile(source):
            raise DataError(f"{path}: this command reads it, and would replace it. Choose another name.")
    return check_writable(path)


def check_folder(path: Path) -> Path:
    """Refuse before a long run a folder that could not be written into after it."""
    if path.exists() and not path.is_dir():
        raise DataError(f"{path}: a file, where a folder is needed. Name a folder.")
    return check_writable(path)


def check_writable(path: Path) -> Path:
    """Refuse before a long run what could not be written after it, a read-only file too."""
    given, path = path, target(path)
    folder = path if path.is_dir() else next((p for p in path.absolute().parents if p.exists()), path)
    probe = folder / ".hydrotwin-probe"
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror}). Choose a folder you may write to.") from None
    return given


def settings_from(changes: list[str] | None, option: str, asked: Sequence[Wanted]) -> dict[str, float]:
    """The ``motor.gain=130`` or ``oil=40degC`` pairs of an option as a dictionary, SI."""
    pairs = texts_from(changes, option, "motor.gain=130")
    return {
        name: _in_si(text, _called(name, text, asked, option), option, f"{name}={{}}") for name, text in pairs.items()
    }


def bounds_from(
    limits: list[str] | None, asked: Sequence[Wanted], option: str = "--bounds"
) -> dict[str, tuple[float, float]]:
    """The ``load.mass=50:200`` or ``load.mass=50:200kg`` of an option as a dictionary, SI; a unit behind the upper
    bound is that of both. Raises DeclarationError."""
    found = {}
    for path, pair in texts_from(limits, option, "load.mass=50:200kg").items():
        low, colon, high = (part.strip() for part in pair.partition(":"))
        both = [apart(low), apart(high)]
        if not (colon and all(both)):
            raise DeclarationError(f"{option} {path}={pair}: no 'path=low:high'. Write for example load.mass=50:200kg.")
        low, of = low if both[0][1] else f"{low} {both[1][1]}", _called(path, high, asked, option)
        found[path] = tuple(_in_si(text, of, option, f"{path}=LOW:{{}}") for text in (low, high))
        if not found[path][0] < found[path][1]:
            raise DeclarationError(f"{option} {path}={pair}: no low below high. Turn the bounds round.")
    return found


def _called(name: str, text: str, asked: Sequence[Wanted], option: str) -> Wanted:
    """What is asked for by a name. A number alone of an unknown one goes on: the model tells more of what it has."""
    found = next((one for one in asked if one.name == name), None)
    if found is None and (apart(text) or ("", ""))[1]:
        raise DeclarationError(
            f"{option} {name}={text}: nothing here is called '{name}'. {nearest(name, [one.name for one in asked])}"
        )
    return found or Wanted(name, "1")


def _in_si(text: str, asked: Wanted, option: str, example: str) -> float:
    try:
        return in_unit(text, asked, example)
    except HydrotwinError as error:
        raise type(error)(f"{option} {error}") from None


def _check_once(option: str, name: str, known: Mapping) -> None:
    if name in known:
        raise DeclarationError(f"{option} {name}: it is given twice. Leave one out.")


def texts_from(changes: list[str] | None, option: str, example: str = "supply=35bar") -> dict[str, str]:
    """The ``supply=35bar`` pairs of an option as they are written."""
    values: dict[str, str] = {}
    for change in changes or []:
        name, equals, text = (part.strip() for part in change.partition("="))
        if not (name and equals and text):
            raise DeclarationError(f"{option} {change}: no 'name=value'. Write for example {example}.")
        _check_once(option, name, values)
        values[name] = text
    return values


def interpolation_from(changes: list[str] | None) -> dict[str, str]:
    """The ``force=linear`` pairs of --interpolation as a dictionary."""
    pairs = [change.rpartition("=") for change in changes or []]
    for (name, _, how), change in zip(pairs, changes or [], strict=True):
        if not name or how not in INTERPOLATIONS:
            raise DeclarationError(
                f"--interpolation {change}: no 'input=hold', 'input=linear' or 'input=smooth'. Write force=linear."
            )
    return {name: how for name, _, how in pairs}


def tell_between(inputs) -> None:
    """What inputs do between samples, unless their model declares it."""
    for sentence in sentences(inputs):
        err.print(sentence, style="dim")


def table(title: str, columns: list[str], rows: list[list]) -> None:
    """Print a table; numbers to the right, a dash where there is none."""
    shown = Table(title=title, title_justify="left", header_style="bold", box=None, pad_edge=False)
    for index, column in enumerate(columns):
        numeric = bool(rows) and all(isinstance(row[index], (int, float)) for row in rows)
        shown.add_column(column, justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        shown.add_row(*(_written(cell) for cell in row))
    wide = Console(file=out.file, width=max(out.width, WIDE), **PLAIN)
    (out if out.is_terminal else wide).print(shown)


def _written(cell: object) -> str:
    """A cell as text; what is not a number is not written as one."""
    if isinstance(cell, float):
        return "-" if np.isnan(cell) else f"{cell:.5g}"
    return str(cell)


def print_json(answer) -> None:
    """Print data as JSON; NaN and infinities become null."""
    typer.echo(json.dumps(json_values(answer), indent=2, ensure_ascii=False))


def progress_bar() -> Progress:
    """A bar on standard error for anything over a second."""
    text = TextColumn("{task.description}", markup=False)
    return Progress(text, BarColumn(), TimeElapsedColumn(), console=err, transient=True)
