"""Parquet and MDF4: tables of typed columns."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from .record import Record
from .table import Column, Table, split_header


def read_parquet(path: Path) -> Table:
    """The table of a Parquet file; the unit of a column is its metadata ``unit``, or stands in its name."""
    import pyarrow
    import pyarrow.parquet

    content = _content(path)
    try:
        arrow = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content)).read()
    except (pyarrow.ArrowException, OSError) as error:
        raise unreadable(path, "Parquet", error) from None
    columns = []
    for field, values in zip(arrow.schema, arrow.columns, strict=True):
        name, unit = split_header(field.name)
        unit = (field.metadata or {}).get(b"unit", b"").decode() or unit
        if pyarrow.types.is_dictionary(field.type):
            values = values.cast(field.type.value_type)
        columns.append(Column(name, unit, as_numbers(values.to_numpy(), path, name)))
    return Table(str(path), tuple(columns), lambda k: k + 1, hashlib.sha256(content).hexdigest())


def write_parquet(headers: list[str], columns: list[np.ndarray], record: Record, path: Path) -> None:
    """Write float64 columns under their plain names, the unit in each field's metadata."""
    import pyarrow
    import pyarrow.parquet

    split = [split_header(h) for h in headers]
    fields = [pyarrow.field(name, pyarrow.float64(), metadata={"unit": unit}) for name, unit in split]
    table = pyarrow.Table.from_arrays([pyarrow.array(c) for c in columns], schema=pyarrow.schema(fields))
    pyarrow.parquet.write_table(table, str(path))


def read_mdf(path: Path) -> Table:
    """The table of an MDF 4 file: its numeric channels on the time axis of the channel with most samples.

    Channels of slower rasters keep their last value (a bus signal holds until the next message).
    """
    mdf = _asammdf(path)
    content = _content(path)
    try:
        with mdf.MDF(path) as file:
            frame_signals = [s for s in file.iter_channels() if s.samples.ndim == 1 and s.samples.dtype.kind in "fiub"]
    except Exception as error:  # the parser raises many kinds for a damaged file
        raise unreadable(path, "MDF", error) from None
    if not frame_signals:
        raise DataError(f"{path}: row 1: no numeric channel. Check the file in a viewer.")
    time = max((s.timestamps for s in frame_signals), key=len)
    columns = [Column("time", "s", np.asarray(time, dtype=float))]
    for signal in frame_signals:
        name, unit = split_header(signal.name)
        at = np.clip(np.searchsorted(signal.timestamps, time, side="right") - 1, 0, None)
        same = len(signal.timestamps) == len(time) and np.array_equal(signal.timestamps, time)
        columns.append(
            Column(name, signal.unit or unit, np.asarray(signal.samples if same else signal.samples[at], float))
        )
    return Table(str(path), tuple(columns), lambda k: k + 1, hashlib.sha256(content).hexdigest())


def write_mdf(headers: list[str], columns: list[np.ndarray], record: Record, path: Path) -> None:
    """Write MDF 4.10: one channel group, unit per channel, time in s."""
    mdf = _asammdf(path)
    names = [split_header(h) for h in headers[1:]]
    signals = [
        mdf.Signal(samples=c, timestamps=columns[0], name=name, unit=unit)
        for c, (name, unit) in zip(columns[1:], names, strict=True)
    ]
    with mdf.MDF(version="4.10") as file:
        file.append(signals, comment=record.name)
        file.save(path, overwrite=True)


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


def _content(path: Path) -> bytes:
    content = path.read_bytes()
    if not content:
        raise DataError(f"{path}: row 1: the file is empty. Copy or export it again.")
    return content


def _asammdf(path: Path):
    try:
        import asammdf
    except ImportError:
        raise DataError(
            f"{path}: MDF files need the package asammdf. Install the extra: pip install 'hydrotwin[mdf]'."
        ) from None
    return asammdf
