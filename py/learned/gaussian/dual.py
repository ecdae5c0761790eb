"""Learn the dual Gaussian process of a valve and its actuator; GPyTorch is needed to train, never to run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .. import held_out
from ..bands import calibrated, with_arrays
from ..block_file import Certificate, LearnedBlock, assemble
from ..interruption import CtrlC
from ..needs import needed_to_train
from ..options import check_counts
from ..steady import steady_where_it_integrates
from ..training_data import training_box
from .delay_lines import Rows, certification_grid, delayed_rows, even_period, input_scales, normalised, training_rows
from .dual_block import DUAL_GAUSSIAN_PROCESS, dual_frame, rate, spline
from .kernel_block import KERNELS
from .single import Form, free_run_errors, recordings, thinned_rows, with_run_noise
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
    judged = [delayed_rows(r, period, inputs, both, lags) for r in validate]
    grid = certification_grid([rows], len(inputs), lags, rng)
    options = {"fit": fit, "points": points, "compress": compress}
    with CtrlC() as ctrl_c:
        shared = {**options, "bound": SHARE_OF_ONE * bound, "rng": rng, "progress": progress, "ctrl_c": ctrl_c}
        scales = input_scales(rows.features, len(inputs))
        spool, slopes = _spool(rows, lead), rows.slopes[:, 1]
        one = train_process(
            exact_gp, rows.features, spool, scales, grid, kernel=kernels[0], label=both[0].name, **shared
        )
        two = _second(exact_gp, spool, slopes, kernel=kernels[1], label=f"{both[1].name}.slope", **shared)
        form = Form(inputs, both, lags, period, True)
        told = provenance("dual_gaussian_process", records, seed, rows, [one, two], options | {"kernel": kernels})
        counted = {"lead": lead, "knots": knots}
        block = _block(form, one, two, counted, records, name=name, provenance=told)
        deviation, certificate = certify(block, one, two, grid, bound)
        errors = {"training": _errors(block, [rows], lead)} | (
            {"validation": _errors(block, judged, lead)} if judged else {}
        )
        block = steady_where_it_integrates(block, records, both[1:], curve=True, published=fit == "paper")
        block = calibrated(with_run_noise(block, records, both[1:]), _judged(form, one, two, counted, records))
        told = {"lead": lead, "errors": errors, "deviation": deviation}
        told["validation"] = free_run_errors(block, validate, both)
        return replace(block, certificate=certificate, provenance={**block.provenance, **told})


def _block(form: Form, one: DeployedProcess, two: DeployedProcess, counted: dict, records, **told) -> LearnedBlock:
    """The block of both processes; ``counted``: lead and knots."""
    knots, lead = counted["knots"], counted["lead"]
    rows = form.rows(records)
    splines = _splines(two, two.raw(), knots)
    slope = [_slopes_at(splines, one.fast(part.features)[0]) for part in rows]
    process = stacked([dict(one.arrays) | {"directions": one.directions(rows, slope), "inside": 0.0}])
    structure = {"kernel": KERNELS.index(one.trained.posterior.kernel), "lags": form.lags, **counted}
    structure |= {"sd_knots": SD_KNOTS * knots, "directions": process["directions"].shape[2]} | counts(process)
    measured = [replace(part, features=_spool(part, lead)[:, None]) for part in rows]
    splines |= _direction_splines(two, measured, splines["spool_range"], knots)
    structure["rate_directions"] = len(splines["rate_directions"])
    arrays = dict(one.scales) | process | splines | {"period": np.array(form.period), "rate_noise": two.arrays["noise"]}
    arrays |= {"run_noise": np.zeros(1), "run_scale": np.ones(2), "step_scale": np.ones(2)}
    kernels = "/".join(p.trained.posterior.kernel for p in (one, two))
    directions = structure["directions"] + structure["rate_directions"]
    block = assemble(
        DUAL_GAUSSIAN_PROCESS,
        arrays,
        structure,
        **dual_frame(form.inputs, *form.outputs, form.lags, lead, directions),
        period=form.period,
        domain=training_box(records, (*form.inputs, *form.outputs)),
        description=f"dual Gaussian process, {kernels}, {form.lags} lags, {structure['points']} points",
        **told,
    )
    most = max((float(cascade(block, part.features)[3].max()) for part in rows if len(part)), default=0.0)
    inside = max(most**2 - float(two.arrays["noise"]) ** 2, 0.0)
    return with_arrays(block, {"inside": np.array([inside])})


def _judged(form: Form, one: DeployedProcess, two: DeployedProcess, counted: dict, records) -> list:
    """The block as it is without what is held out, and that, to judge its band on."""
    split = held_out.split(records, *([s.name for s in part] for part in (form.inputs, form.outputs)))
    rows = thinned_rows(form, split)
    if rows is None:
        return []
    spool = _spool(rows, counted["lead"])
    seen = one.on_part(rows.features, spool), two.on_part(spool[:, None], rows.slopes[:, 1])
    block = _block(form, *seen, counted, split.fit, name="part", provenance={})
    return [(with_run_noise(block, split.fit, form.outputs[1:]), split.parts)]


def _slopes_at(splines: dict[str, np.ndarray], spools: np.ndarray) -> np.ndarray:
    """Slope of the rate by the spool at spools (n,)."""
    s = ca.MX.sym("s")
    one = ca.Function("slope", [s], [spline(splines["rate_mean"], splines["spool_range"], s)[1]])
    return one.map(len(spools))(spools[None]).full().ravel()


def _direction_splines(two: DeployedProcess, parts, bounds: np.ndarray, knots: int) -> dict[str, np.ndarray]:
    """The directions of process II as splines over the range of the spool."""
    from .compression import correlation, spline_coefficients

    D, posterior = two.directions(parts), two.trained.posterior

    def at(spools):
        places = normalised(spools[:, None], two.scales) / posterior.lengths
        return D.T @ correlation(two.small.sd_points, places, posterior.kernel)

    found = [spline_coefficients(lambda s, r=r: at(s)[r], *bounds, knots) for r in range(D.shape[1])]
    return {"rate_directions": np.stack(found)}


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
    """Spool, its latent deviation, rate and its deviation (n,), as the block finds them from lines (n, lags nu)."""
    nu, lead, lags = len(block.inputs), block.structure["lead"], block.structure["lags"]
    at = len(block.states) - nu * (lags - 1)
    x = np.hstack([np.zeros((len(features), at)), features[:, nu:]])
    step = block.step.map(len(features))
    x_next, y = (part.full() for part in step(x.T, features[:, :nu].T, np.zeros((0, len(features)))))
    if lead:
        return x_next[at - 2], x_next[at - 1], y[4], y[5]
    latent = np.sqrt(np.maximum((y[1] / block.arrays["run_scale"][0]) ** 2 - block.arrays["noise"][0] ** 2, 0.0))
    return y[0], latent, y[4], y[5]


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
    check_counts(VERB, {"knots": (knots, 8)}, " 60 are usual.")


def _recordings(records, inputs, outputs, through, validate):
    """Inputs, (spool, output) and the checked recordings."""
    if not isinstance(outputs, (list, tuple)) or len(outputs) != 1:
        raise DataError(f"{VERB}: one output that integrates is needed (got {outputs!r}). Train one block for each.")
    return recordings(records, inputs, [through, *outputs], validate, VERB)
