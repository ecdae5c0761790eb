"""The steady answers of a block or a model: one input is held at many levels, most of them where the answer bends.

An output integrates its input where it keeps moving at held commands, and where it remembers: after two histories the
same command leaves two values of it. Its unit takes no part. A limit makes an integrator stand still; it does not make
it forget. A pressure that a closed valve traps is remembered, too; but it does not keep moving.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.simulation.block import Block

FIRST_LEVELS, ROUNDS, LEVELS_PER_ROUND = 65, 3, 48
UNSETTLED = {True: 0.1, False: 0.005}  # of the span of rates, of values: by how much twice the time may change them
REMEMBERED = 0.8  # of what two histories made different: an integrator keeps more of it, what settles less
LONGER = 10  # times settle and window: how long it may forget
MOVING = 0.1  # of what the output covered since the start: what moves less in as long again is at rest
STOPPED = 0.01  # of the mean rate since the start: less than that at the end is a limit
SETTLE, TWICE = 0.5, 6  # s, where none is given, and how often it may be doubled until the answers are steady


class _Unsettled(DataError):
    """Answers that still change."""


class _Stopped(DataError):
    """An output that stands at a limit, and whose rate was asked for."""


@dataclass(frozen=True)
class Holding:
    """How a block is held.

    settle, window : s before an answer is taken, and s over which it is averaged; settle None: as long as it takes.
    limits : least and largest command; None: its training domain, else +- its nominal value. others : values of the
    other inputs, 0 where none is given. start : values of states or outputs.
    """

    settle: float | None = None
    window: float | None = None
    limits: tuple[float, float] | None = None
    others: Mapping[str, float] | None = None
    start: Mapping[str, float] | None = None


class HeldBlock:
    """A block whose one input is held at levels, everything else left alone.

    changing : by how much its steady rates change in as long again, SI; of values 0.
    """

    def __init__(self, block: Block, input: Signal | str, output: Signal | str, holding: Holding):
        self.block = block
        self.driven = _named(block.inputs, input, block.name, "input")
        self.seen = _named(block.outputs, output, block.name, "output")
        self.limits = holding.limits or _limits(block, block.inputs[self.driven])
        self.settle = SETTLE if holding.settle is None else holding.settle
        self.may_wait = holding.settle is None
        self.window = holding.window or max(0.1, 4 * block.period)
        self.others, self.start = holding.others or {}, holding.start or {}
        self.changing = 0.0

    def answers(self, rate: bool) -> tuple[np.ndarray, np.ndarray]:
        """Commands (n,) in ascending order and the steady rates or values (n,) that they lead to, each from the start.

        ``settle`` is doubled until they are steady, where none was given. Raises DataError for what does not settle,
        reaches a limit, or leaves the finite numbers.
        """
        try:
            return self._answers(rate)
        except _Unsettled as error:
            if not self.may_wait:
                raise
            unsettled = error
        for _ in range(TWICE):
            self.settle *= 2
            try:
                return self._answers(rate)
            except _Unsettled as error:
                unsettled = error
            except _Stopped as error:
                raise DataError(f"{error} Before, it has not settled.") from unsettled
        raise unsettled

    def _answers(self, rate: bool) -> tuple[np.ndarray, np.ndarray]:
        levels = np.linspace(*self.limits, FIRST_LEVELS)
        answers = self._steady(levels, self._held(levels), rate)
        for _ in range(ROUNDS):
            more = _where_it_bends(levels, answers)
            levels = np.append(levels, more)
            answers = np.append(answers, self._steady(more, self._held(more), rate))
            order = np.argsort(levels)
            levels, answers = levels[order], answers[order]
        return levels, answers

    def integrates(self) -> bool:
        """Whether the output integrates its input; see the head of this file."""
        levels = np.linspace(*self.limits, FIRST_LEVELS)
        history, window = self._held(levels)[: self._until], self._steps(self.window)
        covered = float(np.ptp(history))
        last = (history[-1] - history[-1 - window]) / window
        if not np.abs(last).max() * len(history) > MOVING * covered > 0.0:
            return False
        rest = levels[int(np.argmin(np.abs(history[-1] - history[0])))]
        apart = levels[[int(np.argmin(history[-1])), int(np.argmax(history[-1]))]]
        before = np.repeat(apart[None], len(history), axis=0)
        afterwards = self._run(np.vstack([before, np.full((LONGER * len(history), 2), rest)]))
        return not abs(float(np.diff(afterwards[-1])[0])) <= REMEMBERED * float(np.ptp(history[-1]))

    def _steps(self, seconds: float) -> int:
        return max(1, math.ceil(seconds / self.block.period - 1e-9))

    def _held(self, levels: np.ndarray) -> np.ndarray:
        """The output (steps, n) at held levels (n,), until window is over, and as long once more."""
        history = self._run(np.repeat(levels[None], 2 * self._until, axis=0))
        self._refuse_lost(history[: self._until], levels)
        return history

    @property
    def _until(self) -> int:
        """Steps until window is over."""
        return self._steps(self.settle) + self._steps(self.window) + 1

    def _run(self, commands: np.ndarray) -> np.ndarray:
        """The output (steps, n) from the start, with commands (steps, n)."""
        block, n = self.block, commands.shape[1]
        u = np.zeros((len(block.inputs), n))
        for name, value in self.others.items():
            u[_named(block.inputs, name, block.name, "input")] = value
        p = block.parameter_vector()
        x = np.repeat(self._start_state(u[:, 0], p)[:, None], n, axis=1)
        together, parameters, history = block.step.map(n), np.repeat(p[:, None], n, axis=1), []
        for u[self.driven] in commands:
            x, y = (value.full() for value in together(x, u, parameters))
            history.append(y[self.seen])
        history = np.array(history)
        return history

    def _start_state(self, u: np.ndarray, p: np.ndarray) -> np.ndarray:
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

    def _steady(self, levels: np.ndarray, history: np.ndarray, rate: bool) -> np.ndarray:
        """Rates or values (n,) in the window.

        Values must be the same after as long again. Rates need not: a machine moves on meanwhile, to where it may be
        faster, or stand at a limit; by how much they change is kept in ``changing``.
        """
        now, later = history[: self._until][-self._steps(self.window) - 1 :], history[-self._steps(self.window) - 1 :]
        if not rate:
            self._refuse_unsettled(now.mean(axis=0), later.mean(axis=0), rate)
            return now.mean(axis=0)
        half = len(now) // 2
        rates, later, first, second = (self._rate(part) for part in (now, later, now[: half + 1], now[half:]))
        self._refuse_stopped(levels, history[: self._until], rates)
        self._refuse_unsettled(first, second, rate)
        going = np.isfinite(later) & (
            np.abs(later) > STOPPED * np.abs(rates)
        )  # not where a limit is reached, or the finite numbers are left
        self.changing = max(self.changing, *np.abs(later - rates)[going], 0.0)
        return rates

    def _rate(self, values: np.ndarray) -> np.ndarray:
        """Mean rates (n,) of values (steps, n)."""
        return (values[-1] - values[0]) / ((len(values) - 1) * self.block.period)

    def _refuse_lost(self, history: np.ndarray, levels: np.ndarray) -> None:
        lost = ~np.isfinite(history).all(axis=0)
        if lost.any():
            raise DataError(
                f"{self.block.name}: the answer to a held {self.block.inputs[self.driven].name} of "
                f"{levels[np.argmax(lost)]:g} leaves the finite numbers. Give narrower limits, another start, or a "
                "shorter settle."
            )

    def _refuse_stopped(self, levels: np.ndarray, history: np.ndarray, rates: np.ndarray) -> None:
        """Raise DataError where the output went far and stands: at a limit."""
        moved = history[-1] - history[0]
        mean = moved / (self.block.period * (len(history) - 1))
        stopped = (np.abs(rates) <= STOPPED * np.abs(mean)) & (np.abs(moved) > MOVING * np.ptp(history))
        if stopped.any():
            k = int(np.argmax(stopped))
            driven, seen = self.block.inputs[self.driven], self.block.outputs[self.seen]
            raise _Stopped(
                f"{self.block.name}: '{seen.name}' stands at {history[-1, k]:.4g} {seen.unit} while '{driven.name}' is "
                f"held at {levels[k]:.4g} {driven.unit}: it reached a limit within {self.settle + self.window:g} s. "
                "Its rate there says nothing. Give a shorter settle, narrower limits of the command, another start, or "
                "rate=False if it settles there."
            )

    def _refuse_unsettled(self, first: np.ndarray, second: np.ndarray, rate: bool) -> None:
        change = float(np.abs(first - second).max()) if len(first) else 0.0
        if change > UNSETTLED[rate] * max(float(np.ptp(second)), 1e-300):
            raise _Unsettled(
                f"{self.block.name}: '{self.block.outputs[self.seen].name}' has not settled {self.settle:g} s after "
                f"the command (it changes by {change:.3g} until twice that time). Give a longer settle"
                f"{'' if rate else ', or rate=True if it never settles'}."
            )


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


def _where_it_bends(levels: np.ndarray, answers: np.ndarray) -> np.ndarray:
    """Midpoints of the intervals at whose ends the answer bends most."""
    bend = np.zeros(len(levels))
    between = np.interp(levels[1:-1], levels[::2], answers[::2])
    between = np.where(np.arange(1, len(levels) - 1) % 2, between, np.interp(levels[1:-1], levels[1::2], answers[1::2]))
    bend[1:-1] = np.abs(answers[1:-1] - between)
    score = bend[:-1] + bend[1:]
    chosen = np.sort(np.argsort(-score, kind="stable")[:LEVELS_PER_ROUND])
    return 0.5 * (levels[chosen] + levels[chosen + 1])
