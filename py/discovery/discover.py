"""discover: find where a model disagrees with recordings, name what is missing, add it, show the gap shrink."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor

import numpy as np

from hydrotwin.identification.assumptions import Change
from hydrotwin.identification.horizon import measured_start
from hydrotwin.identification.outliers import Strays
from hydrotwin.models.effects import candidates as fitting_candidates
from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.model import Model
from hydrotwin.records.between import settled
from hydrotwin.work.executor import Starts, begin_early, cores_of, executor_for
from hydrotwin.work.memory import recalled
from hydrotwin.work.progress import reporting

from .answer.answering import answer
from .answer.discovery import Discovery
from .answer.so_far import SoFar
from .around.foreign import around
from .around.surroundings import SurroundedFmu
from .asked import Asked, Wanted, bounded, free_names
from .assumed import fairly, judge_samples, with_assumptions
from .evidence.score import Spectrum
from .fits.job import Fitted, Look
from .fits.whole import conclude, judged
from .fits.whole import step as next_step
from .recordings import split
from .structures.jobs import EFFORTS
from .structures.search import Search

MOST_EFFECTS = 3
KEPT = (Fitted, Look, Spectrum, Change, Strays)  # answers that an interrupted search need not find again


def discover(
    model: Model,
    records: Sequence,
    *,
    validate: Sequence = (),
    free: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    exclude: Sequence[str] = (),
    max_effects: int = MOST_EFFECTS,
    initial_states: str = "auto",
    outputs: Sequence[str] | None = None,
    noise: Mapping[str, float] | None = None,
    step: float | None = None,
    executor: str | Executor | None = None,
    progress: bool | Callable | None = None,
    memory=None,
    interpolation: Mapping[str, str] | None = None,
    effort: str = "normal",
    time_limit: float | None = None,
    so_far: Callable[[Discovery], None] | None = None,
) -> Discovery:
    """Name the physical effects that a model lacks, from recordings of the machine.

    Every effect of the catalogue at every place it fits, alone, in pairs and more, is led from the start values of the
    model through short windows to whole recordings, those that promise most first. All that were fitted are compared by
    one score; the answer is the posterior over nothing, each of them, and something else. ``validate`` chooses
    nothing: with other recordings there, or none, the effects, their classes, order and values are the same to the bit.
    It may lower how sure that is, and turn an answer into "unknown".

    Args:
        model: what the machine is thought to be; of an FMU, effects before its inputs and after its outputs.
        records: recordings to learn from, at least one, better three.
        validate: recordings to show the answer on.
        free: globs over the base parameters to identify; None: those the model declares free.
        effects, exclude: globs over effect ids or ``id at site``.
        max_effects: most effects to add.
        initial_states: as in `identify`; "free" when a start state is unknown.
        noise: sensor noise by output, SI, in place of the estimate.
        executor: where fits run, see `executor_for`.
        progress: True for a bar, or a function ``(stage, done, total, note)``.
        memory: a `Memory` of finished fits, to go on after an interruption; ``seconds`` counts all parts.
        interpolation: "hold" or "linear" by input, in place of what the model says or the recordings show.
        effort: "quick", "normal" or "thorough": how many structures are fitted, and how long each may take.
        time_limit: seconds [s] after which the best so far is the answer; last fits take a few seconds more.
        so_far: called with the answer as it stands, after 45 s and again every minute at most; changes nothing.

    Raises DataError (recordings that cannot be used), DeclarationError (unknown names), SolveError (the base model
    diverges from every start).
    """
    began = time.perf_counter()
    if max_effects < 1:
        raise DeclarationError(f"gap: max_effects must be at least 1 (got {max_effects}).")
    if effort not in EFFORTS:
        raise DeclarationError(f"gap: no effort '{effort}'. {nearest(effort, list(EFFORTS))}")
    if memory is not None:
        memory.begin()
    wanted = Wanted(records, validate, free, effects, exclude, initial_states, outputs, noise, step, interpolation)
    is_fmu = isinstance(model, SurroundedFmu) or getattr(model, "kind", "") == "fmu"
    ask = around if is_fmu else inside
    asked = ask(model, wanted)
    until = time.monotonic() + (np.inf if time_limit is None else time_limit)

    def complete(said: Discovery) -> Discovery:
        earlier = 0.0 if memory is None else memory.earlier
        given = {"train": len(records), "validate": len(validate)}
        return dataclasses.replace(said, given=given, seconds=time.perf_counter() - began + earlier)

    telling = SoFar(so_far, complete) if so_far else None
    with reporting(progress, asked.model.name) as report, executor_for(executor) as pool:
        begin_early(pool, next_step)
        run = _runner(pool, report, memory, 1 if is_fmu else cores_of(pool))
        report("identify the base", 0, 1, asked.note)

        def again(model, initial_states: str) -> Asked:
            return ask(model, dataclasses.replace(wanted, initial_states=initial_states))

        def begin(asked: Asked) -> Search:
            told = [o.name in (noise or {}) for o in asked.model.flat.outputs]
            search = Search(asked.table(step, told), run, EFFORTS[effort], max_effects, until)
            search.pause = telling and telling.of(asked.data, asked.model)
            search.identify()
            return search

        search, asked, given_up = fairly(asked, again, begin)
        said = with_assumptions(answer(search, asked.data, asked.model), given_up)
    return complete(said)


def inside(model: Model, wanted: Wanted) -> Asked:
    """What is asked of a model whose equations are known: effects stand anywhere in it."""
    if not isinstance(model, Model):
        raise DeclarationError(
            f"gap: '{getattr(model, 'name', model)}' is no component model, so no effect can be added inside it. "
            "Wrap it, or compare it only: hydrotwin compare."
        )
    model = settled(model, wanted.records, wanted.interpolation)
    data = split(model.flat, wanted.records, wanted.validate, wanted.outputs, wanted.noise)
    moving = any(r.in_motion for r in data.train) and wanted.initial_states == "auto"
    names = free_names(model.flat, wanted.free)
    within = bounded(model, names)
    fitting = fitting_candidates(within, wanted.effects, wanted.exclude)
    return Asked(model, within, names, data, fitting, "free" if moving else wanted.initial_states)


def _runner(pool, report, memory, cores: int = 1):
    """``run(function, jobs, stage)``: the answers in order, from memory where they are known.

    The last jobs share the ``cores`` that they would leave idle.
    """

    def run(function, jobs, stage: str) -> list:
        done = 0
        report(stage, 0, len(jobs), "")

        def on_done(index: int, result) -> None:
            nonlocal done
            done += 1
            report(stage, done, len(jobs), getattr(jobs[index], "label", ""))

        last = len(jobs) % cores
        threads = [cores // last if len(jobs) - i <= last else 1 for i in range(len(jobs))]
        ready = [_portable(*job) for job in zip(jobs, threads, strict=True)]
        kept = function not in (conclude, judged, judge_samples)  # soon done again; nothing that judges is remembered
        return list(recalled(memory, pool, function, ready, on_done, kinds=KEPT, kept=kept))

    return run


def _portable(job, threads: int):
    """A job that can travel: its model keeps the start functions that the job needs, and no others."""
    flat, order = job.flat, [s.name for s in job.flat.states]
    measured = {tuple(measured_start(flat, r)) for r in (*job.question.fit, *job.question.select)}
    together = set.intersection(*(set(names) for names in measured))
    wanted = {*measured, tuple(n for n in order if n in together), tuple(order)}
    wanted |= {tuple(n for n in order if n in states) for states in job.states}
    starts = Starts({names: flat.start_given(names) for names in wanted})
    shared = {"threads": threads} if hasattr(job, "threads") else {}
    return dataclasses.replace(job, flat=dataclasses.replace(flat, initialisation=starts), **shared)
