"""How fast the C-EHA runs, against what one would write otherwise; everything as a ratio within one run.

    python benchmarks/simulation/speed.py

The machine: 80 s at 1 kHz, a smooth command held between samples, Runge-Kutta steps of 1 ms. Every contender runs
several times, in turns; the CPU time of the fastest run counts, so that other work on the machine matters little.
SciPy and CVODES get 2 s, scaled up: they restart at each sample of the held command, their cost is linear.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import tempfile
import time
from pathlib import Path

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from hydrotwin.simulation import compiler, prepare, run_many, squares_of_many
from tests.simulation.flat_cehA import flat_cehA

SAMPLES, PERIOD = 80_001, 1e-3
ROUNDS = 8
SCIPY_SAMPLES = 2_001


def main() -> None:
    model = flat_cehA()
    p = model.parameter_vector()
    x0 = model.start_given(["arm.angle"])(0, p, [0.1]).full().ravel()
    times = PERIOD * np.arange(SAMPLES)
    u = (1.5 * np.sin(2 * np.pi * 0.3 * times) + 0.5 * np.sin(7 * times))[:, None]
    for table in (against_others, side_by_side, over_parameters, over_samples, first_use):
        table(model, times, u, p, x0)


def against_others(model, times, u, p, x0) -> None:
    compiled, interpreted = prepare(model, method="explicit"), prepare(model, method="vm")
    implicit = prepare(model, method="implicit")
    by_hand = hand_written(u, p, x0)
    contenders = {
        "compiled, this room": lambda: compiled.run(times, u, p, x0),
        "C written by hand": by_hand,
        "CasADi virtual machine": lambda: interpreted.run(times, u, p, x0),
        "implicit in C, 1e-10": lambda: implicit.run(times, u, p, x0),
    }
    seconds = fastest(contenders)
    seconds["CasADi CVODES, 1e-6"] = cvodes(model, times, u, p, x0)
    seconds["SciPy LSODA, CasADi right-hand side"] = scipy_lsoda(model, times, u, p, x0)
    unit = seconds["compiled, this room"]
    rows = [(n, f"{s:.4f}", f"{s / unit:.2f}") for n, s in seconds.items()]
    table("80 s at 1 kHz", ["contender", "CPU seconds", "ratio"], rows)
    difference = np.abs(compiled.run(times, u, p, x0)[0] - by_hand()[0]).max(axis=0)
    print(f"largest difference to the C written by hand: {difference.max():.1e} (angle {difference[0]:.1e} rad)")


def side_by_side(model, times, u, p, x0) -> None:
    """Eight parameter sets in vector lanes, against eight single runs."""
    plain, sets = prepare(model, method="explicit"), np.array([p * (1 + 1e-3 * k) for k in range(8)])
    starts = np.tile(x0, (8, 1))
    measured = plain.run(times, u, p, x0)[0]
    contenders = {
        "one by one": lambda: [plain.run(times, u, *one) for one in zip(sets, starts, strict=True)],
        "lanes, outputs": lambda: run_many(plain, times, u, sets, starts),
        "lanes, squares": lambda: squares_of_many(plain, times, u, sets, starts, measured),
    }
    seconds = fastest(contenders)
    unit = seconds["one by one"]
    rows = [(n, f"{s:.4f}", f"{unit / s:.2f}") for n, s in seconds.items()]
    table("8 parameter sets, 80 s at 1 kHz", ["what", "CPU seconds", "times the throughput"], rows)


def over_parameters(model, times, u, p, x0) -> None:
    names = [q.name for q in model.parameters if q.free] + [q.name for q in model.parameters if not q.free]
    plain = prepare(model, method="explicit")
    contenders = {"run": lambda: plain.run(times, u, p, x0)}
    for count in (1, 2, 6, 12, 18):
        propagator = prepare(model, free_parameters=names[:count], method="explicit")
        seeds = np.zeros((len(x0), count))
        contenders[f"{count} parameters"] = lambda q=propagator, s=seeds: q.sensitivity(times, u, p, x0, s, False)
    seconds = fastest(contenders)
    unit = seconds["run"]
    rows = [(n, f"{s:.4f}", f"{s / unit:.2f}") for n, s in seconds.items()]
    table("sensitivities, 80 s at 1 kHz", ["what", "CPU seconds", "ratio to a run"], rows)


def over_samples(model, times, u, p, x0) -> None:
    free = [q.name for q in model.parameters if q.free]
    propagator = prepare(model, free_parameters=free, method="explicit")
    seeds = np.zeros((len(x0), len(free)))
    counts = (5_000, 10_000, 20_000, 40_000, 80_000)
    runs = fastest({n: lambda n=n: propagator.run(times[:n], u[:n], p, x0) for n in counts})
    slopes = fastest({n: lambda n=n: propagator.sensitivity(times[:n], u[:n], p, x0, seeds, False) for n in counts})
    rows = [(n, f"{runs[n] / n * 1e9:.0f}", f"{slopes[n] / n * 1e9:.0f}") for n in counts]
    table("cost per sample", ["samples", "run [ns]", "with 6 sensitivities [ns]"], rows)


def first_use(model, times, u, p, x0) -> None:
    """From a new model to the first answer, with an empty cache and with a full one."""
    free = tuple(q.name for q in model.parameters if q.free)
    kept = os.environ.get("HYDROTWIN_CACHE")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        os.environ["HYDROTWIN_CACHE"] = folder
        for label in ("empty cache", "full cache"):
            begin = time.perf_counter()
            prepare(flat_cehA(), free_parameters=free).run(times[:10], u[:10], p, x0)
            rows.append((label, f"{time.perf_counter() - begin:.3f}"))
    if kept is None:
        del os.environ["HYDROTWIN_CACHE"]
    else:
        os.environ["HYDROTWIN_CACHE"] = kept
    table("new model to first answer", ["cache", "seconds"], rows)


def fastest(contenders: dict) -> dict:
    """CPU seconds of the fastest of several rounds, taken in turns so that all see the same load; one to warm up."""
    best = dict.fromkeys(contenders, np.inf)
    for _ in range(ROUNDS + 1):
        for name, run in contenders.items():
            begin = time.thread_time()
            run()
            best[name] = min(best[name], time.thread_time() - begin)
    return best


def hand_written(u, p, x0):
    """The hand-written loop with the flags of this room."""
    source = Path(__file__).with_name("hand_written.c").read_text()
    library = ctypes.CDLL(str(compiler.compile_library(source, "by_hand")))
    y, x = np.empty((SAMPLES, 6)), np.empty((SAMPLES, 5))
    addresses = [ctypes.c_void_p(a.ctypes.data) for a in (u, p, x0, y, x)]

    def run():
        library.run_by_hand(ctypes.c_longlong(SAMPLES), ctypes.c_double(PERIOD), *addresses)
        return y, x  # kept alive: the library knows addresses only

    return run


def scipy_lsoda(model, times, u, p, x0) -> float:
    """Seconds for all samples; the right-hand side is the CasADi function, called plainly."""

    def rate(t, x, command):
        return model.ode(t, x, command, p)[0].full().ravel()

    begin, x = time.thread_time(), x0
    for k in range(SCIPY_SAMPLES - 1):
        solved = solve_ivp(rate, times[k : k + 2], x, "LSODA", args=(u[k],), rtol=1e-6, atol=1e-6)
        x = solved.y[:, -1]
    return (time.thread_time() - begin) * (SAMPLES - 1) / (SCIPY_SAMPLES - 1)


def cvodes(model, times, u, p, x0) -> float:
    """Seconds for all samples, restarted at each sample of the held command, as one mapped accumulation."""
    count = SCIPY_SAMPLES - 1
    x, command, q = ca.SX.sym("x", len(x0)), ca.SX.sym("u"), ca.SX.sym("p", len(p))
    scale = np.array([s.nominal for s in model.states])
    dae = {"x": x, "u": command, "p": q, "ode": model.ode(0, scale * x, command, q)[0] / scale}
    walk = ca.integrator("walk", "cvodes", dae, 0, PERIOD, {"reltol": 1e-6, "abstol": 1e-6}).mapaccum(count)
    begin = time.thread_time()
    walk(x0=x0 / scale, u=u[:count].T, p=ca.repmat(ca.DM(p), 1, count))
    return (time.thread_time() - begin) * (SAMPLES - 1) / count


def table(title: str, header: list[str], rows: list[tuple]) -> None:
    rows = [tuple(map(str, row)) for row in rows]
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    print(f"\n{title}")
    for row in [header, *rows]:
        numbers = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        print("  " + "  ".join([row[0].ljust(widths[0]), *numbers]))


if __name__ == "__main__":
    words = subprocess.run([*compiler.compilers()[0], "--version"], capture_output=True, text=True, check=False).stdout
    print(words.partition("\n")[0], "|", os.cpu_count(), "cores | load", *(f"{x:.1f}" for x in os.getloadavg()))
    main()
