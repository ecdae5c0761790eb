"""Which parameters are asked about, and over which interval each of them moves."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel, ParameterValue

from ..problem import matching

SIGMAS = 1.959964  # of a normal distribution: 95 % of it
SHARE = 0.1  # of its value: how far a parameter of which nothing is known moves to either side
WIDE = 10.0  # times its lower end: an interval is then walked through in ratios, not in differences
AUTO, FIT, BOUNDS = "auto", "fit", "bounds"
OF_FIT, CUT = "fit, 95 %", ", cut at a bound"  # source of an interval, and what it ends with that is narrower
OF_VALUE = "±"  # what the source of an interval begins with that is a share of the value
_SHARE = re.compile(r"(\d+(?:\.\d+)?)\s*%")


@dataclass(frozen=True)
class Interval:
    """One parameter and where it moves, SI; ``source`` says in words where the interval comes from."""

    name: str
    unit: str
    value: float
    low: float
    high: float
    source: str

    @property
    def logarithmic(self) -> bool:
        """Whether it moves in ratios."""
        return self.low > 0 and self.high > WIDE * self.low

    @property
    def reach(self) -> float:
        """Half the interval in the unit of the parameter; that of its logarithm times the value where it is wide."""
        if self.logarithmic:
            return self.value * 0.5 * float(np.log(self.high / self.low))
        return 0.5 * (self.high - self.low)

    def at(self, share: np.ndarray) -> np.ndarray:
        """Values at shares between 0 and 1 of the interval."""
        if self.logarithmic:
            return self.low * (self.high / self.low) ** share
        return self.low + (self.high - self.low) * share


def intervals(
    flat: FlatModel,
    parameters: Sequence[str] | None = None,
    how: str = AUTO,
    given: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Interval, ...]:
    """The interval of every parameter that matches a glob in ``parameters`` (default: those the model declares free).

    how : "fit" (the value and 1.96 standard deviations of its identification), "bounds" (those of the model), "10%" (of
        the value to either side), or "auto": that of the fit where there is one, else 10 %. All end at the bounds.
    given : by path, SI, in place of it.

    Raises DeclarationError for an unknown parameter, an interval without width, a value outside it, an unknown ``how``.
    """
    given = dict(given or {})
    if not (how in (AUTO, FIT, BOUNDS) or _SHARE.fullmatch(how)):
        raise DeclarationError(
            f"sensitivity: no intervals '{how}'. {nearest(how, (AUTO, FIT, BOUNDS))} A share is written 10%."
        )
    for name in given:
        flat.index_of(name)
    if parameters is None and not any(p.free for p in flat.parameters):
        parameters = list(given) or None
    chosen = matching(flat, parameters, "parameters", "--parameters")
    for name in given:
        if name not in chosen:
            raise DeclarationError(
                f"{flat.name}.{name}: an interval was given, but it is not asked about. Name it in parameters as well."
            )
    return tuple(_checked(flat, p, *_interval(flat, p, how, given)) for p in flat.parameters if p.name in chosen)


def _interval(flat: FlatModel, p: ParameterValue, how: str, given: Mapping) -> tuple[float, float, str]:
    if p.name in given:
        return *map(float, given[p.name]), "given"
    if how == FIT and not p.sigma:
        raise DeclarationError(
            f"{flat.name}.{p.name}: no fit tells how sure it is. Identify the model first, or take intervals 10%."
        )
    if how in (AUTO, FIT) and p.sigma:
        return _around(p, SIGMAS * p.sigma, OF_FIT)
    if how == BOUNDS:
        if not np.isfinite(p.bounds).all():
            raise DeclarationError(
                f"{flat.name}.{p.name}: its bounds are not finite (got {p.bounds[0]:g}, {p.bounds[1]:g}). "
                f"Give its interval: --interval {p.name}=LOW:HIGH."
            )
        return *p.bounds, "bounds"
    share = SHARE if how == AUTO else float(_SHARE.fullmatch(how)[1]) / 100
    around = abs(p.value) or abs(p.nominal)
    return _around(p, share * around, f"{OF_VALUE}{100 * share:g} %" + ("" if p.value else " of its nominal value"))


def _around(p: ParameterValue, reach: float, source: str) -> tuple[float, float, str]:
    """The interval to either side, no wider than the bounds."""
    low, high = max(p.value - reach, p.bounds[0]), min(p.value + reach, p.bounds[1])
    cut = low > p.value - reach or high < p.value + reach
    return low, high, source + (CUT if cut else "")


def _checked(flat: FlatModel, p: ParameterValue, low: float, high: float, source: str) -> Interval:
    if not low < high:
        raise DeclarationError(
            f"{flat.name}.{p.name}: its interval has no width (got {low:g} to {high:g} {p.unit}). "
            f"Give one: --interval {p.name}=LOW:HIGH, or leave the parameter out."
        )
    if not low <= p.value <= high:
        raise DeclarationError(
            f"{flat.name}.{p.name}: its value {p.value:g} {p.unit} lies outside its interval [{low:g}, {high:g}]. "
            "Change one of them."
        )
    return Interval(p.name, p.unit, p.value, low, high, source)
