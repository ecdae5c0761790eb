"""compare: several models on the same recordings, with a report."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from hydrotwin.models.language.errors import DeclarationError, SolveError, nearest
from hydrotwin.models.language.writing import write_whole
from hydrotwin.records import Reading, all_unbroken, require

from ..loading import load, origin
from .comparing_many import AUTO, Runs, notes, print_matrix, run, tell_between_of, write
from .exporting import credibility_told, equations_told
from .own_answer import answers
from .recording_evidence import recorded_as
from .recordings import reads, told_in
from .shared import (
    InitialStatesOption,
    InterpolationOption,
    JsonOption,
    ValidateOption,
    check_file,
    err,
    examples,
    interpolation_from,
    mark,
    out,
    table,
)


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command(
        epilog=examples(
            "hydrotwin compare scenario.toml --out report",
            "hydrotwin compare --model model.toml --model eq17 --validate validate_1.csv --out report --ssp models.ssp",
            "hydrotwin compare --model model.toml --validate validate_1.csv --accept 'arm_angle.rmse < 0.2 deg' "
            "--record model.toml",
        )
    )(answers(reads(compare)))


def compare(
    scenario: Annotated[
        Path | None, typer.Argument(metavar="[SCENARIO.toml]", help="models, recordings, modes")
    ] = None,
    output: Annotated[Path, typer.Option("--out", metavar="DIR", help="folder of the report")] = Path("comparison"),
    models: Annotated[
        list[str] | None, typer.Option("--model", metavar="MODEL", help="NAME=MODEL gives it a name")
    ] = None,
    validate: ValidateOption = None,
    train: Annotated[
        list[Path] | None, typer.Option("--train", metavar="REC", help="what the models were made from")
    ] = None,
    outputs: Annotated[list[str] | None, typer.Option("--output", metavar="NAME", help="outputs to score")] = None,
    rates: Annotated[
        list[str] | None, typer.Option("--slope", metavar="NAME", help="outputs to score the slope of as well")
    ] = None,
    modes: Annotated[list[str] | None, typer.Option("--mode", help="'free run' or 'one step'; both by default")] = None,
    title: Annotated[str | None, typer.Option(help="title of the report")] = None,
    interpolation: InterpolationOption = None,
    initial_states: InitialStatesOption = "measured",
    accept: Annotated[
        list[str] | None,
        typer.Option("--accept", metavar="CRITERION", help="'arm_angle.rmse < 0.2 deg'; exit 1 where it does not hold"),
    ] = None,
    judged: Annotated[
        str, typer.Option("--judge", metavar="MODEL", help="the model that criteria are about; by default the first")
    ] = "",
    against: Annotated[
        Path | None, typer.Option(metavar="compare.json", help="an earlier comparison: what became better and worse")
    ] = None,
    tags: Annotated[
        str, typer.Option(metavar="PATTERN", help="conditions in file names: 'load{load}_stroke{stroke}'")
    ] = "",
    tag_columns: Annotated[
        list[str] | None,
        typer.Option(
            "--tag-column", metavar="TAG=COLUMN", help="conditions in columns: 'oil=oil_temperature by 10 degC'"
        ),
    ] = None,
    junit_file: Annotated[
        Path | None, typer.Option("--junit", metavar="FILE.xml", help="also write the criteria as JUnit XML")
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(metavar="MODEL.toml", help="also write what was found into this model file, one of the models"),
    ] = None,
    ssp: Annotated[
        Path | None, typer.Option(metavar="X.ssp", help="also pack the models as FMUs, wired to the same inputs")
    ] = None,
    ssp_version: Annotated[
        str, typer.Option(metavar="1.0|2.0", help="version of SSP; 2.0 says where values come from")
    ] = "1.0",
    executor: Annotated[
        str,
        typer.Option(
            metavar="WHERE",
            help="where runs are made: processes, here, dask, dask://host:port; auto: processes where they are many",
        ),
    ] = AUTO,
    workers: Annotated[
        int | None, typer.Option(min=1, help="processes or Dask workers; by default a core each")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume/--fresh", help="take runs that an earlier call finished, or begin anew")
    ] = True,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Compare models on the same validation recordings and write report.html, report.md and compare.json."""
    from hydrotwin.comparison import MODES, Scenario, Tags, Wanted, asked_by, junit, read_scenario, record_comparison
    from hydrotwin.identification.beginning import MEASURED, check_initial_states

    if ssp is not None:
        check_file(ssp, ".ssp")
    check_ssp_version(ssp, ssp_version)
    _check_scenario(scenario)
    if (scenario is None) == (not models):
        raise DeclarationError("compare: give either a scenario file, or --model and --validate.")
    if scenario is None and not validate:
        raise DeclarationError("compare: no recording to compare on. Give --validate REC.")
    said = {"--validate": validate, "--train": train, "--output": outputs, "--slope": rates, "--mode": modes}
    said |= {
        "--interpolation": interpolation,
        "--tags": tags,
        "--tag-column": tag_columns,
        "--initial-states": initial_states != MEASURED,
    }
    doubled = [option for option, value in {**said, "--title": title}.items() if value]
    doubled += told_in(reading)
    if scenario is not None and scenario.is_file() and doubled:
        raise DeclarationError(
            f"compare: {scenario} says all, {' and '.join(doubled)} would be ignored. Write it into the file "
            f"instead; a model is given by --model {shlex.quote(str(scenario))}."
        )
    asked = Wanted(tuple(accept or ()), judged, against)
    if scenario is not None:
        described = read_scenario(scenario)
        described = replace(described, wanted=asked.over(described.wanted))
    else:
        described = Scenario(
            title=title or "Comparison of models",
            models=tuple(entry(m) for m in models),
            validate=tuple(validate),
            train=tuple(train or ()),
            modes=tuple(modes or MODES),
            outputs=tuple(outputs) if outputs else None,
            rates=tuple(rates or ()),
            reading=reading or Reading(),
            interpolation=interpolation_from(interpolation),
            initial_states=check_initial_states(initial_states, "compare"),
            tags=Tags(tags, columns=told_columns(tag_columns)),
            wanted=asked,
        )
    if junit_file is not None and not described.wanted.accept:
        raise DeclarationError("compare: --junit writes criteria, and there are none. Give --accept CRITERION.")
    if ssp is not None and described.variants:
        raise DeclarationError("compare: --ssp packs the models of a scenario without variants. Leave one of them out.")
    from hydrotwin.report import notices_of_variants
    from hydrotwin.report.written import note_written

    named = recorded_as(record, described) if record is not None else ""
    loaded, runs = Loaded(), Runs(executor, workers, resume, as_json)
    before = _state(output / "compare.json")
    matrix = run(described, loaded, output, runs)
    fmus = {spec: thing for spec, thing in loaded.items() if hasattr(thing, "constants_read")}
    read = [f"{spec}: {s}" for spec, thing in fmus.items() for s in thing.constants_read(described.reading.constants)]
    tell_between_of(matrix.base.entrants)
    for word in dict.fromkeys([*read, *notes(matrix)]):
        mark(err, "note", word)
    accepted = matrix.accepted if described.variants else matrix.runs[0].accepted
    if not any(one.comparison.scores for one in matrix.runs):
        require_inputs(matrix.base)
        if junit_file is not None:  # all missed: a server shall not read those of an earlier run
            write_whole(junit_file, junit(accepted, matrix.title, notices_of_variants(matrix.runs)))
        why = [f.sentence for f in matrix.base.failures] or [f"{u.model}: {u.reason}." for u in matrix.base.unscored]
        raise SolveError(f"compare: no model could be scored. {why[0]}")
    tell_replaced(described.wanted.earlier, output / "compare.json")
    if _state(output / "compare.json") != before:
        told = "another run has written its report there while this one ran, and this one replaces it"
        mark(err, "note", f"{output}: {told}. Give each its own --out.")
    paths = write(matrix, output, bool(described.variants))
    if junit_file is not None:
        write_whole(junit_file, junit(accepted, matrix.title, notices_of_variants(matrix.runs)))
        paths |= {"junit": junit_file}
        note_written(output, [junit_file])
    if record is not None:
        record_comparison(record, matrix.base, accepted, named, asked=asked_by(described))
        paths |= {"record": record}
    if ssp is not None:
        paths |= {"ssp": pack(described, loaded, matrix.base, ssp, ssp_version)}
    if as_json:
        typer.echo(paths["json"].read_text(encoding="utf-8"))
    else:
        if described.variants:
            print_matrix(matrix)
        else:
            print_comparison(matrix.base, accepted)
        out.print(f"written: {', '.join(str(p) for p in paths.values())}")
    if accepted and not accepted.passed:
        raise typer.Exit(1)


