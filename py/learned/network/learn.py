"""Learn a small network from recordings, judged by how well it runs free; PyTorch is needed to train, never to run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import metadata

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, noise_floor

from ..block_file import Certificate, LearnedBlock, assemble
from ..needs import needed_to_train
from ..steady import steady_where_it_integrates
from ..training_data import (
    HELD_OUT,
    LIMIT_OVER_SEEN,
    checked_recordings,
    choose_input_lags,
    choose_period,
    free_run_bounds,
    increment_spread,
    named,
    on_period,
    split_tail,
    training_box,
)
from .narx import NETWORK, NarxShape, network_states, random_steps

TOLERANCE = 1e-12  # of the outputs' scale: deployed against trained
DECAY_OF_NOISE = 0.03  # weight decay over the noise variance; found by trial on the two machines
LEAST_DECAY = 1e-9
MARGIN = 0.3  # of the range seen in training: how far the hidden layer extrapolates


@dataclass(frozen=True)
class _Normalised:
    """Recordings at the network's period, over the scales that are written into the block."""

    arrays: dict[str, np.ndarray]
    fit: list[tuple[np.ndarray, np.ndarray]]
    held_out: list[tuple[np.ndarray, np.ndarray, bool]]


def train_network(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    period: float | None = None,
    validate: Sequence[Record] = (),
    lags: tuple[int, int | None] = (2, None),
    hidden: int = 10,
    seed: int = 0,
    starts: int = 3,
    effort: float = 1.0,
    budget: float = 120.0,
    name: str = "network",
    commands: Sequence[str] | None = None,
    progress: Callable | None = None,
) -> LearnedBlock:
    """Train a NARX network on several recordings and answer it as a Block.

    The increments of the outputs are a linear part plus one hidden layer of the last outputs, increments and inputs
    (see `narx`). Training goes from one-step prediction to free runs over whole recordings (see `free_run_training`);
    the network kept is the one with the smallest free-run error on ``validate``, or on the last fifth of every
    recording when there is none. Recordings used here for selection are no longer a fair test of the result.

    Args:
        records: training recordings, uniform or not, without gaps.
        inputs, outputs: Signals, or names that take the unit of the recording.
        period: s between steps; None: the longest that loses nothing worth having (`choose_period`).
        lags: past increments of the outputs, samples of the inputs (None: chosen from the data, `choose_input_lags`).
        hidden: tanh units; 0 gives the best linear ARX model in free run.
        seed, starts: seeds ``seed ... seed + starts - 1`` are tried on short stretches, the best is trained on.
        effort: scales the number of iterations. budget: s, after which the best so far is taken.
        commands: inputs whose standing still lets the machine rest (see `steady`); None: all of them.
        progress: called with a `TrainingProgress` after every iteration.

    The same seed and data give the same network unless the budget ends the training (``provenance["stopped"]``).
    Ctrl-C ends the training with the best network so far.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options, or
        PyTorch is not installed. SolveError: no iteration lowered the error.
    """
    with needed_to_train("train_network"):
        from . import free_run as training
    _check_options(lags, hidden, starts, effort, budget, period)
    inputs, outputs, records, validate = checked_recordings("train_network", records, inputs, outputs, validate)
    period = float(period or choose_period(records))
    data = _normalise(records, validate, inputs, outputs, period)
    shape = _shape(data, lags, hidden)
    _check_size(data, shape)
    arrays = data.arrays | _feature_range(data, shape)
    final = _stages(training, effort, (256, 16, 4, 1), (1300, 8, 8, 1), (None, 12, 8, 1))
    longest = max(len(u) for u, _ in data.fit)
    trained = training.train(
        data.fit,
        data.held_out,
        shape,
        training.Scales.of(arrays),
        seeds=[seed + k for k in range(starts if hidden else 1)],
        trial=_stages(training, effort, (4, 16, 1, 5), (32, 16, 2, 5)),
        final=[s for s in final if s.horizon is None or s.horizon < longest],
        decay=_decay(records, outputs, data.arrays),
        budget=budget,
        progress=progress,
    )
    block = assemble(
        NETWORK,
        arrays | _weights(trained.weights, shape),
        shape.structure(),
        name=name,
        inputs=inputs,
        outputs=outputs,
        states=network_states(shape, inputs, outputs),
        parameters=(),
        period=period,
        domain=training_box(records, (*inputs, *outputs)),
        description=_describe(shape),
        provenance=_provenance(records, validate, trained),
    )
    block = replace(block, certificate=certify(block, training, trained.weights, shape))
    return steady_where_it_integrates(block, records, outputs, commands=commands, curve=True)


def certify(block: LearnedBlock, training, weights: np.ndarray, shape: NarxShape, points=20_000) -> Certificate:
    """The largest |deployed - trained| of one step over `random_steps`, relative to the outputs' scale."""
    a, ny = block.arrays, shape.outputs
    states, inputs, features = random_steps(a, shape, points)
    y_next, moved = training.next_step(weights, shape, training.Scales.of(a), features)
    deployed = np.array(block.step.map(points)(states.T, inputs.T, np.zeros((0, points)))[0]).T
    errors = [(deployed[:, :ny] - a["output_centre"]) / a["output_scale"] - y_next]
    if shape.output_lags:
        errors.append(deployed[:, ny : 2 * ny] / a["output_scale"] - moved)
    difference = max(float(np.abs(e).max()) for e in errors)
    return Certificate(difference, TOLERANCE, points, f"torch {metadata.version('torch')} float64")


