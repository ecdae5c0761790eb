"""learn: a surrogate of any kind from recordings, judged on what was held out."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Reading, Record

from ..loading import origin
from .accepting import accepted, criteria
from .recordings import constants_among, read_all, reads, require_columns
from .shared import (
    JsonOption,
    RecordsArgument,
    ValidateOption,
    check_folder,
    duration_of,
    err,
    examples,
    mark,
    out,
)
from .showing import physical
from .training import OutOption, SetOption, check_block, named, options_of, trained, written

AUTO, HYBRID = "auto", "hybrid"
PARTS = ("model", "physics", "residual")  # files of a hybrid beside its own
KINDS = {  # the kinds of learned.learning in words, told without importing it
    "arx": "a linear difference equation by least squares; the yardstick of all others",
    "linear": "a linear state space, refined in free run",
    "nn": "a small network, selected on its free-run error",
    "gp": "a Gaussian process on delayed inputs, with its standard deviation",
    "dual_gp": "two processes: command to spool, spool to rate (needs a measured spool)",
    "piecewise": "a characteristic of straight lines",
    "grey_box": "dead time, hidden spool, play and a monotone characteristic; no spool sensor",
    "symbolic": "a formula found by genetic programming",
    "narx": "a polynomial difference equation, its terms selected by error reduction ratio",
    "hybrid": "an identified model (--model) and a network for what it lacks",
    "state_nn": "a network with hidden states, started by an encoder",
}
BUDGET = (
    "seconds on the clock, or 5min, then the best so far is taken; of nn, state_nn, symbolic, narx, hybrid; auto: of "
    "all kinds together, and of training the best again"
)
THOROUGH = "auto: train every kind to the end, those too that can no longer be as good as the best"
TRIALS = 0.7  # of the budget of auto: the rest is for training the chosen kind again on all recordings
NOT_AGAIN = "It was not trained again on all recordings: {left:.3g} s of the budget were left. Give a longer --budget."
TOLD = {AUTO: "every kind that needs no more than the recordings; the best in free run", **KINDS}


def register(app: typer.Typer) -> None:
    """Add the command of this file."""
    app.command(
        epilog=examples(
            "hydrotwin learn auto train_*.csv --input command --output arm_angle --out best.toml --report best",
            "hydrotwin learn nn train_*.csv --input command --output arm_angle --out network.toml",
            "hydrotwin learn gp train_*.csv --input current --output position --out gp.toml "
            "--accept 'position.rmse < 2 mm'",
        )
    )(reads(learn))


def learn(
    kind: Annotated[str, typer.Argument(metavar="KIND", help="; ".join(f"{k}: {v}" for k, v in TOLD.items()))],
    records: RecordsArgument,
    output: OutOption,
    inputs: Annotated[list[str] | None, typer.Option("--input", metavar="NAME", help="input columns")] = None,
    outputs: Annotated[list[str] | None, typer.Option("--output", metavar="NAME", help="output columns")] = None,
    validate: ValidateOption = None,
    select: Annotated[
        list[Path] | None, typer.Option("--select", metavar="REC...", help="recordings to choose by, not to fit to")
    ] = None,
    model: Annotated[str | None, typer.Option("--model", metavar="MODEL", help="hybrid: the identified model")] = None,
    fit: Annotated[str | None, typer.Option(help="paper: the published procedure; default: the better one")] = None,
    hidden: Annotated[int | None, typer.Option(min=0, help="nn: hidden units; 0: the best linear model")] = None,
    budget: Annotated[
        float | None, typer.Option(parser=duration_of("--budget", 0.1), metavar="TIME", help=BUDGET)
    ] = None,
    thorough: Annotated[bool, typer.Option("--thorough", help=THOROUGH)] = False,
    seed: Annotated[int, typer.Option(help="the same seed gives the same block")] = 0,
    name: Annotated[str | None, typer.Option(help="name of the block")] = None,
    accept: Annotated[
        list[str] | None,
        typer.Option(
            "--accept",
            metavar="CRITERION",
            help="'position.rmse < 2 mm' in free run on what was held out, and on --validate; else exit 1",
        ),
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="DIR", help="write a page with the plots")] = None,
    refit: Annotated[
        bool | None,
        typer.Option(
            "--refit/--no-refit",
            help="when judged, train the kind again on all recordings, and write that where it is no worse; auto does",
        ),
    ] = None,
    settings: SetOption = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Learn a surrogate from recordings: a block that simulates, compares and exports as a model does."""
    check_block(output, model, PARTS if model else ())
    if report:
        check_folder(report)
    if (kind == HYBRID) != bool(model):
        raise DeclarationError(
            f"learn {kind}: --model goes with hybrid (got {model}). Write learn hybrid --model m.toml."
        )
    flags = {"fit": fit, "hidden": hidden, "budget": budget, "thorough": thorough or None}
    settings, reading = constants_among(settings, (*(inputs or ()), *(outputs or ())), reading)
    train, options = _trainer(kind, settings, {k: v for k, v in flags.items() if v is not None})
    records, judged, chosen = (read_all(part, reading, outputs) for part in (records, validate, select))
    if model:
        signals, options["model"] = ((), outputs or ()), physical(model, "learn hybrid")
    else:
        signals = learned_signals([*records, *judged, *chosen], inputs, outputs)
    asked = criteria(accept, records, signals[1], options.get("model"), kind)
    end = time.monotonic() + budget if kind == AUTO and budget else None
    options |= {"budget": TRIALS * budget} if end else {}
    options |= named(name) | {"validate": judged, "seed": seed} | ({"select": chosen} if chosen else {})
    block = trained(f"learn {kind}", train, (records, *signals), as_json, **options)
    if report:
        _write_page(block, records, signals, options.get("model"), report, as_json)
    if kind == AUTO if refit is None else refit:
        block = _refitted(block, kind, (records, *signals), as_json, options, end)
    written(block, output, as_json, origin(model) if model else None)
    if not accepted(asked, block, as_json):
        raise typer.Exit(1)


