"""The catalogue of effects as rows, for people and for machines."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from hydrotwin.models.language import Input, Model, Output, Parameter
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import Port

from .shared import out, table


def catalogue_rows() -> list[dict]:
    """Every effect: what it is, its parameters with unit and typical range, what kind of place it fits."""
    from hydrotwin.models.effects import CATALOGUE

    return [
        {
            "id": effect.id,
            "title": effect.title,
            "family": effect.family,
            "equation": effect.equation,
            "fits": place_of(effect),
            "parameters": [_parameter(effect, name, p) for name, p in _own(effect).items()] or _freed(effect),
            "refines": list(effect.refines),
            "confused_with": list(effect.confused_with),
            "experiment": effect.experiment,
            "source": effect.source,
        }
        for effect in CATALOGUE.values()
    ]


def _own(effect) -> dict[str, Parameter]:
    """The parameters to identify."""
    return {name: p for name, p in declarations(effect).items() if isinstance(p, Parameter) and p.free}


def _freed(effect) -> list[dict]:
    """An effect that frees a parameter of the machine: its range as a multiple of the stated value."""
    lows, highs = zip(*effect.typical.values(), strict=True) if effect.typical else ((None,), (None,))
    row = {"name": "", "unit": "stated value", "description": "a parameter of the machine becomes free", "neutral": 1.0}
    return [{**row, "bounds": None, "typical": [lows[0], highs[0]] if effect.typical else None}]


def _parameter(effect, name: str, p: Parameter) -> dict:
    typical = effect.typical.get(name)
    return {
        "name": name,
        "unit": p.unit,
        "description": p.description,
        "neutral": p.value if isinstance(p.value, float | int) else None,
        "bounds": list(p.bounds),
        "typical": list(typical) if typical else None,
    }


def place_of(effect) -> str:
    """The kind of place an effect fits, in words.

    >>> from hydrotwin.models.effects import CATALOGUE
    >>> place_of(CATALOGUE["coulomb_friction"]), place_of(CATALOGUE["actuator_lag"])
    ('every moving flange', 'every input of the model')
    """
    found = vars(effect).get("sites")
    function = getattr(found, "__func__", found)
    told = (getattr(function, "__doc__", None) or "").strip().partition("\n\n")[0]
    if told:
        first = " ".join(told.replace("``", "").split())
        ends = [first.find(mark) for mark in (";", ":", ". ") if mark in first]
        first = first[: min(ends)] if ends else first
        return first[:1].lower() + first[1:].rstrip(".")
    parts = declarations(effect).values()
    ports = [_PORTS.get(type(p).__name__, type(p).__name__) for p in parts if isinstance(p, Port)]
    if ports:
        return f"a {ports[0]}" if len(ports) == 1 else f"two {ports[0]}s"
    signals = any(isinstance(p, Input) for p in parts) and any(isinstance(p, Output) for p in parts)
    return "a signal" if signals else "a parameter of the machine"


_PORTS = {
    "HydraulicPort": "hydraulic node",
    "Flange": "flange",
    "RotationalFlange": "rotational flange",
    "Shaft": "shaft",
}


def fitting_rows(model: Model) -> list[dict]:
    """What fits where in a model: name of the part, its equation, its free parameters with unit and typical range."""
    from hydrotwin.models.effects import candidates

    known = {p.name: p for p in model.flat.parameters}
    return [
        {
            "effect": c.id,
            "title": c.effect.title,
            "site": c.site.name,
            "name": c.name or c.site.frees,
            "equation": c.effect.equation,
            "parameters": [
                {
                    "name": path,
                    "unit": _unit(c, path, known),
                    "neutral": c.neutral.get(path),
                    "typical": list(c.typical[path]) if path in c.typical else None,
                }
                for path in c.free
            ],
        }
        for c in candidates(model)
    ]


def _unit(candidate, path: str, known: Mapping) -> str:
    """The unit of a free parameter; the part's own, the signal's unit put in."""
    if path in known:
        return known[path].unit
    return candidate.addition.part.declared(path.rpartition(".")[2]).unit


def range_words(typical, unit: str) -> str:
    """A typical range with its unit.

    >>> range_words([0.002, 0.24], "s"), range_words(None, "m"), range_words([0.9, 1.1], "1")
    ('0.002 ... 0.24 s', '', '0.9 ... 1.1')
    """
    if not typical or not np.all(np.isfinite(typical)):
        return ""
    shown = re.sub(r"\((\w+)\)", r"\1", unit)
    return f"{typical[0]:.3g} ... {typical[1]:.3g}{f' {shown}' if unit != '1' else ''}"


def print_catalogue(rows: list[dict]) -> None:
    """The catalogue, one family after the other."""
    for family in dict.fromkeys(row["family"] for row in rows):
        lines = []
        for row in (r for r in rows if r["family"] == family):
            lead = [row["id"], row["title"], row["equation"], row["fits"]]
            for p in row["parameters"]:
                lines.append([*lead, p["name"], p["unit"], range_words(p["typical"], "1")])
                lead = [""] * 4
        table(family, ["effect", "", "equation", "fits", "parameter", "unit", "typical"], lines)
        out.print()
    out.print("'signal' stands for the unit of the signal; typical values are then in its nominal value.")
    out.print(f"{len(rows)} effects. What fits where in a machine: hydrotwin effects MODEL")


def print_fitting(name: str, rows: list[dict]) -> None:
    """What fits where, one row for each free parameter."""
    lines = []
    for row in rows:
        lead = [row["effect"], row["site"], row["equation"], row["name"]]
        for p in row["parameters"]:
            own = p["name"].removeprefix(f"{row['name']}.")
            lines.append([*lead, "" if own == row["name"] else own, range_words(p["typical"], p["unit"])])
            lead = [""] * 4
    columns = ["effect", "where", "equation", "added as, or freed", "parameter", "typical"]
    table(f"what may be missing in {name}", columns, lines)
    out.print(f"{len(rows)} candidates of {len({r['effect'] for r in rows})} effects.")
