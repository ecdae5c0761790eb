"""Run FMUs that were built here for another machine as if there: aarch64 under qemu, Windows under wine."""

from __future__ import annotations

import functools
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fmpy import read_model_description

from hydrotwin.export.build import FMI3_FOLDERS, TARGETS, native_platform

STEPS, STEP = 200, 0.01  # of the replay, s
SHARE = 0.3  # of nominal: the size of the input
TIME_LIMIT = 600.0
_SYSROOT = Path("/usr/aarch64-linux-gnu")
_SOURCE = Path(__file__).with_name("replay.c")
_WINE_PLACES = ("/usr/lib/wine/wine64", "/usr/lib/wine/wine")  # Debian does not put it on the PATH


@dataclass(frozen=True)
class Machine:
    """A platform of FMUs and the program that runs programs of it; ``missing`` says why there is none."""

    platform: str
    runner: tuple[str, ...] = ()
    missing: str = ""
    version: str = ""


@functools.cache
def machine_for(platform: str) -> Machine:
    """This machine, wine for "win64", qemu for "aarch64-linux"."""
    if importlib.util.find_spec("ziglang") is None:
        return Machine(platform, missing="ziglang is not installed")
    if platform == native_platform():
        return Machine(platform)
    if platform == "win64":
        wine = shutil.which("wine64") or shutil.which("wine") or next(filter(os.path.exists, _WINE_PLACES), None)
        return Machine(platform, (wine,), version=_said(wine)) if wine else Machine(platform, missing="no wine")
    if platform == "aarch64-linux":
        qemu = shutil.which("qemu-aarch64") or shutil.which("qemu-aarch64-static")
        if qemu and _SYSROOT.exists():
            return Machine(platform, (qemu, "-L", str(_SYSROOT)), version=_said(qemu))
        return Machine(platform, missing="no qemu-user or libc6-arm64-cross")
    return Machine(platform, missing="nothing here runs its programs")


def replayed(fmu: Path, platform: str, kind: str) -> np.ndarray:
    """Outputs (steps, ny) of an FMU in a program for ``platform``; kind: "cs" or "me".

    Raises RuntimeError, with what the program said, when it fails there.
    """
    description = read_model_description(str(fmu))
    fmi = int(description.fmiVersion[0])
    of = {c: [v for v in description.modelVariables if v.causality == c] for c in ("input", "output")}
    [first, *_] = of["input"]
    words = [
        fmi, kind, description.guid or description.instantiationToken, len(description.derivatives), STEPS, STEP,
        first.valueReference, SHARE * float(first.nominal or 1.0), *(v.valueReference for v in of["output"]),
    ]  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="replay-", ignore_cleanup_errors=True) as name:
        library = _library(fmu, platform, fmi, Path(name))
        said = _run(machine_for(platform), [_program(platform), str(library), *map(str, words)])
    return np.array(said.split(), dtype=float).reshape(STEPS, len(of["output"]))


def _library(fmu: Path, platform: str, fmi: int, folder: Path) -> Path:
    start = f"binaries/{platform if fmi == 2 else FMI3_FOLDERS[platform]}/"
    with zipfile.ZipFile(fmu) as archive:
        [member] = [n for n in archive.namelist() if n.startswith(start)]
        return Path(archive.extract(member, folder))


@functools.cache
def _workplace() -> tempfile.TemporaryDirectory:
    """Programs and wine's own files, kept until the end of this process."""
    return tempfile.TemporaryDirectory(prefix="machines-", ignore_cleanup_errors=True)


@functools.cache
def _program(platform: str) -> str:
    """replay.c as a program for the platform."""
    headers = Path(importlib.util.find_spec("fmpy").submodule_search_locations[0]) / "c-code"
    target, ending = TARGETS[platform]
    program = Path(_workplace().name) / f"replay-{platform}{'.exe' if ending == '.dll' else ''}"
    line = [sys.executable, "-m", "ziglang", "cc", "-target", target.replace(".2.17", ""), "-O1", "-I", str(headers)]
    options = [] if ending == ".dll" else ["-ldl"]
    subprocess.run([*line, str(_SOURCE), "-o", str(program), *options], check=True, capture_output=True, text=True)
    return str(program)


def _run(machine: Machine, line: Sequence[str]) -> str:
    environment = os.environ | {"WINEDEBUG": "-all", "WINEPREFIX": str(Path(_workplace().name) / "wine")}
    done = subprocess.run(
        [*machine.runner, *line], capture_output=True, text=True, timeout=TIME_LIMIT, env=environment, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{machine.platform}: the replay ended with {done.returncode}. {done.stderr[-500:]}")
    return done.stdout


def _said(program: str) -> str:
    done = subprocess.run(
        [program, "--version"], capture_output=True, text=True, timeout=60, check=False,
        env=os.environ | {"WINEDEBUG": "-all"},
    )  # fmt: skip
    return (done.stdout or done.stderr).partition("\n")[0].strip()
