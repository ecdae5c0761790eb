"""Parquet and Arrow: tables of typed columns; and what every reader of binary files needs."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from .clocks import TIME_OF_DAY, called_time
from .columns import Column, Table
from .headings import split_header, together
from .rasters import is_time_unit
from .record import Record


def read_parquet(path: Path) -> Table:
    """The table of a Parquet file; the unit of a column is its metadata ``unit``, or stands in its name."""
    import pyarrow.parquet

    return _read(path, "Parquet", lambda content: pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content)).read())


def read_arrow(path: Path) -> Table:
    """The table of an Arrow file, which Feather is too: a file or a stream."""
    import pyarrow

    def opened(content: bytes):
        kind = pyarrow.ipc.open_file if content.startswith(b"ARROW1") else pyarrow.ipc.open_stream
        return kind(pyarrow.BufferReader(content)).read_all()

    return _read(path, "Arrow", opened)


def _read(path: Path, kind: str, opened) -> Table:
    content = content_of(path)
    try:
        arrow = opened(content)
        arrow.validate(full=True)  # what leads outside the file ends the process where it is used
        columns = [_column(path, field, values) for field, values in zip(arrow.schema, arrow.columns, strict=True)]
        columns = _with_index(columns, arrow.schema)
    except Exception as error:  # a damaged file fails in many ways
        raise unreadable(path, kind, error) from None
    index = re.compile(r"__index_level_\d+__").fullmatch
    numbers = any(index(f.name) and not _is_temporal(f.type) for f in arrow.schema)
    said = "its index as the time in s (or --unit time=ms)" if numbers and columns[-1].name == "time" else ""
    times = [f for f in arrow.schema if called_time(split_header(f.name)[0]) or index(f.name)]
    said = TIME_OF_DAY if any(_is_of_day(f.type) for f in times) else said
    return Table(str(path), tuple(columns), lambda k: k + 1, hashlib.sha256(content).hexdigest(), understood=said)


def _column(path: Path, field, values) -> Column:
    """A column as numbers; what has a type of time is in seconds, a date or stamp counted from the first one.

    A column of anything else, text or lists, says that it cannot be used.
    """
    from pyarrow import types

    name, unit = split_header(field.name)
    unit = together(unit, (field.metadata or {}).get(b"unit", b"").decode(errors="replace"))
    if types.is_dictionary(values.type):
        values = values.cast(values.type.value_type)
    kind = values.type
    if types.is_temporal(kind):
        wrong = f"named in [{unit}]" if unit not in (None, "s") else "of no fixed length"
        if types.is_interval(kind) or unit not in (None, "s"):
            reason = (
                f"its type is {kind}, {wrong}. A type of time has its own unit: name it '{name} [s]', or store numbers"
            )
            return _unusable(path, Column(name, unit, np.full(len(values), np.nan)), reason)
        return Column(name, "s", _seconds(values))
    if types.is_integer(kind) and (called_time(name) or (unit and is_time_unit(unit))):
        return Column(name, unit, _counted(values))
    if types.is_decimal(kind):
        values = values.cast("float64")
    elif not (types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_null(kind)):
        first = next((v for v in values.slice(0, 100).to_pylist() if v is not None), None)
        reason = f"it holds no numbers but {kind} (got {str(first)[:40]!r}). Store numbers, or name another column"
        texts = [v or "" for v in values.to_pylist()] if isinstance(first, str) else None
        return _unusable(path, Column(name, unit, np.full(len(values), np.nan), texts=texts), reason)
    return Column(name, unit, values.cast("float64", safe=False).to_numpy())


def _unusable(path: Path, column: Column, reason: str) -> Column:
    return replace(column, unusable=f"{path}: column '{column.name}': {reason}.")


def _seconds(values) -> np.ndarray:
    """Durations and times of day in seconds; dates and stamps in seconds since the first: all exact to the last bit."""
    import pyarrow

    kind = values.type
    stamped = pyarrow.types.is_timestamp(kind) or pyarrow.types.is_date(kind)
    if pyarrow.types.is_date(kind):
        kind = pyarrow.timestamp("s" if pyarrow.types.is_date32(kind) else "ms")
        values = values.cast(kind)
    counts = values.cast(f"int{kind.bit_width}").cast("int64")
    per_second = 10 ** (3 * ("s", "ms", "us", "ns").index(kind.unit))
    return _counted(counts, per_second, 0 if stamped else 2**63)


def _counted(counts, per_second: int = 1, largest: int = 2**53) -> np.ndarray:
    """Whole numbers over ``per_second`` as floats, less the first where one exceeds ``largest``; NaN for none."""
    absent = counts.is_null().to_numpy()
    whole = counts.fill_null(counts.drop_null()[0] if len(counts.drop_null()) else 0).to_numpy()
    if len(whole) and max(abs(int(whole.max())), abs(int(whole.min()))) > largest:
        whole = (whole - whole[0]).astype(np.int64)
    seconds, rest = np.divmod(whole, per_second)
    return np.where(absent, np.nan, seconds + rest / per_second)


def _with_index(columns: list[Column], schema) -> list[Column]:
    """The columns, with the time named where the table tells it; an unnamed index that is no time is no signal.

    An index of a data frame is the time where it has a type of time, or no name and grows in fractions; so is the only
    column of stamps. A column that is called so is the time before all of them.
    """
    index = [name for name in (schema.pandas_metadata or {}).get("index_columns", []) if isinstance(name, str)]
    stamps = [field.name for field in schema if _is_stamp(field.type)]
    named = any(called_time(c.name) for c in columns)
    found = []
    for field, column in zip(schema, columns, strict=True):
        unnamed = field.name in index and re.fullmatch(r"__index_level_\d+__", column.name)
        is_time = field.name in index and (_is_temporal(field.type) or (unnamed and _in_fractions(column.values)))
        if not named and ((is_time and len(index) == 1) or (not index and stamps == [field.name])):
            column = replace(column, name="time", unit=column.unit or "s")
        elif unnamed:
            continue
        found.append(column)
    return found


def _in_fractions(values: np.ndarray) -> bool:
    """Does it grow in steps that are no whole numbers, as seconds do and row numbers do not?"""
    return len(values) > 1 and bool((np.diff(values) > 0).all() and (values != np.round(values)).any())


def _is_of_day(kind) -> bool:
    from pyarrow import types

    return types.is_time(kind)


def _is_stamp(kind) -> bool:
    from pyarrow import types

    return types.is_timestamp(kind) or types.is_date(kind)


def _is_temporal(kind) -> bool:
    from pyarrow import types

    return types.is_temporal(kind)


def write_parquet(headers: list[str], columns: list[np.ndarray], record: Record, path: Path) -> None:
    """Write float64 columns under their plain names, the unit in each field's metadata."""
    import pyarrow
    import pyarrow.parquet

    split = [split_header(h) for h in headers]
    fields = [pyarrow.field(name, pyarrow.float64(), metadata={"unit": unit}) for name, unit in split]
    table = pyarrow.Table.from_arrays([pyarrow.array(c) for c in columns], schema=pyarrow.schema(fields))
    pyarrow.parquet.write_table(table, str(path))


def unreadable(path: Path, kind: str, error: Exception) -> DataError:
    """The error for a file that its parser refuses, usually a truncated one."""
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:120].rstrip(".")
    return DataError(
        f"{path}: not a whole {kind} file ({reason}). "
        "It may have been cut off while it was written or copied: copy or export it again."
    )


def content_of(path: Path) -> bytes:
    """The bytes of a file that is not empty."""
    content = path.read_bytes()
    if not content:
        raise DataError(f"{path}: row 1: the file is empty. Copy or export it again.")
    return content
