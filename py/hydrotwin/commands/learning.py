"""learn, invert and compensate: blocks from recordings."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import SUFFIXES, Reading, Record

from ..loading import load, origin
from .recordings import constants_among, read_all, reads, require_columns
from .shared import (
    JsonOption,
    RecordsArgument,
    ValidateOption,
    check_file,
    check_folder,
    err,
    examples,
    mark,
    out,
    print_json,
    progress_bar,
)
from .showing import physical

KINDS = {  # the kinds of learned.learning in words, told without importing it
    "nn": "a small network, selected on its free-run error",
    "gp": "a Gaussian process on delayed inputs, with its standard deviation",
    "dual_gp": "two processes: command to spool, spool to rate (needs a measured spool)",
    "piecewise": "a characteristic of straight lines",
    "grey_box": "dead time, hidden spool, play and a monotone characteristic; no spool sensor",
    "symbolic": "a formula found by genetic programming",
    "hybrid": "an identified model (--model) and a network for what it lacks",
    "state_nn": "a network with hidden states, started by an encoder",
}
OWN = {"records", "inputs", "outputs", "validate", "progress", "name", "seed"}  # options with a flag of their own
SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="an option of the kind: lags=5, or lags=2,6")
]
ReportOption = Annotated[Path | None, typer.Option("--report", metavar="DIR", help="write a page with the curves")]
OutOption = Annotated[Path, typer.Option("--out", metavar="BLOCK.toml", help="the block file to write")]


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command(
        epilog=examples(
            "hydrotwin learn nn train_*.csv --input command --output arm_angle --out network.toml",
            "hydrotwin learn gp train_*.csv --input current --output position --out gp.toml",
        )
    )(reads(learn))
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


def learn(
    kind: Annotated[str, typer.Argument(metavar="KIND", help="; ".join(f"{k}: {v}" for k, v in KINDS.items()))],
    records: RecordsArgument,
    output: OutOption,
    inputs: Annotated[list[str] | None, typer.Option("--input", metavar="NAME", help="input columns")] = None,
    outputs: Annotated[list[str] | None, typer.Option("--output", metavar="NAME", help="output columns")] = None,
    validate: ValidateOption = None,
    model: Annotated[str | None, typer.Option("--model", metavar="MODEL", help="hybrid: the identified model")] = None,
    fit: Annotated[str | None, typer.Option(help="paper: the published procedure; default: the better one")] = None,
    hidden: Annotated[int | None, typer.Option(min=0, help="nn: hidden units; 0: the best linear model")] = None,
    budget: Annotated[float | None, typer.Option(min=0.1, help="s of training, then the best so far is taken")] = None,
    seed: Annotated[int, typer.Option(help="the same seed gives the same block")] = 0,
    name: Annotated[str | None, typer.Option(help="name of the block")] = None,
    settings: SetOption = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Learn a surrogate from recordings: a block that simulates, compares and exports as a model does."""
    from hydrotwin.learned import train_network
    from hydrotwin.learned.learning import PUBLISHED, trainer
    from hydrotwin.learned.learning import learn as learn_kind

    train = trainer(kind, fit)
    check_file(output, ".toml")
    if (kind == "hybrid") != bool(model):
        raise DeclarationError(
            f"learn {kind}: --model goes with hybrid (got {model}). Write learn hybrid --model m.toml."
        )
    flags = {"fit": None if kind in PUBLISHED else fit, "hidden": hidden, "budget": budget}
    more = (train_network,) if kind == "hybrid" else ()
    settings, reading = constants_among(settings, (*(inputs or ()), *(outputs or ())), reading)
    options = _options(f"learn {kind}", train, settings, {k: v for k, v in flags.items() if v is not None}, *more)
    records, judged = read_all(records, reading), read_all(validate, reading)
    if kind == "hybrid":
        signals, options = ((), outputs or ()), {**options, "model": physical(model, "learn hybrid")}
    else:
        signals = learned_signals([*records, *judged], inputs, outputs)
    if kind in PUBLISHED:
        options["fit"] = fit
    block = _trained(
        f"learn {kind}", learn_kind, (kind, records, *signals), as_json,
        **options, **_named(name), validate=judged, seed=seed,
    )  # fmt: skip
    _written(block, output, as_json, origin(model) if model else None)


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
    options = _options("invert", learn_inverse, settings, {"method": method}, characteristic)
    machine = _source(source, reading)
    block = _trained(
        "invert", learn_inverse, (machine, command, answer), as_json, **options, **_named(name), seed=seed,
    )  # fmt: skip
    _written(block, output, as_json)
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
    options = _options("compensate", learn_inverse, settings, {"degree": degree}, characteristic, learn_compensator)
    points = [_waypoint(text) for text in waypoints]
    machine = _source(source, reading)
    block = learn_compensator(machine, command, answer, points, **options, **_named(name))
    _written(block, output, as_json)
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


