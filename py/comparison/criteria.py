"""Acceptance criteria that are understood, and whether they hold.

Without a group a criterion is about all recordings together. Without an output, ``fit > 90 %``, it is about every
compared output, and the worst of them counts: see `worst`. How they are written is in `sentence`, what that means in
`meaning`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .comparison import FREE_RUN, mean_known
from .metric import METRICS, PLAIN, SHARE

EQUAL = 1e-9  # relative: nearer to its bound a number lies on it: 95.2 % are no 0.952 to the last digit
FEWEST = 50  # samples that a criterion should be judged on, as many as a start is estimated from; fewer are told


@dataclass(frozen=True)
class Criterion:
    """One sentence, understood.

    text : as written. group : "" for all recordings. low, high : SI, or a share of 1; with ``strict`` (< and >) the
    bound itself is not allowed.
    than : the model that must not be better, ``by`` : the share that it may be. unit : that it is written in, or else
    read in; scale : one of it, in SI. overall : the sentence names no output; this is what it says of one of them.
    """

    text: str
    output: str
    metric: str
    group: str = ""
    low: float = -np.inf
    high: float = np.inf
    than: str = ""
    by: float = 0.0
    unit: str = ""
    scale: float = 1.0
    overall: bool = False
    strict: bool = False

    def as_written(self, value: float) -> float:
        """A number of it (SI, or a share of 1) in ``unit``."""
        return value / self.scale


@dataclass(frozen=True)
class Judged:
    """A criterion with what was found.

    value : SI or a share of 1. low, high : what it had to lie in. margin : how far inside, over the size of the bound;
    negative outside. reason : why a recording left no number, in a sentence; what has none passes nothing.
    samples : that it was judged on, None where nobody counted. without : recordings it is about that do not hold the
    output, so that it was judged on the others. lacking : recordings that have no number of the metric. doubt : why the
    band of the output cannot be trusted; "" where it can, or where there is none. uneven : how differently many samples
    a mean rests on, in words; "" where they are alike. otherwise : what else than the model is not as it is in what it
    is held against, an earlier comparison or another model, in sentences. among : of an overall criterion all outputs
    that it is about, of which this is the worst; left_out : what it was not judged on, in words. seen : recordings that
    it was judged on and that the model was made from. flat : that the output hardly moves against its size, which the
    metric counts by, in words; "" where it moves. holes : where runs began anew behind a hole, in words; unknown :
    samples that were not judged, for no value of the output is known there or nothing was run. mode : in which it was
    judged.
    trained : recordings it was judged on that were named as what the models were made from. skipped : recordings that
    have no number of a metric that is the mean of the others.
    """

    criterion: Criterion
    value: float
    low: float
    high: float
    reason: str = ""
    samples: int | None = None
    without: tuple[str, ...] = ()
    lacking: tuple[str, ...] = ()
    doubt: str = ""
    uneven: str = ""
    otherwise: tuple[str, ...] = ()
    among: tuple[str, ...] = ()
    left_out: str = ""
    seen: tuple[str, ...] = ()
    flat: str = ""
    holes: str = ""
    unknown: str = ""
    mode: str = FREE_RUN
    trained: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def which(self) -> str:
        """Of an overall criterion which output is the worst, in words; empty of any other.

        >>> Judged(Criterion("fit > 90 %", "speed", "fit"), 0.8, 0.9, 1.0, among=("speed", "angle")).which
        'speed, the worst of 2 outputs'
        """
        rest = f", the worst of {len(self.among)} outputs" if len(self.among) > 1 else ""
        return f"{self.criterion.output}{rest}" if self.among else ""

    @property
    def passed(self) -> bool:
        inside = not self.criterion.strict if self.on_bound else self.low <= self.value <= self.high
        return bool(np.isfinite(self.value) and inside and not self.untestable)

    @property
    def on_bound(self) -> bool:
        """Whether the number is a bound, as near as the same number in other units is."""
        return any(math.isclose(self.value, bound, rel_tol=EQUAL) for bound in (self.low, self.high))

    @property
    def untestable(self) -> str:
        """Why a number says nothing, in a sentence: it is of a band that cannot be trusted; empty where it does."""
        if not self.doubt or not METRICS[self.criterion.metric].of_band:
            return ""
        return f"cannot be tested, for the band of {self.criterion.output} cannot be trusted: {self.doubt}"

    @property
    def undefined(self) -> str:
        """Why there is no number to judge, in a sentence; empty where there is one."""
        if self.reason or self.untestable:
            return self.reason or self.untestable
        one, on = self.criterion, f" on {some_of(self.lacking)}" if self.lacking else ""
        if not np.isnan(self.value):
            return f"{one.than} has no {one.metric}{on} to compare with" if np.isnan(self.high) else ""
        why = METRICS[one.metric].undefined or "nothing was found of {output}"
        return f"not defined{on}: {why.format(output=one.output)}"

    @property
    def cautions(self) -> tuple[str, ...]:
        """What to know before it is relied on, one by one."""
        one, told = self.criterion, [self.left_out] if self.left_out else []
        if self.mode != FREE_RUN:
            told.append("judged one step ahead, and not in a free run")
        if self.without:
            holds = "holds" if len(self.without) == 1 else "hold"
            told.append(f"not judged on {some_of(self.without)}, which {holds} no {one.output}")
        if self.skipped:
            told.append(f"not judged on {some_of(self.skipped)}, where {one.metric} is not defined")
        if self.seen:
            told.append(f"judged on {some_of(self.seen)}, which the model was made from")
        if self.trained:
            told.append(f"judged on {some_of(self.trained)}, named as what the models were made from, too")
        if self.holes:
            told.append(f"judged in parts, with a start of its own behind every hole: {self.holes}")
        if self.unknown:
            told.append(f"not judged on {self.unknown}, where {one.output} is not known or nothing was run")
        if self.samples is not None and self.samples < FEWEST:
            told.append(f"judged on only {self.samples} sample{'s' * (self.samples != 1)}")
        told += [words for words in (self.flat, self.uneven) if words]
        told += [sentence.rstrip(".") for sentence in self.otherwise]
        if self.doubt and not self.untestable:
            told.append("its band cannot be trusted")
        return tuple(told)

    @property
    def caution(self) -> str:
        """The same in words; empty where there is nothing."""
        return "; ".join(self.cautions)

    @property
    def margin(self) -> float:
        if not np.isfinite(self.value) or self.untestable:
            return -np.inf
        if self.on_bound:
            return 0.0
        sides = [(self.value - self.low, self.low), (self.high - self.value, self.high)]
        found = [_share_of(room, abs(bound) or self._size) for room, bound in sides if np.isfinite(bound)]
        return min(found) if found else float("nan" if self.passed else "-inf")

    @property
    def _size(self) -> float:
        """What a bound of zero is measured by: the other bound, or of a share or a number one; zero where none is."""
        own = max((abs(bound) for bound in (self.low, self.high) if np.isfinite(bound)), default=0.0)
        return own or float(METRICS[self.criterion.metric].of in (SHARE, PLAIN))


def _share_of(room: float, size: float) -> float:
    return room / size if size else float(np.copysign(np.inf, room)) if room else 0.0


def some_of(names: Sequence[str], most: int = 3) -> str:
    """The first of several names, and that there are more.

    >>> some_of(["a", "b", "c", "d", "e"]), some_of(["a", "b"])
    ('a, b, c and 2 more', 'a, b')
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


