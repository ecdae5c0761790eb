"""Seconds to screen against candidates and against samples: both should be straight lines.

    python -m benchmarks.gap.scaling [--quick]

Every candidate stands at neutral in one compiled model, differentiated once. Compiling is timed on its own: it is done
once for a model and a library, whatever the recordings. A ratio below one is a fixed part that longer recordings
share. Ratios of one run are what counts, on a shared machine.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence

import numpy as np

from hydrotwin.discovery.recordings import split
from hydrotwin.discovery.refit import Question, RefitJob, Refitted, refit
from hydrotwin.discovery.search import Search
from hydrotwin.discovery.structure import Structure
from hydrotwin.models import cehA
from hydrotwin.models.effects import candidates
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

RATE = 100.0  # Hz
SENSORS = {"arm_angle": 2e-4, "motor_speed": 0.3, "pressure_cap": 1.5e4, "pressure_rod": 1.5e4}  # noise, SI
FREE = ("motor.gain", "motor.time_constant", "cylinder.friction.viscous")
LIBRARY = (20, 40, 80)
SECONDS = (20.0, 40.0, 80.0)


def recordings(seconds: float, count: int = 2) -> list[Record]:
    """The C-EHA driven by a slow wave with steps, simulated with gain and friction 10 % off."""
    model, runs = cehA.model(), []
    known = {p.name: p.value for p in model.flat.parameters}
    for seed in range(count):
        random = np.random.default_rng(seed)
        t = np.arange(0.0, seconds, 1 / RATE)
        command = 0.6 * np.sin(2 * np.pi * (0.2 + 0.05 * seed) * t) + 0.3 * np.sign(np.sin(2 * np.pi * 0.45 * t))
        driven = Record(t, {"command": command}, {"command": "V"}, f"run_{seed}")
        true = {FREE[0]: 1.1 * known[FREE[0]], FREE[2]: 0.9 * known[FREE[2]]}
        answer = simulate(model, driven, parameters=true)
        signals, units = {"command": command}, {"command": "V"}
        for name, noise in SENSORS.items():
            signals[name] = answer[name] + noise * random.standard_normal(len(t))
            units[name] = answer.units[name]
        runs.append(Record(t, signals, units, f"run_{seed}"))
    return runs


def question(seconds: float) -> Question:
    """One recording to screen on, one held out."""
    data = split(cehA.model().flat, recordings(seconds), [], noise=SENSORS)
    return Question(data.fit, data.select, data.noise)


def fitted(asked: Question) -> Refitted:
    """The base at its true parameters, as good as fitted: a screen asks for no more."""
    flat = cehA.model().flat
    answer = refit(RefitJob(flat, FREE, asked, iterations=3))
    if isinstance(answer, str):
        raise SystemExit(answer)
    return answer


def screening_seconds(asked: Question, base: Refitted, library: Sequence) -> tuple[float, float, int]:
    """Processor time of the first screen beyond the second, of the second, and the parameters screened."""
    search = Search(cehA.model(), FREE, tuple(library), asked, _here, lambda *said: None)
    taken = []
    for _ in range(2):
        began = spent()
        _, ranked = search.screened(Structure((), base))
        taken.append(spent() - began)
    assert len(ranked) == len(search.candidates)
    return taken[0] - taken[1], taken[1], sum(len(c.free) for c in search.candidates)


def spent() -> float:
    """Processor time of this process and of the compilers it started [s]."""
    return sum(os.times()[:4])


def _here(function, jobs, stage: str) -> list:
    return [function(job) for job in jobs]


def spread(library: Sequence, count: int) -> list:
    """So many candidates, taken evenly from the whole library."""
    return [library[k] for k in np.linspace(0, len(library) - 1, min(count, len(library))).astype(int)]


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a quarter of the candidates and of the seconds")
    share = 0.25 if parser.parse_args(words).quick else 1.0
    library = candidates(cehA.model())
    counts, lengths = [int(n * share) for n in LIBRARY], [s * share for s in SECONDS]

    print(f"{'candidates':>10} {'parameters':>10} {'once, s':>8} {'screen, s':>9} {'ms/candidate':>12} {'ratio':>6}")
    asked = question(lengths[0])
    base, first = fitted(asked), None
    for count in counts:
        chosen = spread(library, count)
        once, screen, parameters = screening_seconds(asked, base, chosen)
        first = first or screen / len(chosen)
        each = screen / len(chosen)
        print(
            f"{len(chosen):10d} {parameters:10d} {once:8.2f} {screen:9.2f} {1e3 * each:12.1f} {each / first:6.2f}",
            flush=True,
        )

    print(f"\n{'samples':>10} {'seconds':>10} {'screen, s':>18} {'us/sample':>12} {'ratio':>6}")
    chosen, first = spread(library, counts[0]), None
    for length in lengths:
        asked = question(length)
        _, screen, _ = screening_seconds(asked, fitted(asked), chosen)
        samples = sum(len(r.time) for r in asked.fit)
        first = first or screen / samples
        each = screen / samples
        print(f"{samples:10d} {length:10.0f} {screen:18.2f} {1e6 * each:12.1f} {each / first:6.2f}", flush=True)


if __name__ == "__main__":
    main()
