"""Acceptance criteria: sentences such as ``arm_angle.rmse < 0.2 deg``, and whether they hold.

    [GROUP:] OUTPUT.METRIC < VALUE [UNIT]           also <=, > and >=
    [GROUP:] OUTPUT.METRIC in [LOW, HIGH] [UNIT]
    [GROUP:] OUTPUT[.METRIC] not worse than MODEL [by SHARE %]

GROUP is the name of a recording, or ``tag=value``; without one a criterion is about all recordings together.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, UnitError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible, convert, display_units

from .comparison import mean_known

OF_OUTPUT, SHARE, TIME, PLAIN = "output", "share", "time", "number"  # what a metric is measured in
METRICS: Mapping[str, str] = {
    "rmse": OF_OUTPUT,
    "mae": OF_OUTPUT,
    "max": OF_OUTPUT,
    "bias": OF_OUTPUT,  # its size, whatever its sign
    "nrmse": SHARE,  # of the range of the measurement
    "fit": SHARE,  # the NRMSE fit
    "coverage": SHARE,  # of the measurements, inside the 95 % band
    "r2": SHARE,  # the coefficient of determination
    "theil": SHARE,  # Theil's inequality coefficient
    "iso18571": SHARE,  # the overall rating of ISO/TS 18571
    "lag": TIME,  # its size: how late or early the prediction is
    "steady": OF_OUTPUT,  # its size: the mean error where inputs and measurement rest
    "vv20": PLAIN,  # RMSE over the validation uncertainty of ASME V&V 20
}
SIZED = ("bias", "lag", "steady")  # judged by their size, whatever their sign
SCORED: Mapping[str, str] = {"rmse": "rmse", "mae": "mae", "max": "maximum", "bias": "bias", "fit": "fit_percent"} | {
    name: name for name in ("r2", "theil", "iso18571", "lag", "steady", "vv20", "coverage")
}  # metric -> field of a `Score`
BEST = ("fit", "r2", "iso18571", "coverage")  # the larger the better
OF_BAND = ("coverage", "vv20")  # a model without a band has none
ERRORS = ("rmse", "mae", "max", "bias", "nrmse", "theil", "lag", "steady", "vv20")  # the smaller the better
UNDEFINED: Mapping[str, str] = {
    "r2": "the measurement does not move",
    "fit": "the measurement does not move",
    "nrmse": "the measurement does not move",
    "theil": "the measurement does not move",
    "iso18571": "a curve does not move or is too short, or the mode is not free run",
    "lag": "a curve does not move, or they do not correlate best within a fifth of the recording",
    "steady": "inputs and measurement never rest together",
    "vv20": "the model has no band there",
    "coverage": "the model has no band there",
}
SIZE, NUMBER = "rmse", r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
FEWEST = 50  # samples that a criterion should be judged on, as many as a start is estimated from; fewer are told
EXAMPLES = "'position.rmse < 2 mm', 'position.fit > 90 %', 'position.coverage in [0.9, 0.99]'"
_WHERE = r"\s*(?:(?P<group>[^:]+?)\s*:\s*)?"
_BOUND = re.compile(rf"{_WHERE}(?P<what>[^<>]+?)\s*(?P<sign><=|>=|<|>)\s*(?P<bound>{NUMBER})\s*(?P<unit>\S.*?)?\s*$")
_RANGE = re.compile(
    rf"{_WHERE}(?P<what>\S.*?)\s+in\s*\[\s*(?P<low>{NUMBER})\s*(?P<each>[^\s,\]][^,\]]*?)?\s*,\s*(?P<high>{NUMBER})\s*"
    r"(?(each)(?P=each)\s*\]|\]\s*(?P<unit>\S.*?)?)\s*$"
)
_THAN = re.compile(
    rf"{_WHERE}(?P<what>\S.*?)\s+not\s+worse\s+than\s+(?P<than>.+?)(?:\s+by\s+(?P<by>{NUMBER})\s*%)?\s*$"
)


LIMITS = {"coverage": (0.0, 1.0), "iso18571": (0.0, 1.0), "fit": (-np.inf, 1.0), "r2": (-np.inf, 1.0)}  # of metrics


@dataclass(frozen=True)
class Criterion:
    """One sentence, understood.

    text : as written. group : "" for all recordings. low, high : SI, or a share of 1; both are allowed themselves.
    than : the model that must not be better, ``by`` : the share that it may be. unit : that it is written in, or else
    read in; scale : one of it, in SI.
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

    def as_written(self, value: float) -> float:
        """A number of it (SI, or a share of 1) in ``unit``."""
        return value / self.scale


