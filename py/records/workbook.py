"""Excel and LibreOffice workbooks: the sheet with most numbers, its cells as rows."""

from __future__ import annotations

import datetime
import hashlib
import io
import re
import zipfile
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError, nearest

from .binary_files import content_of, unreadable
from .columns import Column, Table
from .decimal_sign import SIGNS, number_in
from .text.read import Stated, table_of_text

Cell = str | float | datetime.datetime | None

LARGEST_SHARE = 10.0  # a cell that shows 1000 %
DAY_ZERO = datetime.datetime(1899, 12, 31)  # from which Excel counts days
_CELLS = 30_000_000  # of one sheet, from A1 to the last one; all are held in memory
_UNPACKED = 2 << 30  # bytes; 30 million cells need half of it
_CHUNK = 1 << 20  # bytes


def read_workbook(path: Path, sheet: str | None = None, decimal: str | None = None) -> Table:
    """The table of a sheet, the one with most numbers where none is named; names and units are found as in a text.

    Cells that hold a number as a text have a decimal sign, to be found or stated as in a text; numbers have none.
    """
    found = read_sheet(path, sheet)
    as_texts = any(map(_has_sign, chain.from_iterable(found.rows)))
    lines = ("\t".join(_text(cell, as_texts) for cell in row) for row in found.rows)
    table = table_of_text("\n".join(lines), path, Stated(delimiter="\t", decimal=decimal if as_texts else "."))
    columns = tuple(replace(c, unit="% or 1") if _may_be_share(c) else c for c in table.columns)
    table = replace(table, columns=columns)
    said = f"{found.title}, {table.understood.removeprefix('tab, ')}"
    return replace(table, digest=found.digest, header=f"{found.title}, {table.header}", understood=said)


def _may_be_share(column: Column) -> bool:
    """Whether numbers in % are all so small that their cells may be shares, shown as %."""
    known = column.values[np.isfinite(column.values)]
    return column.unit == "%" and len(known) > 0 and bool(np.abs(known).max() <= LARGEST_SHARE)


@dataclass(frozen=True, eq=False)
class Sheet:
    """The rows of the sheet that was read; ``others`` are the names of those that were not."""

    name: str
    rows: list[list[Cell]]
    others: tuple[str, ...]
    digest: str

    @property
    def title(self) -> str:
        """How an error calls it."""
        return f"sheet '{self.name}'" + (f" (others: {', '.join(self.others)})" if self.others else "")


def read_sheet(path: Path, name: str | None = None) -> Sheet:
    """The rows of a sheet, from row 1 and column A on: text, number, date-time, or None.

    A date, a time of day and a duration are text, ``2026-05-04``, ``03:04:05.250000``; a truth value is 0 or 1.
    Raises `DataError` for a damaged, locked or absurdly large workbook.
    """
    content = content_of(path)
    calamine = _calamine(path)
    try:
        _check_size(path, content)
        book = calamine.CalamineWorkbook.from_filelike(io.BytesIO(content))
        if name is not None and name not in book.sheet_names:
            raise DataError(f"{path}: no sheet '{name}'. {nearest(name, book.sheet_names)}")
        wanted = book.sheet_names if name is None else [name]
        sheets = {n: book.get_sheet_by_name(n).to_python(skip_empty_area=False) for n in wanted}
    except calamine.PasswordError:
        raise DataError(f"{path}: locked by a password. Save it without one.") from None
    except DataError:
        raise
    except Exception as error:  # a damaged archive fails in many ways
        raise unreadable(path, "Excel", error) from None
    name = next(iter(sheets), "") if len(sheets) < 2 else max(sheets, key=lambda n: _numbers_in(sheets[n]))
    raw = sheets.get(name, [])
    mixed = {j for row in raw for j, v in enumerate(row) if type(v) is float} & {
        j for row in raw for j, v in enumerate(row) if type(v) is bool
    }  # a truth value among numbers is none of them
    rows = [[str(v) if j in mixed and type(v) is bool else _cell(v) for j, v in enumerate(row)] for row in raw]
    others = tuple(n for n in book.sheet_names if n != name)
    return Sheet(name, rows, others, hashlib.sha256(content).hexdigest())


def _has_sign(cell: Cell) -> bool:
    """Whether a text is a number with a decimal sign or with groups of digits."""
    return isinstance(cell, str) and any(s in cell and number_in(cell, d) is not None for s in SIGNS for d in SIGNS)


