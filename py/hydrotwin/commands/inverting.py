"""invert and compensate: a characteristic turned round, as a block."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import SUFFIXES, Reading

from ..loading import load
from .recordings import constants_among, read_all, reads
from .shared import JsonOption, check_file, check_folder, examples, out
from .training import OutOption, SetOption, named, options_of, trained, written

ReportOption = Annotated[Path | None, typer.Option("--report", metavar="DIR", help="write a page with the curves")]


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command(
        epilog=examples(
            "hydrotwin invert valve.toml --input current --output position --out inverse.toml",
            "hydrotwin invert ramps_*.csv --input current --output position --set delay=0.05 --out inverse.toml",
        )
    )(reads(invert))
    app.command(
        epilog=examples(
            "hydrotwin compensate valve.toml --input current --output position --waypoint 0.5=0.05 --waypoint 1=0.2 "
            "--out compensator.toml"
        )
    )(reads(compensate))


def invert(
    source: Annotated[list[str], typer.Argument(metavar="MODEL|REC...", help="a model, a block, or recordings")],
    output: OutOption,
    command: Annotated[str, typer.Option("--input", metavar="NAME", help="what is commanded")],
    answer: Annotated[str, typer.Option("--output", metavar="NAME", help="what moves at a rate, or settles")],
    method: Annotated[str, typer.Option(help="table (the best), network (the paper's), monotone")] = "table",
    seed: Annotated[int, typer.Option(help="the same seed gives the same block")] = 0,
    name: Annotated[str | None, typer.Option(help="name of the block")] = None,
    settings: SetOption = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Learn which command gives a wanted steady rate: the inverse of a characteristic, as a block."""
    from hydrotwin.learned import characteristic, learn_inverse

    check_file(output, ".toml")
    if report:
        check_folder(report)
    settings, reading = constants_among(settings, (command, answer), reading)
    options = options_of("invert", learn_inverse, settings, {"method": method}, characteristic)
    machine = _source(source, reading)
    block = trained(
        "invert", learn_inverse, (machine, command, answer), as_json, **options, **named(name), seed=seed,
    )  # fmt: skip
    written(block, output, as_json)
    if report:
        _report_curves(report, machine, command, answer, options, as_json, inverse=block)


def compensate(
    source: Annotated[list[str], typer.Argument(metavar="MODEL|REC...", help="a model, a block, or recordings")],
    output: OutOption,
    command: Annotated[str, typer.Option("--input", metavar="NAME", help="what is commanded")],
    answer: Annotated[str, typer.Option("--output", metavar="NAME", help="what moves at a rate, or settles")],
    waypoints: Annotated[
        list[str], typer.Option("--waypoint", metavar="COMMAND=RATE", help="a point of the desired curve, SI")
    ],
    degree: Annotated[int | None, typer.Option(min=1, help="of the polynomial; by default through all points")] = None,
    name: Annotated[str | None, typer.Option(help="name of the block")] = None,
    settings: SetOption = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Learn what to command instead, so that the machine follows a desired curve through waypoints."""
    from hydrotwin.learned import characteristic, learn_compensator, learn_inverse
    from hydrotwin.learned.inverse.compensator import desired_curve

    check_file(output, ".toml")
    if report:
        check_folder(report)
    settings, reading = constants_among(settings, (command, answer), reading)
    options = options_of("compensate", learn_inverse, settings, {"degree": degree}, characteristic, learn_compensator)
    points = [_waypoint(text) for text in waypoints]
    machine = _source(source, reading)
    block = learn_compensator(machine, command, answer, points, **options, **named(name))
    written(block, output, as_json)
    if report:
        curve = desired_curve(points, degree)
        _report_curves(report, machine, command, answer, options, as_json, compensator=block, desired=curve)


def _report_curves(folder: Path, machine, command: str, answer: str, options: dict, silent: bool, **learnt) -> None:
    """The page of the characteristic that was turned round."""
    from hydrotwin.learned import characteristic
    from hydrotwin.report.characteristic import write_characteristic

    own = {k: v for k, v in options.items() if k in inspect.signature(characteristic).parameters}
    files = write_characteristic(characteristic(machine, command, answer, **own), folder, machine=machine, **learnt)
    if not silent:
        out.print(f"written: {files['html']}")


def _waypoint(text: str) -> tuple[float, float]:
    command, _, rate = text.partition("=")
    try:
        return float(command), float(rate)
    except ValueError:
        raise DeclarationError(
            f"compensate: a waypoint is COMMAND=RATE in SI units (got '{text}'). Write --waypoint 0.5=0.05."
        ) from None


def _source(source: Sequence[str], reading):
    """A model or block, or recordings."""
    if all(text.lower().endswith(SUFFIXES) for text in source):
        return read_all([Path(text) for text in source], reading)
    if len(source) > 1:
        raise DataError(
            f"invert: give one model, or recordings ({', '.join(SUFFIXES)}) (got {', '.join(source)}). Leave out the "
            "others."
        )
    return load(source[0])
