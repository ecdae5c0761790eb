"""The dual Gaussian process in CasADi: currents to spool, spool to the rate of the output; no training library needed.

    s      = mean_I(u[k], u[k-1] ...)               spool, see `kernel_block`
    v      = sum_j c_j B((s - s_j) / h)             rate of the output, the mean of process II as a cubic spline
    var v  = var_II(s) + (dv/ds)^2 var_I            to first order in what is not known of the spool
    y[k+1] = y[k] + T v

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
from .kernel_block import (
    KERNELS,
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


def dual_frame(inputs, through, output, lags: int, lead: int) -> dict[str, tuple]:
    """The signals and states of the block."""
    spool = (
        StateVariable(through.name, through.unit, "predicted at the sample before", through.nominal),
        StateVariable(f"{through.name}.sd", through.unit, "its standard deviation", through.nominal, (0.0, np.inf)),
    )
    return {
        "inputs": tuple(inputs),
        "outputs": level_outputs(through) + integrated_outputs(output),
        "states": integrated_states(output) + (spool if lead else ()) + line_states(inputs, lags),
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
    }


def dual_functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start`` of a dual Gaussian process."""
    nu, lags, lead = len(arrays["input_scale"]), structure["lags"], structure["lead"]
    held, period, kernel = 4 if lead else 2, float(arrays["period"]), KERNELS[structure["kernel"]]
    x, u, p = ca.MX.sym("x", held + nu * (lags - 1)), ca.MX.sym("u", nu), ca.MX.sym("p", 0)
    line, z = normalised_line(arrays, u, x[held:], lags)
    spool = posterior(arrays, 0, z, kernel)
    v, v_sd = rate(arrays, *spool)
    following = [x[0] + period * v, x[1] + period * v_sd, *(spool if lead else ()), line[: nu * (lags - 1)]]
    seen = [*((x[2], x[3]) if lead else spool), x[0], x[1], v, v_sd]
    step = ca.Function("step", [x, u, p], [ca.vertcat(*following), ca.vertcat(*seen)], ["x", "u", "p"], ["x_next", "y"])

    y = ca.MX.sym("y", OUTPUTS)
    past = ca.repmat(u, lags - 1, 1)
    at_rest = posterior(arrays, 0, normalised_line(arrays, u, past, lags)[1], kernel) if lead else ()
    first = ca.densify(ca.vertcat(y[2], 0.0, *at_rest, past))
    return step, ca.Function("start", [u, y, p], [first], ["u", "y", "p"], ["x"])


DUAL_GAUSSIAN_PROCESS = register_kind(LearnedKind("dual_gaussian_process", 1, array_shapes, dual_functions))
