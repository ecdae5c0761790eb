"""A Gaussian process's equations in CasADi, for inputs from a delay line; no training library needed.

    z     = (u[k], u[k-1] ... u[k-l+1])              normalised, over the length scales
    mean  = w' k(X, clip(z))                         X: all training points, or the inducing points
    var   = s2 - |T k(Z, z)|^2                       Z: inducing points, T upper trapezoidal

    rbf       k(x, z) = exp(-|x - z|^2 / 2)
    matern32  k(x, z) = (1 + r) exp(-r),   r = sqrt(3) |x - z|

The deviation told is that of the measured value: the variance of the latent function (Eq. 3 of the paper) with the
noise. The mean is clipped to the range seen in training, so that it keeps its value at the edge, where it would fall
back to the average; the variance is not, so that it grows to its prior value away from the data.

An output is either the process itself, or integrates it: y[k+1] = y[k] + T f(z). For its standard deviation see
`integrated_band`.

Source: Taheri et al., IEEE Robotics and Automation Letters 7 (2022) 9526-9533, section III-B; Rasmussen, Williams,
Gaussian Processes for Machine Learning (2006), chapters 2 and 4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal, StateVariable

from ..block_file import LearnedKind, Shapes, register_kind
from .integrated_band import HELD, advanced, band_states, beyond, deviation

KERNELS = ("rbf", "matern32")
LEAST_VARIANCE = 1e-12  # of the prior variance: keeps the derivative of the root finite
LARGEST_C, BYTES_OF_CONSTANT = 5e6, 30  # bytes of generated C; of one double in it, with its share of the indices
TINY = 1e-20  # under the root of a squared distance, for the same reason


def kernel_values(points, z, kernel: str):
    """k(points, z) over the prior variance, (P, 1); ``points`` (P, d) numbers and ``z`` (d, 1) over the lengths."""
    half_squares = ca.DM(0.5 * np.sum(np.square(points), axis=1))
    half_distance = half_squares + 0.5 * ca.sumsqr(z) - ca.mtimes(ca.DM(points), z)
    if kernel == "rbf":
        return ca.exp(-half_distance)
    r = ca.sqrt(6.0 * ca.fmax(half_distance, 0.0) + TINY)
    return (1.0 + r) * ca.exp(-r)


def posterior(arrays: Mapping[str, np.ndarray], j: int, z, kernel: str):
    """Mean, standard deviation of the latent function, and correlations with the points of the deviation (M, 1).

    Of process ``j`` at the normalised features ``z``, in the output's scale.
    """
    lengths = ca.DM(arrays["lengths"][j])
    repeats = z.numel() // len(arrays["input_lower"])
    low, high = (ca.repmat(ca.DM(arrays[f"input_{side}"]), repeats, 1) for side in ("lower", "upper"))
    inside = ca.fmin(ca.fmax(z, low), high)
    k_mean = kernel_values(arrays["points"][j], inside / lengths, kernel)
    mean = arrays["output_centre"][j] + ca.dot(ca.DM(arrays["weights"][j]), k_mean)
    k_sd = kernel_values(arrays["sd_points"][j], z / lengths, kernel)
    explained = ca.mtimes(ca.triu(ca.DM(arrays["sd_factor"][j])), k_sd)
    prior = float(arrays["prior_variance"][j])
    variance = prior - ca.sumsqr(explained)
    return mean, ca.sqrt(ca.fmax(variance, LEAST_VARIANCE * prior)), k_sd


def process_shapes(count: int, features: int, inputs: int, points: int, sd_points: int, rank: int) -> Shapes:
    """Arrays of ``count`` Gaussian processes over the same features; means and deviations in SI."""
    return {
        "input_centre": (inputs,),
        "input_scale": (inputs,),
        "input_lower": (inputs,),
        "input_upper": (inputs,),
        "lengths": (count, features),
        "points": (count, points, features),
        "weights": (count, points),
        "sd_points": (count, sd_points, features),
        "sd_factor": (count, rank, sd_points),
        "prior_variance": (count,),
        "output_centre": (count,),
        "noise": (count,),
    }


def band_shapes(count: int, sd_points: int, directions: int) -> Shapes:
    """Arrays of the band of ``count`` outputs that integrate; noise, and the largest variance in training, in SI."""
    noise = ("run_noise", "run_scale", "step_scale", "inside")
    return {"directions": (count, sd_points, directions)} | dict.fromkeys(noise, (count,))


def normalised_line(arrays: Mapping[str, np.ndarray], u, past, lags: int):
    """The delay line (u[k], u[k-1] ...) as it is and normalised, each (lags nu, 1)."""
    line = ca.vertcat(u, past)
    centre, scale = (ca.repmat(ca.DM(arrays[f"input_{part}"]), lags, 1) for part in ("centre", "scale"))
    return line, (line - centre) / scale


def line_states(inputs: Sequence[Signal], lags: int) -> tuple[StateVariable, ...]:
    """The past inputs as named states."""
    return tuple(
        StateVariable(f"{s.name}.lag_{lag}", s.unit, f"input {lag} periods ago")
        for lag in range(1, lags)
        for s in inputs
    )


def level_outputs(output: Signal) -> tuple[Signal, ...]:
    """An output that is a process: its mean and standard deviation."""
    return output, Signal(f"{output.name}.sd", output.unit, "standard deviation of the measured value", output.nominal)


def integrated_outputs(output: Signal) -> tuple[Signal, ...]:
    """An output that integrates a process: itself, its standard deviation, its slope and the slope's."""
    slope = f"{output.name}.slope"
    return (
        output,
        Signal(f"{output.name}.sd", output.unit, "standard deviation of the measured value", output.nominal),
        Signal(slope, f"{output.unit}/s", f"rate of {output.name} over the next period", output.nominal),
        Signal(
            f"{slope}.sd",
            f"{output.unit}/s",
            f"standard deviation of the measured rate of {output.name}",
            output.nominal,
        ),
    )


