"""Integer, Boolean and Enumeration variables of an FMU: recordings hold numbers, the FMU takes whole ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from fmpy.model_description import ScalarVariable

from hydrotwin.models.language.errors import DataError

from .fmu_process.master import FLOATS, WHOLE, is_scalar


@dataclass(frozen=True)
class Whole:
    """What such a variable can take: from ``low`` to ``high``, of an enumeration the numbers of its ``items`` alone."""

    kind: str
    low: float
    high: float
    items: Mapping[int, str] = field(default_factory=dict)

    def rounded(self, values: np.ndarray, where: Callable[[int], str]) -> np.ndarray:
        """The whole numbers that ``values`` are to within rounding. DataError where one is none; ``where`` names it."""
        nearest = np.round(values)
        known = np.isin(nearest, list(self.items)) if self.items else (self.low <= nearest) & (nearest <= self.high)
        bad = np.flatnonzero(~(np.abs(values - nearest) <= WHOLE) | ~known)
        if len(bad):
            more = f" ({len(bad)} values are like that)" if len(bad) > 1 else ""
            raise DataError(f"{where(bad[0])} (got {values[bad[0]]:.10g}){more}. Write {self.choices()}.")
        return nearest

    def choices(self) -> str:
        """What can be written, in words."""
        if self.kind == "Boolean":
            return "0 or 1"
        if self.items:
            return ", ".join(f"{number} ({name})" for number, name in self.items.items())
        return f"a whole number from {self.low:.19g} to {self.high:.19g}"


def whole_of(variable: ScalarVariable) -> Whole | None:
    """None for a variable of real numbers or of none."""
    if variable.type in FLOATS or not is_scalar(variable):
        return None
    if variable.type == "Boolean":
        return Whole("Boolean", 0, 1)
    items = getattr(variable.declaredType, "items", None) if variable.type == "Enumeration" else None
    if items:
        return Whole("Enumeration", -np.inf, np.inf, {int(i.value): i.name for i in items})
    size = np.iinfo({"Integer": "int32", "Enumeration": "int64"}.get(variable.type, variable.type.lower()))
    low, high = (int(float(b)) if b not in (None, "") else e for b, e in
                 ((variable.min, size.min), (variable.max, size.max)))  # fmt: skip
    return Whole(variable.type, low, high)
