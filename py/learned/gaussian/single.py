"""Learn a Gaussian process from delayed inputs; GPyTorch is needed to train, never to run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

from ..block_file import Certificate, LearnedBlock, assemble
from ..integrating import integration, one_form, told_forms
from ..interruption import CtrlC
from ..needs import needed_to_train
from ..steady import Steady, steady_block
from ..training_data import as_signals, check_excitation, training_box, usable
from .delay_lines import certification_grid, delayed_rows, even_period, input_scales, training_rows
from .kernel_block import GAUSSIAN_PROCESS, KERNELS, process_frame
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


def learn_gaussian_process(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    rate: bool | None = None,
    kernel: str = "rbf",
    lags: int = 5,
    fit: str = "default",
    points: int | None = 1000,
    samples: int = 6000,
    compress: int | str | None = "auto",
    bound: float = 0.02,
    period: float | None = None,
    validate: Sequence[Record] = (),
    seed: int = 0,
    name: str = "gaussian_process",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Train one Gaussian process per output on delayed inputs, a length scale for each lag; answer them as a Block.

    Beside each output stands its standard deviation ``<output>.sd``; see `kernel_block` for what it means. Recordings
    sampled near ``period`` are taken sample by sample, evenly spaced or not; faster ones are resampled.

    Args:
        records: training recordings, without gaps.
        inputs, outputs: Signals, or names that take the unit of the recording.
        rate: learn the slope between samples, (y[k+1] - y[k]) / (t[k+1] - t[k]), and integrate it in the block; adds
            the outputs ``<output>.slope`` and ``<output>.slope.sd``. None: where the outputs integrate, as the
            recordings tell (`integration`).
        kernel: "rbf" or "matern32". lags: samples of every input, the newest included.
        fit: "default", L-BFGS on the marginal likelihood; "paper", 100 Adam steps of 1e-2 from GPyTorch's defaults.
        points: random rows that the hyper-parameters are fitted on; None: all, as the paper did (minutes each step).
        samples: most rows to condition on; more are thinned at random.
        compress: inducing points; "auto": the fewest from 100 up that keep ``bound``, every row where 800 do not;
            None: every row, the exact mean. The deviation has 200 at most, for it needs their square in constants.
        bound: of the deployed mean against the exact one, over the output's spread; certified. The certificate also
            states how far the deviation is off.
        period: s between steps; None: see `even_period`.
        validate: recordings for the certificate and for ``provenance["validation"]``; nothing is selected on them.
        progress: called with a `GaussianProcessProgress` after every evaluation of the likelihood.

    The same seed and data give the same block. Ctrl-C ends the fits with the best hyper-parameters so far (of
    outputs whose turn had not come, with those that 100 rows give), a second one ends everything.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options, a block
        of more than 5 MB of C, or GPyTorch is not installed. SolveError: the likelihood was never finite.
    """
    with needed_to_train("learn_gaussian_process"):
        from . import exact as exact_gp
    check_options("learn_gaussian_process", kernel, lags, fit, points, samples, compress, bound, period)
    inputs, outputs, records, validate = recordings(records, inputs, outputs, validate, "learn_gaussian_process")
    period = float(period or even_period(records))
    forms = integration(records, inputs, outputs, period=period, lags=range(lags))
    rate = one_form("learn_gaussian_process", "rate", rate, forms)
    rng = np.random.default_rng(seed)
    rows = training_rows(records, period, inputs, outputs, lags, samples, rng)
    check_size("learn_gaussian_process", len(rows), rows.features.shape[1], len(outputs), compress)
    targets = rows.slopes if rate else rows.levels
    scales = input_scales(rows.features, len(inputs))
    held_out = [delayed_rows(r, period, inputs, outputs, lags) for r in validate]
    grid = certification_grid([rows, *held_out], len(inputs), lags, rng)
    options = {"kernel": kernel, "fit": fit, "points": points, "compress": compress}
    with CtrlC() as ctrl_c:
        shared = {**options, "bound": bound, "rng": rng, "progress": progress, "ctrl_c": ctrl_c}
        trained = [
            train_process(exact_gp, rows.features, targets[:, j], scales, grid, label=s.name, **shared)
            for j, s in enumerate(outputs)
        ]
        processes = stacked([p.arrays for p in trained])
        block = assemble(
            GAUSSIAN_PROCESS,
            scales | processes | ({"period": np.array(period)} if rate else {}),
            {"kernel": KERNELS.index(kernel), "lags": lags, "rate": int(rate)} | counts(processes),
            name=name,
            **process_frame(inputs, outputs, lags, rate),
            period=period,
            domain=training_box(records, (*inputs, *outputs)),
            description=f"Gaussian process, {kernel}, {lags} lags, {processes['points'].shape[1]} points",
            provenance=provenance("gaussian_process", records, seed, rows, trained, options),
        )
        deviation, certificate = certify(block, trained, grid, bound)
        block = steady_block(block, records, Steady(outputs if rate and fit != "paper" else (), curve=True))
        told = {"rate": rate, "integration": told_forms(forms), "deviation": deviation}
        told["validation"] = free_run_errors(block, validate, outputs)
        return replace(block, certificate=certificate, provenance={**block.provenance, **told})


def certify(block: LearnedBlock, trained: Sequence[DeployedProcess], grid: np.ndarray, bound: float):
    """The largest |deployed - exact| of mean and deviation over ``grid`` (n, lags nu), over each output's spread."""
    nu, each = len(block.inputs), len(block.outputs) // len(trained)
    held = len(block.states) - (grid.shape[1] - nu)
    x = np.hstack([np.zeros((len(grid), held)), grid[:, nu:]])
    seen = block.step.map(len(grid))(x.T, grid[:, :nu].T, np.zeros((0, len(grid))))[1].full().T
    deviation = {"mean": 0.0, "sd_above": 0.0, "sd_below": 0.0}
    for j, process in enumerate(trained):
        mean, sd = seen[:, each * (j + 1) - 2], seen[:, each * (j + 1) - 1]
        found = apart(mean, sd, process.on_grid, process.scale)
        deviation = {part: max(value, found[part]) for part, value in deviation.items()}
    reference = reference_name(deviation["sd_above"], deviation["sd_below"])
    return deviation, Certificate(deviation["mean"], bound, len(grid), reference)


def free_run_errors(block, records, outputs) -> dict[str, float]:
    """RMS of free runs over ``records``, per output, SI."""
    runs = [(simulate(block, r), r) for r in records]
    misses = {s.name: [run[s.name] - r[s.name] for run, r in runs] for s in outputs if runs}
    return {name: float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for name, e in misses.items()}


def recordings(records, inputs, outputs, validate, verb: str):
    """Signals by name and checked recordings, as every trainer takes them."""
    records, validate = list(records), list(validate)
    if not records:
        raise DataError(f"{verb}: no recordings (got an empty list). Give at least one Record.")
    inputs, outputs = as_signals(inputs, records[0], "inputs"), as_signals(outputs, records[0], "outputs")
    names = [s.name for s in (*inputs, *outputs)]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise DataError(f"{verb}: {twice} named twice. A signal is one input or one output.")
    records, validate = (usable(part, (*inputs, *outputs)) if part else [] for part in (records, validate))
    check_excitation(records, (*inputs, *outputs))
    return inputs, outputs, records, validate
