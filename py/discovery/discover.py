"""discover: find where a model disagrees with recordings, name what is missing, add it, show the gap shrink."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor

from hydrotwin.identification.horizon import measured_start
from hydrotwin.models.effects import candidates as fitting_candidates
from hydrotwin.models.language.errors import DeclarationError, SolveError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.model import Model
from hydrotwin.models.language.units import compatible
from hydrotwin.records.between import settled

from .answering import Found, answer
from .assumed import fairly, with_assumptions
from .base import identified
from .confirm import confirmed
from .discovery import Discovery
from .executor import Starts, cores_of, executor_for
from .forward import begun, searched
from .progress import reporting
from .recordings import Split, split
from .refit import Led, Question, Refitted, conclude
from .resume import recalled
from .search import Search
from .structure import Structure
from .together import explained_together

MOST_EFFECTS = 3
KEPT = (Refitted, Led)  # answers that an interrupted search need not find again
NARROW, WIDE = 1.6, 30.0  # factors around the start within which a positive base parameter may move


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
) -> Discovery:
    """Name the physical effects that a model lacks, from recordings of the machine.

    The model is identified on ``records``; every effect of the catalogue that fits somewhere in it is screened, the
    promising ones are refitted together with the base parameters, and one is named only when it is better by far on the
    recordings it was fitted to, better on those held out, and closes a worthwhile part of the gap. ``validate`` takes
    part in nothing but the final figures.

    Args:
        model: what the machine is thought to be; of an FMU, effects before its inputs and after its outputs.
        records: recordings to learn from, at least one, better three.
        validate: recordings to show the answer on.
        free: globs over the base parameters to identify; None: those the model declares free.
        effects, exclude: globs over effect ids or ``id at site``.
        max_effects: most effects to add.
        initial_states: as in `identify`; "free" when a start state is unknown.
        noise: sensor noise by output, SI, in place of the estimate.
        executor: where refits run, see `executor_for`.
        progress: True for a bar, or a function ``(stage, done, total, note)``.
        memory: a `Memory` of finished refits, to go on after an interruption.
        interpolation: "hold" or "linear" by input, in place of what the model says or the recordings show.

    Raises DataError (recordings that cannot be used), DeclarationError (unknown names), SolveError (the base model
    diverges from every start).
    """
    began = time.perf_counter()
    if max_effects < 1:
        raise DeclarationError(f"gap: max_effects must be at least 1 (got {max_effects}).")
    if getattr(model, "kind", "") == "fmu":
        from .foreign import discover_around  # made of what stands here

        return discover_around(
            model, records, validate=validate, free=free, effects=effects, exclude=exclude, max_effects=max_effects,
            initial_states=initial_states, outputs=outputs, noise=noise, step=step, executor=executor,
            progress=progress, memory=memory, interpolation=interpolation,
        )  # fmt: skip
    if not isinstance(model, Model):
        raise DeclarationError(
            f"gap: '{getattr(model, 'name', model)}' is no component model, so no effect can be added inside it. "
            "Wrap it, or compare it only: hydrotwin compare."
        )
    model = settled(model, records, interpolation)
    if len(records) == 1 and initial_states == "auto":
        initial_states = "free"  # the pieces of a lone recording begin in motion
    names = _free_names(model.flat, free)
    told = tuple(n.name in (noise or {}) for n in model.flat.outputs)
    with reporting(progress, model.name) as report, executor_for(executor) as pool:
        run = _runner(pool, report, memory, cores_of(pool))

        def begin(model: Model, initial_states: str) -> tuple[Search, Split, Structure]:
            flat = model.flat
            data = split(flat, records, validate, outputs, noise)
            question = Question(data.fit, data.select, data.noise, initial_states, step, usual_of(flat, names))
            bounded = _bounded(model, names)
            report("identify the base", 0, 1, "")
            search = Search(bounded, names, fitting_candidates(bounded, effects, exclude), question, run, report, told)
            return search, data, Structure((), _or_refused(identified(search, search.models_ahead())))

        def search_on(search: Search, base: Structure) -> Found:
            return searched(search, begun(search, base), max_effects)

        search, data, found, model, given_up = fairly(begin, search_on, model, initial_states)
        search, found = explained_together(search, data, found, max_effects)
        found = confirmed(search, data, found)
        return with_assumptions(answer(search, data, found, model, began), given_up)


def _bounded(model: Model, names: Sequence[str]) -> Model:
    """The model with what is to be identified free, and bounds around the start values of what is always positive.

    A base that lacks an effect swallows the gap with whatever lets it: a third of the dead volume, a fourth of the
    stiffness. Volumes and pressures stay within a factor of 1.6, the rest within thirty.
    """
    changes = {}
    for p in model.flat.parameters:
        low, high = p.bounds
        if p.name in names and not p.free:
            changes[p.name] = {"free": True}
        if p.name in names and low > 0 and p.value > 0:
            factor = NARROW if compatible(p.unit, "m3") or compatible(p.unit, "Pa") else WIDE
            changes.setdefault(p.name, {})["bounds"] = (max(low, p.value / factor), min(high, p.value * factor))
    return model.with_settings(changes, model.provenance) if changes else model


def usual_of(flat: FlatModel, names: Sequence[str]) -> dict[str, float]:
    """The values of these parameters that a model comes with."""
    return {p.name: p.value for p in flat.parameters if p.name in names}


def _free_names(flat, free: Sequence[str] | None) -> tuple[str, ...]:
    from hydrotwin.identification.problem import free_parameters

    return free_parameters(flat, free).names


def _or_refused(found: Refitted | str) -> Refitted:
    if isinstance(found, str):
        raise SolveError(f"gap: the base model cannot be identified ({found}). Correct its start values first.")
    return found


def _runner(pool, report, memory, cores: int = 1):
    """``run(function, jobs, stage)``: the answers in order, from memory where they are known.

    The last jobs share the ``cores`` that they would leave idle; ``meanwhile`` is gone through while they are at work.
    """

    def run(function, jobs, stage: str, meanwhile: Iterable = ()) -> list:
        done = 0
        report(stage, 0, len(jobs), "")

        def on_done(index: int, result) -> None:
            nonlocal done
            done += 1
            report(stage, done, len(jobs), getattr(jobs[index], "label", ""))

        last = len(jobs) % cores
        threads = [cores // last if len(jobs) - i <= last else 1 for i in range(len(jobs))]
        ready = [_portable(*job) for job in zip(jobs, threads, strict=True)]
        kept = None if function is conclude else memory  # a final fit holds functions, and is soon done again
        return list(recalled(kept, pool, function, ready, on_done, kinds=KEPT, meanwhile=meanwhile))

    return run


def _portable(job, threads: int):
    """A job that can travel: its model keeps the start functions that the job needs, and no others."""
    flat, order = job.flat, [s.name for s in job.flat.states]
    measured = {tuple(measured_start(flat, r)) for r in (*job.question.fit, *job.question.select)}
    together = set.intersection(*(set(names) for names in measured))
    known = getattr(job, "fitted", None)
    wanted = {*measured, tuple(n for n in order if n in together), tuple(order)}
    if known is not None:
        wanted |= {tuple(n for n in order if n in states) for states in known.states}
    starts = Starts({names: flat.start_given(names) for names in wanted})
    shared = {"threads": threads} if hasattr(job, "threads") else {}
    return dataclasses.replace(job, flat=dataclasses.replace(flat, initialisation=starts), **shared)
