"""invert and compensate: a characteristic turned round, as a block."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import typer

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.quantities import in_unit, wanted
from hydrotwin.records import SUFFIXES, Reading

from ..loading import load
from .accepting import STEADY, Judge, accepted, understood
from .recordings import constants_among, read_all, reads
from .shared import JsonOption, check_folder, examples, out
from .training import OutOption, SetOption, check_block, named, options_of, trained, written

AcceptOption = Annotated[
    list[str] | None,
    typer.Option(
        "--accept",
        metavar="CRITERION",
        help="'position_rate.rmse < 2 mm/s' at steady points that were left out; exit 1 where it does not hold",
    ),
]
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
    accept: AcceptOption = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Learn which command gives a wanted steady rate: the inverse of a characteristic, as a block."""
    from hydrotwin.learned import characteristic, judged_inverse, learn_inverse

    check_block(output, *source[:1])
    if report:
        check_folder(report)
    settings, reading = constants_among(settings, (command, answer), reading)
    options = options_of("invert", learn_inverse, settings, {"method": method}, characteristic)
    machine = _Machine(_source(source, reading), command, answer, options)
    asked = _criteria(accept, machine, "invert")
    block = trained(
        "invert", judged_inverse, (*machine.named, ), as_json, forward=machine.forward, **options, **named(name),
        seed=seed,
    )  # fmt: skip
    written(block, output, as_json)
    if report:
        _report_curves(report, machine, as_json, inverse=block)
    if not accepted(asked, block, as_json):
        raise typer.Exit(1)


def compensate(
    source: Annotated[list[str], typer.Argument(metavar="MODEL|REC...", help="a model, a block, or recordings")],
    output: OutOption,
    command: Annotated[str, typer.Option("--input", metavar="NAME", help="what is commanded")],
    answer: Annotated[str, typer.Option("--output", metavar="NAME", help="what moves at a rate, or settles")],
    waypoints: Annotated[
        list[str],
        typer.Option("--waypoint", metavar="COMMAND=RATE", help="a point of the desired curve, SI or with units"),
    ],
    degree: Annotated[int | None, typer.Option(min=1, help="of the polynomial; by default through all points")] = None,
    name: Annotated[str | None, typer.Option(help="name of the block")] = None,
    settings: SetOption = None,
    accept: AcceptOption = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Learn what to command instead, so that the machine follows a desired curve through waypoints."""
    from hydrotwin.learned import characteristic, judged_compensator, learn_compensator, learn_inverse
    from hydrotwin.learned.inverse.compensator import desired_curve

    check_block(output, *source[:1])
    if report:
        check_folder(report)
    settings, reading = constants_among(settings, (command, answer), reading)
    options = options_of("compensate", learn_inverse, settings, {"degree": degree}, characteristic, learn_compensator)
    machine = _Machine(_source(source, reading), command, answer, options)
    points = [_waypoint(text, machine.forward) for text in waypoints]
    asked = _criteria(accept, machine, "compensate")
    block = judged_compensator(*machine.named, points, forward=machine.forward, **options, **named(name))
    written(block, output, as_json)
    if report:
        _report_curves(report, machine, as_json, compensator=block, desired=desired_curve(points, degree))
    if not accepted(asked, block, as_json):
        raise typer.Exit(1)


@dataclass(frozen=True)
class _Machine:
    """A model, a block or recordings, what is commanded and what answers, and the options of all that is learnt."""

    source: object
    command: str
    answer: str
    options: Mapping

    @property
    def named(self) -> tuple:
        return self.source, self.command, self.answer

    @cached_property
    def forward(self):
        """Its characteristic."""
        from hydrotwin.learned import characteristic

        own = {k: v for k, v in self.options.items() if k in inspect.signature(characteristic).parameters}
        return characteristic(*self.named, **own)


def _criteria(texts: Sequence[str] | None, machine: _Machine, verb: str) -> list:
    """The criteria understood before the learning."""
    from hydrotwin.learned.inverse.judging import YARDSTICKS, judged_signal

    return understood(texts, [judged_signal(machine.forward.rate)], Judge(verb, YARDSTICKS[verb], STEADY))


def _report_curves(folder: Path, machine: _Machine, silent: bool, **learnt) -> None:
    """The page of the characteristic that was turned round."""
    from hydrotwin.report.characteristic import write_characteristic

    files = write_characteristic(machine.forward, folder, machine=machine.source, **learnt)
    if not silent:
        out.print(f"written: {files['html']}")


def _waypoint(text: str, forward) -> tuple[float, float]:
    """A command and the rate that shall come of it, in SI."""
    parts = text.split("=")
    if len(parts) != 2:
        raise DeclarationError(
            f"compensate: a waypoint is COMMAND=RATE (got '{text}'). Write --waypoint 0.5=0.05, or 50%=50mm/s."
        )
    forms = (f"--waypoint {{}}={parts[1].strip()}", f"--waypoint {parts[0].strip()}={{}}")
    command, rate = (wanted(signal, "compensate") for signal in (forward.input, forward.rate))
    return in_unit(parts[0], command, forms[0]), in_unit(parts[1], rate, forms[1])


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
