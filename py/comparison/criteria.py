"""Acceptance criteria: sentences such as ``arm_angle.rmse < 0.2 deg``, and whether they hold.

    [GROUP:] OUTPUT.METRIC < VALUE [UNIT]           also <=, > and >=
    [GROUP:] OUTPUT.METRIC in [LOW, HIGH] [UNIT]
    [GROUP:] [OUTPUT][.METRIC] not worse than MODEL [by SHARE %]

GROUP is the name of a recording, or ``tag=value``; without one a criterion is about all recordings together. Without an
OUTPUT, ``fit > 90 %``, it is about every compared output, and the worst of them counts: see `criteria_of` and `worst`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, UnitError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible, convert, display_units

from .comparison import mean_known
from .metric import ERRORS, METRICS, OF_OUTPUT, PLAIN, SHARE, TIME

SIZE, NUMBER = "rmse", r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
FEWEST = 50  # samples that a criterion should be judged on, as many as a start is estimated from; fewer are told
EXAMPLES = "'position.rmse < 2 mm', 'position.fit > 90 %', 'position.coverage in [0.9, 0.99]'"
_WHERE = r"\s*(?:(?P<group>\S(?:[\s\S]*\S)?)\s*:\s*)?"  # up to the last colon: a name or a tag may be a time, 10:12
_BOUND = re.compile(rf"{_WHERE}(?P<what>[^<>]+?)\s*(?P<sign><=|>=|<|>)\s*(?P<bound>{NUMBER})\s*(?P<unit>\S.*?)?\s*$")
_RANGE = re.compile(
    rf"{_WHERE}(?P<what>\S.*?)\s+in\s*\[\s*(?P<low>{NUMBER})\s*(?P<each>[^\s,\]][^,\]]*?)?\s*,\s*(?P<high>{NUMBER})\s*"
    r"(?(each)(?P=each)\s*\]|\]\s*(?P<unit>\S.*?)?)\s*$"
)
_THAN = re.compile(
    rf"{_WHERE}(?:(?P<what>\S.*?)\s+)?not\s+worse\s+than\s+(?P<than>.+?)(?:\s+by\s+(?P<by>{NUMBER})\s*%)?\s*$"
)


@dataclass(frozen=True)
class Criterion:
    """One sentence, understood.

    text : as written. group : "" for all recordings. low, high : SI, or a share of 1; both are allowed themselves.
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
    a mean rests on, in words; "" where they are alike. otherwise : what else than the model is not as it was in the
    earlier comparison that it is held against, in sentences. among : of an overall criterion all outputs that it is
    about, of which this is the worst; left_out : what it was not judged on, in words.
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
        return bool(np.isfinite(self.value) and self.low <= self.value <= self.high)

    @property
    def undefined(self) -> str:
        """Why there is no number to judge, in a sentence; empty where there is one."""
        if self.reason:
            return self.reason
        one, on = self.criterion, f" on {some_of(self.lacking)}" if self.lacking else ""
        if not np.isnan(self.value):
            return f"{one.than} has no {one.metric}{on} to compare with" if np.isnan(self.high) else ""
        why = METRICS[one.metric].undefined or "nothing was found of {output}"
        return f"not defined{on}: {why.format(output=one.output)}"

    @property
    def caution(self) -> str:
        """What to know before it is relied on; empty where there is nothing."""
        one, told = self.criterion, [self.left_out] if self.left_out else []
        if self.without:
            holds = "holds" if len(self.without) == 1 else "hold"
            told.append(f"not judged on {some_of(self.without)}, which {holds} no {one.output}")
        if self.samples is not None and self.samples < FEWEST:
            told.append(f"judged on only {self.samples} sample{'s' * (self.samples != 1)}")
        if self.uneven:
            told.append(self.uneven)
        told += [sentence.rstrip(".") for sentence in self.otherwise]
        if self.doubt:
            of_band = METRICS[one.metric].of_band
            told.append("judged on a band that cannot be trusted" if of_band else "its band cannot be trusted")
        return "; ".join(told)

    @property
    def margin(self) -> float:
        if not np.isfinite(self.value):
            return -np.inf
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


