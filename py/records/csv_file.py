"""CSV: a header of ``name [unit]``, first column ``time [s]``; comma, semicolon (with decimal comma) or tab."""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from .decimal_sign import MINUS, exact_from_first, found_decimal, number_in, other_sign, without_groups
from .record import Record
from .table import UNSEEN, Column, Table, rounding_of, split_header

_LARGE = 2_000_000  # characters: from here on pyarrow is worth its import
_BETWEEN = "\x1f"  # delimiter in place of the comma where quoted cells hold commas: no number contains it


def read_csv(path: Path, decimal: str | None = None) -> Table:
    """The table of a CSV file; ``decimal`` states its decimal sign, else a line ``# decimal=,`` or its numbers do.

    Raises `DataError` for text in numbers, ragged rows, a truncated or empty file, a doubtful decimal sign.
    """
    content = path.read_bytes()
    text = _decode(content, path)
    skip, header, delimiter = _header(text, path)
    *comments, body = text.split("\n", skip)
    body = body.partition("\n")[2]
    body = body if body.isascii() else body.translate(MINUS)
    stated = re.search(r"^#\s*decimal\s*=\s*([.,])\s*$", "\n".join(comments), re.MULTILINE)
    decimal = stated[1] if stated and decimal is None else decimal
    if delimiter == "," and '"' in body and re.search(r'"[^",\n]*\d,\d', body):
        rows = csv.reader(body.split("\n"), delimiter=delimiter, skipinitialspace=True)
        body, delimiter = "\n".join(_BETWEEN.join(cells) for cells in rows), _BETWEEN
    if decimal is None:
        decimal = "." if delimiter == "," else found_decimal(body, delimiter, path, skip + 2)
    values, row = _numbers(body, header, delimiter, decimal, skip + 2, path)
    names = [split_header(h)[0] for h in header]
    if "time" in names and len(values) > 1 and rounding_of(values[:, names.index("time")]) > UNSEEN:
        cells = (row[names.index("time")] for _, row in _rows(body, delimiter))
        values[:, names.index("time")] = exact_from_first(cells, decimal)
    columns = tuple(Column(*split_header(h), values[:, k]) for k, h in enumerate(header))
    return Table(str(path), columns, row, hashlib.sha256(content).hexdigest(), f"row {skip + 1}")


