"""What a component declares in its class body: parameters, states, variables, signals, ports and slots."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from numbers import Real
from typing import ClassVar

import casadi as ca

from .errors import DeclarationError, UnitError
from .flat import INTERPOLATIONS
from .units import Unit, is_difference, parse_unit
from .user_code import Here

Bounds = tuple[float, float]
UNBOUNDED: Bounds = (-math.inf, math.inf)
_EACH = "A quantity is one number: declare each with a name of its own (x_1 = .., x_2 = ..)."
PLACEHOLDER = "signal"  # in a unit: the unit of a signal that is known only where the part is put (effects)


class _Quantity:
    """What has a unit. Whatever unit it is written in, from its declaration on it is in SI, with all its numbers.

    ``written_in`` is the unit it was written in where that was not SI, else "". ``alone`` marks a value that was given
    anew without a unit. ``refused`` says why no model can hold
    it (it is a vector): told where one shall, so that the other models of its file still load.
    """

    points: ClassVar[tuple[str, ...]] = ()  # fields that hold a value in the unit; it may have a zero of its own
    written_in: ClassVar[str] = ""
    alone: ClassVar[bool] = False
    refused: ClassVar[str] = ""

    def __post_init__(self):
        where = Here(type(self).__name__ + (f" {self.description!r}" if self.description else ""))
        known = _unit(where, self.unit)
        for name in self.points:
            value = getattr(self, name)
            if hasattr(value, "__len__") and not isinstance(value, str):
                object.__setattr__(self, "refused", f"{where}: {name} is no number (got {value!r}). {_EACH}")
                return
            if callable(value):
                object.__setattr__(self, name, partial(_number_in_si, value, known) if known else value)
            else:
                number = finite(where, name, value)
                object.__setattr__(self, name, known.factor * number + known.offset if known else number)
        if self.nominal is not None:
            size = finite(where, "nominal", self.nominal)
            if not size > 0:
                raise DeclarationError(
                    f"{where}: the nominal value is no size (got {size:g} {self.unit}). "
                    "Give the usual magnitude, greater than zero; it scales, and changes no equation."
                )
            object.__setattr__(self, "nominal", known.factor * size if known else size)
        if hasattr(self, "bounds"):
            self._settle_bounds(where, known)
        if known and known.si != self.unit:
            if (known.factor, known.offset) != (1.0, 0.0) or is_difference(self.unit):
                object.__setattr__(self, "written_in", self.unit)
            object.__setattr__(self, "unit", known.si)

    def _settle_bounds(self, where: Here, known: Unit | None) -> None:
        low, high = limits(where, self.bounds)
        if known:
            low, high = (known.factor * b + known.offset for b in (low, high))
        object.__setattr__(self, "bounds", (low, high))
        (point,) = self.points
        value = getattr(self, point)
        if not callable(value) and not low <= value <= high:
            value, low, high = ((v - known.offset) / known.factor if known else v for v in (value, low, high))
            raise DeclarationError(
                f"{where}: {point} outside its bounds (got {value:g} {self.unit}). "
                f"It must lie in [{low:g}, {high:g}]. Correct the {point} or widen the bounds."
            )


def _number_in_si(function: Callable, unit: Unit, component):
    """What a function gives for a component: a number is in the unit of the declaration, a quantity is in SI."""
    given = function(component)
    is_number = isinstance(given, Real) and not isinstance(given, bool)
    if not is_number and not (isinstance(given, ca.SX) and given.is_constant() and given.is_scalar()):
        return given
    return unit.factor * float(given) + unit.offset


def _unit(where: Here, unit: str) -> Unit | None:
    """The unit understood; None where it waits for that of a signal."""
    if isinstance(unit, str) and PLACEHOLDER in unit:
        return None
    try:
        return parse_unit(unit)
    except UnitError as error:
        raise UnitError(f"{where}: {error}") from None


def finite(where: Here | str, role: str, value) -> float:
    """A number that is one, or an error that says what else it is."""
    if not isinstance(value, Real) or isinstance(value, bool):
        raise DeclarationError(f"{where}: {role} is no number (got {value!r}). Give a number.")
    if not math.isfinite(value):
        raise DeclarationError(f"{where}: {role} is not finite (got {value}). Give a finite number.")
    return float(value)


def limits(where: Here, bounds) -> Bounds:
    """Lower and upper bound in order; infinite ones are none."""
    try:
        low, high = bounds
        low, high = float(low), float(high)
    except (TypeError, ValueError):
        raise DeclarationError(f"{where}: bounds are no pair of numbers (got {bounds!r}). Write (low, high).") from None
    if not low <= high:
        raise DeclarationError(f"{where}: bounds are in no order (got [{low:g}, {high:g}]). Write (low, high).")
    return low, high


@dataclass(frozen=True)
class Parameter(_Quantity):
    """A constant of the machine: value in ``unit``, meaning, bounds, scale and source.

    ``value`` may be a function of the component that declares it: the parameter then follows others until somebody
    gives it a number of its own. A number that it gives is in ``unit``, what it makes of others is in SI. ``free``
    marks it for identification by default.
    """

    points: ClassVar = ("value",)

    value: float | Callable
    unit: str
    description: str = ""
    bounds: Bounds = UNBOUNDED
    nominal: float | None = None
    source: str = ""
    free: bool = False

    def __post_init__(self):
        super().__post_init__()
        if not isinstance(self.free, bool):
            where = Here(f"Parameter '{self.description}'")
            raise DeclarationError(f"{where}: free is neither True nor False (got {self.free!r}). Give one of them.")


@dataclass(frozen=True)
class State(_Quantity):
    """A quantity with memory. ``start`` is a number or a function of the component.

    With ``fixed=False`` the start value is found from the initial equations (static equilibrium) and ``start`` is
    only the first guess.
    """

    points: ClassVar = ("start",)

    start: float | Callable
    unit: str
    description: str = ""
    nominal: float = 1.0
    bounds: Bounds = UNBOUNDED
    fixed: bool = True


@dataclass(frozen=True)
class Variable(_Quantity):
    """An algebraic unknown. ``start`` is the first guess where a nonlinear loop must be solved for it."""

    points: ClassVar = ("start",)

    unit: str
    description: str = ""
    nominal: float = 1.0
    start: float = 0.0


@dataclass(frozen=True)
class Input(_Quantity):
    """A signal that comes from outside. At the top of a model it is an input of the model.

    ``interpolation`` says what it does between samples, "hold", "linear" or "smooth"; None: as the recordings show.
    """

    points: ClassVar = ("default",)

    unit: str
    description: str = ""
    nominal: float = 1.0
    interpolation: str | None = None
    default: float = 0.0

    def __post_init__(self):
        super().__post_init__()
        if self.interpolation not in (None, *INTERPOLATIONS):
            raise DeclarationError(
                f"{Here()}Input '{self.description}': unknown interpolation (got '{self.interpolation}'). "
                "Use 'hold' for a command that is kept between samples, 'linear' or 'smooth' for a measured quantity."
            )


@dataclass(frozen=True)
class Output(_Quantity):
    """A signal that the component computes. At the top of a model it is an output of the model."""

    unit: str
    description: str = ""
    nominal: float = 1.0


@dataclass(frozen=True)
class Port:
    """A place where energy passes: equal potentials, flows that sum to zero; flow is positive into the component."""

    description: str = ""
    potential: tuple[str, str] = field(default=("", ""), init=False)
    flow: tuple[str, str] = field(default=("", ""), init=False)
    nominals: tuple[float, float] = field(default=(1.0, 1.0), init=False)


@dataclass(frozen=True)
class HydraulicPort(Port):
    """Pressure ``p`` [Pa] and volume flow ``q`` [m3/s] into the component."""

    potential: tuple[str, str] = field(default=("p", "Pa"), init=False)
    flow: tuple[str, str] = field(default=("q", "m3/s"), init=False)
    nominals: tuple[float, float] = field(default=(1e6, 1e-4), init=False)


@dataclass(frozen=True)
class Flange(Port):
    """Position ``s`` [m] and force ``f`` [N] on the component."""

    potential: tuple[str, str] = field(default=("s", "m"), init=False)
    flow: tuple[str, str] = field(default=("f", "N"), init=False)
    nominals: tuple[float, float] = field(default=(0.1, 1e3), init=False)


@dataclass(frozen=True)
class RotationalFlange(Port):
    """Angle ``phi`` [rad] and torque ``tau`` [N.m] on the component."""

    potential: tuple[str, str] = field(default=("phi", "rad"), init=False)
    flow: tuple[str, str] = field(default=("tau", "N.m"), init=False)
    nominals: tuple[float, float] = field(default=(1.0, 1.0), init=False)


@dataclass(frozen=True)
class Shaft(Port):
    """Speed ``w`` [rad/s] and torque ``tau`` [N.m] on the component; for drives whose angle does not matter."""

    potential: tuple[str, str] = field(default=("w", "rad/s"), init=False)
    flow: tuple[str, str] = field(default=("tau", "N.m"), init=False)
    nominals: tuple[float, float] = field(default=(100.0, 1.0), init=False)


@dataclass(frozen=True)
class ElectricPin(Port):
    """Voltage ``v`` [V] and current ``i`` [A] into the component."""

    potential: tuple[str, str] = field(default=("v", "V"), init=False)
    flow: tuple[str, str] = field(default=("i", "A"), init=False)


class Slot:
    """A place for a law, with a default: ``friction = Slot(FrictionLaw, default=Stribeck())``."""

    def __init__(self, kind: type, default):
        if not isinstance(default, kind):
            raise DeclarationError(
                f"{Here()}Slot({kind.__name__}): the default is no {kind.__name__} (got {type(default).__name__}). "
                f"Give an instance of a subclass of {kind.__name__}."
            )
        self.kind = kind
        self.default = default
