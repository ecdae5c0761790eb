"""identify and friction: physical models from recordings."""

from __future__ import annotations

import dataclasses
import math
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from hydrotwin import __version__
from hydrotwin.models.language.credibility import recording_rows
from hydrotwin.models.language.model_file import write_model_file
from hydrotwin.models.language.provenance import TRAIN, of_earlier_fits
from hydrotwin.models.language.quantities import Wanted, in_unit, wanted
from hydrotwin.records import Reading, Record, require, row_of
from hydrotwin.records.between import between

from ..loading import origin
from .recordings import check_set, read_all, reads, require_columns, tell_columns
from .shared import (
    InterpolationOption,
    JsonOption,
    ModelArgument,
    RecordsArgument,
    StepOption,
    ValidateOption,
    bounds_from,
    check_file,
    check_folder,
    examples,
    interpolation_from,
    mark,
    out,
    print_json,
    progress_bar,
    settings_from,
    table,
    tell_between,
)
from .showing import physical

LEFT_OUT = 20  # stretches of a friction test on the screen


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command(epilog=examples("hydrotwin identify cehA train_*.csv --validate validate_*.csv --out model.toml"))(
        reads(identify)
    )
    app.command(epilog=examples("hydrotwin friction friction_test.csv --out friction"))(reads(friction))


