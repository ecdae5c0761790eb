"""Metrics of the field: the scores that standards and papers ask for, each with what it is and where it is from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hydrotwin.comparison import FREE_RUN, Comparison, Score

from .figure import Style
from .format import NONE, difference_to_shown, number_text, with_unit
from .page import Section
from .tables import Cell, Column, Table, numbers, table, texts

NOT_CLAIMED = 1.0  # E / u_val up to which the error of the model cannot be told
DEFINITIONS = (
    (
        "R²",
        "r2",
        "1 − Σ(y − p)² / Σ(y − mean y)²; 1 is best, 0 is as good as the mean",
        "Nash, Sutcliffe, J. Hydrology 10 (1970) 282–290",
    ),
    (
        "Theil’s U",
        "theil",
        "rms(y − p) / (rms y + rms p); 0 is best, 1 worst; it depends on where the SI unit has its zero",
        "Theil, Economic Forecasts and Policy, 2nd ed. (1961), section 2.5",
    ),
    (
        "Lag",
        "lag",
        "by how much p comes after y where they correlate most, within a fifth of the recording either way; of a "
        "motion that repeats the smallest that fits, for whole periods do not show",
        "Knapp, Carter, IEEE Trans. ASSP 24 (1976) 320–327",
    ),
    (
        "ISO 18571",
        "iso18571",
        "R = 0.4 Z + 0.2 EP + 0.2 EM + 0.2 ES, of corridor, phase, magnitude after time warping, and slope; at most "
        "1000 uniform samples; errors count against the size of y, so it depends on where the SI unit has its zero "
        "(of temperatures at 0 K); excellent above 0.94, good above 0.8, fair above 0.58",
        "ISO/TS 18571:2014",
    ),
    (
        "Settling",
        "settling",
        "how much longer p takes to settle than y: from where the inputs, after a move, rest, to where it stays within "
        "5 % of its largest distance from its final value, or, where noise hides so little, rests; mean size over the "
        "moves after which y rests, with the sign of their mean",
        "Franklin, Powell, Emami-Naeini, Feedback Control of Dynamic Systems, 7th ed. (2015), section 3.4",
    ),
    (
        "At rest",
        "steady",
        "mean(p − y) of every rest of inputs and measurement: each within 0.5 % of its range, or its noise, for 2 % of "
        "the recording and 20 samples; mean size over the rests by their samples, with the sign of their mean",
        "own definition",
    ),
    (
        "E / u_val",
        "vv20",
        "E: RMSE; u_val: root mean square of the standard deviation of the model’s band, which holds parameters and "
        "sensors, u_val² = u_input² + u_num² + u_D²; u_num, the accuracy of the run, is kept far below",
        "ASME V&V 20-2009",
    ),
)


def field_section(comparison: Comparison, shown: Mapping[str, str], look: Mapping[str, Style]) -> Section:
    """The metrics of every output and model in free run, and what they are; empty where there was no free run."""
    rows = [
        s
        for signal in comparison.outputs
        for s in comparison.ranking(signal.name, FREE_RUN)
        if s.model not in comparison.yardsticks
    ]
    lead = "Free run, measurement y and prediction p"
    lead += ", means over the recordings." if len(comparison.records) > 1 else "."
    if any(math.isfinite(s.u_val) for s in rows):
        lead += (
            " Nothing is claimed below u_val: where E / u_val is at most 1, the error of the model cannot be told from "
            "the uncertainty of the validation. A band that holds what a fit left unexplained hides that much, too."
        )
    parts = (_scores(rows, shown, look), _definitions()) if rows else ()
    return Section("field", "Metrics of the field", parts, lead)


def _scores(rows: Sequence[Score], shown: Mapping[str, str], look: Mapping[str, Style]) -> Table:
    columns = [
        texts("output", "Output", [s.output for s in rows]),
        texts(
            "model", "Model", [s.model for s in rows], [look[s.model].colour if s.model in look else "" for s in rows]
        ),
        numbers("r2", "R²", [s.r2 for s in rows], common=False, digits=4),
        numbers("theil", "Theil’s U", [s.theil for s in rows], common=False),
        numbers("lag", "Lag", [s.lag for s in rows], "s", "ms", common=False),
        numbers("iso18571", "ISO 18571", [s.iso18571 for s in rows], decimals=3),
        numbers("corridor", "Corridor Z", [s.corridor for s in rows], decimals=3),
        numbers("phase", "Phase EP", [s.phase for s in rows], decimals=3),
        numbers("magnitude", "Magnitude EM", [s.magnitude for s in rows], decimals=3),
        numbers("slope", "Slope ES", [s.slope for s in rows], decimals=3),
        numbers("settling", "Settling", [s.settling for s in rows], "s", "ms", common=False),
        Column("steady", "At rest", tuple(_size(s.steady, s, shown) for s in rows)),
    ]
    if any(math.isfinite(s.u_val) for s in rows):
        columns.append(Column("u_val", "u_val", tuple(_size(s.u_val, s, shown) for s in rows)))
        columns.append(Column("vv20", "E / u_val", tuple(_claim(s.vv20) for s in rows)))
    return table("field", "", columns)


def _definitions() -> Table:
    names, metrics, meant, sources = zip(*DEFINITIONS, strict=True)
    columns = [
        texts("name", "Metric", names),
        texts("metric", "In a criterion", metrics),
        texts("meant", "What it is", meant),
        texts("source", "Source", sources),
    ]
    return table("field_definitions", "What they are", columns, folded=True)


def _size(value: float, score: Score, shown: Mapping[str, str]) -> Cell:
    if not math.isfinite(value):
        return Cell(None, NONE)
    unit = shown.get(score.output, score.unit)
    return Cell(value, with_unit(number_text(float(difference_to_shown(value, score.unit, unit)), 3), unit))


def _claim(ratio: float) -> Cell:
    if not math.isfinite(ratio):
        return Cell(None, NONE)
    return Cell(ratio, number_text(ratio, 3) + (" (nothing claimed)" if ratio <= NOT_CLAIMED else ""))
