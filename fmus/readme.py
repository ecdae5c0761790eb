"""The README of a shipped FMU, from its fmu.toml and its model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase

from hydrotwin.commands.exporting import equations_told, given_starts
from hydrotwin.export.documentation import WIDE
from hydrotwin.export.equations import Equations, equations_of
from hydrotwin.export.lower import Lowered, lower_block, lower_model
from hydrotwin.export.undelayed import without_idle_delays
from hydrotwin.export.unit_definitions import display_factor, shown_units
from hydrotwin.simulation.block import Block

from .shipped import Shipped

KINDS = {"cs": "Co-Simulation", "me": "Model Exchange", "both": "Co-Simulation and Model Exchange"}


def readme_of(shipped: Shipped) -> str:
    """The whole README as Markdown."""
    thing = shipped.load()
    system = lowered_of(shipped, thing)
    equations = equations_of(thing, equations_told(thing))
    parts = [
        f"# {shipped.folder.name}: {shipped.title}",
        "<!-- made by `python -m fmus.make --write` from fmu.toml and the model -->",
        _what(system, shipped),
        _use(system, shipped),
        "## Inputs and outputs",
        _signals(system),
        _starts(system),
        *_parameters(system, shipped),
        *_equations(equations),
        *_provenance(getattr(thing, "provenance", {})),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def lowered_of(shipped: Shipped, thing) -> Lowered:
    """What the FMU has inside: inputs, outputs, parameters, start parameters."""
    if isinstance(thing, Block):
        return lower_block(thing, thing.name)
    flat = thing.flat if shipped.kind == "cs" else without_idle_delays(thing.flat)[0]
    step = float(shipped.step or flat.step)
    return lower_model(flat, given_starts(thing, shipped.start), "explicit", step, 1e-10, flat.name)


def _what(system: Lowered, shipped: Shipped) -> str:
    versions = " and ".join(f"{v}.0" for v in shipped.fmi)
    moves = f"It moves every {system.step:g} s." if system.sampled else f"Internal steps of at most {system.step:g} s."
    says = [system.description.strip().rstrip("."), f"FMI {versions}, {KINDS[shipped.kind]}", moves.rstrip(".")]
    return ". ".join(s for s in says if s) + "."


def _use(system: Lowered, shipped: Shipped) -> str:
    name = shipped.folder.name
    files = [f"{name}_fmi{v}.fmu" for v in shipped.fmi]
    given = shipped.model if not shipped.model.endswith(".toml") else f"fmus/{name}/{shipped.model}"
    size = f" step_size={shipped.communication_step}," if shipped.communication_step else ""
    output = system.outputs[0].name
    return f"""`make fmus` builds {" and ".join(f"`{f}`" for f in files)} in this folder, and checks them.
`hydrotwin export {given} --platform all --out {name}.fmu` builds one for every machine.
Any tool that imports FMI takes them; with FMPy:

```python
from fmpy import simulate_fmu

result = simulate_fmu("{files[0]}",{size} start_values={{"{system.inputs[0].name}": {_input_value(system)}}})
result["time"], result["{output}"]
```

[reference.csv](reference.csv) has inputs, held from sample to sample, and the outputs they give: replay it in your tool
and compare. `hydrotwin check {files[0]}` does that and more."""


def _input_value(system: Lowered) -> str:
    return f"{system.inputs[0].default + 0.2 * system.inputs[0].nominal:g}"


def _signals(system: Lowered) -> str:
    rows = [
        (f"`{s.name}`", what, s.unit, _shown(s.unit), s.description or "-")
        for what, signals in (("input", system.inputs), ("output", system.outputs))
        for s in signals
    ]
    return _table(("name", "", "unit", "also shown in", "meaning"), rows)


def _starts(system: Lowered) -> str:
    if not system.starts:
        return ""
    names = ", ".join(f"`{s.name}` [{s.unit}]" for s in system.starts)
    others = "The memory follows" if system.sampled else "States whose start is not set follow"
    rest = f"{others} from them."
    return f"Set before the run where it starts: {names}. {rest}"


def _parameters(system: Lowered, shipped: Shipped) -> list[str]:
    if not system.parameters:
        return []
    chosen = [p for p in system.parameters if any(fnmatchcase(p.name, glob) for glob in shipped.parameters)]
    rows = []
    for p in chosen:
        interval = "" if p.sigma is None else f"{p.value - WIDE * p.sigma:.6g} … {p.value + WIDE * p.sigma:.6g}"
        rows.append((f"`{p.name}`", f"{p.value:.6g}", interval, p.unit, p.description or "-", p.source))
    left = len(system.parameters) - len(chosen)
    more = f" {left} more are in the FMU." if left else ""
    head = ("name", "value", "95 % interval", "unit", "meaning", "source")
    return ["## Parameters", f"All are tunable and act from the next step on.{more}", _table(head, rows)]


def _equations(equations: Equations) -> list[str]:
    rows = [(e.title, f"`{e.name}.*`", f"`{e.site}`", f"`{e.equation}`", e.source) for e in equations.effects]
    effects = _table(("effect", "parameters", "acts at", "equation", "source"), rows)
    added = ["## What was added to the machine", effects] if rows else []
    title = "## Equations" if equations.language != "modelica" else "## Equations, as Modelica"
    return [*added, title, f"```{equations.language}\n{equations.text.rstrip()}\n```"]


def _provenance(provenance: Mapping) -> list[str]:
    recordings = provenance.get("recordings") or provenance.get("trained_on") or ()
    rows = [(r["name"], r.get("role", "train"), f"`{r['sha256']}`") for r in recordings]
    made = [f"{k}: {provenance[k]}" for k in ("made_by", "verdict", "held_out_error", "seed") if k in provenance]
    if not rows:
        return []
    return ["## Where it comes from", "; ".join(made), _table(("recording", "role", "SHA-256"), rows)]


def _shown(unit: str) -> str:
    shown = []
    for other in shown_units(unit):
        factor, offset = display_factor(unit, other)
        shown.append(f"{other} (× {factor:.6g}{f' + {offset:g}' if offset else ''})")
    return ", ".join(shown)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *([str(cell).replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