def _state(path: Path) -> tuple[int, ...]:
    """What is another one once a file is written anew; empty where there is none."""
    with contextlib.suppress(OSError):
        told = path.stat()
        return told.st_ino, told.st_size, told.st_mtime_ns
    return ()


def tell_replaced(earlier: Sequence[Path], written: Path) -> None:
    """A reference that every run replaces lets models become worse a little at a time, or all at once on the second."""
    if any(path.resolve() == written.resolve() for path in earlier):
        mark(
            err,
            "note",
            f"{written} was held against, and this run replaces it: the next one is held against this one, be it "
            "worse. Keep the reference elsewhere, or give another --out.",
        )


def told_columns(pairs: list[str] | None) -> dict[str, str]:
    """The ``oil=oil_temperature by 10 degC`` pairs of --tag-column."""
    parted = [pair.partition("=") for pair in pairs or []]
    for tag, _, column in parted:
        if not tag.strip() or not column.strip():
            raise DeclarationError(f"--tag-column {tag}: no 'TAG=COLUMN'. Write load=load_mass.")
    return {tag.strip(): column.strip() for tag, _, column in parted}


class Loaded(dict):
    """MODEL -> what it stands for, read once."""

    def __call__(self, spec: str):
        if spec not in self:
            self[spec] = load(spec)
        return self[spec]