def write_csv(headers: list[str], columns: list[np.ndarray], record: Record, path: Path) -> None:
    """Write columns with the shortest digits that read back to the same number."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(headers)
        for start in range(0, len(columns[0]), 4096):
            rows = zip(*(c[start : start + 4096].tolist() for c in columns), strict=True)
            file.write("".join(",".join(map(repr, row)) + "\n" for row in rows))


def _decode(content: bytes, path: Path) -> str:
    if not content or content.isspace():
        raise DataError(f"{path}: row 1: the file is empty. It needs a header 'time [s],name [unit],...' and rows.")
    if content[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in content[:4096]:
        raise DataError(f"{path}: row 1: not a text file in UTF-8 (it has zero bytes). Export it again as CSV UTF-8.")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _lines(text: str) -> Iterator[str]:
    """Lines one by one, without a copy of the whole text."""
    start = 0
    while start < len(text):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        yield text[start:end]
        start = end + 1


def _header(text: str, path: Path) -> tuple[int, list[str], str]:
    """Lines before the header (blank or starting with #), the header's cells, the delimiter."""
    lines = enumerate(_lines(text))
    skip, line = next(((k, line) for k, line in lines if line.strip() and not line.startswith("#")), (0, ""))
    if not line:
        raise DataError(f"{path}: row 1: there are only comments. Write a header 'time [s],name [unit],...'.")
    outside_units = "".join(part.rpartition("]")[2] if "]" in part else part for part in line.split("["))
    delimiter = max(",;\t", key=outside_units.count)
    cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    if all(number_in(cell, ".") is not None for cell in cells):
        raise DataError(
            f"{path}: row {skip + 1}, column 1: numbers where the header belongs (got '{line.strip()[:40]}'). "
            "Write 'time [s],name [unit],...' above them."
        )
    return skip, cells, delimiter


def _numbers(
    body: str, header: list[str], delimiter: str, decimal: str, first_row: int, path: Path
) -> tuple[np.ndarray, Callable[[int], int]]:
    if not body or body.isspace():
        return np.empty((0, len(header))), lambda k: first_row + k
    plain = body if (delimiter, decimal) == (",", ".") else without_groups(body, decimal)
    try:
        values = _quick_numbers(plain, delimiter) if plain is not None else None
        if values is not None and values.shape[1] == len(header):
            return values, _row_finder(body, first_row)
    except (ValueError, UnicodeError):
        pass  # the careful reader below finds the cell, or takes empty ones as missing
    return _read_carefully(body, header, delimiter, decimal, first_row, path)


def _quick_numbers(body: str, delimiter: str) -> np.ndarray:
    """A block of numbers without a flaw, (rows, columns); ValueError for any other. Large ones go through pyarrow."""
    if len(body) < _LARGE:
        return np.loadtxt(io.StringIO(body), delimiter=delimiter, comments=None, ndmin=2)
    import pyarrow
    from pyarrow import csv as arrow_csv

    body = body.lstrip("\n")
    names = [str(k) for k in range(body[: body.find("\n")].count(delimiter) + 1)]
    table = arrow_csv.read_csv(
        pyarrow.BufferReader(body.encode()),
        arrow_csv.ReadOptions(column_names=names),
        arrow_csv.ParseOptions(delimiter=delimiter),
        arrow_csv.ConvertOptions(column_types=dict.fromkeys(names, pyarrow.float64())),
    )
    return np.column_stack([column.to_numpy() for column in table.columns])


def _row_finder(body: str, first_row: int) -> Callable[[int], int]:
    """Sample index -> line number; blank lines count in the file and hold no sample."""

    def row(k: int) -> int:
        filled = [number for number, line in enumerate(body.split("\n"), start=first_row) if line.strip()]
        return filled[k] if k < len(filled) else filled[-1] + 1

    return row


def _read_carefully(
    body: str, header: list[str], delimiter: str, decimal: str, first_row: int, path: Path
) -> tuple[np.ndarray, Callable[[int], int]]:
    """Cell by cell: raises with row and column of the first cell that is wrong; missing ones become NaN."""
    values, rows = [], []
    cut_off = body.count("\n") if body.rpartition("\n")[2].strip() else None  # a last line without its end
    for k, cells in _rows(body, delimiter):
        if len(cells) != len(header):
            _fail_ragged(path, first_row + k, cells, header, cut_off=k == cut_off)
        numbers = [number_in(cell, decimal) for cell in cells]
        if None in numbers:
            column = numbers.index(None)
            other = other_sign(decimal)
            one = cells[column].count(other) == 1
            state = f" Or state the other sign above the header: '# decimal={other}'." if one else ""
            raise DataError(
                f"{path}: row {first_row + k}, column '{split_header(header[column])[0]}': not a number "
                f"(got '{cells[column]}'). Write a decimal {'point' if decimal == '.' else 'comma'}; "
                f"'{other}' may only part groups of three digits; no unit in the cell.{state}"
            )
        values.append(numbers)
        rows.append(first_row + k)
    return np.array(values), lambda k: rows[k] if k < len(rows) else rows[-1] + 1


def _rows(body: str, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of every line that is not blank."""
    for k, line in enumerate(body.split("\n")):
        if line.strip():
            yield k, next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))


def _fail_ragged(path: Path, row: int, cells: list[str], header: list[str], cut_off: bool) -> None:
    counted = f"(got {len(cells)} values, the header names {len(header)})"
    if len(cells) > len(header):
        raise DataError(
            f"{path}: row {row}, column {len(header) + 1}: a value without a column {counted}. "
            "Remove it, or look for a decimal comma in this row."
        )
    column = split_header(header[len(cells)])[0]
    if cut_off:
        raise DataError(
            f"{path}: row {row}, column '{column}': the file ends in the middle of this row {counted}. "
            "It was cut off while it was written or copied: copy it again, or delete this row."
        )
    raise DataError(f"{path}: row {row}, column '{column}': the row is too short {counted}. Repair or delete this row.")
