"""Levenberg-Marquardt over few shared parameters and many private start states.

The start states of a segment touch that segment alone, so each step eliminates them block by block and solves a small
bounded problem in the shared parameters:

    S = H_qq - sum H_qz H_zz^-1 H_zq,   min 1/2 d^T S d + g^T d,   lower <= q + d <= upper

A thousand segments with five start states each cost what their runs cost; a solver that knows no blocks would factor
a 5000-column Jacobian. Source: K. Levenberg 1944, D. Marquardt 1963; damping after H. B. Nielsen 1999; the bounded
step is SciPy's BVLS.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.optimize import lsq_linear

from hydrotwin.models.language.errors import SolveError

from .shooting import Linearisation, Shooting

LONGEST_STEP = 0.5  # in q: a factor 1.6, or half a unit, or half of what is more than a unit
STALLED = 1e9
SLOW_STEPS = 6
LEAST = 1e-4  # of what a step promised: what it must keep to be taken
POOR = 0.1  # of what a step promised: what it should keep
POOR_STEPS = 3


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a minimisation ended: parameters q, start states z (segments, nz), the expansion there."""

    q: np.ndarray
    z: np.ndarray
    at: Linearisation
    iterations: int
    converged: bool
    message: str

    @property
    def cost(self) -> float:
        return self.at.cost

    def information(self) -> np.ndarray:
        """J^T J of the shared parameters once the start states have adapted. (np, np)"""
        size = _diagonal(self.at)
        return DampedStep(self.at, len(self.q), size, 1e-9).matrix


def minimise(
    shooting: Shooting,
    q: np.ndarray,
    z: np.ndarray,
    *,
    absolute: float = 1e-3,
    relative: float = 0.0,
    stalled: float = 0.2,
    most: int = 50,
    hold: bool = False,
    until: float = np.inf,
    at: Linearisation | None = None,
    on_step: Callable[[int, float, float], None] = lambda number, cost, damping: None,
) -> Minimum:
    """Minimise the cost; stop when a full step promises less than ``absolute`` (plus ``relative`` of the unexplained).

    A cost is half a chi-square: a promise of 1e-3 moves no parameter by more than 4.5 % of its sigma. Where more than
    noise is left sigmas grow with it, and so does the promise that is worth a step; unexplained is what lies beyond
    twice the noise's share. It also stops when the last steps together gained less than ``stalled`` on the same scale,
    or when steps that promised less than that kept no promise: a cost that is rough on a small scale never ends to
    promise. A step that diverges or does not descend is rejected and shortened. ``hold`` keeps q and moves the start
    states alone. ``until``: the processor time [s], as of `time.process_time`, at which it stops where it is, or
    earlier where the runs say so. ``at``: the expansion at q and z, where it is known.
    """
    lower, upper = (q, q) if hold else (shooting.free.scaled(b) for b in (shooting.free.lower, shooting.free.upper))
    logarithmic = shooting.free.logarithmic
    at, until = at or shooting.linearise(q, z), min(until, shooting.until)
    if at.diverged.all():
        raise SolveError(f"identify: every run diverges{_where(shooting, q)}. Start elsewhere or use shorter windows.")
    damping, growth, size = 1e-3, 2.0, _diagonal(at)
    straight, rejected, costs, poor = True, 0, [at.cost], 0
    for number in range(1, most + 1):
        size = np.maximum(size, _diagonal(at))
        inside = without_blocked(at, shooting, z)
        step = DampedStep(inside, len(q), size, damping)
        longest = LONGEST_STEP * np.where(logarithmic, 1.0, np.maximum(np.abs(q), 1.0))
        dq, dz = step.towards(inside.gradient, np.maximum(lower - q, -longest), np.minimum(upper - q, longest))
        dz = shooting.clip(z + dz) - z if shooting.locals else dz
        promise = step.promise(dq, dz)
        dispersion = max(1.0, 2 * at.cost / shooting.count)
        enough = absolute * dispersion + relative * max(0.0, at.cost - shooting.count)
        slow = len(costs) > SLOW_STEPS and costs[-1 - SLOW_STEPS] - at.cost < stalled * dispersion
        if slow or poor == POOR_STEPS or (promise <= enough and damping <= 1e-2):
            return Minimum(q, z, at, number - 1, True, "converged")
        trial_q, trial_z = np.clip(q + dq, lower, upper), z + dz if shooting.locals else z
        trial = _below(at.cost - LEAST * promise, shooting, trial_q, trial_z, straight)
        gain = (at.cost - trial.cost) / max(promise, 1e-300) if trial else 0.0
        poor += gain < POOR and promise < stalled * dispersion
        if trial:
            q, z, at = trial_q, trial_z, trial
            straight, rejected = not rejected, 0  # after a step that had to be shortened the next may be, too
            damping, growth = max(damping * max(0.1, 1 - (2 * min(gain, 1) - 1) ** 3), 1e-12), 2.0
            costs.append(at.cost)
            on_step(number, at.cost, damping)
        else:
            straight, rejected = False, rejected + 1
            damping, growth = damping * growth, growth * 2
            if damping > STALLED or promise < 1e-12 * at.cost:
                return Minimum(q, z, at, number, promise < enough, "no step descends any further")
        if time.process_time() > until:
            return Minimum(q, z, at, number, False, "stopped at its time limit")
    return Minimum(q, z, at, most, False, f"stopped after {most} iterations")


