"""Identification from starts that are off by 30 % in every sign pattern tried, on recordings of the truth rig.

    python benchmarks/identification/hard_starts.py [cehA|spool_valve] [SEED]

For each pattern: the cost over that of a fit started at the truth, the largest error in the fit's own sigmas, the
validation RMSE of the position over the sensor noise, seconds. Right is: cost within 1 %, errors below 4 sigma, RMSE at
most 1.05 times the noise. The rig has no hidden effect here; sensors have their usual noise.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import hydrotwin
from hydrotwin.identification import identify
from hydrotwin.records import Record
from tests import rig

POSITION = {"cehA": "arm_angle", "spool_valve": "position"}
FACTOR = 0.3


def patterns(names: list[str]) -> list[tuple[int, ...]]:
    """Each parameter alone, all volumes together, then signs of all parameters at once."""
    random, count = np.random.default_rng(0), len(names)
    volumes = [tuple(sign * ("volume" in name) for name in names) for sign in (1, -1)]
    alone = [tuple(sign if k == j else 0 for k in range(count)) for j in range(count) for sign in (1, -1)]
    whole = [tuple(random.choice([-1, 1], count).tolist()) for _ in range(8)]
    return alone + [v for v in volumes if any(v)] + whole


def recordings(machine: str, kind: str, count: int, seed: int) -> list[Record]:
    units = dict(zip(rig.MACHINES[machine].outputs, rig.MACHINES[machine].units, strict=True))
    units[rig.MACHINES[machine].input] = rig.MACHINES[machine].input_unit
    return [
        Record(c["time"], {k: v for k, v in c.items() if k != "time"}, units, f"{kind}_{k}")
        for k, c in enumerate(rig.clean_recordings(machine, kind, count, seed=seed), 1)
    ]


def main(machine: str = "cehA", seed: int = 2) -> None:
    model = hydrotwin.load(machine)
    free = [p for p in model.flat.parameters if p.free]
    train, validate = recordings(machine, "train", 3, seed), recordings(machine, "validate", 2, seed)
    best = identify(model, train, validate=validate)
    noise = rig.sensor_noise(machine)[POSITION[machine]]
    print(f"{machine}, seed {seed}: {', '.join(p.name for p in free)}")
    print(f"{'pattern':<26}{'cost/truth':>11}{'worst sigma':>13}{'RMSE/noise':>12}{'seconds':>9}")
    right = 0
    chosen = patterns([p.name for p in free])
    for signs in chosen:
        start = {p.name: p.value * (1 + FACTOR * s) for p, s in zip(free, signs, strict=True)}
        began = time.perf_counter()
        fit = identify(model, train, validate=validate, start=start)
        ratio = fit.cost / best.cost
        worst = max(abs(fit.parameter(p.name).value - p.value) / fit.parameter(p.name).sigma for p in free)
        rmse = fit.rmse["validate"][POSITION[machine]] / noise
        good = ratio < 1.01 and worst < 4 and rmse <= 1.05
        right += good
        shown = " ".join("+0-"[1 - s] for s in signs)
        seconds = time.perf_counter() - began
        print(
            f"{shown:<26}{ratio:>11.5f}{worst:>13.2f}{rmse:>12.3f}{seconds:>9.1f}{'' if good else '  WRONG'}",
            flush=True,
        )
    print(f"right: {right} of {len(chosen)}")


if __name__ == "__main__":
    main(*(sys.argv[1:2] or ["cehA"]), *(int(s) for s in sys.argv[2:3]))
