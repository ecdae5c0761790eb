"""Text files of numbers as a Table: what they hold, and in one line how they were understood."""

from __future__ import annotations

import csv
import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from ..columns import UNSEEN, ZEROS_BEFORE, Column, Table, rounding_of
from ..decimal_sign import MINUS, found_decimal
from ..headings import headings, together
from .cells import Block, Place, block_of, column_cells
from .decode import text_of
from .labview import is_labview, labview_layout
from .layout import Layout, Lines, cells_of, is_comment, layout_of

OVERFLOW = (9.9e37, 9.91e37)  # what instruments write after SCPI for a value beyond the range, and for none
HEAD = 20_000  # characters in which a name in quotes may span two lines
_BROKEN = re.compile(r'(?:^|(?<=[,;\t\n]))"[^"\n]{0,80}\n[^"\n]{0,80}"(?=[,;\t\n])')
_QUOTED = re.compile(r'(?:"[^"\n]*(?:[;\t]|,[^"\n]*,)[^"\n]*"[ \t]*\n){3}')
_SECONDS = re.compile(r"(\d{4}-\d{2}-\d{2} \d{2}:\d{2}:\d{2}),(\d{3})(?=,)")  # Python's logging writes its stamps so
_BETWEEN = "\x1f"  # delimiter in place of the comma where quoted cells hold commas: no number contains it


@dataclass(frozen=True)
class Stated:
    """What a person states of a text file: its encoding, what parts its cells, its decimal sign; None: found out."""

    encoding: str | None = None
    delimiter: str | None = None
    decimal: str | None = None


def read_text(path: Path, stated: Stated | None = None) -> Table:
    """The table of a text file.

    Raises `DataError` for ragged rows, a truncated or empty file, a doubtful decimal sign: with row and column.
    """
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    text, encoding = text_of(content, path, stated and stated.encoding)
    del content
    table = table_of_text(text, path, stated or Stated())
    sure = encoding.startswith(("utf-", "ascii")) or (stated and stated.encoding)
    shown = "" if encoding in ("utf-8", "ascii") else f"{encoding}, " if sure else f"{encoding} (or --encoding), "
    return Table(**{**vars(table), "digest": digest, "understood": shown + table.understood})


def table_of_text(text: str, path: Path, stated: Stated) -> Table:
    """The table of a text; its digest is left to whoever knows the file."""
    text = _plain(text)
    lines = Lines(_BROKEN.sub(lambda m: m[0].replace("\n", " "), text[:HEAD]) + text[HEAD:])
    if is_labview(lines[0]):
        layout, decimal, clock = labview_layout(lines, path)
        stated = Stated(None, layout.delimiter, stated.decimal or decimal)
    else:
        layout, clock = layout_of(lines, path, stated.delimiter), None
    if layout.first >= layout.last and not layout.numeric:
        raise DataError(
            f"{path}: no row of numbers, column 'time' needs two or more. It may be a header and no row of values, or "
            "no recording at all. Record longer, or check the export."
        )
    body = lines.body(layout.first, layout.last)
    body = body if body.isascii() else body.translate(MINUS)
    said = layout
    body, layout = _unquoted(body, layout)
    decimal = stated.decimal or _stated_above(lines, layout)
    if decimal is None:
        decimal = "." if layout.delimiter == "," else found_decimal(body, layout.delimiter, path, layout.first + 1)
    found = _headings(layout)
    place = Place(path, layout.first + 1, layout, decimal, [name for name, _ in found])
    block = block_of(body, place)
    found = [(name, together(unit, block.units[k])) for k, (name, unit) in enumerate(found)]
    columns = [_column(found[k], block, k, body, layout, decimal) for k in range(layout.width)]
    if clock:
        start, step = clock
        columns.insert(0, Column("time", "s", start + step * np.arange(len(block.values[0]))))
    header = f"row {(layout.first if layout.names_at is None else layout.names_at) + 1}"
    return Table(str(path), tuple(columns), block.row, "", header, understood=_said(said, decimal, lines))


