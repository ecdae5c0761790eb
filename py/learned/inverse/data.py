"""The forward characteristic of a machine: the steady answer to held commands, from recordings or from a model.

r(u) = lim  y(t)   or   lim  dy/dt     for u held
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.provenance import made_from_rows
from hydrotwin.models.language.units import si_unit
from hydrotwin.records import Record, all_unbroken
from hydrotwin.simulation import lower
from hydrotwin.simulation.block import Block

from ..integrating import integration
from ..training_data import as_signals, named, usable
from .falling import Fall, fall_of_points, refuse_what_falls
from .held import HeldBlock, Holding
from .moving import moving_curve
from .stops import between_stops
from .stretches import LEAST_POINTS, Reading, covers, steady_points


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
    settle: float | None = None,
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
            tell, or how a Block or Model goes on from two histories.
        settle, window: s before a point is taken and s it is averaged over. None: half a second each, or less where
            commands are held for less; settle longer, where the points scatter less then, or do not rest yet.
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
        held = HeldBlock(source, input, output, Holding(settle, window, limits, others, start))
        return _of_block(held, rate, period)
    records = [source] if isinstance(source, Record) else list(source)
    return _of_records(records, (input, output), rate, Reading(settle, window, delay, steady), moving, period)


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
def _of_records(records, signals, rate, reading: Reading, moving, period) -> Characteristic:
    if not records:
        raise DataError("characteristic: no recordings (got an empty list). Give at least one Record.")
    (input,), (output,) = (as_signals([s], records[0], "signals") for s in signals)
    records = usable(all_unbroken(records, [input.name, output.name]), (input, output))
    inside = between_stops(records, input.name, output.name)
    rate = integration(inside, (input,), (output,))[0].found if rate is None else rate
    stood = sum(r.duration for r in records) - sum(r.duration for r in inside) if rate else 0.0
    records = inside if rate else records
    every = np.concatenate([r[input.name] for r in records])
    found = None if moving else steady_points(records, input, output, rate, reading)
    enough = found is not None and covers(found.commands, float(np.ptp(every)))
    if moving or (moving is None and not enough):
        found = _of_moving(records, input, output, rate, reading.delay, period)
        return replace(found, source={**found.source, "at_stops": stood})
    if not len(found.commands):
        raise DataError(
            f"characteristic of {output.name}: '{input.name}' is nowhere steady for {found.settle + found.window:g} s. "
            "Hold commands for longer, ramp more slowly, give a shorter settle and window, or moving=True."
        )
    told = {"trained_on": named(records), "steady_points": len(found.commands), "settle": found.settle,
            "window": found.window, "delay": reading.delay or 0.0, "creeping": list(found.creeping), "rate": rate,
            "going_on": found.going_on, "one_way": found.one_way, "at_stops": stood}  # fmt: skip
    asked, sigma = asked_signal(output, rate), float(np.median(found.errors))
    return Characteristic(input, asked, found.commands, found.answers, sigma, period or records[0].period, told)


def _of_moving(records, input, output, rate, delay, period) -> Characteristic:
    found = moving_curve(records, input, output, rate, delay)
    refuse_what_falls(output.name, input.name, found.fall, float(np.ptp(found.rates)))
    told = {"trained_on": named(records), "moving_points": len(found.commands), "delay": found.dead_time,
            "rate": rate}  # fmt: skip
    return Characteristic(
        input, asked_signal(output, rate), found.commands, found.rates, found.sigma, period or records[0].period, told,
        found.fall,
    )  # fmt: skip


# -- from a block --------------------------------------------------------------------------------------------------
def _of_block(held: HeldBlock, rate: bool | None, period: float | None) -> Characteristic:
    block, rate = held.block, held.integrates() if rate is None else rate
    levels, answers = held.answers(rate)
    source = {"block": block.name, "steady_points": len(levels), "settle": held.settle, "others": dict(held.others),
              "changing": held.changing}  # fmt: skip
    source |= {"trained_on": rows} if (rows := made_from_rows(block.provenance)) else {}
    asked = asked_signal(block.outputs[held.seen], rate)
    return Characteristic(block.inputs[held.driven], asked, levels, answers, 0.0, period or block.period, source)
