"""effects and gap: what a model may be missing, and what it is missing."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Collection
from pathlib import Path
from typing import Annotated

import typer

from hydrotwin.models.language.errors import DeclarationError, HydrotwinError, nearest
from hydrotwin.records import Reading, Record, require

from ..loading import is_fmu, origin, surroundable
from .listing import catalogue_rows, fitting_rows, print_catalogue, print_fitting
from .recordings import check_set, read_all, reads, tell_columns
from .shared import (
    InterpolationOption,
    JsonOption,
    ModelArgument,
    RecordsArgument,
    ValidateOption,
    check_folder,
    duration_of,
    err,
    examples,
    interpolation_from,
    mark,
    out,
    print_json,
    progress_bar,
    table,
    tell_between,
)
from .showing import physical
from .writing import BestSoFar, Made, write_discovery, write_failure

KEPT = ".unfinished"  # folder of finished fits, there while a gap is being worked on
TOLD = 4  # findings on the screen
GAP_COLUMNS = (("RMSE", "noise", "unit"), ("before", "after", "noise", "unit", "gap closed"))  # without, with a name


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command(epilog=examples("hydrotwin effects", "hydrotwin effects cehA"))(effects)
    app.command(epilog=examples("hydrotwin gap model.toml train_*.csv --validate validate_*.csv --out gap"))(reads(gap))


def effects(
    model: Annotated[
        str | None, typer.Argument(metavar="MODEL", help="a physical model; without one, the whole catalogue")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the catalogue of effects, or what of it fits where in MODEL."""
    if model is None:
        rows, show = catalogue_rows(), print_catalogue
    else:
        thing = surroundable(model) if is_fmu(model) else physical(model, "effects")
        rows = fitting_rows(thing)
        if thing.flat.black_box:  # its parameters are freed by name
            rows = [row for row in rows if row["site"] in thing.sites]

        def show(rows: list[dict]) -> None:
            print_fitting(thing.name, rows)

    (print_json if as_json else show)(rows)


