"""inspect: what is in recordings, and what a model can learn from them. The first command with new data."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from hydrotwin.models.language.errors import DataError, DeclarationError, HydrotwinError, SolveError
from hydrotwin.models.language.writing import write_whole
from hydrotwin.records import Reading, Record, import_text, read_record
from hydrotwin.records.inspection import Inspected, inspect_record, together
from hydrotwin.records.matching import Match, matched
from hydrotwin.records.reading import check_replaced, with_beside

from ..loading import load
from .recordings import reads
from .shared import JsonOption, RecordsArgument, check_file, check_folder, err, examples, mark, out, print_json, table


def register(app: typer.Typer) -> None:
    """Add the command of this file."""
    app.command(
        epilog=examples(
            "hydrotwin inspect run_1.txt run_2.txt",
            "hydrotwin inspect run_*.txt --model cehA --report inspection --write import.toml",
        )
    )(reads(inspect))


@dataclass(frozen=True)
class Inspection:
    """What is in the files, how they go with a model, and the ``import.toml`` that would read them for it.

    matches : of every signal of the model; excited : of its free parameters; said : what cannot be told apart, and what
    could not be tried.
    """

    files: tuple[Inspected, ...]
    failed: dict[str, str]
    remarks: tuple[str, ...]
    model: str = ""
    matches: tuple[Match, ...] = ()
    excited: tuple = ()
    said: tuple[str, ...] = ()
    toml: str = ""


def inspect(
    records: RecordsArgument,
    model: Annotated[
        str | None, typer.Option("--model", metavar="MODEL", help="the model that is to learn from them")
    ] = None,
    free: Annotated[list[str] | None, typer.Option("--free", metavar="GLOB", help="parameters to identify")] = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="DIR", help="write a page with the plots")] = None,
    write: Annotated[
        Path | None, typer.Option("--write", metavar="import.toml", help="write how the files are read")
    ] = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Say what is in recordings: columns, rates, gaps, noise, stuck sensors; and what MODEL can learn from them."""
    if report:
        check_folder(report)
    if write:
        check_replaced(check_file(write, ".toml"), records)
    thing = load(model) if model else None
    read, failed = _read(records, reading)
    if not read:
        raise DataError(next(iter(failed.values())))
    found = _inspection(read, failed, thing, *with_beside(reading or Reading(), records), free)
    if write:
        write_whole(write, found.toml)
    if report:
        from hydrotwin.report.inspection import write_inspection

        write_inspection(found, read, report)
    if as_json:
        print_json(dataclasses.asdict(found))
    else:
        _print(found)
        for path in filter(None, (write, report and report / "inspection.html")):
            out.print(f"written: {path}")
    if failed:
        raise typer.Exit(2)


def _read(paths: list[Path], reading: Reading | None) -> tuple[list[Record], dict[str, str]]:
    """The recordings that can be read, and why the others cannot."""
    read, failed = [], {}
    for path in paths:
        try:
            read.append(read_record(path, reading))
        except HydrotwinError as error:
            failed[str(path)] = str(error)
    return read, failed


def _inspection(read: list[Record], failed: dict, thing, reading: Reading, files: list[str], free) -> Inspection:
    facts = tuple(inspect_record(record) for record in read)
    found = Inspection(facts, failed, tuple(together(facts)), toml=import_text(reading, files))
    if thing is None:
        return found
    flat = getattr(thing, "flat", thing)
    matches = tuple(matched((*flat.inputs, *flat.outputs), read[0]))
    proposed = {m.signal.name: m.column for m in matches if m.column and not m.certain}
    comments = [line for m in matches if m.problem for line in (_short(m.problem, read), *_unit_to_add(m))]
    comments += [f'Proposed, below [columns]:  {name} = "{column}"' for name, column in proposed.items()]
    excited, said = _excitation(thing, flat, read, proposed, free)
    toml = import_text(reading, files, comments)
    return dataclasses.replace(found, model=flat.name, matches=matches, excited=excited, said=said, toml=toml)


def _short(sentence: str, read: list[Record]) -> str:
    """The sentence without the path of the recording that it begins with."""
    return sentence.removeprefix(f"{read[0].source}: ")


def _unit_to_add(match: Match) -> list[str]:
    """The line that states the unit of a column without one, as the model has it."""
    if "has no unit" not in match.problem:
        return []
    return [f'Where it is in the unit of the model, below [units]:  "{match.column}" = "{match.signal.unit}"']


def _excitation(thing, flat, read: list[Record], proposed: dict[str, str], free):
    """What the recordings excite of the model's free parameters; why it could not be tried."""
    from hydrotwin.identification.excitation import excitation

    if not hasattr(thing, "flat") or flat.black_box:
        return (), (f"{flat.name}: its parameters are not known here, so what could be identified was not tried.",)
    named = [_renamed(record, proposed) for record in read]
    absent = next((s.name for s in flat.inputs for r in named if s.name not in r.names), None)
    if absent:
        return (), (f"{absent} is an input of {flat.name} and was not recorded, or cannot be used: what could be "
                    f"identified was not tried. Say which column it is: --column '{absent}=NAME'.",)  # fmt: skip
    try:
        return excitation(thing, named, free)
    except (SolveError, DataError, DeclarationError) as error:
        return (), (f"what could be identified was not tried: {error}",)


def _renamed(record: Record, proposed: dict[str, str]) -> Record:
    new = {name: column for name, column in proposed.items() if column in record.names}
    units = {name: record.units[column] for name, column in new.items()}
    shown = {name: record.display_units.get(column, record.units[column]) for name, column in new.items()}
    return record.with_signals({name: record[column] for name, column in new.items()}, units, shown)


def _print(found: Inspection) -> None:
    for path, why in found.failed.items():
        mark(err, "error", why if path in why else f"{path}: {why}", "bold red")
    for one in found.files:
        rate = f"every {one.period:.4g} s ({1 / one.period:.4g} Hz)"
        out.print(f"{one.path}: {one.samples} samples in {one.duration:.4g} s, {rate}")
        if one.understood:
            out.print(f"read as {one.understood}", style="dim")
        rows = [[c.name, c.unit, c.minimum, c.maximum, c.noise, c.step, c.missing or "-"] for c in one.channels]
        table("", ["column", "unit", "minimum", "maximum", "noise (1 sigma)", "step", "missing"], rows)
        for remark in (*one.remarks, *(f"{c.name}: {r}" for c in one.channels for r in c.remarks)):
            mark(out, "note", remark)
        for why in one.refused.values():
            mark(out, "ignored", why.removeprefix(f"{one.path}: "))
        out.print()
    for remark in found.remarks:
        mark(out, "note", remark)
    if found.model:
        _print_model(found)


def _print_model(found: Inspection) -> None:
    rows = [[m.signal.name, m.signal.unit, m.column or "-", m.said] for m in found.matches]
    table(f"{found.model}: which column is what", ["signal", "unit", "column", "why"], rows)
    told = {why for one in found.files for why in one.refused.values()}
    for m in found.matches:
        if m.problem and m.problem not in told:
            mark(out, "note", m.problem)
    if found.excited:
        shown = sorted(found.excited, key=lambda e: ("well", "weakly", "not").index(e.verdict))
        rows = [[e.name, e.unit, e.value, e.said, e.verdict] for e in shown]
        table("what these recordings say of its parameters", ["parameter", "unit", "now", "1 sigma", "seen"], rows)
    for sentence in found.said:
        mark(out, "note", sentence)
    if any(m.column and not m.certain for m in found.matches):
        out.print("Proposed columns serve this preview, and no command before you say so: --column NAME=COLUMN.")
