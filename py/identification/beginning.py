"""Where a recording starts, from its first part: start states that no sensor measures, or a noisy one.

    min over x0   1/2 sum_k sum_outputs ((y(t_k; x0) - y_k) / size)^2,   t_k in the first part

``size`` is the noise of the sensor, or what the run leaves where that is more (see `weighing`), or what the fit of the
model left of the output, where that is known: an output that the model cannot follow shall not bend the start. A first
part cannot tell by itself which of two sensors is off. The rest of the recording is never looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError, nearest
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import Record
from hydrotwin.records.between import settled
from hydrotwin.simulation import prepare
from hydrotwin.simulation.simulate import filled

from .assumptions import CHANCE
from .descent import BEGINNING, FEWEST_SAMPLES
from .horizon import cut, measured_start
from .least_squares import Minimum, minimise
from .loss import Loss
from .noise import output_noise, solver_error, weights
from .problem import FreeParameters, Recording, recordings
from .shooting import Shooting
from .start_states import StartStates
from .weighing import STEADY, WORTH_IT

MEASURED, AUTO, FREE = "measured", "auto", "free"
INITIAL_STATES = (MEASURED, AUTO, FREE)
ROUNDS = 4
STILL = 1e-3  # of its nominal: how exactly a sensor is followed that does not change in the first part


@dataclass(frozen=True)
class StartState:
    """An estimated start state, SI, with its standard deviation; ``assumed`` is what it is without an estimate."""

    name: str
    value: float
    sigma: float
    assumed: float
    unit: str


@dataclass(frozen=True)
class StartEstimate:
    """The start of one recording: its estimated ``states``, from ``seconds`` (from, to) of its clock, ``samples``.

    ``note`` says why nothing was estimated; else empty. ``covariance`` : of the states, rows of SI values, for the
    parameters as they are.
    """

    record: str
    states: tuple[StartState, ...] = ()
    seconds: tuple[float, float] = (0.0, 0.0)
    samples: int = 0
    note: str = ""
    covariance: tuple[tuple[float, ...], ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """State -> start value, SI."""
        return {s.name: s.value for s in self.states}


def check_initial_states(how: str, where: str) -> str:
    """``how`` where it is one of INITIAL_STATES ("fixed", as `identify` calls it, is "measured"); DeclarationError."""
    how = MEASURED if how == "fixed" else how
    if how not in INITIAL_STATES:
        raise DeclarationError(f"{where}: no initial_states '{how}'. {nearest(how, INITIAL_STATES)}")
    return how


def estimate_start(
    model,
    record: Record,
    how: str = AUTO,
    known: Mapping[str, float] | None = None,
    left: Mapping[str, float] | None = None,
) -> StartEstimate:
    """The start states of a Model or FlatModel on a recording, from its first tenth, at least FEWEST_SAMPLES samples.

    how : "measured" estimates none: first samples count as exact, the model finds the rest. "auto" estimates those
        whose sensor is noisy, and those that no sensor measures where less is left then than by chance. "free"
        estimates all.
    known : start states (SI, by name) that are given and stay.
    left : what the fit of the model left of its outputs (RMSE, SI, by name), see `Spread`; an output counts by that
        where it is more than the noise of its sensor.

    Raises DataError for a recording that is too short or holds no output, SolveError for a model that does not run.
    """
    how = check_initial_states(how, "start states")
    flat: FlatModel = settled(getattr(model, "flat", model), [record])
    if how == MEASURED or not flat.states:
        return StartEstimate(record.name)
    part = _first_part(filled(record, flat), flat)
    measured, *_ = recordings(flat, [part], None, "recording")
    if measured.in_motion and not record.in_motion:
        raise DataError(f"{record.name}: it begins with a hole, so that nothing tells how {flat.name} starts there.")
    search = _Search(flat, measured, known or {}, left or {})
    seconds = float(part.time[0]), float(part.time[-1])
    best = search.best(how)
    at = np.flatnonzero(best.moves)
    covariance = tuple(map(tuple, best.covariance[np.ix_(at, at)].tolist()))
    return StartEstimate(record.name, search.told(best), seconds, len(part.time), covariance=covariance)


def _first_part(record: Record, flat: FlatModel) -> Record:
    n = len(record.time)
    if n < FEWEST_SAMPLES:
        raise DataError(
            f"{record.name}: too short to estimate the start of {flat.name} from its first part (got {n} samples). "
            f"It takes {FEWEST_SAMPLES}. Give a longer recording, or let the first samples count (measured)."
        )
    return record.window(end=record.time[max(FEWEST_SAMPLES, int(BEGINNING * n)) - 1])


@dataclass(frozen=True, eq=False)
class _Found:
    """A minimum with its shooting, and which of its start states may move (nz,)."""

    shooting: Shooting
    minimum: Minimum
    moves: np.ndarray

    @property
    def x0(self) -> np.ndarray:
        """All start states (nx,), SI."""
        shooting = self.shooting
        p, u0 = shooting.free.all_values, shooting.recordings[0].u[0]
        return shooting.start(u0, p, self.minimum.z[0] * shooting.start.nominal)[0]

    @property
    def covariance(self) -> np.ndarray:
        """(nz, nz), SI, of those that move, zero of the others; it grows with what is left beyond noise."""
        free = max(1, self.shooting.count - int(self.moves.sum()))
        nominal, at = self.shooting.start.nominal, np.flatnonzero(self.moves)
        information = self.minimum.at.hessian[0][np.ix_(at, at)]
        found = np.zeros((len(self.moves), len(self.moves)))
        found[np.ix_(at, at)] = np.linalg.pinv(information, hermitian=True)
        return found * max(1.0, 2 * self.minimum.cost / free) * np.outer(nominal, nominal)


class _Search:
    """The first part of one recording under one model; ``known`` start states stay, ``left`` as in `estimate_start`."""

    def __init__(self, flat: FlatModel, recording: Recording, known: Mapping[str, float], left: Mapping[str, float]):
        self.flat, self.recording, self.known = flat, recording, dict(known)
        self.order = [s.name for s in flat.states]
        noise, self.noisy = _noise(flat, recording)
        left_of = np.array([left.get(s.name, 0.0) for s in flat.outputs])
        self.noise = np.where(left_of > WORTH_IT * noise, left_of, noise)
        told = np.isfinite(recording.y[0]).any() or not recording.in_motion  # else late inputs of before still act
        self.given = (measured_start(flat, recording) if told else {}) | self.known
        self.parameters = _none_free(flat)
        self.assumed = self._start(list(self.given))(recording.u[0], self.parameters.all_values, self._given())[0]
        self.propagator = prepare(flat, free_states=self.order)

    def best(self, how: str) -> _Found:
        """All free; or those that are measured, and the rest only where it leaves less than chance would."""
        free = [n for n in self.order if n not in self.known]
        if how == FREE:
            return self._weighed(self.order, free, self.assumed)
        noisy = [s.name for s in self.flat.states if s.name in free and s.measured_by in self.noisy]
        few = self._weighed([n for n in self.order if n in self.given], noisy, self.assumed)
        hidden = [n for n in free if n not in self.given]
        if not hidden:
            return few
        weight, x0 = few.shooting.weights, few.x0
        more = self._fitted(self.order, [*noisy, *hidden], x0, weight)
        level = max(1.0, 2 * few.minimum.cost / few.shooting.count)
        gain = 2 * (few.minimum.cost - more.minimum.cost)
        if gain <= chdtri(len(hidden), CHANCE) * level:
            return few
        return self._weighed(self.order, [*noisy, *hidden], more.x0)

    def told(self, found: _Found) -> tuple[StartState, ...]:
        """The states that were estimated."""
        x0, names = found.x0, found.shooting.start.names
        sigma = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
        rows = [(n, s) for n, s, moves in zip(names, sigma, found.moves, strict=True) if moves]
        at = {s.name: k for k, s in enumerate(self.flat.states)}
        return tuple(
            StartState(n, float(x0[at[n]]), float(sigma), float(self.assumed[at[n]]), self.flat.states[at[n]].unit)
            for n, sigma in rows
        )

    def _weighed(self, names: Sequence[str], free: Sequence[str], x0: np.ndarray) -> _Found:
        """A minimum whose weights follow what it leaves, where that is more than noise."""
        size = self.noise
        for _ in range(ROUNDS):
            found = self._fitted(names, free, x0, weights(size))
            before, x0 = size, found.x0
            size = self._sizes(found)
            if np.nanmax(np.abs(np.log(size / before))) < STEADY:
                break
        return found

    def _fitted(self, names: Sequence[str], free: Sequence[str], x0: np.ndarray, weight: np.ndarray) -> _Found:
        start = self._start(names)
        moves = np.array([n in free for n in start.names], dtype=bool)
        z = (x0[start.columns] / start.nominal)[None]
        start.bounds[~moves] = (x0[start.columns][~moves])[:, None]
        segments = tuple(cut([self.recording], np.inf))
        shooting = Shooting(
            self.propagator, self.parameters, (self.recording,), segments, weight, start, z, Loss("linear", 1.0),
            diverged=np.inf,  # a start that nobody measured may be far off, and the first part at rest
        )  # fmt: skip
        return _Found(shooting, minimise(shooting, np.zeros(0), shooting.clip(z)), moves)

    def _sizes(self, found: _Found) -> np.ndarray:
        r = found.shooting.residuals(0, np.zeros(0), found.minimum.z[0])
        if r is None:
            raise SolveError(f"{self.flat.name}: the run diverges from the start estimated on {self.recording.name}.")
        with np.errstate(invalid="ignore", divide="ignore"):
            left = np.sqrt(np.array([np.mean(c[np.isfinite(c)] ** 2) if np.isfinite(c).any() else np.nan for c in r.T]))
            left = left / found.shooting.weights
        return np.where(left > WORTH_IT * self.noise, left, self.noise)

    def _start(self, names: Sequence[str]) -> StartStates:
        return StartStates(self.flat, names, np.zeros(0, dtype=int))

    def _given(self) -> np.ndarray:
        return np.array([self.given[n] for n in self.order if n in self.given])


def _noise(flat: FlatModel, recording: Recording) -> tuple[np.ndarray, frozenset[str]]:
    """Noise (ny,), SI, seen in the first part, and the outputs that have some; one at rest counts as nearly exact."""
    names = [s.name for s in flat.outputs]
    still = {n: STILL * s.nominal for n, s, y in zip(names, flat.outputs, recording.y.T, strict=True)
             if np.isfinite(y).any() and not np.nanmax(y) > np.nanmin(y)}  # fmt: skip
    noise = output_noise(flat, [recording], still)
    exact = solver_error([recording])
    return noise, frozenset(n for n, s, e in zip(names, noise, exact, strict=True) if s > e and n not in still)


def _none_free(flat: FlatModel) -> FreeParameters:
    none = np.zeros(0)
    return FreeParameters(
        names=(), units=(), index=none.astype(int), start=none, lower=none, upper=none,
        logarithmic=none.astype(bool), unit=none, all_values=flat.parameter_vector(), nominal=none,
    )  # fmt: skip
