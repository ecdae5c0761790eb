"""Tables: one set of rows, rendered as HTML, Markdown and JSON."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from .format import NONE, difference_to_shown, number_text, number_texts, pretty_unit, to_shown

# what Markdown would take for itself and leave out: a tag, a link, a sign by its name
_TAG = re.compile(r"<(?=[A-Za-z/!?])|\[(?=[^\[\]]*\]\()|&(?=#?\w+;)")
_STARS = re.compile(r"\*.*\*", re.DOTALL)  # pairs, which slant or embolden
_LINES = re.compile(r"(?<!\w)_(?=\w).*(?<=\w)_(?!\w)", re.DOTALL)
_BESIDE = re.compile(r"(?<!\w)_(?=\w)|(?<=\w)_(?!\w)")


@dataclass(frozen=True)
class Cell:
    """One value: ``value`` in SI as in the JSON, ``text`` as shown everywhere.

    best : the best of its column.  colour : the model's colour, shown as a swatch.  tone : "", "warning" or "quiet".
    link : another page, by its way from this one.
    """

    value: float | str | bool | None
    text: str
    best: bool = False
    colour: str = ""
    tone: str = ""
    link: str = ""

    @property
    def plain(self) -> str:
        """The text where nothing can be pale: in brackets what is quiet."""
        return f"({self.text})" if self.tone == "quiet" and self.text != NONE else self.text


@dataclass(frozen=True)
class Column:
    """Cells under one heading. ``unit`` is that of the values (SI), ``shown`` that of the texts."""

    key: str
    title: str
    cells: tuple[Cell, ...]
    unit: str = ""
    shown: str = ""
    numeric: bool = False

    @property
    def heading(self) -> str:
        """Title with its unit, as printed."""
        unit = pretty_unit(self.shown)
        return f"{self.title} [{unit}]" if unit else self.title


@dataclass(frozen=True)
class Table:
    """Columns of equal length. A ``folded`` table opens on a click."""

    id: str
    title: str
    columns: tuple[Column, ...]
    note: str = ""
    folded: bool = False

    @property
    def rows(self) -> list[tuple[Cell, ...]]:
        """The table by rows."""
        return list(zip(*(c.cells for c in self.columns), strict=True))

    def as_json(self) -> dict:
        """Columns with units, and rows with the SI value and the text shown of each cell."""
        return {
            "title": self.title,
            "columns": [{"key": c.key, "title": c.title, "unit": c.unit, "shown_unit": c.shown} for c in self.columns],
            "rows": [{c.key: _cell_json(cell) for c, cell in zip(self.columns, row, strict=True)} for row in self.rows],
        }

    def as_markdown(self) -> str:
        """The table as GitHub Markdown; the best of a column is bold."""
        lines = [f"| {' | '.join(_escaped(c.heading) for c in self.columns)} |"]
        lines.append(f"|{'|'.join('---:' if c.numeric else ':---' for c in self.columns)}|")
        for row in self.rows:
            texts = [_linked(c, f"**{_escaped(c.plain)}**" if c.best else _escaped(c.plain)) for c in row]
            lines.append(f"| {' | '.join(texts)} |")
        return "\n".join(lines)


def texts(key: str, title: str, values: Sequence[str], colours: Sequence[str] | None = None) -> Column:
    """A column of words; ``colours`` puts a swatch before each."""
    colours = colours or [""] * len(values)
    return Column(key, title, tuple(Cell(v, v, colour=c) for v, c in zip(values, colours, strict=True)))


def numbers(
    key: str,
    title: str,
    values: Sequence[float | None],
    unit: str = "",
    shown: str | None = None,
    *,
    difference: bool = True,
    best: str = "",
    digits: int = 3,
    common: bool = True,
    decimals: int | None = None,
    among: Sequence[bool] | None = None,
) -> Column:
    """A column of numbers given in SI.

    difference : the values are errors, to which the zero point of a unit does not apply.
    common : the same decimals for the whole column; else ``digits`` significant ones for each number.
    decimals : how many, where another column decides.
    best : "min" or "max" marks the best (all that tie), of those rows where ``among`` is true.
    """
    values = [math.nan if v is None else float(v) for v in values]
    shown = unit if shown is None else shown
    convert = difference_to_shown if difference else to_shown
    seen = [float(convert(v, unit, shown)) if unit and math.isfinite(v) else v for v in values]
    words = number_texts(seen, digits, decimals) if common else [number_text(v, digits) for v in seen]
    marks = _best(values, best, among)
    cells = (
        Cell(v if math.isfinite(v) else None, text, best=mark)
        for v, text, mark in zip(values, words, marks, strict=True)
    )
    return Column(key, title, tuple(cells), unit, shown, numeric=True)


def counts(key: str, title: str, values: Sequence[int | None]) -> Column:
    """A column of whole numbers, or of none."""
    cells = tuple(Cell(None, NONE) if v is None else Cell(int(v), f"{int(v)}") for v in values)
    return Column(key, title, cells, numeric=True)


def warned(column: Column, where: Sequence[bool]) -> Column:
    """The column with a warning tone on the cells where ``where`` is true."""
    cells = (replace(c, tone="warning") if w else c for c, w in zip(column.cells, where, strict=True))
    return replace(column, cells=tuple(cells))


def linked(column: Column, links: Sequence[str]) -> Column:
    """The column with links to other pages, "" for none."""
    return replace(column, cells=tuple(replace(c, link=to) for c, to in zip(column.cells, links, strict=True)))


def quiet(column: Column, where: Sequence[bool]) -> Column:
    """The column with pale cells where ``where`` is true."""
    cells = (replace(c, tone="quiet") if w and not c.tone else c for c, w in zip(column.cells, where, strict=True))
    return replace(column, cells=tuple(cells))


def table(id: str, title: str, columns: Sequence[Column], note: str = "", folded: bool = False) -> Table:
    """A table; all columns must be equally long."""
    return Table(id, title, tuple(columns), note, folded)


def _best(values: list[float], best: str, among: Sequence[bool] | None) -> list[bool]:
    among = [True] * len(values) if among is None else among
    rivals = [v for v, a in zip(values, among, strict=True) if a and not math.isnan(v)]
    if not best or len(rivals) < 2:
        return [False] * len(values)
    winner = min(rivals) if best == "min" else max(rivals)
    return [a and v == winner for v, a in zip(values, among, strict=True)]


def _cell_json(cell: Cell) -> dict:
    more = ({"best": True} if cell.best else {}) | ({"link": cell.link} if cell.link else {})
    return {"value": cell.value, "shown": cell.text} | more


def _linked(cell: Cell, text: str) -> str:
    return f"[{text}]({cell.link})" if cell.link else text


def markdown_text(text: str) -> str:
    """Text as Markdown shows it letter by letter: ``<b>`` in a name is no tag, two stars or lines are not bold, a line
    end is a space. One alone stays as it is: a command can be copied.

    >>> markdown_text("load<2: <old> d*.rmse < 3 mm")
    'load<2: \\\\<old> d*.rmse < 3 mm'
    >>> markdown_text("_cold_ run_1 [a](b) &amp; [mm]")
    '\\\\_cold\\\\_ run_1 \\\\[a](b) \\\\&amp; [mm]'
    """
    pairs = [(_STARS, r"\*"), (_LINES, _BESIDE.pattern)]
    found = [_TAG.pattern, *(signs for pair, signs in pairs if pair.search(text))]
    return re.sub("|".join(found), r"\\\g<0>", text).replace("\n", " ")


def _escaped(text: str) -> str:
    return markdown_text(text).replace("|", "\\|")
