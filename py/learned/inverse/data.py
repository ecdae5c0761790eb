"""The forward characteristic of a machine: the steady answer to held commands, from recordings or from a model.

r(u) = lim  y(t)   or   lim  dy/dt     for u held
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.provenance import made_from_rows
from hydrotwin.models.language.units import si_unit
from hydrotwin.records import Record, all_unbroken
from hydrotwin.simulation import lower
from hydrotwin.simulation.block import Block

from ..integrating import integration
from ..training_data import as_signals, level_and_error, named, slope_and_error, usable
from .falling import Fall, fall_of_points, refuse_what_falls
from .moving import moving_curve

POSITIONS = ("m", "rad")  # of a Block or Model: outputs in these units move at a rate, others settle at a value
FIRST_LEVELS, ROUNDS, LEVELS_PER_ROUND = 65, 3, 48
LEAST_POINTS = 12
COVERED = 0.8  # of the range of the command by steady stretches, or every sample counts
UNSETTLED = {True: 0.1, False: 0.02}  # of the span of rates, of values: what the halves of a window may differ by


@dataclass(frozen=True)
class Characteristic:
    """Steady rates (n,) at commands (n,) in ascending order, both SI.

    input, rate : what is commanded, and what comes of it. sigma : standard deviation of one of the rates.
    period : s, of the block that is learnt from it. source : where it comes from, for the provenance.
    fall : where the machine falls, of rates that were made monotone; see `fell`.
    """

    input: Signal
    rate: Signal
    commands: np.ndarray
    rates: np.ndarray
    sigma: float = 0.0
    period: float = 0.01
    source: Mapping = field(default_factory=dict)
    fall: Fall | None = None

    def __post_init__(self):
        u, r = np.asarray(self.commands, float), np.asarray(self.rates, float)
        if u.ndim != 1 or u.shape != r.shape or not (np.isfinite(u).all() and np.isfinite(r).all()):
            raise DataError(
                f"characteristic of {self.rate.name}: commands and rates must be finite and of one length "
                f"(got shapes {u.shape} and {r.shape}). Leave out what is not known."
            )
        if len(u) < LEAST_POINTS:
            raise DataError(
                f"characteristic of {self.rate.name}: too few points (got {len(u)}). At least {LEAST_POINTS} are "
                "needed. Hold more commands, longer than settle and window together, or move through the whole range."
            )
        if np.ptp(u) <= 0 or np.ptp(r) <= 0:
            still = self.input.name if np.ptp(u) <= 0 else self.rate.name
            raise DataError(
                f"characteristic of {self.rate.name}: '{still}' never changes (got {(u if np.ptp(u) <= 0 else r)[0]:g} "
                "throughout). What does not answer has no inverse. Give recordings in which it moves."
            )
        order = np.lexsort((r, u))
        object.__setattr__(self, "commands", u[order])
        object.__setattr__(self, "rates", r[order])

    @property
    def fell(self) -> Fall | None:
        """Where the rates fall as the command rises, beyond their scatter."""
        return self.fall or fall_of_points(self.commands, self.rates, self.sigma)

    @property
    def reach(self) -> tuple[float, float]:
        """Least and largest rate seen."""
        return float(self.rates.min()), float(self.rates.max())


def characteristic(
    source,
    input: Signal | str | None = None,
    output: Signal | str | None = None,
    *,
    rate: bool | None = None,
    settle: float = 0.5,
    window: float | None = None,
    delay: float | None = None,
    steady: float = 0.03,
    moving: bool | None = None,
    limits: tuple[float, float] | None = None,
    others: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    period: float | None = None,
) -> Characteristic:
    """The steady answer of ``output`` to ``input``.

    From recordings: every stretch of ``settle + window`` over which the command stays within ``steady`` of its range
    gives one point, staircases and slow ramps alike. A ramp's answer is late; up and down together cancel that, and
    ``delay`` takes it out. Where the command does not rest long enough, every sample counts instead (`moving_curve`).
    From a Block or Model: commands are held from rest, most of them where the answer bends.

    Args:
        source: a Record, several, a Block, a Model, or a Characteristic (which is answered as it is).
        rate: whether the output's rate of change is meant; None: where it integrates the input, as the recordings
            tell; of a Block or Model, yes for outputs in m or rad.
        settle, window: s before a point is taken and s it is averaged over (None: 0.5 s or 10 samples).
        delay: s of dead time by which a recorded answer lags its command; None: 0 for steady stretches, found from the
            recordings where every sample counts.
        moving: whether every sample counts; None: when the steady stretches are fewer than 12 or cover less than 0.8 of
            the range of the command.
        limits: least and largest command held (Block, Model); None: its training domain, else +- its nominal value.
        others: values of the other inputs, 0 by default; start: of states or outputs (Block, Model).
        period: s, of the block to be learnt and of a Model's samples; None: the source's own (a Model's: 10 ms).

    Raises:
        DataError: too few steady stretches, NaN, gaps, an answer that does not settle. DeclarationError: options.
    """
    if isinstance(source, Characteristic):
        return source
    if input is None or output is None:
        raise DeclarationError(
            f"characteristic: no {'input' if input is None else 'output'} is named (got None). "
            "Name the command and what it moves, as 'current', 'position'."
        )
    positive = {"settle": settle, "window": window, "steady": steady, "period": period}
    for option, value in positive.items():
        if value is not None and not (math.isfinite(value) and (value > 0 or (option == "settle" and value == 0))):
            raise DeclarationError(f"characteristic: {option} must be positive (got {value}). Give seconds, as 0.5.")
    if hasattr(source, "flat"):
        source = lower(source, period or 0.01)
    run = {"limits": limits, "others": others, "start": start}
    _refuse_idle({"delay": delay, "moving": moving} if isinstance(source, Block) else run, isinstance(source, Block))
    if isinstance(source, Block):
        return _of_block(source, input, output, rate, settle, window, limits, others or {}, start or {}, period)
    records = [source] if isinstance(source, Record) else list(source)
    return _of_records(records, input, output, rate, settle, window, delay, steady, moving, period)


def _refuse_idle(options: Mapping[str, object], runs: bool) -> None:
    """Raise DeclarationError for an option that says nothing of such a source."""
    given = [name for name, value in options.items() if value is not None]
    if given:
        kinds = ("recordings", "a block or a model") if runs else ("a block or a model", "recordings")
        raise DeclarationError(
            f"characteristic: {' and '.join(given)} tells of {kinds[0]}, and nothing of {kinds[1]}. Leave it out."
        )


def asked_signal(output: Signal, rate: bool) -> Signal:
    """What is asked of the inverse: the output itself, or its rate of change."""
    name = f"{output.name}_rate" if rate else output.name
    unit = si_unit(f"{output.unit}/s" if output.unit != "1" else "1/s") if rate else output.unit
    return Signal(f"wanted_{name}", unit, f"wanted {'rate of ' if rate else ''}{output.name}", output.nominal, "linear")


# -- from recordings -----------------------------------------------------------------------------------------------
def _of_records(records, input, output, rate, settle, window, delay, steady, moving, period) -> Characteristic:
    if not records:
        raise DataError("characteristic: no recordings (got an empty list). Give at least one Record.")
    (input,), (output,) = (as_signals([s], records[0], "signals") for s in (input, output))
    records = usable(all_unbroken(records, [input.name, output.name]), (input, output))
    rate = integration(records, (input,), (output,))[0].found if rate is None else rate
    span = max(float(np.ptp(np.concatenate([r[input.name] for r in records]))), 1e-300)
    window = window or max(0.5, 10 * max(r.period for r in records))
    cut = [] if moving else [_stretches(r, input, output, rate, settle, window, delay or 0.0, steady * span)
                             for r in records]  # fmt: skip
    u, r, error = np.array([p for part in cut for p in part]).reshape(-1, 3).T
    fall = None
    told = {"trained_on": named(records), "steady_points": len(u), "settle": settle, "window": window,
            "delay": delay or 0.0}  # fmt: skip
    if moving or (moving is None and (len(u) < LEAST_POINTS or np.ptp(u) < COVERED * span)):
        found = moving_curve(records, input, output, rate, delay)
        refuse_what_falls(output.name, input.name, found.fall, float(np.ptp(found.rates)))
        u, r, error, fall = found.commands, found.rates, found.sigma, found.fall
        told = {"trained_on": named(records), "moving_points": len(u), "delay": found.dead_time}
    elif not len(u):
        raise DataError(
            f"characteristic of {output.name}: '{input.name}' is nowhere steady for {settle + window:g} s. "
            "Hold commands for longer, ramp more slowly, give a shorter settle and window, or moving=True."
        )
    sigma = float(np.median(error))
    return Characteristic(input, asked_signal(output, rate), u, r, sigma, period or records[0].period, told, fall)


def _stretches(record, input, output, rate, settle, window, delay, allowed):
    """(command, rate, its standard error) of every steady stretch of a recording, one after the other."""
    t, u, y = record.time, record[input.name], record[output.name]
    before, begin, end = settle + delay, t[0] + settle + delay, t[-1] + 1e-9
    while begin + window <= end:
        first, low, high = np.searchsorted(t, np.array([begin - before, begin, begin + window]) - 1e-9)
        wandering = np.flatnonzero(_spread_to_the_end(u[first:high]) > allowed)
        if len(wandering):
            begin = t[first + wandering[-1] + 1] + before
            continue
        begin += window
        if high - low >= 4:
            late = slice(*np.searchsorted(t, np.array([t[low] - delay, t[low] + window - delay]) - 1e-9))
            yield float(u[late].mean()), *(slope_and_error if rate else level_and_error)(t[low:high], y[low:high])


def _spread_to_the_end(values: np.ndarray) -> np.ndarray:
    """Largest minus smallest of what follows, for every value of (n,)."""
    back = values[::-1]
    return (np.maximum.accumulate(back) - np.minimum.accumulate(back))[::-1]


# -- from a block --------------------------------------------------------------------------------------------------
def _of_block(block, input, output, rate, settle, window, limits, others, start, period) -> Characteristic:
    driven = _named(block.inputs, input, block.name, "input")
    seen = _named(block.outputs, output, block.name, "output")
    rate = block.outputs[seen].unit in POSITIONS if rate is None else rate
    limits = limits or _limits(block, block.inputs[driven])
    held = _Held(block, driven, seen, rate, settle, window or max(0.1, 4 * block.period), others, start)
    levels = np.linspace(*limits, FIRST_LEVELS)
    rates = held.answer(levels)
    for _ in range(ROUNDS):
        more = _where_it_bends(levels, rates)
        levels, rates = np.append(levels, more), np.append(rates, held.answer(more))
        order = np.argsort(levels)
        levels, rates = levels[order], rates[order]
    source = {"block": block.name, "steady_points": len(levels), "settle": settle, "others": dict(others)}
    source |= {"trained_on": rows} if (rows := made_from_rows(block.provenance)) else {}
    asked = asked_signal(block.outputs[seen], rate)
    return Characteristic(block.inputs[driven], asked, levels, rates, 0.0, period or block.period, source)


def _named(signals: Sequence[Signal], wanted: Signal | str, where: str, role: str) -> int:
    names, name = [s.name for s in signals], getattr(wanted, "name", wanted)
    if name not in names:
        raise DeclarationError(f"{where}: no {role} '{name}'. {nearest(str(name), names)}")
    return names.index(name)


def _limits(block: Block, signal: Signal) -> tuple[float, float]:
    if block.domain is not None and signal.name in block.domain.names:
        k = block.domain.names.index(signal.name)
        return block.domain.lower[k], block.domain.upper[k]
    return -signal.nominal, signal.nominal


def _where_it_bends(levels: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Midpoints of the intervals at whose ends the answer bends most."""
    bend = np.zeros(len(levels))
    between = np.interp(levels[1:-1], levels[::2], rates[::2])
    between = np.where(np.arange(1, len(levels) - 1) % 2, between, np.interp(levels[1:-1], levels[1::2], rates[1::2]))
    bend[1:-1] = np.abs(rates[1:-1] - between)
    score = bend[:-1] + bend[1:]
    chosen = np.sort(np.argsort(-score, kind="stable")[:LEVELS_PER_ROUND])
    return 0.5 * (levels[chosen] + levels[chosen + 1])


@dataclass(frozen=True)
class _Held:
    """A block whose one input is held at a level, everything else left alone."""

    block: Block
    driven: int
    seen: int
    rate: bool
    settle: float
    window: float
    others: Mapping[str, float]
    start: Mapping[str, float]

    def answer(self, levels: np.ndarray) -> np.ndarray:
        """Steady answers (n,) to ``levels`` (n,), each from the start state."""
        block, n = self.block, len(levels)
        u = np.zeros((len(block.inputs), n))
        for name, value in self.others.items():
            u[_named(block.inputs, name, block.name, "input")] = value
        p = block.parameter_vector()
        x = np.repeat(self._start(u[:, 0], p)[:, None], n, axis=1)
        u[self.driven] = levels
        together = block.step.map(n)
        settling, measuring = (max(1, math.ceil(s / block.period - 1e-9)) for s in (self.settle, self.window))
        history = []
        for k in range(settling + measuring + 1):
            x, y = (value.full() for value in together(x, u, np.repeat(p[:, None], n, axis=1)))
            if k >= settling:
                history.append(y[self.seen])
        history = np.array(history)
        self._check(history, levels)
        half = len(history) // 2
        if not self.rate:
            parts = history[:half].mean(axis=0), history[half:].mean(axis=0)
            self._check_settled(*parts)
            return history.mean(axis=0)
        steps = np.diff(history, axis=0) / block.period
        self._check_settled(steps[:half].mean(axis=0), steps[half:].mean(axis=0))
        return steps.mean(axis=0)

    def _start(self, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        block, y = self.block, np.full(len(self.block.outputs), np.nan)
        for k, signal in enumerate(block.outputs):
            if signal.name in self.start:
                y[k] = self.start[signal.name]
            elif block.domain is not None and signal.name in block.domain.names:
                at = block.domain.names.index(signal.name)
                y[k] = 0.5 * (block.domain.lower[at] + block.domain.upper[at])
        x = block.start(u, y, p).full().ravel()
        for k, state in enumerate(block.states):
            x[k] = self.start.get(state.name, x[k])
            if not np.isfinite(x[k]):
                raise DataError(
                    f"{block.name}.{state.name}: the start is not known (got {x[k]}). "
                    f"Give start={{'{state.measured_by or state.name}': ...}}."
                )
        return x

    def _check(self, history: np.ndarray, levels: np.ndarray) -> None:
        lost = ~np.isfinite(history).all(axis=0)
        if lost.any():
            raise DataError(
                f"{self.block.name}: the answer to a held {self.block.inputs[self.driven].name} of "
                f"{levels[np.argmax(lost)]:g} leaves the finite numbers. Give narrower limits, another start, or a "
                "shorter settle."
            )

    def _check_settled(self, first: np.ndarray, second: np.ndarray) -> None:
        change = float(np.abs(first - second).max()) if len(first) else 0.0
        if change > UNSETTLED[self.rate] * max(float(np.ptp(second)), 1e-300):
            raise DataError(
                f"{self.block.name}: '{self.block.outputs[self.seen].name}' has not settled {self.settle:g} s after "
                f"the command (it still changes by {change:.3g} within the window). Give a longer settle"
                f"{'' if self.rate else ', or rate=True if it never settles'}."
            )
