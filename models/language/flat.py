"""What a model is once its component tree is gone: one explicit ODE with named, unit-carrying vectors.

    x' = f(t, x, u, p),   y = h(t, x, u, p),   x(0) = x0(u, p)

Everything is in SI. Methods (simulation, identification, export, ...) see a model through this class alone.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import ClassVar

import casadi as ca
import numpy as np

from .errors import DeclarationError, nearest
from .provenance import IDENTIFIED, OF_NO_FIT, lasting
from .quantities import in_si, wanted

SD = ".sd"  # behind the name of an output: the standard deviation that a block gives beside it
SAME = 1e-12  # relative: the same number, read in one unit or another


@dataclass(frozen=True)
class Signal:
    """An input or output: name, SI unit, typical magnitude.

    ``interpolation`` says what an input does between samples: "hold" (a command kept by a D/A converter), "linear"
    or "smooth" (a measured continuous quantity, on a line or on the curve through its samples); None leaves that to
    the recordings, and holds it without any.
    ``chosen_by`` is who says so, "model", "user", "recording" or "fit", and ``why`` the reason in words. ``shift`` [s]:
    its recorded column is taken for so much later than it is stamped. ``dead_time`` names the parameter [s] that delays
    the input, if any. ``written_in`` is the unit in which it is declared, or shown, where that is not SI.
    """

    name: str
    unit: str
    description: str = ""
    nominal: float = 1.0
    interpolation: str | None = "hold"
    dead_time: str | None = None
    default: float = 0.0
    chosen_by: str | None = "model"
    shift: float = 0.0
    why: str = ""
    written_in: str = ""

    @property
    def held(self) -> bool:
        """Whether it stays where it is between its samples."""
        return self.interpolation not in ("linear", "smooth")


INTERPOLATIONS = ("hold", "linear", "smooth")
CHANGES = ("interpolation", "chosen_by", "why", "shift")  # what a recording or a user may say of an input


def by_name(given, owner: str, what: str, example: str) -> Mapping:
    """What is given by names, or an error that says how to write it."""
    if not isinstance(given, Mapping):
        raise DeclarationError(f"{owner}: {what} are not given by name (got {given!r}). Write {example}.")
    for name in given:
        if not isinstance(name, str):
            raise DeclarationError(f"{owner}: one of the {what} has no name (got {name!r}). Write {example}.")
    return given


def changed(inputs: Sequence[Signal], changes: Mapping[str, Mapping], owner: str) -> tuple[Signal, ...]:
    """The inputs of ``owner`` with other ``interpolation``, ``chosen_by``, ``shift`` or ``why``, by name.

    Raises DeclarationError for an unknown input, key or interpolation, and a shift that is no time.
    """
    names = [s.name for s in inputs]
    for name, change in by_name(changes, owner, "inputs", "{'name': {'interpolation': 'linear'}}").items():
        if name not in names:
            raise DeclarationError(f"{owner}: no input '{name}'. {nearest(name, names)}")
        where = f"{owner}: input '{name}'"
        for key in by_name(change, where, "changes", "{'interpolation': 'linear'}"):
            if key not in CHANGES:
                raise DeclarationError(f"{where}: nothing to change by the name '{key}'. {nearest(key, CHANGES)}")
        if change.get("interpolation", "hold") not in INTERPOLATIONS:
            raise DeclarationError(
                f"{where}: unknown interpolation (got '{change['interpolation']}'). Use 'hold' for a "
                "command that is kept between samples, 'linear' or 'smooth' for a measured quantity."
            )
        if not isinstance(shift := change.get("shift", 0.0), Real) or not np.isfinite(shift):
            raise DeclarationError(f"{where}: the shift is no time (got {shift!r}). Give seconds.")
    return tuple(dataclasses.replace(s, **changes.get(s.name, {})) for s in inputs)


@dataclass(frozen=True)
class StateVariable:
    """A state: dotted path, SI unit, typical magnitude, physical bounds, and the output that measures it.

    ``written_in`` as of a `Signal`.
    """

    name: str
    unit: str
    description: str = ""
    nominal: float = 1.0
    bounds: tuple[float, float] = (-np.inf, np.inf)
    measured_by: str | None = None
    written_in: str = ""


@dataclass(frozen=True)
class ParameterValue:
    """A parameter with its value: dotted path, SI unit, bounds, scale, uncertainty and source.

    ``free`` marks the parameters that identification frees by default. ``written_in`` as of a `Signal`.
    """

    name: str
    value: float
    unit: str
    bounds: tuple[float, float] = (-np.inf, np.inf)
    nominal: float = 1.0
    sigma: float | None = None
    source: str = ""
    description: str = ""
    free: bool = False
    written_in: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class FlatModel:
    """One explicit ODE.

    ode : ``(t, x, u, p) -> (xdot, y)``, a CasADi SX function with these argument names; t scalar, the rest columns.
    start : ``(u, p, z) -> x``; ``z`` are the values of the states in ``given`` (see `start_given`), u the first input.
    step : recommended fixed step [s].
    loops : nonlinear ones, each by the unknowns it is solved for and ``(t, x, u, p) -> 1`` where it has a solution.
    provenance : of its values, where a fit found them; of other values what is `lasting`.
    black_box : a part of it has no equations: it runs from its beginning only, by what its `prepared` gives.
    """

    black_box: ClassVar[bool] = False

    name: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[StateVariable, ...]
    parameters: tuple[ParameterValue, ...]
    ode: ca.Function
    initialisation: object
    step: float = 1e-3
    description: str = ""
    loops: tuple[tuple[str, ca.Function], ...] = ()
    provenance: Mapping = field(default_factory=dict)

    def __repr__(self) -> str:
        counts = (("states", self.states), ("inputs", self.inputs), ("outputs", self.outputs))
        held = ", ".join(f"{what} {' '.join(v.name for v in some)}" for what, some in counts)
        return f"FlatModel '{self.name}': {held}, {len(self.parameters)} parameters"

    def start_given(self, given: Sequence[str] = ()) -> ca.Function:
        """Start states ``(u, p, z) -> x`` when the states named in ``given`` have the values ``z`` (SI).

        States that the model finds from static equilibrium adapt to the given ones.
        """
        known = [s.name for s in self.states]
        for name in given:
            if name not in known:
                raise DeclarationError(f"{self.name}: no state '{name}'. {nearest(name, known)}")
        return self.initialisation(tuple(given))

    def lost_loop(self, t: float, x, u, p) -> str:
        """The unknowns of the first nonlinear loop of which Newton's iteration finds no solution there; "" for none."""
        return next((names for names, solved in self.loops if float(solved(t, x, u, p)) != 1), "")

    def parameter_vector(self, changes: Mapping[str, float] | None = None) -> np.ndarray:
        """Values of all parameters, shape (np,), SI, with ``changes`` by path applied: in SI, or texts with a unit."""
        values = np.array([p.value for p in self.parameters], dtype=float)
        for name, value in (changes or {}).items():
            k = self.index_of(name)
            asked = wanted(self.parameters[k], self.name)
            values[k] = in_si(value, asked)
        return values

    def index_of(self, parameter: str) -> int:
        """Position of a parameter in ``p``; an unknown name raises with the nearest right one."""
        names = [p.name for p in self.parameters]
        if parameter not in names:
            raise no_parameter(self.name, parameter, names)
        return names.index(parameter)

    def with_inputs(self, changes: Mapping[str, Mapping]) -> FlatModel:
        """The same model whose inputs do something else between samples, see `changed`."""
        return dataclasses.replace(self, inputs=changed(self.inputs, changes, self.name))

    def with_parameters(self, changes: Mapping[str, float]) -> FlatModel:
        """The same model with other parameter values (SI), of which no fit says anything; see `since_set`."""
        values = dict(zip((p.name for p in self.parameters), self.parameter_vector(changes), strict=True))
        moved = [p.name for p in self.parameters if not same_value(values[p.name], p.value)]
        parameters = tuple(
            dataclasses.replace(p, value=float(values[p.name]), **OF_NO_FIT) if p.name in moved else p
            for p in self.parameters
        )
        return dataclasses.replace(self, parameters=parameters, provenance=since_set(self, moved)) if moved else self


