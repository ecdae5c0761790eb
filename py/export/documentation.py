"""documentation/index.html: what a person who gets the FMU needs to know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from hydrotwin.models.language.units import display_units

from .equations import Equations
from .lower import Lowered
from .unit_definitions import display_factor, shown_units
from .variables import Variable

WIDE = 1.959964  # sigmas on either side of a 95 % interval
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em; color: #1b2330 }
table { border-collapse: collapse; margin: 1em 0; width: 100% }
th, td { border-bottom: 1px solid #d5dbe3; padding: .3em .6em; text-align: left; vertical-align: top }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
code { background: #eef1f5; padding: 0 .2em }
pre { background: #f6f8fa; padding: .8em; overflow-x: auto; font-size: 13px }
"""


def documentation(
    lowered: Lowered, variables: Sequence[Variable], solver: str, facts: Mapping[str, str], equations: Equations,
    provenance: Mapping, licences: Sequence[tuple[str, str]],
) -> str:  # fmt: skip
    """The page as text: facts, variables, fit table, parameters, equations, provenance, licences."""
    body = [
        f"<h1>{escape(lowered.name)}</h1>",
        f"<p>{escape(lowered.description)}</p>" if lowered.description else "",
        _table(("fact", "value"), [[escape(k), escape(str(v))] for k, v in facts.items()]),
        "<h2>How it computes</h2>",
        f"<p>{escape(solver)}</p>",
        _starts_text(variables),
        "<h2>Variables</h2>",
        _table(
            ("name", "causality", "unit", "also shown in", "meaning"),
            [_variable_row(v) for v in variables if v.kind not in ("parameter", "time")],
        ),
        *_fitted(lowered),
        "<h2>Parameters</h2>" if lowered.parameters else "",
        _table(
            ("name", "value", "sigma", "unit", "bounds", "meaning", "source"),
            [_parameter_row(p) for p in lowered.parameters],
        )
        if lowered.parameters
        else "",
        *_equations(equations),
        "<h2>Provenance</h2>",
        *(_provenance(provenance) or ["<p>None was recorded.</p>"]),
        "<h2>Licences</h2>",
        _table(("part", "licence"), [[escape(part), escape(licence)] for part, licence in licences]),
    ]
    head = f'<meta charset="utf-8"><title>{escape(lowered.name)}</title><style>{_STYLE}</style>'
    text = "\n".join(b for b in body if b)
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head>\n<body>\n{text}\n</body></html>\n'


def _fitted(lowered: Lowered) -> list[str]:
    """What was identified, with intervals, in SI and in the unit a person reads."""
    rows = []
    for p in lowered.parameters:
        if p.sigma is None:
            continue
        shown = [_number(p.value, p.sigma, 1.0, 0.0, p.unit)]
        best = p.written_in or display_units(p.unit)[0]
        if best != p.unit:
            shown.append(_number(p.value, p.sigma, *display_factor(p.unit, best), best))
        percent = f"{100 * p.sigma / abs(p.value):.2g} %" if p.value else ""
        rows.append([f"<code>{escape(p.name)}</code>", "<br>".join(shown), percent, escape(p.source)])
    if not rows:
        return []
    head = ("parameter", "value and 95 % interval", "sigma of value", "source")
    return ["<h2>Identified parameters</h2>", _table(head, rows)]


def _number(value: float, sigma: float, factor: float, offset: float, unit: str) -> str:
    middle, half = factor * value + offset, WIDE * factor * sigma
    return escape(f"{middle:.6g}  ({middle - half:.6g} … {middle + half:.6g}) {unit}")


def _provenance(provenance: Mapping) -> list[str]:
    """Facts as one table, and every list of rows, such as the recordings with their hashes, as one of its own."""
    facts, tables = [], []
    for key, value in provenance.items():
        if isinstance(value, (list, tuple)) and value and all(isinstance(row, Mapping) for row in value):
            head = list(dict.fromkeys(name for row in value for name in row))
            rows = [[escape(str(row.get(name, ""))) for name in head] for row in value]
            tables += [f"<h3>{escape(str(key).replace('_', ' '))}</h3>", _table(head, rows)]
        else:
            facts += _fact_rows(str(key), value)
    return [*([_table(("what", "value"), facts)] if facts else []), *tables]


def _fact_rows(name: str, value) -> list[list[str]]:
    if isinstance(value, Mapping):
        return [row for key, inner in value.items() for row in _fact_rows(f"{name}: {key}", inner)]
    if isinstance(value, (list, tuple)):
        return [[escape(name), escape("; ".join(map(str, value)))]] if value else []
    return [[escape(name), escape(f"{value:.6g}" if isinstance(value, float) else str(value))]]


def _equations(equations: Equations) -> list[str]:
    """Added effects with their equation, then all equations."""
    rows = [
        [escape(e.title), f"<code>{escape(e.name)}</code>", escape(e.site), f"<code>{escape(e.equation)}</code>",
         escape(e.source)]
        for e in equations.effects
    ]  # fmt: skip
    head = ("effect", "parameters under", "acts at", "equation", "source")
    effects = ["<h2>Effects added to the machine</h2>", _table(head, rows)] if rows else []
    text = f"<pre>{escape(equations.text)}</pre>" if equations.text else f"<p>{escape(equations.reason)}</p>"
    named = {"modelica": "Equations, as Modelica"}.get(equations.language, "Equations")
    return [*effects, f"<h2>{named}</h2>", text]


def _starts_text(variables: Sequence[Variable]) -> str:
    starts = [v for v in variables if v.kind == "start"]
    if not starts:
        return "<p>The initial states follow from the parameters and the inputs at the end of initialization.</p>"
    names = ", ".join(f"<code>{escape(v.name)}</code>" for v in starts)
    return (
        f"<p>Initial values to set before the run: {names}. What is not set follows from what is, the parameters "
        "and the inputs at the end of initialization.</p>"
    )


def _variable_row(variable: Variable) -> list[str]:
    kind = {"start": "start parameter", "state": "local (state)", "derivative": "local (derivative)"}
    factors = []
    for unit in shown_units(variable.unit):
        factor, offset = display_factor(variable.unit, unit)
        factors.append(f"{unit} (× {factor:.6g}{f' + {offset:g}' if offset else ''})")
    return [
        f"<code>{escape(variable.name)}</code>", kind.get(variable.kind, variable.kind), escape(variable.unit),
        escape(", ".join(factors)), escape(variable.description),
    ]  # fmt: skip


def _parameter_row(p) -> list[str]:
    bounds = f"{p.bounds[0]:g} … {p.bounds[1]:g}"
    return [
        f"<code>{escape(p.name)}</code>", f"{p.value:.9g}", "" if p.sigma is None else f"{p.sigma:.3g}", escape(p.unit),
        bounds, escape(p.description), escape(p.source),
    ]  # fmt: skip


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(h)}</th>" for h in head)
    lines = ["<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows]
    return "<table><thead><tr>" + top + "</tr></thead><tbody>\n" + "\n".join(lines) + "\n</tbody></table>"
