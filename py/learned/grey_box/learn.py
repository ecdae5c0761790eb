"""Learn a latent-spool grey box: dead time, spool, play, monotone map and lag from command and position alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from importlib import metadata
from time import perf_counter

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..block_file import LearnedBlock, assemble
from ..integrating import integration, one_form, told_forms
from ..interruption import INTERRUPTED
from ..options import check_counts, check_positive
from ..steady import Steady, steady_block
from ..training_data import named, training_box
from .block import GREY_BOX, grey_box_states
from .data import (
    FitProgress,
    Run,
    Watch,
    block_period,
    certify,
    coarser,
    falls,
    one_in_one_out,
    run_of,
    seen_late,
)
from .fit import (
    Fitted,
    Problem,
    bent_knots,
    evaluate,
    intervals,
    opening,
    refine,
    responses,
    reweighed,
    rough_starts,
)

LONGEST = 125  # periods: dead time, time constants
TRIAL, MORE = 5, 15  # evaluations of the outer solver (each with its derivatives): per start, for the best one


def learn_grey_box(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    period: float | None = None,
    validate: Sequence[Record] = (),
    select: Sequence[Record] = (),
    knots: int = 25,
    starts: int = 4,
    integrating: bool | None = None,
    seed: int = 0,
    effort: float = 1.0,
    name: str = "grey_box",
    progress: Callable[[FitProgress], None] | None = None,
) -> LearnedBlock:
    """Fit the grey box of `grey_box_block` to recordings of one command and one output and answer it as a Block.

    Nothing between command and output needs to be measured. Times may be uneven and outputs quantised: every sample
    counts at its own time, and what is left is taken as sensor noise on a random walk, whose ratio is estimated too.

    Args:
        records: training recordings without gaps. inputs, outputs: one each, as Signals or names.
        period: s between steps of the block; None: a fifth of `choose_period`.
        validate: checked, and nothing else. select: recordings that choose among the starts; none: the training loss
            does.
        knots: points of the map; they gather where it bends. starts: dynamics refined from a scan, every
            other one with the play behind the spool; the best is kept.
        integrating: the map gives the rate of the output (a position); False: the output itself (a speed); None: what
            the recordings tell (`integration`).
        seed: spreads the starts. effort: scales the evaluations.
        progress: called with a `FitProgress` after every evaluation.

    The identified constants and their 95 % intervals are in ``provenance["identified"]``: [value, low, high]. The
    intervals hold for noise, not for what the machine has and the grey box has not; slow samples tell the sum of dead
    time, 2 D/w0 and lag much better than its parts.
    The same seed and data give the same block. Ctrl-C ends the fit with the best so far.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options.
    """
    began = perf_counter()
    check_counts("learn_grey_box", {"knots": (knots, 4), "starts": (starts, 1)})
    check_positive("learn_grey_box", effort=effort)
    records, select, input_, output = one_in_one_out("learn_grey_box", records, inputs, outputs, validate, select)
    period = block_period("learn_grey_box", records, period)
    forms = integration(records, (input_,), (output,))
    integrating = one_form("learn_grey_box", "integrating", integrating, forms)
    sign = -1.0 if falls([run_of(r, period, input_, output) for r in records], integrating) else 1.0

    def at(step: float, part=records) -> Problem:
        runs = [run_of(r, step, input_, output) for r in part]
        turned = [replace(run, output=sign * run.output) for run in runs]
        return Problem(turned, step, integrating, 1.0 if integrating else None, LONGEST * period)

    quick, fine = at(coarser(records, period)), at(period)
    judge = at(quick.period, select) if select else quick
    fitted, problem, watch = _fit(quick, fine, judge, knots, starts, seed, effort, progress)
    block = _block(fitted, sign, integrating, period, name, records, input_, output)
    identified = _identified(problem, fitted, seen_late(records, period, input_))
    provenance = {
        "kind": "grey_box",
        "trained_on": named(records),
        "selected_on": named(select) or "the training loss",
        "integrating": integrating,
        "integration": told_forms(forms),
        "identified": identified,
        "play": "before the spool" if fitted.dynamics.play_first else "behind the spool",
        "walk_to_sensor_noise": "none" if problem.ratio is None else problem.ratio,
        "seed": seed,
        "evaluations": watch.evaluations,
        "seconds": round(perf_counter() - began, 2),
        "stopped": watch.stopped or "finished",
        "versions": {package: metadata.version(package) for package in ("numpy", "scipy", "casadi")},
    }
    expected = [sign * _output(problem, fitted, run) for run in problem.runs]
    block = replace(block, provenance=provenance, certificate=certify(block, problem.runs, expected))
    return steady_block(block, records, Steady((output,) if integrating else ()))


def _identified(problem: Problem, fitted: Fitted, late: float) -> dict[str, list[float]]:
    """[value, low, high] of each constant; the dead time is the machine's, which the block sees later by ``late``."""
    known = intervals(problem, fitted)
    answer = {key: [value, *known[key]] for key, value in _constants(fitted).items()}
    answer["dead_time"] = [value + late for value in answer["dead_time"]]
    return answer


