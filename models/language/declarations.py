"""What a component declares in its class body: parameters, states, variables, signals, ports and slots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .errors import DeclarationError

Bounds = tuple[float, float]
UNBOUNDED: Bounds = (-np.inf, np.inf)


@dataclass(frozen=True)
class Parameter:
    """A constant of the machine: value in ``unit``, meaning, bounds, scale and source.

    ``value`` may be a function of the component that declares it: the parameter then follows others until somebody
    gives it a number of its own. ``free`` marks it for identification by default.
    """

    value: float | Callable
    unit: str
    description: str = ""
    bounds: Bounds = UNBOUNDED
    nominal: float | None = None
    source: str = ""
    free: bool = False

    def __post_init__(self):
        if not callable(self.value) and not self.bounds[0] <= self.value <= self.bounds[1]:
            low, high = self.bounds
            raise DeclarationError(
                f"Parameter '{self.description}': value outside its bounds (got {self.value:g} {self.unit}). "
                f"It must lie in [{low:g}, {high:g}]. Correct the value or widen the bounds."
            )


@dataclass(frozen=True)
class State:
    """A quantity with memory. ``start`` is a number or a function of the component.

    With ``fixed=False`` the start value is found from the initial equations (static equilibrium) and ``start`` is
    only the first guess.
    """

    start: float | Callable
    unit: str
    description: str = ""
    nominal: float = 1.0
    bounds: Bounds = UNBOUNDED
    fixed: bool = True


@dataclass(frozen=True)
class Variable:
    """An algebraic unknown. ``start`` is the first guess where a nonlinear loop must be solved for it."""

    unit: str
    description: str = ""
    nominal: float = 1.0
    start: float = 0.0


@dataclass(frozen=True)
class Input:
    """A signal that comes from outside. At the top of a model it is an input of the model.

    ``interpolation`` says what it does between samples, "hold" or "linear"; None leaves that to the recordings.
    """

    unit: str
    description: str = ""
    nominal: float = 1.0
    interpolation: str | None = None
    default: float = 0.0

    def __post_init__(self):
        if self.interpolation not in (None, "hold", "linear"):
            raise DeclarationError(
                f"Input '{self.description}': unknown interpolation (got '{self.interpolation}'). "
                "Use 'hold' for a command that is kept between samples or 'linear' for a measured quantity."
            )


@dataclass(frozen=True)
class Output:
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
                f"Slot({kind.__name__}): the default is no {kind.__name__} (got {type(default).__name__}). "
                f"Give an instance of a subclass of {kind.__name__}."
            )
        self.kind = kind
        self.default = default
