"""Whether a model is good enough: the first sentence of a comparison that has criteria, their table, and changes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from hydrotwin.comparison import Acceptance, Change, Judged

from .format import NONE, difference_to_shown, number_text, with_unit
from .page import Note, Section
from .tables import Cell, Column, Table, numbers, table, texts

DIGITS = 3  # of what was found


def verdict(accepted: Acceptance) -> tuple[str, ...]:
    """PASS or FAIL in a sentence, and how close the tightest criterion is."""
    if not accepted.judged:
        return ()
    tightest = min(accepted.judged, key=lambda one: one.margin if not math.isnan(one.margin) else math.inf)
    count = len(accepted.judged)
    careful = _careful(accepted.judged)
    if accepted.passed:
        many = "its criterion" if count == 1 else f"all {count} criteria"
        told = f"PASS: {accepted.model} meets {many}, “{tightest.criterion.text}” with {margin_told(tightest, '')}."
        return (told, *careful)
    missed = [one for one in accepted.judged if not one.passed]
    many = "its criterion" if count == 1 else f"{len(missed)} of {count} criteria"
    words = [one.undefined.rstrip(".") or f"found {found_told(one)}, {margin_told(one, '')}" for one in missed[:3]]
    told = "; ".join(f"“{one.criterion.text}”: {word}" for one, word in zip(missed, words, strict=False))
    return (f"FAIL: {accepted.model} misses {many}: {told}.", *careful)


def _careful(judged: Sequence[Judged]) -> tuple[str, ...]:
    """What to know of the criteria before they are relied on: of the one that says least, and of how many more."""
    careful = sorted((one for one in judged if one.caution), key=_says)
    if not careful:
        return ()
    first, *others = careful
    more = f" The table of the criteria says what to know of {len(others)} more." if others else ""
    return (f"Careful with “{first.criterion.text}”: {first.caution}.{more}",)


def _says(one: Judged) -> tuple[bool, int]:
    """How much a criterion with a caution says: least where the model had seen what judges it, then by its samples."""
    return not one.seen, one.samples or 0


def acceptance_lines(accepted: Acceptance, shown: Mapping[str, str]) -> list[tuple[bool, str]]:
    """For a screen: the verdict, each criterion, and what became better or worse; good news or bad, and a line."""
    lines = [(accepted.passed, text) for text in verdict(accepted)]
    for one in accepted.judged:
        word = "PASS" if one.passed else "FAIL"
        lines.append((one.passed, f"  {word} {one.criterion.text}: {found_told(one)}, {margin_told(one)}"))
    lines += [(False, f"  {sentence}") for sentence in against_told(accepted)]
    if accepted.changes and not any(one.better or one.worse for one in accepted.changes):
        lines.append((True, "  As before: no mean RMSE changed by 2\u00a0% or more."))
    for one in accepted.changes:
        if one.better or one.worse:
            now, before = (_size(value, one, shown).text for value in (one.now, one.before))
            word, what = "better" if one.better else "worse", f"{one.model}, {one.output}, {one.mode}"
            told = f"{now} from {before}" if math.isfinite(one.before) else ""
            told = "; elsewhere ".join(filter(None, [one.scored, told]))
            lines.append((one.better, f"  {word} than before: {what}: {told}"))
    return lines


def acceptance_sections(accepted: Acceptance, shown: Mapping[str, str]) -> tuple[Section, ...]:
    """The criteria one by one, and what changed against an earlier comparison."""
    lead = (
        f"Judged is {accepted.model} in {accepted.mode}. Over several recordings the mean counts, of max the largest; "
        "bias, lag, settling and steady by their size. Where no output is named the worst of all counts."
    )
    judged = Section("acceptance", "Acceptance", (_criteria(accepted.judged),) if accepted.judged else (), lead)
    told = against_told(accepted)
    if not accepted.changes and not told:
        return (judged,)
    lead = (
        "Mean RMSE, and what it was in the earlier comparison, over the recordings that both have scored. Changes of "
        "less than 2\u00a0% are none."
    )
    parts = (*((Note(told),) if told else ()), *((_changes(accepted.changes, shown),) if accepted.changes else ()))
    return judged, Section("changes", "Against the earlier comparison", parts, lead)


def against_told(accepted: Acceptance) -> tuple[str, ...]:
    """Of an earlier comparison what else was otherwise, and which models only one of the two has, in sentences."""
    told = [*accepted.otherwise]
    told += [f"New against the earlier comparison: {', '.join(accepted.new)}."] if accepted.new else []
    told += [f"No longer compared: {', '.join(accepted.gone)}."] if accepted.gone else []
    return tuple(told)


def acceptance_data(accepted: Acceptance | None) -> dict:
    """For the JSON, SI; empty where nothing was asked."""
    if accepted is None:
        return {}
    criteria = [
        asdict(one.criterion)
        | {"value": one.value, "low": one.low, "high": one.high, "margin": one.margin, "passed": one.passed}
        | {"among": list(one.among), "samples": one.samples, "without": list(one.without), "lacking": list(one.lacking)}
        | {"caution": one.caution, "doubt": one.doubt, "undefined": one.undefined}
        | {"as_written": {key: one.criterion.as_written(getattr(one, key)) for key in ("value", "low", "high")}}
        for one in accepted.judged
    ]
    changes = [asdict(one) | {"better": one.better, "worse": one.worse} for one in accepted.changes]
    return {
        "acceptance": {
            "model": accepted.model,
            "mode": accepted.mode,
            "passed": accepted.passed,
            "criteria": criteria,
            "changes": changes,
            "new": list(accepted.new),
            "gone": list(accepted.gone),
            "otherwise": list(accepted.otherwise),
        }
    }


def found_told(one: Judged) -> str:
    """The value of a criterion in the unit that it is written in, of an overall one with its worst output."""
    told = _told(one.value, one)
    return f"{told} of {one.which}" if one.which and told != NONE else told


def margin_told(one: Judged, caution: str | None = None) -> str:
    """How far inside or outside of its bound, and on how few samples; caution : in place of that."""
    caution = one.caution if caution is None else caution
    if one.undefined:
        return one.undefined
    if one.on_bound and not one.passed:
        told = "exactly on its bound, which the sign leaves out"
        return f"{told}, {caution}" if caution else told
    told = "any margin" if one.passed else "no number" if not math.isfinite(one.value) else "not allowed at all"
    if math.isfinite(one.margin):
        outside = "too little" if one.value < one.low else "too much"
        told = f"{number_text(100 * abs(one.margin), 2)}\u00a0% {'to spare' if one.margin >= 0 else outside}"
    return f"{told}, {caution}" if caution else told


def _told(value: float, one: Judged) -> str:
    """A number of a criterion in the unit of the criterion."""
    if not math.isfinite(value):
        return NONE
    told, unit = number_text(one.criterion.as_written(value), DIGITS), one.criterion.unit
    return f"{told}\u00a0%" if unit == "%" else with_unit(told, unit).replace(" ", "\u00a0")


def _criteria(judged: Sequence[Judged]) -> Table:
    columns = [
        texts("criterion", "Criterion", [one.criterion.text for one in judged]),
        Column(
            "result",
            "Result",
            tuple(
                Cell(one.passed, "PASS" if one.passed else "FAIL", tone="" if one.passed else "warning")
                for one in judged
            ),
        ),
        Column("found", "Found", tuple(Cell(one.value, found_told(one)) for one in judged)),
        Column("margin", "Margin", tuple(Cell(one.margin, margin_told(one)) for one in judged)),
    ]
    return table("acceptance", "", columns)


def _changes(changes: Sequence[Change], shown: Mapping[str, str]) -> Table:
    ratios = {c: c.now / c.before for c in changes if c.before and math.isfinite(c.before)}
    rows = sorted(changes, key=lambda c: (not c.lost, -ratios.get(c, 0.0)))
    words = ["worse" if c.worse else "better" if c.better else "as before" for c in rows]
    told = [f"{word}: {c.scored}" if c.scored else word for word, c in zip(words, rows, strict=True)]
    columns = [
        texts("model", "Model", [c.model for c in rows]),
        texts("output", "Output", [f"{c.output}, {c.mode}" for c in rows]),
        Column("before", "Before", tuple(_size(c.before, c, shown) for c in rows)),
        Column("now", "Now", tuple(_size(c.now, c, shown) for c in rows)),
        numbers("ratio", "Now over before", [ratios.get(c) for c in rows], common=False),
        Column(
            "change",
            "",
            tuple(Cell(w, t, tone="warning" if w == "worse" else "") for w, t in zip(words, told, strict=True)),
        ),
    ]
    return table("changes", "", columns)


def _size(value: float, change: Change, shown: Mapping[str, str]) -> Cell:
    unit = shown.get(change.output, change.unit)
    if not math.isfinite(value):
        return Cell(None, NONE)
    return Cell(value, with_unit(number_text(float(difference_to_shown(value, change.unit, unit)), 3), unit))
