"""How the parameters of an effect, shares and sentences are written in a gap report."""

from __future__ import annotations

import math

import numpy as np

from hydrotwin.discovery.answer.discovery import EffectParameter

from .format import NONE, number_text, pretty_unit, shown_unit, to_shown, with_unit


def parameter_unit(p: EffectParameter) -> str:
    """The unit that a parameter of an effect is shown in; times under half a second in ms."""
    if p.unit == "s" and abs(p.value) < 0.5:
        return "ms"
    return shown_unit(p.unit, peak=abs(p.value))


def value_texts(p: EffectParameter) -> tuple[str, str, str]:
    """Value, lower and upper limit in the shown unit with the digits that the interval gives sense to."""
    unit = parameter_unit(p)
    value, low, high = (float(to_shown(v, p.unit, unit)) for v in (p.value, p.low, p.high))
    reach = (high - low) / 2
    digits = 3
    if math.isfinite(reach) and math.isfinite(value) and reach > 0.0 and value != 0.0:
        digits = min(6, max(3, 1 + math.ceil(math.log10(abs(value) / reach))))
    return number_text(value, digits), number_text(low, digits), number_text(high, digits)


def value_text(p: EffectParameter) -> str:
    """The value with its unit."""
    return with_unit(value_texts(p)[0], parameter_unit(p)).replace(" ", "\u00a0")


def interval_words(p: EffectParameter) -> str:
    """The 95 % interval in brackets."""
    _, low, high = value_texts(p)
    if not (math.isfinite(p.low) and math.isfinite(p.high)):
        return " (on its limit)" if p.at_bound else " (interval not known)"
    return f" (95\u00a0%: {low} to {high})"


def typical_text(p: EffectParameter) -> str:
    """The typical range of the catalogue in the shown unit."""
    if p.typical is None:
        return NONE
    unit = parameter_unit(p)
    low, high = (number_text(float(to_shown(v, p.unit, unit))) for v in p.typical)
    return f"{low} to {high}"


def typical_remark(p: EffectParameter) -> str:
    """That a value lies outside its typical range, when even its interval does; else empty."""
    if p.typical is None:
        return ""
    low = p.low if math.isfinite(p.low) else p.value
    high = p.high if math.isfinite(p.high) else p.value
    if p.value < 0.0 <= p.typical[0]:  # a size with a sign: its range is that of the size
        low, high = -high, -low
    if high < p.typical[0]:
        return "below its typical range"
    return "above its typical range" if low > p.typical[1] else ""


def capital(text: str) -> str:
    """A text at the start of a sentence: with a capital, unless it starts with the path of a quantity.

    >>> capital("no input moves."), capital("arm_angle is off."), capital("motor.gain is known.")
    ('No input moves.', 'arm_angle is off.', 'motor.gain is known.')
    """
    first = text.split(" ", 1)[0].rstrip(".:,")
    return text if "_" in first or "." in first else text[:1].upper() + text[1:]


def largest(values: np.ndarray) -> float:
    """The largest magnitude among the values that exist; 0 without any."""
    known = np.abs(np.asarray(values, float))
    known = known[np.isfinite(known)]
    return float(known.max()) if len(known) else 0.0


def unit_label(unit: str) -> str:
    """`` [unit]`` for an axis or heading, empty without a unit."""
    label = pretty_unit(unit)
    return f" [{label}]" if label else ""
