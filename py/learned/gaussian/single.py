"""Learn a Gaussian process from delayed inputs; GPyTorch is needed to train, never to run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.stops import Diverged

from .. import held_out
from ..bands import calibrated, with_arrays
from ..block_file import Certificate, LearnedBlock, assemble
from ..integrating import integration, one_form, told_forms
from ..interruption import CtrlC
from ..needs import needed_to_train
from ..steady import Steady, steady_block
from ..training_data import as_signals, check_excitation, training_box, usable
from .delay_lines import FEWEST, Rows, certification_grid, delayed_rows, even_period, input_scales, training_rows
from .integrated_band import run_noise
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

PART_ROWS = 3000  # that the process is conditioned on whose band is judged on the rest


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

    Beside each output stands ``<output>.sd``, the standard deviation of its measured value (`kernel_block`), scaled to
    what the end of every recording shows of a process that did not see it (``provenance["band"]``). Recordings
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
        validate: recordings for ``provenance["validation"]``; nothing is chosen on them.
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
    rng = np.random.default_rng(seed)
    rows = training_rows(records, period, inputs, outputs, lags, samples, rng)
    check_size("learn_gaussian_process", len(rows), rows.features.shape[1], len(outputs), compress)
    forms = integration(records, inputs, outputs, period=period, lags=range(lags))
    rate = one_form("learn_gaussian_process", "rate", rate, forms)
    targets = rows.slopes if rate else rows.levels
    scales = input_scales(rows.features, len(inputs))
    grid = certification_grid([rows], len(inputs), lags, rng)
    options = {"kernel": kernel, "fit": fit, "points": points, "compress": compress}
    with CtrlC() as ctrl_c:
        shared = {**options, "bound": bound, "rng": rng, "progress": progress, "ctrl_c": ctrl_c}
        trained = [
            train_process(exact_gp, rows.features, targets[:, j], scales, grid, label=s.name, **shared)
            for j, s in enumerate(outputs)
        ]
        form = Form(inputs, outputs, lags, period, rate)
        block = _block(form, trained, records, name=name, provenance=provenance(
            "gaussian_process", records, seed, rows, trained, options))  # fmt: skip
        deviation, certificate = certify(block, trained, grid, bound)
        block = steady_block(block, records, Steady(outputs if rate and fit != "paper" else (), curve=True))
        block = calibrated(with_run_noise(block, records, outputs), _judged(form, trained, records, rate))
        told = {"rate": rate, "integration": told_forms(forms), "deviation": deviation}
        told["validation"] = free_run_errors(block, validate, outputs)
        return replace(block, certificate=certificate, provenance={**block.provenance, **told})


@dataclass(frozen=True)
class Form:
    """Signals, delay line, period [s], and whether the outputs integrate."""

    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    lags: int
    period: float
    rate: bool

    def rows(self, records: Sequence[Record]) -> list[Rows]:
        """The rows of every recording."""
        return [delayed_rows(r, self.period, self.inputs, self.outputs, self.lags) for r in records]


def _block(form: Form, trained: Sequence[DeployedProcess], records: Sequence[Record], **told) -> LearnedBlock:
    """The block of processes, one for each output."""
    kernel, ones, parts = trained[0].trained.posterior.kernel, np.ones(len(trained)), []
    rows = form.rows(records) if form.rate else []
    for process in trained:
        extra = {"directions": process.directions(rows), "inside": process.largest_variance()} if form.rate else {}
        parts.append(dict(process.arrays) | extra)
    arrays = stacked(parts) | {"run_scale": ones}
    structure = {"kernel": KERNELS.index(kernel), "lags": form.lags, "rate": int(form.rate)} | counts(arrays)
    structure["directions"] = arrays["directions"].shape[2] if form.rate else 0
    if form.rate:
        arrays |= {"period": np.array(form.period), "step_scale": ones, "run_noise": 0 * ones}
    return assemble(
        GAUSSIAN_PROCESS,
        dict(trained[0].scales) | arrays,
        structure,
        **process_frame(form.inputs, form.outputs, form.lags, form.rate, structure["directions"]),
        period=form.period,
        domain=training_box(records, (*form.inputs, *form.outputs)),
        description=f"Gaussian process, {kernel}, {form.lags} lags, {structure['points']} points",
        **told,
    )


def with_run_noise(block: LearnedBlock, records: Sequence[Record], outputs: Sequence[Signal]) -> LearnedBlock:
    """The block whose band holds what its free runs over the training recordings leave of ``outputs``."""
    if "run_noise" not in block.arrays:
        return block
    try:
        runs = [simulate(block, r) for r in records]
    except Diverged:
        return block
    noise = [run_noise([run[s.name] for run in runs], [r[s.name] for r in records]) for s in outputs]
    return with_arrays(block, {"run_noise": np.array(noise)})


def _judged(form: Form, trained: Sequence[DeployedProcess], records: Sequence[Record], rate: bool) -> list:
    """The block as it is without what is held out, and that, to judge its band on."""
    split = held_out.split(records, *([s.name for s in part] for part in (form.inputs, form.outputs)))
    rows = thinned_rows(form, split)
    if rows is None:
        return []
    targets = rows.slopes if rate else rows.levels
    seen = [p.on_part(rows.features, targets[:, j]) for j, p in enumerate(trained)]
    block = _block(form, seen, split.fit, name="part", provenance={})
    return [(with_run_noise(block, split.fit, form.outputs), split.parts)]


def thinned_rows(form: Form, split: held_out.Split) -> Rows | None:
    """At most `PART_ROWS` of the rows that are not held out; None where nothing is, or they are too few."""
    parts = form.rows(split.fit) if split.parts else []
    rows = Rows.joined(parts) if parts else None
    if rows is None or len(rows) < FEWEST:
        return None
    return rows.taken(slice(None, None, -(-len(rows) // PART_ROWS)))


def certify(block: LearnedBlock, trained: Sequence[DeployedProcess], grid: np.ndarray, bound: float):
    """The largest |deployed - exact| of mean and deviation over ``grid`` (n, lags nu), over each output's spread."""
    nu, each = len(block.inputs), len(block.outputs) // len(trained)
    held = len(block.states) - (grid.shape[1] - nu)
    x = np.hstack([np.zeros((len(grid), held)), grid[:, nu:]])
    seen = block.step.map(len(grid))(x.T, grid[:, :nu].T, np.zeros((0, len(grid))))[1].full().T
    deviation = {"mean": 0.0, "sd_above": 0.0, "sd_below": 0.0}
    for j, process in enumerate(trained):
        mean, sd = seen[:, each * (j + 1) - 2], seen[:, each * (j + 1) - 1]
        sd = np.sqrt(np.maximum(sd**2 - block.arrays["noise"][j] ** 2, 0.0))
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
