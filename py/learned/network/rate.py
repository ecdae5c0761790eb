"""Learn the published network of delayed inputs to a rate; PyTorch is needed to train, never to run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..block_file import Certificate, LearnedBlock, assemble
from ..gaussian.delay_lines import certification_grid, even_period, input_scales, normalised, training_rows
from ..needs import needed_to_train
from ..options import check_counts
from ..steady import steady_where_it_integrates
from ..training_data import checked_recordings, named, training_box
from .rate_block import RATE_NETWORK, rate_frame

TOLERANCE = 1e-12  # of the spread of the rates: deployed against trained
SCALES = ("input_centre", "input_scale")


def learn_rate_network(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    lags: int = 5,
    hidden: int = 16,
    iterations: int = 100,
    starts: int = 10,
    samples: int = 6000,
    period: float | None = None,
    validate: Sequence[Record] = (),
    seed: int = 0,
    name: str = "rate_network",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Train the feed-forward network of the dual-GP paper on raw rates and answer it as a Block.

    It is the baseline, not the advice: it sees no output and is judged one step ahead (`train_network` is judged by its
    free run). 100 Adam steps are the paper's budget as far as can be told; 1000 are near convergence.

    Args:
        records: training recordings, evenly sampled or not, without gaps.
        inputs, outputs: Signals, or names that take the unit of the recording; one output, which integrates.
        lags: samples of every input, the newest included. hidden: units of each of the two layers.
        iterations: Adam steps of 1e-2 on all samples. starts: trained side by side, the smallest training loss is kept.
        samples: most rows to learn from; more are thinned at random.
        period: s between steps; None: see `even_period`. validate: checked, but nothing is selected on them.
        progress: called with ``(iteration, loss)``.

    The same seed and data give the same block. Ctrl-C ends the training with the best so far.
    ``provenance["losses"]`` holds the training loss of every start.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options, or
        PyTorch is not installed.
    """
    with needed_to_train("learn_rate_network"):
        from . import adam
    counts = {"lags": lags, "hidden": hidden, "iterations": iterations, "starts": starts, "samples": samples}
    check_counts("learn_rate_network", {option: (value, 1) for option, value in counts.items()})
    inputs, outputs, records, _ = checked_recordings("learn_rate_network", records, inputs, outputs, validate)
    if len(outputs) != 1:
        raise DataError(f"learn_rate_network: one output is needed (got {len(outputs)}). Learn a block for each.")
    period, rng = float(period or even_period(records)), np.random.default_rng(seed)
    rows = training_rows(records, period, inputs, outputs, lags, samples, rng)
    slopes = rows.slopes[:, 0]
    scales = {key: value for key, value in input_scales(rows.features, len(inputs)).items() if key in SCALES}
    centre, scale = float(slopes.mean()), float(slopes.std())
    X, y = normalised(rows.features, scales), (slopes - centre) / scale
    trained = adam.train(X, y, hidden=hidden, starts=starts, iterations=iterations, seed=seed, progress=progress)
    rest = {"rate_centre": np.array([centre]), "rate_scale": np.array([scale]), "period": np.array([period])}
    block = assemble(
        RATE_NETWORK,
        trained.arrays | scales | rest,
        {"lags": lags, "hidden": hidden},
        name=name,
        **rate_frame(inputs, outputs[0], lags),
        period=period,
        domain=training_box(records, (*inputs, *outputs)),
        description=f"network {X.shape[1]}-{hidden}-{hidden}-1 of delayed inputs, {_count(trained.arrays)} weights",
        provenance={
            "kind": "rate_network",
            "fit": "paper",
            "trained_on": named(records),
            "seed": seed,
            "rows": len(rows),
            "losses": list(trained.losses),
            "iterations": trained.iterations,
            "stopped": trained.stopped,
            "versions": {package: metadata.version(package) for package in ("torch", "numpy", "casadi")},
        },
    )
    block = replace(block, certificate=certify(block, adam, certification_grid([rows], len(inputs), lags, rng)))
    return steady_where_it_integrates(block, records, outputs, published=True)


def certify(block: LearnedBlock, adam, grid: np.ndarray) -> Certificate:
    """The largest |deployed - trained| of the rate over delay lines ``grid`` (n, lags nu), over the rates' spread."""
    nu, a = len(block.inputs), block.arrays
    x = np.hstack([np.zeros((len(grid), 1)), grid[:, nu:]])
    found = block.step.map(len(grid))(x.T, grid[:, :nu].T, np.zeros((0, len(grid))))[1].full()[1]
    layers = {key: value for key, value in a.items() if key.endswith(("_weights", "_bias"))}
    expected = adam.predicted(layers, normalised(grid, {key: a[key] for key in SCALES}))
    difference = float(np.abs((found - a["rate_centre"]) / a["rate_scale"] - expected).max())
    return Certificate(difference, TOLERANCE, len(grid), f"torch {metadata.version('torch')} float64")


def _count(arrays: dict[str, np.ndarray]) -> int:
    return sum(a.size for a in arrays.values())
