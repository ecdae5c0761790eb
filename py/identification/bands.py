"""How sure a prediction of an identified model is: the standard deviation of what a sensor will read.

    sd(t)^2 = S(t) C S(t)^T + Z(t) N Z(t)^T + left^2,     S = dy/dp,  Z = dy/dx0

C is the covariance of the parameters, N that of the noise in measured start states, or of states that were estimated
from the first part of the recording (parameters as they are), and ``left`` what the fit left of
an output on its training recordings: the noise of the sensor where nothing is missing, else what is missing too. S and
Z are the exact sensitivities of the run. Where something is missing a band is as wide as the training was wrong, and on
other recordings the machine may be further off: then it cannot be trusted, and the output is not in `Spread.explained`.
Source: G. Seber, C. Wild, Nonlinear Regression, Wiley 1989, section 5.1 (the delta method).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.provenance import SPREAD, TRAIN
from hydrotwin.records import Record
from hydrotwin.records.between import settled
from hydrotwin.simulation import prepare
from hydrotwin.simulation.simulate import filled, inputs_of, since_start

from .beginning import StartEstimate
from .moved import Moved
from .start_states import StartStates


@dataclass(frozen=True, eq=False)
class Spread:
    """What a fit knows of its own errors.

    names : parameters by path; covariance : theirs, (np, np), SI. noise, left : of the sensors, and of what the fit
    left on its training recordings, by output, SI. explained : outputs of which nothing is left but noise.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    noise: Mapping[str, float]
    left: Mapping[str, float]
    explained: frozenset[str]

    @classmethod
    def of(cls, fit) -> Spread:
        """Of a `Fit`; parameters at a bound, or which the recordings do not determine, are taken as known."""
        known = np.flatnonzero(np.isfinite(np.diag(fit.covariance)))
        covariance = np.nan_to_num(fit.covariance[np.ix_(known, known)])
        left = dict(fit.rmse.get(TRAIN, {}))
        rows = [r for r in fit.residuals if r.role == TRAIN]
        explained = {r.output for r in rows} - {r.output for r in rows if not r.explained}
        names = tuple(fit.parameters[k].name for k in known)
        return cls(names, covariance, dict(fit.noise), left, frozenset(explained))

    def told(self) -> dict:
        """As data, for a model file."""
        return {
            "names": list(self.names),
            "covariance": self.covariance.tolist(),
            "noise": dict(self.noise),
            "left": dict(self.left),
            "explained": sorted(self.explained),
        }

    @classmethod
    def left_by(cls, provenance: Mapping | None) -> dict[str, float]:
        """What the fit of a model left of each output, SI, as its provenance tells it; empty where it does not."""
        told = (provenance or {}).get(SPREAD)
        return dict(cls.from_told(told).left) if told else {}

    @classmethod
    def from_told(cls, told: Mapping) -> Spread:
        """From the data of `told`. Raises DataError where they are garbled."""
        try:
            names = tuple(str(n) for n in told["names"])
            covariance = np.array(told["covariance"], dtype=float).reshape(len(names), len(names))
            noise, left = ({str(k): float(v) for k, v in told[part].items()} for part in ("noise", "left"))
            return cls(names, covariance, noise, left, frozenset(told["explained"]))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DataError(f"the spread of a model file is garbled ({error}). Identify the model again.") from None


def deviations(
    model,
    record: Record,
    spread: Spread,
    start: Mapping[str, float] | None = None,
    estimated: StartEstimate | None = None,
) -> dict[str, np.ndarray]:
    """Standard deviation (n,), SI, of what the sensor of every output reads in a free run; asked as `moves`."""
    return {name: one.deviation for name, one in moves(model, record, spread, start, estimated).items()}


def moves(
    model,
    record: Record,
    spread: Spread,
    start: Mapping[str, float] | None = None,
    estimated: StartEstimate | None = None,
) -> dict[str, Moved]:
    """How far every output of a free run as `simulate` makes it may be moved by what the fit does not know.

    model : a Model or FlatModel, its inputs as it was fitted; start : start states by name that are known exactly;
    estimated : those that are not, with their covariance.
    Only outputs that the fit was judged on have one. Raises as `simulate`.
    """
    flat: FlatModel = settled(getattr(model, "flat", model), [record])
    record, order = filled(record, flat), [p.name for p in flat.parameters]
    kept = [k for k, name in enumerate(spread.names) if name in order]
    names = [spread.names[k] for k in kept]
    doubted = estimated.values if estimated else {}
    given, measured = given_starts(flat, record, {**(start or {}), **doubted})
    starts = StartStates(flat, list(given), np.array([order.index(n) for n in names], dtype=int))
    u, p = inputs_of(flat, record), flat.parameter_vector()
    x0, by_p, by_z = starts(u[0], p, np.array([given[n] for n in starts.names]))
    moving = [*measured, *doubted]
    seeds = np.hstack([by_p, by_z[:, [starts.names.index(n) for n in moving]]])
    propagator = prepare(flat, free_parameters=names, free_states=moving)
    _, dy, _, _ = propagator.sensitivity(since_start(record), u, p, x0, seeds, with_states=False)
    noise = np.square([spread.noise.get(output, 0.0) for output in measured.values()])
    of_start = np.reshape(estimated.covariance if estimated else (), (len(doubted), len(doubted)))
    C = block_diag(spread.covariance[np.ix_(kept, kept)], np.diag(noise), of_start)
    root, left = _root(C), spread.left
    return {s.name: Moved(dy[:, j] @ root, left[s.name]) for j, s in enumerate(flat.outputs) if s.name in left}


def _root(C: np.ndarray) -> np.ndarray:
    """A square root of a covariance; by way of the correlation, for parameters in SI are of very different size."""
    size = np.sqrt(np.maximum(np.diag(C), 0.0))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(C / np.outer(scale, scale))
    return size[:, None] * (vectors * np.sqrt(np.maximum(values, 0.0)))


def given_starts(
    flat: FlatModel, record: Record, start: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, str]]:
    """Start states that are given, by name, and of those that are measured the output, in the order of the states."""
    outputs = {s.name: s.measured_by for s in flat.states if s.measured_by in record and s.name not in start}
    measured = {name: output for name, output in outputs.items() if np.isfinite(record[output][0])}
    return {name: float(record[output][0]) for name, output in measured.items()} | dict(start), measured