def _text(cell: Cell, without_sign: bool) -> str:
    if isinstance(cell, float):
        text = repr(cell).removesuffix(".0")
        return _exponential(text) if without_sign and "." in text else text
    return re.sub(r'[\t\r\n"]+', " ", str(cell)) if cell is not None else ""


def _exponential(number: str) -> str:
    """The same number with no decimal sign: 1.25 is 125e-2."""
    digits, _, exponent = number.partition("e")
    whole, _, decimals = digits.partition(".")
    return f"{whole}{decimals}e{int(exponent or 0) - len(decimals)}"


def _numbers_in(rows: list[list]) -> int:
    return sum(type(value) in _NUMBERS for row in rows for value in row)


_NUMBERS = {float, int, datetime.datetime, datetime.date, datetime.time, datetime.timedelta}


def _cell(value) -> Cell:
    if isinstance(value, datetime.date) and value.year <= DAY_ZERO.year + 1:  # hours of a clock that passed midnight
        return _of_day(datetime.datetime(*value.timetuple()[:6], getattr(value, "microsecond", 0)) - DAY_ZERO)
    if isinstance(value, float | datetime.datetime):
        return value
    if isinstance(value, str):
        return value.strip() or None
    if isinstance(value, int):  # truth values too
        return float(value)
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, datetime.timedelta):
        return _of_day(value)
    return value.strftime("%H:%M:%S.%f") if isinstance(value, datetime.time) else None


def _of_day(duration: datetime.timedelta) -> str:
    hours, rest = divmod(duration, datetime.timedelta(hours=1))
    return f"{hours:02d}:{(datetime.datetime.min + rest).strftime('%M:%S.%f')}"


def _check_size(path: Path, content: bytes) -> None:
    """Refuse what would fill the memory, before it is unpacked: a cell far outside makes a sheet as large."""
    if not zipfile.is_zipfile(io.BytesIO(content)):
        return  # the old binary format bounds itself
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        unpacked = sum(member.file_size for member in archive.infolist())
        if unpacked > _UNPACKED:
            raise DataError(
                f"{path}: {unpacked / 1e9:.3g} GB when unpacked, a workbook for a recording has at most "
                f"{_UNPACKED / 1e9:.2g} GB. Export it as CSV or Parquet."
            )
        for member in archive.infolist():
            if re.fullmatch(r"xl/worksheets/[^/]+\.xml|content\.xml", member.filename):
                with archive.open(member) as sheet:
                    rows, columns = (_repeated if member.filename == "content.xml" else _extent)(sheet)
                if rows * columns > _CELLS:
                    raise DataError(
                        f"{path}: {member.filename} reaches to row {rows} in {columns} columns, too many cells. "
                        "Delete what lies outside the recording, or export it as CSV or Parquet."
                    )


def _repeated(sheet) -> tuple[int, int]:
    """How often a row, and how often a filled cell, is repeated at most in a sheet of LibreOffice."""
    rows, columns, before = 1, 1, b""
    while chunk := sheet.read(_CHUNK):
        text = before + chunk
        rows = max(rows, *map(int, re.findall(rb'number-rows-repeated="(\d+)"', text)), 1)
        for cell in re.findall(rb"<table:table-cell [^>]*repeated=[^>]*>", text):
            if b"office:" in cell:
                columns = max(columns, int(re.search(rb'repeated="(\d+)"', cell)[1]))
        before = text[-1024:]
    return rows, columns


def _extent(sheet) -> tuple[int, int]:
    """The last row, and at least the number of columns of a sheet, as the references in it tell them."""
    rows, widest, before = 0, b"Z", b""
    while chunk := sheet.read(_CHUNK):
        text = before + chunk
        for reference in re.findall(rb' r="(\d+|[A-Z]{2,3}(?=\d))', text):
            if reference.isdigit():
                rows = max(rows, int(reference))
            else:
                widest = max(widest, reference, key=lambda name: (len(name), name))
        before = text[-16:]
    columns = 0
    for letter in widest:
        columns = 26 * columns + letter - 64
    return rows, columns


def _calamine(path: Path):
    try:
        import python_calamine
    except ImportError:
        raise DataError(
            f"{path}: Excel files need the package python-calamine. Install the extra: pip install 'hydrotwin[xlsx]'."
        ) from None
    return python_calamine
