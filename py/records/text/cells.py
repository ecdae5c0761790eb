"""The cells of a block of numbers, column by column: numbers, or what they say instead."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.errors import DataError

from ..decimal_sign import MISSING_TEXTS, SIGNS, number_in, other_sign, without_groups
from ..headings import is_unit
from ..stamps import is_stamp
from .layout import Layout, cells_of, is_comment

LARGE = 2_000_000  # characters: from here on pyarrow is worth its import
_WITH_UNIT = re.compile(r"[-+]?\d[\d.,]*(?:[eE][-+]?\d+)?(?:\s+|(?=[%°])|(?=[^\W\d]{2}))([^\s\d.,:;+-][^\s:;]*)")
_HEAD = 100  # cells that tell a column of text
_SHOWN = 40  # characters of a cell in a sentence


@dataclass(frozen=True, eq=False)
class Block:
    """What stands in a block: a column each.

    values : (n,) float, NaN for what is missing. texts : the cells as written, of columns that hold no numbers only.
    problems : why a column holds none, "" where it does. row : index of a sample -> number of its line. units : what
    stands behind the numbers of a column, in every cell, or None.
    """

    values: Sequence[np.ndarray]
    texts: Sequence[Sequence[str] | None]
    problems: Sequence[str]
    row: Callable[[int], int]
    units: Sequence[str | None]


@dataclass(frozen=True)
class Place:
    """Where a block stands: the file, its first line (from 1), its layout, the decimal sign, names of its columns."""

    path: object
    first_row: int
    layout: Layout
    decimal: str
    names: Sequence[str]


def block_of(body: str, place: Place) -> Block:
    """The block of a text. Raises `DataError` for rows that are too short or too long, with row and column."""
    layout = place.layout
    if not body or body.isspace():
        none = [np.empty(0)] * layout.width
        n = layout.width
        return Block(none, [None] * n, [""] * n, lambda k: place.first_row + k, [None] * n)
    if layout.width == 1:
        body = re.sub(r"(?m)^[ \t]*$(?=\n)", "nan", body)  # nothing else can say that a value is missing
    try:
        found = _quick(body, place)
    except (ValueError, UnicodeError):  # pyarrow's errors are ValueErrors
        found = None
    return found or _carefully(body, place)


def column_cells(body: str, layout: Layout, column: int) -> Iterator[str]:
    """The cells of one column, as they are written."""
    for line in body.split("\n"):
        if line.strip():
            cells = cells_of(line, layout.delimiter)
            yield cells[column] if column < len(cells) else ""


# -- quickly -----------------------------------------------------------------------------------------------------------
def _quick(body: str, place: Place) -> Block | None:
    """The block where its columns are plain numbers, or a few of them text; None for anything else."""
    layout, quoted = place.layout, '"' in body
    if place.decimal == layout.delimiter or (quoted and len(body) < LARGE):
        return None
    if len(body) >= LARGE and layout.delimiter != " ":
        with contextlib.suppress(ValueError):  # numbers in groups
            return _with_arrow(body, body, place)
    plain = body if (layout.delimiter, place.decimal) == (",", ".") else without_groups(body, place.decimal)
    if plain is None:
        return None
    if layout.delimiter == " ":
        plain = re.sub(r"(?m)^ | $", "", re.sub(r"[ \t]+", " ", plain))
    if len(body) >= LARGE:
        return _with_arrow(plain, body, replace(place, decimal="."))
    values = np.loadtxt(io.StringIO(plain), delimiter=layout.delimiter, comments=None, ndmin=2)
    if values.shape[1] != layout.width:
        return None
    n = layout.width
    return Block(list(values.T), [None] * n, [""] * n, _row_finder(body, place.first_row), [None] * n)


def _with_arrow(plain: str, body: str, place: Place) -> Block | None:
    import pyarrow
    from pyarrow import csv as arrow_csv

    layout = place.layout
    plain = plain.lstrip("\n")
    count = plain[: plain.find("\n")].count(layout.delimiter) + 1 if layout.width > 1 else 1
    if count < layout.width:
        return None
    names = [str(k) for k in range(count)]
    first = cells_of(plain[: plain.find("\n")], layout.delimiter)
    numbers = {k for k in layout.numeric if not is_stamp(first[k])}
    kinds = {n: pyarrow.float64() if k in numbers else pyarrow.string() for k, n in enumerate(names)}
    read = arrow_csv.ReadOptions(column_names=names, block_size=1 << 24)
    missing = [text for word in MISSING_TEXTS for text in {word, word.upper(), word.capitalize(), _camel(word)}]
    convert = arrow_csv.ConvertOptions(
        column_types=kinds, null_values=missing, strings_can_be_null=False, decimal_point=place.decimal
    )
    parse = arrow_csv.ParseOptions(delimiter=layout.delimiter)
    table = arrow_csv.read_csv(pyarrow.BufferReader(plain.encode()), read, parse, convert)
    if any(cell for k in range(layout.width, count) for cell in table.column(k).unique().to_pylist()):
        return None  # values without a column
    columns = [table.column(k) for k in range(layout.width)]
    texts = [None if k in numbers else column.to_pylist() for k, column in enumerate(columns)]
    rows = _row_finder(body, place.first_row)
    values = [c.to_numpy() if t is None else np.full(len(c), np.nan) for c, t in zip(columns, texts, strict=True)]
    problems, units = [""] * layout.width, [None] * layout.width
    for k in range(layout.width):
        if texts[k] is not None:
            values[k], texts[k], problems[k], units[k] = _column(place, k, texts[k], rows)
    return Block(values, texts, problems, rows, units)


def _camel(word: str) -> str:
    return "NaN" if word == "nan" else word


def _row_finder(body: str, first_row: int) -> Callable[[int], int]:
    """Sample index -> line number; blank lines count in the file and hold no sample."""

    def row(k: int) -> int:
        filled = [number for number, line in enumerate(body.split("\n"), start=first_row) if line.strip()]
        return filled[k] if k < len(filled) else filled[-1] + 1

    return row


# -- carefully ---------------------------------------------------------------------------------------------------------
def _carefully(body: str, place: Place) -> Block:
    """Cell by cell: a row of another width is refused, a column with another thing than numbers says so."""
    width, rows, table = place.layout.width, [], []
    lines = body.split("\n")
    cut_off = len(lines) - 1 if lines[-1].strip() else None  # a last line without its end
    for k, line in enumerate(lines):
        if not line.strip():
            continue
        cells = cells_of(line, place.layout.delimiter)
        if is_comment(line) and not _may_be_number(cells[0]) and (len(cells) != width or 0 in place.layout.numeric):
            continue
        while len(cells) > width and not any(c.isdigit() for c in cells[-1]):
            cells.pop()  # an end of the row, or a remark
        if len(cells) == width - 1 and width - 1 not in place.layout.numeric:
            cells.append("")  # a remark that this row lacks
        if len(cells) != width:
            _fail_ragged(place, k, cells, cut_off == k)
        table.append(cells)
        rows.append(place.first_row + k)
    columns = [_column(place, j, [cells[j] for cells in table], rows.__getitem__) for j in range(width)]
    values, texts, problems, units = zip(*columns, strict=True)
    return Block(values, texts, problems, lambda k: rows[k] if k < len(rows) else rows[-1] + 1, units)


def _column(place: Place, j: int, cells: Sequence[str], row: Callable[[int], int]):
    """Values, the cells where they are no numbers, and why; the unit that stands in every cell."""
    head = [cell for cell in cells[:_HEAD] if cell]
    unit = _unit_behind(head)
    if unit:
        bare = [cell.removesuffix(unit).rstrip() for cell in cells]
        return *_column(place, j, bare, row)[:3], unit
    if len(head) > _HEAD / 2 and not any(number_in(cell, place.decimal) is not None for cell in head):
        return np.full(len(cells), np.nan), cells, _is_text(place, j, cells, row), None
    numbers = [number_in(cell, place.decimal) for cell in cells]
    if None not in numbers and any(cells):
        return np.array(numbers, dtype=float), None, "", None
    values = np.array([np.nan if number is None else number for number in numbers], dtype=float)
    wrong = [k for k, number in enumerate(numbers) if number is None]
    filled = sum(cell != "" for cell in cells)
    if len(wrong) >= filled / 2 and not (wrong and _flawed_number(cells[wrong[0]])):
        return np.full(len(cells), np.nan), cells, _is_text(place, j, cells, row), None
    k, other = wrong[0], other_sign(place.decimal)
    one = cells[k].count(other) == 1
    state = f" Or state the other sign: --decimal '{other}', or '# decimal={other}' above the header." if one else ""
    why = (
        f"{place.path}: row {row(k)}, column '{place.names[j]}': not a number (got '{cells[k][:_SHOWN]}'). Write a "
        f"decimal {'point' if place.decimal == '.' else 'comma'}; '{other}' may only part groups of three digits; no "
        f"unit in the cell.{state}"
    )
    return values, cells, why, None


def _unit_behind(cells: Sequence[str]) -> str | None:
    """The unit that stands behind the number in all of these cells."""
    if any(number_in(cell, d) is not None for cell in cells for d in SIGNS):
        return None  # 1.5d2 is a number
    matches = [_WITH_UNIT.fullmatch(cell) for cell in cells]
    units = {match[1] for match in matches if match}
    return units.pop() if matches and all(matches) and len(units) == 1 and is_unit(next(iter(units))) else None


def _may_be_number(cell: str) -> bool:
    """Whether a number stands behind a sign of comment."""
    return any(number_in(cell.lstrip("#%/'! "), d) is not None for d in SIGNS)


def _flawed_number(cell: str) -> bool:
    """Whether a cell was meant for a number: it is made of digits and signs only, and no date or time."""
    return not is_stamp(cell) and not any(c.isalpha() for c in cell) and any(c.isdigit() for c in cell)


def _is_text(place: Place, j: int, cells: Sequence[str], row: Callable[[int], int]) -> str:
    k = next((k for k, cell in enumerate(cells) if cell and number_in(cell, place.decimal) is None), None)
    if k is None:
        return f"{place.path}: column '{place.names[j]}' is empty. Record it, or take another column."
    kind = "dates or times" if is_stamp(cells[k]) else "text"
    return (
        f"{place.path}: row {row(k)}, column '{place.names[j]}': {kind}, not numbers (got '{cells[k][:_SHOWN]}'). "
        "Write numbers, or take another column."
    )


def _fail_ragged(place: Place, k: int, cells: list[str], cut_off: bool) -> None:
    width, row = place.layout.width, place.first_row + k
    names = "the header names" if place.layout.names else "the rows before have"
    counted = f"(got {len(cells)} values, {names} {width})"
    if len(cells) > width:
        raise DataError(
            f"{place.path}: row {row}, column {width + 1}: a value without a column {counted}. "
            "Remove it, or look for a decimal comma in this row."
        )
    column = place.names[len(cells)]
    if cut_off:
        raise DataError(
            f"{place.path}: row {row}, column '{column}': the file ends in the middle of this row {counted}. "
            "It was cut off while it was written or copied: copy it again, or delete this row."
        )
    raise DataError(
        f"{place.path}: row {row}, column '{column}': the row is too short {counted}. Repair or delete this row."
    )