def gap(
    model: ModelArgument,
    records: RecordsArgument,
    output: Annotated[Path, typer.Option("--out", metavar="DIR", help="where everything is written")],
    validate: ValidateOption = None,
    free: Annotated[list[str] | None, typer.Option("--free", metavar="GLOB", help="parameters to identify")] = None,
    wanted: Annotated[
        list[str] | None, typer.Option("--effects", metavar="GLOB", help="effects to try: 'sensor_*', '* at command'")
    ] = None,
    exclude: Annotated[list[str] | None, typer.Option("--exclude", metavar="GLOB", help="effects not to try")] = None,
    initial_states: Annotated[
        str, typer.Option(help="auto; free: start states are estimated, for a load or a level nobody measured; fixed")
    ] = "auto",
    max_effects: Annotated[int, typer.Option(min=1, help="most effects to add together")] = 3,
    effort: Annotated[
        str, typer.Option(metavar="HOW", help="quick, normal or thorough: how many combinations are fitted, how long")
    ] = "normal",
    time_limit: Annotated[
        float | None,
        typer.Option(
            parser=duration_of("--time-limit"),
            metavar="TIME",
            help="90s, 5min, 1h30min: then the best so far is the answer",
        ),
    ] = None,
    executor: Annotated[
        str, typer.Option(metavar="WHERE", help="where the fits run: processes, here or dask://host:port")
    ] = "processes",
    resume: Annotated[
        bool, typer.Option("--resume/--fresh", help="go on where an interrupted run stopped, or begin anew")
    ] = True,
    interpolation: InterpolationOption = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Find out which physical effect a model lacks, add it, and show what it closes.

    Every effect of the catalogue is looked at, at every place it fits. Those that promise most are fitted, alone and
    together. The answer is one of four: none, this one, one of these with the experiment that tells them apart, or
    unknown.
    """
    from hydrotwin.discovery.discover import discover
    from hydrotwin.models.effects import check_patterns
    from hydrotwin.work.executor import executor_for
    from hydrotwin.work.memory import Memory

    began = time.perf_counter()
    check_folder(output)
    check_effort(effort)
    thing = surroundable(model) if is_fmu(model) else physical(model, "gap")
    check_patterns((*(wanted or ()), *(exclude or ())))  # a misspelt effect is told before anything runs
    check_set(reading, thing.flat)
    measured = [s.name for s in thing.flat.outputs]
    train, judged = (read_all(part, reading, measured) for part in (records, validate))
    check_recordings(thing, train, judged, interpolation_from(interpolation))
    memory = Memory(output / KEPT)
    if not resume:
        memory.remove()
    elif len(memory):
        err.print(f"going on: {len(memory)} fits of an interrupted run are kept (--fresh begins anew)", style="dim")

    def write(found, so_far: bool = False) -> None:
        named = origin_from(thing, model, output)
        write_discovery(found, named, output, Made.of(found, train, judged), so_far)

    best = BestSoFar(output, write, silent=as_json)
    with executor_for(executor) as pool, telling(thing.name, as_json) as told:
        try:
            found = discover(
                thing, train, validate=judged, free=free, effects=wanted, exclude=exclude or (),
                max_effects=max_effects, initial_states=initial_states, executor=pool, progress=told, memory=memory,
                interpolation=interpolation_from(interpolation), effort=effort, time_limit=time_limit, so_far=best,
            )  # fmt: skip
        except HydrotwinError as error:
            seconds = time.perf_counter() - began + memory.earlier
            if kept := write_failure(thing.name, str(error), output, seconds):
                err.print(kept, style="dim")
            raise
        except KeyboardInterrupt:
            kept = f"stopped; finished fits kept: {len(memory)}. The same command goes on from there. {best.left}"
            err.print(kept.strip(), style="dim")
            raise
    write(found)
    memory.remove()
    if as_json:
        from hydrotwin.report.gap_data import gap_data

        print_json(gap_data(found))
        return
    print_discovery(found, output)
    if ".py:" in model and found.steps:
        out.print(f"Use it with its code: {origin(model)}@{output / 'model.toml'}")


def check_effort(effort: str) -> None:
    """Refuse an effort that does not exist."""
    from hydrotwin.discovery.structures.jobs import EFFORTS

    if effort not in EFFORTS:
        raise DeclarationError(f"--effort {effort}: no such effort. {nearest(effort, list(EFFORTS))}")


def origin_from(thing, spec: str, folder: Path) -> str:
    """What the model file in ``folder`` calls its model; an FMU by its way from there."""
    if not thing.flat.black_box:
        return origin(spec)
    file = Path(os.path.relpath(thing.fmu.path, folder.resolve())).as_posix()
    return ":".join([file, ",".join(thing.fmu.named)]) if thing.fmu.named else file


@contextlib.contextmanager
def telling(name: str, silent: bool):
    """The function that moves a bar with ``(stage, done, total, note)``; None where nothing is to be shown."""
    from hydrotwin.work.progress import described

    if silent:
        yield None
        return
    with progress_bar() as bar:
        row = bar.add_task(f"gap {name}", total=None)

        def told(stage: str, done: int, total: int, note: str = "") -> None:
            words = described(f"gap {name}", stage, done, total, note)
            bar.update(row, description=words, completed=done, total=total or None)

        yield told


def check_recordings(thing, train: list[Record], judged: list[Record], said: Collection[str] = ()) -> None:
    """Every recording has the inputs of the model, and none judges what it taught; unknown columns are told."""
    from hydrotwin.records import require_unseen

    flat = thing.flat
    for record in (*train, *judged):
        require(record, [*flat.inputs, *(s for s in flat.outputs if s.name in record)], thing.name)
    require_unseen(train, judged, [s.name for s in flat.outputs])
    tell_columns([*train, *judged], (*flat.inputs, *flat.outputs), thing.name, said)


def print_discovery(found, folder: Path) -> None:
    """The answer for a reader: verdict, what was added, what could not be told apart, the next experiment."""
    from hydrotwin.discovery.answer.going_on import experiment_sentence, untried_sentences
    from hydrotwin.discovery.answer.words import sentence

    tell_between(found.model.flat.inputs)
    out.print(f"{found.name}: {found.verdict}. {sentence(found.answer)}")
    rows = effect_rows(found)
    if rows:
        out.print()
        table("what is missing", ["effect", "where", "parameter", "value", "95 % interval", "gap closed"], rows)
    left = output_rows(found)
    if left:
        out.print()
        where = "validation recordings" if found.outputs.get("validate") else "recordings of the fit"
        table(f"RMSE on the {where}", ["output", *GAP_COLUMNS[bool(found.steps)]], left)
    for finding in found.findings[:TOLD]:
        mark(out, "note", sentence(str(finding)))
    if len(found.findings) > TOLD:
        mark(out, "note", f"{len(found.findings) - TOLD} more findings are in the report.")
    for cut_short in untried_sentences(found):
        mark(out, "note", cut_short)
    reached = getattr(found.fit_after, "accuracy", None)
    if reached and reached.reached:  # else a finding says so
        mark(out, "note", f"the runs are {reached}")
    if any(s.is_class for s in found.steps):
        mark(out, "next", experiment_sentence(found), "bold cyan")
    out.print(f"{found.seconds:.1f} s. Written: {folder / 'report.html'}, gap.json, model.toml, model.mo")


def effect_rows(found) -> list[list[str]]:
    """One row for each parameter of each named effect; the members of a class below it."""
    from hydrotwin.discovery.answer.words import percent
    from hydrotwin.report.gap_text import value_text, value_texts

    rows = []
    for step in found.steps:
        lead = [step.title or step.effect, step.site]
        for p in step.parameters:
            low, high = value_texts(p)[1:]
            value = [p.name.rpartition(".")[2], value_text(p), f"{low} ... {high}"]
            rows.append([*lead, *value, "" if not lead[0] else percent(step.gap_closed)])
            lead = ["", ""]
        if not step.parameters:
            rows.append([*lead, "", "", "", percent(step.gap_closed)])
        rows += [[f"or {e}", s, "", "", "", ""] for e, s in step.members if (e, s) != (step.effect, step.site)]
        rows += [[f"with {e}", s, "", "", "", ""] for e, s in step.together]
    return rows


def output_rows(found) -> list[list]:
    """RMSE of every output on unseen recordings in the units of the report; before and after when it changed."""
    from hydrotwin.discovery.answer.words import percent
    from hydrotwin.report.format import difference_to_shown, pretty_unit
    from hydrotwin.report.gap_words import display_units

    shown = display_units(found)
    rows = []
    for o in found.outputs.get("validate", ()) or found.outputs.get("train", ()):
        unit = shown.get(o.output, o.unit)
        before, after, noise = (
            float(difference_to_shown(v, o.unit, unit)) for v in (o.rmse_before, o.rmse_after, o.noise)
        )
        changed = [before, after, noise, pretty_unit(unit), percent(o.gap_closed)]
        rows.append([o.output, *(changed if found.steps else [after, noise, pretty_unit(unit)])])
    return rows
