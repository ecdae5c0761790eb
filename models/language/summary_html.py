"""Small HTML of an object, for notebooks: title, verdict, key figures, tables; no script, no style sheet, no network.

What is shown is cut to a size that a notebook keeps well; the object has the rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from .provenance import told_since

ROWS, NOTES = 12, 12  # of one table; sentences below
LONGEST, LONGEST_CELL = 400, 60  # characters of a sentence, of a cell
_LEFT = "text-align:left"


@dataclass(frozen=True)
class SmallTable:
    """Rows of texts and numbers under headings; numbers are shown with four significant digits."""

    caption: str
    headings: Sequence[str]
    rows: Sequence[Sequence[object]]


def summary_html(
    title: str,
    verdict: str,
    facts: Mapping[str, object],
    tables: Sequence[SmallTable] = (),
    notes: Sequence[str] = (),
) -> str:
    """A title, one sentence, figures by name, tables, and further sentences; all texts are escaped."""
    told = " · ".join(f"{escape(name)}: {_text(value)}" for name, value in facts.items())
    parts = [f"<strong>{_text(title)}</strong>"]
    parts += [f"<p>{_text(verdict, LONGEST)}</p>"] if verdict else []
    parts += [f"<p>{told}</p>"] if told else []
    parts += [_table(one) for one in tables if one.rows]
    parts += [f"<p>{_text(note, LONGEST)}</p>" for note in notes[:NOTES]]
    parts += [_more(len(notes) - NOTES)]
    return f"<div>{''.join(parts)}</div>"


def model_html(model) -> str:
    """Of a `Model`: its signals and its parameters."""
    flat, added = model.flat, ", ".join(a.name for a in model.additions)
    free = [p.name for p in flat.parameters if p.free]
    signals = [(s.name, "input", s.unit, s.description) for s in flat.inputs]
    signals += [(s.name, "output", s.unit, s.description) for s in flat.outputs]
    first = sorted(flat.parameters, key=lambda p: not p.free)
    values = [(p.name, p.value, p.unit, p.source) for p in first]
    tables = [
        SmallTable("", ("signal", "", "unit", "what it is"), signals),
        SmallTable("Parameters, SI, free ones first", ("parameter", "value", "unit", "source"), values),
    ]
    facts = {"states": len(flat.states), "parameters": len(flat.parameters), "free": len(free), "step [s]": model.step}
    since = told_since(flat.provenance)
    notes = [f"{since}."] if since else []
    return summary_html(f"Model {model.name}", "", facts | ({"added": added} if added else {}), tables, notes)


def _table(one: SmallTable) -> str:
    head = "".join(f'<th style="{_LEFT}">{_text(heading)}</th>' for heading in one.headings)
    rows = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in one.rows[:ROWS])
    caption = f'<caption style="{_LEFT}">{_text(one.caption)}</caption>' if one.caption else ""
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{_more(len(one.rows) - ROWS)}"


def _more(count: int) -> str:
    return f"<p>and {count} more</p>" if count > 0 else ""


def _cell(value: object) -> str:
    return f'<td style="{_LEFT}">{_text(value)}</td>'


def _text(value: object, longest: int = LONGEST_CELL) -> str:
    """A value as escaped text: a number with four digits, what does not exist as a dash.

    >>> _text(1.23456), _text(float("nan")), _text("<b>")
    ('1.235', '–', '&lt;b&gt;')
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return escape(text if len(text) <= longest else text[: longest - 1] + "…")
