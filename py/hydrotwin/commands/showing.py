"""simulate, modelica, linearize: look at a model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.model_file import write_whole
from hydrotwin.records import write_record

from ..loading import load
from .shared import (
    JsonOption,
    ModelArgument,
    ScaleOption,
    check_writable,
    err,
    examples,
    out,
    print_json,
    read_all,
    settings_from,
    table,
    tell_ignored,
)


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command(epilog=examples("hydrotwin simulate cehA --input validate_1.csv --out simulated.csv"))(simulate)
    app.command(epilog=examples("hydrotwin modelica cehA --out cehA.mo"))(modelica)
    app.command(epilog=examples("hydrotwin linearize cehA --at arm.angle=0.3 --bode bode.html"))(linearize)


def physical(spec: str, command: str):
    """The physical model that ``spec`` names; a learned block or an FMU has no equations to look at."""
    model = load(spec)
    if not hasattr(model, "root"):
        raise DeclarationError(f"{command}: '{spec}' is no physical model. Give cehA, spool_valve or file.py:factory.")
    return model


def simulate(
    model: ModelArgument,
    input: Annotated[Path, typer.Option("--input", metavar="REC", help="recording with the model's inputs")],
    output: Annotated[Path | None, typer.Option("--out", metavar="REC", help="write the outputs (CSV, Parquet, MAT)")] = None,
    changes: Annotated[list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="parameter value, SI")] = None,
    step: Annotated[float | None, typer.Option(help="integration step [s]")] = None,
    method: Annotated[str, typer.Option(help="auto, explicit, rosenbrock or vm")] = "auto",
    scale: ScaleOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run a model on the inputs of a recording and write its outputs."""
    from hydrotwin.comparison import as_contender, errors_of
    from hydrotwin.simulation import Block, simulate

    if output:
        check_writable(output)
    (record,) = read_all([input], scale)
    thing = load(model)
    if isinstance(thing, Block) or hasattr(thing, "flat"):
        result = simulate(thing, record, parameters=settings_from(changes), step=step, method=method)
    else:
        result = as_contender(thing).free_run(record)
    contender = as_contender(thing)
    known = {s.name for s in (*contender.inputs, *contender.outputs)}
    tell_ignored([record], known, contender.name)
    rows = []
    for signal in contender.outputs:
        values = result[signal.name]
        row = [signal.name, signal.unit, float(values.min()), float(values.max())]
        row.append(float(errors_of(record[signal.name], values).rmse) if signal.name in record.signals else "-")
        rows.append(row)
    if output:
        write_record(result, output)
    if as_json:
        keys = ("output", "unit", "minimum", "maximum", "rmse")
        print_json({"model": contender.name, "outputs": [dict(zip(keys, row, strict=True)) for row in rows]})
        return
    table(f"{contender.name} on {record.name}", ["output", "unit", "minimum", "maximum", "RMSE"], rows)
    if output:
        out.print(f"written: {output}")


def modelica(
    model: ModelArgument,
    output: Annotated[Path | None, typer.Option("--out", metavar="FILE.mo", help="write to a file")] = None,
) -> None:
    """Write a physical model as Modelica source."""
    from hydrotwin.models.language.modelica import modelica_text

    text = modelica_text(physical(model, "modelica"))
    if output:
        write_whole(output, text)
        err.print(f"written: {output}")
    else:
        typer.echo(text)


def linearize(
    model: ModelArgument,
    at: Annotated[list[str] | None, typer.Option("--at", metavar="NAME=VALUE", help="input or state, SI")] = None,
    output: Annotated[str | None, typer.Option("--output", metavar="NAME", help="output of the Bode figure")] = None,
    bode: Annotated[Path | None, typer.Option("--bode", metavar="FILE.html", help="write the Bode figure")] = None,
    as_json: JsonOption = False,
) -> None:
    """Linearise a physical model: poles, damping, hydraulic natural frequency, Bode figure.

    Where nothing is given, the model rests in the equilibrium of its start.
    """
    from hydrotwin.models.language.linearisation import linearise, modes

    thing = physical(model, "linearize")
    flat = thing.flat
    point = settings_from(at)
    names = [s.name for s in (*flat.inputs, *flat.states)]
    for name in point:
        if name not in names:
            raise DeclarationError(f"{thing.name}: no input or state '{name}'. {nearest(name, names)}")
    system = linearise(thing, at=point)
    found = modes(thing, system)
    if bode:
        from hydrotwin.report.bode import write_bode

        write_bode(system, bode, title=thing.name, output=output)
    answer = {
        "model": thing.name,
        "inputs": list(system.input_labels),
        "outputs": list(system.output_labels),
        "states": list(system.state_labels),
        "A": np.asarray(system.A),
        "B": np.asarray(system.B),
        "C": np.asarray(system.C),
        "D": np.asarray(system.D),
        "hydraulic_frequency_hz": found.hydraulic_frequency,
        "modes": [
            {"pole": [m.pole.real, m.pole.imag], "frequency_hz": m.frequency, "damping": m.damping, "name": m.name}
            for m in found.modes
        ],
    }
    if as_json:
        print_json(answer)
        return
    rows = [[f"{m.pole:.5g}", m.frequency, m.damping, m.name] for m in found.modes]
    table(f"{thing.name}: poles", ["pole [rad/s]", "frequency [Hz]", "damping", "mostly"], rows)
    if found.hydraulic_frequency:
        out.print(f"hydraulic natural frequency: {found.hydraulic_frequency:.4g} Hz")
    if bode:
        out.print(f"written: {bode}")