def identify(
    model: ModelArgument,
    records: RecordsArgument,
    output: Annotated[Path, typer.Option("--out", metavar="MODEL.toml", help="the model file to write")],
    free: Annotated[list[str] | None, typer.Option("--free", metavar="GLOB", help="parameters to identify")] = None,
    validate: ValidateOption = None,
    fit_outputs: Annotated[list[str] | None, typer.Option("--output", metavar="NAME", help="outputs to fit")] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option("--noise", metavar="OUTPUT=NUMBER", help="what may be left of an output, SI or with its unit"),
    ] = None,
    weights: Annotated[
        str, typer.Option(help="noise, residual (what the model leaves), or auto: residual where noise is out of reach")
    ] = "auto",
    loss: Annotated[
        str, typer.Option(help="linear, soft_l1, huber, or auto: linear, without samples that stand alone")
    ] = "auto",
    initial_states: Annotated[str, typer.Option(help="auto, fixed or free")] = "auto",
    starts: Annotated[int, typer.Option(min=1, help="starts to try at most")] = 4,
    bounds: Annotated[
        list[str] | None,
        typer.Option("--bounds", metavar="PATH=LOW:HIGH", help="limits of a free parameter, SI or with its unit"),
    ] = None,
    step: StepOption = None,
    method: Annotated[str, typer.Option(help="auto, explicit, implicit or vm")] = "auto",
    report: Annotated[Path | None, typer.Option("--report", metavar="DIR", help="write a report on the fit")] = None,
    interpolation: InterpolationOption = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Identify the parameters of a physical model by nonlinear least squares."""
    from hydrotwin.identification import identify

    check_file(output, ".toml", sources=[Path(model.rpartition("@")[2])])
    if report:
        check_folder(report)
    thing = physical(model, "identify")
    flat = thing.flat
    check_set(reading, flat)
    errors = settings_from(noise, "--noise", [wanted(s, difference=True) for s in flat.outputs])
    limits = bounds_from(bounds, [wanted(p) for p in flat.parameters])
    measured = [s.name for s in flat.outputs]
    train, judged = (read_all(part, reading, measured) for part in (records, validate))
    fitted = [s for s in flat.outputs if not fit_outputs or s.name in fit_outputs]
    for record in (*train, *judged):
        require(record, [*flat.inputs, *(s for s in fitted if s.name in record)], thing.name)
    tell_columns([*train, *judged], (*flat.inputs, *flat.outputs), thing.name, interpolation_from(interpolation))
    with progress_bar() as bar:
        row = bar.add_task("identify", total=None)

        def told(stage: str, iteration: int, cost: float) -> None:
            bar.update(row, description=f"identify {thing.name}: {stage}, iteration {iteration}, cost {cost:.6g}")

        fit = identify(
            thing, train, free=free, validate=judged, outputs=fit_outputs, noise=errors,
            weights=weights, loss=loss, initial_states=initial_states, starts=starts,
            bounds=limits, step=step, method=method,
            progress=None if as_json else told, interpolation=interpolation_from(interpolation),
        )  # fmt: skip
    from hydrotwin.identification.evidence import evidence_of_fit

    provenance, evidence = fit_provenance(fit, train, judged), evidence_of_fit(fit, train, judged)
    write_model_file(output, origin(model), fit.flat, provenance, thing.additions, evidence)
    if report:
        from hydrotwin.comparison import PhysicalContender, compare
        from hydrotwin.report import write_report

        start = unmeasured_starts(fit)
        as_fitted = between(fit.flat.inputs)
        contenders = [
            PhysicalContender(thing.with_inputs(as_fitted), f"{thing.name} as given", start=start),
            PhysicalContender(fit.flat, "identified", start=start),
        ]
        comparison = compare(contenders, judged or train, train_records=train, title=f"Identification of {thing.name}")
        write_report(comparison, report, fits=[fit])
    if as_json:
        print_json(fit_answer(fit))
        return
    print_fit(fit, output)
    if ".py:" in model:
        out.print(f"Use it with its code: {origin(model)}@{output}")


def unmeasured_starts(fit) -> dict[str, dict[str, float]]:
    """By recording, the estimated start states that no output measures: nothing else tells them."""
    hidden = {s.name for s in fit.flat.states if s.measured_by is None}
    return {r.name: {name: value for name, value in r.start.items() if name in hidden} for r in fit.records}


def fit_provenance(fit, train: list[Record], judged: list[Record]) -> dict:
    """What the model file says about its making."""
    from hydrotwin.identification.evidence import names_of

    names = names_of(fit.flat)
    return {
        "made_by": f"hydrotwin {__version__}",
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        **fit.flat.provenance,
        "recordings": [
            *(row_of(r, names, TRAIN) for r in train),
            *recording_rows(judged, "validate"),
            *of_earlier_fits(fit.flat.provenance),
        ],
    }


def fit_answer(fit) -> dict:
    """The fit as data."""
    rows = ("name", "value", "start", "sigma", "unit", "bounds", "at_bound")
    return {
        "model": fit.name,
        "converged": fit.converged,
        "message": fit.message,
        "chi2_per_sample": fit.chi2_per_dof,
        "inputs": between(fit.flat.inputs),
        "parameters": [{key: getattr(p, key) for key in rows} for p in fit.parameters],
        "correlation": fit.correlation,
        "noise": dict(fit.noise),
        "rmse": fit.rmse,
        "validation_starts": "estimated" if estimated_starts(fit) else "as measured",
        "accuracy": fit.accuracy.as_data() if fit.accuracy else None,
        "findings": [str(f) for f in fit.findings],
        "seconds": fit.seconds,
    }


def estimated_starts(fit) -> str:
    """That errors on validation recordings are of starts that were estimated there; "" where they are not."""
    judged = any(r.role == "validate" for r in fit.residuals)
    if not judged or not fit.flat.states or fit.settings.get("initial_states") == "fixed":
        return ""
    return (
        "where validation recordings begin was estimated from their samples, and their RMSE is from there. compare "
        "begins at their first samples; its --initial-states auto estimates, too."
    )


def print_fit(fit, path: Path) -> None:
    """The fit for a reader."""
    rows = [
        [p.name, float(p.start), float(p.value), _plus_minus(p.sigma), p.unit, "at its bound" if p.at_bound else ""]
        for p in fit.parameters
    ]
    tell_between(fit.flat.inputs)
    table(f"{fit.name}: {fit.message}", ["parameter", "start", "value", "sigma", "unit", ""], rows)
    left = [
        [r.record, r.role, r.output, float(r.rmse), float(r.noise), r.unit, math.sqrt(r.chi2_per_sample)]
        for r in fit.residuals
    ]
    out.print()
    table("what is left", ["recording", "role", "output", "RMSE", "noise", "unit", "ratio"], left)
    if started := estimated_starts(fit):
        mark(out, "note", started)
    for finding in fit.findings:
        if finding.kind != "unexplained":  # the table has said so, output by output
            mark(out, "note", str(finding))
    if fit.accuracy and fit.accuracy.reached:
        mark(out, "note", f"the runs are {fit.accuracy}")
    unexplained = dict.fromkeys(r.output for r in fit.residuals if r.role == "train" and not r.explained)
    if unexplained:
        mark(out, "note", f"not explained: {', '.join(unexplained)}. Look for a missing effect, or free more.")
    out.print(f"chi-square per sample {fit.chi2_per_dof:.3f}, {fit.seconds:.1f} s. Written: {path}")


def _plus_minus(sigma: float) -> str:
    return f"± {sigma:.2g}" if math.isfinite(sigma) else "unknown"


def force_of(text: str | float) -> float:
    """The force of ``--load`` in N."""
    return in_unit(text, Wanted("--load", "N"), "--load 2.5kN")


def friction(
    records: RecordsArgument,
    velocity: Annotated[str, typer.Option(metavar="NAME", help="column of the velocity")] = "velocity",
    force: Annotated[str, typer.Option(metavar="NAME", help="column of the force")] = "force",
    load: Annotated[
        float | None,
        typer.Option(parser=force_of, metavar="FORCE", help="constant force beside friction, where it is known: 2.5kN"),
    ] = None,
    output: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="write a page with the curve")] = None,
    as_json: JsonOption = False,
    reading: Reading | None = None,
) -> None:
    """Fit the Stribeck curve to a friction test at constant speeds (C-EHA paper, Fig. 7 and Table 1)."""
    from hydrotwin.identification.constant_speed import friction_test

    if output:
        check_folder(output)
    read = read_all(records, reading)
    require_columns(read, (velocity, force), " Name the columns with --velocity and --force.")
    fit = friction_test(read, velocity=velocity, force=force, load=load)
    if output:
        from hydrotwin.report.friction import write_friction_test

        write_friction_test(fit, output, recordings=[r.name for r in read])
    if as_json:
        keys = ("name", "value", "sigma", "interval", "unit")
        rows = [{key: getattr(c, key) for key in keys} for c in fit.told]
        dropped = [dataclasses.asdict(stretch) for stretch in fit.dropped]
        print_json({"coefficients": rows, "rmse_n": fit.rmse, "findings": fit.findings, "dropped": dropped})
        return
    print_friction(fit)
    if output:
        out.print(f"written: {output}/friction.html")


def print_friction(fit) -> None:
    """The coefficients for a reader."""
    rows = [[c.name, float(c.value), f"{c.interval[0]:.4g} ... {c.interval[1]:.4g}", c.unit] for c in fit.told]
    title = f"Stribeck curve through {len(fit.velocity)} speeds, RMSE {fit.rmse:.3g} N"
    table(title, ["coefficient", "value", f"{fit.confidence:.0%} interval", "unit"], rows)
    for finding in fit.findings:
        mark(out, "note", str(finding))
    for stretch in fit.dropped[:LEFT_OUT]:
        mark(out, "left out", str(stretch))
    if len(fit.dropped) > LEFT_OUT:
        mark(out, "left out", f"{len(fit.dropped) - LEFT_OUT} more stretches: on the page (--out) and in --json.")