def _check_options(lags, hidden, starts, effort, budget, period) -> None:
    n, m = lags
    counts = {"lags[0]": (n, 0), "lags[1]": (1 if m is None else m, 1), "hidden": (hidden, 0), "starts": (starts, 1)}
    for option, (value, least) in counts.items():
        if int(value) != value or value < least:
            raise DeclarationError(f"train_network: {option} must be a whole number from {least} up (got {value}).")
    for option, value in {"effort": effort, "budget": budget, "period": 1.0 if period is None else period}.items():
        if not value > 0:
            raise DeclarationError(f"train_network: {option} must be positive (got {value}).")


def _normalise(records, validate, inputs, outputs, period) -> _Normalised:
    even = [on_period(r, period, inputs) for r in records]
    short = min(even, key=len)
    if len(short) < 50:
        raise DataError(
            f"{short.source or short.name}: too few samples to train on (got {len(short)} at {period:g} s). "
            "At least 50 are needed. Leave the recording out or choose a shorter period."
        )
    judged = [(on_period(r, period, inputs), True) for r in validate]
    if not judged:
        whole = even
        even, tails = zip(*(split_tail(r, HELD_OUT) for r in whole), strict=True)
        judged = [(tail, False) for tail in tails] + [(r, True) for r in whole]
    u, y = (np.concatenate([r.array([s.name for s in part]) for r in even]) for part in (inputs, outputs))
    arrays = _scales(u, y, [r.array([s.name for s in outputs]) for r in even])

    def normal(record):
        parts = {"input": record.array([s.name for s in inputs]), "output": record.array([s.name for s in outputs])}
        return tuple((v - arrays[f"{part}_centre"]) / arrays[f"{part}_scale"] for part, v in parts.items())

    return _Normalised(arrays, [normal(r) for r in even], [(*normal(r), rest) for r, rest in judged])


def _scales(u: np.ndarray, y: np.ndarray, runs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Centres, spreads and the bounds of a free run, from the training samples; SI."""
    return {
        "input_centre": u.mean(axis=0),
        "input_scale": np.where(u.std(axis=0) > 0, u.std(axis=0), 1.0),
        "output_centre": y.mean(axis=0),
        "output_scale": np.where(y.std(axis=0) > 0, y.std(axis=0), 1.0),
        **free_run_bounds(runs, increment_spread(runs)),
    }


def _decay(records, outputs, arrays) -> float:
    """Weight decay: a share of the noise variance of the cleanest output, so that noise is not learnt."""
    names = [s.name for s in outputs]
    floors = [noise_floor(r.select(names)) for r in records]
    noise = np.array([[f[name].sigma for name in names] for f in floors]) / arrays["output_scale"]
    return max(DECAY_OF_NOISE * float(np.square(noise).mean(axis=0).min()), LEAST_DECAY)


def _shape(data: _Normalised, lags, hidden: int) -> NarxShape:
    u, y = zip(*data.fit, strict=True)
    input_lags = lags[1] or choose_input_lags(u, y, lags[0])
    return NarxShape(u[0].shape[1], y[0].shape[1], int(lags[0]), int(input_lags), int(hidden))


def _feature_range(data: _Normalised, shape: NarxShape) -> dict[str, np.ndarray]:
    """The range of every feature over the training samples, widened; normalised."""
    u, y = (np.concatenate(part) for part in zip(*data.fit, strict=True))
    moved = np.tile(data.arrays["increment_limit"], shape.output_lags) / LIMIT_OVER_SEEN
    sides = {}
    for side, extreme, sign in (("lower", np.min, -1), ("upper", np.max, 1)):
        outputs = extreme(y, axis=0) + sign * MARGIN * np.ptp(y, axis=0)
        inputs = np.tile(extreme(u, axis=0) + sign * MARGIN * np.ptp(u, axis=0), shape.input_lags)
        sides[f"feature_{side}"] = np.concatenate([outputs, sign * (1 + 2 * MARGIN) * moved, inputs])
    return sides


def _check_size(data: _Normalised, shape: NarxShape) -> None:
    samples = sum(len(u) for u, _ in data.fit)
    needed = max(200, 2 * shape.size // shape.outputs)
    if samples < needed:
        raise DataError(
            f"train_network: too few samples for {shape.size} weights (got {samples}). At least {needed} are needed. "
            "Record longer, choose a shorter period or fewer hidden units."
        )
    longest = max(shape.output_lags, shape.input_lags) + 2
    if min(len(u) for u, *_ in (*data.fit, *data.held_out)) <= longest:
        raise DataError(f"train_network: a recording is shorter than the lags (needs over {longest} samples).")


def _stages(training, effort: float, *stages):
    return [training.Stage(horizon, max(1, round(effort * n)), *pace) for horizon, n, *pace in stages]


def _weights(flat: np.ndarray, shape: NarxShape) -> dict[str, np.ndarray]:
    parts = np.split(flat, np.cumsum([int(np.prod(s)) for s in shape.weights.values()])[:-1])
    return {name: part.reshape(s) for (name, s), part in zip(shape.weights.items(), parts, strict=True)}


def _describe(shape: NarxShape) -> str:
    layer = f"{shape.hidden} tanh units and a linear part" if shape.hidden else "linear"
    return f"NARX, {layer}, {shape.output_lags} past increments, {shape.input_lags} input samples, {shape.size} weights"


def _provenance(records, validate, trained) -> dict:
    return {
        "kind": "network",
        "trained_on": named(records),
        "selected_on": named(validate) or f"last {HELD_OUT:.0%} of every training recording",
        "seed": trained.seed,
        "held_out_error": trained.held_out_error,
        "iterations": trained.iterations,
        "seconds": round(trained.seconds, 2),
        "stopped": trained.stopped or "finished",
        "versions": {package: metadata.version(package) for package in ("torch", "numpy", "casadi")},
    }
