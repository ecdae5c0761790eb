"""A learned formula without dynamics as a Block: the outputs are functions of the inputs at the same moment.

    y[k] = centre + scale * f((u[k] - input_centre) / input_scale)

It has no state. Nothing is fed back, so that nothing is clipped: a law holds as far as it holds. Tokens and constants
are those of `block`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..block_file import LearnedKind, Shapes, register_kind
from .block import expressions, token_shapes, whole_tokens

SCALES = ("input_centre", "input_scale", "output_centre", "output_scale")


@dataclass(frozen=True)
class StaticShape:
    """Counts of inputs and outputs; as `NarxShape` with nothing fed back."""

    inputs: int
    outputs: int
    output_lags: int = -1

    @property
    def features(self) -> int:
        """The inputs, once each."""
        return self.inputs


def static_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    """Arrays of a formula without dynamics."""
    if set(structure) != {"tokens", "constants"}:
        raise TypeError("no counts of tokens and constants")
    scales = {name: (inputs,) if name.startswith("input") else (outputs,) for name in SCALES}
    return token_shapes(structure) | scales


def static_functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start``, both without states."""
    a = {name: ca.DM(arrays[name]) for name in SCALES}
    nu, ny = a["input_scale"].numel(), a["output_scale"].numel()
    x, u, p, first = (ca.SX.sym(n, size) for n, size in (("x", 0), ("u", nu), ("p", 0), ("y", ny)))
    f = expressions(
        whole_tokens(arrays["tokens"]), arrays["constants"].tolist(), (u - a["input_centre"]) / a["input_scale"], ny
    )
    y = ca.densify(a["output_centre"] + a["output_scale"] * f)
    step = ca.Function("step", [x, u, p], [ca.SX(0, 1), y], ["x", "u", "p"], ["x_next", "y"])
    return step, ca.Function("start", [u, first, p], [ca.SX(0, 1)], ["u", "y", "p"], ["x"])


STATIC = register_kind(LearnedKind("static_formula", 1, static_shapes, static_functions))
