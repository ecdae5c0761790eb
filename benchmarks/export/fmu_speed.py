"""What an FMU costs: its steps beside the bare compiled loop and beside a PythonFMU, its export, its size.

    python benchmarks/export/fmu_speed.py

The machine: the C-EHA as a Co-Simulation FMU of FMI 2.0, 80 s in steps of 1 ms, a smooth command held over each step,
one internal step of Runge-Kutta in each. Everything in one run: times of a shared machine mean little, their ratios do.
CPU seconds of the fastest of several rounds, taken in turns. Runs through FMPy are 8 s long and scaled to 80 s: their
cost is linear. FMU code runs in child processes only; every run must have the outputs of the bare loop.

PythonFMU takes part when it is installed: pip install pythonfmu. The importer in C needs a POSIX system.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
from fmpy import read_model_description

from hydrotwin.export import export_fmu
from hydrotwin.export.build import TARGETS
from hydrotwin.models.language.flat import Signal, StateVariable
from hydrotwin.simulation import Block, prepare
from tests.simulation.flat_cehA import flat_cehA

HERE = Path(__file__).resolve().parent
STEPS, STEP = 80_000, 1e-3
FMPY_STEPS = 8_000
ROUNDS, FMPY_ROUNDS = 6, 3
ANGLE = 0.1  # rad, where the arm starts
WITHIN = 1e-6  # of the range of each output
OUTPUTS = ("arm_angle", "motor_speed", "rod_position", "pressure_cap", "pressure_rod", "piston_force")


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="fmu-speed-") as name:
        folder = Path(name)
        speed(folder)
        export_times(folder)
        sizes(folder)


def speed(folder: Path) -> None:
    model = flat_cehA()
    p = model.parameter_vector()
    x0 = model.start_given(["arm.angle"])(0, p, [ANGLE]).full().ravel()
    times = STEP * np.arange(STEPS + 1)
    u = 1.5 * np.sin(2 * np.pi * 0.3 * times) + 0.5 * np.sin(7 * times)
    bare = prepare(model, method="explicit")
    expected = bare.run(times, u[:, None], p, x0)[0][1:]
    ours = export_fmu(model, folder / "cehA.fmu", step_size=STEP)
    nothing = export_fmu(idle_block(), folder / "nothing.fmu")
    importer = compile_importer(folder)

    def from_python() -> float:
        begun = time.thread_time()
        bare.run(times, u[:, None], p, x0)
        return time.thread_time() - begun

    contenders: dict[str, Callable[[], float]] = {"bare compiled loop": from_python}
    if importer:
        contenders["FMU from C"] = importer_run(importer, ours, u[:-1], expected, folder)
    seconds = fastest(contenders, ROUNDS)

    starts = {"arm.angle.start": ANGLE}
    scale = STEPS / FMPY_STEPS
    through = {
        "FMU through FMPy's calls": fmpy_run(ours, "calls", starts, u, expected, folder),
        "FMU that does nothing, FMPy's calls": fmpy_run(nothing, "calls", {}, u, None, folder),
        "FMU in fmpy.simulate_fmu": fmpy_run(ours, "simulate_fmu", starts, u, None, folder),
    }
    rival = python_fmu(folder)
    if rival:
        values = {**{f"p_{k}": p[k] for k in range(19)}, **{f"x_{k}": v for k, v in enumerate(x0)}}
        through["PythonFMU through FMPy's calls"] = fmpy_run(rival, "calls", values, u, expected, folder)
        through["PythonFMU in fmpy.simulate_fmu"] = fmpy_run(rival, "simulate_fmu", values, u, None, folder)
    seconds |= {name: scale * s for name, s in fastest(through, FMPY_ROUNDS).items()}

    unit = seconds["bare compiled loop"]
    rows = [(n, f"{s:.4f}", f"{s / STEPS * 1e6:.2f}", f"{s / unit:.2f}") for n, s in seconds.items()]
    table("80 s of the C-EHA at 1 ms", ["contender", "CPU seconds", "us a step", "ratio to the bare loop"], rows)
    judge_speed(seconds)


def judge_speed(seconds: dict[str, float]) -> None:
    rows = []
    if "FMU from C" in seconds:
        c, bare = seconds["FMU from C"], seconds["bare compiled loop"]
        rows.append(at_most("FMU from C / bare loop", c / bare, 1.5, "x"))
        rows.append(at_most("FMU from C - bare loop, a step", (c - bare) / STEPS * 1e6, 3.0, "us"))
        for rival in ("PythonFMU through FMPy's calls", "PythonFMU in fmpy.simulate_fmu"):
            if rival in seconds:
                rows.append(at_least(f"{rival} / FMU from C", seconds[rival] / c, 50.0, "x"))
    else:
        print("left out: the importer in C, it needs dlopen and a C compiler (ziglang).")
    for way, ours in (("calls", "FMU through FMPy's calls"), ("simulate_fmu", "FMU in fmpy.simulate_fmu")):
        rival = ours.replace("FMU", "PythonFMU", 1)
        if rival in seconds:
            ratio = f"{seconds[rival] / seconds[ours]:.1f} x"
            rows.append((f"PythonFMU / FMU, both through FMPy ({way})", ratio, "", ""))
    table("targets of speed", ["what", "measured", "target", ""], rows)


def idle_block() -> Block:
    """One input, as many outputs as the C-EHA, a sample period that never ends: what is left is the master's cost."""
    x, u, p = ca.SX.sym("x", 1), ca.SX.sym("u", 1), ca.SX.sym("p", 0)
    return Block(
        name="nothing",
        inputs=(Signal("command", "V"),),
        outputs=tuple(Signal(n, "1") for n in OUTPUTS),
        states=(StateVariable("kept", "1"),),
        parameters=(),
        step=ca.Function("step", [x, u, p], [x, ca.repmat(x, len(OUTPUTS), 1)], ["x", "u", "p"], ["x_next", "y"]),
        start=ca.Function("start", [u, ca.SX.sym("y", len(OUTPUTS)), p], [ca.SX(1)], ["u", "y", "p"], ["x"]),
        period=1e6,
    )


