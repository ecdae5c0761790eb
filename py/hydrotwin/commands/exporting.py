"""export and check: FMUs."""

from __future__ import annotations

import inspect
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.records import Reading, all_unbroken, cuts, require

from ..loading import load
from .recording_evidence import known_of, tell_evidence
from .recordings import read_all, reads
from .shared import (
    InterpolationOption,
    JsonOption,
    ModelArgument,
    StepOption,
    check_file,
    err,
    examples,
    interpolation_from,
    mark,
    out,
    print_json,
    table,
)

STARTS = ("positions", "measured")


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command(
        epilog=examples(
            "hydrotwin export model.toml --out cehA.fmu",
            "hydrotwin export cehA --fmi 3 --kind both --out cehA.fmu",
            "hydrotwin export cehA --method implicit --step 0.001 --out real_time.fmu",
            "hydrotwin export model.toml --experiment validate_1.csv --out cehA.fmu",
        )
    )(reads(export))
    app.command(
        epilog=examples("hydrotwin check cehA.fmu --replay", "hydrotwin check cehA.fmu --reference simulated.csv")
    )(reads(check))


def export(
    model: ModelArgument,
    output: Annotated[Path, typer.Option("--out", metavar="X.fmu", help="the FMU to write")],
    fmi: Annotated[int, typer.Option(help="version of the FMI standard: 2 or 3")] = 2,
    kind: Annotated[str, typer.Option(help="cs (Co-Simulation), me (Model Exchange) or both")] = "cs",
    start: Annotated[
        str,
        typer.Option(help="start values to set: positions (the rest in equilibrium), or measured (as simulate starts)"),
    ] = "positions",
    platform: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="linux64, win64, darwin64 ... or all; may be repeated; this machine by default"
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            help="solver inside: explicit or implicit (for stiff models), each of fixed cost for hard real time, or "
            "adaptive; auto is as accurate as simulate: explicit with steps cut around contacts, or adaptive"
        ),
    ] = "auto",
    step: StepOption = None,
    experiment: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="REC", help="recording to carry along as an experiment: its inputs, starts and what the model gives"
        ),
    ] = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Write a model or a learned block as an FMU that runs without Python.

    It carries along a short run of our own, what its model file says of where it was fitted and judged, and recordings
    only with --experiment; 'hydrotwin check --replay' runs them again.
    """
    from hydrotwin.export import export_fmu

    check_file(output, ".fmu")
    thing = load(model)
    if not hasattr(thing, "flat") and not hasattr(thing, "step"):
        raise DeclarationError(f"export: '{model}' is an FMU already. Give a physical model or a learned block.")
    if getattr(getattr(thing, "flat", None), "black_box", False):
        raise DeclarationError(
            f"export: '{model}' is an FMU with effects around it, and an FMU has no equations to write. Connect it to "
            "the class that 'hydrotwin modelica' writes for what stands around it."
        )
    export_fmu(
        thing,
        output,
        fmi=fmi,
        kind=kind,
        given=given_starts(thing, start),
        method=method,
        step=step,
        platforms=platform or None,
        reference=_reference(thing, kind, method, step),
        equations=equations_told(thing),
        experiments=_experiments(thing, read_all(experiment, reading), method, step),
        credibility=credibility_told(thing, model),
    )
    size = output.stat().st_size
    if as_json:
        print_json({"fmu": str(output), "bytes": size})
    else:
        out.print(f"written: {output} ({size / 1000:.0f} kB)")


def credibility_told(thing, model: str):
    """What vouches for it: the record of its model file, or of a learned block what it was trained on and its card.

    None of an FMU, which has its own inside.
    """
    if hasattr(thing, "flat"):
        return known_of(model)
    if not hasattr(thing, "step"):
        return None
    from hydrotwin.learned.evidence import credibility_of_block

    return credibility_of_block(thing)


def given_starts(thing, start: str) -> list[str] | None:
    """The states whose start a master may set: ``positions`` alone, or every one that a recording can measure."""
    if start not in STARTS:
        raise DeclarationError(f"export: no start '{start}'. {nearest(start, STARTS)}")
    if start == "positions" or not hasattr(thing, "flat"):
        return None  # what export_fmu does by itself; a block starts from its measured outputs in any case
    return [s.name for s in thing.flat.states if s.measured_by]


def equations_told(thing) -> str:
    """The words with which the code of a learned block's kind explains its recursion; "" for anything else."""
    name = getattr(thing, "kind", "")
    if not name:
        return ""
    from hydrotwin.learned.block_file import learned_kinds

    kind = {kind.name: kind for kind in learned_kinds()}.get(name)
    return (inspect.getdoc(inspect.getmodule(kind.functions)) or "") if kind else ""


