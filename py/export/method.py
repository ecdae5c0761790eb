"""Which integrator an exported model gets: explicit with a fixed step, or one for the stiff: adaptive, or fixed again.

Decided by trial: a short run under a smooth excitation, fixed step against the adaptive method at a tight tolerance.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel

from .lower import adaptive_advance

STIFF = 1e-2
"""Difference of the two methods, relative to the range of a state, above which the fixed step is called unstable."""

TRIAL_TIME, TRIAL_INTERVALS, TIGHT = 0.5, 25, 1e-11
METHODS = ("auto", "explicit", "implicit", "adaptive")


def choose_method(flat: FlatModel, method: str, step: float) -> tuple[str, float, str]:
    """``(method, step, reason)``.

    "auto" keeps the explicit method at the very step that `simulate` takes, so that FMU and simulation are the same
    numbers, unless that step is unstable: then "adaptive". The reason says how far the fixed step is from the adaptive
    method; a smaller ``step`` brings it nearer, in `simulate` as here.

    Raises DeclarationError for a method that is none and a step that is not positive.
    """
    check_method(flat.name, method, step)
    if not flat.states:
        return "explicit", step, "the model has no states"
    if method != "auto":
        return method, step, "chosen by the caller"
    reference = _trial(flat, adaptive_advance(flat, TIGHT))
    if reference is None:
        return "explicit", step, "the adaptive method did not get through the trial run"
    difference = _difference(_trial(flat, fixed_step_advance(flat, step)), reference)
    if difference > STIFF:
        return "adaptive", step, f"Runge-Kutta at {step:g} s is {difference:.1e} of the range off: the model is stiff"
    return "explicit", step, f"Runge-Kutta at {step:g} s and Rosenbrock agree to {difference:.1e} of each state's range"


def check_method(name: str, method: str, step: float | None = None) -> None:
    """Raise DeclarationError for a method that is none and a step [s] that is not positive; ``name``: of the model."""
    if method not in METHODS:
        raise DeclarationError(f"{name}: no method '{method}'. {nearest(method, METHODS)}")
    if step is not None and not step > 0:
        raise DeclarationError(f"{name}: the internal step must be positive (got {step:g} s). Give seconds, as 1e-3.")


def fixed_step_advance(flat: FlatModel, step: float) -> ca.Function:
    """``(t, h, x, u, p) -> x`` by classical Runge-Kutta with the substeps that the C runtime takes."""
    count = max(1, int(np.ceil(TRIAL_TIME / TRIAL_INTERVALS / step - 1e-6)))
    sizes = len(flat.states), len(flat.inputs), len(flat.parameters)
    t, h, (x, u, p) = ca.MX.sym("t"), ca.MX.sym("h"), (ca.MX.sym(n, s) for n, s in zip("xup", sizes, strict=True))
    d = h / count
    k1 = flat.ode(t, x, u, p)[0]
    k2 = flat.ode(t + d / 2, x + d / 2 * k1, u, p)[0]
    k3 = flat.ode(t + d / 2, x + d / 2 * k2, u, p)[0]
    k4 = flat.ode(t + d, x + d * k3, u, p)[0]
    once = ca.Function("substep", [x, t, h, u, p], [x + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    many = once.mapaccum(count)
    times = t + h * ca.DM(np.arange(count) / count).T
    after = many(x, times, ca.repmat(h, 1, count), ca.repmat(u, 1, count), ca.repmat(p, 1, count))
    return ca.Function("fixed_step", [t, h, x, u, p], [after[:, -1]])


def _trial(flat: FlatModel, advance: ca.Function) -> np.ndarray | None:
    """States at the ends of the trial's intervals, shape (intervals, states); None when the run broke down."""
    p, h = flat.parameter_vector(), TRIAL_TIME / TRIAL_INTERVALS
    nominal, default = np.array([s.nominal for s in flat.inputs]), np.array([s.default for s in flat.inputs])
    x = np.array(flat.start_given(())(default, p, [])).ravel()
    states = []
    for k in range(TRIAL_INTERVALS):
        u = default + 0.3 * nominal * np.sin(2 * np.pi * (k + 1) / TRIAL_INTERVALS * (1 + np.arange(len(nominal))))
        try:
            x = np.array(advance(k * h, h, x, u, p)).ravel()
        except RuntimeError:
            return None
        if not np.isfinite(x).all():
            return None
        states.append(x)
    return np.array(states)


def _difference(states: np.ndarray | None, reference: np.ndarray) -> float:
    """Largest difference relative to the range of each state; a state that stays put counts in its own magnitude."""
    if states is None:
        return np.inf
    span = np.ptp(reference, axis=0)
    span = np.where(span > 1e-9 * np.abs(reference).max(axis=0), span, np.maximum(np.abs(reference).max(axis=0), 1e-12))
    return float((np.abs(states - reference) / span).max())
