"""A network with hidden states and an encoder for their start, in CasADi; no training library needed.

    z[k]   = (x[k], u[k])                                                   normalised; x = (y, hidden states)
    o[k]   = W_out tanh(W_in z + b_in) + W_lin z + b_out
    x[k+1] = clip(x[k] + r o[k])                r: period over the time constant of each state
    x[0]   = (y[0], V_out tanh(V_in e + c_in) + V_lin e + c_out)            e: past increments and inputs

The first states are the outputs themselves, so that a measured y[k] can be put in place of a state. The encoder sees
the last samples of a recording; a block is started from one sample alone and takes it for the whole past: a machine at
rest. The clip lies outside everything seen: a free run stays bounded.

Source: Beintema, Schoukens, Toth, "Continuous-time identification of dynamic state-space models by deep subspace
encoding", ICLR 2023; "Deep subspace encoders for nonlinear system identification", Automatica 156 (2023) 111210.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal, StateVariable

from ..block_file import LearnedKind, Shapes, register_kind

NUMBERED = "hidden_state_{}"


@dataclass(frozen=True)
class StateShape:
    """The counts that fix a network; ``past``: samples before the first that the encoder sees."""

    inputs: int
    outputs: int
    hidden_states: int
    hidden: int
    past: int
    encoder_hidden: int

    @property
    def order(self) -> int:
        """Number of states, the outputs among them."""
        return self.outputs + self.hidden_states

    @property
    def features(self) -> int:
        """Length of z."""
        return self.order + self.inputs

    @property
    def encoder_features(self) -> int:
        """Length of e: the output, its past increments, the inputs, now and past."""
        return self.outputs * (1 + self.past) + self.inputs * (1 + self.past)

    @property
    def step_weights(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the trained arrays of a step, in the order of the flat weight vector."""
        return {
            "linear_weights": (self.order, self.features),
            "output_bias": (self.order,),
            "hidden_weights": (self.hidden, self.features),
            "hidden_bias": (self.hidden,),
            "output_weights": (self.order, self.hidden),
        }

    @property
    def encoder_weights(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the trained arrays of the encoder, which follow."""
        states, units, features = self.hidden_states, self.encoder_hidden, self.encoder_features
        return {
            "encoder_linear_weights": (states, features),
            "encoder_bias": (states,),
            "encoder_hidden_weights": (units, features),
            "encoder_hidden_bias": (units,),
            "encoder_output_weights": (states, units),
        }

    @property
    def weights(self) -> dict[str, tuple[int, ...]]:
        """Shapes of all trained arrays."""
        return self.step_weights | self.encoder_weights

    @property
    def size(self) -> int:
        """Number of weights."""
        return sum(int(np.prod(shape)) for shape in self.weights.values())

    def structure(self) -> dict[str, int]:
        """The counts for the block file's header."""
        counts = ("hidden_states", "hidden", "past", "encoder_hidden")
        return {name: getattr(self, name) for name in counts}


def scale_shapes(shape: StateShape) -> dict[str, tuple[int, ...]]:
    """Arrays beside the weights: scales of inputs and outputs, rates r and bounds of the normalised states."""
    per_input, per_output = ("input_centre", "input_scale"), ("output_centre", "output_scale")
    per_state = ("rate", "state_lower", "state_upper")
    return (
        dict.fromkeys(per_input, (shape.inputs,))
        | dict.fromkeys(per_output, (shape.outputs,))
        | dict.fromkeys(per_state, (shape.order,))
    )


def array_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    """Arrays of a block: its weights, scales and bounds."""
    shape = StateShape(inputs, outputs, **structure)
    return shape.weights | scale_shapes(shape)


def network_states(shape: StateShape, outputs: Sequence[Signal]) -> tuple[StateVariable, ...]:
    """The outputs (measured, SI) and the hidden states, which have no unit."""
    hidden = range(1, shape.hidden_states + 1)
    return tuple(StateVariable(s.name, s.unit, s.description, s.nominal, measured_by=s.name) for s in outputs) + tuple(
        StateVariable(NUMBERED.format(k), "1", "hidden state of the network, over its spread") for k in hidden
    )


def network_functions(
    arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]
) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start`` of a network."""
    shape = StateShape(len(arrays["input_scale"]), len(arrays["output_scale"]), **structure)
    a = {name: ca.DM(value) for name, value in arrays.items()}
    x, u, p = ca.SX.sym("x", shape.order), ca.SX.sym("u", shape.inputs), ca.SX.sym("p", 0)
    hidden_scale = ca.DM.ones(shape.hidden_states)
    scale = ca.vertcat(a["output_scale"], hidden_scale)
    centre = ca.vertcat(a["output_centre"], 0 * hidden_scale)
    normal = (x - centre) / scale
    driven = (u - a["input_centre"]) / a["input_scale"]
    z = ca.vertcat(normal, driven)
    moved = ca.mtimes(a["linear_weights"], z) + a["output_bias"]
    if shape.hidden:
        h = ca.tanh(ca.mtimes(a["hidden_weights"], z) + a["hidden_bias"])
        moved += ca.mtimes(a["output_weights"], h)
    following = ca.fmin(ca.fmax(normal + a["rate"] * moved, a["state_lower"]), a["state_upper"])
    y = x[: shape.outputs]
    step = ca.Function("step", [x, u, p], [ca.densify(centre + scale * following), y], ["x", "u", "p"], ["x_next", "y"])
    first = ca.SX.sym("y", shape.outputs)
    still = ca.vertcat(
        (first - a["output_centre"]) / a["output_scale"],
        ca.SX.zeros(shape.outputs * shape.past),
        ca.repmat(driven, 1 + shape.past, 1),
    )
    begun = ca.vertcat(first, _encoded(a, still, shape)) if shape.hidden_states else first
    return step, ca.Function("start", [u, first, p], [ca.densify(begun)], ["u", "y", "p"], ["x"])


def _encoded(a: Mapping[str, ca.DM], e: ca.SX, shape: StateShape) -> ca.SX:
    """The hidden states from the features of the encoder, within their bounds."""
    found = ca.mtimes(a["encoder_linear_weights"], e) + a["encoder_bias"]
    if shape.encoder_hidden:
        h = ca.tanh(ca.mtimes(a["encoder_hidden_weights"], e) + a["encoder_hidden_bias"])
        found += ca.mtimes(a["encoder_output_weights"], h)
    lower, upper = (a[f"state_{side}"][shape.outputs :] for side in ("lower", "upper"))
    return ca.fmin(ca.fmax(found, lower), upper)


STATE_NETWORK = register_kind(LearnedKind("state_network", 1, array_shapes, network_functions))
