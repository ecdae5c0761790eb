"""The implicit method with a fixed step: stable where Runge-Kutta is not, of order 5, and never dearer than before."""

from __future__ import annotations

import ctypes as c
import zipfile
from functools import cache

import casadi as ca
import numpy as np
import pytest
from typer.testing import CliRunner

from hydrotwin.cli import app
from hydrotwin.export import check_fmu, export_fmu, read_fmu
from hydrotwin.export.build import compile_for, native_platform
from hydrotwin.export.reference import reference_run
from hydrotwin.models.language.errors import DeclarationError, SolveError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests.export.raw import OK, Library
from tests.export.systems import delayed_mass, lag_block, stiff_oscillator
from tests.export.test_agreement import WITHIN, cvodes
from tests.simulation.flat_cehA import flat_cehA
from tests.simulation.small_models import small_model

IMPLICIT = ("method", "implicit")


def stiff_cehA():
    """The actuator with 0.1 ml of oil behind a piston that starts at its end: 1000 Hz, where 1 ms is the step."""
    return flat_cehA().with_parameters({"cylinder.cap_dead_volume": 1e-7})


def soft_start() -> Record:
    t = np.arange(0.0, 1.0, 0.01)
    signals = {"command": 0.5 * (1 - np.cos(2 * np.pi * t)), "arm_angle": np.zeros(len(t))}
    return Record(t, signals, {"command": "V", "arm_angle": "rad"}, "soft start")


@cache
def exact() -> dict[str, np.ndarray]:
    return cvodes(stiff_cehA(), soft_start(), {"arm.angle": 0.0})


def errors(folder, **options) -> dict[str, float]:
    """Largest differences to CVODES at 1e-12, of the range of each output."""
    found = read_fmu(export_fmu(stiff_cehA(), folder / "x.fmu", **options)).free_run(soft_start())
    return {n: float(np.abs(found[n] - y).max() / np.ptp(y)) for n, y in exact().items()}


def test_a_stiff_volume_explodes_explicitly_and_is_damped_implicitly(tmp_path):
    assert errors(tmp_path, method="explicit", step=1e-3)["arm_angle"] > 1.0
    assert errors(tmp_path, method="implicit", step=1e-3)["arm_angle"] < 2e-5


def test_the_method_is_of_order_five(tmp_path):
    coarse, fine = (errors(tmp_path, method="implicit", step=h) for h in (2.5e-4, 1.25e-4))
    for output in ("arm_angle", "pressure_cap", "pressure_rod", "piston_force"):
        assert 4.5 < np.log2(coarse[output] / fine[output]) < 5.5, (output, coarse, fine)


def test_the_stiff_oscillator_agrees_with_cvodes(variants, systems):
    t = np.arange(0.0, 2.0, 0.01)
    record = Record(t, {"drive": np.sin(3 * t)}, {"drive": "1"})
    expected, found = cvodes(systems["stiff"], record, {}), read_fmu(variants["stiff", IMPLICIT]).free_run(record)
    assert np.abs(found["level"] - expected["level"]).max() < WITHIN  # of 2; it starts with a transient of 0.3 ms


COUNTER = '__attribute__((visibility("default"))) int evaluations = 0;\n'
TASKS = ("case IVP_EVAL_RHS:", "case IVP_EVAL_JAC:")


def counting(fmu, folder) -> tuple[Library, c.c_int]:
    """The FMU's library, compiled once more so that it counts the evaluations of its equations and their Jacobian."""
    library = Library(fmu, folder)
    with zipfile.ZipFile(fmu) as archive:
        files = {n.removeprefix("sources/"): archive.read(n).decode() for n in archive.namelist() if "sources/" in n}
    for task in TASKS:
        assert task in files["functions.c"]
        files["functions.c"] = files["functions.c"].replace(task, f"{task} evaluations++;")
    files["functions.c"] = COUNTER + files["functions.c"]
    (folder / "counting.so").write_bytes(compile_for(native_platform(), "counting", files)[1])
    library.dll = c.CDLL(str(folder / "counting.so"))
    library.dll.fmi2Instantiate.restype = c.c_void_p
    return library, c.c_int.in_dll(library.dll, "evaluations")


def evaluations(fmu, folder) -> list[int]:
    """Evaluations in each of 40 communication steps of 10 ms over a drive that jumps."""
    library, counter = counting(fmu, folder)
    instance, found = library.instance().initialise(), []
    for k in range(40):
        counter.value = 0
        assert instance.set("drive", 3000.0 * (k % 10 == 0)) == OK
        assert instance.step(0.01 * k, 0.01) == OK
        found.append(counter.value)
    instance.free()
    return found


