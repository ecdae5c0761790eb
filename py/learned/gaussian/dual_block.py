"""The dual Gaussian process in CasADi: currents to spool, spool to the rate of the output; no training library needed.

    s      = mean_I(u[k], u[k-1] ...)               spool, see `kernel_block`
    v      = sum_j c_j B((s - s_j) / h)             rate of the output, the mean of process II as a cubic spline
    var v  = var_II(s) + (dv/ds)^2 var_I            to first order in what is not known of the spool
    y[k+1] = y[k] + T v                             its band: see `integrated_band`, directions of both processes

With ``lead`` 0, as in the paper, s is the spool at sample k, when the interval begins over which the output moves by
T v. With ``lead`` 1 it is the spool at k+1, when the interval ends: where the valve is faster than the sampling, it is
there that the spool has followed the current of sample k.

Source: Taheri et al., IEEE Robotics and Automation Letters 7 (2022) 9526-9533, section III-B.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import StateVariable

from ..block_file import LearnedKind, Shapes, register_kind
from .integrated_band import HELD, advanced, beyond, deviation
from .kernel_block import (
    KERNELS,
    band_shapes,
    integrated_outputs,
    integrated_states,
    level_outputs,
    line_states,
    normalised_line,
    posterior,
    process_shapes,
)

OUTPUTS = 6  # spool, spool.sd, output, output.sd, output.slope, output.slope.sd


def spline(coefficients: np.ndarray, bounds: np.ndarray, x):
    """Value and slope at ``x`` of a cubic spline on even knots, constant outside its bounds.

    B(t) = (a^3 - 4 b^3) / 6,   a = max(2 - |t|, 0),   b = max(1 - |t|, 0)
    """
    low, high = (float(v) for v in bounds)
    step = (high - low) / (len(coefficients) - 3)
    t = (ca.fmin(ca.fmax(x, low), high) - low) / step - ca.DM(np.arange(-1.0, len(coefficients) - 1.0))
    a, b = ca.fmax(2.0 - ca.fabs(t), 0.0), ca.fmax(1.0 - ca.fabs(t), 0.0)
    c = ca.DM(coefficients)
    slope = ca.dot(c, ca.sign(t) * (2.0 * b * b - 0.5 * a * a)) / step
    return ca.dot(c, a * a * a - 4.0 * b * b * b) / 6.0, slope


def rate(arrays: Mapping[str, np.ndarray], spool, spool_sd):
    """Mean and standard deviation of the output's rate for a spool that is known to ``spool_sd``; SI."""
    v, slope = spline(arrays["rate_mean"], arrays["spool_range"], spool)
    own = spline(arrays["rate_sd"], arrays["spool_range_of_sd"], spool)[0]
    return v, ca.sqrt(own * own + (slope * spool_sd) ** 2)


def rate_directions(arrays: Mapping[str, np.ndarray], spool, k_sd):
    """What the directions of process I, then those of process II, do to the rate (R, 1)."""
    slope = spline(arrays["rate_mean"], arrays["spool_range"], spool)[1]
    own = [spline(c, arrays["spool_range"], spool)[0] for c in arrays["rate_directions"]]
    return ca.vertcat(slope * ca.mtimes(ca.DM(arrays["directions"][0]).T, k_sd), *own)


def dual_frame(inputs, through, output, lags: int, lead: int, directions: int) -> dict[str, tuple]:
    """The signals and states of the block; ``directions`` of both processes."""
    spool = (
        StateVariable(through.name, through.unit, "predicted at the sample before", through.nominal),
        StateVariable(f"{through.name}.sd", through.unit, "its standard deviation", through.nominal, (0.0, np.inf)),
    )
    return {
        "inputs": tuple(inputs),
        "outputs": level_outputs(through) + integrated_outputs(output),
        "states": integrated_states(output, directions) + (spool if lead else ()) + line_states(inputs, lags),
        "parameters": (),
    }


def array_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    """Arrays of a dual process: those of process I, and the splines of process II."""
    s = structure
    return process_shapes(1, s["lags"] * inputs, inputs, s["points"], s["sd_points"], s["rank"]) | {
        "rate_mean": (s["knots"],),
        "rate_sd": (s["sd_knots"],),
        "spool_range": (2,),
        "spool_range_of_sd": (2,),
        "period": (),
        **band_shapes(1, s["sd_points"], s["directions"]),
        "rate_directions": (s["rate_directions"], s["knots"]),
        "rate_noise": (),
        "run_scale": (2,),
        "step_scale": (2,),
    }


def dual_functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start`` of a dual Gaussian process."""
    nu, lags, lead = len(arrays["input_scale"]), structure["lags"], structure["lead"]
    period, kernel = float(arrays["period"]), KERNELS[structure["kernel"]]
    own = HELD + structure["directions"] + structure["rate_directions"] + 1
    held = own + (2 if lead else 0)
    x, u, p = ca.MX.sym("x", held + nu * (lags - 1)), ca.MX.sym("u", nu), ca.MX.sym("p", 0)
    line, z = normalised_line(arrays, u, x[held:], lags)
    *spool, k_sd = posterior(arrays, 0, z, kernel)
    v, v_sd = rate(arrays, *spool)
    effect = ca.vertcat(rate_directions(arrays, spool[0], k_sd), beyond(v_sd**2, float(arrays["inside"][0])))
    band, y_next = x[1:own], x[0] + period * v
    held_on = advanced(x[0], y_next, band, period * effect)
    following = [y_next, held_on, *(spool if lead else ()), line[: nu * (lags - 1)]]
    s, s_latent = (x[own], x[own + 1]) if lead else spool
    run, one = (arrays[f"{part}_scale"].tolist() for part in ("run", "step"))
    rate_noise = float(arrays["rate_noise"])
    y_sd = deviation(band, (float(arrays["run_noise"][0]), run[1]), (period * rate_noise, one[1]))
    s_sd = run[0] * ca.sqrt(s_latent**2 + float(arrays["noise"][0]) ** 2)
    seen = [s, s_sd, x[0], y_sd, v, ca.sqrt(v_sd**2 + rate_noise**2)]
    step = ca.Function("step", [x, u, p], [ca.vertcat(*following), ca.vertcat(*seen)], ["x", "u", "p"], ["x_next", "y"])

    y = ca.MX.sym("y", OUTPUTS)
    past = ca.repmat(u, lags - 1, 1)
    at_rest = posterior(arrays, 0, normalised_line(arrays, u, past, lags)[1], kernel)[:2] if lead else ()
    first = ca.densify(ca.vertcat(y[2], y[2], *[0.0] * (own - 2), *at_rest, past))
    return step, ca.Function("start", [u, y, p], [first], ["u", "y", "p"], ["x"])


DUAL_GAUSSIAN_PROCESS = register_kind(LearnedKind("dual_gaussian_process", 2, array_shapes, dual_functions))
