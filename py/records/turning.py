"""Angles that begin anew at every turn: no model of a shaft that goes on turning can meet them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .record import Record

TURN = 2 * np.pi
_JUMP, _MOVE = 0.75, 0.25  # of a turn: a jump back is nearly a whole one, a shaft that is sampled well moves far less
_SPAN = 1.02  # turns: what a sensor that begins anew shows at most, with its noise


def turned_back(record: Record) -> tuple[str, ...]:
    """Of every angle that seems to begin anew at each turn a sentence: what, so what, what next.

    It stays within one turn, jumps by nearly one from a sample to the next, and moves little between the others.
    """
    found = {name: _jumps(record[name]) for name in record.signals if record.units[name] == "rad"}
    return tuple(
        f"{name} seems to begin anew at every turn: it jumps by nearly 360 deg from one sample to the next, {times} "
        f"time{'s' * (times > 1)}. A model counts turns on, so its error there is whole turns. Unwrap it first "
        "(numpy.unwrap, unwrap of MATLAB)."
        for name, times in found.items()
        if times
    )


def _jumps(values: np.ndarray) -> int:
    """How often an angle [rad] begins anew; 0 where something else than that moves it."""
    known = values[np.isfinite(values)]
    if len(known) < 3 or np.ptp(known) > _SPAN * TURN:
        return 0
    steps = np.abs(np.diff(known)) / TURN
    jumps = int((steps > _JUMP).sum())
    return jumps if jumps == int((steps > _MOVE).sum()) else 0