def _below(level: float, shooting: Shooting, q: np.ndarray, z: np.ndarray, straight: bool) -> Linearisation | None:
    """The expansion where the cost is below a level, else None. straight : without asking for the cost alone before.

    From where derivatives explode no step leads on, though the run may end nearby.
    """
    if not straight and not shooting.cost(q, z, level) < level:
        return None
    at = shooting.linearise(q, z, level)
    return at if at.cost < level else None


def _diagonal(at: Linearisation) -> np.ndarray:
    """Diagonal of the whole Hessian: shared part summed over segments, private parts apart. (segments, k)"""
    return np.einsum("sii->si", at.hessian)


def without_blocked(at: Linearisation, shooting: Shooting, z: np.ndarray) -> Linearisation:
    """The expansion for start states that may still move: one on its bound that the gradient pushes outwards stays.

    Clipped afterwards it would take the shared parameters along with a step that it does not make.
    """
    if not shooting.locals:
        return at
    shared = at.gradient.shape[1] - shooting.locals
    low, high = (shooting.clip(np.full_like(z, limit)) for limit in (-np.inf, np.inf))
    push = at.gradient[:, shared:]
    stays = ((z <= low) & (push > 0)) | ((z >= high) & (push < 0))
    moves = np.concatenate([np.ones((len(z), shared)), ~stays], axis=1)
    hessian = at.hessian * moves[:, :, None] * moves[:, None, :] + _diagonal_blocks(1 - moves)
    return dataclasses.replace(at, gradient=at.gradient * moves, hessian=hessian)


class DampedStep:
    """The damped system of one iteration, with the start states eliminated."""

    def __init__(self, at: Linearisation, shared: int, size: np.ndarray, damping: float):
        H = at.hessian
        self._at, self._shared = at, shared
        self._scale_q, self._scale_z = _floored(size[:, :shared].sum(axis=0)), _floored(size[:, shared:])
        self.matrix = H[:, :shared, :shared].sum(axis=0) + damping * np.diag(self._scale_q)
        self._H_zq = H[:, shared:, :shared]
        private = H.shape[1] - shared
        if private:
            frozen = at.diverged[:, None] * np.ones(private)
            self._H_zz = H[:, shared:, shared:] + _diagonal_blocks(damping * self._scale_z + frozen)
            self._carried = np.linalg.solve(self._H_zz, self._H_zq)
            self.matrix = self.matrix - np.einsum("szq,szr->qr", self._H_zq, self._carried)

    def towards(self, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step in q (shared,) inside [low, high] and in z (segments, private) against a gradient (segments, k)."""
        g_q, g_z = gradient[:, : self._shared].sum(axis=0), gradient[:, self._shared :]
        if not g_z.shape[1]:
            return self._inside(g_q, low, high), np.zeros_like(g_z)
        alone = np.linalg.solve(self._H_zz, g_z[:, :, None])[:, :, 0]
        dq = self._inside(g_q - np.einsum("szq,sz->q", self._H_zq, alone), low, high)
        return dq, self.beside(dq) - alone

    def beside(self, dq: np.ndarray) -> np.ndarray:
        """How the start states go along with a step in q. (segments, private)"""
        private = self._at.hessian.shape[1] - self._shared
        return -(self._carried @ dq) if private else np.zeros((len(self._at.hessian), 0))

    def promise(self, dq: np.ndarray, dz: np.ndarray) -> float:
        """Decrease of cost that the expansion predicts for a step."""
        d = np.concatenate([np.broadcast_to(dq, (len(dz), self._shared)), dz], axis=1)
        bend = np.einsum("sk,sk->", d, np.einsum("skl,sl->sk", self._at.hessian, d))
        return -float(np.einsum("sk,sk->", self._at.gradient, d) + 0.5 * bend)

    def _inside(self, g: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return _bounded(self.matrix, g, low, high)


def _floored(diagonal: np.ndarray) -> np.ndarray:
    """Damping scale: a direction without any effect still needs some, or its step is undefined."""
    largest = diagonal.max(initial=0.0)
    return np.maximum(diagonal, 1e-12 * largest if largest > 0 else 1.0)


def _diagonal_blocks(values: np.ndarray) -> np.ndarray:
    return values[:, :, None] * np.eye(values.shape[1])


def _bounded(S: np.ndarray, g: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minimise 1/2 d^T S d + g^T d in the box."""
    if not len(g):
        return np.zeros(0)
    unit = 1 / np.sqrt(np.maximum(np.diag(S), np.finfo(float).tiny))
    scaled = S * np.outer(unit, unit)
    values, vectors = scipy.linalg.eigh(scaled)
    root = np.sqrt(np.maximum(values, 1e-14 * values.max()))
    free = -unit * (vectors @ ((vectors.T @ (unit * g)) / root**2))
    if np.all((free >= low) & (free <= high)):
        return free
    open_ = high > low
    if not open_.any():
        return low.copy()
    A, b, d = root[:, None] * vectors.T / unit, -(vectors.T @ (unit * g)) / root, np.where(open_, 0.0, low)
    box = low[open_], high[open_]
    scale = unit[open_]
    answer = lsq_linear(A[:, open_] * scale, b - A @ d, (box[0] / scale, box[1] / scale), method="bvls")
    d[open_] = np.clip(answer.x * scale, *box)
    return d


def _where(shooting: Shooting, q: np.ndarray) -> str:
    values = shooting.free.values(q)
    told = ", ".join(f"{n} = {v:.4g}" for n, v in zip(shooting.free.names, values, strict=True))
    return f" at {told}" if told else ""
