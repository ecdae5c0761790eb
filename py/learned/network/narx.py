"""The network's equations: a free-running NARX with integrating outputs, in CasADi; no training library needed.

    z[k]   = (y[k], d[k-1] ... d[k-n], u[k] ... u[k-m+1])          normalised
    d[k]   = clip(W_out tanh(W_in clip(z) + b_in) + W_lin z + b_out)     increments, per period
    y[k+1] = clip(y[k] + d[k])

The increments are states of their own (velocity-like), so that putting a measured y[k] in place of the state gives a
proper one-step prediction. The inner clip is the range seen in training and some more: beyond it the hidden layer keeps
its edge value and the linear part alone goes on. The outer clips lie outside everything seen: a free run stays bounded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal, StateVariable

from ..block_file import LearnedKind, Shapes, register_kind


@dataclass(frozen=True)
class NarxShape:
    """The counts that fix a network: outputs, inputs, lags of the increments, samples of the inputs, hidden units."""

    inputs: int
    outputs: int
    output_lags: int
    input_lags: int
    hidden: int

    @property
    def fed_back(self) -> int:
        """Features that come from the network's own outputs."""
        return self.outputs * (1 + self.output_lags)

    @property
    def features(self) -> int:
        """Length of z."""
        return self.fed_back + self.inputs * self.input_lags

    @property
    def weights(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the trained arrays, in the order of the flat weight vector."""
        return {
            "hidden_weights": (self.hidden, self.features),
            "hidden_bias": (self.hidden,),
            "output_weights": (self.outputs, self.hidden),
            "linear_weights": (self.outputs, self.features),
            "output_bias": (self.outputs,),
        }

    @property
    def size(self) -> int:
        """Number of weights."""
        return sum(int(np.prod(shape)) for shape in self.weights.values())

    def structure(self) -> dict[str, int]:
        """The counts for the block file's header."""
        return {"output_lags": self.output_lags, "input_lags": self.input_lags, "hidden": self.hidden}


def network_states(shape: NarxShape, inputs: Sequence[Signal], outputs: Sequence[Signal]) -> tuple[StateVariable, ...]:
    """The delay lines as named states: outputs (measured), past increments, past inputs; all SI."""
    states = [StateVariable(s.name, s.unit, s.description, s.nominal, measured_by=s.name) for s in outputs]
    for lag in range(1, shape.output_lags + 1):
        states += [StateVariable(f"{s.name}.increment_{lag}", s.unit, f"increment {lag} periods ago") for s in outputs]
    for lag in range(1, shape.input_lags):
        states += [StateVariable(f"{s.name}.lag_{lag}", s.unit, f"input {lag} periods ago") for s in inputs]
    return tuple(states)


def array_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    """Arrays of a network block: its weights, the scales and bounds of a free run, the range of every feature."""
    shape = NarxShape(inputs, outputs, **structure)
    range_ = {"feature_lower": (shape.features,), "feature_upper": (shape.features,)}
    return shape.weights | scale_shapes(inputs, outputs) | range_


def scale_shapes(inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
    """The scales of a NARX and the bounds of its free run, which `narx_functions` needs beside the increments."""
    per_input = ("input_centre", "input_scale")
    per_output = ("output_centre", "output_scale", "increment_scale", "increment_limit", "output_lower", "output_upper")
    return dict.fromkeys(per_input, (inputs,)) | dict.fromkeys(per_output, (outputs,))


def narx_functions(
    shape: NarxShape, arrays: Mapping[str, np.ndarray], increments: Callable[[ca.SX], ca.SX]
) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start`` of a NARX with integrating outputs.

    arrays : those of `scale_shapes`, SI, ``increment_limit`` in increment scales. increments : the normalised
    increments (ny,) of the normalised features z; they are clipped here.
    """
    nu, ny = shape.inputs, shape.outputs
    a = {name: ca.DM(arrays[name]) for name in scale_shapes(nu, ny)}
    x = ca.SX.sym("x", shape.fed_back + nu * (shape.input_lags - 1))
    u, p = ca.SX.sym("u", nu), ca.SX.sym("p", 0)
    y, past_d, past_u = ca.vertsplit(x, [0, ny, shape.fed_back, x.numel()])
    u_line = ca.vertcat(u, past_u)
    z = ca.vertcat(
        (y - a["output_centre"]) / a["output_scale"],
        past_d / ca.repmat(a["increment_scale"], shape.output_lags, 1),
        (u_line - ca.repmat(a["input_centre"], shape.input_lags, 1)) / ca.repmat(a["input_scale"], shape.input_lags, 1),
    )
    d = ca.fmin(ca.fmax(increments(z), -a["increment_limit"]), a["increment_limit"]) * a["increment_scale"]
    y_next = ca.fmin(ca.fmax(y + d, a["output_lower"]), a["output_upper"])

    kept_increments = ca.vertcat(d, past_d)[: shape.fed_back - ny, :]  # two indices: [:0] of a scalar is (1, 0)
    x_next = ca.vertcat(y_next, kept_increments, u_line[: nu * (shape.input_lags - 1), :])
    step = ca.Function("step", [x, u, p], [ca.densify(x_next), y], ["x", "u", "p"], ["x_next", "y"])
    y_first = ca.SX.sym("y", ny)
    at_rest = ca.vertcat(y_first, ca.SX.zeros(shape.fed_back - ny), ca.repmat(u, shape.input_lags - 1, 1))
    start = ca.Function("start", [u, y_first, p], [ca.densify(at_rest)], ["u", "y", "p"], ["x"])
    return step, start


def network_functions(
    arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]
) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start`` of a network."""
    shape = NarxShape(len(arrays["input_scale"]), len(arrays["output_scale"]), **structure)
    a = {name: ca.DM(arrays[name]) for name in (*shape.weights, "feature_lower", "feature_upper")}

    def increments(z):
        d = ca.mtimes(a["linear_weights"], z) + a["output_bias"]
        if not shape.hidden:
            return d
        seen = ca.fmin(ca.fmax(z, a["feature_lower"]), a["feature_upper"])
        return d + ca.mtimes(a["output_weights"], ca.tanh(ca.mtimes(a["hidden_weights"], seen) + a["hidden_bias"]))

    return narx_functions(shape, arrays, increments)


def random_steps(
    arrays: Mapping[str, np.ndarray], shape: NarxShape, points: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States (points, nx) and inputs (points, nu), SI, and the normalised features (points, nf) they make.

    For certificates: outputs fill the bounds of the free run and increments their limits, so that every clip acts;
    inputs go three scales beyond their centre.
    """
    rng, a = np.random.default_rng(0), arrays
    y = rng.uniform(a["output_lower"], a["output_upper"], (points, shape.outputs))
    centre, scale = (np.tile(a[f"input_{part}"], shape.input_lags) for part in ("centre", "scale"))
    u = rng.uniform(centre - 3 * scale, centre + 3 * scale, (points, len(centre)))
    limit, increment = (np.tile(a[f"increment_{part}"], shape.output_lags) for part in ("limit", "scale"))
    d = rng.uniform(-limit, limit, (points, len(limit)))
    z = np.hstack([(y - a["output_centre"]) / a["output_scale"], d, (u - centre) / scale])
    return np.hstack([y, d * increment, u[:, shape.inputs :]]), u[:, : shape.inputs], z


NETWORK = register_kind(LearnedKind("network", 1, array_shapes, network_functions))
