"""Identification under many conditions, on recordings of the truth rig with nothing hidden: where does it break?

    python -m benchmarks.identification.stress [cehA|spool_valve|all] [GLOB over case names] [--seeds 3,4,5]

The true free parameters are random within 30 % of the model's defaults; the fit starts at the defaults. Right is: cost
at most 1 % above a fit that starts at the truth, every parameter within 4 of its own sigmas (or named in a finding as
not determined), validation RMSE of the position at most 1.05 times the noise.
"""

from __future__ import annotations

import argparse
import fnmatch
import time
from dataclasses import dataclass, field

import numpy as np

import hydrotwin
from hydrotwin.identification import identify
from hydrotwin.records import Record
from tests import rig

POSITION = {"cehA": "arm_angle", "spool_valve": "position"}
SUBSETS = {
    "cehA": {"position and speed": ("arm_angle", "motor_speed"), "position alone": ("arm_angle",)},
    "spool_valve": {
        "position and pressures": ("position", "pressure_a", "pressure_b"), "position alone": ("position",),
    },
}  # fmt: skip
DELAY = 0.018


@dataclass(frozen=True)
class Case:
    """What is different from three smooth recordings of 40 s at 100 Hz with all sensors."""

    name: str
    record: dict = field(default_factory=dict)
    outputs: tuple[str, ...] | None = None
    delayed: bool = False


def cases(machine: str) -> list[Case]:
    quantised = {name: 3 * sigma for name, sigma in rig.sensor_noise(machine).items()}
    chosen = [
        Case("smooth"),
        Case("steps", {"command": "steps"}),
        Case("ramps", {"command": "ramps"}),
        Case("sweep", {"command": "sweep"}),
        Case("jittered time", {"jitter": 0.3}),
        Case("quantised", {"quantisation": quantised}),
        Case("50 Hz", {"rate": 50.0}),
        Case("1 kHz, 15 s", {"rate": 1000.0, "duration": 15.0}),
        Case("15 s", {"duration": 15.0}),
    ]
    chosen += [Case(name, {}, outputs) for name, outputs in SUBSETS[machine].items()]
    if machine == "spool_valve":
        late = {"effects": {"dead_time": {"seconds": DELAY}}}
        chosen += [Case("dead time", late, None, True), Case("dead time, position alone", late, ("position",), True)]
    return chosen


def truth_of(model, seed: int) -> dict[str, float]:
    """True values of the free parameters: up to 30 % from the model's own."""
    random = np.random.default_rng(seed)
    return {p.name: p.value * (1 + random.uniform(-0.3, 0.3)) for p in model.flat.parameters if p.free}


def recordings(machine: str, kind: str, seed: int, truth: dict, case: Case) -> list[Record]:
    m = rig.MACHINES[machine]
    units = {**dict(zip(m.outputs, m.units, strict=True)), m.input: m.input_unit}
    keep = {m.input, *(case.outputs or m.outputs)}
    own, made = 1000 * seed + {"train": 0, "validate": 500}[kind], []
    while len(made) < {"train": 3, "validate": 2}[kind]:
        own += 1
        try:
            columns = rig.clean_recordings(machine, kind, 1, seed=own, parameters=truth, **case.record)[0]
        except RuntimeError:  # this draw cannot be kept inside the machine's span
            continue
        signals = {n: v for n, v in columns.items() if n in keep}
        made.append(Record(columns["time"], signals, units, f"{kind}_{len(made) + 1}"))
    return made


def judge(machine: str, case: Case, seed: int) -> str:
    """One row: cost over that of the fit from the truth, largest error in sigmas (and of that fit), RMSE, seconds."""
    model = hydrotwin.load(machine)
    truth = truth_of(model, seed)
    train, validate = (recordings(machine, kind, seed, truth, case) for kind in ("train", "validate"))
    known = {**truth, "solenoid.dead_time": DELAY} if case.delayed else truth
    best = identify(model, train, free=list(known), start=known, windows=(), starts=1, validate=validate)
    began, busy = time.perf_counter(), time.process_time()
    fit = identify(model, train, free=list(known), validate=validate)
    taken, busy = time.perf_counter() - began, time.process_time() - busy
    away = {n: abs(fit.values[n] - v) / fit.sigma[n] for n, v in known.items()}
    own = max(abs(best.values[n] - v) / best.sigma[n] for n, v in known.items())
    worst = max(away, key=lambda n: away[n] if np.isfinite(away[n]) else np.inf)
    widest = max(fit.sigma[n] / fit.values[n] for n in truth)
    ratio, rmse = fit.cost / best.cost, _rmse_over_noise(machine, fit, best)
    wrong = _wrong(fit, ratio, away, rmse)
    kinds = ",".join(dict.fromkeys(f.kind for f in fit.findings))
    return (
        f"{machine:<12}{case.name:<26}{seed:>3}{ratio - 1:>10.1e}{away[worst]:>8.2f}{own:>8.2f} "
        f"{worst.split('.')[-1]:<20}{widest:>8.1%}{rmse:>7.3f}{taken:>7.1f}{busy:>7.1f}  "
        f"{'WRONG ' + ' '.join(wrong) if wrong else 'right':<18} {kinds}"
    )


def _rmse_over_noise(machine: str, fit, best) -> float:
    """A quantised sensor has the noise that the fit from the truth leaves, not the one drawn."""
    position = POSITION[machine]
    noise = max(rig.sensor_noise(machine)[position], best.rmse["train"][position])
    return fit.rmse["validate"][position] / noise


def _wrong(fit, ratio: float, away: dict[str, float], rmse: float) -> list[str]:
    named = {p for f in fit.findings for p in f.parameters}
    missed = {n for n, s in away.items() if not s < 4}
    judged = {"cost": ratio > 1.01, "sigma": bool(missed - named), "rmse": rmse > 1.05}
    return [what for what, bad in judged.items() if bad]


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("machine", nargs="?", default="all")
    arguments.add_argument("cases", nargs="?", default="*")
    arguments.add_argument("--seeds", default="3,4,5")
    chosen = arguments.parse_args()
    print(
        f"{'machine':<12}{'case':<26}{'':>3}{'cost-1':>10}{'sigmas':>8}{'truth':>8} {'worst parameter':<20}"
        f"{'widest':>8}{'RMSE':>7}{'s':>7}{'cpu':>7}"
    )
    for machine in POSITION if chosen.machine == "all" else (chosen.machine,):
        for case in cases(machine):
            if not fnmatch.fnmatch(case.name, chosen.cases):
                continue
            for seed in (int(s) for s in chosen.seeds.split(",")):
                try:
                    print(judge(machine, case, seed), flush=True)
                except Exception as error:
                    print(f"{machine:<12}{case.name:<26}{seed:>3} {type(error).__name__}: {error}", flush=True)


if __name__ == "__main__":
    main()
