"""Learn the dual Gaussian process of a valve and its actuator; GPyTorch is needed to train, never to run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..block_file import Certificate, LearnedBlock, assemble
from ..interruption import CtrlC
from ..needs import needed_to_train
from ..steady import steady_where_it_integrates
from ..training_data import training_box
from .delay_lines import Rows, certification_grid, delayed_rows, even_period, input_scales, training_rows
from .dual_block import DUAL_GAUSSIAN_PROCESS, dual_frame, rate
from .kernel_block import KERNELS
from .single import free_run_errors, recordings
from .training import (
    DeployedProcess,
    apart,
    check_options,
    check_size,
    counts,
    provenance,
    reference_name,
    stacked,
    train_process,
)

VERB = "learn_dual_gp"
SD_KNOTS = 3  # times those of the mean: the deviation is needed for one range beyond either end
BINS = 40  # classes of the spool, to compare leads
PLACES = 501  # of the spool, where process II is compared
SHARE_OF_ONE = 0.5  # of the bound: what process I may use of it


def learn_dual_gp(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    through: Signal | str = "spool",
    lead: int | None = None,
    kernel: str | tuple[str, str] | None = None,
    lags: int = 5,
    fit: str = "default",
    points: int | None = 1000,
    samples: int = 6000,
    compress: int | str | None = "auto",
    knots: int = 60,
    bound: float = 0.02,
    period: float | None = None,
    validate: Sequence[Record] = (),
    seed: int = 0,
    name: str = "dual_gp",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Train process I, delayed inputs to spool, and process II, measured spool to the raw rate of the output.

    The block runs them in cascade, without the spool sensor, and integrates the rate. ``provenance["errors"]`` tells
    each process apart: RMSE of the spool, of the rate on the measured spool, and of the rate in cascade, against raw
    samples; ``provenance["validation"]`` the free runs over ``validate``. Ctrl-C ends the fits of both processes with
    the best so far, the second one with what 100 rows give in a moment where its turn had not come.

    Args (others as in `learn_gaussian_process`):
        outputs: one output, which integrates. through: the measured signal between the two processes.
        lead: 0 pairs the rate over an interval with the spool at its beginning, as the paper does, 1 with the spool at
            its end; None: 0 for ``fit="paper"``, else the one that explains more of the rates.
        kernel: one name or one for each process; None: rbf and matern32, rbf for both with ``fit="paper"``.
        knots: B-splines of process II over the range of the spool.

    Raises: as `learn_gaussian_process`.
    """
    with needed_to_train(VERB):
        from . import exact as exact_gp
    kernels = _kernels(kernel, fit)
    _check(kernels, lead, knots, lags, fit, points, samples, compress, bound, period)
    inputs, both, records, validate = _recordings(records, inputs, outputs, through, validate)
    period = float(period or even_period(records))
    rng = np.random.default_rng(seed)
    rows = training_rows(records, period, inputs, both, lags, samples, rng)
    lead = _lead(rows, fit) if lead is None else lead
    check_size(VERB, len(rows), rows.features.shape[1], 1, compress)
    held_out = [delayed_rows(r, period, inputs, both, lags) for r in validate]
    grid = certification_grid([rows, *held_out], len(inputs), lags, rng)
    options = {"fit": fit, "points": points, "compress": compress}
    with CtrlC() as ctrl_c:
        shared = {**options, "bound": SHARE_OF_ONE * bound, "rng": rng, "progress": progress, "ctrl_c": ctrl_c}
        scales = input_scales(rows.features, len(inputs))
        spool, slopes = _spool(rows, lead), rows.slopes[:, 1]
        one = train_process(
            exact_gp, rows.features, spool, scales, grid, kernel=kernels[0], label=both[0].name, **shared
        )
        two = _second(exact_gp, spool, slopes, kernel=kernels[1], label=f"{both[1].name}.slope", **shared)
        process, splines = stacked([one.arrays]), _splines(two, spool, knots)
        block = assemble(
            DUAL_GAUSSIAN_PROCESS,
            scales | process | splines | {"period": np.array(period)},
            {
                "kernel": KERNELS.index(kernels[0]),
                "lags": lags,
                "lead": lead,
                "knots": knots,
                "sd_knots": SD_KNOTS * knots,
            }
            | counts(process),
            name=name,
            **dual_frame(inputs, *both, lags, lead),
            period=period,
            domain=training_box(records, (*inputs, *both)),
            description=f"dual Gaussian process, {'/'.join(kernels)}, {lags} lags, {process['points'].shape[1]} points",
            provenance=provenance(
                "dual_gaussian_process", records, seed, rows, [one, two], options | {"kernel": kernels}
            ),
        )
        deviation, certificate = certify(block, one, two, grid, bound)
        errors = {"training": _errors(block, [rows], lead)} | (
            {"validation": _errors(block, held_out, lead)} if held_out else {}
        )
        block = steady_where_it_integrates(block, records, both[1:], curve=True, published=fit == "paper")
        told = {"lead": lead, "errors": errors, "deviation": deviation}
        told["validation"] = free_run_errors(block, validate, both)
        return replace(block, certificate=certificate, provenance={**block.provenance, **told})


def _second(exact_gp, spool: np.ndarray, slopes: np.ndarray, **options) -> DeployedProcess:
    """Process II, compared on even places over the range of the spool."""
    places = np.linspace(spool.min(), spool.max(), PLACES)[:, None]
    return train_process(exact_gp, spool[:, None], slopes, input_scales(spool[:, None], 1), places, **options)