def criteria_of(text: str, outputs: Iterable[Signal], every: Iterable[Signal] | None = None) -> tuple[Criterion, ...]:
    """What a sentence says: one criterion, or where it names no output the same for each of ``every``, by default all.

    Raises `DeclarationError` for a sentence that is none, an output or a metric that does not exist, and for one bound
    on outputs in different units; `UnitError` for a unit that the metric of an output cannot be in.
    """
    signals = {s.name: s for s in outputs}
    for pattern, meant in ((_RANGE, _in_range), (_THAN, _not_worse), (_BOUND, _bounded)):
        if found := pattern.match(text):
            what = found["what"] or SIZE
            if what not in METRICS or what in signals:
                return (meant(text, found, signals),)
            about = list(signals.values() if every is None else every)
            if "than" not in found.groupdict():
                _require_one_unit(text, what, about)
            return tuple(replace(meant(text, found, {s.name: s}), overall=True) for s in about)
    raise DeclarationError(f"accept: '{text}' is no criterion. Write for example {EXAMPLES}.")


def criterion(text: str, outputs: Iterable[Signal]) -> Criterion:
    """The criterion that a sentence says of one output. Raises as `criteria_of`, and for one that names no output."""
    signals = list(outputs)
    first, *_ = criteria_of(text, signals)
    if first.overall:
        raise DeclarationError(
            f"accept: '{text}' names no output. Write {first.output}.{first.metric}, and one for each output that "
            f"counts: {', '.join(s.name for s in signals)}."
        )
    return first


def other_of(text: str) -> str:
    """The model, or the file of an earlier comparison, that a sentence holds against; "" where it does not.

    >>> other_of("load=2: angle not worse than 'last/compare.json' by 5 %"), other_of("fit > 90 %")
    ('last/compare.json', '')
    """
    found = _THAN.match(text)
    return found["than"].strip().strip("\"'") if found else ""


def _require_one_unit(text: str, metric: str, about: Sequence[Signal]) -> None:
    """One bound for errors in bar and in degrees says nothing of which is the worst."""
    if METRICS[metric].of != OF_OUTPUT or len({s.unit for s in about}) < 2:
        return
    shown = ", ".join(f"{s.name} in {display_units(s.unit)[0]}" for s in about)
    raise DeclarationError(
        f"accept: '{text}' names no output, and no one bound fits all: {metric} is in the unit of each ({shown}). "
        f"Write {about[0].name}.{metric}, and one for each output that counts, or judge a share of all: nrmse, fit."
    )


