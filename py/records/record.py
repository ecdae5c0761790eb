"""Record: named signals on one time axis, in SI; measured and simulated are the same type."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hydrotwin.models.language.errors import DataError, UnitError, nearest
from hydrotwin.models.language.summary_html import SmallTable, summary_html
from hydrotwin.models.language.units import si_unit

from . import resampling
from .even import even_times, is_whole
from .steps import few_lost, holes_at
from .turning import turned_back

TOLD = 5  # gaps in time that are named one by one
PERIOD_DIGITS = 13
EXACT = 1e15  # below it a number keeps every digit that a file writes


def tidy(period: float) -> float:
    """Seconds without what arithmetic leaves in the last digits; a third of a period is good for a million steps."""
    return float(f"{period:.{PERIOD_DIGITS}g}")


@dataclass(frozen=True)
class Gap:
    """A hole in the time axis: no sample between ``start`` and ``end`` [s]; ``index`` is the sample before it."""

    start: float
    end: float
    index: int

    def __str__(self) -> str:
        return f"no samples from {self.start:g} s to {self.end:g} s"


def gaps_of(time: np.ndarray) -> tuple[Gap, ...]:
    """Holes in a time axis (n,) [s], see `steps`."""
    return tuple(Gap(float(time[k]), float(time[k + 1]), int(k)) for k in holes_at(time))


@dataclass(frozen=True)
class Whole:
    """The recording that another one is a part of: its name, when it begins [s], its holes in words, and what was made
    of it, a sentence."""

    name: str
    begins: float
    holes: str
    told: str


class Signals(dict):
    """Signals by name. Whoever asks for one that cannot be used is told why; it is not taken for one that is absent."""

    def __init__(self, signals: Mapping[str, np.ndarray], refused: Mapping[str, str]):
        super().__init__(signals)
        self.refused = {name: why for name, why in refused.items() if name not in signals}

    def __contains__(self, name: object) -> bool:
        if name in self.refused:
            raise DataError(self.refused[name])
        return super().__contains__(name)

    def __missing__(self, name: str):
        raise DataError(self.refused[name]) if name in self.refused else KeyError(name)

    def get(self, name, default=None):
        return self[name] if name in self else default  # noqa: SIM401  a refused name raises


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """Named signals on one strictly increasing time axis.

    time : (n,) s, uniform or not. signals : name -> (n,), SI. units : name -> SI unit.
    display_units : the units a person reads them in, kept from the file. source, digest : the file and its SHA-256.
    refused : columns of the file that cannot be used, and why, a sentence; it is raised where one of them is asked for.
    understood : in words, how the file was read. tags : operating condition by name (load, machine, ...), in words.
    words : what columns say, as the file writes it: the name of a machine, a serial number with zeros before it. Of
    texts that change within the recording, the first two.
    part_of : the recording that this is an unbroken part of, where that was cut at holes (`unbroken`).

    Arrays are copied and read-only. Raises `DataError` for lengths that differ or a time that does not grow,
    `UnitError` for a unit that is not SI.
    """

    time: np.ndarray
    signals: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    name: str = "record"
    source: str | None = None
    digest: str | None = None
    display_units: Mapping[str, str] = field(default_factory=dict)
    refused: Mapping[str, str] = field(default_factory=dict)
    understood: str = ""
    tags: Mapping[str, str] = field(default_factory=dict)
    words: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    part_of: Whole | None = None

    def __post_init__(self):
        time = _frozen_array(self.time, f"{self.name}: time")
        signals = {n: _frozen_array(v, f"{self.name}: column '{n}'") for n, v in self.signals.items()}
        for name, values in signals.items():
            if len(values) != len(time):
                raise DataError(
                    f"{self.name}: column '{name}' has {len(values)} values, time has {len(time)}. "
                    "All columns of a record share one time axis."
                )
        if not (np.diff(time) > 0).all():  # NaN fails too
            k = int(np.argmin(np.diff(time) > 0))
            raise DataError(
                f"{self.name}: time must grow (got {time[k + 1]:.9g} s after {time[k]:.9g} s). "
                "Sort the samples and remove those with the same time."
            )
        for name in signals:
            self._check_name(name)
            self._check_unit(name)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "signals", Signals(signals, self.refused))
        object.__setattr__(self, "refused", self.signals.refused)
        object.__setattr__(self, "units", {n: self.units[n] for n in signals})
        object.__setattr__(self, "display_units", {n: u for n, u in self.display_units.items() if n in signals})

    def _check_name(self, name: str):
        if name == "time" or not name.strip() or "\n" in name:
            raise DataError(f"{self.name}: a column cannot be named {name!r}. Use a word; time has its own axis.")

    def _check_unit(self, name: str):
        if name not in self.units:
            raise UnitError(f"{self.name}: column '{name}' has no unit. Give units={{'{name}': ...}}, '1' for none.")
        unit = self.units[name]
        if si_unit(unit) != unit:
            raise UnitError(
                f"{self.name}: column '{name}' is in {unit}, a record holds SI. Convert it to {si_unit(unit)} (to_si)."
            )

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.signals:
            raise DataError(f"{self.source or self.name}: no column '{name}'. {nearest(str(name), self.signals)}")
        return self.signals[name]

    def __contains__(self, name: object) -> bool:
        return name in self.signals

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        columns = ", ".join(f"{name} [{unit}]" for name, unit in self.units.items())
        return f"Record '{self.name}': {len(self)} samples in {self.duration:g} s; {columns}"

    def _repr_html_(self) -> str:
        facts = {"samples": len(self), "duration [s]": self.duration, "period [s]": self.period, **self.tags}
        rows = [(n, self.units[n], *_extent(v), int(np.isnan(v).sum())) for n, v in self.signals.items()]
        tables = [
            SmallTable("", ("signal", "unit", "smallest", "mean", "largest", "unknown"), rows),
            SmallTable("Left out: no column of these can be used", ("column", "what it says"), self._left_out()),
        ]
        notes = [
            *(f"{hole}." for hole in self.holes),
            *turned_back(self),
            *(self._short(why) for why in self.refused.values()),
        ]
        return summary_html(f"Record '{self.name}'", self.understood, facts, tables, notes)

    def _left_out(self) -> list[tuple[str, str]]:
        """Columns that cannot be used, and what those say that say the same in every row; why is told below."""
        return [(name, "".join(said) if len(said := self.words.get(name, ())) == 1 else "") for name in self.refused]

    def _short(self, sentence: str) -> str:
        """A sentence without the path of the file that it begins with."""
        return sentence.removeprefix(f"{self.source}: ")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals, in order."""
        return tuple(self.signals)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0]) if len(self) else 0.0

    @property
    def whole(self) -> str:
        """Its name; of a part that of the whole recording."""
        return self.name if self.part_of is None else self.part_of.name

    @property
    def begins(self) -> float:
        """When the recording begins [s] that this is, or is a part of: a model's time is 0 there."""
        return float(self.time[0]) if self.part_of is None else self.part_of.begins

    @property
    def in_motion(self) -> bool:
        """Whether it begins where a recording goes on behind a hole: no machine rests there because a file begins."""
        return bool(len(self)) and self.time[0] > self.begins

    @cached_property
    def period(self) -> float:
        """Time step [s]: of the even grid where sampling is even, for printed times are rounded, else the median.

        NaN for fewer than two samples.
        """
        if len(self) < 2:
            return float("nan")
        even = self._even_times
        if even is None:
            return tidy(np.median(np.diff(self.time)))
        ticks = len(even) - 1 if is_whole(even) else np.round((even[-1] - even[0]) / np.diff(even).min())
        return tidy((even[-1] - even[0]) / ticks)

    @property
    def uniform(self) -> bool:
        """Whether every sample lies on an even grid, as near as printed times do; see `even`."""
        return self._even_times is not None and is_whole(self._even_times)

    @cached_property
    def _even_times(self) -> np.ndarray | None:
        return even_times(self.time)

    def evenly(self) -> Record:
        """The samples at the times of their even grid, where those that were printed are others."""
        even = self._even_times
        same = even is None or not np.abs(even - self.time).max(initial=0.0) > resampling.ROUNDING * self.period
        return self if same else self._at(even, self.signals)

    def on_grid(self, period: float) -> bool:
        """Whether the samples are those of an even grid of this period [s], as far as two clocks agree."""
        return len(self) < 2 or (self.uniform and abs(self.period - period) <= resampling.CLOCKS * period)

    @cached_property
    def gaps(self) -> tuple[Gap, ...]:
        """Holes in the time axis, see `steps`. They are reported, never filled."""
        return gaps_of(self.time)

    @property
    def holes_in_time(self) -> tuple[str, ...]:
        """Gaps in time, and samples that are missing beside them, in words."""
        further, lost = len(self.gaps) - TOLD, few_lost(self.time)
        told = [*map(str, self.gaps[:TOLD]), *([f"{further} further gaps"] if further > 0 else [])]
        missing = "1 sample is missing" if lost == 1 else f"{lost} samples are missing, one or few at a time"
        return (*told, *([missing] if lost else []))

    @property
    def holes(self) -> tuple[str, ...]:
        """What it lacks, in words: in time, then signals without a value in some samples."""
        lacks = {name: int(np.isnan(values).sum()) for name, values in self.signals.items()}
        told = [f"{name} has no value in {count} of {len(self)} samples" for name, count in lacks.items() if count]
        return (*self.holes_in_time, *told)

    def array(self, names: Sequence[str]) -> np.ndarray:
        """The named signals as columns, (n, k), SI."""
        return np.column_stack([self[n] for n in names]) if len(names) else np.empty((len(self), 0))

    def select(self, names: Sequence[str]) -> Record:
        """Only the named signals, in that order."""
        return dataclasses.replace(self, signals={n: self[n] for n in names})

    def window(self, start: float | None = None, end: float | None = None) -> Record:
        """The samples with ``start <= time <= end`` [s]; time keeps its origin."""
        low, high = -np.inf if start is None else start, np.inf if end is None else end
        inside = (self.time >= low) & (self.time <= high)
        if not inside.any():
            covered = f"{self.time[0]:g} s to {self.time[-1]:g} s" if len(self) else "no time at all"
            raise DataError(
                f"{self.name}: no sample in the window (got {low:g} s to {high:g} s). The record covers {covered}."
            )
        return self._at(self.time[inside], {n: v[inside] for n, v in self.signals.items()})

    def resample(
        self,
        period: float | None = None,
        *,
        times: Sequence[float] | None = None,
        hold: Sequence[str] = (),
        anti_alias: bool = False,
    ) -> Record:
        """The signals on another time axis: an even grid of ``period`` [s], or at ``times`` [s] inside the record.

        Signals named in ``hold`` keep their last value, the others are linear between samples. ``anti_alias``
        removes what the new rate cannot carry (see `resampling.low_pass`) from the linear ones before down-sampling.
        """
        for name in hold:
            self[name]
        new_time = resampling.new_time_axis(self.time, period, times, self.name)
        signals = {}
        for name, values in self.signals.items():
            if name in hold:
                signals[name] = resampling.hold(self.time, values, new_time)
                continue
            smooth = resampling.low_pass(self.time, values, new_time) if anti_alias else (self.time, values)
            signals[name] = np.interp(new_time, *smooth)
        return self._at(new_time, signals)

    def with_signals(
        self,
        signals: Mapping[str, np.ndarray],
        units: Mapping[str, str] | None = None,
        display_units: Mapping[str, str] | None = None,
    ) -> Record:
        """The record with signals (SI) added or replaced; new names need a unit in ``units``."""
        return dataclasses.replace(
            self,
            signals={**self.signals, **signals},
            units={**self.units, **(units or {})},
            display_units={**self.display_units, **(display_units or {})},
        )

    def _at(self, time: np.ndarray, signals: Mapping[str, np.ndarray]) -> Record:
        return dataclasses.replace(self, time=time, signals=signals)


def _extent(values: np.ndarray) -> tuple[float, float, float]:
    """The smallest value, the mean and the largest of those that are known; NaN without any."""
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.mean()), float(known.max())) if len(known) else (np.nan,) * 3


def _frozen_array(values, where: str) -> np.ndarray:
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise DataError(f"{where}: not numbers ({error}). Give one real number per sample.") from None
    if array.ndim != 1:
        raise DataError(f"{where}: one value per sample is needed (got shape {array.shape}). Give a 1-D array.")
    array.setflags(write=False)
    return array


def distinct(*groups: Sequence[Record]) -> list[list[Record]]:
    """The recordings of all groups with distinct names: the second ``run`` becomes ``run (2)``.

    Files of one name in several folders are different recordings.
    """
    seen: set[str] = set()

    def apart(record: Record) -> Record:
        names = (f"{record.name} ({k})" if k > 1 else record.name for k in itertools.count(1))
        name = next(name for name in names if name not in seen)
        seen.add(name)
        return record if name == record.name else dataclasses.replace(record, name=name)

    return [[apart(record) for record in group] for group in groups]