def integrated_states(output: Signal, directions: int) -> tuple[StateVariable, ...]:
    """The states of an output that integrates: itself first, then those of its band."""
    own = StateVariable(output.name, output.unit, output.description, output.nominal, measured_by=output.name)
    return (own, *band_states(output, directions + 1))


def process_frame(inputs, outputs, lags: int, rate: bool, directions: int = 0) -> dict[str, tuple]:
    """The signals and states of the block; ``directions`` of the band of an output that integrates."""
    made = [integrated_outputs(s) if rate else level_outputs(s) for s in outputs]
    states = [integrated_states(s, directions) for s in outputs] if rate else []
    return {
        "inputs": tuple(inputs),
        "outputs": tuple(s for group in made for s in group),
        "states": tuple(s for group in states for s in group) + line_states(inputs, lags),
        "parameters": (),
    }


def _count(structure: Mapping[str, int], outputs: int) -> int:
    return outputs // (4 if structure["rate"] else 2)


def array_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    """Arrays of a block of Gaussian processes; of those that integrate, also the period."""
    count, features = _count(structure, outputs), structure["lags"] * inputs
    shapes = process_shapes(count, features, inputs, *(structure[part] for part in ("points", "sd_points", "rank")))
    if not structure["rate"]:
        return shapes | {"run_scale": (count,)}
    return shapes | band_shapes(count, structure["sd_points"], structure["directions"]) | {"period": ()}


def process_functions(
    arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]
) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start`` of a block of Gaussian processes."""
    nu, count, lags, rate = len(arrays["input_scale"]), len(arrays["lengths"]), structure["lags"], structure["rate"]
    each = HELD + structure["directions"] + 1 if rate else 0
    held, period = each * count, float(arrays.get("period", 1.0))
    x, u, p = ca.MX.sym("x", held + nu * (lags - 1)), ca.MX.sym("u", nu), ca.MX.sym("p", 0)
    line, z = normalised_line(arrays, u, x[held:], lags)
    found = [posterior(arrays, j, z, KERNELS[structure["kernel"]]) for j in range(count)]
    following, seen = [], []
    for j, (mean, latent, k_sd) in enumerate(found):
        noise = float(arrays["noise"][j])
        measured = ca.sqrt(latent**2 + noise**2)
        scale = {part: float(arrays[f"{part}_scale"][j]) for part in ("run", "step") if f"{part}_scale" in arrays}
        if rate:
            y, band = x[each * j], x[each * j + 1 : each * (j + 1), :]
            effect = ca.mtimes(ca.DM(arrays["directions"][j]).T, k_sd)
            effect = period * ca.vertcat(effect, beyond(latent**2, float(arrays["inside"][j])))
            y_next = y + period * mean
            following += [y_next, advanced(y, y_next, band, effect)]
            run, one = (float(arrays["run_noise"][j]), scale["run"]), (period * noise, scale["step"])
            seen += [y, deviation(band, run, one), mean, measured]
        else:
            seen += [mean, scale["run"] * measured]
    x_next = ca.vertcat(*following, line[: nu * (lags - 1)])
    step = ca.Function("step", [x, u, p], [x_next, ca.vertcat(*seen)], ["x", "u", "p"], ["x_next", "y"])
    y_first = ca.MX.sym("y", count * (4 if rate else 2))
    rest = [0.0] * (each - 2)
    measured = [part for j in range(count) for part in (y_first[4 * j], y_first[4 * j], *rest)] if rate else []
    at_rest = ca.vertcat(*measured, ca.repmat(u, lags - 1, 1))
    return step, ca.Function("start", [u, y_first, p], [ca.densify(at_rest)], ["u", "y", "p"], ["x"])


GAUSSIAN_PROCESS = register_kind(LearnedKind("gaussian_process", 2, array_shapes, process_functions))
