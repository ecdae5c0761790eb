"""Parquet: a table of typed columns; and what every reader of binary files needs."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from .columns import Column, Table
from .headings import split_header
from .record import Record


def read_parquet(path: Path) -> Table:
    """The table of a Parquet file; the unit of a column is its metadata ``unit``, or stands in its name."""
    import pyarrow
    import pyarrow.parquet

    content = content_of(path)
    try:
        arrow = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content)).read()
    except (pyarrow.ArrowException, OSError) as error:
        raise unreadable(path, "Parquet", error) from None
    columns = [_column(path, field, values) for field, values in zip(arrow.schema, arrow.columns, strict=True)]
    columns = _with_index(columns, arrow.schema)
    return Table(str(path), tuple(columns), lambda k: k + 1, hashlib.sha256(content).hexdigest())


def _column(path: Path, field, values) -> Column:
    """A column as numbers; what has a type of time is in seconds, a date or stamp counted from the first one."""
    from pyarrow import types

    name, unit = split_header(field.name)
    unit = (field.metadata or {}).get(b"unit", b"").decode() or unit
    if types.is_dictionary(field.type):
        values = values.cast(field.type.value_type)
    if not types.is_temporal(values.type):
        exact = types.is_integer(values.type) and name == "time"
        return Column(name, unit, _counted(values) if exact else as_numbers(values.to_numpy(), path, name))
    if types.is_interval(values.type) or unit not in (None, "s"):
        wrong = f"named in [{unit}]" if unit not in (None, "s") else "of no fixed length"
        raise DataError(
            f"{path}: row 1, column '{name}': its type is {values.type}, {wrong}. A type of time has its own unit: "
            f"name it '{name} [s]', or store numbers."
        )
    return Column(name, "s", _seconds(values))


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
    """The columns with the index of a data frame as time where it has a type of time; an unnamed one is no signal."""
    index = [name for name in (schema.pandas_metadata or {}).get("index_columns", []) if isinstance(name, str)]
    named = any(c.name == "time" for c in columns)
    found = []
    for field, column in zip(schema, columns, strict=True):
        if field.name in index and not named and len(index) == 1 and _is_temporal(field.type):
            column = replace(column, name="time")
        if not (field.name in index and re.fullmatch(r"__index_level_\d+__", column.name)):
            found.append(column)
    return found


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


def as_numbers(values: np.ndarray, path: Path, name: str) -> np.ndarray:
    """A column as floats; `DataError` with the row of the first value that is not a real number."""
    values = np.asarray(values)
    if values.dtype.kind in "fiub":
        return values.astype(float)
    for k, value in enumerate(values):
        try:
            if isinstance(value, str | bytes) or np.iscomplexobj(value):
                raise ValueError
            float("nan" if value is None else value)
        except (TypeError, ValueError):
            raise DataError(
                f"{path}: row {k + 1}, column '{name}': not a number (got {value!r}). "
                "Store real numbers; leave other columns out of the file."
            ) from None
    return np.array([float("nan" if v is None else v) for v in values])


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
