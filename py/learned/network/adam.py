"""Training of the rate network as published: Adam on all samples, the best of several starts by its training loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from ..device import REAL, array, tensor
from ..interruption import INTERRUPTED
from .rate_block import weight_shapes

RATE = 1e-2


@dataclass(frozen=True, eq=False)
class TrainedRates:
    """Arrays of the best network, and the smallest loss of every start (mean square over the spread of the rates)."""

    arrays: dict[str, np.ndarray]
    losses: tuple[float, ...]
    iterations: int
    stopped: str


def train(
    X: np.ndarray, y: np.ndarray, *, hidden: int, starts: int, iterations: int, seed: int, progress: Callable | None
) -> TrainedRates:
    """All ``starts`` side by side on normalised X (n, f), y (n,); every start keeps its best weights.

    progress : called with ``(iteration, loss)``, of the best start so far. Ctrl-C ends with the best so far.
    """
    shapes = weight_shapes(X.shape[1], hidden)
    weights = {name: w.requires_grad_() for name, w in _first_weights(shapes, starts, seed).items()}
    kept = {name: w.detach().clone() for name, w in weights.items()}
    inputs, target = tensor(X), tensor(y)
    best, done, stopped = tensor(np.full(starts, np.inf)), 0, "finished"
    adam = torch.optim.Adam(weights.values(), lr=RATE)
    try:
        for _ in range(iterations):
            adam.zero_grad()
            losses = (rates(weights, inputs) - target).square().mean(dim=1)
            better = losses.detach() < best
            best = torch.where(better, losses.detach(), best)
            for name, w in weights.items():
                kept[name][better] = w.detach()[better]
            losses.sum().backward()
            adam.step()
            done += 1
            if progress is not None:
                progress(done, float(best.min()))
    except KeyboardInterrupt:
        if not done:
            raise
        stopped = INTERRUPTED
    first = int(best.argmin())
    arrays = {name: array(w[first]).reshape(shapes[name]) for name, w in kept.items()}
    return TrainedRates(arrays, tuple(array(best).tolist()), done, stopped)


def rates(weights: dict[str, torch.Tensor], inputs: torch.Tensor) -> torch.Tensor:
    """Normalised rates (starts, n) at normalised lines (n, f); weights are those of `weight_shapes`, starts first."""
    h = inputs.expand(len(weights["first_bias"]), -1, -1)
    for layer in ("first", "second", "output"):
        h = torch.baddbmm(weights[f"{layer}_bias"].unsqueeze(1), h, weights[f"{layer}_weights"].transpose(1, 2))
        h = torch.relu(h) if layer != "output" else h
    return h.squeeze(2)


def predicted(arrays: dict[str, np.ndarray], X: np.ndarray) -> np.ndarray:
    """Normalised rates (n,) of one trained network, by torch."""
    with torch.no_grad():
        return array(rates({name: tensor(a).unsqueeze(0) for name, a in arrays.items()}, tensor(X)))[0]


def _first_weights(shapes: dict[str, tuple[int, ...]], starts: int, seed: int) -> dict[str, torch.Tensor]:
    """PyTorch's own start of a linear layer: even within one over the root of its inputs."""
    draw, weights = torch.Generator().manual_seed(seed), {}
    for name, shape in shapes.items():
        inputs = shapes[name.replace("bias", "weights")][1]
        weights[name] = tensor((2 * torch.rand(starts, *shape, generator=draw, dtype=REAL) - 1) / inputs**0.5)
    return weights
