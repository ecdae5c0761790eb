"""Where the numbers of a text file begin and end, what parts its cells, and which rows above name them.

The block of numbers is what the file is about; everything else is found from it. Text above it is a preamble, text
below it a footer.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hydrotwin.models.language.errors import DataError

from ..clocks import called_time
from ..decimal_sign import number_in
from ..headings import is_units_row, split_header
from ..stamps import is_stamp

DELIMITERS = {"\t": "tab", ";": "semicolon", ",": "comma", "|": "bar", " ": "blanks"}
LOOKED_AT = 400  # lines from which the block of numbers is told, and as many before the end of the file
NUMERIC = 0.8  # of the rows of a block: from so many on a column with numbers in them is one of numbers
FEW_BELOW = 4  # rows of a footer in a short file
SMALL = 0.2  # of the rows of numbers that are looked at: fewer above another row of names are a table of their own
EVEN = 1.5  # the longest of the steps of a clock over the shortest: rounding may make them differ
COMMENTS = ("#", "%", "//", "'", "!")
CELLS = 1 << 15  # what is known of so many: each is asked for several times under every delimiter
MOST_ROWS_ABOVE = 6  # with the cells of the block: names, units, and what a logger writes beside them


@dataclass(frozen=True)
class Layout:
    """How the lines of a text are to be read. Lines count from 0.

    first : the line of the first numbers. last : one behind the last. delimiter : a single character, a blank for any
    number of them. width : cells of a row, without an empty one at the end. names, units : the cells of those rows, if
    any. names_at, units_at : their lines. numeric : columns that hold numbers or times.
    """

    first: int
    last: int
    delimiter: str
    width: int
    names: tuple[str, ...] | None = None
    units: tuple[str, ...] | None = None
    names_at: int | None = None
    units_at: int | None = None
    numeric: frozenset[int] = frozenset()

    def said(self) -> str:
        """In words, for a person."""
        words = [DELIMITERS.get(self.delimiter, repr(self.delimiter)) if self.width > 1 else "one column"]
        words += [f"names in row {self.names_at + 1}"] if self.names_at is not None else ["no names"]
        words += [f"units in row {self.units_at + 1}"] if self.units_at is not None else []
        return ", ".join(words)


class Lines(Sequence):
    """The lines of a text at its beginning and at its end, by their numbers: a long middle is not taken apart."""

    ENDS = 2_000_000  # characters

    def __init__(self, text: str):
        cut = text.find("\n", self.ENDS) if len(text) > 2 * self.ENDS else -1
        begin = text.rfind("\n", 0, len(text) - self.ENDS) + 1 if cut >= 0 else 0
        self.text = text
        self.head = text[:cut].split("\n") if 0 <= cut < begin else text.split("\n")
        self.tail = text[begin:].split("\n") if 0 <= cut < begin else []
        skipped = text.count("\n", cut + 1, begin) if self.tail else 0
        self.tail_at = len(self.head) + skipped

    def __len__(self) -> int:
        return self.tail_at + len(self.tail)

    def __getitem__(self, k: int) -> str:
        if k < len(self.head):
            return self.head[k]
        if k < self.tail_at:
            raise IndexError(k)
        return self.tail[k - self.tail_at]

    def line_with(self, beginning: str, after: int) -> int | None:
        """Number of the first line behind line ``after`` that begins so."""
        at = sum(len(line) + 1 for line in self.head[: after + 1]) - 1
        found = self.text.find(f"\n{beginning}", at)
        return None if found < 0 else self.text.count("\n", 0, found + 1)

    def body(self, first: int, last: int) -> str:
        """The text of lines ``first`` to before ``last``, the end of the last one as it is."""
        begin = sum(len(line) + 1 for line in self.head[:first])
        behind = sum(len(self[k]) + 1 for k in range(last, len(self)))
        return self.text[begin : len(self.text) - behind + 1 if behind else None]


def cells_of(line: str, delimiter: str) -> list[str]:
    """The cells of a line."""
    if delimiter == " ":
        line = re.sub(r"[ \t]+", " ", line.strip(" \t"))
        return line.split(" ") if '"' not in line else next(csv.reader([line], delimiter=" "))
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]


def is_comment(line: str) -> bool:
    """Whether a line stands behind a sign of comment, and is no row of numbers."""
    return line.startswith(COMMENTS) and not line.lstrip("'!").lstrip()[:1].isdigit()


def layout_of(lines: Sequence[str], path, delimiter: str | None = None) -> Layout:
    """The layout of a text; ``delimiter`` states it. Raises `DataError` for a text without a block of numbers."""
    stated = re.fullmatch(r"\s*\"?sep=(.)\"?\s*", lines[0], re.IGNORECASE) if lines else None
    delimiter = delimiter or (stated[1] if stated else None)
    begin = 1 if stated else 0
    tried = [delimiter] if delimiter else list(DELIMITERS)
    found = [layout for d in tried if (layout := _with_delimiter(lines, begin, d))]
    if not found:
        return _without_numbers(lines, begin, delimiter, path)
    return max(found, key=_rank)


def _rank(layout: Layout) -> tuple:
    """A better layout explains more: its names have its width, its cells are numbers, and there are more of them."""
    return (layout.names is not None, len(layout.numeric) / layout.width, len(layout.numeric))


def _with_delimiter(lines: Sequence[str], begin: int, delimiter: str) -> Layout | None:
    """The layout under one delimiter; None where no two lines in a row would hold numbers."""
    filled = _filled(lines, range(begin, len(lines)), LOOKED_AT)
    looked = [(k, cells_of(lines[k], delimiter)) for k in filled if not is_comment(lines[k])]
    width = _usual_width(looked)
    block = [(k, _trimmed(cells, width)) for k, cells in looked]
    rows = [cells for _, cells in block if len(cells) == width and any(map(_is_number, cells))]
    if not rows:
        return None
    settled = _settled(rows)
    numeric = frozenset(j for j in range(width) if _is_numeric([row[j] for row in settled]))
    if not numeric:
        return None
    labels = _labels([row for row in block if len(row[1]) == width], numeric)
    start = _start(block, width, numeric, labels)
    if start is None:
        return None
    first = block[start][0]
    above = [(k, cells) for k, cells in block[:start] if len(cells) == width]
    if delimiter == " " and not above:
        above = [(k, whole) for k, _ in block[:start] if len(whole := _with_units_attached(lines[k])) == width]
    rows_above = above or _uncommented(lines, first, width, delimiter)
    if not rows_above and delimiter in " \t" and _are_labels(lines, rows):  # its rows are named, too: there is one less
        less = [row for row in block[:start] if len(row[1]) == width - 1 and not any(map(_is_number, row[1]))]
        rows_above = [(k, ["", *cells]) for k, cells in less[-1:]]
    names_at, units_at, names, units = _named(rows_above, numeric, lines)
    named = max(k if k is not None else -1 for k in (names_at, units_at))
    below = [(k, cells) for k, cells in block[: start + 1] if k > named and len(cells) == width]
    first = next((k for k, cells in below if k not in labels and any(_is_number(cells[j]) for j in numeric)), first)
    last = _end(lines, first, delimiter, width, numeric)
    return Layout(first, last, delimiter, width, names, units, names_at, units_at, numeric)


def _settled(rows: list) -> list:
    """Rows behind whatever stands above the numbers, before whatever stands below them."""
    below = max(len(rows) // 8, min(FEW_BELOW, len(rows) // 4))
    return rows[len(rows) // 2 : len(rows) - below]


def _filled(lines: Sequence[str], which: range, most: int) -> list[int]:
    """Lines of ``which`` that are not blank, ``most`` of them."""
    found = []
    for k in which:
        if lines[k].strip():
            found.append(k)
            if len(found) == most:
                break
    return found


def _usual_width(looked: Sequence[tuple[int, list[str]]]) -> int:
    """The usual number of cells of lines with numbers, without one behind a trailing delimiter that nothing fills."""
    numbers = [any(map(_is_number, cells)) for _, cells in looked]
    rows = [cells for (_, cells), has in zip(looked, numbers, strict=True) if has]
    counts = Counter(len(cells) for cells in _settled(rows))
    if not counts:
        return 1
    width = max(counts, key=lambda n: (counts[n], n))
    named = any(len(cells) == width and cells[-1] for (_, cells), has in zip(looked, numbers, strict=True) if not has)
    filled = named or any(cells[-1] for cells in rows if len(cells) == width)
    return width if filled or width == 1 else width - 1


def _trimmed(cells: list[str], width: int) -> list[str]:
    """Without empty cells behind the last column."""
    while len(cells) > width and cells[-1] == "":
        cells = cells[:-1]
    return cells


@lru_cache(maxsize=CELLS)
def _is_number(cell: str) -> bool:
    return bool(cell) and any(c.isdigit() for c in cell) and (_value(cell) or is_stamp(cell))


def _value(cell: str) -> bool:
    return number_in(cell, ".") is not None or number_in(cell, ",") is not None


def _is_numeric(cells: Sequence[str]) -> bool:
    numbers = sum(map(_is_number, cells))
    return numbers > 0 and numbers >= NUMERIC * sum(cell != "" and not _is_missing(cell) for cell in cells)


@lru_cache(maxsize=CELLS)
def _is_missing(cell: str) -> bool:
    return number_in(cell, ".") is not None and not any(c.isdigit() for c in cell)


def _labels(rows: Sequence[tuple[int, list[str]]], numeric: frozenset[int]) -> set[int]:
    """Lines above the numbers that hold numbers too, and a word that names them: ``Channel;1;2``.

    They have one where nearly all samples have none. A sample with a remark has it as well, but goes on as the samples
    do: with a date or time where they have one, with the usual step of a column that grows.
    """
    samples = [cells for _, cells in rows if any(_is_number(cells[j]) for j in numeric)]
    if 0 in numeric or sum(cells[0] == "" for cells in samples) < NUMERIC * len(samples):
        return set()
    clock = next((j for j in sorted(numeric) if _goes_on(samples[-(len(samples) // 2) :], j)), None)
    found, following = set(), []
    for k, cells in reversed(rows):
        named = cells[0] and any(_is_number(cells[j]) for j in numeric)
        if named and (clock is None or not _goes_on([cells, *following], clock)):
            found.add(k)
        else:
            following = [cells, *following[:2]]
    return found


def _goes_on(rows: Sequence[list[str]], column: int) -> bool:
    """Whether a column holds dates or times, or numbers that grow by even steps, in all of a few rows."""
    cells = [row[column] for row in rows]
    if len(cells) < 3 or all(map(is_stamp, cells)):
        return all(map(is_stamp, cells))
    numbers = [number_in(c, "," if "," in c else ".") for c in cells]
    if any(n is None or not np.isfinite(n) for n in numbers):
        return False
    steps = np.diff(numbers)
    return bool(steps.min() > 0 and steps.max() < EVEN * steps.min())


def _start(block: Sequence[tuple[int, list[str]]], width: int, numeric: frozenset[int], labels: set[int]) -> int | None:
    """Index in the block of the first line of numbers behind the last of names."""

    def holds(k: int, cells: list[str]) -> bool:
        if len(cells) != width or k in labels:
            return False
        inside = [cells[j] for j in numeric]
        numbers = sum(map(_is_number, inside))
        return numbers > 0 and 2 * numbers >= sum(cell != "" and not _is_missing(cell) for cell in inside)

    rows = [at for at, (k, cells) in enumerate(block) if holds(k, cells)]
    first = None
    for k, following in zip(rows, [*rows[1:], len(block)], strict=True):
        if not any(_is_heading(cells, width) for _, cells in block[k + 1 : following]):
            first = k if first is None else first
            continue
        before = {tuple(cells) for _, cells in block[: rows[0]] if _is_heading(cells, width)}
        again = any(tuple(cells) in before for _, cells in block[k + 1 : following])
        if not again and rows.index(k) + 1 < SMALL * len(rows):  # what ends here is another, small table
            first = None
    return first


def _is_heading(cells: list[str], width: int) -> bool:
    """Whether a row is one of names or units: above it are no samples, but numbers of channels."""
    return len(cells) == width and not any(map(_is_number, cells)) and sum(map(bool, cells)) > width / 2


def _with_units_attached(line: str) -> list[str]:
    """Cells of a line of names parted by blanks, units in brackets behind them."""
    return re.findall(r"\S+\s*\[[^\]]*\]|\S+\s*\([^)]*\)|\S+", line)


def _uncommented(lines: Sequence[str], first: int, width: int, delimiter: str) -> list[tuple[int, list[str]]]:
    """Rows of names that stand behind a sign of comment."""
    found = []
    for k in range(max(0, first - MOST_ROWS_ABOVE), first):
        sign = next((c for c in COMMENTS if lines[k].startswith(c)), None)
        if sign:
            bare = lines[k].removeprefix(sign).strip()
            options = [cells_of(bare, delimiter), *([_with_units_attached(bare)] if delimiter == " " else [])]
            found += [(k, cells) for cells in options if len(_trimmed(cells, width)) == width][:1]
    return found


def _named(above: Sequence[tuple[int, list[str]]], numeric: frozenset[int], lines: Sequence[str]):
    """Lines and cells of the names and of the units, out of the rows right above that are as wide as the block."""
    rows = [(k, cells) for k, cells in above if not all(_is_number(cells[j]) for j in numeric) and any(cells)]
    for at in range(len(rows) - 1, 0, -1):  # what stands apart from them is of another kind, but not names over units
        apart = rows[at][0] - rows[at - 1][0] > 1
        if apart and not (at == len(rows) - 1 and is_units_row(rows[at][1])):
            rows = rows[at:]
            break
    rows = rows[-MOST_ROWS_ABOVE:]
    if not rows:
        return None, None, None, None
    units = [row for row in rows if is_units_row(row[1])] if len(rows) > 1 else []
    units = units[1:] if len(units) == len(rows) else units  # names that could all be units: the upper row names
    names = max((row for row in rows if row not in units), key=_naming)
    mostly = [row for row in rows if row != names and is_units_row(row[1], mostly=True)]
    unit = (units or mostly or [None])[-1]
    return names[0], unit and unit[0], tuple(names[1]), unit and tuple(unit[1])


def _naming(row: tuple[int, list[str]]) -> tuple:
    """How well a row names columns: with units, one of them a time, all of them different; the upper of two."""
    at, cells = row
    split = [split_header(cell) for cell in cells if cell]
    with_units = bool(split) and all(unit for _, unit in split)
    timed = any(called_time(name) for name, _ in split)
    return with_units, timed, len({cell for cell in cells if cell and not _is_number(cell)}), -at


def _are_labels(lines: Sequence[str], rows: Sequence[list[str]]) -> bool:
    """Whether the first cells of the rows are their names: in quotes, or counted from 1."""
    first = [row[0] for row in rows]
    quoted = sum(line.lstrip().startswith('"') for line in lines.head[: len(rows) + MOST_ROWS_ABOVE])
    return quoted >= len(rows) or first == [str(k) for k in range(1, len(rows) + 1)]


def _end(lines: Sequence[str], first: int, delimiter: str, width: int, numeric: frozenset[int]) -> int:
    """One behind the last line of numbers: lines of words at the end are a footer."""
    end = len(lines)
    while end > first and not lines[end - 1].strip():
        end -= 1
    for k in range(end - 1, max(first, end - LOOKED_AT), -1):
        if lines[k].strip() and not _is_footer(_trimmed(cells_of(lines[k], delimiter), width), width, min(numeric)):
            return k + 1
    return end


def _is_footer(cells: list[str], width: int, column: int) -> bool:
    """Whether a line at the end is none of the block: a word stands where its first numbers are, or no number is."""
    at = cells[min(column, len(cells) - 1)]
    word = bool(re.search(r"[^\W\d_]{3}", at)) and not is_stamp(at) and not _value(at)
    return word or (not any(map(_is_number, cells)) and len(cells) != width)


def _without_numbers(lines: Sequence[str], begin: int, delimiter: str | None, path) -> Layout:
    """The layout of a header with nothing below it; `DataError` where there is not even that."""
    bare = [k for k in _filled(lines, range(begin, len(lines)), LOOKED_AT) if not lines[k].startswith(COMMENTS)]
    if not bare:
        raise DataError(f"{path}: row 1: there are only comments. Write a header 'time [s],name [unit],...'.")
    line = lines[bare[0]]
    outside_units = re.sub(r"\[[^\]]*\]", "", line)
    delimiter = delimiter or max(",;\t", key=outside_units.count)
    names = cells_of(line, delimiter)
    if len(bare) > 1:
        raise DataError(
            f"{path}: row {bare[0] + 1}: no block of numbers was found below '{line.strip()[:40]}'. A recording has "
            "two rows of numbers or more, as many cells in each. Open the file in an editor, or state what parts its "
            "cells: --delimiter ';'."
        )
    return Layout(len(lines), len(lines), delimiter, len(names), tuple(names), names_at=bare[0])
