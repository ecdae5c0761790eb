"""demo: the whole main job on the recordings that ship with the project."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

import hydrotwin.models
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.model_file import read_model_file, write_model_file
from hydrotwin.models.language.writing import write_whole
from hydrotwin.records import Record

from ..loading import load
from .comparing import print_comparison
from .discovering import print_discovery, telling
from .exporting import equations_told, given_starts
from .fitting import fit_provenance, print_fit, print_friction
from .recordings import read_all
from .shared import check_folder, duration_of, examples, mark, out, progress_bar
from .writing import Made, write_discovery

IDENTIFIED, COMPLETED = "identified", "with the named effect"
EXAMPLES = Path(hydrotwin.models.__file__).parents[1] / "examples"
LEARNED = {"cehA": ("command", "arm_angle"), "spool_valve": ("current", "position")}  # input and output to learn
FORMULA = {"cehA": ["eq17"]}  # published formulas to put beside
CRITERIA = {  # errors: 3 times the noise of the first sensor, 2 times that of a pressure; then lag and band
    "cehA": (
        "arm_angle.rmse < 0.017 deg",
        "pressure_cap.rmse < 0.4 bar",
        "pressure_rod.rmse < 0.4 bar",
        "arm_angle.lag < 10 ms",
        "pressure_cap.coverage in [0.9, 0.99]",
    ),
    "spool_valve": (
        "position.rmse < 0.3 mm",
        "pressure_a.rmse < 0.4 bar",
        "pressure_b.rmse < 0.4 bar",
        "position.lag < 10 ms",
        "pressure_a.coverage in [0.9, 0.99]",
    ),
}
TAGS = "validate_{run}"  # conditions in the names of the recordings that judge
RATES = {"cehA": ["arm_angle"], "spool_valve": ["position"]}  # scored with their slope, as Fig. 12 of the C-EHA paper


def register(app: typer.Typer) -> None:
    """Add the command of this file."""
    app.command(epilog=examples("hydrotwin demo --out out/demo"))(demo)


def demo(
    output: Annotated[Path, typer.Option("--out", metavar="DIR", help="where everything is written")] = Path(
        "out/demo"
    ),
    machines: Annotated[
        list[str] | None, typer.Option("--machine", help="cehA or spool_valve; both by default")
    ] = None,
    budget: Annotated[
        float, typer.Option(parser=duration_of("--budget", 0.1), metavar="TIME", help="time for each network")
    ] = 30.0,
) -> None:
    """Identify, learn, export, find what is missing, compare and report, on the shipped recordings."""
    check_folder(output)
    began, passed = time.perf_counter(), True
    for machine in machines or list(LEARNED):
        if machine not in LEARNED:
            raise DataError(f"demo: no recordings of '{machine}'. There are {' and '.join(LEARNED)}.")
        passed &= run_machine(machine, output / machine, budget)
    pages = f"{output}/*/report.html and {output}/*/gap/report.html"
    mark(out, "done", f"in {time.perf_counter() - began:.0f} s. Open {pages} in a browser.", "bold")
    if not passed:
        raise typer.Exit(1)


def run_machine(machine: str, folder: Path, budget: float) -> bool:
    """Recordings in; identified model, network, FMUs, the missing effect and report out; whether it is good enough."""
    from hydrotwin.comparison import Tags

    recordings = EXAMPLES / machine / "recordings"
    train = read_all(sorted(recordings.glob("train_*.csv")))
    judging = sorted(recordings.glob("validate_*.csv"))
    validate = [Tags(TAGS).put(r, path) for r, path in zip(read_all(judging), judging, strict=True)]
    if not train or not validate:
        raise DataError(
            f"{recordings}: the recordings are missing. Make them with examples/{machine}/make_recordings.py."
        )
    folder.mkdir(parents=True, exist_ok=True)
    fit, identified = identify_machine(machine, folder, train, validate)
    for test in sorted(recordings.glob("friction_test*.csv")):
        fit_friction(machine, folder, test)
    network = learn_machine(machine, folder, train, budget)
    fmus = export_machine(machine, folder, identified, network)
    completed = find_missing(machine, folder / "gap", train, validate)
    return compare_all(machine, folder, (identified, completed, network, fmus), fit, train, validate)


def identify_machine(machine: str, folder: Path, train: list[Record], validate: list[Record]):
    """The fit, and the model as its file gives it back."""
    from hydrotwin.identification import identify
    from hydrotwin.identification.evidence import evidence_of_fit

    out.rule(f"{machine}: identify")
    fit = identify(load(machine), train, validate=validate, progress=True)
    provenance, evidence = fit_provenance(fit, train, validate), evidence_of_fit(fit, train, validate)
    path = write_model_file(folder / "model.toml", machine, fit.flat, provenance, evidence=evidence)
    print_fit(fit, path)
    return fit, load(str(path))


def fit_friction(machine: str, folder: Path, recording: Path) -> None:
    """The Stribeck curve of the constant-speed test."""
    from hydrotwin.identification.constant_speed import friction_test
    from hydrotwin.report.friction import write_friction_test

    out.rule(f"{machine}: friction test")
    fit = friction_test(read_all([recording]))
    write_friction_test(fit, folder, recordings=[recording.stem])
    print_friction(fit)


def learn_machine(machine: str, folder: Path, train: list[Record], budget: float):
    """A network from the same recordings, with a card and a band of what was held out of them."""
    from hydrotwin.learned import learn, write_block

    out.rule(f"{machine}: learn")
    column_in, column_out = LEARNED[machine]
    with progress_bar() as bar:
        row = bar.add_task("learn nn", total=None)
        network = learn(
            "nn", train, [column_in], [column_out], budget=budget,
            progress=lambda p: bar.update(row, description=f"learn nn: best free-run error {p.best:.4g} of the spread"),
        )  # fmt: skip
    write_block(network, folder / "network.toml")
    out.print(f"network: {network.description}")
    out.print(network.provenance["free_run"]["says"])
    return network


def export_machine(machine: str, folder: Path, identified, network) -> list:
    """FMUs of both, checked and read back."""
    from hydrotwin.comparison import as_contender
    from hydrotwin.export import check_fmu, export_fmu, read_fmu, reference_run

    out.rule(f"{machine}: export and check")
    answers = []
    for name, thing in (("identified", identified), ("network", network)):
        path = folder / f"{machine}_{name}.fmu"
        given, told = given_starts(thing, "measured"), equations_told(thing)
        known = read_model_file(folder / "model.toml").credibility if thing is identified else None
        export_fmu(thing, path, given=given, reference=reference_run(thing), equations=told, credibility=known)
        answer = check_fmu(path)
        failed = ", ".join(row.name for row in answer.failures)
        verdict = "all checks passed" if answer.passed else f"FAILED: {failed}"
        out.print(f"{path}: {path.stat().st_size / 1000:.0f} kB, {verdict}")
        answers.append(as_contender(read_fmu(path), f"{name}, as FMU"))
    return answers


def find_missing(machine: str, folder: Path, train: list[Record], validate: list[Record]):
    """The gap workflow: its report and files; the model with what was named, None when nothing was."""
    from hydrotwin.discovery.discover import discover

    out.rule(f"{machine}: what is missing")
    with telling(machine, silent=False) as told:
        found = discover(load(machine), train, validate=validate, progress=told)
    write_discovery(found, machine, folder, Made.of(found, train, validate))
    print_discovery(found, folder)
    return load(str(folder / "model.toml")) if found.steps else None


def compare_all(machine: str, folder: Path, models, fit, train: list[Record], validate: list[Record]) -> bool:
    """Everything side by side on the validation recordings, and the report; whether the best physics is good enough.

    models : identified, completed (None where nothing was named), network, FMUs. Criteria are about the completed
    model, else the identified one; criteria.xml has them as JUnit.
    """
    from hydrotwin.comparison import BlockContender, PhysicalContender, Wanted, acceptance, as_contender, compare, junit
    from hydrotwin.report import notices, write_report

    out.rule(f"{machine}: compare")
    identified, completed, network, fmus = models
    contenders = [
        PhysicalContender(load(machine), f"{machine} as given"),
        PhysicalContender(identified, IDENTIFIED),
        *([PhysicalContender(completed, COMPLETED)] if completed else []),
        BlockContender(network, kind="network", name="network"),
        *(as_contender(load(spec), spec) for spec in FORMULA.get(machine, [])),
        *fmus,
    ]
    title = f"{machine}: physical, learned and exported models"
    comparison = compare(contenders, validate, train_records=train, rates=RATES[machine], title=title)
    accepted = acceptance(comparison, Wanted(CRITERIA[machine], COMPLETED if completed else IDENTIFIED))
    paths = write_report(comparison, folder, fits=[fit], accepted=accepted)
    paths |= {"junit": folder / "criteria.xml"}
    write_whole(paths["junit"], junit(accepted, title, notices(comparison)))
    print_comparison(comparison, accepted)
    out.print(f"written: {', '.join(str(p) for p in paths.values())}")
    return accepted.passed
