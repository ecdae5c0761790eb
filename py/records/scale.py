"""Scale: what one unit of a column stands for, ``command=0.05 V/%``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DataError, UnitError
from hydrotwin.models.language.quantities import apart
from hydrotwin.models.language.units import parse_unit, si_unit, to_si

_FORM = "Write --scale command=0.05 V/%."


@dataclass(frozen=True)
class Scale:
    """A factor with unit for one column: value [V] = factor [V/%] * column [%]."""

    column: str
    factor: float
    unit: str

    def apply(self, values: np.ndarray, unit: str) -> tuple[np.ndarray, str]:
        """Values in SI times the factor in SI, and the SI unit of the product."""
        factor, own = to_si(self.factor, self.unit)
        return values * factor, si_unit(f"({own}).({unit})")


def parse_scale(text: str) -> Scale:
    """``"command=0.05 V/%"`` -> Scale; a unit left out is 1.

    >>> parse_scale("command=0.05 V/%")
    Scale(column='command', factor=0.05, unit='V/%')
    """
    column, equals, rest = text.partition("=")
    found = apart(rest)
    if not (equals and column.strip() and found):
        raise DataError(f"scale: not understood (got '{text}'). {_FORM}")
    factor, unit = found
    try:
        si_unit(unit or "1")
    except UnitError as error:
        raise UnitError(f"scale: '{text}': {error}") from None
    if zero := next((u for u in re.split(r"[*/.\u00b7^()\s]+", unit) if _has_zero(u)), None):
        raise DataError(
            f"scale: {zero} has a zero of its own, which a factor cannot give (got '{text}'). Write K for differences "
            f"of temperature; a temperature needs the column in {zero}."
        )
    if factor == 0:
        raise DataError(f"scale: the factor of '{column.strip()}' must not be zero (got '{text}'). {_FORM}")
    return Scale(column.strip(), factor, unit or "1")


def _has_zero(unit: str) -> bool:
    try:
        return bool(parse_unit(unit).offset)
    except UnitError:
        return False


def scales_of(scale: Mapping[str, str | Scale] | Sequence[str | Scale] | str | None) -> dict[str, Scale]:
    """Every accepted way to give scales, as ``column -> Scale``: texts, Scales, or a mapping column -> "0.05 V/%"."""
    if scale is None:
        return {}
    if isinstance(scale, str | Scale):
        scale = [scale]
    if isinstance(scale, Mapping):
        scale = [s if isinstance(s, Scale) else f"{column}={s}" for column, s in scale.items()]
    parsed = [s if isinstance(s, Scale) else parse_scale(s) for s in scale]
    return {s.column: s for s in parsed}