def _trainer(kind: str, settings, flags: dict):
    """What trains this kind, called with recordings, inputs and outputs, and its options."""
    from hydrotwin.learned import learn as learn_kind
    from hydrotwin.learned import learn_best, train_network
    from hydrotwin.learned.learning import PUBLISHED, trainer

    if kind == AUTO:
        kinds = options_of(f"learn {kind}", learn_best, settings, flags)
        return learn_best, kinds
    fit = flags.get("fit")
    own = {k: v for k, v in flags.items() if k != "fit" or kind not in PUBLISHED}
    more = (train_network,) if kind == HYBRID else ()
    options = options_of(f"learn {kind}", trainer(kind, fit), settings, own, *more)

    def train(records, inputs, outputs, **options):
        return learn_kind(kind, records, inputs, outputs, **options)

    return train, options | ({"fit": fit} if fit and kind in PUBLISHED else {})


def _refitted(block, kind: str, arguments: tuple, silent: bool, options: dict, end: float | None):
    """The block's kind trained again on all recordings; the block where that is worse, interrupted, or out of time.

    end : of the budget of ``auto``, on the monotonic clock.
    """
    from hydrotwin.learned import refitted
    from hydrotwin.learned.learning import takes

    if kind == AUTO:
        row = next(row for row in block.provenance["ranking"] if row["chosen"])
        kind = row["kind"]
        if end is not None and (left := end - time.monotonic()) < row["seconds"]:
            return _noted(block, NOT_AGAIN.format(left=max(left, 0.0)))
        options = options | ({} if end is None else {"budget": end - time.monotonic()})
        options = {k: v for k, v in options.items() if takes(kind, k)}

    def train(*given, **own):
        return refitted(block, kind, *given, **own)

    try:
        return trained(f"learn {kind}, on all recordings", train, arguments, silent, **options)
    except KeyboardInterrupt:  # what was judged is not lost
        return block


def _noted(block, words: str):
    """The block with a sentence more on its card."""
    card = block.provenance.get("free_run", {})
    told = card | {"says": f"{card.get('says', '')} {words}".strip(), "refitted": False}
    return replace(block, provenance={**block.provenance, "free_run": told})


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


def _write_page(block, records, signals, model, folder: Path, silent: bool) -> None:
    """The page of a block: its free run on what was held out, beside yardsticks and the model alone."""
    from hydrotwin.learned.report_card import card_of
    from hydrotwin.report.learned import write_learned

    if not card_of(block).get("held_out"):  # the block is not lost because there is nothing to show it on
        mark(err, "note", "no page: nothing was held out of the training that the block could run on.")
        return
    files = write_learned(block, records, *signals, folder, model=model)
    if not silent:
        out.print(f"written: {files['html']}")
