"""Excel and LibreOffice workbooks: the sheet with most numbers, its cells as rows."""

from __future__ import annotations

import datetime
import hashlib
import io
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError, UnitError
from hydrotwin.models.language.units import parse_unit

from .binary_files import content_of, not_written, unreadable
from .table import Column, Table, split_header

Cell = str | float | datetime.datetime | None

_CELLS = 30_000_000  # of one sheet, from A1 to the last one; all are held in memory
_UNPACKED = 2 << 30  # bytes; 30 million cells need half of it
_CHUNK = 1 << 20  # bytes

write_xlsx = not_written("Excel")


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


def rows_of_sheet(path: Path) -> list[list[Cell]]:
    """The rows of the sheet with most numbers, from row 1 and column A on: text, number, date-time, or None.

    A time of day and a duration are text as a sheet shows them, ``03:04:05.250000``; a truth value is 0 or 1.
    """
    return read_sheet(path).rows


def read_sheet(path: Path) -> Sheet:
    """The sheet with most numbers; `DataError` for a damaged, locked or absurdly large workbook."""
    content = content_of(path)
    calamine = _calamine(path)
    try:
        _check_size(path, content)
        book = calamine.CalamineWorkbook.from_filelike(io.BytesIO(content))
        sheets = {n: book.get_sheet_by_name(n).to_python(skip_empty_area=False) for n in book.sheet_names}
    except calamine.PasswordError:
        raise DataError(f"{path}: locked by a password. Save it without one.") from None
    except (calamine.CalamineError, zipfile.BadZipFile, OSError, EOFError, ValueError) as error:
        raise unreadable(path, "Excel", error) from None
    name = max(sheets, key=lambda n: _numbers_in(sheets[n]), default="") if len(sheets) > 1 else next(iter(sheets), "")
    rows = [[_cell(v) for v in row] for row in sheets.get(name, [])]
    return Sheet(name, rows, tuple(n for n in sheets if n != name), hashlib.sha256(content).hexdigest())


def _numbers_in(rows: list[list]) -> int:
    return sum(type(value) in _NUMBERS for row in rows for value in row)


_NUMBERS = {float, int, datetime.datetime, datetime.date, datetime.time, datetime.timedelta}
_CLOCK = re.compile(r"(\d+):(\d\d):(\d\d(?:\.\d+)?)")


def _cell(value) -> Cell:
    if isinstance(value, float | datetime.datetime):
        return value
    if isinstance(value, str):
        return value.strip() or None
    if isinstance(value, int):  # truth values too
        return float(value)
    if isinstance(value, datetime.date):
        return datetime.datetime.combine(value, datetime.time())
    if isinstance(value, datetime.timedelta):
        hours, rest = divmod(value, datetime.timedelta(hours=1))
        return f"{hours:02d}:{(datetime.datetime.min + rest).strftime('%M:%S.%f')}"
    return value.strftime("%H:%M:%S.%f") if isinstance(value, datetime.time) else None


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
            if re.fullmatch(r"xl/worksheets/[^/]+\.xml", member.filename):
                with archive.open(member) as sheet:
                    rows, columns = _extent(sheet)
                if rows * columns > _CELLS:
                    raise DataError(
                        f"{path}: {member.filename} reaches to row {rows} in {columns} columns, too many cells. "
                        "Delete what lies outside the recording, or export it as CSV or Parquet."
                    )


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


def read_xlsx(path: Path) -> Table:
    """The table of a workbook: names above the first row of numbers, units below them or in brackets."""
    sheet = read_sheet(path)
    filled = [(k, row) for k, row in enumerate(sheet.rows, start=1) if any(v is not None for v in row)]
    counts = [sum(not isinstance(v, str | None) for v in row) for _, row in filled]
    usual = max(set(counts) - {0}, key=counts.count, default=0)
    at = next((k for k, n in enumerate(counts) if n and 2 * n >= usual), 0)
    if not at:
        raise DataError(
            f"{path}: {sheet.title} has no row of names above its numbers. Write 'time [s]', 'name [unit]'."
        )
    names, units = filled[at - 1][1], None
    if at > 1 and _are_units(names):
        names, units = filled[at - 2][1], names
    columns = [
        _column(path, [(k, row[c]) for k, row in filled[at:]], *_header(name, units[c] if units else None))
        for c, name in enumerate(names)
        if isinstance(name, str)
    ]
    numbers = [k for k, _ in filled[at:]]
    where = f"{sheet.title}, row {filled[at - 1 - (units is not None)][0]}"
    numbers.append(numbers[-1] + 1)
    return Table(str(path), tuple(columns), numbers.__getitem__, sheet.digest, where)


def _header(name: str, unit: Cell) -> tuple[str, str | None]:
    short, own = split_header(name)
    return short, own or (unit.strip("[]() ") if isinstance(unit, str) else None) or None


def _are_units(row: list[Cell]) -> bool:
    """Is every text of a row a unit, and one of them not a plain number's?"""
    texts = [v.strip("[]() ") for v in row if isinstance(v, str)]
    try:
        return bool(texts) and all(parse_unit(t) is not None for t in texts if t not in ("", "-"))
    except UnitError:
        return False


def _column(path: Path, cells: list[tuple[int, Cell]], name: str, unit: str | None) -> Column:
    """A column of numbers, of stamps as seconds from the first, or of times of day as seconds."""
    first = next((v for _, v in cells if isinstance(v, datetime.datetime)), None)
    values = np.full(len(cells), np.nan)
    for k, (row, cell) in enumerate(cells):
        clock = _CLOCK.fullmatch(cell) if isinstance(cell, str) else None
        if clock:
            values[k] = 3600 * int(clock[1]) + 60 * int(clock[2]) + float(clock[3])
        elif isinstance(cell, str):
            why = f"row {row}, column '{name}': not a number (got '{cell[:40]}'). Write a number, or empty the cell."
            return Column(name, unit, np.full(len(cells), np.nan), f"{path}: {why}")
        elif isinstance(cell, datetime.datetime):
            values[k] = (cell - first) / datetime.timedelta(seconds=1)
        elif cell is not None:
            values[k] = cell
        unit = unit or ("s" if clock or isinstance(cell, datetime.datetime) else None)
    return Column(name, unit, values)
