"""From C source to a shared library, compiled once per source, compiler and machine."""

from __future__ import annotations

import atexit
import functools
import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path

import platformdirs

from hydrotwin.models.language.errors import SolveError

# Contraction off: one rounding per operation, as in the CasADi virtual machine.
# No -march=native for models: measured equal without, and a cache folder may be shared by different machines.
FLAGS = ("-fvisibility=hidden", "-fno-math-errno", "-ffp-contract=off", "-fPIC", "-shared", "-w")
NATIVE = "-march=native"
SUFFIX = {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")


def cache_folder() -> Path:
    """Where compiled libraries live: ``$HYDROTWIN_CACHE`` or the user's cache folder."""
    chosen = os.environ.get("HYDROTWIN_CACHE")
    return Path(chosen).absolute() if chosen else Path(platformdirs.user_cache_dir("hydrotwin", appauthor=False))


def compilers() -> list[tuple[str, ...]]:
    """Commands to try in this order: ``$CC`` alone when it is set, else the system's ``cc``, else the zig wheel's."""
    chosen = os.environ.get("CC")
    if chosen:
        return [tuple(shlex.split(chosen))]
    found = [("cc",)] if shutil.which("cc") else []
    if _importable("ziglang"):
        found.append((sys.executable, "-m", "ziglang", "cc"))
    return found


def compile_library(
    source: str, name: str, optimise: Sequence[str] = ("-O3",), for_this_processor: bool = False
) -> Path | None:
    """Path of the shared library made from ``source``; None when this machine has no compiler.

    for_this_processor : it may use whatever instructions this one has; others that share the cache make their own.

    Raises SolveError with the compiler's own words when every compiler here refuses the source.
    """
    words = ""
    for command in compilers():
        try:
            processor = _processor(command) if for_this_processor else ""
            native = (NATIVE,) if processor else ()
            return _compiled(source, name, (*command, *optimise, *native, *FLAGS), processor)
        except _Refused as refused:
            words = f"'{' '.join(command)}' said: {str(refused).strip()[-800:] or 'nothing'}"
            if command != compilers()[-1]:
                warnings.warn(f"{name}: the C compiler failed ({words}). Trying the next one.", stacklevel=2)
    if not words:
        return None
    raise SolveError(
        f"{name}: the C compiler failed ({words}). A C99 compiler with math.h is needed. "
        "Set CC to one that works, or run with method='vm'."
    )


def _writable_folder() -> Path:
    """The cache folder, or a private one for this process where the cache cannot be written."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return _private_folder()
    return folder if os.access(folder, os.W_OK) else _private_folder()


@functools.cache
def _private_folder() -> Path:
    folder = tempfile.mkdtemp(prefix="hydrotwin-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


class _Refused(Exception):
    """A compiler that is missing or returned an error; the text is what it wrote."""


def _compiled(source: str, name: str, command: tuple[str, ...], processor: str) -> Path:
    """The library in the cache, compiled when it is not there; beside it first, then renamed."""
    key = "\0".join((source, *command, _version_of(command), platform.machine(), processor))
    folder = _writable_folder()
    library = folder / f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:24]}{SUFFIX}"
    if library.exists():
        return library
    with tempfile.TemporaryDirectory(dir=folder, prefix=".building-") as building:
        text, made = Path(building) / "model.c", Path(building) / f"model{SUFFIX}"
        text.write_text(source, encoding="utf-8")
        done = _call((*command, str(text), "-o", str(made), *(() if os.name == "nt" else ("-lm",))))
        if done.returncode or not made.exists():
            raise _Refused(done.stderr or done.stdout)
        os.replace(made, library)
    return library


def _call(command: tuple[str, ...]) -> subprocess.CompletedProcess:
    try:
        return subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    except OSError as missing:
        raise _Refused(str(missing)) from missing


@functools.cache
def _version_of(command: tuple[str, ...]) -> str:
    done = _call((*(word for word in command if word not in FLAGS), "--version"))
    return done.stdout.partition("\n")[0]


@functools.cache
def _processor(command: tuple[str, ...]) -> str:
    """What the compiler makes of `NATIVE` here: its macros, one for each set of instructions; "" when it refuses."""
    done = _call((*command, NATIVE, "-dM", "-E", "-x", "c", os.devnull))
    return "" if done.returncode else done.stdout


@functools.cache
def _importable(module: str) -> bool:
    return importlib.util.find_spec(module) is not None