def _fit(quick: Problem, fine: Problem, judge: Problem, knots: int, starts: int, seed: int, effort: float, progress):
    """Scan, refine each start a little, weigh and place the knots anew and refine the best; at last at full fineness.

    Half of the starts have the play before the spool, half behind it.
    """
    watch, even, problem = Watch(progress), np.linspace(*quick.span, knots), quick
    trial, more = (max(round(n * effort), 1) for n in (TRIAL, MORE))
    try:
        watch(evaluate(problem, rough_starts(problem, 1)[0], even))
        problem = reweighed(problem, watch.best)
        watch.anew()
        half = (starts + 1) // 2
        apart = _spread(rough_starts(problem, half), half, seed)
        begun = [replace(d, play_first=first) for d in apart for first in (True, False)][:starts]
        tried = [refine(problem, d, even, trial, watch) for d in begun]
        best = min(tried, key=lambda f: _loss(replace(judge, ratio=problem.ratio), f))
        for problem, evaluations in ((quick, more), (fine, trial)):
            problem = reweighed(problem, best)
            bent = bent_knots(best.knots, best.values)
            watch.anew()
            best = refine(problem, best.dynamics, bent, evaluations, watch)
    except KeyboardInterrupt:
        if watch.best is None:
            raise
        watch.stopped, best = INTERRUPTED, watch.best
    problem = replace(fine, ratio=problem.ratio)
    return evaluate(problem, best.dynamics, best.knots), problem, watch


def _constants(fitted: Fitted) -> dict[str, float]:
    """Dead time, natural frequency, damping, play and lag."""
    return {key: value for key, value in asdict(fitted.dynamics).items() if key != "play_first"}


def _spread(found, starts: int, seed: int):
    """The scan's dynamics; where there are too few, copies with other time constants."""
    random, answer = np.random.default_rng(seed), list(found)
    while len(answer) < starts:
        d = found[len(answer) % len(found)]
        slower = np.exp(random.uniform(0.0, 1.5, 2))
        answer.append(replace(d, natural_frequency=d.natural_frequency / slower[0], lag=d.lag * slower[1]))
    return answer[:starts]


def _loss(problem: Problem, fitted: Fitted) -> float:
    """Mean square of the weighed misses of the fit on the runs of the problem."""
    misses = problem.rows(lambda run: run.output - run.sampled(_output(problem, fitted, run)))
    return float(np.mean(misses**2))


def _output(problem: Problem, fitted: Fitted, run: Run) -> np.ndarray:
    """The output of the fit at the block's samples, (m,), from the first one measured."""
    d, q = fitted.dynamics, opening(run, fitted.dynamics, problem.period)
    rows = responses(q, fitted.knots, d.lag, problem.period, problem.integrating)
    return rows @ fitted.values + run.output[0] * problem.integrating


def _block(fitted: Fitted, sign, integrating, period, name, records, input_: Signal, output: Signal) -> LearnedBlock:
    d = fitted.dynamics
    structure = {"knots": len(fitted.knots), "delay": d.late(period)[0] + 1}
    structure |= {"integrating": int(integrating), "play_first": int(d.play_first)}
    arrays = {key: np.array([value]) for key, value in {**_constants(fitted), "period": period}.items()}
    return assemble(
        GREY_BOX,
        arrays | {"knots": fitted.knots, "rates": sign * fitted.values},
        structure,
        name=name,
        inputs=(input_,),
        outputs=(output,),
        states=grey_box_states(structure, input_, output),
        parameters=(),
        period=period,
        domain=training_box(records, (input_, output)),
        description=(
            f"latent spool: dead time {1e3 * d.dead_time:.3g} ms, {d.natural_frequency:.3g} rad/s, play {d.play:.3g} "
            f"{input_.unit} {'before' if d.play_first else 'behind'} it, {len(fitted.knots)} knots, "
            f"lag {1e3 * d.lag:.3g} ms"
        ),
        provenance={},
    )