def learned_signals(records: list[Record], inputs, outputs) -> tuple[list[Signal | str], list[Signal | str]]:
    """The columns to learn from; a recording with two columns needs no naming."""
    columns = list(records[0].signals)
    if not inputs and not outputs and len(columns) == 2:
        inputs, outputs = columns[:1], columns[1:]
        err.print(f"learning {outputs[0]} from {inputs[0]}", style="dim")
    if not inputs or not outputs:
        raise DeclarationError(
            f"learn: which columns are inputs, which outputs? Give --input and --output. Known: {', '.join(columns)}."
        )
    require_columns(records, (*inputs, *outputs))
    return list(inputs), list(outputs)


def _named(name: str | None) -> dict[str, str]:
    return {"name": name} if name else {}


def _options(what: str, function: Callable, settings, flags: dict, *more: Callable) -> dict:
    """Options by name from flags and ``NAME=VALUE``, each one that ``function`` (or one of ``more``) has."""
    known: dict[str, inspect.Parameter] = {}
    for one in (function, *more):
        known |= {k: p for k, p in inspect.signature(one).parameters.items() if p.kind is p.KEYWORD_ONLY}
    found = dict(flags)
    for text in settings or ():
        key, equals, value = text.partition("=")
        if not equals:
            raise DeclarationError(f"{what}: --set takes NAME=VALUE (got '{text}'). Write --set lags=5.")
        found[key.strip()] = _value(value.strip())
    own = [k for k in known if k not in OWN]
    for key in found:
        if key not in own:
            raise DeclarationError(f"{what}: has no option '{key}'. {nearest(key, own)} It has: {', '.join(own)}.")
    return found


def _value(text: str):
    """A number, true, false, none, or a word; with commas several: ``2,6``, or ``arm_angle,`` for one."""
    if "," in text:
        return tuple(_value(part.strip()) for part in text.split(",") if part.strip())
    words = {"true": True, "false": False, "none": None}
    if text.lower() in words:
        return words[text.lower()]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


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


def _trained(what: str, trainer: Callable, arguments: tuple, silent: bool, **options):
    """The trained block, with a bar that says how good the best so far is."""
    taken = inspect.signature(trainer).parameters.values()
    if silent or not any(p.name == "progress" or p.kind is p.VAR_KEYWORD for p in taken):
        return trainer(*arguments, **options)
    with progress_bar() as bar:
        row = bar.add_task(what, total=None)

        def told(step, *more) -> None:
            best = more[0] if more else step.best
            bar.update(row, description=f"{what}: {_where(step)}best so far {best:.4g}")

        return trainer(*arguments, **options, progress=told)


def _where(step) -> str:
    """What a step of a training says about itself: its output, process, seed or generation."""
    words = [f"{k} {getattr(step, k)}" for k in ("process", "output", "seed", "generation") if hasattr(step, k)]
    return f"{', '.join(words)}, " if words else ""


def _written(block, output: Path, as_json: bool, model: str | None = None) -> None:
    """The block's files; a hybrid keeps the name of its model."""
    from hydrotwin.learned import write_block, write_hybrid
    from hydrotwin.learned.interruption import INTERRUPTED

    output.parent.mkdir(parents=True, exist_ok=True)
    files = write_hybrid(block, output, model) if model else write_block(block, output)
    if block.provenance.get("stopped") == INTERRUPTED:
        mark(err, "note", f"stopped by Ctrl-C: {output} holds the best so far.")
    run = block.provenance.get("free_run", {})
    if as_json:
        told = {key: run[key] for key in ("says", "no_better_than") if key in run}
        told |= {"block": block.name, "files": [str(f) for f in files], "period": block.period}
        print_json(told | block.provenance)
        return
    if run:
        mark(out, "careful:" if run["bad"] else "checked:", run["says"], "red" if run["bad"] else "green")
    out.print(f"{block.name}: {block.description}, period {block.period:g} s. Written: {', '.join(map(str, files))}")
