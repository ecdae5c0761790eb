"""MDF 3 and 4: channels in groups, each group with its own time; what a group did not sample is unknown."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from .binary_files import content_of, unreadable
from .columns import Table
from .headings import split_header
from .rasters import Axis, Signal, table_of
from .record import Record

_ELEMENT = re.compile(r".*\S(\[\d+\])+")  # of a channel that is an array: its index is no unit
_ALL_INVALID = 1  # flag of a channel of which no sample is valid (ASAM MDF 4, cn_flags bit 0)
_IN_TIME = (0, 1)  # synchronisation of a master channel that is time, or does not say (cn_sync_type)


def read_mdf(path: Path) -> Table:
    """The table of an MDF 3 or 4 file: its channels on the union of the times of all groups.

    A channel is unknown (NaN) where its group has no sample and where its invalidation bit is set. A channel of
    arrays is one column per element, ``name[0]``. Text and what is sampled over an angle cannot be used.
    """
    mdf = _asammdf(path)
    content = content_of(path)
    try:
        with mdf.MDF(path) as file:
            signals = _signals_of(file)
    except Exception as error:  # the parser raises many kinds for a damaged file
        raise unreadable(path, "MDF", error) from None
    return replace(table_of(path, signals, hashlib.sha256(content).hexdigest()), marks_unknown=True)


def is_mdf(path: Path) -> bool:
    """Whether a file begins as MDF does, whatever it is called; ``UnFinMF`` is one that was not closed."""
    with open(path, "rb") as file:
        return file.read(8) in (b"MDF     ", b"UnFinMF ")


def _signals_of(file) -> list[Signal]:
    found, axes = [], {}
    for channel in file.iter_channels():
        if channel.samples.dtype.names:
            continue  # an array or a structure as a whole: its elements are channels too
        group = file.groups[channel.group_index]
        name, unit = (channel.name, None) if _ELEMENT.fullmatch(channel.name) else split_header(channel.name)
        axis = axes.setdefault(channel.group_index, Axis(np.asarray(channel.timestamps, dtype=float)))
        signal = Signal(name, channel.unit or unit, channel.samples, axis, f"group {channel.group_index + 1}.{name}")
        master = file.masters_db.get(channel.group_index)
        if master is not None and getattr(group.channels[master], "sync_type", 0) not in _IN_TIME:
            signal = replace(signal, axis=None, unusable="it is not sampled over time. Export it over time.")
        elif channel.samples.dtype.kind not in "fiub":
            signal = replace(signal, values=np.array(channel.samples.tolist(), object))
        else:
            signal = replace(signal, values=_known_values(channel, group))
        if len(axis.values) or signal.unusable:
            found.append(signal)
    return found


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


def _known_values(channel, group) -> np.ndarray:
    values = np.array(channel.samples, dtype=float)
    if channel.invalidation_bits is not None:
        values[np.asarray(channel.invalidation_bits, dtype=bool)] = np.nan
    if getattr(group.channels[channel.channel_index], "flags", 0) & _ALL_INVALID:
        values[:] = np.nan
    return values


def _asammdf(path: Path):
    try:
        import asammdf
    except ImportError:
        raise DataError(
            f"{path}: MDF files need the package asammdf. Install the extra: pip install 'hydrotwin[mdf]'."
        ) from None
    return asammdf
