"""A Gaussian process that feeds its outputs back, in CasADi, with the band of its free run; no training library needed.

    z[k]   = (y[k], d[k-1] ... d[k-n], u[k] ... u[k-m+1])         normalised; without y[k] where ``level`` is 0
    d[k]   = clip(w' k(Z, clip(z)))                                increments, per period
    y[k+1] = clip(y[k] + d[k])

What is not known of the weights is a sum of R directions with independent N(0, 1) amplitudes. Their effect on the
states x = (y, d) is carried along to first order, so that the error of the model is the same function at every step,
neither drawn anew (too narrow a band) nor added up by its deviations (too wide):

    S[k+1] = dx[k+1]/dx[k] S[k] + (what the directions do in this step)
    sd     = scale sqrt(|S_y|^2 + noise)

Two more directions of each output are what is not known of its start. Where the features leave the data, the part of
the prior variance that the points do not explain is a direction of its own. The deviation is that of the measured
value: with the noise of a free run, or of one step where a measured value was put in place of the state y, of which
S_y is then zero.

Sources: Rasmussen, Williams, Gaussian Processes for Machine Learning (2006), chapter 8 (subset of regressors);
Deisenroth, Turner, Huber, Hanebeck, Rasmussen, IEEE Trans. Automatic Control 57 (2012) (moments through dynamics).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal, StateVariable

from ..block_file import LearnedKind, Shapes, register_kind
from .feedback_run import Lags
from .kernels import Hyper, Kernel, diagonal_in_casadi, in_casadi

ALIKE = 1e-9  # of the output's scale: a state nearer than this to its prediction was not replaced by a measurement
LEAST = 1e-24  # of the output's variance, under the root: keeps its derivative finite


def lags_of(structure: Mapping[str, int], inputs: int, outputs: int) -> Lags:
    """What a step sees, by the counts of the header; ``outputs`` without the deviations."""
    return Lags(inputs, outputs, structure["level"], structure["increments"], structure["samples"])


def feedback_frame(
    lags: Lags, directions: int, inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> dict[str, tuple]:
    """The signals and states of the block."""
    told = "standard deviation of the measured value"
    states = [StateVariable(s.name, s.unit, s.description, s.nominal, measured_by=s.name) for s in outputs]
    for lag in range(1, lags.increments + 1):
        states += [StateVariable(f"{s.name}.increment_{lag}", s.unit, f"increment {lag} periods ago") for s in outputs]
    moved = list(states)
    for lag in range(1, lags.samples):
        states += [StateVariable(f"{s.name}.lag_{lag}", s.unit, f"input {lag} periods ago") for s in inputs]
    for s in outputs:
        states.append(StateVariable(f"{s.name}.expected", s.unit, "what the step before predicted"))
    for s in outputs:
        states.append(StateVariable(f"{s.name}.noise", "1", "share of one step in the noise: 1 after a measurement"))
    for r in range(1, directions + 1):
        told_of = f"effect of direction {r} of the model error"
        states += [StateVariable(f"{s.name}.by_{r}", s.unit, told_of) for s in moved]
    made = [(s, Signal(f"{s.name}.sd", s.unit, told, s.nominal)) for s in outputs]
    return {
        "inputs": tuple(inputs),
        "outputs": tuple(s for pair in made for s in pair),
        "states": tuple(states),
        "parameters": (),
    }


def directions_of(structure: Mapping[str, int], outputs: int) -> int:
    """All directions: of the weights, outside the data, of the start (value and increment of every output)."""
    return structure["directions"] + outputs + 2 * outputs


def array_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    """Arrays of a block; ``outputs`` counts the deviations too. Deviations over the scale of their output."""
    ny = outputs // 2
    d, M, R = lags_of(structure, inputs, ny).features, structure["points"], structure["directions"]
    factors, terms = structure["factors"], structure["terms"]
    per_output = ("output_centre", "output_scale", "increment_scale", "increment_limit", "output_lower", "output_upper")
    band = ("unexplained", "start_noise", "start_increment", "run_noise", "step_noise", "run_scale", "step_scale")
    return {
        "input_centre": (inputs,),
        "input_scale": (inputs,),
        **dict.fromkeys(per_output, (ny,)),
        "feature_lower": (d,),
        "feature_upper": (d,),
        "kernel": (factors, 2),
        "variances": (ny, terms),
        "lengths": (ny, factors, d),
        "points": (M, d),
        "whitening": (ny, M, M),
        "weights": (ny, M),
        "directions": (ny, M, R),
        **dict.fromkeys(band, (ny,)),
    }


def feedback_functions(
    arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]
) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start``."""
    nu, ny = len(arrays["input_scale"]), len(arrays["output_scale"])
    lags, R = lags_of(structure, nu, ny), directions_of(structure, ny)
    moved, past_u = ny * (1 + lags.increments), nu * (lags.samples - 1)
    a = {key: ca.DM(value) for key, value in arrays.items() if value.ndim == 1}
    x = ca.MX.sym("x", moved + past_u + 2 * ny + moved * R)
    u, p = ca.MX.sym("u", nu), ca.MX.sym("p", 0)
    fed, old_u, expected, fresh, S = ca.vertsplit(x, np.cumsum([0, moved, past_u, ny, ny, moved * R]).tolist())
    known = ca.fabs(fed[:ny] - expected) > ALIKE * a["output_scale"]
    S = ca.reshape(S, moved, R) * ca.repmat(ca.vertcat(ca.if_else(known, 0.0, 1.0), ca.DM.ones(moved - ny, 1)), 1, R)

    state, line = ca.MX.sym("state", moved), ca.vertcat(u, old_u)
    inputs = ca.MX.sym("line", line.numel())
    following, direct = _moved(arrays, lags, a, state, inputs)
    advance = ca.Function("advance", [state, inputs], [following, ca.jacobian(following, state), direct])
    x_moved, J, effect = advance(fed, line)
    effect = effect * ca.repmat(a["increment_scale"], 1, effect.size2())
    pushed = ca.horzcat(effect, ca.MX.zeros(ny, 2 * ny))
    first, kept = min(1 + lags.increments, 2), ny * max(lags.increments - 1, 0)
    S_next = ca.mtimes(J, S) + ca.vertcat(*[pushed] * first, ca.MX.zeros(kept, R))
    noise = ca.if_else(known, 1.0, 0.0)
    x_next = ca.vertcat(x_moved, line[:past_u, :], x_moved[:ny], noise, ca.vec(S_next))

    y = fed[:ny]
    scale2 = a["output_scale"] ** 2
    model = ca.sum2(S[:ny, :] ** 2)
    run = a["run_scale"] ** 2 * (model + a["run_noise"] ** 2 * scale2)
    one = a["step_scale"] ** 2 * (model + a["step_noise"] ** 2 * scale2)
    sd = ca.sqrt(ca.if_else(fresh > 0.5, one, run) + LEAST * scale2)
    seen = ca.vec(ca.horzcat(y, sd).T)
    step = ca.Function("step", [x, u, p], [ca.densify(x_next), ca.densify(seen)], ["x", "u", "p"], ["x_next", "y"])
    return step, _start(lags, R, a)


