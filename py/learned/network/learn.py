"""Learn a small network from recordings, chosen and trained by how well it runs free; NumPy and CasADi alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..block_file import Certificate, LearnedBlock, assemble
from ..options import check_counts, check_positive
from ..steady import steady_where_it_integrates
from ..substeps import with_steps
from ..training_data import checked_recordings, named, training_box
from .form import Form
from .free_run import Scales, next_step, weight_arrays
from .narx import NETWORK, NarxShape, network_states, random_steps
from .search import Asked, Search
from .series import PARTS
from .training import Meter

TOLERANCE = 1e-12  # of the outputs' scale: deployed against trained
LEAST = 60  # samples of all recordings at the period


def train_network(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    period: float | None = None,
    validate: Sequence[Record] = (),
    select: Sequence[Record] = (),
    lags: tuple[int | None, int | None] = (None, None),
    delay: int | None = None,
    substeps: int | None = None,
    integrates: bool | None = None,
    hidden: int | None = None,
    seed: int = 0,
    starts: int = 3,
    effort: float = 1.0,
    budget: float | None = None,
    name: str = "network",
    commands: Sequence[str] | None = None,
    progress: Callable | None = None,
) -> LearnedBlock:
    """Train a NARX network on several recordings and answer it as a Block.

    The increments of the outputs are a linear part plus one hidden layer of the last outputs, increments and inputs
    (see `narx`). What is not given is chosen by free runs on parts of the recordings that are held out in turn, or on
    ``select`` (see `search`): first by linear models, from least squares on, then by networks around the best of them.
    Where no network is clearly better, the linear model is the answer. What was chosen is then trained on all
    recordings; ``select`` takes no part in training.

    Args:
        records: training recordings, uniform or not, without gaps.
        inputs, outputs: Signals, or names that take the unit of the recording.
        period: s between steps. validate: checked, and nothing else: who judges with them is not helped by them.
        select: recordings to choose by.
        lags: past increments of the outputs, samples of the inputs. delay: newest samples of the inputs that are not
            looked at; they are among those samples. integrates: whether the linear part is blind to the outputs' level.
        substeps: steps in a period, over which inputs are means; None: where the period is chosen and its samples do
            not show what the inputs do in between, those of the recordings (`substeps_step`).
        hidden: tanh units; 0: the best linear model in free run.
        seed, starts: seeds ``seed ... seed + starts - 1`` are trained; ``provenance["seeds"]`` has what each comes to.
        effort: scales the number of iterations. budget: time limit in s, after which the best so far is taken.
        commands: inputs whose standing still lets the machine rest (see `steady`); None: all of them.
        progress: called with a `TrainingProgress` after every iteration.

    The same seed and data give the same network unless the budget ends the training, which ``provenance["stopped"]``
    tells. Ctrl-C ends the training with the best network so far.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options.
    """
    counts = {"lags[0]": (lags[0], 0), "lags[1]": (lags[1], 1), "delay": (delay, 0), "hidden": (hidden, 0)}
    check_counts("train_network", counts | {"starts": (starts, 1), "substeps": (substeps, 1)})
    check_positive("train_network", effort=effort, budget=budget, period=period)
    inputs, outputs, records, validate = checked_recordings("train_network", records, inputs, outputs, validate)
    select = checked_recordings("train_network", records, inputs, outputs, select)[3]
    asked = Asked(period, *lags, delay, integrates, hidden, seed, starts, effort, substeps)
    meter = Meter(budget, progress)
    search = Search(records, select, inputs, outputs, asked, meter)
    _check_size(search, asked)
    search.run()
    found, weights = search.trained()
    problem = search.problem(found.form)
    parts = dict(zip(problem.shape.weights, weight_arrays(weights, problem.shape), strict=True))
    arrays = problem.series.arrays | problem.series.feature_range(problem.shape) | parts
    block = assemble(
        NETWORK,
        arrays,
        problem.shape.structure(),
        name=name,
        inputs=inputs,
        outputs=outputs,
        states=network_states(problem.shape, inputs, outputs),
        parameters=(),
        period=found.form.period,
        domain=training_box(records, (*inputs, *outputs)),
        description=_describe(found.form, problem.shape),
        provenance={
            "kind": "network",
            "trained_on": named(records),
            "selected_on": named(select) or f"{PARTS} parts of the training recordings, held out in turn",
            "form": found.form.told() | {"substeps": search.steps(found.form.period)},
            "seed": found.seed,
            "seeds": search.seeds,
            "held_out_error": found.error,
            "iterations": meter.iterations,
            "seconds": round(meter.seconds, 2),
            "stopped": meter.stopped or "finished",
            "versions": {package: metadata.version(package) for package in ("numpy", "casadi")},
        },
    )
    block = replace(block, certificate=certify(block, weights, problem.shape))
    block = with_steps(block, search.steps(found.form.period))
    return steady_where_it_integrates(block, records, outputs, commands=commands, curve=True)


def certify(block: LearnedBlock, weights: np.ndarray, shape: NarxShape, points: int = 20_000) -> Certificate:
    """The largest |deployed - trained| of one step over `random_steps`, relative to the outputs' scale."""
    a, ny = block.arrays, shape.outputs
    states, inputs, features = random_steps(a, shape, points)
    y_next, moved = next_step(weights, shape, Scales.of(a), features)
    deployed = np.array(block.step.map(points)(states.T, inputs.T, np.zeros((0, points)))[0]).T
    errors = [(deployed[:, :ny] - a["output_centre"]) / a["output_scale"] - y_next]
    if shape.output_lags:
        errors.append(deployed[:, ny : 2 * ny] / a["output_scale"] - moved)
    difference = max(float(np.abs(e).max()) for e in errors)
    return Certificate(difference, TOLERANCE, points, f"numpy {metadata.version('numpy')} float64")


def _check_size(search: Search, asked: Asked) -> None:
    """Raise `DataError` for too few samples: of all at the shortest period, and for the weights that were asked for."""
    period = min(search.periods())
    samples = sum(len(p.time) for p in search.series(period).pieces)
    if samples < LEAST:
        short = min(search.records, key=len)
        raise DataError(
            f"{short.source or short.name}: too few samples to train on (got {samples} at {period:g} s). "
            f"At least {LEAST} are needed. Record longer or choose a shorter period."
        )
    form = Form(period, asked.output_lags or 1, asked.input_lags or 2, hidden=asked.hidden or 0)
    size = form.shape(len(search.inputs), len(search.outputs)).size
    if samples * len(search.outputs) < 2 * size:
        raise DataError(
            f"train_network: too few samples for {size} weights (got {samples}). At least "
            f"{2 * size // len(search.outputs)} are needed. Record longer, or choose a shorter period or fewer hidden "
            "units."
        )


def _describe(form: Form, shape: NarxShape) -> str:
    layer = f"{shape.hidden} tanh units and a linear part" if shape.hidden else "linear"
    late = f" of which the newest {form.delay} are not looked at" if form.delay else ""
    lags = f"{shape.output_lags} past increments, {shape.input_lags} input samples{late}"
    return f"NARX, {layer}, {lags}, {len(form.trained(shape.inputs, shape.outputs))} weights"