def check_ssp_version(path: Path | None, version: str) -> None:
    """Refuse a version that there is none of, or one of an archive that nobody asked for."""
    from hydrotwin.export.ssp_text import VERSIONS

    if version not in VERSIONS:
        raise DeclarationError(f"compare: --ssp-version {version}: there is none. {nearest(version, VERSIONS)}")
    if path is None and version != VERSIONS[0]:
        raise DeclarationError("compare: --ssp-version is of an archive. Say where it goes: --ssp models.ssp.")


def pack(scenario, loaded: Loaded, comparison, path: Path, version: str) -> Path:
    """The models of a comparison as an SSP archive; those that cannot be in it are named."""
    from hydrotwin.comparison import load_contenders, things_of
    from hydrotwin.comparison.elsewhere import input_names
    from hydrotwin.export import SystemPart, export_ssp

    parts, things = [], {one.name: one.thing for one in things_of(scenario, loaded)}
    for row, contender in zip(scenario.models, load_contenders(scenario, loaded), strict=True):
        thing = things.get(contender.name, contender)
        if scenario.loop:
            thing = getattr(contender, "block", contender)  # the model under the controller
        known = None if row.settings or scenario.loop else credibility_told(thing, row.model)
        told = shipped_values(row.model, thing), equations_told(thing), known
        starts = {s.estimate.record: s.estimate.values for s in comparison.starts if s.model == contender.name}
        parts.append(SystemPart(contender.name, thing, *told, starts))
    records = all_unbroken(comparison.records, input_names(comparison.entrants))  # the parts, each with its own start
    archive = export_ssp(parts, path, records=records, title=comparison.title, version=version)
    for sentence in archive.left_out:
        mark(err, "note", f"{path}: {sentence}")
    return archive.path


def shipped_values(spec: str, thing) -> dict[str, float]:
    """Parameter -> value [SI] before identification, for a model with the values of a model file; else empty.

    Parameters of effects that the file adds are neutral there.
    """
    if not hasattr(thing, "additions") or origin(spec) == spec:
        return {}
    base = load(origin(spec))
    here = {a.name for a in base.additions}
    base = base.plus([a for a in thing.additions if a.name not in here])
    return {p.name: p.value for p in base.flat.parameters}


def require_inputs(comparison) -> None:
    """A recording that a model cannot take is unusable input, anything else an honest failure."""
    for record in comparison.records:
        for entrant in comparison.entrants:
            require(record, entrant.inputs, entrant.name)


def entry(text: str):
    """``NAME=MODEL`` or ``MODEL``, which then goes by how it is written, see `ModelEntry.label`."""
    from hydrotwin.comparison import ModelEntry

    name, equals, model = text.partition("=")
    return ModelEntry(model, name) if equals else ModelEntry(text)


def print_comparison(comparison, accepted=None) -> None:
    """Mean scores over the recordings in the units of the report, best first, what failed, and whether it is enough."""
    from hydrotwin.report import answer, display_units
    from hydrotwin.report.acceptance import acceptance_lines
    from hydrotwin.report.format import difference_to_shown

    units = display_units(comparison)
    for mode in comparison.modes:
        for signal in comparison.outputs:
            unit = units[signal.name]
            rows = [
                [s.model, *(float(difference_to_shown(v, s.unit, unit)) for v in (s.rmse, s.mae, s.maximum)),
                 float(s.fit_percent), unit]
                for s in sorted(comparison.means, key=lambda s: s.rmse)
                if s.mode == mode and s.output == signal.name
            ]  # fmt: skip
            if rows:
                table(f"{signal.name}, {mode}", ["model", "RMSE", "MAE (Eq. 18)", "maximum", "fit %", "unit"], rows)
                out.print()
    for failure in comparison.failures:
        mark(out, "failed", f"{failure.model} on {failure.record}, {failure.mode}: {failure.sentence}")
    for good, line in acceptance_lines(accepted, units) if accepted else ():
        out.print(line, style="green" if good else "red")
    out.print(answer(comparison, units))


def _check_scenario(scenario: Path | None) -> None:
    """What stands where a scenario file does, and is none. Raises DeclarationError with how it is given."""
    from hydrotwin.records import SUFFIXES

    if scenario is None:
        return
    given = shlex.quote(str(scenario))
    if scenario.name.lower().endswith(SUFFIXES):
        told = f"'{scenario}' is a recording, and no scenario file. A recording is given by --validate {given}."
        raise DeclarationError(f"compare: {told}")
    if not scenario.exists() and (scenario.suffix != ".toml" or "@" in str(scenario)):
        raise DeclarationError(f"compare: no scenario file '{scenario}'. A model is given by --model {given}.")
