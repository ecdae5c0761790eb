"""Inverse characteristics as blocks: wanted rate in, command out; numpy and CasADi only.

Table:     u = u_0 + sum_i s_i clip(r - r_i, 0, r_{i+1} - r_i),   s_i >= 0
Network:   u = c_u + k_u (a z + W_3 tanh(W_2 tanh(W_1 z + b_1) + b_2) + b_3),   z = (clip(r) - c_r)/k_r

Beyond the rates that were seen both hold their end. The table rises or stays, whatever the rounding: every term does.
A network whose weights are all positive does too; that of a trained network is checked (`least_slope`).
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.simulation.block import Block

from ..block_file import LearnedKind, Shapes, register_kind

GRID = 20_001
ROUNDING = 1e-9  # of the mean slope: a flat part of a network may seem to fall by its rounding


def table_expression(arrays: Mapping[str, np.ndarray], r: ca.SX) -> ca.SX:
    """Command [SI] of a table at a wanted rate: knots ``rates`` (n,) rising, ``commands`` (n,) not falling."""
    rates, commands = np.asarray(arrays["rates"], float), np.asarray(arrays["commands"], float)
    width, rise = np.diff(rates), np.diff(commands)
    if (width <= 0).any() or (rise < 0).any():
        raise SolveError("inverse table: the knots must rise. Learn the inverse again.")
    u = ca.SX(commands[0])
    for left, w, slope in zip(rates, width, rise / width, strict=False):
        if slope > 0:
            u += slope * ca.fmin(ca.fmax(r - left, 0), w)
    return u


def network_expression(arrays: Mapping[str, np.ndarray], r: ca.SX) -> ca.SX:
    """Command [SI] of a network at a wanted rate."""
    a = {name: ca.DM(value) for name, value in arrays.items()}
    z = (ca.fmin(ca.fmax(r, a["rate_lower"]), a["rate_upper"]) - a["rate_centre"]) / a["rate_scale"]
    first = ca.tanh(a["first_weights"] * z + a["first_bias"])
    second = ca.tanh(ca.mtimes(a["second_weights"], first) + a["second_bias"])
    out = a["linear"] * z + ca.mtimes(a["output_weights"].T, second) + a["output_bias"]
    return a["command_centre"] + a["command_scale"] * out


def static_functions(u: ca.SX, r: ca.SX) -> tuple[ca.Function, ca.Function]:
    """``step`` and ``start`` of a block without states that answers ``u`` to ``r``."""
    x, p, y = ca.SX.sym("x", 0), ca.SX.sym("p", 0), ca.SX.sym("y")
    step = ca.Function("step", [x, r, p], [x, u], ["x", "u", "p"], ["x_next", "y"])
    start = ca.Function("start", [r, y, p], [ca.SX(0, 1)], ["u", "y", "p"], ["x"])
    return step, start


def table_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    return {"rates": (_count(structure, "knots"),), "commands": (_count(structure, "knots"),)}


def network_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    h = _count(structure, "hidden")
    layers = {"first_weights": (h,), "first_bias": (h,), "second_weights": (h, h), "second_bias": (h,)}
    numbers = ("linear", "output_bias", "rate_lower", "rate_upper", "rate_centre", "rate_scale")
    scales = dict.fromkeys((*numbers, "command_centre", "command_scale"), (1,))
    return layers | {"output_weights": (h,)} | scales


def _count(structure: Mapping[str, int], name: str) -> int:
    """A count of the structure; ``TypeError`` (which `assemble` turns into its sentence) when it is not there."""
    if set(structure) != {name}:
        raise TypeError(name)
    return int(structure[name])


def _table_functions(arrays, structure):
    r = ca.SX.sym("u")
    return static_functions(table_expression(arrays, r), r)


def _network_functions(arrays, structure):
    r = ca.SX.sym("u")
    return static_functions(network_expression(arrays, r), r)


INVERSE_TABLE = register_kind(LearnedKind("inverse_table", 1, table_shapes, _table_functions))
INVERSE_NETWORK = register_kind(LearnedKind("inverse_network", 1, network_shapes, _network_functions))
EXPRESSIONS = {INVERSE_TABLE.name: table_expression, INVERSE_NETWORK.name: network_expression}


def static_answer(block: Block, values: np.ndarray) -> np.ndarray:
    """Output (n,) of a block without states at input values (n,)."""
    values = np.asarray(values, float)
    empty = np.zeros((0, len(values)))
    return block.step.map(len(values))(empty, values[None, :], empty)[1].full().ravel()


def least_slope(block: Block, points: int = GRID) -> tuple[float, float]:
    """The least slope du/dr of a block without states over its domain, on ``points`` points, and where it is."""
    grid = np.linspace(block.domain.lower[0], block.domain.upper[0], points)
    slopes = np.diff(static_answer(block, grid)) / np.diff(grid)
    worst = int(np.argmin(slopes))
    return float(slopes[worst]), float(grid[worst])


def refuse_falling(block: Block, hint: str, points: int = GRID) -> float:
    """The least slope; raises `SolveError` with ``hint`` when it is negative: such a command would run away."""
    slope, at = least_slope(block, points)
    low, high = (static_answer(block, [side])[0] for side in (block.domain.lower[0], block.domain.upper[0]))
    mean = abs(high - low) / (block.domain.upper[0] - block.domain.lower[0])
    if slope < -ROUNDING * mean:
        unit = block.inputs[0].unit
        raise SolveError(
            f"{block.name}: the inverse falls (slope {slope:.3g} at {at:.4g} {unit}, on {points} points). "
            f"A larger wanted rate must not ask for a smaller command. {hint}"
        )
    return slope