def _start(lags: Lags, R: int, a: Mapping[str, ca.DM]) -> ca.Function:
    """At rest at the first measured outputs, which are known to their noise; increments to what they began with."""
    ny, nu = lags.outputs, lags.inputs
    u, y, p = ca.MX.sym("u", nu), ca.MX.sym("y", 2 * ny), ca.MX.sym("p", 0)
    first = ca.vertcat(*[y[2 * j] for j in range(ny)])
    S = ca.DM.zeros(ny * (1 + lags.increments), R)
    for j in range(ny):
        S[j, R - 2 * ny + j] = a["start_noise"][j] * a["output_scale"][j]
        for lag in range(1, lags.increments + 1):
            S[lag * ny + j, R - ny + j] = a["start_increment"][j] * a["increment_scale"][j]
    rest = ca.MX.zeros(ny * lags.increments)
    x = ca.vertcat(first, rest, ca.repmat(u, lags.samples - 1, 1), first, ca.MX.zeros(ny), ca.vec(ca.MX(S)))
    return ca.Function("start", [u, y, p], [ca.densify(x)], ["u", "y", "p"], ["x"])


def _moved(arrays: Mapping[str, np.ndarray], lags: Lags, a: Mapping[str, ca.DM], state, line):
    """Outputs and increments one period later, SI, and what the directions do to this increment (ny, R + ny)."""
    ny = lags.outputs
    y, d = state[:ny, :], state[ny:, :]
    level = (y - a["output_centre"]) / a["output_scale"]
    past = d / ca.repmat(a["increment_scale"], lags.increments, 1)
    u = (line - ca.repmat(a["input_centre"], lags.samples, 1)) / ca.repmat(a["input_scale"], lags.samples, 1)
    z = ca.vertcat(*[level][1 - lags.level :], past, u)
    seen = ca.fmin(ca.fmax(z, a["feature_lower"]), a["feature_upper"])
    kernel, o, effects = Kernel.of_table(arrays["kernel"]), [], []
    for j in range(ny):
        hyper = Hyper(kernel, arrays["variances"][j], arrays["lengths"][j])
        k = in_casadi(hyper, arrays["points"], seen)
        o.append(ca.dot(ca.DM(arrays["weights"][j]), k))
        told = ca.sumsqr(ca.mtimes(ca.tril(ca.DM(arrays["whitening"][j])), in_casadi(hyper, arrays["points"], z)))
        beyond = ca.sqrt(ca.fmax(diagonal_in_casadi(hyper, z) - told - float(arrays["unexplained"][j]), LEAST))
        outside = [beyond if i == j else 0.0 for i in range(ny)]
        effects.append(ca.horzcat(ca.mtimes(ca.DM(arrays["directions"][j]).T, k).T, *outside))
    o = ca.fmin(ca.fmax(ca.vertcat(*o), -a["increment_limit"]), a["increment_limit"])
    moved = o * a["increment_scale"]
    y_next = ca.fmin(ca.fmax(y + moved, a["output_lower"]), a["output_upper"])
    kept = ca.vertcat(moved, d)[: ny * lags.increments, :]  # two indices: [:0] of a scalar is (1, 0)
    return ca.vertcat(y_next, kept), ca.vertcat(*effects)


FEEDBACK = register_kind(LearnedKind("gaussian_feedback", 1, array_shapes, feedback_functions))
