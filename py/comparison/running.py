"""A scenario run: its recordings read, its models made contenders, all compared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import Reading, Record, distinct, read_record, require_once
from hydrotwin.records.reading import check_constants
from hydrotwin.work.executor import Here, cores_of, executor_for, mapped
from hydrotwin.work.memory import Memory

from .asked import Asked, check_wanted
from .comparison import Comparison
from .contender import Contender, HoldLast, as_contender
from .elsewhere import input_names
from .loop import in_loop
from .rates import rate_signal
from .run import check_modes, compare, entrant, measured_in, require_own_names, wanted_of
from .scenario import ModelEntry, Scenario
from .tags import check_tags
from .variants import Variant
from .varied import Thing, concerns, run_as, varied, with_values

HOLD_LAST = "hold_last"
SET_SO = 'set it in a scenario, {{model = "...", set = {{{name} = "{value}"}}}}.'
MANY = 8  # recordings that several processes read faster than one


def run_scenario(
    scenario: Scenario,
    resolve: Callable[[str], object],
    where: Where | None = None,
    *,
    repeats: int = 3,
    progress: Callable[[int, int, str], None] | None = None,
) -> Comparison:
    """Read the recordings, make every model a contender and `compare`; of a scenario with variants, as it stands.

    ``resolve`` turns a model as written (name or path) into a Model, Block or Contender; the face knows how.
    where : where the runs are made; by default here.
    """
    where = where or Where(progress=progress)
    with executor_for(where.executor) as pool:
        contenders = load_contenders(scenario, resolve)
        records, train = read_all(scenario, pool, where.on_read)
        check_asked(scenario, contenders, records)
        return compare_as(scenario, contenders, records, train, replace(where, executor=pool), repeats)


@dataclass(frozen=True)
class Where:
    """Where runs are made, what keeps them, who is told; ``curves`` as in `compare`.

    on_read : called with the recordings to compare on once they are read, before anything runs.
    """

    executor: str | Executor = "here"
    memory: Memory | None = None
    progress: Callable[[int, int, str], None] | None = None
    curves: int | None = None
    on_read: Callable[[Sequence[Record]], None] | None = None


def compare_as(
    scenario: Scenario,
    contenders: Sequence[Contender],
    records: Sequence[Record],
    train: Sequence[Record],
    where: Where,
    repeats: int = 3,
) -> Comparison:
    """`compare` as a scenario says."""
    return compare(
        contenders,
        records,
        modes=scenario.modes,
        outputs=scenario.outputs,
        rates=scenario.rates,
        train_records=train,
        title=scenario.title,
        repeats=repeats,
        progress=where.progress,
        interpolation=scenario.interpolation,
        initial_states=scenario.initial_states,
        executor=where.executor,
        memory=where.memory,
        curves=where.curves,
    )


def read_all(
    scenario: Scenario, pool: Executor, on_read: Callable[[Sequence[Record]], None] | None = None
) -> tuple[list[Record], list[Record]]:
    """The recordings to compare on, with their tags, and those of the training; by all processes of this machine.

    on_read : called with the first.
    """
    paths = (*scenario.validate, *scenario.train)
    alone = cores_of(pool) == 1 or len(paths) < MANY  # workers elsewhere do not have our files
    found = list(mapped(Here() if alone else pool, _read, [(path, scenario.reading) for path in paths]))
    count = len(scenario.validate)
    require_once(found[:count])
    (named,) = distinct(found[:count])  # as criteria name them
    tagged = [scenario.tags.put(r, path) for r, path in zip(named, scenario.validate, strict=True)]
    check_tags(tagged)
    if on_read:
        on_read(tagged)
    return tagged, found[count:]


def check_asked(scenario: Scenario, contenders: Sequence[Contender], records: Sequence[Record]) -> None:
    """Refuse before a long run criteria that could not be judged after it, and constants that nothing reads."""
    check_modes(scenario.modes)
    known = {s.name for c in contenders for s in (*c.inputs, *c.outputs)} | scenario.tags.read
    settable = {p.name for c in contenders for p in getattr(c, "parameters", None) or ()}
    check_constants(scenario.reading, known, settable, SET_SO)
    check_wanted(scenario.wanted, asked_of(scenario, contenders, records))


def asked_of(scenario: Scenario, contenders: Sequence[Contender], records: Sequence[Record]) -> Asked:
    """What criteria of a scenario can be about. Raises DeclarationError for two models of one name."""
    require_own_names(contenders)
    records = measured_in(contenders, records, input_names(contenders))
    outputs = wanted_of(contenders, records, scenario.outputs)
    sloped = wanted_of(contenders, records, scenario.rates) if scenario.rates else []
    entrants = tuple(entrant(c) for c in contenders)
    scored = (*outputs, *(rate_signal(s) for s in sloped))
    return Asked(entrants, scored, records, scenario.modes[0])


def things_of(scenario: Scenario, resolve: Callable[[str], object]) -> list[Thing]:
    """The models of a scenario under their names, before they are contenders; not the yardstick."""
    loaded = [(e, _with_settings(resolve(e.model), e)) for e in scenario.models if e.model != HOLD_LAST]
    return [Thing(entry.label or thing.name, thing) for entry, thing in loaded]


def load_contenders(
    scenario: Scenario, resolve: Callable[[str], object], variant: Variant | None = None
) -> list[Contender]:
    """The contenders of a scenario, in its order; the yardstick holds the outputs of all others."""
    contenders: list[Contender] = []
    for one in things_of(scenario, resolve):
        thing = one.thing if variant is None else varied(one, variant)
        own = variant if variant is not None and concerns(one, variant) else Variant()
        if scenario.loop:
            contenders.append(in_loop(thing, scenario.loop, one.name, step=own.step, method=own.method))
        else:
            contenders.append(run_as(as_contender(thing, one.name), own))
    for k, entry in enumerate(scenario.models):
        if entry.model == HOLD_LAST:
            outputs = {s.name: s for c in contenders for s in c.outputs}
            contenders.insert(k, HoldLast(tuple(outputs.values()), entry.name or "hold last sample"))
    return contenders


def _with_settings(thing, entry: ModelEntry):
    """What an entry sets. DeclarationError for a model that has nothing to set, or not that."""
    if not entry.settings:
        return thing
    if not (hasattr(thing, "with_values") or isinstance(thing, Model | FlatModel)):
        raise DeclarationError(f"{entry.model}: a learned block has no parameters to set. Drop set = {{...}}.")
    return with_values(thing, entry.settings)


def _read(job: tuple[Path, Reading]) -> Record:
    return read_record(*job)
