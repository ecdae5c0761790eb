"""Training on the command line: options by name, a bar that says how good the best so far is, the files of a block."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Union, get_args, get_origin, get_type_hints

import typer

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.quantities import Wanted, apart, in_unit

from .shared import check_file, err, mark, out, print_json, progress_bar

UNITS = {"period": "s", "budget": "s", "dead_time": "s", "settle": "s", "window": "s", "delay": "s", "tolerance": "1",
         "steady": "1"}  # fmt: skip
OWN = {"records", "inputs", "outputs", "validate", "select", "progress", "name", "seed"}  # with a flag of their own
FATES = {"chosen": "chosen", "cut": "cut by the budget", "failed": "failed", "dropped": "first course only",
         "as_good": "as good"}  # fmt: skip
SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="an option of the kind: lags=5, or lags=2,6")
]
OutOption = Annotated[Path, typer.Option("--out", metavar="BLOCK.toml", help="the block file to write")]


def check_block(output: Path, model: str | None = None, parts: Sequence[str] = ()) -> None:
    """Refuse before a long training a block that could not be written after it, or would replace the model it is of.

    parts : of its other files, ``<stem>_<part>.toml``.
    """
    read = [Path(model.rpartition("@")[2])] if model else []
    for place in (output, *(output.with_name(f"{output.stem}_{part}.toml") for part in parts)):
        check_file(place, ".toml", sources=read)


def named(name: str | None) -> dict[str, str]:
    return {"name": name} if name else {}


def options_of(what: str, function: Callable, settings, flags: dict, *more: Callable) -> dict:
    """Options by name from flags and ``NAME=VALUE``, each one that ``function`` (or one of ``more``) has."""
    known: dict[str, object] = {}
    for one in (function, *more):
        kinds, parameters = get_type_hints(one), inspect.signature(one).parameters
        known |= {k: kinds.get(k, object) for k, p in parameters.items() if p.kind is p.KEYWORD_ONLY}
    found = dict(flags)
    for text in settings or ():
        key, equals, value = text.partition("=")
        if not equals:
            raise DeclarationError(f"{what}: --set takes NAME=VALUE (got '{text}'). Write --set lags=5.")
        found[key.strip()] = _in_its_unit(what, key.strip(), _value(value.strip()), known)
    own = [k for k in known if k not in OWN]
    for key, value in found.items():
        if key not in own:
            told, listed = nearest(key, own), ", ".join(own)
            raise DeclarationError(
                f"{what}: has no option '{key}'. {told}" + ("" if listed in told else f" It has: {listed}.")
            )
        if not _fits(value, known[key]):
            given = ",".join(map(str, value)) if isinstance(value, tuple) else value
            raise DeclarationError(f"{what}: {key} cannot be '{given}'. It takes {_words(known[key])}.")
    return found


def _in_its_unit(what: str, key: str, value, known: dict[str, object]):
    """A value with a unit as the option takes it; whatever else it is stays. Raises UnitError."""
    takes = {known.get(key), *get_args(known.get(key))}
    if not (isinstance(value, str) and key in UNITS and float in takes and apart(value)):
        return value
    return in_unit(value, Wanted(f"{what}: {key}", UNITS[key]), f"--set {key}={{}}")


def _fits(value, kind) -> bool:
    """Whether a value is of a kind, as an annotation says it; whole numbers are numbers, too."""
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    try:
        TypeAdapter(kind, config=ConfigDict(arbitrary_types_allowed=True)).validate_python(value)
    except ValidationError:
        return False
    return True


def _words(kind) -> str:
    """A kind of value as one writes it on the command line."""
    plain = {int: "a whole number", float: "a number", bool: "true or false", str: "a word", NoneType: "none"}
    if kind in plain:
        return plain[kind]
    parts = get_args(kind)
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(_words(part) for part in parts)
    if get_origin(kind) is tuple and ... not in parts:
        return f"{len(parts)} values with commas between them"
    return "values with a comma behind each" if parts else str(kind)


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


def trained(what: str, trainer: Callable, arguments: tuple, silent: bool, **options):
    """The trained block, with a bar that says how good the best so far is."""
    taken = inspect.signature(trainer).parameters.values()
    if silent or not any(p.name == "progress" or p.kind is p.VAR_KEYWORD for p in taken):
        return trainer(*arguments, **options)
    with progress_bar() as bar:
        row = bar.add_task(what, total=None)

        def told(step, *more) -> None:
            """A trainer tells (done, total, words), (iteration or step, best so far), or a step that knows its best."""
            if len(more) == 2:
                bar.update(row, completed=step, total=more[0], description=f"{what}: {more[1]}")
                return
            best = more[0] if more else step.best
            where = f"iteration {step}, " if isinstance(step, int) else _where(step)
            bar.update(row, description=f"{what}: {where}best so far {best:.4g}")

        return trainer(*arguments, **options, progress=told)


def _where(step) -> str:
    """What a step of a training says about itself: its output, process, seed or generation."""
    words = [f"{k} {getattr(step, k)}" for k in ("process", "output", "seed", "generation") if hasattr(step, k)]
    return f"{', '.join(words)}, " if words else ""


def written(block, output: Path, as_json: bool, model: str | None = None) -> None:
    """The block's files; a hybrid keeps the name of its model."""
    from hydrotwin.learned import write_block, write_hybrid
    from hydrotwin.learned.interruption import INTERRUPTED
    from hydrotwin.learned.report_card import card_of
    from hydrotwin.learned.validation import doubtful, sentence

    output.parent.mkdir(parents=True, exist_ok=True)
    files = write_hybrid(block, output, model) if model else write_block(block, output)
    if block.provenance.get("stopped") == INTERRUPTED:
        mark(err, "note", f"stopped by Ctrl-C: {output} holds the best so far.")
    run = card_of(block)
    if as_json:
        told = {key: run[key] for key in ("says", "no_better_than") if key in run}
        told |= {"validation_says": judged} if (judged := sentence(block)) else {}
        told |= {"block": block.name, "files": [str(f) for f in files], "period": block.period}
        print_json(told | block.provenance)
        return
    said = [(bool(run["bad"]), run["says"])] if run else []
    said += [(doubtful(block), judged)] if (judged := sentence(block)) else []
    for bad, words in sorted(said, key=lambda one: not one[0]):  # bad news first, whoever tells it
        mark(out, "careful:" if bad else "checked:", words, "red" if bad else "green")
    if rows := block.provenance.get("ranking"):
        out.print(ranked(rows))
    out.print(f"{block.name}: {block.description}, period {block.period:g} s. Written: {', '.join(map(str, files))}")


def ranked(rows: Sequence[Mapping]) -> str:
    """A line with the kinds that `learn auto` tried, the best first, and what became of each."""
    names = list(dict.fromkeys(name for row in rows for name in row.get("percent_of_range", {})))
    kinds = ", ".join(_came_to(row) for row in rows)
    return f"kinds by their error on what was held out, in % of the range of {' and '.join(names)}: {kinds}."


def _came_to(row: Mapping) -> str:
    errors = [f"{value:.2g}" for value in row.get("percent_of_range", {}).values()]
    fate = next((f"({words})" for key, words in FATES.items() if row.get(key)), "")
    return " ".join(filter(None, [row["kind"], " and ".join(errors), fate]))