def over_recordings(metric: str, values: Sequence[float]) -> float:
    """What a criterion takes of the scores of several recordings: the largest maximum, of those that are
    sized the mean size (of what is defined at times where it is), else the mean; what is in percent as a share.
    """
    if metric == "max":
        return float(max(values))
    if METRICS[metric].at_times:
        return mean_known(np.abs(values))
    value = float(np.mean(np.abs(values) if METRICS[metric].sized else values))
    return value / 100 if metric == "fit" else value


def worst(judged: Sequence[Judged]) -> Judged:
    """Of an overall criterion the output with the least margin, or without a number; any other as it is."""
    first = judged[0]
    if not first.criterion.overall:
        return first
    one = min(judged, key=lambda j: (j.passed, np.inf if np.isnan(j.margin) else j.margin))
    others: dict[str, list[str]] = {}  # what to know of other outputs alone: that all hold rests on them, too
    for j in judged:
        for words in (w for w in j.cautions if w not in one.cautions):
            others.setdefault(words, []).append(j.criterion.output)
    told = [f"of {some_of(names)}: {words}" for words, names in others.items()]
    return replace(
        one,
        among=tuple(j.criterion.output for j in judged),
        left_out="; ".join(filter(None, [one.left_out, *told])),
    )


def judge(one: Criterion, value: Callable[[str, str, str, str], float]) -> Judged:
    """Whether it holds. value : what was found for (group, output, metric, model), model "" the one that is judged."""
    found = value(one.group, one.output, one.metric, "")
    found = abs(found) if METRICS[one.metric].sized else found
    if not one.than:
        return Judged(one, found, one.low, one.high)
    other = abs(value(one.group, one.output, one.metric, one.than))
    allowed = other * (1 + one.by) if np.isfinite(other) else np.nan  # nothing is shown by being as good as a failure
    return Judged(one, found, -np.inf, allowed)
