"""The section of a fit: parameters with their uncertainty, what the recordings cannot say, what is left unexplained."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .figure import PALETTE, Figure, layout
from .format import difference_to_shown, number_text, pretty_unit, shown_unit, to_shown
from .page import Note, Section
from .tables import Cell, Column, Table, counts, numbers, table, texts, warned

TWO_SIDED_95 = 1.959964
FAR = 0.1  # of its start: a parameter that moved further is named
BIASED = 3.0  # times the noise left on an output: the parameters then make up for what the model lacks


@dataclass(frozen=True)
class ParameterRow:
    """One fitted parameter in SI; ``low`` and ``high`` are the 95 % interval, value -+ 1.96 sigma (nan if unknown)."""

    name: str
    start: float
    value: float
    low: float
    high: float
    sigma: float
    unit: str
    shift: float
    at_bound: bool


def parameter_rows(fit) -> list[ParameterRow]:
    """The free parameters of a fit, in its order.

    ``fit.parameters`` are rows with name, value, start, sigma, unit, at_bound and shift (a fraction of the start).
    """
    rows = []
    for p in fit.parameters:
        sigma = math.nan if p.sigma is None else float(p.sigma)
        reach = TWO_SIDED_95 * sigma
        rows.append(
            ParameterRow(
                p.name, p.start, p.value, p.value - reach, p.value + reach, sigma, p.unit, p.shift, bool(p.at_bound)
            )
        )
    return rows


def fit_section(fit, name: str | None = None, id: str = "fit") -> Section:
    """Everything about one fit."""
    rows = parameter_rows(fit)
    parts: list = [parameter_table(rows, f"{id}_parameters"), interval_figure(rows, f"{id}-intervals")]
    residuals = getattr(fit, "residuals", ())
    told = ("unexplained",) if residuals else ()  # the table below says the same, output by output
    findings = tuple(_sentence(str(f)) for f in fit.findings if getattr(f, "kind", "") not in told)
    if findings:
        parts.append(Note(findings, tone="warning"))
    accuracy = getattr(fit, "accuracy", None)
    if accuracy and accuracy.reached:  # else a finding says so
        parts.append(Note((f"The runs are {accuracy}.",)))
    if residuals:
        parts += [residual_table(residuals, f"{id}_residuals", _start_note(fit)), Note((_left_over(residuals),))]
    return Section(id, f"Fit of {name or fit.name}", tuple(parts), _lead(fit))


def fit_warning(fit) -> str:
    """What the first screen says about a fit whose parameters cannot be read as physics; empty when they can."""
    left = [r for r in getattr(fit, "residuals", ()) if r.role == "train" and r.chi2_per_sample > BIASED**2]
    if not left:
        return ""
    worst = max(left, key=lambda r: r.chi2_per_sample)
    moved = max((r for r in parameter_rows(fit) if r.start), key=lambda r: abs(r.shift), default=None)
    far = moved is not None and abs(moved.shift) > FAR
    example = f" ({moved.name} moved by {number_text(_moved(moved), 2)} %)" if far else ""
    return (
        f"The fit of {fit.name} leaves {number_text(math.sqrt(worst.chi2_per_sample), 2)} times the noise on "
        f"{worst.output}: the model lacks something, and its parameters make up for it{example}. Take them as numbers "
        "that fit these recordings, not as properties of the machine."
    )


def _moved(row: ParameterRow) -> float:
    """How far it moved in percent of its start; nan for one that started at zero, of which nothing is a share."""
    return 100.0 * row.shift if row.start else math.nan


def parameter_table(rows: Sequence[ParameterRow], id: str = "parameters") -> Table:
    """Start, value and 95 % interval of each parameter; those on a bound or without an interval are marked."""
    units = [shown_unit(r.unit) for r in rows]

    def column(key: str, title: str, difference: bool = False) -> Column:
        cells = []
        for row, unit in zip(rows, units, strict=True):
            value = getattr(row, key)
            convert = difference_to_shown if difference else to_shown
            text = number_text(float(convert(value, row.unit, unit)), 4)
            cells.append(Cell(value if math.isfinite(value) else None, text))
        return Column(key, title, tuple(cells), numeric=True)

    bound = ["at bound" if r.at_bound else ("not determined" if math.isnan(r.sigma) else "") for r in rows]
    columns = [
        texts("parameter", "Parameter", [r.name for r in rows]),
        texts("unit", "Unit", [pretty_unit(u) for u in units]),
        column("start", "Start"),
        column("value", "Value"),
        column("low", "95 % from"),
        column("high", "to"),
        numbers("shift", "Shift", [_moved(r) for r in rows], "%", common=False),
        warned(texts("remark", "Remark", bound), [bool(b) for b in bound]),
    ]
    return table(id, "Parameters", columns)


def interval_figure(rows: Sequence[ParameterRow], id: str = "intervals") -> Figure:
    """Value and 95 % interval of each parameter over its start, on a logarithmic axis when it spans much."""
    rows = rows[::-1]
    scale = [r.start or 1.0 for r in rows]
    ratio = [r.value / s for r, s in zip(rows, scale, strict=True)]
    reach = [abs((r.high - r.value) / s) for r, s in zip(rows, scale, strict=True)]
    reach = [v if math.isfinite(v) else 0.0 for v in reach]
    marker = {
        "size": 10,
        "color": [PALETTE[1] if r.at_bound else PALETTE[0] for r in rows],
        "symbol": ["x" if r.at_bound else "circle" for r in rows],
    }
    trace = {"type": "scatter", "mode": "markers", "x": ratio, "y": [r.name for r in rows], "showlegend": False}
    trace["error_x"] = {"type": "data", "array": reach, "thickness": 3, "width": 0, "color": PALETTE[0]}
    trace["hovertemplate"] = "%{y}: %{x:.4g} ± %{error_x.array:.2g} of its start<extra></extra>"
    plan = layout("value over start, with 95 % interval", [""], height=140 + 34 * len(rows))
    plan |= {"hovermode": "closest", "margin": {"l": 20, "r": 44, "t": 16, "b": 46}}
    low = min((v - w for v, w in zip(ratio, reach, strict=True)), default=1.0)
    high = max((v + w for v, w in zip(ratio, reach, strict=True)), default=1.0)
    if low > 0.0 and high > 4.0 * low:
        ticks = [m * 10.0**k for k in range(-9, 10) for m in (1, 2, 5) if low / 2 < m * 10.0**k < 2 * high]
        plan["xaxis"] |= {"type": "log", "tickvals": ticks, "ticktext": [f"{t:g}" for t in ticks]}
    plan["shapes"] = [
        {"type": "line", "x0": 1, "x1": 1, "yref": "paper", "y0": 0, "y1": 1, "line": {"color": "#c3c9cf"}}
    ]
    return Figure(id, "", {"data": [trace | {"marker": marker}], "layout": plan})


def residual_table(residuals: Sequence, id: str = "residuals", note: str = "") -> Table:
    """RMSE against noise for each output and recording, and whether what is left is white."""
    ratio = [math.sqrt(r.chi2_per_sample) for r in residuals]
    shown = [shown_unit(r.unit, peak=100.0 * r.rmse) for r in residuals]

    def errors(key: str, title: str) -> Column:
        cells = (
            Cell(getattr(r, key), number_text(float(difference_to_shown(getattr(r, key), r.unit, u))))
            for r, u in zip(residuals, shown, strict=True)
        )
        return Column(key, title, tuple(cells), numeric=True)

    verdict = ["noise only" if r.explained else "more than noise" for r in residuals]
    columns = [
        texts("output", "Output", [r.output for r in residuals]),
        texts("record", "Recording", [r.record for r in residuals]),
        texts("role", "Role", [r.role for r in residuals]),
        errors("rmse", "RMSE"),
        errors("noise", "Noise"),
        texts("unit", "Unit", [pretty_unit(u) for u in shown]),
        numbers("ratio", "RMSE / noise", ratio, common=False),
        numbers("lag_one", "Correlation of neighbours", [r.lag_one for r in residuals], common=False, digits=2),
        texts("white", "White", ["yes" if r.white else "no" for r in residuals]),
        warned(texts("verdict", "What is left", verdict), [not r.explained for r in residuals]),
        counts("samples", "Samples", [r.samples for r in residuals]),
    ]
    return table(id, "What the fit explains", columns, note)


def _lead(fit) -> str:
    records = getattr(fit, "records", ())
    train = sum(getattr(r, "role", "train") == "train" for r in records)
    words = [f"{len(fit.parameters)} parameters"]
    if train:
        words.append(f"from {train} recording{'s' if train > 1 else ''}")
    words.append(f"in {number_text(fit.seconds, 2)} s")
    per_dof = getattr(fit, "chi2_per_dof", None)
    tail = ""
    if per_dof is not None and np.isfinite(per_dof):
        tail = f" Chi-square per degree of freedom is {number_text(float(per_dof))}; 1 means that only noise is left."
    message = getattr(fit, "message", "")
    return f"{' '.join(words)}.{tail}{' ' + _sentence(message) if message else ''}"


def _start_note(fit) -> str:
    """Why these errors are not those of the scores, when the fit estimated start states."""
    starts = list(dict.fromkeys(name for r in getattr(fit, "records", ()) for name in r.start))
    if not starts:
        return ""
    return (
        f"Free runs from the start that the fit estimates for each recording ({', '.join(starts)}). The scores above "
        "start from the first sample as it was measured, noise and all: their errors are other, often larger, numbers."
    )


def _sentence(text: str) -> str:
    """A message as a sentence of the page: without the verb in front, with a capital unless it starts with a path."""
    text = text.removeprefix("identify: ")
    first = text.split(" ", 1)[0]
    start = text if "." in first or "_" in first else text[:1].upper() + text[1:]
    return start if start.endswith((".", "!", "?")) else f"{start}."


def _left_over(residuals: Sequence) -> str:
    left = [r for r in residuals if not r.explained]
    if not left:
        return "Explained: every output of every recording, down to the noise of its sensor."
    done = sorted({r.output for r in residuals} - {r.output for r in left})
    worst = max(left, key=lambda r: r.chi2_per_sample)
    share = 100.0 * max(0.0, 1.0 - 1.0 / worst.chi2_per_sample) if worst.chi2_per_sample > 0 else 0.0
    explained = f"Explained down to the noise: {', '.join(done)}. " if done else ""
    return (
        f"{explained}Not explained: {', '.join(dict.fromkeys(r.output for r in left))}. Worst is {worst.output} in "
        f"{worst.record}, {number_text(math.sqrt(worst.chi2_per_sample), 2)} times its noise: "
        f"{number_text(share, 3)} % of the error's power is not sensor noise. The free parameters cannot explain that: "
        "look for a missing effect, or free more."
    )