def test_a_communication_step_costs_the_same_whatever_happens(fmus, variants, tmp_path):
    """Eight stages and one Jacobian in each internal step; the adaptive method takes many more when the drive jumps."""
    fixed = evaluations(variants["stiff", IMPLICIT, ("step", 2.5e-3)], tmp_path / "fixed")
    assert len(set(fixed)) == 1
    assert 4 * 8 <= fixed[0] <= 4 * 10
    adaptive = evaluations(fmus["stiff"], tmp_path / "adaptive")
    assert max(adaptive) > 3 * min(adaptive)


@pytest.mark.parametrize("system", [stiff_oscillator(), delayed_mass(), flat_cehA()], ids=lambda s: s.name)
@pytest.mark.parametrize("method", ["implicit", "explicit"])
def test_the_reference_inside_is_of_the_same_method_and_step(tmp_path, system, method):
    if method == "explicit" and system.name == "stiff":
        pytest.skip("no explicit step survives it")
    chosen = {"method": method, "step": 5e-4}
    fmu = export_fmu(system, tmp_path / "x.fmu", reference=reference_run(system, **chosen), **chosen)
    row = check_fmu(fmu)["reference"]
    assert row.passed, row.detail
    assert float(row.detail.split("difference ")[1].split()[0]) < 1e-9
    other = read_fmu(export_fmu(system, tmp_path / "y.fmu", method=method, step=1e-3))
    record = reference_run(system, **chosen)
    assert any(np.abs(other.free_run(record)[s.name] - record[s.name]).max() > 0 for s in system.outputs)


def slamming_valve():
    """A check valve on a small volume: a poppet on a seat of 1e8 N/m, its pressures stiff beyond any fixed step."""

    def equations(t, x, u, p):
        flow = 1e-3 * ca.fmax(x[0], 0) * (u[0] - x[2])
        seat = 1e8 * ca.fmax(-x[0], 0)
        force = (u[0] - x[2]) * 1e-4 - 5 - 5e3 * x[0] - x[1] + seat
        return ca.vertcat(x[1], force / 0.01, 1.4e9 / 1e-6 * (flow - 1e-10 * x[2])), x

    supply = Signal("supply", "1", nominal=1e6, default=1e5, interpolation="hold")
    return small_model("valve", ["x", "v", "p"], {"none": 0.0}, equations, inputs=(supply,), start=[0.0, 0.0, 1e5])


def test_an_adaptive_step_that_gives_up_is_cut(tmp_path):
    flat = slamming_valve()
    t = np.arange(0.0, 0.2, 0.01)
    record = Record(t, {"supply": 1e5 + 5e5 * (t > 0.05)}, {"supply": "1"}, "opens")
    found = read_fmu(export_fmu(flat, tmp_path / "valve.fmu", method="adaptive")).free_run(record)
    expected = simulate(flat, record)
    for name in ("x_seen", "p_seen"):
        assert np.abs(found[name] - expected[name]).max() < 2e-3 * np.ptp(expected[name])


def test_a_fixed_implicit_step_that_gives_up_is_told():
    with pytest.raises(SolveError, match=r"gives up at t = .* Take a smaller step, or method 'adaptive'"):
        reference_run(slamming_valve(), method="implicit")


def test_method_and_step_are_options_of_the_command(tmp_path):
    fmu = tmp_path / "x.fmu"
    options = ["--method", "implicit", "--step", "0.002"]
    done = CliRunner().invoke(app, ["export", "cehA", "--out", str(fmu), *options])
    assert done.exit_code == 0, done.output
    with zipfile.ZipFile(fmu) as archive:
        assert "HT_IMPLICIT" in archive.read("sources/model.c").decode()
        assert "steps of at most 0.002 s" in archive.read("documentation/index.html").decode()
    assert check_fmu(fmu).passed


@pytest.mark.parametrize(
    ("system", "options", "words"),
    [
        (flat_cehA(), {"method": "implicitt"}, "Did you mean 'implicit'"),
        (flat_cehA(), {"step": 0.0}, "must be positive"),
        (flat_cehA(), {"step": float("nan")}, "must be positive"),
        (lag_block(), {"method": "implicit"}, "no solver inside"),
        (lag_block(), {"step": 1e-3}, "moves every 0.02 s"),
    ],
)
def test_a_method_or_step_that_cannot_be_is_refused(tmp_path, system, options, words):
    with pytest.raises(DeclarationError, match=words):
        export_fmu(system, tmp_path / "x.fmu", **options)