def same_value(one: float, other: float) -> bool:
    """Whether two values of a parameter are one: set once more, a fitted one loses nothing of what is known of it."""
    return math.isclose(one, other, rel_tol=SAME, abs_tol=0.0)


def since_set(flat: FlatModel, moved: Sequence[str]) -> dict:
    """The provenance of a model of which the parameters ``moved`` got other values."""
    return lasting(flat.provenance, f"{', '.join(moved)} set", fitted_beside(flat, moved))


def fitted_beside(flat: FlatModel, names: Iterable[str]) -> bool:
    """Whether a fit found other values than those of ``names``, for all that the sources of values say."""
    fitted = {p.name for p in flat.parameters if p.source.startswith(IDENTIFIED)}
    return not fitted or not fitted <= set(names)


def no_parameter(model: str, path: str, known: Iterable[str], hint: str = "") -> DeclarationError:
    """The error for a path that leads to no parameter; paths begin within the model."""
    known, (owner, _, leaf) = list(known), path.rpartition(".")
    within = path.removeprefix(f"{model}.")
    if within in known:
        return DeclarationError(f"{model}: no parameter '{path}'. Write '{within}': paths begin within the model.")
    is_part = any(name.startswith(f"{owner}.") for name in known)
    where, name = (f"{model}.{owner}", leaf) if is_part else (model, path)
    return DeclarationError(f"{where}: no parameter '{name}'. {hint or nearest(path, known)}")


def fixed_start(values: Sequence[float], names: Sequence[str], inputs: int, parameters: int):
    """An ``initialisation`` for hand-written flat models: constants, any of them replaceable by name."""

    def initialisation(given: tuple[str, ...]) -> ca.Function:
        u, p, z = ca.SX.sym("u", inputs), ca.SX.sym("p", parameters), ca.SX.sym("z", len(given))
        x = ca.vertcat(*(z[given.index(n)] if n in given else v for n, v in zip(names, values, strict=True)))
        return ca.Function("start", [u, p, z], [ca.SX(x)], ["u", "p", "z"], ["x"])

    return initialisation
