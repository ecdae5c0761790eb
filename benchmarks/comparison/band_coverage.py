"""Do the bands of identified models cover what sensors read, and are they flagged where something is missing?

``python -m benchmarks.comparison.band_coverage --help``, from the root of the repository.

The truth is the rig of tests/rig, which shares no code with hydrotwin. A case identifies the parameters of a shipped
machine on three recordings, runs `compare` on two others and counts, by output, how much of what the sensors read lies
in the 95 % band. Half of the cases have the right structure; in the others the truth has one effect that the model
lacks. Cases are drawn from their seed alone, and what was found of each is kept in OUT as JSON and not made twice.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.gap.cases import Case, Made, make, single_effects
from benchmarks.gap.severity import FIT, HELD_OUT, Unreachable, bed, steps_of
from hydrotwin.comparison import FREE_RUN, PhysicalContender, compare
from hydrotwin.comparison.band import bands_of
from hydrotwin.identification import Fit, Spread, deviations, identify
from hydrotwin.models.language.provenance import SPREAD
from hydrotwin.models.language.writing import write_whole
from hydrotwin.records import Record
from hydrotwin.simulation import simulate_many
from tests import rig

SEED, CASES = 801, 40  # of the figures in docs/validation.md; 701 and on were looked at while bands were made
WANTED = (0.90, 0.99)  # coverage of a 95 % band that is right
MACHINES = ("cehA", "spool_valve")
STYLES = ("drive", "steps", "ramps", "sweep", "strokes", "sines", "chirp")
SENSORS = ("all", "position+pressures", "position")
BITS = (0, 12, 14, 16)  # of the converters; 0: no steps
LOUDER = (1.0, 0.3, 3.0)  # times the usual noise of the sensors
SEVERITIES = (5.0, 30.0)  # gap that a missing effect makes, times the noise
SECONDS, DRAWS = 20.0, 1000
STARTS = ("measured", "auto")  # `compare --initial-states`
RIGHT, MISSING = "right", "missing"


@dataclasses.dataclass(frozen=True)
class BandCase:
    """A case, and how loud its sensors are, times the usual."""

    case: Case
    louder: float = 1.0

    @property
    def file(self) -> str:
        """Where its answer is kept."""
        return f"{self.case.name}/{self.louder:g}.json".replace("/", "~")


def right_cases(count: int, seed: int) -> list[BandCase]:
    """So many cases in which nothing is missing, of both machines in turn."""
    return [
        BandCase(Case(machine, "none", (), 0.0, sensors, style, own, SECONDS, bits), louder)
        for machine, own, sensors, style, bits, louder in _drawn(count, seed)
    ]


def missing_cases(count: int, seed: int) -> list[BandCase]:
    """So many cases with one effect that the model lacks; each machine goes through all that it can have."""
    found, used = [], dict.fromkeys(MACHINES, 0)
    for machine, own, sensors, style, bits, _ in _drawn(count, seed):
        effects = single_effects(machine)
        effect = effects[(own + 3 * used[machine]) % len(effects)]
        severity = SEVERITIES[used[machine] % len(SEVERITIES)]
        used[machine] += 1
        found.append(BandCase(Case(machine, "single", (effect,), severity, sensors, style, own, SECONDS, bits)))
    return found


def _drawn(count: int, seed: int):
    for k in range(count):
        random = np.random.default_rng([seed, k])
        sensors, style, bits, louder = (random.choice(choices) for choices in (SENSORS, STYLES, BITS, LOUDER))
        yield MACHINES[k % len(MACHINES)], seed + k, str(sensors), str(style), int(bits), float(louder)


def recordings(one: BandCase) -> tuple[Made | None, list[Record], list[Record]]:
    """Recordings to fit and to judge. Raises Unreachable where the effect cannot be of that severity."""
    case = one.case
    if case.effects:
        made = make(case)
        return made, list(made.fit), list(made.held_out)
    machine = rig.machine_of(case.machine)
    units = {**dict(zip(machine.outputs, machine.units, strict=True)), machine.input: machine.input_unit}
    sigmas = {n: one.louder * s for n, s in rig.sensor_noise(case.machine).items() if n in case.outputs}
    records = []
    for k in range(FIT + HELD_OUT):
        steps = steps_of(case.machine, case.bits)
        columns = bed(*case.bed_key).recorded((), k, noise=sigmas, quantisation=steps, seed=1000 * case.seed + k)
        names = (machine.input, *case.outputs)
        signals = {n: columns[n] for n in names}
        records.append(Record(columns["time"], signals, {n: units[n] for n in names}, f"record_{k + 1}"))
    return None, records[:FIT], records[FIT:]


def answer(one: BandCase, with_draws: bool = True) -> dict:
    """What the bands of a case do, as data."""
    import hydrotwin

    told = {"case": one.case.name, "kind": MISSING if one.case.effects else RIGHT, "louder": one.louder}
    try:
        _, fit_on, judged_on = recordings(one)
    except Unreachable as reason:
        return told | {"unreachable": str(reason)}
    model = hydrotwin.load(one.case.machine)
    model = model.with_parameters(one.case.settings) if one.case.settings else model
    began = time.process_time()
    fit = identify(model, fit_on)
    seconds = time.process_time() - began
    contender = PhysicalContender(fit.flat, "fitted", provenance={SPREAD: Spread.of(fit).told()})
    trusted = {band.output: bool(band.trusted) for band in bands_of(contender)}
    rows = {name: {"trusted": trusted.get(name, False)} for name in one.case.outputs}
    for how in STARTS:
        found = compare([contender], judged_on, modes=[FREE_RUN], repeats=0, initial_states=how)
        for score in found.scores:
            rows[score.output].setdefault(how, []).append(score.coverage)
        for band in found.entrants[0].bands:  # as the report says it, having seen what was measured
            if band.output in rows:
                rows[band.output]["trusted"] &= bool(band.trusted)
    told |= {"outputs": rows, "seconds": seconds}
    drawn = with_draws and told["kind"] == RIGHT
    return told | ({"draws": _by_draws(fit, judged_on[0], next(iter(rows)))} if drawn else {})


def _by_draws(fit: Fit, record: Record, output: str) -> dict:
    """The deviation that the parameters alone make, by draws of them and by sensitivities: rms over the run."""
    spread = Spread.of(fit)
    spread = dataclasses.replace(spread, noise={}, left=dict.fromkeys(spread.left, 0.0))
    draws = np.array([fit.values[n] for n in spread.names]) + _drawn_from(spread.covariance)
    own = {p.name: p.bounds for p in fit.flat.parameters}
    outside = [n for n, d in zip(spread.names, draws.T, strict=True) if d.min() < own[n][0] or d.max() > own[n][1]]
    draws = np.clip(draws, *np.array([own[n] for n in spread.names]).T)
    began = time.process_time()
    many = simulate_many(fit.flat, [dict(zip(spread.names, d, strict=True)) for d in draws], record)
    seconds = time.process_time() - began
    whole = np.isfinite(many[output]).all(axis=1)
    drawn, exact = many[output][whole].std(axis=0), deviations(fit.flat, record, spread)[output]
    ratio = float(np.sqrt(np.mean(drawn**2)) / np.sqrt(np.mean(exact**2)))
    return {"output": output, "ratio": ratio, "seconds": seconds, "lost": int((~whole).sum()), "outside": outside}


def _drawn_from(covariance: np.ndarray) -> np.ndarray:
    """Normal draws (DRAWS, np) about zero, by way of the correlation: parameters in SI are of very different size."""
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.random.default_rng(0).normal(size=(DRAWS, len(size))) @ root.T * size


def table(rows: Sequence[Mapping]) -> str:
    """What was found, in Markdown."""
    head = "| starts | machine, cases | outputs | in 90 to 99 % | median | lowest | highest |"
    lines, right = [head, "|---|---|---|---|---|---|---|"], [r for r in rows if r["kind"] == RIGHT and "outputs" in r]
    groups = [*((m, [r for r in right if r["case"].startswith(m)]) for m in MACHINES), ("both", right)]
    for how in STARTS:
        for name, some in groups:
            inside = [np.mean(o[how]) for r in some for o in r["outputs"].values() if how in o]
            if inside:
                good = np.mean([_good(c) for c in inside])
                numbers = [f"{100 * v:.1f} %" for v in (good, np.median(inside), min(inside), max(inside))]
                lines.append(f"| {how} | {name}, {len(some)} | {len(inside)} | {' | '.join(numbers)} |")
    if right:
        doubted = sum(_flagged(r) for r in right)
        lines += ["", f"Right structure: {doubted} of {len(right)} cases have a band that is said not to be trusted."]
        draws = [r["draws"] for r in right if "draws" in r]
        lines += [_draws_told(draws)] if draws else []
    missing = [r for r in rows if r["kind"] == MISSING and "outputs" in r]
    return "\n".join([*lines, *(_missing_told(missing) if missing else ()), ""])


def _good(coverage: float) -> bool:
    return bool(WANTED[0] <= coverage <= WANTED[1])


def _flagged(row: Mapping) -> bool:
    """Whether the band of an output is said not to be trusted."""
    return any(not o["trusted"] for o in row["outputs"].values())


def _draws_told(draws: Sequence[Mapping]) -> str:
    inside = [d for d in draws if not d["outside"]]
    ratios, seconds = [d["ratio"] for d in inside], [d["seconds"] for d in draws]
    found = f"median {np.median(ratios):.3f}, {min(ratios):.3f} to {max(ratios):.3f}" if inside else "none"
    return (
        f"{DRAWS} draws over sensitivities, parameters alone, {len(inside)} of {len(draws)} cases, in which no draw "
        f"leaves the bounds: {found}. Processor time {np.median(seconds):.2g} s a case, {max(seconds):.2g} s at most."
    )


def _missing_told(missing: Sequence[Mapping]) -> list[str]:
    """How many were flagged, and what became of the others with starts estimated."""
    quiet = [r for r in missing if not _flagged(r)]
    lines = ["", f"One effect missing: {len(missing) - len(quiet)} of {len(missing)} cases flagged.", ""]
    inside = [(r["case"], n, np.mean(o[STARTS[-1]])) for r in quiet for n, o in r["outputs"].items() if STARTS[-1] in o]
    good = [one for one in inside if _good(one[-1])]
    lines += [f"Of the {len(quiet)} others {len(good)} of {len(inside)} outputs are covered 90 to 99 %. The rest:", ""]
    return lines + [f"- {case}, {name}: {100 * c:.1f} %" for case, name, c in inside if not _good(c)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the cases that are not there yet and print the table. Returns 0, or 1 when a case failed."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=CASES, help="of each kind: right structure, one effect missing")
    parser.add_argument("--seed", type=int, default=SEED, help="of the first case")
    parser.add_argument("--kind", choices=(RIGHT, MISSING), help="only these")
    parser.add_argument("--out", type=Path, default=Path("out/band_coverage"), help="folder of the answers")
    told = "without the check by draws, which takes most of the time; such a case counts as made"
    parser.add_argument("--no-draws", dest="draws", action="store_false", help=told)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    made = {RIGHT: right_cases(options.cases, options.seed), MISSING: missing_cases(options.cases, options.seed)}
    rows, failed = [], 0
    for one in (one for kind, some in made.items() if options.kind in (None, kind) for one in some):
        path = options.out / one.file
        if not path.exists():
            try:
                write_whole(path, json.dumps(answer(one, options.draws)))
            except Exception as error:
                failed += 1
                print(f"{one.case.name}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
                continue
            print(_line(json.loads(path.read_text(encoding="utf-8"))), flush=True)
        rows.append(json.loads(path.read_text(encoding="utf-8")))
    text = table(rows)
    write_whole(options.out / "table.md", text)
    print(text)
    return int(failed > 0)


def _line(row: Mapping) -> str:
    if "outputs" not in row:
        return f"{row['case']}: {row['unreachable']}"
    said = [f"{n} {_percent(o)}{'' if o['trusted'] else '!'}" for n, o in row["outputs"].items()]
    return f"{row['case']} x{row['louder']:g} {row['seconds']:.0f} s: {', '.join(said)}"


def _percent(output: Mapping) -> str:
    return "/".join(f"{100 * np.mean(output[how]):.1f}" for how in STARTS if how in output)


if __name__ == "__main__":
    sys.exit(main())
