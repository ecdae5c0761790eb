"""How numbers and units are written: one way, in the page, the Markdown and the JSON."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.errors import UnitError
from hydrotwin.models.language.units import compatible, convert, convert_difference

_SHOWN = {
    "Pa": "bar",
    "rad": "deg",
    "m": "mm",
    "m/s": "mm/s",
    "m2": "cm2",
    "m3": "cm3",
    "m3/s": "L/min",
    "m3/rad": "cm3/rev",
    "m3/(s.Pa)": "mL/(min.bar)",
    "Pa/s": "bar/s",
}
_FAST = 15.0  # rad/s: above this an engineer reads rpm, below deg/s
NONE = "–"


def shown_unit(unit: str, *, preferred: str | None = None, peak: float = 0.0) -> str:
    """The unit an engineer reads: ``preferred`` (that of the file) when it fits, else bar, deg, mm, rpm, ...

    >>> shown_unit("Pa"), shown_unit("rad/s", peak=300.0), shown_unit("kg")
    ('bar', 'rpm', 'kg')
    """
    if preferred and _fits(preferred, unit):
        return preferred
    if unit == "rad/s":
        return "rpm" if peak > _FAST else "deg/s"
    chosen = _SHOWN.get(unit, unit)
    return chosen if _fits(chosen, unit) else unit


def to_shown(values, unit: str, shown: str) -> np.ndarray:
    """Values in SI in the shown unit."""
    values = np.asarray(values, float)
    return values if shown == unit else np.asarray(convert(values, unit, shown), float)


def difference_to_shown(values, unit: str, shown: str) -> np.ndarray:
    """Differences (errors, sigmas) in SI in the shown unit: as `to_shown` without the zero point of the unit."""
    return np.asarray(convert_difference(np.asarray(values, float), unit, shown), float)


def pretty_unit(unit: str) -> str:
    """A unit as printed: ``m3/(s.Pa)`` is ``m³/(s·Pa)``; dimensionless is empty.

    >>> pretty_unit("m3/(s.Pa)"), pretty_unit("1")
    ('m³/(s·Pa)', '')
    """
    if unit in ("1", ""):
        return ""
    raised = re.sub(r"(?<=[A-Za-z])(-?\d)", lambda m: m[1].translate(str.maketrans("-123456789", "⁻¹²³⁴⁵⁶⁷⁸⁹")), unit)
    return raised.replace(".", "·").replace("deg", "°")


def number_texts(values: Sequence[float], digits: int = 3, decimals: int | None = None) -> list[str]:
    """Numbers of one column as text: the same decimals for all, ``digits`` significant ones for the smallest.

    A column that spans more than four decades gets significant digits for each number instead.

    >>> number_texts([0.01234, 1.5, float("nan")])
    ['0.0123', '1.5000', '–']
    """
    decimals = common_decimals(values, digits) if decimals is None else decimals
    if decimals is None:
        return [number_text(v, digits) for v in values]
    return [_spaced(f"{v:.{decimals}f}").replace("-", "−") if _finite(v) else number_text(v) for v in values]


def common_decimals(values: Sequence[float], digits: int = 3) -> int | None:
    """Decimals that give the smallest number ``digits`` significant ones; None when the numbers span too much."""
    sizes = [abs(v) for v in values if _finite(v) and v != 0.0]
    if not sizes:
        return None
    low, high = min(sizes), max(sizes)
    if high >= 1e6 or low < 1e-4 or high / low > 1e4:
        return None
    return max(0, min(digits - 1 - math.floor(math.log10(low)), 6 - max(0, math.floor(math.log10(high)))))


def number_text(value: float | None, digits: int = 3) -> str:
    """One number with ``digits`` significant digits (all those before the point up to 9999).

    Very large and small ones get a power of ten, thousands from 10 000 on a narrow space.

    >>> number_text(1234.5), number_text(3.2e-9), number_text(float("inf"))
    ('1234', '3.20e−9', '∞')
    """
    if value is None or math.isnan(value):
        return NONE
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 6:
        rounded = round(value, digits - 1 - exponent) if exponent >= 4 else value
        text = _spaced(f"{rounded:.{max(0, digits - 1 - exponent)}f}")
    else:
        mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
        text = f"{mantissa}e{int(power)}"
    return text.replace("-", "−")


def margin_text(ratio: float) -> str:
    """How much smaller one number is than ``ratio`` times itself: in percent when close, else "n times".

    >>> margin_text(1.25), margin_text(3.42), margin_text(27.4)
    ('20 %', '3.4 times', '27 times')
    """
    if ratio < 1.5:
        return f"{100.0 * (1.0 - 1.0 / ratio):.0f} %"
    return f"{ratio:.1f} times" if ratio < 10 else f"{_spaced(f'{ratio:.0f}')} times"


def with_unit(text: str, unit: str) -> str:
    """A number with its unit in a sentence.

    >>> with_unit("0.012", "deg"), with_unit("3", "bar"), with_unit("3", "1")
    ('0.012°', '3 bar', '3')
    """
    label = pretty_unit(unit)
    return f"{text}{label}" if label == "°" else f"{text} {label}".rstrip()


def _spaced(text: str) -> str:
    """Groups of three digits before the point, from five digits on; no minus before zero."""
    if text.startswith("-") and not text.strip("-0."):
        text = text[1:]
    whole, point, fraction = text.partition(".")
    grouped = f"{int(whole):,}".replace(",", "\u202f") if len(whole.lstrip("-")) > 4 else whole
    return f"{grouped}{point}{fraction}"


def _finite(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def _fits(unit: str, si: str) -> bool:
    try:
        return compatible(unit, si)
    except UnitError:
        return False