def compile_importer(folder: Path) -> Path | None:
    """The importer as a program; None where there is no dlopen or no compiler."""
    if os.name != "posix" or importlib.util.find_spec("ziglang") is None:
        return None
    headers = Path(importlib.util.find_spec("fmpy").submodule_search_locations[0]) / "c-code"
    made = folder / "importer"
    line = [
        sys.executable, "-m", "ziglang", "cc", "-std=c99", "-Wall", "-O2", f"-I{headers}",
        str(HERE / "importer.c"), "-o", str(made), "-ldl",
    ]  # fmt: skip
    subprocess.run(line, check=True)
    return made


def importer_run(importer: Path, fmu: Path, drive, expected, folder: Path) -> Callable[[], float]:
    """One run of the importer in a process of its own: CPU seconds of the steps."""
    with zipfile.ZipFile(fmu) as archive:
        library = archive.extract(next(n for n in archive.namelist() if n.startswith("binaries/")), folder / "ours")
    description = read_model_description(str(fmu), validate=False)
    reference = {v.name: str(v.valueReference) for v in description.modelVariables}
    drive.astype(float).tofile(folder / "drive.bin")
    line = [
        str(importer), library, description.guid, str(folder / "drive.bin"), str(folder / "found.bin"), "2",
        str(len(drive)), repr(STEP), reference["command"], reference["arm.angle.start"], repr(ANGLE),
        *(reference[n] for n in OUTPUTS),
    ]  # fmt: skip

    def run() -> float:
        said = subprocess.run(line, check=True, capture_output=True, text=True, timeout=120).stdout
        same(np.fromfile(folder / "found.bin").reshape(-1, len(OUTPUTS)), expected, "FMU from C")
        return float(said)

    return run


def fmpy_run(fmu: Path, way: str, starts: dict, u, expected, folder: Path) -> Callable[[], float]:
    """One run through FMPy in a process of its own: CPU seconds of FMPY_STEPS steps."""
    label = f"{fmu.stem}-{way}"
    np.save(folder / "drive.npy", u[:FMPY_STEPS])
    job = {
        "path": str(fmu), "way": way, "starts": {n: float(v) for n, v in starts.items()}, "step": STEP,
        "outputs": OUTPUTS, "drive": str(folder / "drive.npy"), "found": str(folder / f"{label}.npy"),
        "folder": str(folder / label), "rounds": 1,
    }  # fmt: skip
    file = folder / f"{label}.json"
    file.write_text(json.dumps(job), encoding="utf-8")

    def run() -> float:
        line = [sys.executable, str(HERE / "_fmpy_loop.py"), str(file)]
        ended = subprocess.run(line, capture_output=True, text=True, timeout=300)
        said = ended.stdout  # all of it, even where unloading aborts the process: PythonFMU does that now and then
        if not said.strip():
            raise SystemExit(f"{label}: the run ended with {ended.returncode}. {ended.stderr[-300:]}")
        if expected is not None:
            same(np.load(folder / f"{label}.npy", allow_pickle=False), expected[:FMPY_STEPS], label)
        return float(said.split()[-1])

    return run


