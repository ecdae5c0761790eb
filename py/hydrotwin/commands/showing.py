"""simulate, modelica, linearize: look at a model."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.quantities import wanted
from hydrotwin.models.language.units import compatible
from hydrotwin.models.language.writing import write_whole
from hydrotwin.records import WRITTEN, Reading, as_needed, cuts, joined, unbroken, write_record
from hydrotwin.records.between import between, settled

from ..loading import load
from .recordings import constants_among, read_all, reads, tell_columns
from .shared import (
    InitialStatesOption,
    InterpolationOption,
    JsonOption,
    ModelArgument,
    StepOption,
    check_file,
    check_folder,
    err,
    examples,
    interpolation_from,
    mark,
    out,
    print_json,
    settings_from,
    table,
    tell_between,
    texts_from,
)


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command(epilog=examples("hydrotwin simulate cehA --input validate_1.csv --out simulated.csv"))(reads(simulate))
    app.command(epilog=examples("hydrotwin modelica cehA --out cehA.mo"))(modelica)
    app.command(epilog=examples("hydrotwin linearize cehA --at arm.angle=0.3 --out linear"))(linearize)


def physical(spec: str, command: str):
    """The physical model that ``spec`` names; a learned block or an FMU has no equations to look at."""
    model = load(spec)
    if not hasattr(model, "root"):
        raise DeclarationError(f"{command}: '{spec}' is no physical model. Give cehA, spool_valve or file.py:factory.")
    return model


def simulate(
    model: ModelArgument,
    input: Annotated[Path, typer.Option("--input", metavar="REC", help="recording with the model's inputs")],
    output: Annotated[
        Path | None, typer.Option("--out", metavar="REC", help="write the outputs (CSV, Parquet, MAT)")
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="PATH=VALUE", help="parameter, SI or with its unit: m=2000g; input not recorded: p=35bar"
        ),
    ] = None,
    step: StepOption = None,
    method: Annotated[str, typer.Option(help="auto, explicit, implicit or vm")] = "auto",
    interpolation: InterpolationOption = None,
    initial_states: InitialStatesOption = "measured",
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Run a model on the inputs of a recording and write its outputs."""
    from hydrotwin.comparison import FREE_RUN, Trajectory, as_contender, domain_shares
    from hydrotwin.simulation import Block, InaccurateWarning, simulate

    if output:
        check_file(output, *WRITTEN, sources=[input])
    thing = load(model)
    is_fmu = hasattr(thing, "with_values")  # which reads what is set of its inputs itself, by the units that it defines
    inputs = set() if is_fmu else {s.name for s in as_contender(thing).inputs}
    changes, reading = constants_among(changes, inputs, reading)
    (record,) = read_all([input], reading)
    if is_fmu:
        if step is not None or method != "auto":
            raise DeclarationError(f"simulate: '{model}' is an FMU, which --step and --method do not reach. Drop them.")
        texts = texts_from(changes, "--set")
        thing = thing.with_values(texts).fed_by([record])
        tell_out_of_bounds(thing.parameters, {p.name: p.value for p in thing.parameters if p.name in texts})
        settings = {}
    else:
        settings = settings_from(changes, "--set", [wanted(p) for p in _parameters_of(thing)])
    notes = tuple(getattr(thing, "notes", ()))
    thing = settled(thing, [record], interpolation_from(interpolation))
    contender = as_contender(thing)
    record = as_needed(record, (*contender.inputs, *contender.outputs))
    parts = unbroken(record, [s.name for s in contender.inputs])
    if isinstance(thing, Block) or hasattr(thing, "flat"):
        tell_out_of_bounds(_parameters_of(thing), settings)
    begun, runs = [_started(thing, part, initial_states, settings) for part in parts], []
    for part, start in zip(parts, begun, strict=True):
        if not (isinstance(thing, Block) or hasattr(thing, "flat")):
            runs.append(contender.free_run(part))
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InaccurateWarning)  # told below
            given = start.estimate.values if start else None
            runs.append(simulate(thing, part, parameters=settings, start=given, step=step, method=method))
    accuracy = max((r.accuracy for r in runs if getattr(r, "accuracy", None)), key=lambda a: a.error, default=None)
    record, result, begun = joined(parts), joined(runs), [one for one in begun if one]
    tell_columns([record], (*contender.inputs, *contender.outputs), contender.name)
    tell_between(contender.inputs)
    starts = [*cuts(parts), *map(str, begun)]
    for note in [*(f"{contender.name}: {note}" for note in notes), *starts]:
        mark(err, "note", note)
    run = Trajectory(contender.name, record.name, FREE_RUN, result)
    beyond = [d.extrapolates for d in domain_shares([contender], [record], (), [run]) if d.extrapolates]
    for sentence in beyond:
        mark(err, "careful:", sentence)
    rows = [_row_of(signal, record, result[signal.name]) for signal in contender.outputs]
    if output:
        output.parent.mkdir(parents=True, exist_ok=True)
        write_record(result, output)
    if as_json:
        keys = ("output", "unit", "minimum", "maximum", "rmse")
        outputs = [dict(zip(keys, row, strict=True)) for row in rows]
        answer = {"model": contender.name, "inputs": between(contender.inputs), "outputs": outputs}
        told = [*notes, *starts, *beyond]
        answer |= {"notes": told} if told else {}
        answer |= {"starts": [asdict(one.estimate) for one in begun]} if begun else {}
        print_json(answer | ({"accuracy": accuracy.as_data()} if accuracy else {}))
        return
    table(f"{contender.name} on {record.name}", ["output", "unit", "minimum", "maximum", "RMSE"], rows)
    if accuracy:
        mark(out, "note" if accuracy.reached else "warning", str(accuracy))
    if output:
        out.print(f"written: {output}")


