"""FMUs built here for other machines run there: aarch64 under qemu, Windows under wine, as they run here."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

from hydrotwin.export import export_fmu

SOURCE = Path(__file__).with_name("replay.c")
HEADERS = Path(fmpy.__file__).parent / "c-code"
SYSROOT = Path("/usr/aarch64-linux-gnu")
WINE = (
    shutil.which("wine64")
    or shutil.which("wine")
    or next((str(p) for p in (Path("/usr/lib/wine/wine64"), Path("/usr/lib/wine/wine")) if p.exists()), None)
)
QEMU = shutil.which("qemu-aarch64") or shutil.which("qemu-aarch64-static")
STEPS, STEP = 200, 0.01
# platform of the FMU -> folder and ending of its library, target of the compiler, what runs a program for it
MACHINES = {
    "linux64": ("linux64", ".so", "x86_64-linux-gnu", []),
    "aarch64-linux": ("aarch64-linux", ".so", "aarch64-linux-gnu", [QEMU, "-L", str(SYSROOT)]),
    "win64": ("win64", ".dll", "x86_64-windows-gnu", [WINE]),
}
MISSING = {
    "linux64": "" if sys.platform == "linux" and os.uname().machine == "x86_64" else "this is no 64-bit x86 Linux",
    "aarch64-linux": "" if QEMU and SYSROOT.exists() else "qemu-user or libc6-arm64-cross is not installed",
    "win64": "" if WINE else "wine is not installed",
}


def replayed(fmu: Path, platform: str, folder: Path) -> np.ndarray:
    """Outputs (steps, ny) of an FMU in a program for ``platform``."""
    where, ending, target, runner = MACHINES[platform]
    description = fmpy.read_model_description(str(fmu))
    with zipfile.ZipFile(fmu) as archive:
        member = next(n for n in archive.namelist() if n.startswith("binaries/") and where in n and n.endswith(ending))
        library = Path(archive.extract(member, folder))
    program = folder / ("replay.exe" if ending == ".dll" else "replay")
    options = ["-ldl"] if ending == ".so" else []
    subprocess.run(
        [sys.executable, "-m", "ziglang", "cc", "-target", target, "-O1", "-I", str(HEADERS), str(SOURCE),
         "-o", str(program), *options],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    references = {v.causality: [] for v in description.modelVariables}
    for v in description.modelVariables:
        references[v.causality].append(str(v.valueReference))
    words = [description.guid, str(STEPS), str(STEP), references["input"][0], *references["output"]]
    environment = os.environ | {"WINEDEBUG": "-all", "WINEPREFIX": str(folder / "wine")}
    run = subprocess.run(
        [*runner, str(program), str(library), *words], capture_output=True, text=True, timeout=600, env=environment
    )
    assert run.returncode == 0, run.stderr[-500:]
    return np.array(run.stdout.split(), dtype=float).reshape(STEPS, len(references["output"]))


@pytest.fixture(scope="module")
def fmu(tmp_path_factory, systems):
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    path = tmp_path_factory.mktemp("machines") / "cehA.fmu"
    return export_fmu(systems["cehA"], path, platforms=list(MACHINES))


@pytest.fixture(scope="module")
def here(fmu, tmp_path_factory):
    if MISSING["linux64"]:
        pytest.skip(MISSING["linux64"])
    return replayed(fmu, "linux64", tmp_path_factory.mktemp("here"))


def runs_there(platform: str):
    """The platform as a parameter, skipped where the machine cannot be imitated."""
    reason = MISSING[platform]
    return pytest.param(platform, marks=pytest.mark.skipif(bool(reason), reason=reason or "it runs"))


@pytest.mark.parametrize("platform", [runs_there("aarch64-linux"), runs_there("win64")])
def test_an_fmu_runs_on_another_machine_as_here(fmu, here, platform, tmp_path):
    found = replayed(fmu, platform, tmp_path)
    assert np.ptp(here, axis=0).min() > 0
    assert np.abs(found - here).max(axis=0) == pytest.approx(0, abs=1e-9 * np.abs(here).max())