@dataclass(frozen=True)
class Judged:
    """A criterion with what was found.

    value : SI or a share of 1. low, high : what it had to lie in. margin : how far inside, over the size of the bound;
    negative outside. reason : why a recording left no number, in a sentence; what has none passes nothing.
    samples : that it was judged on, None where nobody counted. without : recordings it is about that do not hold the
    output, so that it was judged on the others.
    """

    criterion: Criterion
    value: float
    low: float
    high: float
    reason: str = ""
    samples: int | None = None
    without: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        return bool(np.isfinite(self.value) and self.low <= self.value <= self.high)

    @property
    def undefined(self) -> str:
        """Why there is no number to judge, in a sentence; empty where there is one."""
        if self.reason:
            return self.reason
        if not np.isnan(self.value):
            one = self.criterion
            return f"{one.than} has no {one.metric} to compare with" if np.isnan(self.high) else ""
        return f"not defined: {UNDEFINED.get(self.criterion.metric, 'nothing was found to judge')}"

    @property
    def caution(self) -> str:
        """What to know before it is relied on; empty where there is nothing."""
        told = [f"not judged on {', '.join(self.without[:3])}{' and others' * (len(self.without) > 3)}, which "
                f"hold{'s' * (len(self.without) == 1)} no {self.criterion.output}"] if self.without else []  # fmt: skip
        if self.samples is not None and self.samples < FEWEST:
            told.append(f"judged on only {self.samples} sample{'s' * (self.samples != 1)}")
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
        return own or float(METRICS[self.criterion.metric] in (SHARE, PLAIN))


def _share_of(room: float, size: float) -> float:
    return room / size if size else float(np.copysign(np.inf, room)) if room else 0.0


def over_recordings(metric: str, values: Sequence[float]) -> float:
    """What a criterion takes of the scores of several recordings: the largest maximum, of those in SIZED the
    mean size (of errors at rest where something rests), else the mean; what is in percent as a share.
    """
    if metric == "max":
        return float(max(values))
    if metric == "steady":
        return mean_known(np.abs(values))
    value = float(np.mean(np.abs(values) if metric in SIZED else values))
    return value / 100 if metric == "fit" else value


def criterion(text: str, outputs: Iterable[Signal]) -> Criterion:
    """The criterion that a sentence says.

    Raises `DeclarationError` for a sentence that is none, an output or a metric that does not exist, `UnitError` for a
    unit that the metric of this output cannot be in.
    """
    signals = {s.name: s for s in outputs}
    for pattern, meant in ((_RANGE, _in_range), (_THAN, _not_worse), (_BOUND, _bounded)):
        if found := pattern.match(text):
            return meant(text, found, signals)
    raise DeclarationError(f"accept: '{text}' is no criterion. Write for example {EXAMPLES}.")


def judge(one: Criterion, value: Callable[[str, str, str, str], float]) -> Judged:
    """Whether it holds. value : what was found for (group, output, metric, model), model "" the one that is judged."""
    found = value(one.group, one.output, one.metric, "")
    found = abs(found) if one.metric in SIZED else found
    if not one.than:
        return Judged(one, found, one.low, one.high)
    other = abs(value(one.group, one.output, one.metric, one.than))
    allowed = other * (1 + one.by) if np.isfinite(other) else np.nan  # nothing is shown by being as good as a failure
    return Judged(one, found, -np.inf, allowed)


