"""TDMS (LabVIEW, DIAdem): channels in groups; their time is a waveform's start and increment, or a channel."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from .binary_files import content_of, unreadable
from .clocks import called_time
from .columns import Table
from .headings import spelt, split_header, together
from .rasters import Axis, Signal, in_seconds, is_time_unit, table_of

_EPOCH = np.datetime64("1904-01-01", "ns")
_UNSET = np.datetime64("1904-01-02", "ns")  # a start before is none
_NANOSECONDS = 1e9 / 2**64  # in a fraction of a second as TDMS counts it


def read_tdms(path: Path) -> Table:
    """The table of a TDMS file: its channels, scaled, on the union of the times of all groups.

    A channel that holds stamps or is called time is the time of its group, else the waveform is: start, offset and
    increment. Groups that start at different instants stay apart by as much. Text cannot be used.
    """
    content = content_of(path)
    nptdms = _nptdms(path)
    try:
        file = nptdms.TdmsFile.read(io.BytesIO(content), raw_timestamps=True)
        if file.file_status.incomplete_final_segment:
            raise EOFError("its last segment is incomplete")
        groups = [[_channel(c) for c in group.channels()] for group in file.groups()]
    except Exception as error:  # the parser raises many kinds for a damaged file
        raise unreadable(path, "TDMS", error) from None
    return table_of(path, _signals(groups), hashlib.sha256(content).hexdigest())


@dataclass(frozen=True, eq=False)
class _Channel:
    group: str
    name: str
    unit: str | None
    values: np.ndarray  # stamps as a type of time
    start: np.datetime64 | None  # of its waveform
    offset: float
    increment: float | None
    over: str  # the unit of what the increment counts

    def is_time(self) -> bool:
        if self.values.dtype.kind == "M":
            return len(self.values) > 0
        named = called_time(self.name) and self.values.dtype.kind in "fiu" and len(self.values) > 1
        return named and bool((self.values[1:] > self.values[:-1]).all())


def _channel(channel) -> _Channel:
    given = channel.properties
    name, unit = split_header(channel.name)
    values = channel[:]
    if hasattr(values, "second_fractions"):
        values = _stamps(values.seconds, values.second_fractions)
    start, step = given.get("wf_start_time"), given.get("wf_increment")
    start = None if start is None else _stamps(start.seconds, start.second_fractions)
    return _Channel(
        channel.group_name,
        name,
        together(unit, str(given.get("unit_string") or given.get("NI_UnitDescription", "")).strip()),
        np.asarray(values),
        start if start is not None and start > _UNSET else None,
        float(given.get("wf_start_offset", 0.0)),
        float(step) if isinstance(step, float | int) and step > 0 else None,
        spelt(str(given.get("wf_xunit_string", "")).strip()) or "s",
    )


def _stamps(seconds, fractions):
    """Stamps to the nanosecond."""
    counts = np.asarray(seconds, np.int64) * 1_000_000_000 + np.rint(np.multiply(fractions, _NANOSECONDS)).astype(int)
    return _EPOCH + counts.astype("timedelta64[ns]")


def _signals(groups: list[list[_Channel]]) -> list[Signal]:
    """The signals of all groups; those without a time take that of the file, where it has one of their length."""
    every = [c for group in groups for c in group]
    stamps = [c.values[~np.isnat(c.values)] for c in every if c.values.dtype.kind == "M"]
    starts = [c.start for c in every if c.start is not None] + [v.min() for v in stamps if len(v)]
    first = min(starts, default=None)
    found = [s for group in groups for s in _in_group(group, first)]
    shared = {s.axis.values.tobytes(): s.axis for s in found if s.axis}
    only = next(iter(shared.values())) if len(shared) == 1 else None
    return [replace(s, axis=s.axis or only) for s in found]


def _in_group(group: list[_Channel], first: np.datetime64 | None) -> list[Signal]:
    time = next((c for c in group if c.is_time()), None)
    axis = None
    if time is not None:
        is_stamp = time.values.dtype.kind == "M"
        axis = Axis(in_seconds(time.values, first), "s") if is_stamp else Axis(time.values, time.unit)
    found = []
    for channel in group:
        path = f"{channel.group}.{channel.name}"
        if channel is time:
            continue
        signal = Signal(channel.name, channel.unit, channel.values, axis or _waveform(channel, first), path)
        if axis is None and channel.increment and not is_time_unit(channel.over):
            signal = replace(
                signal, axis=None, unusable=f"it runs over {channel.over}, not over time. Export it over time."
            )
        found.append(signal)
    return found or ([Signal(time.name, time.unit, time.values, axis, time.group)] if time is not None else [])


def _waveform(channel: _Channel, first: np.datetime64 | None) -> Axis | None:
    """Start, offset and increment as a time; the start counts from the first instant of the file."""
    if channel.increment is None or not is_time_unit(channel.over):
        return None
    begin = channel.offset
    if channel.start is not None and channel.over == "s":
        begin += float(in_seconds(channel.start[None], first)[0])
    return Axis(begin + channel.increment * np.arange(len(channel.values)), channel.over)


def _nptdms(path: Path):
    try:
        import nptdms
    except ImportError:
        raise DataError(
            f"{path}: TDMS files need the package npTDMS. Install the extra: pip install 'hydrotwin[tdms]'."
        ) from None
    return nptdms
