"""Units: what a unit string means, its SI form, and conversion between strings of one dimension.

A unit string is a product of symbols with exponents: ``m3/(s.Pa)``, ``rad/(s.V)``, ``m3/(s.sqrt(Pa))``, ``L/min``,
``%``, ``1``. A dot (or ``*``, ``·``, a space) multiplies; after a ``/`` a product needs brackets, as in Modelica.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import product

import numpy as np

from .errors import UnitError
from .unit_symbols import right_symbol, symbol_table

BASE_UNITS = ("m", "kg", "s", "A", "K", "mol", "cd")
_BASE_NAMES = ("length", "mass", "time", "current", "temperature", "substance", "luminosity")

_PER_MINUTE = {"min": Fraction(-1)}  # DIN and Modelica libraries count revolutions so; a rate is in 1/s
DELTA = "delta_"  # before a temperature: a difference of two
_ZERO_POINT = {"degC": 273.15, "°C": 273.15, "degF": 459.67 / 1.8, "°F": 459.67 / 1.8}  # K at 0 of a bare temperature

_DISPLAY = {
    "Pa": ("bar", "MPa", "kPa", "psi"), "rad": ("deg",), "rad/s": ("rpm", "deg/s"), "rad/s2": ("deg/s2",),
    "m": ("mm", "cm"), "m/s": ("mm/s",), "m/s2": ("m/s2",), "m2": ("mm2", "cm2"), "m3": ("L", "cm3"),
    "m3/s": ("L/min", "cm3/s"), "m3/rad": ("cm3/rev",), "N": ("kN",), "1": ("%",), "s": ("s", "ms"), "kg": ("kg", "t"),
    "W": ("kW",), "J": ("kJ",), "K": ("K", "degC"), "Pa/s": ("bar/s",), "m3/(s.Pa)": ("L/(min.bar)",), "A": ("A", "mA"),
}  # fmt: skip

_GAUGE = re.compile(
    r"\b([mk]?bar|[kM]?Pa|psi) *(?:\( *(g|rel|ü|a|abs) *\)|(?:[ _]|(?=[üga]\b))(g|rel|ü|a|abs)\b)", re.I
)
_TEMPERATURE = re.compile(r"(?:grad|degrees?|deg) *(c|f)(?:elsius|ahrenheit)?", re.IGNORECASE)
_TOKEN = re.compile(
    r"(?P<sqrt>sqrt\()|(?P<open>\()|(?P<close>\))|(?P<over>/)|(?P<power>\*\*|\^)|(?P<times>[.*·⋅ ])"
    r"|(?P<number>[-+]?\d+)|(?P<symbol>delta_deg[CF]|[A-Za-zμΩ°%‰]+)"
)


@dataclass(frozen=True)
class Unit:
    """A unit string understood: ``value_si = factor * value + offset`` in the unit ``si``, with base exponents."""

    text: str
    si: str
    factor: float
    offset: float
    dimension: tuple[Fraction, ...]


@cache
def parse_unit(unit: str) -> Unit:
    """Understand a unit string; the answer is cached.

    Raises `UnitError` naming the nearest known symbol when one is not known.

    >>> parse_unit("L/min").si
    'm3/s'
    """
    if isinstance(unit, str) and (found := _TEMPERATURE.fullmatch(unit.strip())) and unit not in symbol_table():
        raise UnitError(f"unit '{unit}': not known. For a temperature write deg{found[1].upper()} in one word.")
    powers = _Reader(unit).read()
    for degree, scale in product(("deg", "°"), ("C", "F")):
        if degree in powers and powers.get(scale) == powers[degree]:
            raise UnitError(f"unit '{unit}': a degree times {scale}. For a temperature write deg{scale} in one word.")
    return _unit(unit, {"rpm": Fraction(1)} if powers == _PER_MINUTE else powers)


def _unit(unit: str, powers: Mapping[str, Fraction]) -> Unit:
    factor, dimension = 1.0, (Fraction(0),) * 7
    si_powers: dict[str, Fraction] = {}
    for symbol, power in powers.items():
        scale, exponents, si_form = _symbol(symbol)
        factor *= scale ** (int(power) if power.denominator == 1 else float(power))
        dimension = tuple(d + power * e for d, e in zip(dimension, exponents, strict=True))
        for si_symbol, si_power in si_form.items():
            si_powers[si_symbol] = si_powers.get(si_symbol, Fraction(0)) + power * si_power
    offset = _ZERO_POINT.get(next(iter(powers)), 0.0) if list(powers.values()) == [1] else 0.0
    return Unit(unit, _write(si_powers), factor, offset, dimension)


def to_si(values, unit: str):
    """Values in SI and the SI unit: ``(values_si, si_unit)``. Arrays stay arrays, numbers become floats.

    >>> to_si(2.0, "bar")
    (200000.0, 'Pa')
    """
    known = parse_unit(unit)
    return _scaled(values, known.factor, known.offset), known.si


def from_si(values, unit: str):
    """Values given in SI, expressed in ``unit``.

    >>> from_si(200000.0, "bar")
    2.0
    """
    known = parse_unit(unit)
    values = np.asarray(values, dtype=float) if not np.isscalar(values) else float(values)
    return (values - known.offset) / known.factor


def convert(values, from_: str, to: str):
    """Values in ``from_`` expressed in ``to``; `UnitError` when the two are not `compatible`.

    >>> convert(60.0, "1/min", "rev/s"), convert(60.0, "1/min", "1/s")
    (1.0, 1.0)
    """
    if from_ == to:
        return _scaled(values, 1.0, 0.0)
    if not compatible(from_, to):
        kinds = describe(from_), describe(to)
        got = f"got {kinds[0]}, not {kinds[1]}" if kinds[0] != kinds[1] else "only one of them holds an angle"
        raise UnitError(f"unit '{from_}': cannot become '{to}' ({got}). {way_out(from_, to)}")
    one = _meant(from_, to)
    return from_si(_scaled(values, one.factor, one.offset), to)


def convert_difference(values, from_: str, to: str):
    """A difference in ``from_`` expressed in ``to``: as `convert`, whatever the zeros of the units are.

    >>> convert_difference(0.2, "degC", "K"), convert_difference(0.9, "degF", "K")
    (0.2, 0.5)
    """
    convert(0.0, from_, to)  # whether it can be
    factor = 1.0 if from_ == to else _meant(from_, to).factor / parse_unit(to).factor
    return _scaled(values, factor, 0.0)


def si_unit(unit: str) -> str:
    """The SI form of a unit: bar -> Pa, rpm -> rad/s, cm3/rev -> m3/rad, % -> 1, m3/(s.sqrt(Pa)) -> itself."""
    return parse_unit(unit).si


def dimension(unit: str) -> tuple[Fraction, ...]:
    """Exponents of m, kg, s, A, K, mol, cd; angles and ratios are dimensionless.

    >>> [int(e) for e in dimension("N.s/m")]
    [0, 1, -1, 0, 0, 0, 0]
    """
    return parse_unit(unit).dimension


@cache
def compatible(from_: str, to: str) -> bool:
    """Whether values in ``from_`` can be expressed in ``to``.

    They need one dimension, and the angle must not be left out where that could hide a factor of 2 pi: 1/s and Hz are
    no angular speed, m3 is no displacement per angle. 1/min is revolutions per minute where ``to`` holds an angle.
    """
    one, two = _meant(from_, to), parse_unit(to)
    return one.dimension == two.dimension and not _hides_turns(one, two)


def describe(unit: str) -> str:
    """The dimension of a unit in words: ``'mass length^-1 time^-2'``, or ``'dimensionless'``."""
    words = [
        name if power == 1 else f"{name}^{power}"
        for name, power in zip(_BASE_NAMES, dimension(unit), strict=True)
        if power
    ]
    return " ".join(words) or "dimensionless"


def is_difference(unit: str) -> bool:
    """Whether a unit says that only differences count, whatever the zero of the scale is.

    >>> is_difference("delta_degC"), is_difference("degC"), is_difference("K")
    (True, False, False)
    """
    return unit.startswith(DELTA)


def display_units(unit: str) -> tuple[str, ...]:
    """Units a person reads this quantity in, best first: Pa -> bar, rad -> deg, m -> mm. Never empty."""
    si = si_unit(unit)
    return _DISPLAY.get(si, (si,))


def modelica_unit(unit: str) -> str:
    """The SI form in Modelica's unit grammar; ``""`` (unspecified) where that has no word for it.

    Modelica exponents are integers, so ``m3/(s.sqrt(Pa))`` has none.
    Source: Modelica Language Specification 3.6, chapter 19.
    """
    si = si_unit(unit)
    return "" if "sqrt" in si or "^" in si else re.sub(r"\bohm\b", "Ohm", re.sub(r"\bohm(?=\d)", "Ohm", si))


def known_symbols() -> tuple[str, ...]:
    """Every symbol a unit string may contain."""
    return tuple(symbol_table())


def _scaled(values, factor: float, offset: float):
    if np.isscalar(values):
        return float(values) * factor + offset
    values = np.asarray(values, dtype=float)
    return values * factor + offset if offset else values * factor


@cache
def _meant(from_: str, to: str) -> Unit:
    """``from_`` understood for a conversion to ``to``: a bare 1/min counts turns, unless ``to`` holds no angle."""
    unit = parse_unit(from_)
    rate = not _power("rad", parse_unit(to).si) and counts_turns_or_not(from_)
    return _unit(from_, _PER_MINUTE) if rate else unit


@cache
def _hides_turns(one: Unit, two: Unit) -> bool:
    """Whether one of two units of one dimension leaves an angle out, so that it may count turns or radians.

    An arc is a length (m.rad/s is m/s), and mechanics leaves "per radian" out (N.m/rad is N.m, V.s/rad is N.m/A), as
    long as time is in seconds.
    """
    angles = _power("rad", one.si), _power("rad", two.si)
    if angles[0] == angles[1]:
        return False
    with_angle, without = (one, two) if angles[0] else (two, one)
    if max(angles) > 0:
        return not _power("m", with_angle.si)
    return not with_angle.dimension[1] or not {"min", "h"}.isdisjoint(_Reader(without.text).read())


def counts_turns_or_not(unit: str) -> bool:
    """Whether what a unit means depends on what is needed: 1/min is revolutions, or a rate where no angle is."""
    return _Reader(unit).read() == _PER_MINUTE


def power(symbol: str, unit: str) -> Fraction:
    """The exponent of a symbol in the SI form of a unit: 1 for rad in rpm."""
    return _power(symbol, parse_unit(unit).si)


def _power(symbol: str, si: str) -> Fraction:
    return _Reader(si).read().get(symbol, Fraction(0))


def way_out(unit: str, needed: str) -> str:
    """What to write instead of a unit that is not the one needed."""
    if dimension(unit) != dimension(needed):
        return f"Write it in {', '.join(dict.fromkeys((si_unit(needed), *display_units(needed))))}."
    if _power("rad", parse_unit(needed).si) and dimension(needed) == dimension("1/s"):
        return f"'{unit}' does not say whether it counts radians or turns: write rad/s, rpm or rev/s."
    if _power("rad", parse_unit(needed).si):
        return f"'{unit}' leaves the angle out: write rad, deg or rev into it, as in '{needed}'."
    return f"'{needed}' holds no angle: write a unit without rad, deg or rev (for a rate 1/s or Hz)."


@cache
def _registry():
    import pint

    return pint.UnitRegistry(cache_folder=None)


@cache
def _symbol(symbol: str) -> tuple[float, tuple[Fraction, ...], dict[str, Fraction]]:
    """Factor to SI, base exponents and SI form of one symbol."""
    pint_name, si_form = symbol_table()[symbol]
    quantity = _registry().Quantity(1.0, pint_name).to_base_units()
    exponents = {str(name): power for name, power in dict(quantity.unit_items()).items()}
    base = ("meter", "kilogram", "second", "ampere", "kelvin", "mole", "candela")
    dims = tuple(Fraction(exponents.get(name, 0)).limit_denominator(12) for name in base)
    powers = {symbol: Fraction(1)} if si_form == symbol else _Reader(si_form).read()
    return float(quantity.magnitude), dims, powers


def _write(powers: dict[str, Fraction]) -> str:
    """``{"m": 3, "s": -1, "Pa": -1/2}`` -> ``m3/(s.sqrt(Pa))``."""
    above = [_factor(s, p) for s, p in powers.items() if p > 0]
    below = [_factor(s, -p) for s, p in powers.items() if p < 0]
    top = ".".join(above) or "1"
    if not below:
        return top
    return f"{top}/{below[0]}" if len(below) == 1 else f"{top}/({'.'.join(below)})"


def _factor(symbol: str, power: Fraction) -> str:
    if power.denominator == 1:
        return symbol if power == 1 else f"{symbol}{power}"
    if power.denominator == 2:
        return f"sqrt({_factor(symbol, power * 2)})"
    return f"{symbol}^({power})"


def _plain(unit: str) -> str:
    """The text with one character for each meaning: superscripts as digits, one micro sign, one minus."""
    return unicodedata.normalize("NFKC", unit).strip().replace("\N{MINUS SIGN}", "-")


def _over_what(found: re.Match) -> str:
    """A unit of pressure with what it counts from: g over the ambient one, a over none."""
    letter = "a" if (found[2] or found[3]).lower() in ("a", "abs") else "g"
    return f"{found[1]}{letter}"


class _Reader:
    """Recursive descent over one unit string."""

    def __init__(self, unit: str):
        self.unit = unit
        if not isinstance(unit, str):
            raise UnitError(f"unit: not text (got {unit!r}). Write a string such as 'bar' or 'm3/s', '1' for none.")
        text = _GAUGE.sub(_over_what, _plain(unit))  # of a pressure over the ambient one, and no gram
        text = re.sub(r"\s*([/.*·⋅()])\s*", r"\1", text) or "1"
        text = f"1{text}" if text.startswith("/") else text
        self.tokens = self._split("1" if text == "-" else text)
        self.place = 0

    def read(self) -> dict[str, Fraction]:
        powers = self._product()
        if self.place < len(self.tokens):
            self._fail(f"unexpected '{self.tokens[self.place][1]}'")
        return {symbol: power for symbol, power in powers.items() if power}

    def _split(self, text: str) -> list[tuple[str, str]]:
        tokens, at = [], 0
        while at < len(text):
            match = _TOKEN.match(text, at)
            if not match:
                self._fail(f"unexpected '{text[at]}'")
            tokens.append((match.lastgroup, match.group()))
            at = match.end()
        return tokens

    def _peek(self) -> str:
        return self.tokens[self.place][0] if self.place < len(self.tokens) else "end"

    def _next(self) -> tuple[str, str]:
        if self.place >= len(self.tokens):
            self._fail("it ends too early")
        self.place += 1
        return self.tokens[self.place - 1]

    def _product(self) -> dict[str, Fraction]:
        powers = self._operand()
        divided = False
        while self._peek() in ("times", "over"):
            sign = -1 if self._next()[0] == "over" else 1
            if divided and sign > 0:
                self._fail("a product after '/' is ambiguous")
            divided = divided or sign < 0
            for symbol, power in self._operand().items():
                powers[symbol] = powers.get(symbol, Fraction(0)) + sign * power
        return powers

    def _operand(self) -> dict[str, Fraction]:
        kind, text = self._next()
        if kind == "number" and text == "1":
            return {}
        if kind == "symbol":
            if text not in symbol_table():
                whole = "" if text == self.unit else f" in '{self.unit}'"
                raise UnitError(f"unit '{text}'{whole}: not known. {right_symbol(text)}")
            if re.search("[*/]", symbol_table()[text][0]) and self._peek() in ("number", "power"):
                self._fail(f"an exponent behind the product '{text}' is ambiguous")
            return {text: self._exponent()}
        if kind in ("open", "sqrt"):
            inner = self._product()
            if self._next()[0] != "close":
                self._fail("a bracket is not closed")
            power = (Fraction(1, 2) if kind == "sqrt" else Fraction(1)) * self._exponent()
            return {symbol: p * power for symbol, p in inner.items()}
        self._fail(f"unexpected '{text}'")

    def _exponent(self) -> Fraction:
        if self._peek() == "power":
            self._next()
            if self._peek() == "open":
                return self._fraction()
        elif self._peek() != "number":
            return Fraction(1)
        kind, text = self._next()
        if kind != "number":
            self._fail(f"'{text}' is not an exponent")
        return Fraction(int(text))

    def _fraction(self) -> Fraction:
        kinds = [self._next() for _ in range(5)]
        if [k for k, _ in kinds] != ["open", "number", "over", "number", "close"] or int(kinds[3][1]) == 0:
            self._fail("an exponent in brackets is a fraction such as ^(1/2)")
        return Fraction(int(kinds[1][1]), int(kinds[3][1]))

    def _fail(self, reason: str):
        raise UnitError(f"unit '{self.unit}': {reason}. Write a product such as 'm3/(s.Pa)', 'N.s/m' or '1'.")
