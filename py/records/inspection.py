"""What is in a recording before any model is asked: rates, gaps, spans, noise, sensors that stick or saturate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.units import convert, convert_difference

from .noise import channel_noise
from .record import Record
from .turning import turned_back

SEEN = 40, 4096  # stretches of a long recording, and samples of each, from which the noise of a channel is told
LEVELS = 50  # different values from which on a channel is measured, and not switched
STICKS = 20  # equal samples in a row of a channel with noise: nobody measures that
SATURATES = 10, 0.002  # equal samples in a row at the edge of the range, and the share of all of them
MOSTLY = 0.9  # of the samples at the edges: such a channel is switched
NOISY = 1.5  # of 4th to 3rd differences: 1.87 for white noise, little for what moves smoothly
UNEVEN = 0.05  # of the usual step: from here on a scatter of the steps is worth a word


@dataclass(frozen=True)
class Channel:
    """One signal of one recording, in its own unit: range, noise (one sigma), step, samples without a value."""

    name: str
    unit: str
    minimum: float
    maximum: float
    noise: float
    step: float
    missing: int
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Inspected:
    """What one recording holds. period : usual step [s]; refused : columns that cannot be used, and why."""

    name: str
    path: str
    understood: str
    samples: int
    duration: float
    period: float
    channels: tuple[Channel, ...]
    refused: dict[str, str]
    remarks: tuple[str, ...] = ()


def inspect_record(record: Record) -> Inspected:
    """The facts of a recording."""
    return Inspected(
        name=record.name,
        path=record.source or record.name,
        understood=record.understood,
        samples=len(record),
        duration=record.duration,
        period=record.period,
        channels=tuple(_channel(record, name) for name in record.names),
        refused=dict(record.refused),
        remarks=(*_clock_remarks(record), *turned_back(record)),
    )


def _clock_remarks(record: Record) -> list[str]:
    remarks = [f"{hole}." for hole in record.holes_in_time]
    steps = np.diff(record.time)
    near = steps[steps < 2 * record.period]
    scatter = float(np.std(near) / record.period) if len(near) else 0.0
    if scatter > UNEVEN:
        remarks.append(
            f"the steps of the time scatter by {100 * scatter:.0f} % of the usual one: the clock of a computer that "
            "writes when it can? A sampling rate may be truer (--rate)."
        )
    return remarks


def _channel(record: Record, name: str) -> Channel:
    values, unit = record[name], record.display_units.get(name, record.units[name])
    known = np.isfinite(values)
    if not known.any():
        return Channel(name, unit, np.nan, np.nan, np.nan, np.nan, len(values), ("no value at all.",))
    free = known & ~_at_an_edge(values)
    floor = channel_noise(*_stretches(record.time[free], values[free]))
    shown = convert(values[known], record.units[name], unit)
    one = _one(record.units[name], unit)
    noisy_at_rest = floor.white > 2 * floor.quantum
    remarks = _sensor_remarks(shown, floor.quantum * one, noisy_at_rest, unit)
    return Channel(
        name, unit, float(shown.min()), float(shown.max()), floor.sigma * one, floor.quantum * one,
        int((~known).sum()), tuple(remarks),
    )  # fmt: skip


def _one(si: str, unit: str) -> float:
    """A difference of one SI unit, in ``unit``."""
    return float(convert_difference(1.0, si, unit))


def _stretches(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evenly spread stretches of a long channel, or all of a short one."""
    count, length = SEEN
    if len(values) <= count * length:
        return time, values
    begins = np.linspace(0, len(values) - length, count).astype(int)
    at = (begins[:, None] + np.arange(length)).ravel()
    return time[at], values[at]


def _sensor_remarks(values: np.ndarray, step: float, noisy_at_rest: bool, unit: str) -> list[str]:
    """What looks like a sensor that rests, sticks or saturates: values that are equal though there is noise."""
    low, high = float(values.min()), float(values.max())
    if low == high:
        return [f"never moves (it stays at {low:.4g} {unit})."]
    begins, lengths = _runs(values)
    if len(begins) < LEVELS or not _is_noisy(values[begins], 2 * step):  # equal values are no wonder there
        return []
    remarks = []
    in_a_row, share = SATURATES
    for edge, word in ((low, "smallest"), (high, "largest")):
        at_edge = lengths[(values[begins] == edge) & (lengths >= in_a_row)].sum()
        if at_edge > share * len(values):
            remarks.append(
                f"stands at its {word} value, {edge:.4g} {unit}, in {100 * at_edge / len(values):.2g} % of the "
                "samples: a sensor or converter that saturates? Leave these samples empty, or widen its range."
            )
    inside = (values[begins] != low) & (values[begins] != high) & (lengths >= STICKS)
    if noisy_at_rest and inside.any():  # else it may rest
        longest = int(np.argmax(np.where(inside, lengths, 0)))
        remarks.append(
            f"repeats one value {lengths[longest]} times in a row (sample {begins[longest] + 1} on), though it is "
            "noisy elsewhere: a sensor, or a bus, that stuck? Leave these samples empty."
        )
    return remarks


def _at_an_edge(values: np.ndarray) -> np.ndarray:
    """Samples (n,) that stand at the smallest or largest value, many in a row: no noise shows there."""
    begins, lengths = _runs(values)
    edges = np.isin(values[begins], (np.nanmin(values), np.nanmax(values))) & (lengths >= SATURATES[0])
    found = np.repeat(edges, lengths)
    return found if found.mean() < MOSTLY else np.zeros(len(values), dtype=bool)


def _is_noisy(values: np.ndarray, more_than: float) -> bool:
    """Whether neighbours scatter at random, and by how much: 4th differences of white noise are sqrt(70) sigma.

    They are sqrt(70/20) times 3rd ones then.
    """
    third, fourth = (np.median(np.abs(np.diff(values, order))) for order in (3, 4))
    return bool(fourth > NOISY * third and 1.48 * fourth / np.sqrt(70) > more_than)


def _runs(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Begin and length of every run of equal values."""
    begins = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1])
    return begins, np.diff(np.concatenate([begins, [len(values)]]))


def together(inspected: Sequence[Inspected]) -> list[str]:
    """What differs between recordings that should be alike: columns and sampling."""
    remarks = []
    names = [set(one.refused) | {c.name for c in one.channels} for one in inspected]
    common = set.intersection(*names) if names else set()
    for one, own in zip(inspected, names, strict=True):
        if extra := sorted(own - common):
            remarks.append(f"{one.name}: only some of the recordings have {', '.join(extra)}.")
    periods = [one.period for one in inspected]
    if len(periods) > 1 and max(periods) > 1.5 * min(periods):
        remarks.append(f"the recordings are sampled differently, every {min(periods):.3g} to {max(periods):.3g} s.")
    return remarks
