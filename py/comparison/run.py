"""Run every contender on every recording and score it: the verb of this room."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor

import numpy as np

from hydrotwin.identification.beginning import check_initial_states
from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, as_needed, distinct, noise_floor, unbroken, without_unknown
from hydrotwin.records.between import between, settled, told
from hydrotwin.records.unbroken import unknown_stretches
from hydrotwin.simulation import InaccurateWarning
from hydrotwin.work.executor import Here, executor_for
from hydrotwin.work.memory import Memory, recalled

from .band import Held, bands_of, held_here
from .comparison import (
    FREE_RUN,
    MODES,
    Comparison,
    Entrant,
    Inaccurate,
    Score,
    Timing,
    Trajectory,
    mean_scores,
    relative_scores,
)
from .contender import Contender, as_contender
from .domain import domain_shares
from .elsewhere import input_names, other_reasons
from .job import KEPT, WARNINGS, Done, Job, Plan, Run, run_job
from .rates import rate_signal, with_rates
from .tags import check_tags
from .travel import Carried, travels

TIMED = 3  # recordings, the first, on which runs are repeated for their time


def compare(
    contenders: Sequence[Contender],
    records: Sequence[Record],
    *,
    modes: Sequence[str] = MODES,
    outputs: Sequence[str] | None = None,
    rates: Sequence[str] = (),
    train_records: Sequence[Record] = (),
    title: str = "Comparison of models",
    repeats: int = 3,
    progress: Callable[[int, int, str], None] | None = None,
    interpolation: Mapping[str, str] | None = None,
    initial_states: str = "measured",
    known: Sequence[str] = (),
    executor: str | Executor = "here",
    memory: Memory | None = None,
    curves: int | None = None,
) -> Comparison:
    """Score ``contenders`` on ``records``, all on the same inputs and the same samples.

    contenders : models, blocks and FMUs, as they are or by `as_contender`.
    modes : "free run" (inputs and start only) and "one step" (each sample from the measurement before it).
    outputs : names to score; by default every output that some contender gives and some recording holds.
    rates : names of outputs whose slope is scored too, in free run, as output ``<name>.rate``.
    train_records : the recordings the models were made from, for the share of each recording they cover.
    repeats : timed runs per model on each of the first TIMED recordings; fewer when they take longer than
        TIMING_BUDGET together.
    progress : called with (runs done, runs in all, what was done).
    interpolation : "hold" or "linear" by input, in place of what the models say or the recordings show.
    initial_states : "measured": first samples count as exact, and models find the rest of their start; "auto" and
        "free": physical models have it estimated from the first part of each recording, see `estimate_start`. All
        samples are scored, the first part too.
    known : signals, beside the inputs of all contenders, without which nothing runs: runs begin anew behind a hole.
    executor : where the runs are made, see `executor_for`; the numbers are the same to the bit. A contender without
        ``content`` runs here.
    memory : keeps finished runs; those that it knows are not made again.
    curves : so many predicted curves (of models, outputs and modes) are in the answer, of the first recordings; one
        recording at least, and by default all.

    A contender that fails on a recording is a row of ``failures``. Raises DeclarationError for names that are used
    twice or not known, one condition in two writings, and an executor that is not there, DataError when there is
    nothing to compare.
    """
    _require_lists(contenders=contenders, records=records, modes=modes, outputs=outputs or (), rates=rates)
    contenders = [as_contender(c) for c in contenders]
    signals = [*_signals(contenders), *(s for c in contenders for s in c.inputs)]
    records, train_records = ([as_needed(r, signals) for r in some] for some in (records, train_records))
    known = tuple(dict.fromkeys((*input_names(contenders), *known)))
    records = measured_in(contenders, distinct(records)[0], known)
    modes = tuple(dict.fromkeys(modes))  # one that is named twice counts once
    _check(contenders, records, modes)
    contenders = _settled(contenders, records, interpolation or {})
    wanted = wanted_of(contenders, records, outputs)
    sloped = wanted_of(contenders, records, rates) if rates else []
    how = check_initial_states(initial_states, "compare")
    slopes = tuple(rate_signal(s) for s in sloped)
    plan = Plan(tuple(modes), tuple(wanted), tuple(sloped), slopes, how, known)
    noise = [noise_floor(r) for r in records]
    records = [with_rates(r, sloped) for r in records]
    drawn = _drawn(curves, len(contenders) * len(modes) * len(plan.wanted + plan.rates), len(records))
    jobs = _jobs(contenders, list(zip(records, noise, strict=True)), plan, (repeats, drawn))
    with executor_for(executor) as pool:
        done = _answers(jobs, pool, memory, _counting(progress, jobs))
    for kind, text in dict.fromkeys(w for one in done for w in one.warned):
        warnings.warn(text, WARNINGS[kind], stacklevel=2)
    made = [(job, one, run) for mode in modes for job, one in zip(jobs, done, strict=True) for run in one.runs
            if run.mode == mode]  # fmt: skip
    scores = relative_scores(_by_mode(modes, [s for one in done for s in one.scores]))
    trajectories = [(job, _trajectory(job, run)) for job, _, run in made]
    starts = tuple(started for one in done for started in one.started)
    return Comparison(
        title=title,
        entrants=tuple(
            _judged_here(c, scores, {r.name: other_reasons(c, r, starts, contenders) for r in records})
            for c in contenders
        ),
        records=tuple(records),
        train_records=tuple(train_records),
        modes=tuple(modes),
        outputs=plan.wanted + plan.rates,
        scores=scores,
        means=mean_scores(scores),
        trajectories=tuple(t for job, t in trajectories if job.curves),
        timings=_timings([(job, run) for job, _, run in made]),
        failures=tuple(_by_mode(modes, [f for one in done for f in one.failures])),
        unscored=tuple(dict.fromkeys(u for one in done for u in one.unscored)),
        domains=domain_shares(contenders, records, train_records, [t for _, t in trajectories]),
        residuals=tuple(r for one in done for r in one.residuals),
        starts=starts,
        inaccurate=_inaccurate(jobs, done),
        asked=_asked(plan, interpolation or {}, records),
    )


def _asked(plan: Plan, interpolation: Mapping[str, str], records: Sequence[Record]) -> dict:
    """How a comparison can be made again of one of its models: with inputs that recordings lack in some stretch, for
    all models start anew behind it."""
    lost = [n for n in plan.known if any(n in r and unknown_stretches(r.time, r[n]).any() for r in records)]
    told = {"modes": list(plan.modes), "outputs": [s.name for s in plan.wanted], "rates": [s.name for s in plan.sloped]}
    told |= {"initial_states": plan.initial_states, "interpolation": dict(interpolation), "known": lost}
    return {key: value for key, value in told.items() if value}


def measured_in(contenders: Sequence[Contender], records: Sequence[Record], known: Sequence[str]) -> list[Record]:
    """The recordings without outputs that none of their samples knows: they hold them no more than a file without.

    Samples between holes, also of what else must be ``known``, that are too few for a run are unknown, too.
    """
    outputs = list(_signals(contenders))
    return [_in_parts(without_unknown(r, outputs), [s.name for s in outputs], known) for r in records]


def _in_parts(record: Record, outputs: Sequence[str], known: Sequence[str]) -> Record:
    """The recording with its outputs known in those parts alone that are run through."""
    inside = np.isin(record.time, np.concatenate([part.time for part in unbroken(record, known)]))
    lost = {n: np.where(inside, record[n], np.nan) for n in outputs if n in record.signals}
    return record if inside.all() else record.with_signals(lost)


def _inaccurate(jobs: Sequence[Job], done: Sequence[Done]) -> tuple[Inaccurate, ...]:
    told = InaccurateWarning.__name__
    rows = [(job, text) for job, one in zip(jobs, done, strict=True) for kind, text in one.warned if kind == told]
    return tuple(Inaccurate(job.carried.contender.name, job.record.name, text) for job, text in rows)


def _drawn(curves: int | None, each: int, count: int) -> int:
    """Recordings of which the curves stay, with ``each`` curves of one."""
    return count if curves is None else max(1, curves // max(1, each))


def _jobs(contenders, records: Sequence[tuple[Record, Mapping]], plan: Plan, first: tuple[int, int]) -> list[Job]:
    """Every model on every recording with its noise; first : timed runs, and recordings of which the curves stay."""
    carried = [Carried(c) for c in contenders]
    repeats, drawn = first
    return [
        Job(one, record, plan, noise, repeats if k < TIMED else None, k < drawn)
        for one in carried
        for k, (record, noise) in enumerate(records)
    ]


def _answers(jobs: Sequence[Job], pool: Executor, memory: Memory | None, on_done: Callable[[Job], None]) -> list[Done]:
    """The answers in the order of the jobs. What cannot travel runs here, and is not kept."""
    able = [travels(job.carried.contender) for job in jobs]
    found: dict[int, Done] = {}
    for which, where, kept in ((True, pool, memory), (False, Here(), None)):
        some = [k for k, can in enumerate(able) if can is which]

        def told(position: int, _, some=some) -> None:
            on_done(jobs[some[position]])

        found |= dict(zip(some, recalled(kept, where, run_job, [jobs[k] for k in some], told, KEPT), strict=True))
    return [found[k] for k in range(len(jobs))]


def _counting(progress: Callable[[int, int, str], None] | None, jobs: Sequence[Job]) -> Callable[[Job], None]:
    """What is called with every job that is done."""
    if progress is None:
        return lambda job: None
    total, done = sum(len(job.plan.modes) for job in jobs), 0
    progress(0, total, "")

    def told(job: Job) -> None:
        nonlocal done
        done += len(job.plan.modes)
        progress(done, total, f"{job.carried.contender.name}, {job.record.name}")

    return told


def _by_mode(modes: Sequence[str], rows: Sequence) -> list:
    return sorted(rows, key=lambda row: modes.index(row.mode))


def _trajectory(job: Job, run: Run) -> Trajectory:
    prediction = Record(job.record.time, run.signals, run.units, run.name)
    return Trajectory(job.carried.contender.name, job.record.name, run.mode, prediction, run.deviation)


def _timings(made: Sequence[tuple[Job, Run]]) -> tuple[Timing, ...]:
    """By model and mode; where the recordings that were to be timed failed, by the others."""
    groups: dict[tuple[str, str], dict[bool, list[float]]] = {}
    for job, run in made:
        timed = groups.setdefault((job.carried.contender.name, run.mode), {True: [], False: []})
        parts = unbroken(job.record, job.plan.known)  # nothing is run through holes
        duration = max(sum(part.duration for part in parts), np.finfo(float).tiny)
        timed[job.repeats is not None] += [s / duration for s in run.seconds]
    return tuple(_timing(key, values[True] or values[False]) for key, values in groups.items())


def _timing(key: tuple[str, str], values: list[float]) -> Timing:
    return Timing(*key, float(np.median(values)), float(min(values)), float(max(values)), len(values))


def _settled(contenders: Sequence[Contender], records: Sequence[Record], wanted: Mapping[str, str]) -> list[Contender]:
    """The contenders with their inputs decided for all recordings together: one rule for what they share."""
    told([s for c in contenders for s in c.inputs], wanted, "none of the models")
    contenders = [_fed(c, records) for c in contenders]
    own = [{s.name: wanted[s.name] for s in c.inputs if s.name in wanted} for c in contenders]
    return [settled(c, records, some) for c, some in zip(contenders, own, strict=True)]


def _fed(contender: Contender, records: Sequence[Record]) -> Contender:
    """An FMU whose inputs that nobody recorded keep their start values, under the name of its contender."""
    fed_by = getattr(contender, "fed_by", None)
    return contender if fed_by is None else as_contender(fed_by(records), contender.name)


def entrant(contender) -> Entrant:
    """A contender as it is listed."""
    chosen = between([s for s in contender.inputs if s.chosen_by != "model"])
    return Entrant(
        contender.name,
        contender.kind,
        tuple(contender.inputs),
        tuple(contender.outputs),
        tuple(getattr(contender, "parameters", None) or ()),
        {**(getattr(contender, "provenance", None) or {}), **({"inputs between samples": chosen} if chosen else {})},
        bands_of(contender),
    )


def _judged_here(contender: Contender, scores: Sequence[Score], why: Mapping[str, str]) -> Entrant:
    """As it is listed, with its bands held against what was measured; why : by recording, see `other_reasons`."""
    one = entrant(contender)
    held: dict[str, list[Held]] = {}
    for s in scores:
        if (s.model, s.mode) == (one.name, FREE_RUN):
            held.setdefault(s.output, []).append(Held(s.record, s.coverage, s.chance, why[s.record]))
    return dataclasses.replace(one, bands=held_here(one.bands, held))


def _require_lists(**given) -> None:
    """Raises DeclarationError for one thing where a list of them is needed, and for what is no recording."""
    for name, value in given.items():
        if isinstance(value, str | Record) or not isinstance(value, Iterable):
            raise DeclarationError(
                f"compare: {name} takes a list (got a {type(value).__name__} alone). Write {name}=[...]."
            )
    for one in given["records"]:
        if not isinstance(one, Record):
            raise DeclarationError(f"compare: {one!r} is no recording. Read it first: read_record('run.csv').")


def _check(contenders: Sequence[Contender], records: Sequence[Record], modes: Sequence[str]) -> None:
    if not contenders or not records:
        what = "contenders" if not contenders else "recordings"
        raise DataError(f"compare: nothing to compare (got 0 {what}). Give at least one model and one recording.")
    require_own_names(contenders)
    check_modes(modes)
    check_tags(records)


def check_modes(modes: Sequence[str]) -> None:
    """Raises DeclarationError for a mode that there is none of."""
    for mode in modes:
        if mode not in MODES:
            raise DeclarationError(f"compare: no mode '{mode}'. {nearest(mode, MODES)}")


def require_own_names(contenders: Sequence[Contender]) -> None:
    """Raises DeclarationError for two that are called alike: nothing could be asked of either by its name."""
    names = [c.name for c in contenders]
    for name in names:
        if names.count(name) > 1:
            raise DeclarationError(
                f"compare: two models are called '{name}'. Each needs its own name, which is its row in every table. "
                'Give one of them another name: --model NAME=MODEL, or name = "..." in a scenario.'
            )


def wanted_of(contenders, records: Sequence[Record], outputs: Sequence[str] | None) -> list[Signal]:
    """Signals to score, each once. An asked-for name that no contender gives raises."""
    given = {s.name: s for s in _signals(contenders)}
    if outputs is None:
        measured = [s for s in given.values() if any(s.name in r.signals for r in records)]
        if not measured:
            raise DataError(
                f"compare: no recording holds an output of any model (got {', '.join(records[0].signals)}). "
                f"The models give {', '.join(given)}. Rename a column, or record one of them."
            )
        return measured
    for name in outputs:
        if name not in given:
            raise DeclarationError(f"compare: no model has an output '{name}'. {nearest(name, given)}")
    return [given[name] for name in dict.fromkeys(outputs)]


def _signals(contenders) -> Iterator[Signal]:
    """Outputs of all contenders; the first to declare one sets its unit, yardsticks come last."""
    for contender in contenders:
        yield from contender.outputs