def _reference(thing, kind: str, method: str, step: float | None):
    """The run to carry along, by the FMU's own method and step; finer where the importer's solver will compute it."""
    from hydrotwin.export import reference_run
    from hydrotwin.export.method import check_method

    if not hasattr(thing, "flat"):
        return reference_run(thing)
    check_method(thing.flat.name, method, step)
    if kind == "me":
        return reference_run(thing, fine=True)
    return reference_run(thing, step=step, method=method)


def _experiments(thing, records, method: str, step: float | None) -> list:
    """Recordings as experiments of the FMU, one with holes part by part, by its own method and step."""
    from hydrotwin.export import reference_experiment

    own = {} if not hasattr(thing, "flat") else {"method": method, "step": step}
    inputs = getattr(thing, "flat", thing).inputs
    for record in records:
        require(record, inputs, f"export: {record.name}")
    records = all_unbroken(records, [s.name for s in inputs])
    for sentence in cuts(records):
        mark(err, "note", sentence)
    return [reference_experiment(thing, record, **own) for record in records]


def check(
    fmu: Annotated[
        Path,
        typer.Argument(
            metavar="X.fmu",
            help="the FMU to check, anybody's; or a model file, to tell its record (file.py:factory@model.toml to run "
            "your own code again)",
        ),
    ],
    reference: Annotated[Path | None, typer.Option(metavar="REC", help="recording its outputs must meet")] = None,
    interpolation: InterpolationOption = None,
    replay: Annotated[
        bool, typer.Option("--replay", help="run the experiments that it carries along again, and judge its record")
    ] = False,
    recordings: Annotated[
        list[Path] | None,
        typer.Option(metavar="FOLDER", help="where --replay finds the recordings of a model file, by their SHA-256"),
    ] = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Judge an FMU by the standard, try it in a child process, compare its outputs; exit 1 when a rule is broken.

    Of a model file: where it was fitted and judged; exit 1 when that is of other values, or a criterion did not hold.
    With --replay its comparisons are made again; exit 1 where a number is another, or nothing could be tried.
    """
    from hydrotwin.export import check_fmu, read_fmu

    if fmu.suffix == ".toml":
        if reference or interpolation:
            raise DeclarationError(f"check: {fmu} is a model file, whose record is told. Leave the other options out.")
        if not tell_evidence(str(fmu), as_json, again=tuple(recordings or ()) if replay else None):
            sys.exit(1)
        return
    if recordings:
        raise DeclarationError("check: --recordings is of a model file. An FMU carries its experiments along.")
    if reading and reading.constants:  # constants of the recording, for inputs that it lacks
        inputs = [s.name for s in read_fmu(fmu).inputs]
        if lost := next((n for n in reading.constants if n not in inputs), None):
            raise DeclarationError(
                f"check: --set {lost} is no input of {fmu}, which runs at its own values here. {nearest(lost, inputs)}"
            )
    record = read_all([reference], reading)[0] if reference else None
    answer = check_fmu(fmu, reference=record, interpolation=interpolation_from(interpolation), replay=replay)
    if as_json:
        rows = [{"name": r.name, "verdict": r.verdict, "detail": r.detail, "rule": r.rule} for r in answer.rows]
        replays = [{**asdict(r), "margin": r.margin, "passed": r.passed} for r in answer.replays]
        print_json({"fmu": str(fmu), "passed": answer.passed, "rows": rows, "replays": replays})
    else:
        table(str(fmu), ["", "check", "detail"], [list(row) for row in answer.told])
        if answer.replays:
            heads = ["", "experiment", "output", "largest difference / range", "allowed", "margin"]
            out.print()
            table("run again", heads, [_replay_row(r) for r in answer.replays])
        out.print(answer.summary)
    if not answer.passed:
        sys.exit(1)


def _replay_row(one) -> list:
    word = "PASS" if one.passed else "FAIL"
    return [word, one.experiment, one.output, float(one.difference), float(one.allowed), f"{100 * one.margin:.3g} %"]
