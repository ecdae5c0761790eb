"""The same fit by other means: SciPy on finite differences, and CasADi multiple shooting with IPOPT."""

from __future__ import annotations

import time
from collections.abc import Sequence

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from hydrotwin.identification.problem import free_parameters
from hydrotwin.identification.problem import recordings as arrays
from hydrotwin.models.language.flat import FlatModel


class TimeIsUp(Exception):
    """The cap on a rival's run time."""


def scipy_finite_differences(flat: FlatModel, records: Sequence, start: dict, noise: np.ndarray, cap: float):
    """`scipy.optimize.least_squares` (trf, 2-point differences) on `solve_ivp`, input held between samples.

    Start states are those of the model at the first measured angle. Returns (parameters, evaluations, seconds, done).
    """
    free = free_parameters(flat, list(start), start)
    measured = arrays(flat, records, None, "record")
    rate = flat.ode
    began, best = time.perf_counter(), {"cost": np.inf, "q": free.scaled(free.start), "calls": 0}

    def run(recording, p):
        angle = recording.y[0, 0]
        x = np.array(flat.start_given(["arm.angle"])(recording.u[0], p, [angle])).ravel()
        states = [x]
        for k in range(len(recording.time) - 1):
            if time.perf_counter() - began > cap:
                raise TimeIsUp
            ends = recording.time[k], recording.time[k + 1]
            u = recording.u[k]
            solved = solve_ivp(lambda t, x, u=u: np.array(rate(t, x, u, p)[0]).ravel(), ends, states[-1], rtol=1e-6)
            states.append(solved.y[:, -1])
        every_sample = rate.map(len(states))
        outputs = every_sample(recording.time, np.array(states).T, recording.u.T, ca.repmat(p, 1, len(states)))[1]
        return np.array(outputs).T

    def residuals(q):
        p = free.vector(q)
        r = np.concatenate([((run(m, p) - m.y) / noise).ravel() for m in measured])
        best["calls"] += 1
        if r @ r < best["cost"]:
            best.update(cost=float(r @ r), q=q.copy())
        return r

    try:
        least_squares(residuals, free.scaled(free.start), x_scale="jac")
        done = True
    except TimeIsUp:
        done = False
    return free.values(best["q"]), best["calls"], time.perf_counter() - began, done


def casadi_multiple_shooting(
    flat: FlatModel, records: Sequence, start: dict, noise: np.ndarray, cap: float, every: int
):
    """CasADi multiple shooting, a node every ``every`` samples, RK4 of the model's step, IPOPT with L-BFGS.

    Returns (parameters, iterations, seconds, done).
    """
    free = free_parameters(flat, list(start), start)
    measured = arrays(flat, records, None, "record")
    scale = np.array([s.nominal for s in flat.states])
    began = time.perf_counter()
    q = ca.MX.sym("q", len(free.names))
    p = _vector(free, q)
    variables, guess, gaps, cost = [q], [free.scaled(free.start)], [], 0
    for m in measured:
        interval = _interval(flat, every, float(np.median(np.diff(m.time))))
        nodes = (len(m.time) - 1) // every
        Z = ca.MX.sym("Z", len(scale), nodes)
        variables.append(ca.vec(Z))
        guess.append((_measured_states(m, nodes, every) / scale).ravel())
        u = m.u[: nodes * every, 0].reshape(nodes, every)
        y = m.y[: nodes * every].reshape(nodes, every, -1)
        end, seen = interval.map(nodes, "thread", 2)(Z * scale[:, None], u.T, ca.repmat(p, 1, nodes))
        gaps.append(ca.vec((end[:, :-1] - (Z * scale[:, None])[:, 1:]) / scale[:, None]))
        r = (seen - y.reshape(nodes, -1).T) / np.tile(noise, every)[:, None]
        cost = cost + ca.sumsqr(r)
    problem = {"x": ca.vertcat(*variables), "f": 0.5 * cost, "g": ca.vertcat(*gaps)}
    limits = {"ipopt.max_wall_time": max(1.0, cap - (time.perf_counter() - began)), "ipopt.print_level": 0}
    solver = ca.nlpsol(
        "fit", "ipopt", problem, {**limits, "print_time": False, "ipopt.hessian_approximation": "limited-memory"}
    )
    solution = solver(x0=np.concatenate(guess), lbg=0, ubg=0)
    stats = solver.stats()
    found = np.array(solution["x"]).ravel()[: len(free.names)]
    return free.values(found), stats["iter_count"], time.perf_counter() - began, bool(stats["success"])


def _vector(free, q: ca.MX) -> ca.MX:
    p = ca.MX(free.all_values)
    for j, i in enumerate(free.index):
        p[int(i)] = ca.exp(q[j]) if free.logarithmic[j] else q[j] * free.unit[j]
    return p


def _measured_states(m, nodes: int, every: int) -> np.ndarray:
    """Angle, pressures and speed as measured, angular velocity from differences: (nodes, nx), in model order."""
    k = np.arange(nodes) * every
    return np.column_stack([m.y[k, 1], m.y[k, 3], m.y[k, 4], m.y[k, 0], np.gradient(m.y[:, 0], m.time)[k]])


def _interval(flat: FlatModel, every: int, period: float) -> ca.Function:
    """(x, u of every sample, p) -> (x at the next node, outputs of every sample, stacked)."""
    x0, u = ca.SX.sym("x", len(flat.states)), ca.SX.sym("u", every)
    p, x, outputs = ca.SX.sym("p", len(flat.parameters)), x0, []
    n = int(np.ceil(period / flat.step - 1e-6))
    h = period / n
    for k in range(every):
        outputs.append(flat.ode(0, x, u[k], p)[1])
        for _ in range(n):
            k1 = flat.ode(0, x, u[k], p)[0]
            k2 = flat.ode(0, x + h / 2 * k1, u[k], p)[0]
            k3 = flat.ode(0, x + h / 2 * k2, u[k], p)[0]
            k4 = flat.ode(0, x + h * k3, u[k], p)[0]
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("interval", [x0, u, p], [x, ca.vertcat(*outputs)])
