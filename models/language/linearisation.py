"""Linear models around an operating point, and their modes.

x' = A (x - x0) + B (u - u0),   y = y0 + C (x - x0) + D (u - u0)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca
import control
import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from .errors import DeclarationError, SolveError, nearest
from .flat import FlatModel

STANDSTILL = 1e-6  # of nominal per second: the largest rate of a steady state
PADE_ORDER = 3


@dataclass(frozen=True)
class OperatingPoint:
    """Where a model is linearised: inputs, states and their rates by name, SI."""

    inputs: Mapping[str, float]
    states: Mapping[str, float]
    rates: Mapping[str, float]


@dataclass(frozen=True)
class Mode:
    """One pole (or conjugate pair, as the upper one): natural frequency [Hz], damping ratio, who takes part.

    ``participation`` is the share of each state, summing to one. Source: Perez-Arriaga, Verghese and Schweppe,
    Selective modal analysis, IEEE Trans. PAS-101 (1982) 3117-3125.
    """

    pole: complex
    frequency: float
    damping: float
    participation: Mapping[str, float]

    @property
    def oscillates(self) -> bool:
        return self.pole.imag > 0


@dataclass(frozen=True)
class Modes:
    """All modes of a model, slowest first; ``pressures`` names its states that are pressures."""

    modes: tuple[Mode, ...]
    pressures: tuple[str, ...]

    @property
    def poles(self) -> np.ndarray:
        """Every pole, both of a conjugate pair, shape (nx,) [1/s]."""
        return np.array([p for m in self.modes for p in ([m.pole, m.pole.conjugate()] if m.oscillates else [m.pole])])

    @property
    def hydraulic(self) -> Mode | None:
        """The mode of the oil spring: the oscillating one in which pressures take part most; None without one."""
        shares = [(sum(m.participation[name] for name in self.pressures), m) for m in self.modes if m.oscillates]
        share, mode = max(shares, key=lambda pair: pair[0], default=(0.0, None))
        return mode if share > 0 else None


def operating_point(model, at: Mapping[str, float] | None = None, *, steady: bool = False) -> OperatingPoint:
    """The point that values of inputs and states (SI, by name) determine.

    Inputs not named have their defaults; states not named follow from the model's start (static equilibrium). With
    ``steady`` the states not named are moved until nothing changes any more, from there by the shortest way.

    Raises
    ------
    DeclarationError : a name is neither input nor state.
    SolveError : no equilibrium or no steady state was found; the restless states are named.
    """
    flat: FlatModel = getattr(model, "flat", model)
    at = dict(at or {})
    names = [s.name for s in flat.states]
    known = [*names, *(i.name for i in flat.inputs)]
    for name in at:
        if name not in known:
            raise DeclarationError(f"{flat.name}: no input or state '{name}'. {nearest(name, known)}")
    u = np.array([at.get(i.name, i.default) for i in flat.inputs])
    given = {name: at[name] for name in names if name in at}
    p = flat.parameter_vector()
    x = np.array(flat.start_given(tuple(given))(u, p, list(given.values())), dtype=float).ravel()
    if not np.all(np.isfinite(x)):
        lost = ", ".join(name for name, value in zip(names, x, strict=True) if not np.isfinite(value))
        raise SolveError(f"{flat.name}: no static equilibrium found for {lost} (got {at}). Give these states.")
    if lost := flat.lost_loop(0, x, u, p):
        raise SolveError(
            f"{flat.name}: the equations for {lost} have no solution at this operating point, or none that Newton's "
            f"iteration finds (got {at}). Give other inputs or states."
        )
    if steady:
        x = _steady(flat, x, u, p, [k for k, name in enumerate(names) if name not in given])
    rates = np.array(flat.ode(0, x, u, p)[0]).ravel()
    return OperatingPoint(
        dict(zip((i.name for i in flat.inputs), u.tolist(), strict=True)),
        dict(zip(names, x.tolist(), strict=True)),
        dict(zip(names, rates.tolist(), strict=True)),
    )


def _steady(flat: FlatModel, x: np.ndarray, u: np.ndarray, p: np.ndarray, free: list[int]) -> np.ndarray:
    """Move the ``free`` states until every rate is zero."""
    nominal = np.array([s.nominal for s in flat.states])
    symbol = ca.SX.sym("x", len(x))
    rate = flat.ode(0, symbol, u, p)[0] / nominal
    evaluate = ca.Function("rate", [symbol], [rate, ca.jacobian(rate, symbol)])

    def point(z):
        moved = x.copy()
        moved[free] = x[free] + z * nominal[free]
        return moved

    if free and len(x):
        found = least_squares(
            lambda z: np.array(evaluate(point(z))[0]).ravel(),
            np.zeros(len(free)),
            lambda z: np.array(evaluate(point(z))[1])[:, free] * nominal[free],
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        x = point(found.x)
    left = np.abs(np.array(evaluate(x)[0]).ravel())
    restless = [s.name for s, value in zip(flat.states, left, strict=True) if not value < STANDSTILL]
    if restless:
        raise SolveError(
            f"{flat.name}: no steady state found: {', '.join(restless)} keep moving (got {left.max():g} of nominal per "
            "second). Fewer states may be given, or the inputs let the machine move for ever."
        )
    return x


def linearise(
    model, at: Mapping[str, float] | None = None, *, steady: bool = False, pade_order: int = PADE_ORDER
) -> control.StateSpace:
    """The linear model around `operating_point`\\ ``(model, at, steady=steady)`` with the model's names, in SI.

    A dead time becomes a Padé approximation of ``pade_order``, whose states are called ``<input>.delayed[k]``.

    Example
    -------
    ``linearise(model, {"command": 0.0}).poles()``
    """
    flat: FlatModel = getattr(model, "flat", model)
    point = operating_point(flat, at, steady=steady)
    a, b, c, d = _matrices(flat, point)
    states = [s.name for s in flat.states]
    a, b, c, d, delays = _with_dead_times(flat, (a, b, c, d), pade_order)
    return control.StateSpace(
        a, b, c, d,
        states=states + delays, inputs=[i.name for i in flat.inputs], outputs=[o.name for o in flat.outputs],
        name=flat.name, remove_useless_states=False,
    )  # fmt: skip


def _matrices(flat: FlatModel, point: OperatingPoint):
    x, u, p = (ca.SX.sym(n, len(v)) for n, v in zip("xup", (flat.states, flat.inputs, flat.parameters), strict=True))
    rate, y = flat.ode(0, x, u, p)
    f = ca.Function("matrices", [x, u, p], [ca.jacobian(e, v) for e in (rate, y) for v in (x, u)])
    values = f(list(point.states.values()), list(point.inputs.values()), flat.parameter_vector())
    matrices = [np.array(value, dtype=float) for value in values]
    if not all(np.all(np.isfinite(m)) for m in matrices):
        raise SolveError(
            f"{flat.name}: the model has no derivative at this operating point (got {dict(point.states)}). "
            "Move a little away from it."
        )
    return matrices


def _with_dead_times(flat: FlatModel, matrices, order: int):
    """Delayed inputs pass a Padé filter first: u_delayed = C_d x_d + D_d u."""
    a, b, c, d = matrices
    filters, names = [], []
    for signal in flat.inputs:
        dead_time = flat.parameters[flat.index_of(signal.dead_time)].value if signal.dead_time else 0.0
        if dead_time > 0 and order > 0:
            pade = control.ss(control.tf(*control.pade(dead_time, order)))
            filters.append((pade.A, pade.B, pade.C, pade.D))
            names += [f"{signal.name}.delayed[{k + 1}]" for k in range(order)]
        else:
            filters.append((np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))))
    if not names:
        return a, b, c, d, []
    a_d, b_d, c_d, d_d = (block_diag(*parts) for parts in zip(*filters, strict=True))
    n, k = len(a), len(a_d)
    a = np.block([[a, b @ c_d], [np.zeros((k, n)), a_d]])
    return a, np.vstack([b @ d_d, b_d]), np.hstack([c, d @ c_d]), d @ d_d, names


def modes(model, at: Mapping[str, float] | None = None, *, steady: bool = False) -> Modes:
    """Poles of a model around an operating point, and which states make each of them.

    Dead times do not add modes.
    """
    flat: FlatModel = getattr(model, "flat", model)
    a = _matrices(flat, operating_point(flat, at, steady=steady))[0]
    nominal = np.array([s.nominal for s in flat.states])
    names = [s.name for s in flat.states]
    found = _modes_of(a * nominal / nominal[:, None], names)
    return Modes(tuple(found), tuple(s.name for s in flat.states if s.unit == "Pa"))


def _modes_of(a: np.ndarray, names: list[str]) -> Iterable[Mode]:
    poles, right = np.linalg.eig(a)
    tiny = 1e-9 * np.abs(poles).max(initial=0.0)
    poles = np.where(np.abs(poles) < tiny, 0.0, poles)  # an integrator, to rounding
    left = np.linalg.pinv(right)  # rows are left eigenvectors
    share = np.abs(right * left.T)
    share /= np.maximum(share.sum(axis=0), np.finfo(float).tiny)
    order = np.argsort(np.abs(poles), kind="stable")
    for k in order:
        pole = complex(poles[k]) if abs(poles[k].imag) > tiny else complex(poles[k].real)
        if pole.imag < 0:
            continue
        size = abs(pole)
        damping = -pole.real / size if size > tiny else 1.0
        yield Mode(pole, size / (2 * np.pi), damping, dict(zip(names, share[:, k].tolist(), strict=True)))
