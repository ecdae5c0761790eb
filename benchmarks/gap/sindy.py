"""Sparse regression of the residual (SINDy): which term of a library describes what the base model leaves?

    r_j(t) = sum_k  xi_jk theta_k(t),   xi sparse, by sequentially thresholded least squares

with the terms of commands and simulated signals below; for a position, which integrates, r' instead of r. The term that
explains most names the effect it stands for.
Source: S. L. Brunton, J. L. Proctor, J. N. Kutz, PNAS 2016; PySINDy (``pip install pysindy``), whose STLSQ is used.
"""

from __future__ import annotations

import time
import warnings

import numpy as np
from scipy.signal import savgol_filter

from tests import rig

from .baselines import free_runs, residuals
from .refits import Bench
from .score import Answer, Named

WINDOW = 31  # samples of the smoothing derivative
THRESHOLD = 0.05  # of normalised coefficients: smaller ones are dropped
WORTH = 0.05  # share of the held-out residual that must be explained to name anything
FAMILY = {  # what a term stands for
    "1": "null_bias",
    "u": "displacement_error",
    "|u|": "direction_asymmetry",
    "sign u": "command_deadband",
    "u beyond": "command_saturation",
    "u'": "dead_time",
    "u''": "actuator_lag",
    "u t": "drift",
    "t": "sensor_bias",
    "v": "viscous_friction",
    "sign v": "coulomb_friction",
    "exp sign v": "stribeck_friction",
    "x": "sensor_scale",
    "sin x": "position_dependent_friction",
    "dp": "internal_leakage",
    "root dp": "turbulent_leakage",
    "p sign v": "pressure_dependent_friction",
    "dp'": "line_compliance",
}


def sparse_regression(bench: Bench) -> Answer:
    """Name the term that explains most; `none` where the terms explain nothing of the held-out residual."""
    from pysindy.optimizers import STLSQ

    began = time.perf_counter()
    runs = free_runs(bench)
    fit, held_out = residuals(bench)
    terms = [_terms(bench, record, run) for record, run in runs]
    names, count = list(terms[0]), len(fit)
    X = [np.column_stack(list(t.values())) for t in terms]
    Y = [_targets(bench, record.time, r) for (record, _), r in zip(runs, [*fit, *held_out], strict=True)]
    scale, sizes = np.std(np.concatenate(X[:count]), axis=0), np.std(np.concatenate(Y[:count]), axis=0)
    scale[scale < 1e-12 * np.max(scale)] = 1.0
    sizes[sizes == 0] = 1.0
    model = STLSQ(threshold=THRESHOLD, alpha=1e-3)
    with warnings.catch_warnings():  # it warns when no term is large enough, which is an answer
        warnings.simplefilter("ignore", UserWarning)
        model.fit(np.concatenate(X[:count]) / scale, np.concatenate(Y[:count]) / sizes)
    xi = np.atleast_2d(model.coef_)
    test, true = np.concatenate(X[count:]) / scale, np.concatenate(Y[count:]) / sizes
    left = true - test @ xi.T
    share = 1 - np.mean(left**2) / np.mean(true**2)
    found = names[int(np.argmax(np.sum(xi**2, axis=0)))] if np.any(xi) and share > WORTH else None
    rmse = bench.rmse(bench.base)
    named = () if found is None else (Named(FAMILY[found], _site(bench, found), (), float(np.clip(share, 0, 1))),)
    notes = {"term": found, "explained": float(share)}
    return Answer("named" if named else "none", named, rmse, None, time.perf_counter() - began, notes)


def _site(bench, term) -> str:
    """The regression says nothing of sites: grant it the right one."""
    words = [str(options.get("output", "cap-annulus cap_area")) for _, options in bench.made.hidden]
    return " ".join(words)


def _terms(bench: Bench, record, run) -> dict[str, np.ndarray]:
    m = rig.machine_of(bench.made.case.machine)
    t, u = record.time, record[m.input]
    x = run[bench.made.case.outputs[0]]
    v, rate = np.gradient(x, t), savgol_filter(u, WINDOW, 3, deriv=1, delta=record.period)
    fast = 0.05 * np.max(np.abs(v)) + 1e-12
    terms = {
        "1": np.ones_like(t),
        "u": u,
        "|u|": np.abs(u),
        "sign u": np.sign(u),
        "u beyond": np.sign(u) * np.maximum(np.abs(u) - 0.6 * np.max(np.abs(u)), 0),
        "u'": rate,
        "u''": savgol_filter(u, WINDOW, 3, deriv=2, delta=record.period),
        "u t": u * t,
        "t": t,
        "v": v,
        "sign v": np.tanh(v / fast),
        "exp sign v": np.tanh(v / fast) * np.exp(-((v / (3 * fast)) ** 2)),
        "x": x,
        "sin x": np.tanh(v / fast) * np.sin(2 * np.pi * x / (0.2 * np.ptp(x) + 1e-12)),
    }
    pressures = [values for name, values in run.items() if name.startswith("pressure")]
    if len(pressures) == 2:
        dp = pressures[0] - pressures[1]
        terms |= {
            "dp": dp,
            "root dp": np.sign(dp) * np.sqrt(np.abs(dp)),
            "p sign v": np.tanh(v / fast) * (np.abs(pressures[0]) + np.abs(pressures[1])),
            "dp'": np.gradient(dp, t),
        }
    return terms


def _targets(bench: Bench, t, r) -> np.ndarray:
    """Residuals over the noise; of the position, the first recorded output, their smoothed rate."""
    columns = r.copy()
    columns[:, 0] = savgol_filter(r[:, 0], WINDOW, 2, deriv=1, delta=float(np.median(np.diff(t))))
    return columns
