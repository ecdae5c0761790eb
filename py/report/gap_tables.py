"""The tables of a gap report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

from hydrotwin.discovery.answer.discovery import Discovery, OutputGap, Ranked, RecordingGap, Step, Unknown
from hydrotwin.discovery.answer.words import certainty, joined, percent, sentence

from .figure import PALETTE
from .format import NONE, common_decimals, difference_to_shown, number_text, pretty_unit, shown_unit, to_shown
from .gap_figures import moved
from .gap_text import capital, parameter_unit, typical_remark, typical_text, value_texts
from .gap_words import AT_NOISE, ROLES, driver_words, got_worse, unseen
from .tables import Cell, Column, Table, numbers, table, texts, warned

FULL = 12  # candidates shown before the rest is folded
NO_GAP = "no gap"
LEFT = "Left: what a fit leaves of whole recordings beyond noise, in nats; 0: nothing but noise is left."
SWATCH = {"named": PALETTE[0], "in class": PALETTE[5]}


def headline(discovery: Discovery, shown: Mapping[str, str]) -> Table:
    """One row per output, on unseen recordings: RMSE before and after, noise, what is left, gap closed."""
    rows, fresh = unseen(discovery)
    which = "the recordings never used for fitting" if fresh else "the recordings of the fit: none were held back"
    return output_table("headline", "", rows, shown, bool(discovery.steps), f"RMSE of free runs over {which}.")


def output_table(
    id: str, title: str, rows: Sequence[OutputGap], shown: Mapping[str, str], changed: bool, note: str = ""
) -> Table:
    """RMSE before and after of outputs in units of their own; without ``changed`` only one of the two."""
    units = [shown.get(o.output, o.unit) for o in rows]
    columns = [
        texts("output", "Output", [o.output for o in rows]),
        rmse_column("rmse_before", "RMSE before" if changed else "RMSE", rows, units),
    ]
    if changed:
        columns.append(rmse_column("rmse_after", "After", rows, units))
    else:
        columns.append(rmse_column("noise", "Noise", rows, units))
    columns.append(texts("unit", "Unit", [pretty_unit(u) for u in units]))
    if changed:
        columns.append(closed_column([o.gap_closed for o in rows]))
    columns.append(left_column(rows))
    return table(id, title, columns, note)


def rmse_column(key: str, title: str, rows: Sequence[OutputGap], units: Sequence[str]) -> Column:
    """One of rmse_before, rmse_after and noise, each row in its unit with the decimals of the smallest of the three."""
    cells = []
    for o, unit in zip(rows, units, strict=True):
        three = [float(difference_to_shown(v, o.unit, unit)) for v in (o.rmse_before, o.rmse_after, o.noise)]
        decimals = common_decimals(three, 2)
        value = getattr(o, key)
        shown = float(difference_to_shown(value, o.unit, unit))
        text = number_text(shown) if decimals is None or not math.isfinite(shown) else f"{shown:.{decimals}f}"
        cells.append(_cell(value, text.replace("-", "−")))
    return Column(key, title, tuple(cells), numeric=True)


def left_column(rows: Sequence[OutputGap]) -> Column:
    """RMSE after over noise; more than noise is marked."""
    ratio = [o.rmse_after / o.noise if o.noise > 0.0 else math.nan for o in rows]
    return warned(numbers("times_noise", "× noise", ratio, common=False), [r > AT_NOISE for r in ratio])


def closed_column(values: Sequence[float], none: str = NO_GAP) -> Column:
    """Share of the gap closed; ``none`` where there was none to close."""
    cells = (_cell(v, percent(v) if math.isfinite(v) else none) for v in values)
    return Column("gap_closed", "Gap closed", tuple(cells), numeric=True)


def left_of_recordings(values: Sequence[float]) -> Column:
    """Nats that fits leave of whole recordings: 0 where nothing but noise is left."""
    return numbers("left", "Left", values, common=False)


def location_table(discovery: Discovery) -> Table:
    """Where each output disagrees before anything is added, worst first."""
    rows = sorted(discovery.locations, key=lambda place: -place.times_noise)
    columns = [
        texts("output", "Output", [r.output for r in rows]),
        numbers("times_noise", "× noise", [r.times_noise for r in rows], common=False),
        texts("white", "White", ["yes" if r.white else "no" for r in rows]),
        texts("where", "Where", [sentence(r.where) or NONE for r in rows]),
        texts("drivers", "Follows", [driver_words(r.drivers) or NONE for r in rows]),
    ]
    return table("locations", "Before anything is added", columns)


def candidate_tables(ranked: Sequence[Ranked], id: str, title: str) -> list[Table]:
    """The candidates of one look in their order: those that were fitted open, the rest folded."""
    fitted = [r for r in ranked if math.isfinite(r.left) or r.fate in ("named", "in class")]
    first = fitted or list(ranked[:FULL])
    rest = [r for r in ranked if r not in first]
    found = [_candidates(first, id, title, False)] if first else []
    if rest:
        found.append(_candidates(rest, f"{id}_rest", f"{len(rest)} more candidates, not fitted", True))
    return found


def _candidates(rows: Sequence[Ranked], id: str, title: str, folded: bool) -> Table:
    columns = [
        texts(
            "candidate",
            "Candidate",
            [capital(r.title or r.effect) for r in rows],
            [SWATCH.get(r.fate, "") for r in rows],
        ),
        texts("site", "Where", [r.site for r in rows]),
        _percents("share", "Promise", [r.share for r in rows]),
    ]
    if not folded:
        columns += [
            left_of_recordings([r.left for r in rows]),
            closed_column([r.gap_closed for r in rows], NONE),
            _percents("probability", "Probability", [r.probability for r in rows], certainty),
        ]
    columns += [
        texts("fate", "Fate", [r.fate for r in rows]),
        texts("reason", "Why", [capital(sentence(r.reason)) for r in rows]),
    ]
    return table(id, title, columns, "" if folded else LEFT, folded)


def effect_table(step: Step, id: str) -> Table:
    """The parameters of a named effect, with interval and the typical range of the catalogue."""
    rows = step.parameters
    units = [parameter_unit(p) for p in rows]
    words = [value_texts(p) for p in rows]
    remarks = [typical_remark(p) for p in rows]

    def column(key: str, title: str, k: int) -> Column:
        cells = (_cell(getattr(p, key), w[k]) for p, w in zip(rows, words, strict=True))
        return Column(key, title, tuple(cells), numeric=True)

    columns = [
        texts("parameter", "Parameter", [p.name for p in rows]),
        column("value", "Value", 0),
        column("low", "95 % from", 1),
        column("high", "to", 2),
        texts("unit", "Unit", [pretty_unit(u) for u in units]),
        texts("typical", "Typical", [typical_text(p) for p in rows]),
        texts("meaning", "Meaning", [p.description for p in rows]),
        warned(texts("remark", "Remark", remarks), [bool(r) for r in remarks]),
    ]
    note = f"Source: {sentence(step.source)} " if step.source else ""
    return table(id, "", _told(columns), f"{note}The interval also allows 2 % (one sigma) for the form of the law.")


def member_table(step: Step, id: str) -> Table:
    """The members of a class, in order, with what each has to show."""
    known = {(r.effect, r.site): r for r in step.ranked}
    rows = [known.get(m) for m in step.members]
    columns = [
        texts("member", "Member", [capital(r.title) if r else m[0] for m, r in zip(step.members, rows, strict=True)]),
        texts("site", "Where", [site for _, site in step.members]),
        _percents("probability", "Probability", [r.probability if r else math.nan for r in rows], certainty),
        closed_column([r.gap_closed if r else math.nan for r in rows], NONE),
        left_of_recordings([r.left if r else math.nan for r in rows]),
        texts("values", "Its parameters would be", [_values(r) if r else NONE for r in rows]),
    ]
    return table(id, "What explains the recordings as well", columns, LEFT)


def _values(row: Ranked) -> str:
    found = [
        f"{p.name.rpartition('.')[2]} = {value_texts(p)[0]} {pretty_unit(parameter_unit(p))}" for p in row.parameters
    ]
    return joined([f.strip() for f in found]) or NONE


def waterfall_table(discovery: Discovery) -> Table:
    """What is left after each effect, and the share of the squared gap that it closed."""
    rungs = discovery.waterfall
    squares = [r.times_noise**2 - 1.0 for r in rungs]
    gap = squares[0] if squares[0] > 0.0 else math.nan
    share = [math.nan, *((a - b) / gap for a, b in pairwise(squares))]
    columns = [
        texts("label", "Model", [r.label for r in rungs]),
        numbers("times_noise", "Error over noise", [r.times_noise for r in rungs], common=False),
        closed_column(share, NONE),
    ]
    return table("waterfall", "", columns)


def shift_table(discovery: Discovery) -> Table:
    """The free parameters of the base model before and after, and how far they moved."""
    rows = discovery.shifts
    units = [shown_unit(s.unit, peak=max(abs(s.before), abs(s.after))) for s in rows]

    def column(key: str, title: str, digits: int, convert) -> Column:
        values = [(getattr(s, key), s.unit, u) for s, u in zip(rows, units, strict=True)]
        cells = (_cell(v, number_text(float(convert(v, si, u)), digits)) for v, si, u in values)
        return Column(key, title, tuple(cells), numeric=True)

    bound = ["at bound" if s.at_bound else "" for s in rows]
    change = [(s.after - s.before) / abs(s.before) if s.before else math.nan for s in rows]
    columns = [
        texts("parameter", "Parameter", [s.name for s in rows]),
        column("before", "Before", 4, to_shown),
        column("sigma_before", "±", 2, difference_to_shown),
        column("after", "After", 4, to_shown),
        column("sigma_after", "±", 2, difference_to_shown),
        texts("unit", "Unit", [pretty_unit(u) for u in units]),
        _percents("change", "Moved", change),
        numbers("sigmas", "Moved, in sigmas", [moved(s) for s in rows], common=False, digits=2),
        warned(texts("remark", "Remark", bound), [s.at_bound for s in rows]),
    ]
    bare = any(math.isnan(s.sigma_before) for s in rows)
    note = f"± is one standard deviation{'; – where a value rests on a bound of the search' * bare}."
    return table("shifts", "", _told(columns), note)


def recording_tables(discovery: Discovery, shown: Mapping[str, str]) -> list[Table]:
    """For each output the recordings, those never used first."""
    order = {"report": 0, "validate": 0, "fit": 1, "train": 1}
    recordings = sorted(discovery.recordings, key=lambda r: order.get(r.role, 3))
    outputs = dict.fromkeys(o.output for r in recordings for o in r.outputs)
    return [_by_recording(output, recordings, shown, bool(discovery.steps)) for output in outputs]


def _by_recording(output: str, recordings: Sequence[RecordingGap], shown: Mapping[str, str], changed: bool) -> Table:
    pairs = [(r, o) for r in recordings for o in r.outputs if o.output == output]
    rows = [o for _, o in pairs]
    si, unit = rows[0].unit, shown.get(output, rows[0].unit)
    values = [v for o in rows for v in (o.rmse_before, o.rmse_after)]
    decimals = common_decimals([float(difference_to_shown(v, si, unit)) for v in values], 2)

    def errors(key: str, title: str) -> Column:
        return numbers(key, title, [getattr(o, key) for o in rows], si, unit, decimals=decimals)

    columns = [
        texts("record", "Recording", [r.record for r, _ in pairs]),
        texts("role", "Role", [ROLES.get(r.role, r.role) for r, _ in pairs]),
        errors("rmse_before", "RMSE before" if changed else "RMSE"),
    ]
    if changed:
        worse = [got_worse(o) for o in rows]
        columns.append(warned(errors("rmse_after", "After"), worse))
    columns.append(left_column(rows))
    if changed:
        columns.append(closed_column([o.gap_closed for o in rows]))
    return table(f"recordings_{output}", output, columns)


def unknown_table(rows: Sequence[Unknown]) -> Table:
    """What was left without a name: what it follows, and how much of it that explains."""
    columns = [
        texts("output", "Output", [u.output for u in rows]),
        texts("inputs", "Described by", [joined(u.inputs) for u in rows]),
        _percents("explained", "Explains of it", [u.explained for u in rows]),
        texts("formula", "Formula", [u.formula for u in rows]),
    ]
    note = "Shares of the squared residual on recordings that the formula was not made from; formulas in SI."
    return table("unknown", "", _told(columns), note)


def untestable_table(rows: Sequence[Ranked]) -> Table:
    """What cannot be judged, and why."""
    columns = [
        texts("effect", "Effect", [capital(r.title or r.effect) for r in rows]),
        texts("site", "Where", [r.site for r in rows]),
        texts("fate", "Fate", [r.fate for r in rows]),
        texts("reason", "Why", [capital(sentence(r.reason)) for r in rows]),
    ]
    return table("not_testable", "", columns)


def noise_table(discovery: Discovery, shown: Mapping[str, str]) -> Table:
    """The standard deviation of each sensor."""
    names = list(discovery.noise)
    units = {o.output: o.unit for rows in discovery.outputs.values() for o in rows}
    units |= {o.output: o.unit for r in discovery.recordings for o in r.outputs}
    cells = []
    for name in names:
        value, si = discovery.noise[name], units.get(name, "1")
        cells.append(_cell(value, number_text(float(difference_to_shown(value, si, shown.get(name, si))))))
    columns = [
        texts("output", "Output", names),
        Column("noise", "Standard deviation", tuple(cells), numeric=True),
        texts("unit", "Unit", [pretty_unit(shown.get(n, units.get(n, "1"))) for n in names]),
    ]
    return table("noise", "", columns)


def timing_table(discovery: Discovery) -> Table:
    """How long it took, all parts of an interrupted search together."""
    columns = [texts("stage", "Stage", ["all"]), numbers("seconds", "Time", [discovery.seconds], "s", common=False)]
    return table("timings", "Time", columns)


def _told(columns: Sequence[Column]) -> list[Column]:
    """The columns that say anything."""
    return [c for c in columns if any(cell.text for cell in c.cells)]


def _percents(key: str, title: str, values: Sequence[float], text: Callable[[float], str] = percent) -> Column:
    return Column(key, title, tuple(_cell(v, text(v)) for v in values), numeric=True)


def _cell(value: float, text: str) -> Cell:
    return Cell(float(value) if math.isfinite(value) else None, text)