def worst(judged: Sequence[Judged]) -> Judged:
    """Of an overall criterion the output with the least margin, or without a number; any other as it is."""
    first = judged[0]
    if not first.criterion.overall:
        return first
    one = min(judged, key=lambda j: (j.passed, np.inf if np.isnan(j.margin) else j.margin))
    apart = [j for j in judged if j is not one and j.without]
    told = [f"{j.criterion.output} was not judged on {some_of(j.without)}, without it" for j in apart]
    doubts = [j.doubt for j in (one, *judged) if j.doubt and (j is one or METRICS[one.criterion.metric].of_band)]
    return replace(
        one,
        among=tuple(j.criterion.output for j in judged),
        left_out="; ".join(filter(None, [one.left_out, *told])),
        doubt=doubts[0] if doubts else "",
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


def _bounded(text: str, found: re.Match, signals: Mapping[str, Signal]) -> Criterion:
    output, metric = _named(text, found["what"], signals)
    bound = _si(text, float(found["bound"]), found["unit"], signals[output], metric)
    sides = {"high": bound} if found["sign"] in ("<", "<=") else {"low": bound}
    _require_a_test(text, metric, list(sides.values()), Criterion(text, output, metric, **sides), found["sign"] in "<>")
    written = _written(found["unit"], signals[output], metric)
    return Criterion(text, output, metric, found["group"] or "", **sides, **written)


def _in_range(text: str, found: re.Match, signals: Mapping[str, Signal]) -> Criterion:
    output, metric = _named(text, found["what"], signals)
    unit = found["each"] or found["unit"]  # behind each bound, or behind both
    low, high = (_si(text, float(found[side]), unit, signals[output], metric) for side in ("low", "high"))
    if low > high:
        raise DeclarationError(f"accept: '{text}' holds for nothing: its range ends before it begins. Turn it round.")
    _require_a_test(text, metric, [low, high], Criterion(text, output, metric, low=low, high=high))
    written = _written(unit, signals[output], metric)
    return Criterion(text, output, metric, found["group"] or "", low, high, **written)


def _require_a_test(text: str, metric: str, bounds: Sequence[float], one: Criterion, strict: bool = False) -> None:
    """A bound beyond what a metric can be is met by everything, or by nothing; strict : the bound itself is not met."""
    can = METRICS[metric]
    never = one.low > can.most or one.high < can.least or (strict and (one.low == can.most or one.high == can.least))
    always = one.low <= can.least and one.high >= can.most
    if never or always:
        said = f"holds for {'nothing' if never else 'everything'}"
    elif any(not can.least <= bound <= can.most for bound in bounds):
        said = "has a bound that nothing reaches"
    else:
        return
    way = "Give the size that it may have." if np.isinf(can.most) else "Take a bound inside."
    raise DeclarationError(f"accept: '{text}' {said}: {metric} is {can.span}. {way}")


def _not_worse(text: str, found: re.Match, signals: Mapping[str, Signal]) -> Criterion:
    what = found["what"] or SIZE  # of every output where none is named
    output, metric = (what, SIZE) if what in signals else _named(text, what, signals)
    if metric not in ERRORS:
        raise DeclarationError(f"accept: '{text}' compares no error. Compare one of {', '.join(ERRORS)}.")
    by = float(found["by"] or 0.0) / 100
    if by <= -1:
        raise DeclarationError(
            f"accept: '{text}' holds for nothing: no error is smaller by 100 %. Give a smaller share."
        )
    written, than = _written(None, signals[output], metric, bare=True), other_of(text)
    return Criterion(text, output, metric, found["group"] or "", than=than, by=by, **written)


def _written(unit: str | None, signal: Signal, metric: str, bare: bool = False) -> dict[str, str | float]:
    """The unit of a criterion, as written or as a person reads it, and what one of it is in SI.

    bare : there is no number in it that could have a unit.
    """
    what = METRICS[metric]
    if what.of in (SHARE, PLAIN):
        unit = unit or ("%" if bare and what.percent else "")
        return {"unit": unit, "scale": 0.01 if unit == "%" else 1.0}
    of = "s" if what.of == TIME else signal.unit
    unit = unit or ("ms" if of == "s" else display_units(of)[0])
    return {"unit": "" if unit == "1" else unit, "scale": convert(1.0, unit, of) - convert(0.0, unit, of)}


def _named(text: str, what: str, signals: Mapping[str, Signal]) -> tuple[str, str]:
    output, _, metric = what.rpartition(".")
    if what in METRICS and what not in signals:  # of an overall criterion, with its one output
        return next(iter(signals)), what
    if what not in signals and not output:
        known = nearest(what, [*METRICS, *signals])
        raise DeclarationError(f"accept: '{text}': '{what}' is neither a metric nor an output. {known}")
    if what in signals:
        raise DeclarationError(f"accept: '{text}' names no metric. Write {what}.rmse; known: {', '.join(METRICS)}.")
    if output not in signals:
        raise DeclarationError(f"accept: '{text}': no output '{output}'. {nearest(output, signals)}")
    if metric not in METRICS:
        raise DeclarationError(f"accept: '{text}': no metric '{metric}'. {nearest(metric, METRICS)}")
    return output, metric


def _si(text: str, value: float, unit: str | None, signal: Signal, metric: str) -> float:
    """A bound in SI; a metric of an output is a difference, so that degC counts as K."""
    if unit and unit.startswith(","):
        raise DeclarationError(f"accept: '{text}' has a decimal comma. Write a point.")
    what = METRICS[metric]
    if what.of == SHARE:
        if unit not in (None, "%"):
            raise UnitError(f"accept: '{text}': {metric} is a share, {what.span}. Write it as 5 % or as 0.05.")
        if unit is None and abs(value) > 1:
            raise UnitError(
                f"accept: '{text}': {metric} is a share, {what.span}, and {value:g} without a unit is "
                f"{100 * value:g} %. Write {value:g} % or {value / 100:g}, if that is meant."
            )
        return value / 100 if unit else value
    if what.of == PLAIN and unit:
        raise UnitError(f"accept: '{text}': {metric} is a number. Write {value:g} without a unit.")
    of = {TIME: "s", PLAIN: "1"}.get(what.of, signal.unit)
    if not unit and of == "1":
        return value
    return _converted(text, value, unit, signal.name if of == signal.unit else metric, of)


def _converted(text: str, value: float, unit: str | None, what: str, of: str) -> float:
    """A difference in SI, of what is measured in ``of``."""
    usual = "ms" if of == "s" else display_units(of)[0]
    try:
        fits = bool(unit) and compatible(unit, of)
    except UnitError as error:
        raise UnitError(f"accept: '{text}': {error} {what} is in {usual}.") from None
    if not fits:
        got = f"'{unit}' does not fit" if unit else "a unit is missing"
        share = " A share of the range is nrmse." if unit == "%" else ""
        raise UnitError(f"accept: '{text}': {got}. {what} is in {usual}. Write {value:g} {usual}.{share}")
    return convert(value, unit, of) - convert(0.0, unit, of)
