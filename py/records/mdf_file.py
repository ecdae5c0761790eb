"""MDF 4: channels in groups, each group with its own time; what a group did not sample is unknown."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from .binary_files import content_of, unreadable
from .columns import Column, Table
from .headings import split_header
from .record import Record
from .resampling import ROUNDING

_ELEMENT = re.compile(r".*\S(\[\d+\])+")  # of a channel that is an array: its index is no unit
_ALL_INVALID = 1  # flag of a channel of which no sample is valid (ASAM MDF 4, cn_flags bit 0)
_IN_TIME = (0, 1)  # synchronisation of a master channel that is time, or does not say (cn_sync_type)


def read_mdf(path: Path) -> Table:
    """The table of an MDF 4 file: its numeric channels on the union of the times of all groups.

    A channel is unknown (NaN) where its group has no sample and where its invalidation bit is set. A channel of
    arrays is one column per element, ``name[0]``. Text and groups over an angle or a distance are left out.
    """
    mdf = _asammdf(path)
    content = content_of(path)
    try:
        with mdf.MDF(path) as file:
            signals = [s for s in file.iter_channels() if _is_usable(file, s)]
            values = [_known_values(file, s) for s in signals]
    except Exception as error:  # the parser raises many kinds for a damaged file
        raise unreadable(path, "MDF", error) from None
    if not signals:
        raise DataError(f"{path}: row 1: no numeric channel over time. Check the file in a viewer.")
    axes = [np.asarray(s.timestamps, dtype=float) for s in signals]
    for signal, axis in zip(signals, axes, strict=True):
        _check_axis(path, signal.name, axis)
    time = union_of_times(axes)
    columns = [Column("time", "s", time)]
    for signal, axis, samples in zip(signals, axes, values, strict=True):
        name, unit = (signal.name, None) if _ELEMENT.fullmatch(signal.name) else split_header(signal.name)
        on_time = np.full(len(time), np.nan)
        on_time[np.searchsorted(time, axis + ROUNDING * _step([axis]), side="right") - 1] = samples
        columns.append(Column(name, signal.unit or unit, on_time))
    digest = hashlib.sha256(content).hexdigest()
    return Table(str(path), tuple(columns), lambda k: k + 1, digest, marks_unknown=True)


def union_of_times(axes: list[np.ndarray]) -> np.ndarray:
    """All instants of several growing time axes [s]; those within a rounding error of a step are one instant."""
    different = {axis.tobytes(): axis for axis in axes}
    if len(different) == 1:
        return axes[0]
    every = np.sort(np.concatenate(list(different.values())))
    return every[np.concatenate([[True], np.diff(every) > ROUNDING * _step(axes)])[: len(every)]]


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


def _is_usable(file, signal) -> bool:
    master = file.masters_db.get(signal.group_index)
    in_time = master is None or file.groups[signal.group_index].channels[master].sync_type in _IN_TIME
    return in_time and signal.samples.ndim == 1 and signal.samples.dtype.kind in "fiub"


def _known_values(file, signal) -> np.ndarray:
    values = np.array(signal.samples, dtype=float)
    if signal.invalidation_bits is not None:
        values[np.asarray(signal.invalidation_bits, dtype=bool)] = np.nan
    if file.groups[signal.group_index].channels[signal.channel_index].flags & _ALL_INVALID:
        values[:] = np.nan
    return values


def _check_axis(path: Path, name: str, axis: np.ndarray) -> None:
    growing = np.diff(axis) > 0
    if not growing.all():
        k = int(np.argmin(growing))
        raise DataError(
            f"{path}: row {k + 2} of the group of channel '{name}', column 'time': time must grow (got "
            f"{axis[k + 1]:.9g} s after {axis[k]:.9g} s; {(~growing).sum()} such steps). Remove these samples, or "
            "export the group anew."
        )


def _step(axes: list[np.ndarray]) -> float:
    """The smallest median step of the axes [s]."""
    return min((float(np.median(np.diff(axis))) for axis in axes if len(axis) > 1), default=0.0)


def _asammdf(path: Path):
    try:
        import asammdf
    except ImportError:
        raise DataError(
            f"{path}: MDF files need the package asammdf. Install the extra: pip install 'hydrotwin[mdf]'."
        ) from None
    return asammdf
