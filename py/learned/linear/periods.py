"""The period of kinds whose training runs over every sample many times: long recordings get a longer one."""

from __future__ import annotations

from collections.abc import Sequence

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..training_data import MANY, choose_period
from .arx import choose
from .orders import Asked


def affordable_period(
    both: tuple[Sequence[Record], Sequence[Record]], inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> float:
    """The longest period [s] that loses nothing worth having; where that is more than `MANY` samples, the one of ARX.

    That one is chosen by free runs over what is held out of linear equations, at most `MANY` samples each (`choose`).
    both : recordings to fit, and those that choose (none: parts of the former).
    """
    period = choose_period(both[0])
    if sum(r.duration for r in both[0]) <= MANY * period:
        return period
    return max(period, choose(both, inputs, outputs, None, Asked(), 0).period)
