"""The page of a learned block: how well it runs freely on what was held out of its training, beside yardsticks.

It is the page of a comparison on the held-out part: the report card said first, what training left behind below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from hydrotwin.comparison import HoldLast, as_contender, compare
from hydrotwin.learned.held_out import Part
from hydrotwin.learned.learning import held_out_of
from hydrotwin.learned.symbolic.front import front_rows
from hydrotwin.learned.validation import sentence
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .figure import PALETTE, Figure, layout, line
from .format import NONE, number_text, pretty_unit
from .page import Section
from .tables import Cell, Column, Table, counts, numbers, table, texts
from .write import write_report


def write_learned(
    block,
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    folder: str | Path,
    *,
    model=None,
) -> dict[str, Path]:
    """Write report.html, report.md and report.json of a block that `learn` made from ``records``.

    model : that of a hybrid, which runs beside it. Raises DataError where nothing was held out, for then there is
    nothing to show the block on.
    """
    split = held_out_of(records, inputs, outputs, model)
    if not split.held_out:
        raise DataError(f"{block.name}: no page. Nothing was held out of its training: {split.why}.")
    shown = [replace(r, name=f"{r.name}, from {r.time[0]:.4g} s", digest=None) for r in split.held_out]
    parts = {r.name: part for r, part in zip(shown, split.parts, strict=True)}
    named = [s.name for s in block.outputs if all(s.name in r for r in shown)]
    running = [as_contender(block), *([as_contender(model)] if model is not None else [])]
    comparison = compare(
        [_Through(c, parts) for c in running] + [HoldLast([s for s in block.outputs if s.name in named])],
        shown,
        outputs=named,
        train_records=split.fit,
        title=f"{block.name}: what was held out of its training",
        repeats=1,
    )
    card = block.provenance.get("free_run", {})
    says = (card["says"],) if "says" in card else ()
    says += (SEVERAL,) if says and len(shown) > 1 else ()
    says += (judged,) if (judged := sentence(block)) else ()
    return write_report(comparison, folder, sections=learned_sections(block), says=says)


class _Through:
    """A contender whose runs over a part begin with the recording that it is a part of, as those of the card do.

    parts : by the name of the recording that stands for it in the comparison.
    """

    def __init__(self, contender, parts: Mapping[str, Part]):
        self._contender, self._parts = contender, parts

    def __getattr__(self, name: str):
        if name.startswith("_") or name in OF_ONE:
            raise AttributeError(name)
        return getattr(self._contender, name)

    def with_inputs(self, changes: Mapping[str, Mapping]) -> _Through:
        return _Through(self._contender.with_inputs(changes), self._parts)

    def free_run(self, record: Record) -> Record:
        return self._run(self._contender.free_run, record)

    def one_step(self, record: Record) -> Record:
        return self._run(self._contender.one_step, record)

    def _run(self, run: Callable[[Record], Record], record: Record) -> Record:
        part = self._parts[record.name]
        return part.cut(run(part.whole))


def learned_sections(block) -> tuple[Section, ...]:
    """What training left behind: yardsticks, kinds that were tried, seeds."""
    provenance = block.provenance
    card = provenance.get("free_run", {}).get("outputs", {})
    made = (
        _section("yardsticks", "Beside yardsticks", YARDSTICKS, _yardsticks(card) if card else None),
        _section("inputs", "What each input is worth", INPUTS, _inputs(provenance.get("free_run", {}))),
        _section("kinds", "Kinds that were tried", KINDS, _ranking(provenance.get("ranking", ()))),
        _section("seeds", "Spread over seeds", SEEDS, _seeds(provenance.get("seeds", ()))),
        _front(front_rows(block)),
        _terms(provenance.get("narx", {})),
    )
    return tuple(section for section in made if section.parts)


OF_ONE = ("with_starts", "estimate_start", "deviations")  # what a contender knows of a recording that begins a run
YARDSTICKS = "Free run on what was held out. A block that is no better than a yardstick is not worth its parameters."
INPUTS = "Free run on what was held out, with one input at its mean: what the block loses without it."
KINDS = (
    "All were trained on the same recordings. Of those that are as good as the first, within one standard error over "
    "the stretches held out, the one with the fewest numbers is chosen. What was held out chose it, so its figure "
    "flatters it. What was trained on the first course of the commands only has its figures from there."
)
SEVERAL = "These errors count all samples together; the tables below take the mean over recordings."
FRONT = "Of each size the best formula. The shortest one that is as good as the best is chosen."
TERMS = (
    "Error reduction ratio: the share of the squared increments that a term explains, one step ahead, beside those "
    "selected before it; none where a term was added in free run. Factors are over the scales of the block. AIC and "
    "BIC are least where one step ahead more terms are not worth it; free run on held-out parts then chose."
)
SEEDS = "The same training from other random numbers: what differs by no more than this is no difference."


def _section(id: str, title: str, lead: str, found: Table | None) -> Section:
    return Section(id, title, (found,) if found else (), lead)


def _yardsticks(card: Mapping[str, Mapping]) -> Table:
    names = list(dict.fromkeys(name for row in card.values() for name in row.get("yardsticks", {})))
    columns = [
        texts("output", "Output", list(card)),
        Column("block", "The block", tuple(_share(row.get("rmse"), row) for row in card.values())),
    ]
    for name in names:
        cells = tuple(_share(row.get("yardsticks", {}).get(name), row, row.get("rmse")) for row in card.values())
        columns.append(Column(name, name[0].upper() + name[1:], cells))
    return table("yardsticks", "", columns, "RMS error in percent of the range; a yardstick that is as good is marked.")


def _share(value: float | None, row: Mapping, rival: float | None = None) -> Cell:
    if value is None:
        return Cell(None, NONE)
    beaten = rival is None or rival < value
    return Cell(float(value), f"{number_text(100 * value / row['range'], 3)}\u00a0%", tone="" if beaten else "warning")


def _inputs(card: Mapping) -> Table | None:
    worth, rows = card.get("inputs", {}), card.get("outputs", {})
    if not worth:
        return None
    columns = [texts("input", "Without", ["nothing, all inputs told", *worth])]
    for name, row in rows.items():
        errors = [row.get("rmse"), *(without.get(name) for without in worth.values())]
        shares = [None if e is None else 100 * e / row["range"] for e in errors]
        columns.append(numbers(name, f"{name}, of its range", shares, "%", common=False))
    return table("inputs", "", columns)


def _ranking(rows: Sequence[Mapping]) -> Table | None:
    if not rows:
        return None
    names = list(dict.fromkeys(name for row in rows for name in row.get("percent_of_range", {})))
    columns = [
        texts("kind", "Kind", [row["kind"] for row in rows]),
        texts("choice", "", [_choice(row) for row in rows]),
        counts("numbers", "Numbers", [row.get("numbers") for row in rows]),
    ]
    for name in names:
        values = [row.get("percent_of_range", {}).get(name) for row in rows]
        columns.append(numbers(name, f"{name}, of its range", values, "%", best="min", common=False))
        apart = [_apart(row.get("stretches", {}).get(name, ())) for row in rows]
        columns.append(texts(f"{name}.stretches", "by stretch", apart))
    columns.append(numbers("seconds", "Training", [row["seconds"] or None for row in rows], "s", common=False))
    columns.append(texts("why", "", [row.get("failed") or row.get("dropped", "") for row in rows]))
    return table("kinds", "", columns)


def _choice(row: Mapping) -> str:
    names = {"chosen": "chosen", "as_good": "as good", "dropped": "first course only"}
    return next((name for key, name in names.items() if row.get(key)), "")


def _apart(errors: Sequence[float]) -> str:
    """The least and the largest error of a stretch."""
    return f"{number_text(min(errors), 3)} to {number_text(max(errors), 3)}\u00a0%" if errors else ""


def _front(rows: Sequence[Mapping]) -> Section:
    """Error against size of the formulas than which no other is both shorter and better, by output."""
    groups: dict[str, list[Mapping]] = {}
    for row in rows:
        groups.setdefault(row["output"], []).append(row)
    parts = []
    for output, own in groups.items():
        unit = own[0]["unit"]
        title = f"error [{pretty_unit(unit)}]" if unit != "1" else "error"
        spec = {
            "data": [line([r["size"] for r in own], [r["error"] for r in own], output, PALETTE[0])],
            "layout": layout("size (operators, variables, constants)", [title], height=320),
        }
        spec["data"][0]["mode"] = "lines+markers"
        parts += [Figure(f"front-{output}", output, spec)] if len(own) > 1 else []
        columns = [
            texts("chosen", "", ["chosen" if r["chosen"] else "" for r in own]),
            counts("size", "Size", [r["size"] for r in own]),
            numbers("error", "Error where formulas were judged", [r["error"] for r in own], unit, unit, common=False),
            texts("equation", "Formula", [r["equation"] for r in own]),
        ]
        parts.append(table(f"front_{output}", output, columns))
    return Section("front", "Shorter and longer formulas", tuple(parts), FRONT if parts else "")


def _terms(by_output: Mapping[str, Mapping]) -> Section:
    """Terms of a polynomial NARX in the order of their selection, by output."""
    parts = []
    for output, told in by_output.items():
        kept = {row["term"]: row["factor"] for row in told["terms"]}
        rows = list(dict.fromkeys([*told["selected"], *kept]))
        known, left = len(told["selected"]), [None] * (len(rows) - len(told["selected"]))
        columns = [
            texts("term", "Term", rows),
            numbers("err", "ERR", [*told["err"], *left], common=False),
            numbers("aic", "AIC", [*told["aic"], *left], best="min", common=False),
            numbers("bic", "BIC", [*told["bic"], *left], best="min", common=False),
            numbers("factor", "Factor", [kept.get(name) for name in rows], common=False),
        ]
        parts.append(table(f"terms_{output}", f"{output}: {len(kept)} of {known} selected are kept", columns))
    return Section("terms", "Terms of the polynomial", tuple(parts), TERMS if parts else "")


def _seeds(rows: Sequence[Mapping]) -> Table | None:
    if not rows:
        return None
    errors = [row.get("held_out_error") for row in rows]
    columns = [
        counts("seed", "Seed", [row["seed"] for row in rows]),
        numbers("error", "Error on the part that chose, over the spread", errors, common=False, best="min"),
    ]
    return table("seeds", "", columns)
