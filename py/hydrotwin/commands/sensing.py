"""sensitivity: which parameters drive which output where, how far each can be told, what to measure next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydrotwin.models.language.quantities import wanted
from hydrotwin.records import Reading

from .recordings import check_set, read_all, reads, tell_columns
from .shared import (
    InterpolationOption,
    JsonOption,
    ModelArgument,
    RecordsArgument,
    bounds_from,
    check_file,
    check_folder,
    examples,
    interpolation_from,
    mark,
    out,
    print_json,
    progress_bar,
    settings_from,
    table,
    tell_between,
)
from .showing import physical

NEXT = 5  # measurements on the screen


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command(
        epilog=examples(
            "hydrotwin sensitivity model.toml train_*.csv --report sensitivity",
            "hydrotwin sensitivity cehA train_1.csv --parameters 'cylinder.*' --intervals 20% --profile 'cylinder.*'",
        )
    )(reads(sensitivity))


def sensitivity(
    model: ModelArgument,
    records: RecordsArgument,
    parameters: Annotated[
        list[str] | None, typer.Option("--parameters", metavar="GLOB", help="asked about; by default the free ones")
    ] = None,
    over: Annotated[
        str,
        typer.Option(
            "--intervals", metavar="HOW", help="fit (95 % of its identification), bounds, 10%; auto: fit, else 10%"
        ),
    ] = "auto",
    given: Annotated[
        list[str] | None,
        typer.Option("--interval", metavar="PATH=LOW:HIGH", help="of one parameter, SI or with its unit: 50:200kg"),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            "--noise",
            metavar="OUTPUT=NUMBER",
            help="of a sensor, SI or with its unit; also of one that is not there yet",
        ),
    ] = None,
    samples: Annotated[
        int, typer.Option(min=0, help="base points of the Sobol indices, a power of two; 0: only local")
    ] = 512,
    of: Annotated[
        str, typer.Option("--of", metavar="WHAT", help="indices of the course of outputs, or of their deviation (rms)")
    ] = "course",
    stretches: Annotated[int, typer.Option(help="equal parts of each recording that are told by themselves")] = 6,
    goal: Annotated[
        list[str] | None,
        typer.Option("--for", metavar="NAME", help="parameter or output that the next measurement should tell"),
    ] = None,
    profile_of: Annotated[
        list[str] | None,
        typer.Option("--profile", metavar="GLOB", help="identify first, then profile the likelihood of these"),
    ] = None,
    seed: Annotated[int, typer.Option(help="the same seed gives the same indices")] = 0,
    report: Annotated[Path | None, typer.Option("--report", metavar="DIR", help="write a page; or a FILE.html")] = None,
    interpolation: InterpolationOption = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Tell which parameters drive which output where, what cannot be told apart, and what to measure next.

    Local by exact derivatives, over intervals by Sobol indices. With --profile the parameters are identified first, and
    the likelihood of each is followed outward until the recordings contradict it.
    """
    from hydrotwin.identification import identify, profile, sensitivity
    from hydrotwin.identification.influence.intervals import intervals
    from hydrotwin.identification.influence.profile import profiled
    from hydrotwin.identification.influence.sobol import Sampling

    if report:
        check_file(report, ".html") if report.suffix else check_folder(report)
    thing = physical(model, "sensitivity")
    check_set(reading, thing.flat)
    limits = bounds_from(given, [wanted(p) for p in thing.flat.parameters], "--interval")
    between = interpolation_from(interpolation)
    errors = settings_from(noise, "--noise", [wanted(s, difference=True) for s in thing.flat.outputs])
    asked = intervals(thing.flat, parameters, over if over != "fit" or not profile_of else "auto", limits)
    Sampling(samples, of)  # what is misspelt is told before anything runs
    profiled(thing.flat, [i.name for i in asked], profile_of)
    read = read_all(records, reading, [s.name for s in thing.flat.outputs])
    tell_columns(read, (*thing.flat.inputs, *thing.flat.outputs), thing.name, between)
    with progress_bar() as bar:
        row = bar.add_task("sensitivity", total=None)

        def told(stage: str, done: int, total: int) -> None:
            bar.update(row, completed=done, total=total or None, description=f"sensitivity {thing.name}: {stage}")

        fit = profiles = None
        if profile_of:
            told("identify", 0, 0)
            fit = identify(thing, read, free=[i.name for i in asked], noise=errors, interpolation=between)
            profiles = profile(fit, read, parameters=profile_of, progress=told)
        found = sensitivity(
            fit or thing, read, parameters=[i.name for i in asked], over=over, given=limits, noise=errors,
            samples=samples, of=of, stretches=stretches, seed=seed, goal=goal or (), interpolation=between,
            progress=None if as_json else told,
        )  # fmt: skip
    paths = _written(found, profiles, report)
    if as_json:
        print_json(found.as_data() | ({"profiles": profiles.as_data()} if profiles else {}))
        return
    tell_between((fit.flat if fit else thing.flat).inputs)
    print_sensitivity(found)
    if profiles:
        print_profiles(profiles)
    if paths:
        out.print(f"written: {', '.join(str(p) for p in paths.values())}")


def _written(found, profiles, report: Path | None) -> dict[str, Path]:
    """The page, where one is asked for."""
    if report is None:
        return {}
    from hydrotwin.report.sensitivity import STEM, write_sensitivity

    folder, stem = (report.parent, report.stem) if report.suffix else (report, STEM)
    return write_sensitivity(found, folder, profiles=profiles, stem=stem)


def print_sensitivity(found) -> None:
    """Shares, findings and what to measure next, for a reader."""
    what = "total Sobol indices" if found.sobol else "shares of the local squares"
    rows = [
        [p.name, f"{p.low:.5g} ... {p.high:.5g} {p.unit}", p.source, *(_percent(s) for s in found.shares[:, k])]
        for k, p in enumerate(found.parameters)
    ]
    head = ["parameter", "interval", "from", *(s.name for s in found.outputs)]
    table(f"{found.name}: {what}, % of the variance of each output", head, rows)
    out.print()
    for sentence in found.sentences():
        out.print(sentence)
    for finding in found.findings:
        mark(out, "note", str(finding))
    for one in found.measurements[:NEXT]:
        mark(out, "next", one.sentence, "cyan")
    sets = f"{found.sobol.sets} parameter sets, {found.sobol.diverged} diverged, " if found.sobol else ""
    many = "s" * (len(found.records) > 1)
    out.print(f"{sets}{len(found.records)} recording{many}, {found.seconds:.1f} s.")


def _percent(share: float) -> str:
    return f"{100 * share:.1f}" if share == share else "-"


def print_profiles(profiles) -> None:
    """Both intervals of each parameter."""
    out.print()
    rows = [
        [p.name, float(p.value), float(p.low), float(p.high), *(p.quadratic or ("none", "none")), p.unit]
        for p in profiles.profiles
    ]
    head = ["parameter", "value", "from", "to", "quadratic from", "to", "unit"]
    table(f"profile likelihoods, 95 % ({profiles.fits} fits, {profiles.seconds:.1f} s)", head, rows)
    for sentence in profiles.sentences():
        out.print(sentence)