def certify(block: LearnedBlock, one: DeployedProcess, two: DeployedProcess, grid: np.ndarray, bound: float):
    """The largest |deployed - exact|, over the spread of the spool and of the rate.

    Process I over the delay lines in ``grid`` (n, lags nu), process II over its places, and the rate of the cascade
    over ``grid``.
    """
    spool, spool_sd, v, _ = cascade(block, grid)
    exact = one.on_grid[0]
    low, high = block.arrays["spool_range"]
    known = _rate_of(block)(np.linspace(low, high, PLACES), np.zeros(PLACES))
    in_cascade = two.exact_mean(np.clip(exact, low, high)[:, None])
    parts = {
        "spool": apart(spool, spool_sd, one.on_grid, one.scale),
        "slope": apart(*known, two.on_grid, two.scale),
    }
    deviation = {f"{name}_{part}": value for name, found in parts.items() for part, value in found.items()}
    deviation["slope_in_cascade_mean"] = float(np.abs(v - in_cascade).max() / two.scale)
    worst = {p: max(v for k, v in deviation.items() if k.endswith(p)) for p in ("mean", "sd_above", "sd_below")}
    reference = reference_name(worst["sd_above"], worst["sd_below"])
    return deviation, Certificate(worst["mean"], bound, len(grid) + PLACES, reference)


def cascade(block: LearnedBlock, features: np.ndarray) -> tuple[np.ndarray, ...]:
    """Spool, its deviation, rate and its deviation (n,), as the block finds them from delay lines (n, lags nu)."""
    nu, lead = len(block.inputs), block.structure["lead"]
    held = np.zeros((len(features), 4 if lead else 2))
    x = np.hstack([held, features[:, nu:]])
    step = block.step.map(len(features))
    x_next, y = (part.full() for part in step(x.T, features[:, :nu].T, np.zeros((0, len(features)))))
    spool, spool_sd = x_next[2:4] if lead else y[0:2]
    return spool, spool_sd, y[4], y[5]


def _rate_of(block: LearnedBlock):
    """The rate and its deviation for spools and deviations (n,), as the block computes them."""
    s, sd = ca.MX.sym("s"), ca.MX.sym("sd")
    one = ca.Function("rate", [s, sd], list(rate(block.arrays, s, sd)))
    return lambda spools, sds: [part.full().ravel() for part in one.map(len(spools))(spools[None], sds[None])]


def _errors(block: LearnedBlock, parts: Sequence[Rows], lead: int) -> dict[str, float]:
    """RMSE against raw samples, SI: spool, rate on the measured spool, rate in cascade."""
    features, slopes = (np.concatenate([getattr(p, key) for p in parts]) for key in ("features", "slopes"))
    measured = np.concatenate([_spool(p, lead) for p in parts])
    spool, _, in_cascade, _ = cascade(block, features)
    alone = _rate_of(block)(measured, np.zeros(len(measured)))[0]
    misses = {
        "spool": spool - measured,
        "slope_on_measured_spool": alone - slopes[:, 1],
        "slope_in_cascade": in_cascade - slopes[:, 1],
    }
    return {key: float(np.sqrt(np.mean(e**2))) for key, e in misses.items()}


def _spool(rows: Rows, lead: int) -> np.ndarray:
    return (rows.ahead if lead else rows.levels)[:, 0]


def _lead(rows: Rows, fit: str) -> int:
    """The sample of the spool, before or after the interval, whose classes differ more in their mean rate."""
    if fit == "paper":
        return 0
    return int(
        _spread_in_bins(rows.ahead[:, 0], rows.slopes[:, 1]) < _spread_in_bins(rows.levels[:, 0], rows.slopes[:, 1])
    )


def _spread_in_bins(spool: np.ndarray, slopes: np.ndarray) -> float:
    """Variance of the rates about their mean in classes of the spool of equal numbers."""
    parts = np.array_split(slopes[np.argsort(spool, kind="stable")], min(BINS, len(spool) // 10))
    return float(sum(np.sum((p - p.mean()) ** 2) for p in parts))


def _splines(two: DeployedProcess, spool: np.ndarray, knots: int) -> dict[str, np.ndarray]:
    """Process II as splines: its mean over the range of the measured spool, its deviation one range further."""
    from .compression import spline_coefficients

    low, high = spool.min(), spool.max()
    wide = (2 * low - high, 2 * high - low)
    return {
        "rate_mean": spline_coefficients(lambda s: two.fast(s[:, None])[0], low, high, knots),
        "rate_sd": spline_coefficients(lambda s: two.fast(s[:, None])[1], *wide, SD_KNOTS * knots),
        "spool_range": np.array([low, high]),
        "spool_range_of_sd": np.array(wide),
    }


def _kernels(kernel, fit: str) -> tuple[str, ...]:
    if kernel is None:
        return ("rbf", "rbf") if fit == "paper" else ("rbf", "matern32")
    return (kernel, kernel) if isinstance(kernel, str) else tuple(kernel)


def _check(kernels, lead, knots, *shared) -> None:
    if len(kernels) != 2:
        raise DeclarationError(f"{VERB}: kernel is one name or one for each process (got {kernels}). Give two.")
    for one in kernels:
        check_options(VERB, one, *shared)
    if lead not in (None, 0, 1):
        raise DeclarationError(f"{VERB}: lead must be 0, 1 or None (got {lead}). Leave it out to choose by the data.")
    if isinstance(knots, bool) or not isinstance(knots, (int, np.integer)) or knots < 8:
        raise DeclarationError(f"{VERB}: knots must be a whole number from 8 up (got {knots}). 60 are usual.")


def _recordings(records, inputs, outputs, through, validate):
    """Inputs, (spool, output) and the checked recordings."""
    if not isinstance(outputs, (list, tuple)) or len(outputs) != 1:
        raise DataError(f"{VERB}: one output that integrates is needed (got {outputs!r}). Train one block for each.")
    return recordings(records, inputs, [through, *outputs], validate, VERB)