def python_fmu(folder: Path) -> Path | None:
    """The same machine as a PythonFMU; None, with a sentence, when PythonFMU is not installed."""
    if importlib.util.find_spec("pythonfmu") is None:
        print("left out: PythonFMU is not installed. Beside it: pip install pythonfmu, then run this again.")
        return None
    line = [sys.executable, "-m", "pythonfmu", "build", "-f", str(HERE / "cehA_slave.py"), "-d", str(folder)]
    subprocess.run(line, check=True, capture_output=True, timeout=120)
    print(f"PythonFMU {importlib.metadata.version('pythonfmu')}")
    return next(folder.glob("CehASlave.fmu"))


def export_times(folder: Path) -> None:
    """Wall seconds of exports with a warm toolchain: values never seen, so that it compiles; the same once more."""
    model, gain = flat_cehA(), {p.name: p.value for p in flat_cehA().parameters}["motor.gain"]
    export_fmu(model, folder / "warm.fmu")
    changed = model.with_parameters({"motor.gain": gain * (1 + 1e-3 * np.random.default_rng().random())})
    command = [sys.executable, "-m", "hydrotwin", "export", "cehA", "--out", str(folder / "command.fmu")]
    tasks = {
        "export_fmu, compiled anew": lambda: export_fmu(changed, folder / "new.fmu"),
        "export_fmu, once more": lambda: export_fmu(changed, folder / "new.fmu"),
        "hydrotwin export cehA, the whole command": lambda: subprocess.run(command, check=True, capture_output=True),
    }
    rows = []
    for name, task in tasks.items():
        begun = time.perf_counter()
        task()
        rows.append(at_most(name, time.perf_counter() - begun, 5.0, "s"))
    table("export, warm", ["what", "measured", "target", ""], rows)


def sizes(folder: Path) -> None:
    """Size of the FMU with one platform, for each platform."""
    rows = []
    for name in TARGETS:
        path = export_fmu(flat_cehA(), folder / f"{name}.fmu", platforms=[name])
        with zipfile.ZipFile(path) as archive:
            library = next(i.file_size for i in archive.infolist() if i.filename.startswith("binaries/"))
        rows.append((*at_most(name, path.stat().st_size / 1000, 300.0, "kB"), f"{library / 1000:.0f} kB"))
    table("size, one platform", ["platform", "FMU", "target", "", "library, unpacked"], rows)


def fastest(contenders: dict[str, Callable[[], float]], rounds: int) -> dict[str, float]:
    """Seconds of the fastest round of each, in turns so that all see the same load; one round to warm up."""
    best = dict.fromkeys(contenders, np.inf)
    for _ in range(rounds + 1):
        for name, run in contenders.items():
            best[name] = min(best[name], run())
    return best


def same(found: np.ndarray, expected: np.ndarray, what: str) -> None:
    """A run that computes something else is no measurement."""
    off = float((np.abs(found - expected).max(axis=0) / np.ptp(expected, axis=0)).max())
    if not off < WITHIN:
        sys.exit(f"{what}: its outputs are {off:.1e} of their range off the bare loop (at most {WITHIN:g}).")


def at_most(what: str, measured: float, target: float, unit: str) -> tuple:
    return what, f"{measured:.2f} {unit}", f"<= {target:g} {unit}", "met" if measured <= target else "MISSED"


def at_least(what: str, measured: float, target: float, unit: str) -> tuple:
    return what, f"{measured:.1f} {unit}", f">= {target:g} {unit}", "met" if measured >= target else "MISSED"


def table(title: str, header: list[str], rows: list[tuple]) -> None:
    rows = [tuple(map(str, row)) for row in rows]
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    print(f"\n{title}")
    for row in [header, *rows]:
        cells = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        print("  " + "  ".join([row[0].ljust(widths[0]), *cells]).rstrip())


if __name__ == "__main__":
    load = " ".join(f"{x:.1f}" for x in os.getloadavg()) if hasattr(os, "getloadavg") else "unknown"
    print(os.cpu_count(), "cores | load", load)
    main()
