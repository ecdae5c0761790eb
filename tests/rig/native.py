"""Compile the C core once per source text and call it."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

SOURCE = Path(__file__).with_name("source")
FLAGS = ("-O2", "-ffp-contract=off", "-std=gnu11", "-shared")
STATES, NAMES = 16, ("cehA", "spool_valve", "winch", "lift_boom", "test_cylinder")  # in the order of rig.c


def _cache_folder() -> Path:
    if sys.platform == "win32":
        root = Path(os.environ.get("LOCALAPPDATA", Path.home()))
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Caches"
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return root / "hydrotwin-rig"


def _compiler() -> list[str]:
    system = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    return [system] if system else [sys.executable, "-m", "ziglang", "cc"]


def _build() -> Path:
    files = sorted(SOURCE.glob("*.[ch]"))
    compiler = _compiler()
    key = hashlib.sha256("\0".join([*compiler, *FLAGS, *(f.read_text(encoding="utf-8") for f in files)]).encode())
    suffix = ".dll" if sys.platform == "win32" else ".so"
    library = _cache_folder() / f"rig-{key.hexdigest()[:20]}{suffix}"
    if library.exists():
        return library
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        built = Path(folder) / library.name
        position = [] if sys.platform == "win32" else ["-fPIC", "-lm"]
        command = [*compiler, *FLAGS, str(SOURCE / "rig.c"), "-o", str(built), *position]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"rig: the C core does not compile (got {done.stderr[-800:]}).")
        os.replace(built, library)
    return library


@functools.cache
def _library() -> ctypes.CDLL:
    library = ctypes.CDLL(str(_build()))
    array = np.ctypeslib.ndpointer(dtype=float, flags="C_CONTIGUOUS")
    library.rig_run.restype = ctypes.c_long
    library.rig_run.argtypes = [ctypes.c_int, ctypes.c_long, *[array] * 4, ctypes.c_double, array, array]
    library.rig_names.restype = ctypes.c_char_p
    return library


@functools.cache
def field_names(machine: str) -> tuple[str, ...]:
    """The parameters of the C core, in its order."""
    return tuple(_library().rig_names(NAMES.index(machine)).decode().rstrip(",").split(","))


def run(machine, times, values, slopes, fields, start, outputs, step, hold_after_loss=False):
    """Integrate through breakpoints.

    On ``[times[i], times[i+1])`` the input is ``values[i] + slopes[i] (t - times[i])``.

    Args: times, values, slopes (n,); fields: mapping of every C field; start: state, SI (a full state vector is carried
    on in place); step: longest step [s].
    Returns: outputs at the breakpoints, (n, outputs).
    Raises: RuntimeError when an output is not finite or an oil volume is gone, with the time.
    """
    parameters = np.array([fields[name] for name in field_names(machine)], dtype=float)
    state = start if isinstance(start, np.ndarray) and len(start) == STATES else np.zeros(STATES)
    state[: len(start)] = start
    answer = np.empty((len(times), outputs))
    arrays = [np.ascontiguousarray(a, dtype=float) for a in (times, values, slopes)]
    bad = _library().rig_run(NAMES.index(machine), len(times), *arrays, parameters, step, state, answer)
    if bad >= 0 and hold_after_loss:
        answer[bad:] = answer[bad - 1]
    elif bad >= 0:
        raise RuntimeError(f"rig: {machine} left its volumes or the finite numbers at t = {times[bad]:.4f} s.")
    return answer
