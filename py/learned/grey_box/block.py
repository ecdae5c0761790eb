"""The latent-spool grey box's equations: a spool that nobody measures between command and speed, in CasADi.

    c(t)  = u(t - T_d)                                                dead time
    q     : c - b/2 <= q <= c + b/2, moves only when pushed           play of width b
    s''   = w0^2 (q - s) - 2 D w0 s'                                  spool, unit gain
    f     = monotone, piecewise linear in s, constant beyond its ends
    tau v' = f - v                                                    lag
    y'    = v   (integrating)      or      y = v

The play stands before the spool (the solenoid's magnetic hysteresis) or behind it (friction and edges); then the spool
follows c, q follows s, and f is of q. Where a slow command is all there is, both are one.

Sampled with period h: the spool exactly for an input held over the step (with a dead time that ends inside a step, its
mean over the step); f as the mean of its values at both ends, the lag and the integral exactly for that mean:

    v[k+1] = a v[k] + (1 - a) f_mean,      y[k+1] = y[k] + h f_mean - tau (v[k+1] - v[k]),      a = exp(-h/tau)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal, StateVariable

from ..block_file import LearnedKind, Shapes, register_kind
from ..piecewise.block import whole_and_share

CONSTANTS = ("dead_time", "natural_frequency", "damping", "play", "lag", "period")


@dataclass(frozen=True)
class Dynamics:
    """Dead time [s], spool's natural frequency [rad/s] and damping [1], play [unit of the input], lag [s].

    play_first : whether the play stands before the spool.
    """

    dead_time: float
    natural_frequency: float
    damping: float
    play: float
    lag: float
    play_first: bool = True

    def spool(self, period: float) -> tuple[np.ndarray, np.ndarray]:
        """A (2, 2), B (2,): (s, s') after one period for an input held over it."""
        from scipy.linalg import expm

        w = self.natural_frequency
        continuous = np.array([[0, 1, 0], [-w * w, -2 * self.damping * w, w * w], [0, 0, 0]])
        step = expm(continuous * period)
        return step[:2, :2], step[:2, 2]

    def late(self, period: float) -> tuple[int, float]:
        """Whole periods of the dead time, and the share of a period that is left."""
        return whole_and_share(self.dead_time, period)


def grey_box_states(structure: Mapping[str, int], input_: Signal, output: Signal) -> tuple[StateVariable, ...]:
    """The named states: output (measured) and its rate, spool, play, delay line."""
    first = StateVariable(output.name, output.unit, output.description, output.nominal, measured_by=output.name)
    per_second = f"{output.unit}/s" if structure["integrating"] and "/" not in output.unit else "1"
    states = (
        [first, StateVariable(f"{output.name}.lagged", per_second, "rate")] if structure["integrating"] else [first]
    )
    for name, about in (
        ("spool", "latent spool"),
        ("spool_rate", "its speed, per second"),
        ("play", "behind the play"),
    ):
        states.append(StateVariable(f"{input_.name}.{name}", input_.unit, about))
    lags = range(1, structure["delay"] + 1)
    return (*states, *(StateVariable(f"{input_.name}.lag_{k}", input_.unit, f"input {k} periods ago") for k in lags))


def characteristic(knots: np.ndarray, values: np.ndarray, q):
    """The piecewise linear map through the points, constant beyond the first and last; CasADi expression of ``q``."""
    slopes = np.diff(values) / np.diff(knots)
    inside = ca.fmin(ca.fmax(q, float(knots[0])), float(knots[-1]))
    turned = zip(knots[1:-1], np.diff(slopes), strict=True)
    kinks = sum((float(turn) * ca.fmax(inside - float(knot), 0) for knot, turn in turned), start=0)
    return float(values[0]) + float(slopes[0]) * (inside - float(knots[0])) + kinks


def _shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    counts = {name: structure[name] for name in ("knots", "delay", "integrating", "play_first")}
    return {name: (1,) for name in CONSTANTS} | {"knots": (counts["knots"],), "rates": (counts["knots"],)}


def _functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    constants = {name: float(arrays[name][0]) for name in CONSTANTS}
    h = constants.pop("period")
    dynamics, integrating = (
        Dynamics(**constants, play_first=bool(structure["play_first"])),
        bool(structure["integrating"]),
    )
    whole, share = dynamics.late(h)
    A, B = (ca.DM(part) for part in dynamics.spool(h))
    decay = float(np.exp(-h / dynamics.lag)) if dynamics.lag > 0 else 0.0

    def f(q):
        return characteristic(arrays["knots"], arrays["rates"], q)

    x, u, p = ca.SX.sym("x", (2 if integrating else 1) + 3 + structure["delay"]), ca.SX.sym("u"), ca.SX.sym("p", 0)
    y, v = x[0], x[1 if integrating else 0]
    spool, play, line = ca.vertsplit(x[2 if integrating else 1 :], [0, 2, 3, 3 + structure["delay"]])
    late = ca.vertcat(u, line)
    command = (1 - share) * late[whole] + share * late[whole + 1]

    def played(pushed):
        return ca.fmin(ca.fmax(play, pushed - dynamics.play / 2), pushed + dynamics.play / 2)

    if dynamics.play_first:
        play_next = played(command)
        spool_next = ca.mtimes(A, spool) + B * play_next
        mean = (f(spool[0]) + f(spool_next[0])) / 2
    else:
        spool_next = ca.mtimes(A, spool) + B * command
        play_next = played(spool_next[0])
        mean = (f(play) + f(play_next)) / 2
    v_next = decay * v + (1 - decay) * mean
    y_next = [y + h * mean - dynamics.lag * (v_next - v), v_next] if integrating else [v_next]
    x_next = ca.vertcat(*y_next, spool_next, play_next, late[:-1])
    step = ca.Function("step", [x, u, p], [x_next, y], ["x", "u", "p"], ["x_next", "y"])

    first = ca.SX.sym("y")
    begin = [first, f(u)] if integrating else [first]
    at_rest = ca.vertcat(*begin, u, 0, u, ca.repmat(u, structure["delay"], 1))
    return step, ca.Function("start", [u, first, p], [at_rest], ["u", "y", "p"], ["x"])


GREY_BOX = register_kind(LearnedKind("grey_box", 1, _shapes, _functions))