def _bounded(text: str, found: re.Match, signals: Mapping[str, Signal]) -> Criterion:
    output, metric = _named(text, found["what"], signals)
    bound = _si(text, float(found["bound"]), found["unit"], signals[output], metric)
    sides = {"high": bound} if found["sign"] in ("<", "<=") else {"low": bound}
    _require_a_test(text, metric, sides.get("low", -np.inf), sides.get("high", np.inf))
    written = _written(found["unit"], signals[output], metric)
    return Criterion(text, output, metric, found["group"] or "", **sides, **written)


def _in_range(text: str, found: re.Match, signals: Mapping[str, Signal]) -> Criterion:
    output, metric = _named(text, found["what"], signals)
    unit = found["each"] or found["unit"]  # behind each bound, or behind both
    low, high = (_si(text, float(found[side]), unit, signals[output], metric) for side in ("low", "high"))
    if low > high:
        raise DeclarationError(f"accept: '{text}' holds for nothing: its range ends before it begins. Turn it round.")
    _require_a_test(text, metric, low, high)
    written = _written(unit, signals[output], metric)
    return Criterion(text, output, metric, found["group"] or "", low, high, **written)


def _require_a_test(text: str, metric: str, low: float, high: float) -> None:
    """A bound beyond what a metric can be is met by everything, or by nothing."""
    least, most = LIMITS.get(metric, (-np.inf, np.inf))
    if low > most or high < least or (metric in LIMITS and low <= least and high >= most):
        holds = "nothing" if low > most or high < least else "everything"
        span = f"{least:g} to {most:g}" if np.isfinite(least) else f"at most {most:g}"
        raise DeclarationError(
            f"accept: '{text}' holds for {holds}: {metric} is {span} ({100 * most:g} %). Take a bound inside."
        )


def _not_worse(text: str, found: re.Match, signals: Mapping[str, Signal]) -> Criterion:
    output, metric = (found["what"], SIZE) if found["what"] in signals else _named(text, found["what"], signals)
    if metric not in ERRORS:
        raise DeclarationError(f"accept: '{text}' compares no error. Compare one of {', '.join(ERRORS)}.")
    by = float(found["by"] or 0.0) / 100
    written, than = _written(None, signals[output], metric), found["than"].strip().strip("\"'")
    return Criterion(text, output, metric, found["group"] or "", than=than, by=by, **written)


def _written(unit: str | None, signal: Signal, metric: str) -> dict[str, str | float]:
    """The unit of a criterion, as written or as a person reads it, and what one of it is in SI."""
    if METRICS[metric] in (SHARE, PLAIN):
        return {"unit": unit or "", "scale": 0.01 if unit == "%" else 1.0}
    of = "s" if METRICS[metric] == TIME else signal.unit
    unit = unit or ("ms" if of == "s" else display_units(of)[0])
    return {"unit": "" if unit == "1" else unit, "scale": convert(1.0, unit, of) - convert(0.0, unit, of)}


def _named(text: str, what: str, signals: Mapping[str, Signal]) -> tuple[str, str]:
    output, _, metric = what.rpartition(".")
    if what in METRICS and what not in signals:
        first = next(iter(signals), "output")
        raise DeclarationError(
            f"accept: '{text}' names no output. Write {first}.{what}, and one for each output that counts: "
            f"{', '.join(signals)}."
        )
    if what in signals or not output:
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
    if METRICS[metric] == SHARE:
        if unit not in (None, "%") or (unit is None and abs(value) > 1):
            raise UnitError(f"accept: '{text}': {metric} is a share. Write it as 5 % or as 0.05.")
        return value / 100 if unit else value
    if METRICS[metric] == PLAIN and unit:
        raise UnitError(f"accept: '{text}': {metric} is a number. Write {value:g} without a unit.")
    if value < 0:
        raise DeclarationError(f"accept: '{text}': {metric} is never negative. Give the size that it may have.")
    of = {TIME: "s", PLAIN: "1"}.get(METRICS[metric], signal.unit)
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