def _row_of(signal, record, values: np.ndarray) -> list:
    """Name, unit, smallest, largest and RMSE of a simulated output; NaN for what there is not."""
    from hydrotwin.comparison import errors_of

    given, rmse = values[np.isfinite(values)], np.nan
    if lost := len(values) - len(given):
        mark(err, "note", f"{signal.name}: the model gives no number in {lost} of {len(values)} samples.")
    known = np.isfinite(record[signal.name]) if signal.name in record else np.zeros(len(values), dtype=bool)
    if known.any() and np.isfinite(values[known]).all() and compatible(record.units[signal.name], signal.unit):
        rmse = errors_of(record[signal.name], values).rmse
    extent = [float(given.min()), float(given.max())] if len(given) else [np.nan, np.nan]
    return [signal.name, signal.unit, *extent, rmse]


def _started(thing, record, initial_states: str, settings: Mapping[str, float]):
    """Where a model starts, as `compare` has it start; None where there is nothing to tell of it."""
    from hydrotwin.comparison import PhysicalContender, as_contender
    from hydrotwin.comparison.starts import start_of
    from hydrotwin.identification.beginning import check_initial_states

    how = check_initial_states(initial_states, "simulate")
    own = PhysicalContender(thing, parameters=settings) if hasattr(thing, "flat") else as_contender(thing)
    return start_of(own, record, how)[1]


def _parameters_of(thing) -> Sequence:
    return getattr(getattr(thing, "flat", thing), "parameters", ())


def tell_out_of_bounds(parameters, settings: Mapping[str, float]) -> None:
    """A value outside the bounds of its parameter is run, and told."""
    for p in parameters:
        low, high = p.bounds
        if p.name in settings and not low <= settings[p.name] <= high:
            got = f"(got {settings[p.name]:g} {p.unit})"
            mark(err, "note", f"--set {p.name}: outside its bounds {got}. They are {low:g} to {high:g}.")


def modelica(
    model: ModelArgument,
    output: Annotated[Path | None, typer.Option("--out", metavar="FILE.mo", help="write to a file")] = None,
) -> None:
    """Write a physical model as Modelica source."""
    from hydrotwin.models.language.modelica import modelica_text

    if output:
        check_file(output, ".mo")
    thing = physical(model, "modelica")
    text = modelica_text(getattr(thing, "opened", thing))
    if output:
        write_whole(output, text)
        err.print(f"written: {output}")
    else:
        typer.echo(text)


def linearize(
    model: ModelArgument,
    at: Annotated[
        list[str] | None, typer.Option("--at", metavar="NAME=VALUE", help="input or state, SI or with its unit")
    ] = None,
    steady: Annotated[bool, typer.Option("--steady", help="move the states not given until nothing changes")] = False,
    output: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="write a page with the Bode figure")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Linearise a physical model: poles, damping, hydraulic natural frequency, Bode figure.

    What is not given follows from the static equilibrium of the model's start.
    """
    from hydrotwin.models.language.linearisation import linearise, modes, operating_point

    if output:
        check_folder(output)
    thing = physical(model, "linearize")
    if thing.flat.black_box:
        raise DeclarationError(f"linearize: '{model}' is an FMU, which has no equations to linearize.")
    values = settings_from(at, "--at", [wanted(s) for s in (*thing.flat.inputs, *thing.flat.states)])
    system, found = linearise(thing, values, steady=steady), modes(thing, values, steady=steady)
    oil = found.hydraulic
    if output:
        from hydrotwin.report.linearisation import write_linearisation

        flat = thing.flat
        units = {s.name: s.unit for s in (*flat.inputs, *flat.outputs, *flat.states)}
        point = operating_point(thing, values, steady=steady)
        write_linearisation(system, found, output, units=units, point={**point.inputs, **point.states})
    if as_json:
        labels = {"inputs": system.input_labels, "outputs": system.output_labels, "states": system.state_labels}
        rows = [
            {"pole": [m.pole.real, m.pole.imag], "frequency_hz": m.frequency, "damping": m.damping,
             "participation": dict(m.participation)}
            for m in found.modes
        ]  # fmt: skip
        matrices = {name: getattr(system, name) for name in "ABCD"}
        frequency = oil.frequency if oil else None
        print_json({"model": thing.name, **labels, **matrices, "modes": rows, "hydraulic_frequency_hz": frequency})
        return
    rows = [
        [f"{m.pole:.5g}", float(m.frequency), float(m.damping), max(m.participation, key=m.participation.get)]
        for m in found.modes
    ]
    table(f"{thing.name}: modes", ["pole [rad/s]", "frequency [Hz]", "damping", "mostly"], rows)
    if oil:
        out.print(f"hydraulic natural frequency: {oil.frequency:.4g} Hz, damping ratio {oil.damping:.3g}")
    if output:
        out.print(f"written: {output}/linearisation.html")