def _plain(text: str) -> str:
    """The text without quotes around whole lines, and with a point where a comma in stamps would part cells."""
    if _QUOTED.match(text):
        text = re.sub(r'(?m)^"([^"\n]*)"[ \t]*$', r"\1", text)
    if match := _SECONDS.search(text[:HEAD]):
        *above, row = text[: text.find("\n", match.end())].rstrip("\n").split("\n")
        names = next((line for line in reversed(above) if line.strip()), "")
        if len(cells_of(names.rstrip(", "), ",")) == len(cells_of(row.rstrip(", "), ",")) - 1:
            return _SECONDS.sub(r"\1.\2", text)
    return text


def _unquoted(body: str, layout: Layout) -> tuple[str, Layout]:
    """A block whose quoted cells hold commas, parted by another sign."""
    if layout.delimiter != "," or '"' not in body or not re.search(r'"[^",\n]*\d,\d', body):
        return body, layout
    rows = csv.reader(body.split("\n"), delimiter=",", skipinitialspace=True)
    body = "\n".join(_BETWEEN.join(cells) for cells in rows)
    return body, Layout(**{**vars(layout), "delimiter": _BETWEEN})


def _stated_above(lines: Lines, layout: Layout) -> str | None:
    """The decimal sign that a line ``# decimal=,`` above the numbers states."""
    for line in lines.head[: layout.first]:
        if match := re.fullmatch(r"#\s*decimal\s*=\s*([.,])\s*", line):
            return match[1]
    return None


def _headings(layout: Layout) -> list[tuple[str, str | None]]:
    """Names and units; a file without names has its columns called by their numbers."""
    if layout.names is None:
        return [(str(k + 1), None) for k in range(layout.width)]
    return headings(layout.names, layout.units)


def _column(heading, block: Block, k: int, body: str, layout: Layout, decimal: str) -> Column:
    name, unit = heading
    values, texts = block.values[k], block.texts[k]
    if len(values) and np.nanmax(np.abs(values), initial=0.0) >= OVERFLOW[0]:
        values = np.where(np.isin(np.abs(values), OVERFLOW), np.nan, values)
    if texts is None and len(values) > 1 and np.isfinite(values).all() and UNSEEN < rounding_of(values) < np.inf:
        texts = [cell if decimal == "." else cell.replace(",", ".") for cell in column_cells(body, layout, k)]
    if texts is None and len(values) and (values == values[0]).all() and _zeros_before(body, layout, k):
        texts = list(column_cells(body, layout, k))
    return Column(name, unit, values, block.problems[k], texts)


def _zeros_before(body: str, layout: Layout, k: int) -> bool:
    """Whether a column begins as no number is written."""
    return bool(ZEROS_BEFORE.fullmatch(next(column_cells(body, layout, k), "").strip()))


def _said(layout: Layout, decimal: str, lines: Lines) -> str:
    words = [layout.said()]
    words += ["decimal comma"] if decimal == "," else []
    named = max(-1 if k is None else k for k in (layout.names_at, layout.units_at))
    between = [] if named < 0 else _filled(lines, named + 1, layout.first)
    for left, where in ((between, "above"), (_filled(lines, layout.last, len(lines)), "below")):
        if left:
            several = "s" if len(left) > 1 else ""
            words += [f"{len(left)} line{several} {where} the numbers left out, the first: '{left[0][:40]}'"]
    return ", ".join(words)


def _filled(lines: Lines, first: int, last: int) -> list[str]:
    return [line for k in range(first, last) if (line := lines[k].strip()) and not is_comment(line)]


def no_names(path: Path) -> DataError:
    """What is said of a file whose columns have no names, where one is needed."""
    return DataError(
        f"{path}: its columns have no names; they are called 1, 2, ... from the left. Say which is which: "
        "--column command=2."
    )
