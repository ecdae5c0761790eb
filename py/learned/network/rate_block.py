"""A feed-forward network from delayed inputs to the rate of one output, which the block integrates; CasADi only.

    z[k]   = (u[k], u[k-1] ... u[k-lags+1])              normalised
    v[k]   = c + s (w_3 relu(W_2 relu(W_1 z + b_1) + b_2) + b_3)
    y[k+1] = y[k] + h v[k]

Source: Taheri et al., IEEE RA-L 7 (2022), section IV-A: 5 currents, two layers of 16 units, 385 weights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal

from ..block_file import LearnedKind, Shapes, register_kind
from ..gaussian.kernel_block import integrated_outputs, integrated_states, line_states, normalised_line


def weight_shapes(features: int, hidden: int) -> dict[str, tuple[int, ...]]:
    """The trained arrays, in the order of the layers."""
    h = hidden
    return {
        "first_weights": (h, features), "first_bias": (h,), "second_weights": (h, h), "second_bias": (h,),
        "output_weights": (1, h), "output_bias": (1,),
    }  # fmt: skip


def array_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    """Arrays of the block: weights, the scales of inputs and rate, the period [s]."""
    if set(structure) != {"lags", "hidden"}:
        raise TypeError("no counts of lags and hidden units")
    scales = {"input_centre": (inputs,), "input_scale": (inputs,), "rate_centre": (1,), "rate_scale": (1,)}
    return weight_shapes(inputs * structure["lags"], structure["hidden"]) | scales | {"period": (1,)}


def rate_frame(inputs: Sequence[Signal], output: Signal, lags: int) -> dict[str, tuple]:
    """The signals and states of the block: the output, its rate ``<output>.slope``, and the delay line."""
    return {
        "inputs": tuple(inputs),
        "outputs": (output, integrated_outputs(output)[2]),
        "states": (integrated_states(output, 0)[0], *line_states(inputs, lags)),
        "parameters": (),
    }


def rate_functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start``."""
    nu, lags = len(arrays["input_scale"]), structure["lags"]
    a = {name: ca.DM(value) for name, value in arrays.items()}
    x, u, p = ca.MX.sym("x", 1 + nu * (lags - 1)), ca.MX.sym("u", nu), ca.MX.sym("p", 0)
    line, z = normalised_line(arrays, u, x[1:], lags)
    h = ca.fmax(ca.mtimes(a["first_weights"], z) + a["first_bias"], 0)
    h = ca.fmax(ca.mtimes(a["second_weights"], h) + a["second_bias"], 0)
    v = a["rate_centre"] + a["rate_scale"] * (ca.mtimes(a["output_weights"], h) + a["output_bias"])
    x_next = ca.vertcat(x[0] + a["period"] * v, line[: nu * (lags - 1)])
    step = ca.Function("step", [x, u, p], [x_next, ca.vertcat(x[0], v)], ["x", "u", "p"], ["x_next", "y"])
    first = ca.MX.sym("y", 2)
    at_rest = ca.vertcat(first[0], ca.repmat(u, lags - 1, 1))
    return step, ca.Function("start", [u, first, p], [ca.densify(at_rest)], ["u", "y", "p"], ["x"])


RATE_NETWORK = register_kind(LearnedKind("rate_network", 1, array_shapes, rate_functions))
