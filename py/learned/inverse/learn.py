"""Learn the inverse of a characteristic: which command gives a wanted steady rate.

    u = f^-1(r),   du/dr >= 0

A deadband is a jump of the inverse. The table keeps it: the forward characteristic is made monotone (isotonic
regression of the rates, whose noise it is), then read the other way, no steeper than a cap. The networks round it off.
Source: Taheri et al., Nonlinear Model Learning for Compensation and Feedforward Control of Real-World Hydraulic
Actuators Using Gaussian Processes, IEEE RA-L 7 (2022), section III-C; isotonic regression: Barlow et al. (1972).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib import metadata

import numpy as np
from scipy.optimize import isotonic_regression

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.simulation.block import TrainingDomain

from ..block_file import Certificate, LearnedBlock, assemble
from ..needs import needed_to_train
from ..options import check_counts, check_known
from .curve import GRID, INVERSE_NETWORK, INVERSE_TABLE, refuse_falling, static_answer
from .data import Characteristic, characteristic
from .falling import refuse_what_falls

METHODS = ("table", "network", "monotone")
SAMPLINGS = ("rate", "command")
TOLERANCE = 1e-12  # of the commands' range: deployed against learnt
STANDSTILL = 2.0  # sigmas below which a rate counts as rest
MOST_STANDSTILL = 0.01  # of the rates' span
THINNED = 2e-4  # of the ranges: what leaving out knots may change; half a sigma where that is more
CHECKED = 501  # rates at which the round trip is judged


@dataclass(frozen=True)
class RoundTrip:
    """How far ``f(f^-1(r))`` is from r over the reach: RMS and largest, as shares of the span of the rates."""

    rms: float
    worst: float


def learn_inverse(
    source,
    input: Signal | str | None = None,
    output: Signal | str | None = None,
    *,
    method: str = "table",
    seed: int = 0,
    name: str = "inverse",
    steepest: float = 200.0,
    hidden: int = 16,
    monotonicity: float = 1.0,
    iterations: int = 3000,
    sampling: str = "rate",
    progress: Callable | None = None,
    **steady,
) -> LearnedBlock:
    """Learn which command of ``input`` gives a wanted steady rate of ``output``, as a Block without states.

    Args:
        source: recordings, a Block, a Model or a `Characteristic`; ``steady`` are the options of `characteristic`.
        input, output: Signals or names; a Characteristic has its own.
        method: "table" (isotonic, the best), "network" (the paper's, with its monotonicity loss, Eq. 6-7), "monotone"
            (a network whose weights are positive). The last two need PyTorch to learn, never to run.
        steepest: of the table, in mean slopes: how fast the command may cross the deadband.
        hidden, iterations, seed: of the networks, two layers of tanh units, full-batch Adam.
        monotonicity: weight of the loss on falling slopes; it is raised by ten, twice at most, while any slope falls.
            0 leaves it out.
        sampling: of "network" and "monotone": every point counts by the "rate" it covers, or every "command" equally
            as in the paper, which smears the jump of the deadband.
        progress: called with ``(iteration, loss)`` by the networks.

    The input of the block is ``wanted_<output>`` or ``wanted_<output>_rate``, its output is named as the command.
    ``provenance`` holds the round trip, the least slope and the recordings. Ctrl-C ends the training with what it has.

    Raises:
        SolveError: an inverse that falls anywhere on 20,001 points. DataError: see `characteristic`; rates that fall
        by more than they rise. Where they fall by less, ``provenance["falls"]`` tells it.
        DeclarationError: an unknown method, impossible options, or PyTorch is not installed.
    """
    _check_options(method, steepest, hidden, iterations, monotonicity, sampling)
    forward = characteristic(source, input, output, **steady)
    _, r, w = _merged(forward)
    rises = float(np.ptp(isotonic_regression(r, weights=w).x))
    refuse_what_falls(forward.rate.name.removeprefix("wanted_"), forward.input.name, forward.fell, rises)
    if method == "table":
        arrays, structure, learnt = _table(forward, steepest)
        block = _block(INVERSE_TABLE, arrays, structure, forward, name, f"isotonic table, {structure['knots']} knots")
        hint, told = "Learn it again from other recordings.", {"steepest": steepest}
    else:
        with needed_to_train("learn_inverse", ", or take method='table', which does without"):
            from . import network as training
        trained = training.train(
            forward, hidden=hidden, positive=method == "monotone", weight=monotonicity, by_rate=sampling == "rate",
            iterations=iterations, seed=seed, progress=progress,
        )  # fmt: skip
        learnt, words = trained.answer, f"{method} network, 2 x {hidden} tanh units"
        block = _block(INVERSE_NETWORK, trained.arrays, {"hidden": hidden}, forward, name, words)
        hint = "Raise monotonicity or iterations, or take method='table'."
        told = {"seed": seed, "iterations": trained.iterations, "loss": trained.loss, "monotonicity": trained.weight,
                "stopped": trained.stopped or "finished", "versions": _versions("torch")}  # fmt: skip
    slope = refuse_falling(block, hint)
    trip = round_trip(block, forward)
    provenance = {
        "kind": "inverse", "method": method, **forward.source, "round_trip": trip.rms, "round_trip_worst": trip.worst,
        "least_slope": slope, "sigma": forward.sigma, "versions": _versions(), **told,
    }  # fmt: skip
    provenance |= {"falls": asdict(forward.fell)} if forward.fell else {}
    return replace(block, certificate=_certify(block, learnt), provenance=provenance)


def round_trip(block: LearnedBlock, forward: Characteristic) -> RoundTrip:
    """How well the commands of an inverse give the rates wanted, by the forward characteristic made monotone."""
    u, r, w = _merged(forward)
    f = isotonic_regression(r, weights=w).x
    low, high = block.domain.lower[0], block.domain.upper[0]
    wanted = np.linspace(low, high, CHECKED)
    error = (np.interp(static_answer(block, wanted), u, f) - wanted) / (high - low)
    return RoundTrip(float(np.sqrt(np.mean(error**2))), float(np.abs(error).max()))


def _table(forward: Characteristic, steepest: float):
    """Arrays and structure of the table, and the function it was built from."""
    u, r = _knots(forward, steepest)
    off = max(THINNED, min(0.5 * forward.sigma / np.ptp(r), 10 * THINNED))
    keep = _thinned((r - r[0]) / (r[-1] - r[0]), (u - u[0]) / (u[-1] - u[0]), off)
    u, r = u[keep], r[keep]
    return {"rates": r, "commands": u}, {"knots": len(u)}, lambda wanted: np.interp(wanted, r, u)


def _knots(forward: Characteristic, steepest: float) -> tuple[np.ndarray, np.ndarray]:
    """Commands and rising rates of the monotone characteristic: one knot per pool, both ends of the standstill."""
    u, r, w = _merged(forward)
    still = min(max(STANDSTILL * forward.sigma, 1e-9 * np.ptp(r)), MOST_STANDSTILL * np.ptp(r))
    fit = isotonic_regression(r, weights=w)
    levels, below, above = fit.x[fit.blocks[:-1]], fit.x < -still, fit.x > still
    middle = np.add.reduceat(u * w, fit.blocks[:-1]) / np.add.reduceat(w, fit.blocks[:-1])
    edges = np.unique(u[~below & ~above][[0, -1]]) if not (below | above).all() else np.empty(0)
    commands = np.concatenate([middle[levels < -still], edges, middle[levels > still]])
    rates = np.concatenate([levels[levels < -still], np.zeros(len(edges)), levels[levels > still]])
    centre = edges.mean() if len(edges) else 0.0
    ramp = np.ptp(rates) / (steepest * np.ptp(commands)) * (commands - centre)
    rates = isotonic_regression(rates - ramp).x + ramp
    rising = np.append(True, np.diff(rates) > 0)
    return commands[rising], rates[rising]


def _merged(forward: Characteristic) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distinct commands, the mean rate at each, how many points it is the mean of."""
    u, at, count = np.unique(forward.commands, return_inverse=True, return_counts=True)
    return u, np.bincount(at, forward.rates) / count, count.astype(float)


def _thinned(x: np.ndarray, y: np.ndarray, allowed: float) -> np.ndarray:
    """Indices of the knots to keep so that no other is farther than ``allowed`` off (Douglas and Peucker 1973)."""
    keep, open_ = {0, len(x) - 1}, [(0, len(x) - 1)]
    while open_:
        a, b = open_.pop()
        if b - a < 2:
            continue
        dx, dy = x[b] - x[a], y[b] - y[a]
        off = np.abs(dy * (x[a + 1 : b] - x[a]) - dx * (y[a + 1 : b] - y[a])) / math.hypot(dx, dy)
        worst = a + 1 + int(np.argmax(off))
        if off.max() > allowed:
            keep.add(worst)
            open_ += [(a, worst), (worst, b)]
    return np.array(sorted(keep))


def _block(kind, arrays: Mapping, structure: Mapping, forward: Characteristic, name: str, words: str) -> LearnedBlock:
    low, high = (float(v) for v in (arrays["rates"][[0, -1]] if "rates" in arrays else forward.reach))
    return assemble(
        kind,
        arrays,
        structure,
        name=name,
        inputs=(forward.rate,),
        outputs=(replace(forward.input, dead_time=None),),
        states=(),
        parameters=(),
        period=forward.period,
        domain=TrainingDomain((forward.rate.name,), (low,), (high,)),
        description=f"inverse characteristic: {forward.rate.description} -> {forward.input.name}; {words}",
        provenance={},
    )


def _certify(block: LearnedBlock, learnt: Callable[[np.ndarray], np.ndarray]) -> Certificate:
    """Largest |deployed - learnt| over the reach and a tenth beyond, relative to the range of the commands."""
    low, high = block.domain.lower[0], block.domain.upper[0]
    grid = np.linspace(low - 0.1 * (high - low), high + 0.1 * (high - low), GRID)
    found, expected = static_answer(block, grid), np.asarray(learnt(grid), float)
    scale = max(float(np.ptp(expected)), 1e-300)
    table = block.kind == INVERSE_TABLE.name
    reference = "numpy interpolation" if table else f"torch {metadata.version('torch')} float64"
    return Certificate(float(np.abs(found - expected).max()) / scale, TOLERANCE, GRID, reference)


def _versions(*more: str) -> dict[str, str]:
    return {package: metadata.version(package) for package in ("numpy", "scipy", "casadi", *more)}


def _check_options(method, steepest, hidden, iterations, monotonicity, sampling) -> None:
    check_known("learn_inverse", "method", method, METHODS)
    check_known("learn_inverse", "sampling", sampling, SAMPLINGS)
    check_counts("learn_inverse", {"hidden": (hidden, 1), "iterations": (iterations, 1)})
    if not steepest > 1:
        raise DeclarationError(f"learn_inverse: steepest must be above 1 mean slope (got {steepest}). Try 200.")
    if not 0 <= monotonicity < math.inf:
        raise DeclarationError(f"learn_inverse: monotonicity must not be negative (got {monotonicity}). Try 1.")
