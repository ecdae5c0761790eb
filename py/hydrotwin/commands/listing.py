"""The catalogue of effects as rows, for people and for machines."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from hydrotwin.models.language import Input, Model, Output, Parameter
from hydrotwin.models.language.additions import by_end
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import Port
from hydrotwin.models.language.places import Places

from .shared import out, table


def catalogue_rows() -> list[dict]:
    """Every effect: what it is, its parameters with unit and typical range, what kind of place it fits."""
    from hydrotwin.models.effects import CATALOGUE

    fits = kinds_of_place()
    return [
        {
            "id": effect.id,
            "title": effect.title,
            "family": effect.family,
            "equation": effect.equation,
            "fits": fits[effect.id],
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


def kinds_of_place() -> dict[str, str]:
    """By effect the kinds of place it fits, in words, as met in the shipped machines.

    >>> kinds = kinds_of_place()
    >>> kinds["coulomb_friction"], kinds["command_deadband"], kinds["area_error"]
    ('a flange or a link on a joint of its own', 'an input of the model', 'a parameter of the machine')
    """
    from hydrotwin.models import cehA, spool_valve
    from hydrotwin.models.effects import CATALOGUE, candidates

    met: dict[str, dict[str, None]] = {}
    for model in (cehA.model(), spool_valve.model()):
        places = Places(model)
        for c in candidates(model):
            met.setdefault(c.id, {})[_words(c.site, places)] = None
    return {name: " or ".join(met.get(name, {})) or _declared_place(effect) for name, effect in CATALOGUE.items()}


_PORTS = {
    "HydraulicPort": "hydraulic node",
    "Flange": "flange",
    "RotationalFlange": "rotational flange",
    "Shaft": "shaft",
}
_ROLES = {"input": "an input of the model", "output": "an output of the model", "inside": "a signal between parts"}
_FAMILIES = {"vessel": "the level of a vessel"}  # no shipped machine has one


def _words(site, places: Places) -> str:
    """The kind of one place."""
    if site.frees:
        return "a parameter of the machine"
    if getattr(site, "body", "") == "joint":
        return "a link on a joint of its own"
    if site.between:
        ports = list(by_end(site.between).values())
        return f"behind {_several('port', len(ports))} ({_port_words(ports, places)})"
    if isinstance(site.through, Mapping) or (site.through or "").startswith("der("):
        return "the rate of a state"
    if site.through:
        return _ROLES[next((w.role for w in places.wires if w.path == site.through), "inside")]
    reads = f", reading {' and '.join(site.reads)}" if site.reads else ""
    return f"{_port_words(list((site.ties or {}).values()), places)}{reads}"


def _port_words(ports: list[str], places: Places) -> str:
    """``two hydraulic nodes``, ``a flange``."""
    kinds = [places.node_at(port).kind.__name__ for port in ports]
    words = [_PORTS.get(kind, kind) for kind in kinds]
    if len(set(words)) > 1:
        return " and ".join(f"a {word}" for word in dict.fromkeys(words))
    return _several(words[0], len(words))


def _several(word: str, count: int) -> str:
    """``a port``, ``two ports``."""
    return f"{_COUNTED.get(count, count)} {word}{'s' * (count > 1)}"


_COUNTED = {1: "a", 2: "two", 3: "three", 4: "four"}


def _declared_place(effect) -> str:
    """The kind of place as the ports of the part tell it, for an effect that no shipped machine has a place for."""
    if effect.family in _FAMILIES:
        return _FAMILIES[effect.family]
    parts = declarations(effect).values()
    ports = [_PORTS.get(type(p).__name__, type(p).__name__) for p in parts if isinstance(p, Port)]
    if ports:
        return f"a {ports[0]}" if len(ports) == 1 else f"two {ports[0]}s"
    signals = any(isinstance(p, Input) for p in parts) and any(isinstance(p, Output) for p in parts)
    return "a signal" if signals else "a parameter of the machine"


def fitting_rows(model: Model) -> list[dict]:
    """What fits where in a model: name of the part, its equation, its free parameters with unit and typical range.

    ``twins`` are other places where the equations cannot tell the same effect from this one.
    """
    from hydrotwin.models.effects import candidates

    known = {p.name: p for p in (*model.flat.parameters, *(p for p, _ in model.followers))}
    return [
        {
            "effect": c.id,
            "title": c.effect.title,
            "site": c.site.name,
            "twins": [label.partition(" at ")[2] for label in c.twins],
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
    """What fits where, one row for each free parameter or further place, whichever are more."""
    lines = []
    for row in rows:
        places = [row["site"], *(f"= {twin}" for twin in row["twins"])]
        parameters = [(p["name"].removeprefix(f"{row['name']}."), p) for p in row["parameters"]]
        shown = [["" if own == row["name"] else own, range_words(p["typical"], p["unit"])] for own, p in parameters]
        for k in range(max(len(places), len(shown))):
            lead = [row["effect"], places[0], row["equation"], row["name"]] if k == 0 else ["", *places[k : k + 1]]
            lines.append([*lead, *[""] * (4 - len(lead)), *(shown[k] if k < len(shown) else ["", ""])])
    columns = ["effect", "where", "equation", "added as, or freed", "parameter", "typical"]
    table(f"what may be missing in {name}", columns, lines)
    out.print(f"{len(rows)} candidates of {len({r['effect'] for r in rows})} effects.")
    if any(row["twins"] for row in rows):
        out.print("'=' marks places where the equations cannot tell the effect from that one: one candidate.")
