"""A linear start: hidden states as what the past tells of the future, and the linear step and encoder to go with them.

The outputs of the next samples are regressed on the past and on the inputs of those samples. What the past contributes
beyond the present output spans the hidden states; the largest directions are kept, scaled to unit spread. The step is
then linear least squares from states to states. Source: Van Overschee, De Moor, "Subspace identification for linear
systems", Kluwer 1996, in the plain form of one projection and one regression.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .equations import StateShape
from .sensitivities import Network, joined_weights

AHEAD = 20  # samples that the past is asked to foretell
MOST = 6000  # rows of the regressions, over all recordings
RIDGE = 1e-6  # of the mean square of a column
LEAST_RATE = 1e-6  # of a spread: of a state that hardly moves from sample to sample

Runs = Sequence[tuple[np.ndarray, np.ndarray]]


def output_rates(runs: Runs) -> np.ndarray:
    """Spread (ny,) of the increments of the normalised outputs."""
    steps = np.concatenate([np.diff(y, axis=0) for _, y in runs])
    return np.maximum(steps.std(axis=0), LEAST_RATE)


def encoder_features(u: np.ndarray, y: np.ndarray, at: np.ndarray, past: int, rates: np.ndarray) -> np.ndarray:
    """e (n, ne) at the samples ``at`` of a normalised recording; before its first sample nothing moved."""
    moved = [(y[np.maximum(at - i, 0)] - y[np.maximum(at - i - 1, 0)]) / rates for i in range(past)]
    return np.hstack([y[at], *moved, *(u[np.maximum(at - i, 0)] for i in range(past + 1))])


def linear_start(runs: Runs, shape: StateShape) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Linear weights of step and encoder by name, and the rates (nx,) of the states.

    runs : normalised (inputs (n, nu), outputs (n, ny)).
    """
    rates, ny = output_rates(runs), shape.outputs
    past = [encoder_features(u, y, np.arange(len(u)), shape.past, rates) for u, y in runs]
    ahead = min(AHEAD, min(len(u) for u, _ in runs) // 4)
    encoder, bias = _encoder(runs, past, shape, ahead)
    states = [np.hstack([y, e @ encoder.T + bias]) for (_, y), e in zip(runs, past, strict=True)]
    moved = np.concatenate([np.diff(x, axis=0) for x in states])
    rate = np.concatenate([rates, np.maximum(moved[:, ny:].std(axis=0), LEAST_RATE)])
    z = np.concatenate([np.hstack([x, u])[:-1] for x, (u, _) in zip(states, runs, strict=True)])
    solution = _regressed(z, moved / rate)
    parts = {"linear_weights": solution[1:].T, "output_bias": solution[0]}
    return parts | {"encoder_linear_weights": encoder, "encoder_bias": bias}, rate


def _encoder(runs: Runs, past: Sequence[np.ndarray], shape: StateShape, ahead: int) -> tuple[np.ndarray, np.ndarray]:
    """Hidden states as a linear function of e: (nh, ne) and (nh,)."""
    ny, nu = shape.outputs, shape.inputs
    now = ny * (1 + shape.past)  # where the present input stands in e
    rows, causes, futures = [], [], []
    for (u, y), e in zip(runs, past, strict=True):
        at = np.arange(shape.past, len(u) - ahead)
        if not len(at):
            continue
        rows.append(e[at])
        causes.append(np.hstack([u[at + i] for i in range(1, ahead)]))
        futures.append(np.hstack([y[at + i] - y[at] for i in range(1, ahead + 1)]))
    e, causes, futures = (_thinned(np.concatenate(part)) for part in (rows, causes, futures))
    solution = _regressed(np.hstack([e, causes]), futures)[1 : 1 + e.shape[1]]
    solution[now : now + nu] = 0.0  # the present input is no state
    told = e @ solution
    of_output = _regressed(e[:, :ny], told)
    told = told - told.mean(axis=0) - (e[:, :ny] - e[:, :ny].mean(axis=0)) @ of_output[1:]
    solution[:ny] -= of_output[1:]
    _, directions = np.linalg.eigh(told.T @ told)
    chosen = directions[:, ::-1][:, : shape.hidden_states]
    if chosen.shape[1] < shape.hidden_states:
        chosen = np.hstack([chosen, np.zeros((len(chosen), shape.hidden_states - chosen.shape[1]))])
    spread = np.maximum((told @ chosen).std(axis=0), 1e-9)
    encoder = (solution @ chosen / spread).T
    return encoder, -encoder @ e.mean(axis=0)


def rescaled(net: Network, spread: np.ndarray) -> Network:
    """The same network with its hidden states over ``spread`` (nh,): their unit is free."""
    ny, w = net.shape.outputs, {name: part.copy() for name, part in net.parts.items()}
    every = np.concatenate([np.ones(ny), spread])
    wide = np.concatenate([every, np.ones(net.shape.inputs)])
    for name in ("linear_weights", "hidden_weights"):
        w[name] *= wide
    for name in ("encoder_linear_weights", "encoder_bias", "encoder_output_weights"):
        w[name] = (w[name].T / spread).T
    return replace(net, flat=joined_weights(w, net.shape), rate=net.rate / every)


def _thinned(rows: np.ndarray) -> np.ndarray:
    return rows[:: max(1, len(rows) // MOST)]


def _regressed(rows: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Coefficients (1 + m, k) of a constant and of the columns."""
    A = np.hstack([np.ones((len(rows), 1)), rows])
    gram = A.T @ A
    gram[np.diag_indices_from(gram)] += RIDGE * np.maximum(np.diag(gram), 1e-12)
    return np.linalg.solve(gram, A.T @ targets)
