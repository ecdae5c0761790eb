"""Running a Block: its sample grid, its free run and its one-step predictions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import CLOCKS, NEAR, steps_over

from . import inputs
from .block import Block
from .stops import Diverged

CHUNK = 400  # samples per call of the interpreter, at most


def sample_grid(block: Block, time: np.ndarray) -> np.ndarray:
    """The block's own sample times over a recording; ``time`` itself when it already is that grid, by another clock."""
    even = np.ptp(time) / max(len(time) - 1, 1)
    alike = len(time) > 1 and abs(even - block.period) <= CLOCKS * block.period
    if alike and np.abs(time - time[0] - even * np.arange(len(time))).max() < NEAR * block.period:
        return time
    steps = max(int(np.ceil(steps_over(time[-1] - time[0], block.period, block.name) - NEAR)), 0)
    return time[0] + block.period * np.arange(steps + 1)


def sampled_inputs(block: Block, time: np.ndarray, u: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Inputs (m, nu) at the block's samples: the held or the linear value there, the last one after the end.

    Printed times and periods are rounded: what is a sample but for that is the sample (`NEAR`).
    """
    near = time[np.minimum(np.searchsorted(time, grid - NEAR * block.period), len(time) - 1)]
    grid = np.where(np.abs(near - grid) < NEAR * block.period, near, grid)
    columns = [inputs.at(time, u[:, j], grid, not s.held, "right") for j, s in enumerate(block.inputs)]
    return np.column_stack(columns) if columns else np.empty((len(grid), 0))


def start_state(block: Block, u: np.ndarray, y: np.ndarray, p: np.ndarray, start: Mapping[str, float]) -> np.ndarray:
    """State before the first step; ``y`` (ny,) is nan where not measured, ``start`` replaces states by name."""
    x = block.start(u, y, p).full().ravel()
    for j, state in enumerate(block.states):
        x[j] = start.get(state.name, x[j])
        if not np.isfinite(x[j]):
            measured = state.measured_by or "the outputs"
            raise DataError(
                f"{block.name}.{state.name}: the start is not known (got {x[j]} {state.unit}). "
                f"It comes from the first sample of {measured}. Record that, or give start={{'{state.name}': ...}}."
            )
    return x


def run_block(block: Block, time: np.ndarray, u: np.ndarray, p: np.ndarray, x0: np.ndarray):
    """Outputs (n, ny) and states (n, nx) of a free run at the samples ``time`` with inputs ``u`` (n, nu)."""
    size = -(-len(time) // -(-len(time) // CHUNK))  # parts of equal length: little of the last one is padding
    walk = block.step.mapaccum("walk", size, 1)
    y, x = np.empty((len(time), len(block.outputs))), np.empty((len(time), len(block.states)))
    state = x0
    for first in range(0, len(time), size):
        part = u[first : first + size]
        padded = np.concatenate([part, np.repeat(part[-1:], size - len(part), axis=0)])
        following, seen = (value.full().T for value in walk(state, padded.T, p))
        y[first : first + len(part)] = seen[: len(part)]
        x[first : first + len(part)] = np.vstack([state, following])[: len(part)]
        state = following[-1]
        _stop_if_not_finite(block, time, x, y, first + len(part))
    return y, x


def predict_block(
    block: Block, grid: np.ndarray, time: np.ndarray, u: np.ndarray, p: np.ndarray, corrected: np.ndarray
) -> np.ndarray:
    """Outputs (n, ny) on ``grid``, each predicted from the last sample of ``time`` before it.

    ``corrected`` (n, nx) are the states with the measurement in them; they are taken only where a sample was taken. In
    between the block runs on by itself: a block faster than the recording must not see a measurement that is
    interpolated towards the next sample.
    """
    y = np.empty((len(grid), len(block.outputs)))
    sampled_at = np.unique(np.clip(np.searchsorted(grid, time - NEAR * block.period), 0, len(grid) - 1))
    until = np.append(sampled_at[1:], len(grid) - 1)
    state = corrected[sampled_at]
    for k in range(int((until - sampled_at).max(initial=0))):
        live = sampled_at + k < until
        at = sampled_at[live] + k
        following, seen = (value.full().T for value in block.step(state[live].T, u[at].T, p))
        if k:  # what is seen at a sample itself comes from the one before it
            y[at] = seen
        state[live] = following
    led = until > sampled_at  # not the last sample, at the end of the grid
    y[until[led]] = block.step(state[led].T, u[until[led]].T, p)[1].full().T
    y[0] = block.step(corrected[0], u[0], p)[1].full().ravel()
    return y


def _stop_if_not_finite(block: Block, time, x, y, upto: int) -> None:
    if np.isfinite(x[:upto]).all() and np.isfinite(y[:upto]).all():
        return
    k = int(np.argmax(~(np.isfinite(x[:upto]).all(axis=1) & np.isfinite(y[:upto]).all(axis=1))))
    states = [s.name for s, value in zip(block.states, x[k], strict=True) if not np.isfinite(value)]
    outputs = [s.name for s, value in zip(block.outputs, y[k], strict=True) if not np.isfinite(value)]
    raise Diverged(
        f"{block.name}.{(states or outputs)[0]}: the run left the finite numbers at t = {time[k]:.6g} s. "
        "Check the parameters, the start and whether the inputs are in SI.",
        float(time[k]),
        states[0] if states else None,
    )
