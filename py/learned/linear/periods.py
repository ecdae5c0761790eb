"""The period of kinds whose training runs over every sample many times: long recordings get a longer one."""

from __future__ import annotations

from collections.abc import Sequence

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, tidy

from ..training_data import MANY, choose_period, recorded_period
from .arx import choose
from .orders import Asked

PLENTY = 2000  # samples that are not thinned any further: of fewer, each tells something of the noise. Formulas of the
# tanks' training file, 160 to 200 samples of its 600 to 800, ran 1.3 times as far off on what they had not seen


def affordable_period(
    both: tuple[Sequence[Record], Sequence[Record]], inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> float:
    """The longest period [s] that loses nothing worth having; where that is more than `MANY` samples, the one of ARX.

    That one is chosen by free runs over what is held out of linear equations, at most `MANY` samples each (`choose`).
    Few samples are not thinned: `PLENTY` are left, or those of the recordings.
    both : recordings to fit, and those that choose (none: parts of the former).
    """
    total, recorded = sum(r.duration for r in both[0]), recorded_period(both[0])
    period = choose_period(both[0])
    if total < PLENTY * period:
        return tidy(min(period, recorded * max(1, int(total / recorded / PLENTY))))
    if total <= MANY * period:
        return period
    return max(period, choose(both, inputs, outputs, None, Asked(), 0).period)
