"""Train an inverse network with the paper's losses; needs PyTorch, and is needed only to train.

    L = mean w_i (u_i - u^_i)^2 + lambda mean |min(du^/dr, 0)|        Eq. 6 and 7, both normalised

The slope is looked at on an even grid over the whole reach, not only at the samples. Full-batch Adam in float64, the
step falling along a cosine to nothing: the loss is not smooth where a slope changes sign.
Source: Taheri et al., IEEE RA-L 7 (2022), section III-C.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from ..device import REAL, array, tensor
from ..interruption import INTERRUPTED
from .data import Characteristic

SLOPES = 401  # points at which the slope is looked at
RATE = 2e-2  # of Adam, at first
RAISES = 2  # times the weight of the slopes is raised by ten
LINEAR, BIASES = "linear", ("first_bias", "second_bias", "output_bias")


@dataclass(frozen=True)
class TrainedInverse:
    """Arrays of the block, the trained function (rates -> commands, SI), and how it went."""

    arrays: dict[str, np.ndarray]
    answer: Callable[[np.ndarray], np.ndarray]
    loss: float
    iterations: int
    weight: float
    stopped: str


def train(
    forward: Characteristic, *, hidden: int, positive: bool, weight: float, by_rate: bool, iterations: int, seed: int,
    progress: Callable | None,
) -> TrainedInverse:  # fmt: skip
    """Train until no slope on the grid falls, or the weight has been raised ``RAISES`` times; best loss kept."""
    scales = _scales(forward)
    z, u, w = _samples(forward, scales, by_rate)
    grid = tensor(np.linspace(z.min(), z.max(), SLOPES))
    z, u, w = tensor(z), tensor(u), tensor(w)
    raw = _first_weights(hidden, positive, seed)
    done, stopped, raises = 0, "", 0 if positive or weight == 0 else RAISES
    for k in range(raises + 1):
        raw, loss, ran, stopped = _descend(raw, positive, (z, u, w, grid), weight, iterations, done, progress)
        done += ran
        falls = float(slopes(_weights(raw, positive), grid).min()) < 0
        if stopped or not falls or k == raises:
            break
        weight *= 10
    weights = {name: value.detach() for name, value in _weights(raw, positive).items()}
    return TrainedInverse(
        {name: array(value) for name, value in weights.items()} | {k: np.array([v]) for k, v in scales.items()},
        lambda rates: _answer(weights, scales, rates), loss, done, weight, stopped,
    )  # fmt: skip


def commands(a: dict, z: torch.Tensor) -> torch.Tensor:
    """Normalised commands (n,) at normalised rates (n,)."""
    first = torch.tanh(z[:, None] * a["first_weights"] + a["first_bias"])
    second = torch.tanh(first @ a["second_weights"].T + a["second_bias"])
    return a["linear"] * z + second @ a["output_weights"] + a["output_bias"]


def slopes(a: dict, z: torch.Tensor) -> torch.Tensor:
    """du/dz (n,) of `commands`."""
    first = torch.tanh(z[:, None] * a["first_weights"] + a["first_bias"])
    second = torch.tanh(first @ a["second_weights"].T + a["second_bias"])
    through = ((1 - first**2) * a["first_weights"]) @ a["second_weights"].T
    return a["linear"] + ((1 - second**2) * through) @ a["output_weights"]


def _descend(raw, positive, data, weight, iterations, done, progress):
    """Adam from ``raw``; answers the best weights, their loss, the iterations and why it stopped early."""
    z, u, w, grid = data
    raw = {name: value.detach().clone().requires_grad_() for name, value in raw.items()}
    adam = torch.optim.Adam(raw.values(), lr=RATE)
    pace = torch.optim.lr_scheduler.CosineAnnealingLR(adam, iterations)
    best, kept, ran = math.inf, raw, 0
    try:
        for _ in range(iterations):
            adam.zero_grad()
            a = _weights(raw, positive)
            loss = (w * (commands(a, z) - u) ** 2).sum()
            if weight and not positive:
                loss = loss + weight * slopes(a, grid).clamp(max=0).abs().mean()
            if loss.item() < best:
                best, kept = loss.item(), {name: value.detach().clone() for name, value in raw.items()}
            loss.backward()
            adam.step()
            pace.step()
            ran += 1
            if progress is not None:
                progress(done + ran, loss.item())
    except KeyboardInterrupt:
        return kept, best, ran, INTERRUPTED
    return kept, best, ran, ""


def _first_weights(hidden: int, positive: bool, seed: int) -> dict[str, torch.Tensor]:
    """Random first weights; the raw numbers of positive ones, which `_weights` squares."""
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape, scale):
        return scale * torch.randn(*shape, generator=draw, dtype=REAL)

    biases = 2 * torch.rand(hidden, generator=draw, dtype=REAL) - 1
    raw = {
        "first_weights": normal(hidden, scale=3.0),
        "second_weights": normal(hidden, hidden, scale=(1 if positive else 3) / math.sqrt(hidden)),
        "output_weights": normal(hidden, scale=1 / math.sqrt(hidden)),
        "first_bias": 3 * biases,
        "second_bias": normal(hidden, scale=0.5),
        "linear": torch.full((1,), 0.3, dtype=REAL),
        "output_bias": torch.zeros(1, dtype=REAL),
    }
    return {name: tensor(value) for name, value in raw.items()}


def _weights(raw: dict[str, torch.Tensor], positive: bool) -> dict[str, torch.Tensor]:
    """The weights as the network uses them: squared where they must be positive."""
    return {name: value**2 if positive and name not in BIASES else value for name, value in raw.items()}


def _scales(forward: Characteristic) -> dict[str, float]:
    (low, high), u = forward.reach, forward.commands
    return {
        "rate_lower": low, "rate_upper": high, "rate_centre": (low + high) / 2, "rate_scale": (high - low) / 2,
        "command_centre": float(u.max() + u.min()) / 2, "command_scale": float(np.ptp(u)) / 2,
    }  # fmt: skip


def _samples(forward: Characteristic, scales: dict[str, float], by_rate: bool):
    """Normalised rates, commands and weights that sum to one: each by the rates it covers, or all alike."""
    order = np.argsort(forward.rates, kind="stable")
    r, u = forward.rates[order], forward.commands[order]
    w = np.gradient(r, edge_order=1) if by_rate else np.ones(len(r))
    w = w / np.ptp(r) + 0.02 / len(r) if by_rate else w
    z = (r - scales["rate_centre"]) / scales["rate_scale"]
    n = (u - scales["command_centre"]) / scales["command_scale"]
    return z, n, w / w.sum()


def _answer(weights: dict[str, torch.Tensor], scales: dict[str, float], rates: np.ndarray) -> np.ndarray:
    inside = np.clip(rates, scales["rate_lower"], scales["rate_upper"])
    z = tensor((inside - scales["rate_centre"]) / scales["rate_scale"])
    with torch.no_grad():
        return scales["command_centre"] + scales["command_scale"] * array(commands(weights, z))
