"""Screen: which candidates could explain what is left, from one run with sensitivities at neutral.

    M = (I - P_S) C,   min over d of ||r + S d_S + C_g d_g||^2,   d_g inside the bounds of candidate g

S are the sensitivities to the base parameters and start states, C those to the candidates' parameters, all at the
present fit with every candidate at neutral: what wrong base parameters absorb already is projected away, but for those
that rest on a bound and absorb no more (the oil in a line is like a larger volume). Candidates
without a useful derivative at neutral (thresholds, limits) are run at finite amplitudes instead.
A screen never names: the best by score was the right one in four of five cases only.
Source: C. R. Rao, Proc. Cambridge Phil. Soc. 1948 (score test).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
from scipy.optimize import lsq_linear

from hydrotwin.identification import horizon
from hydrotwin.identification.descent import Task
from hydrotwin.identification.loss import Loss
from hydrotwin.identification.noise import weights
from hydrotwin.identification.problem import free_parameters
from hydrotwin.identification.shooting import Shooting
from hydrotwin.identification.start_states import StartStates
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.simulation import prepare

from .decide import correlation_times
from .executor import processors
from .refit import Question, Refitted, likelihood_by_output

TESTABLE = 3.0  # predicted |t| of an effect at its largest usual amplitude
BLIND = 1e-6  # of the largest projected column: no derivative
ABSORBED = 1e-6  # of the plain column: what the base parameters leave of it is rounding
FARTHEST = 0.7  # in q of a base parameter: a factor of two
PARALLEL = 0.95  # cosine: an effect that does what a parameter does
NEUTRAL_DIVERGES = (
    "the fitted model with all candidates at neutral diverges. Look for fewer of them at once (effects or exclude), or "
    "give a smaller step."
)
LONGEST = 3.0  # in units of the largest probe: how far a linear prediction is followed


@dataclass(frozen=True, eq=False)
class Screened:
    """What the screen says about one candidate.

    gain : predicted drop of L; evidence : the same with samples counted by what they are worth (see `decide`);
    share : of the squared gap in noise units.
    visible : predicted |t| at its largest usual amplitude.
    start : parameter values that the prediction suggests; column : its projected, normalised prediction (m,), (0,) for
        a fault of a sensor that was not recorded.
    beside : values of the base parameters that it suggests with them.
    beyond : it does what a base parameter that rests on a bound would do beyond that.
    """

    candidate: object
    gain: float
    evidence: float
    share: float
    visible: float
    start: Mapping[str, float]
    column: np.ndarray
    beside: Mapping[str, float] = field(default_factory=dict)
    beyond: bool = False

    @property
    def testable(self) -> bool:
        return self.visible >= TESTABLE


def _silent(stage: str, number: int, cost: float) -> None:
    """A screen reports nothing."""


class Screen:
    """The present fit with every candidate at neutral, differentiated once.

    big : the base with every candidate added; free : base parameters and those of the effects named so far.
    """

    def __init__(self, big: FlatModel, free: Sequence[str], candidates: Sequence, fitted: Refitted, question: Question):
        self.question, self.fitted, self.flat = question, fitted, big
        self.size = np.fmax(fitted.size, question.noise)
        self.tau = correlation_times(fitted.residuals_fit)
        names = tuple(dict.fromkeys([*free, *(n for c in candidates for n in c.free)]))
        known = fitted.states[0] if fitted.states else {}
        self.free = free_parameters(big, names, dict(fitted.values))
        given = [s.name for s in big.states if s.name in known]
        here = self.free.vector(self.free.scaled(self.free.start))
        absent = [n for c in candidates for n, value in c.neutral.items() if value == 0 == here[big.index_of(n)]]
        self._zero = tuple(dict.fromkeys(absent))
        self._start = StartStates(big, given, self.free.index, held=question.initial_states == "fixed")
        z = np.array([[states[n] for n in self._start.names] for states in fitted.states]) / self._start.nominal
        self.z = z.reshape(len(question.fit), -1)
        self._prepare()
        self._base = [self.free.names.index(n) for n in dict.fromkeys(free) if n not in fitted.at_bound]
        self._differentiate()

    def _prepare(self) -> None:
        """The model, ready to run over the fit recordings."""
        question = self.question
        propagator = prepare(
            self.flat, free_parameters=self.free.names, free_states=list(self._start.names), step=question.step,
            few_runs=True, zero=self._zero,
        )  # fmt: skip
        self.task = Task(
            self.flat, self.free, propagator, question.fit, weights(self.size), Loss("linear", 1.0),
            question.initial_states, 1, _silent, question.noise,
        )  # fmt: skip
        self.shooting = Shooting(
            propagator, self.free, question.fit, tuple(horizon.cut(question.fit, np.inf)), self.task.weights,
            self._start, self.z, self.task.loss, 1 if self.flat.black_box else processors(),
        )  # fmt: skip

    def _differentiate(self) -> None:
        q = self.free.scaled(self.free.start)
        residuals, rows, outputs = [], [], []
        shared, local = len(self.free.names), self.shooting.locals
        count = len(self.question.fit)
        every = self.shooting.all_sensitivities(q, self.z)
        for i, (recording, found) in enumerate(zip(self.question.fit, every, strict=True)):
            if found is None:
                raise SolveError(f"{self.flat.name}: {NEUTRAL_DIVERGES}")
            r, J, _ = found
            own = np.zeros((len(r), shared + count * local))
            own[:, :shared] = J[:, :shared]
            own[:, shared + i * local : shared + (i + 1) * local] = J[:, shared : shared + local]
            residuals.append(r)
            rows.append(own)
            seen = np.isfinite(recording.y) & (self.task.weights > 0)
            outputs.append(np.nonzero(seen)[1])
        self.residual, self.output = np.concatenate(residuals), np.concatenate(outputs)
        J = np.concatenate(rows)
        nuisance = J[:, [*self._base, *range(shared, J.shape[1])]]
        size = np.linalg.norm(nuisance, axis=0)
        self._inverse = np.linalg.pinv(nuisance / np.maximum(size, 1e-300), rcond=1e-8)
        self._inverse /= np.maximum(size, 1e-300)[:, None]
        nuisance = nuisance[:, size > 1e-12 * size.max(initial=1e-300)] if nuisance.shape[1] else nuisance
        nuisance = nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300)
        basis, sizes, _ = scipy.linalg.svd(nuisance, full_matrices=False)
        self.basis = basis[:, sizes > 1e-8 * sizes.max(initial=0.0)]
        self.jacobian = J[:, :shared]
        self.left = self.project(self.residual)
        self._outward = [self._unit(way * self.project(J[:, k])) for k, way in self._stopped()]

    def _stopped(self) -> list[tuple[int, float]]:
        """Base parameters that rest on a bound, and the way (+1, -1) that leads beyond it."""
        known = [(self.free.names.index(n), self.fitted.values[n]) for n in self.fitted.at_bound]
        upper = [abs(self.free.upper[k] - value) < abs(value - self.free.lower[k]) for k, value in known]
        return [(k, 1.0 if up else -1.0) for (k, _), up in zip(known, upper, strict=True)]

    def project(self, columns: np.ndarray) -> np.ndarray:
        """``(I - P_S) columns``."""
        return columns - self.basis @ (self.basis.T @ columns)

    def by_derivative(self, candidate) -> Screened:
        """The score test of one candidate."""
        index = [self.free.names.index(n) for n in candidate.free]
        columns = self.project(self.jacobian[:, index])
        q0 = self.free.scaled(self.free.start)[index]
        low, high = (self.free.scaled(b)[index] for b in (self.free.lower, self.free.upper))
        reach = np.maximum(self._reach(candidate, index), 1e-12)
        low, high = np.maximum(low - q0, -LONGEST * reach), np.minimum(high - q0, LONGEST * reach)
        norms = np.linalg.norm(columns, axis=0)
        plain = np.linalg.norm(self.jacobian[:, index], axis=0) * reach
        if not np.any(norms * reach > np.maximum(BLIND, ABSORBED * plain)):
            nil = 0.0 if not np.any(plain > BLIND) else np.finfo(float).tiny
            return Screened(candidate, 0.0, 0.0, 0.0, nil, dict(candidate.neutral), np.zeros(len(self.left)))
        step = np.zeros(len(index))
        use = (norms * reach > BLIND) & (high > low)
        if use.any():
            scaled = columns[:, use] * reach[use]
            answer = lsq_linear(scaled, -self.left, (low[use] / reach[use], high[use] / reach[use]), method="bvls")
            step[use] = answer.x * reach[use]
        visible = self._in_noise(columns * np.where(high - low > 0, np.minimum(reach, np.maximum(high, -low)), 0))
        q = self.free.scaled(self.free.start).copy()
        q[index] += step
        values = self.free.values(q)[index]
        start = dict(zip(candidate.free, values.tolist(), strict=True))
        return self._judged(candidate, columns @ step, visible, start, self._beside(self.jacobian[:, index] @ step))

    def seen_alone(self, candidate, name: str) -> bool:
        """Whether one parameter of a candidate, at its largest usual value, shows beside the base parameters."""
        index = [self.free.names.index(n) for n in candidate.free]
        k = candidate.free.index(name)
        change = self.jacobian[:, [index[k]]] * self._reach(candidate, index)[k]
        return self._in_noise(self.project(change)) >= TESTABLE

    def _beside(self, change: np.ndarray) -> dict[str, float]:
        """Values of the base parameters where the weighted outputs (m,) change by so much, as far as they may go."""
        step = self._inverse @ -(self.residual + change)
        q = self.free.scaled(self.free.start).copy()
        low, high = (self.free.scaled(b) for b in (self.free.lower, self.free.upper))
        q[self._base] += np.clip(step[: len(self._base)], -FARTHEST, FARTHEST)
        values = self.free.values(np.clip(q, low, high))
        return {self.free.names[k]: float(values[k]) for k in self._base}

    def by_amplitude(self, candidate, values: Mapping[str, float], change: np.ndarray) -> Screened:
        """A candidate run at a finite amplitude: ``change`` (m,) of the weighted simulated outputs."""
        with np.errstate(over="ignore", invalid="ignore"):  # a run may have all but diverged
            column = self.project(change)
            energy = float(column @ column)
        if not energy > BLIND or not np.isfinite(energy):
            return Screened(candidate, 0.0, 0.0, 0.0, 0.0, dict(values), np.zeros(len(self.left)))
        factor = float(np.clip(-(column @ self.left) / energy, 0.0, 1.5))
        beside = self._beside(factor * change)
        return self._judged(candidate, factor * column, self._in_noise(column[:, None]), dict(values), beside)

    def joint_gain(self, one: Screened, other: Screened) -> float:
        """Predicted drop of L when two candidates act together, beyond the better of them alone."""
        columns = np.column_stack([self._columns(one), self._columns(other)])
        size = np.linalg.norm(columns, axis=0)
        columns = columns[:, size > 0] / size[size > 0]
        step, *_ = np.linalg.lstsq(columns, -self.left, rcond=1e-6)
        _, evidence = self._gains(self.rmse(self.left + columns @ step))
        return evidence - max(one.evidence, other.evidence)

    def _columns(self, screened: Screened) -> np.ndarray:
        """Projected columns of a candidate: its derivatives, or its change at a finite amplitude."""
        names = [n for n in screened.candidate.free if n in self.free.names]
        columns = self.project(self.jacobian[:, [self.free.names.index(n) for n in names]])
        if np.linalg.norm(columns) > 0 and not hasattr(screened.candidate.effect, "probes_for"):
            return columns
        return screened.column[:, None]

    def _reach(self, candidate, index) -> np.ndarray:
        """Largest usual change of every parameter of a candidate, in q."""
        q0 = self.free.scaled(self.free.start)[index]
        reach = np.zeros(len(index))
        spans = [*candidate.probes, *({n: t[1] for n, t in candidate.typical.items()},)]
        for probe in spans:
            values = self.free.start.copy()
            for k, name in zip(index, candidate.free, strict=True):
                if name in probe:
                    values[k] = np.clip(probe[name], self.free.lower[k], self.free.upper[k])
            reach = np.maximum(reach, np.abs(self.free.scaled(values)[index] - q0))
        return np.where(reach > 0, reach, 1.0)

    def _in_noise(self, columns: np.ndarray) -> float:
        """Largest |t| of the columns in units of the sensors' noise."""
        back = (self.size / self.question.noise)[self.output]
        return float(np.max(np.linalg.norm(columns * back[:, None], axis=0), initial=0.0))

    def _judged(self, candidate, change: np.ndarray, visible: float, start, beside) -> Screened:
        after = self.left + change
        rmse = self.rmse(after)
        gain, evidence = self._gains(rmse)
        noise = np.where(np.isfinite(self.question.noise), self.question.noise, 1.0)
        gap = lambda value: float(np.nansum(np.maximum((value / noise) ** 2 - 1, 0)))  # noqa: E731
        before = gap(self.rmse(self.left))
        share = 1 - gap(rmse) / before if before > 0 else 0.0
        unit = self._unit(change)
        beyond = any(unit @ outward > PARALLEL for outward in self._outward)
        return Screened(candidate, gain, evidence, float(np.clip(share, 0, 1)), visible, start, unit, beside, beyond)

    @staticmethod
    def _unit(column: np.ndarray) -> np.ndarray:
        norm = np.linalg.norm(column)
        return column / norm if norm > 0 else column

    def _gains(self, rmse: np.ndarray) -> tuple[float, float]:
        """Drop of L to an RMSE per output, plain and with effective sample sizes."""
        drop = likelihood_by_output(self.rmse(self.left), self.question) - likelihood_by_output(rmse, self.question)
        return float(drop.sum()), float((drop / self.tau).sum())

    def rmse(self, weighted: np.ndarray) -> np.ndarray:
        """RMSE per output, SI, of weighted residuals in the order of the rows."""
        count = np.bincount(self.output, minlength=len(self.size))
        squares = np.bincount(self.output, weighted**2, minlength=len(self.size))
        return np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)) * self.size, np.nan)

    def trajectories(self) -> list[np.ndarray]:
        """State trajectories (n, nx) of the model with all candidates, per fit recording."""
        return self.shooting.trajectories(self.free.scaled(self.free.start), self.z)

    def weighted(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """Residuals (n, ny) of the fit recordings, SI, as rows of the screen."""
        rows = []
        for r, recording in zip(residuals, self.question.fit, strict=True):
            seen = np.isfinite(recording.y) & (self.task.weights > 0)
            rows.append((r * self.task.weights)[seen])
        return np.concatenate(rows)
