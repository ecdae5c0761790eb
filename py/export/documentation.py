"""documentation/index.html: what a person who gets the FMU needs to know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from .lower import Lowered
from .unit_definitions import display_factor, shown_units
from .variables import Variable

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em; color: #1b2330 }
table { border-collapse: collapse; margin: 1em 0; width: 100% }
th, td { border-bottom: 1px solid #d5dbe3; padding: .3em .6em; text-align: left; vertical-align: top }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
code { background: #eef1f5; padding: 0 .2em }
"""


def documentation(
    lowered: Lowered, variables: Sequence[Variable], solver: str, facts: Mapping[str, str], provenance: Mapping
) -> str:
    """The page as text: facts, variables, parameters with uncertainty and source, provenance."""
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
        "<h2>Parameters</h2>",
        _table(
            ("name", "value", "sigma", "unit", "bounds", "meaning", "source"),
            [_parameter_row(p) for p in lowered.parameters],
        ),
        "<h2>Provenance</h2>",
        _table(("what", "value"), [[escape(str(k)), escape(str(v))] for k, v in provenance.items()])
        if provenance
        else "<p>None was recorded.</p>",
    ]
    head = f'<meta charset="utf-8"><title>{escape(lowered.name)}</title><style>{_STYLE}</style>'
    text = "\n".join(b for b in body if b)
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head>\n<body>\n{text}\n</body></html>\n'


def _starts_text(variables: Sequence[Variable]) -> str:
    starts = [v for v in variables if v.kind == "start"]
    if not starts:
        return "<p>The initial states follow from the parameters and the inputs at the end of initialization.</p>"
    names = ", ".join(f"<code>{escape(v.name)}</code>" for v in starts)
    return (
        f"<p>Initial values to set before the run: {names}. All other initial states follow from them, the parameters "
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
