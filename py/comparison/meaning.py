"""What a criterion means: the parts of a sentence looked up among outputs, metrics and units, and in SI."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from hydrotwin.models.language.errors import DeclarationError, UnitError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible, convert, convert_difference, display_units

from .criteria import Criterion
from .metric import ALSO, ERRORS, METRICS, OF_OUTPUT, PLAIN, SHARE, TIME
from .sentence import IN, THAN, Sentence, taken_apart

SIZE = "rmse"  # what is compared with another model where no metric is named
_APART = re.compile(r"(?:[\s.:/_()\[\]|-]|\b(?:of|abs)\b)+")


def criteria_of(text: str, outputs: Iterable[Signal], every: Iterable[Signal] | None = None) -> tuple[Criterion, ...]:
    """What a sentence says: one criterion, or where it names no output the same for each of ``every``, by default all.

    Raises `DeclarationError` for a sentence that is none, an output or a metric that does not exist, and for one bound
    on outputs in different units; `UnitError` for a unit that the metric of an output cannot be in.
    """
    signals, said = {s.name: s for s in outputs}, taken_apart(text)
    what = said.what or SIZE
    if what not in METRICS or what in signals:
        return (_meant(said, signals),)
    about = list(signals.values() if every is None else every)
    if said.kind != THAN:
        _require_one_unit(text, what, about)
    return tuple(replace(_meant(said, {s.name: s}), overall=True) for s in about)


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


def _require_one_unit(text: str, metric: str, about: Sequence[Signal]) -> None:
    """One bound for errors in bar and in degrees says nothing of which is the worst."""
    if METRICS[metric].of != OF_OUTPUT or len({s.unit for s in about}) < 2:
        return
    shown = ", ".join(f"{s.name} in {display_units(s.unit)[0]}" for s in about)
    raise DeclarationError(
        f"accept: '{text}' names no output, and no one bound fits all: {metric} is in the unit of each ({shown}). "
        f"Write {about[0].name}.{metric}, and one for each output that counts, or judge a share of all: nrmse, fit."
    )


def _meant(said: Sentence, signals: Mapping[str, Signal]) -> Criterion:
    if said.kind == THAN:
        return _not_worse(said, signals)
    output, metric = _named(said, signals)
    bounds = [_si(said, number, signals[output], metric) for number in said.numbers]
    if said.kind == IN:
        sides = dict(zip(("low", "high"), bounds, strict=True))
    else:
        sides = {"high" if said.kind.startswith("<") else "low": bounds[0]}
    one = Criterion(said.text, output, metric, said.group, **sides, strict=said.kind in ("<", ">"))
    if one.low > one.high:
        raise DeclarationError(
            f"accept: '{said.text}' holds for nothing: its range ends before it begins. Turn it round."
        )
    _require_a_test(one, bounds)
    return replace(_bounded(one), **_written(said.unit, signals[output], metric))


def _bounded(one: Criterion) -> Criterion:
    """Without a bound that its metric cannot pass, 0 of an error or 1 of a share: nobody is near to missing that."""
    can = METRICS[one.metric]
    low = -math.inf if one.low <= can.least else one.low
    return replace(one, low=low, high=math.inf if one.high >= can.most else one.high)


def _require_a_test(one: Criterion, bounds: Sequence[float]) -> None:
    """A bound beyond what a metric can be is met by everything, or by nothing."""
    can = METRICS[one.metric]
    never = one.low > can.most or one.high < can.least
    never |= one.strict and (one.low == can.most or one.high == can.least)
    always = one.low <= can.least and one.high >= can.most
    if never or always:
        said = f"holds for {'nothing' if never else 'everything'}"
    elif any(not can.least <= bound <= can.most for bound in bounds):
        said = "has a bound that nothing reaches"
    else:
        return
    way = "Give the size that it may have." if math.isinf(can.most) else "Take a bound inside."
    raise DeclarationError(f"accept: '{one.text}' {said}: {one.metric} is {can.span}. {way}")


def _not_worse(said: Sentence, signals: Mapping[str, Signal]) -> Criterion:
    what = said.what or SIZE  # of every output where none is named
    output, metric = (what, SIZE) if what in signals else _named(replace(said, what=what), signals)
    if metric not in ERRORS:
        raise DeclarationError(f"accept: '{said.text}' compares no error. Compare one of {', '.join(ERRORS)}.")
    if not -1 < said.by < math.inf:
        held = "nothing: no error is smaller by 100 %" if said.by < 0 else "everything: no share is so large"
        raise DeclarationError(f"accept: '{said.text}' holds for {held}. Give a smaller share.")
    written = _written("", signals[output], metric, bare=True)
    return Criterion(said.text, output, metric, said.group, than=said.than, by=said.by, **written)


def _written(unit: str, signal: Signal, metric: str, bare: bool = False) -> dict[str, str | float]:
    """The unit of a criterion, as written or as a person reads it, and what one of it is in SI.

    bare : there is no number in it that could have a unit.
    """
    what = METRICS[metric]
    if what.of in (SHARE, PLAIN):
        unit = unit or ("%" if bare and what.percent else "")
        return {"unit": unit, "scale": 0.01 if unit == "%" else 1.0}
    of = "s" if what.of == TIME else signal.unit
    unit = unit or ("ms" if of == "s" else display_units(of)[0])
    return {"unit": "" if unit == "1" else unit, "scale": convert_difference(1.0, unit, of)}


def _named(said: Sentence, signals: Mapping[str, Signal]) -> tuple[str, str]:
    """The output and the metric of ``what``; of an overall criterion its one output."""
    what = said.what
    output, _, metric = what.rpartition(".")
    if what in METRICS and what not in signals:
        return next(iter(signals)), what
    if what in signals:
        raise DeclarationError(
            f"accept: '{said.text}' names no metric. Write {what}.rmse; known: {', '.join(METRICS)}."
        )
    if output in signals and metric in METRICS:
        return output, metric
    raise DeclarationError(f"accept: '{said.text}': {_unnamed(what, signals)}")


def _unnamed(what: str, signals: Mapping[str, Signal]) -> str:
    """What is wrong with an output and its metric that are not there, and which are meant."""
    told = _turned(what, signals)
    if told and told.casefold() != what.casefold():
        return f"'{what}' is no output with its metric. Write {told}."
    output, _, metric = what.rpartition(".")
    if output in signals:
        return f"no metric '{metric}'. {_nearest_metric(metric)}"
    if output:
        return f"no output '{output}'. {nearest(output, signals)}"
    known = nearest(what, [*METRICS, *signals])
    other = known if known.startswith("Did") else _nearest_metric(what)
    return f"'{what}' is neither a metric nor an output. {other if other.startswith('Did') else known}"


def _turned(what: str, signals: Mapping[str, Signal]) -> str:
    """``rmse(angle)``, ``rmse of angle`` or ``angle rmse`` as ``angle.rmse``; "" for what is none of these."""
    names = {"".join(_APART.split(name)).casefold(): name for name in signals}
    words = [word for word in _APART.split(what) if word]
    for k in range(1, len(words)):
        for metric, rest in ((words[:k], words[k:]), (words[k:], words[:k])):
            name, called = names.get("".join(rest).casefold()), _metric(" ".join(metric))
            if name and called:
                return f"{name}.{called}"
    return ""


def _metric(word: str) -> str:
    """The metric that goes by a word, too; "" for none."""
    plain = word.casefold()
    return plain if plain in METRICS else ALSO.get(plain, "")


def _nearest_metric(word: str) -> str:
    plain = re.sub(r"[_\s-]+", " ", word.casefold()).strip()
    return nearest(ALSO.get(plain, word), METRICS)


def _si(said: Sentence, value: float, signal: Signal, metric: str) -> float:
    """A bound in SI; a metric of an output is a difference, so that degC counts as K."""
    text, unit, what = said.text, said.unit, METRICS[metric]
    if what.of == SHARE:
        if unit not in ("", "%"):
            raise UnitError(f"accept: '{text}': {metric} is a share, {what.span}. {_as_share(value, unit)}")
        if not unit and abs(value) > 1:
            raise UnitError(
                f"accept: '{text}': {metric} is a share, {what.span}, and {value:g} without a unit is "
                f"{100 * value:g} %. Write {value:g} % or {value / 100:g}, if that is meant."
            )
        return value / 100 if unit else value
    if what.of == PLAIN and unit:
        share = value / 100 if unit == "%" else value
        raise UnitError(f"accept: '{text}': {metric} is a number. Write {share:g} without a unit.")
    if what.of == PLAIN:
        return value
    of = "s" if what.of == TIME else signal.unit
    if not unit and of == "1":
        raise UnitError(
            f"accept: '{text}': {signal.name} is a pure number, shown in %, so {value:g} alone may mean {value:g} % or "
            f"{100 * value:g} %. Write {value:g} %, or {value:g} 1."
        )
    return _converted(said, value, signal.name if of == signal.unit else metric, of)


def _as_share(value: float, unit: str) -> str:
    """How a number in another unit than percent is a share."""
    try:
        share = convert(value, unit, "1") if compatible(unit, "1") and not compatible(unit, "rad") else None
    except UnitError:
        share = None
    return "Write it as 5 % or as 0.05." if share is None else f"Write it as {100 * share:g} % or as {share:g}."


def _converted(said: Sentence, value: float, what: str, of: str) -> float:
    """A difference in SI, of what is measured in ``of``."""
    text, unit = said.text, said.unit
    usual = "ms" if of == "s" else display_units(of)[0]
    try:
        fits = bool(unit) and compatible(unit, of)
    except UnitError as error:
        raise UnitError(f"accept: '{text}': {error} {what} is in {usual}.") from None
    if not fits:
        got = f"'{unit}' does not fit" if unit else "a unit is missing"
        share = " A share of the range is nrmse." if unit == "%" else ""
        ways = [usual] if unit else dict.fromkeys([of, usual])  # a number alone may be either
        numbers = ", or ".join(" and ".join(f"{number:g} {way}" for number in said.numbers) for way in ways)
        raise UnitError(f"accept: '{text}': {got}. {what} is in {usual}. Write {numbers}.{share}")
    return convert_difference(value, unit, of)
