"""Compile the sources of an FMU for one platform: zig for any of them, the system's compiler for this one."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from hydrotwin.models.language.errors import DeclarationError, SolveError, nearest
from hydrotwin.simulation.compiler import cache_folder

TARGETS = {  # FMI 2 folder -> (zig target, suffix of the library)
    "linux64": ("x86_64-linux-gnu.2.17", ".so"),
    "win64": ("x86_64-windows-gnu", ".dll"),
    "darwin64": ("x86_64-macos", ".dylib"),
    "aarch64-linux": ("aarch64-linux-gnu.2.17", ".so"),
    "aarch64-darwin": ("aarch64-macos", ".dylib"),
}
FMI3_FOLDERS = {
    "linux64": "x86_64-linux", "win64": "x86_64-windows", "darwin64": "x86_64-darwin",
    "aarch64-linux": "aarch64-linux", "aarch64-darwin": "aarch64-darwin",
}  # fmt: skip
STRICT = ("-std=c99", "-pedantic", "-Wall", "-Werror")
FLAGS = (*STRICT, "-O2", "-fPIC", "-ffp-contract=off", "-fvisibility=hidden")
# Values, step, names. Every other source is the same in every FMU, or (functions.c) in all that have these equations,
# whatever their kind, step and values: compiled once, kept as an object.
OWN = ("model.c",)
TIME_LIMIT = 300.0


def native_platform() -> str:
    """The FMI 2 folder name of this machine.

    Raises DeclarationError on a machine for which FMUs are not built.
    """
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    system = {"Linux": "linux", "Windows": "windows", "Darwin": "macos"}.get(platform.system(), "")
    for folder, (target, _) in TARGETS.items():
        if target.startswith(f"{machine}-{system}") and system:
            return folder
    raise DeclarationError(
        f"platform: FMUs are not built for this machine (got {platform.system()} {machine}). "
        f"Name platforms. Known: {', '.join(TARGETS)}."
    )


def platforms_named(names: Sequence[str] | None) -> tuple[str, ...]:
    """Names of FMI 2 for names of either version, "all", or None for this machine. DeclarationError for others."""
    if names is None:
        return (native_platform(),)
    of_fmi3 = {new: old for old, new in FMI3_FOLDERS.items()}
    found: list[str] = []
    for name in names:
        if name != "all" and name not in TARGETS and name not in of_fmi3:
            raise DeclarationError(
                f"platform: no '{name}'. {nearest(name, dict.fromkeys(['all', *TARGETS, *of_fmi3]))}"
            )
        found += list(TARGETS) if name == "all" else [of_fmi3.get(name, name)]
    return tuple(dict.fromkeys(found))


def compile_for(target_platform: str, identifier: str, sources: Mapping[str, str]) -> tuple[str, bytes]:
    """File name and bytes of the shared library with exactly the FMI functions exported.

    Raises DeclarationError for an unknown platform, SolveError with the compilers' own words when none works.
    """
    if target_platform not in TARGETS:
        raise DeclarationError(f"platform: no '{target_platform}'. {nearest(target_platform, TARGETS)}")
    target, suffix = TARGETS[target_platform]
    words = []
    for command in _compilers(target, target_platform):
        kept = _kept(command, sources, sources, suffix)
        if not kept.exists():
            said = _compile(command, sources, kept)
            if said is not None:
                words.append(f"'{' '.join(command[:4])}' said: {said}")
                continue
        return f"{identifier}{suffix}", kept.read_bytes()
    raise SolveError(
        f"{identifier}: compiling for {target_platform} failed ({'; '.join(words) or 'no compiler found'}). "
        "The ziglang package compiles for every platform. Install it: pip install ziglang."
    )


def _compilers(target: str, target_platform: str) -> list[list[str]]:
    """Commands to try in turn: zig, and for this machine the system's own."""
    commands = []
    if importlib.util.find_spec("ziglang"):
        commands.append([sys.executable, "-m", "ziglang", "cc", "-target", target])
    if shutil.which("cc") and target_platform == native_platform():
        commands.append(["cc"])
    return commands


def _kept(command: list[str], sources: Mapping[str, str], names: Iterable[str], suffix: str) -> Path:
    """Where what this very compiler made from sources of these names and this very text is kept."""
    key = "\0".join((*command[1:], _version(tuple(command)), *FLAGS, *(f"{n}\0{sources[n]}" for n in sorted(names))))
    return cache_folder() / f"fmu-{hashlib.sha256(key.encode()).hexdigest()[:32]}{suffix}"


def _compile(command: list[str], sources: Mapping[str, str], kept: Path) -> str | None:
    """None when it worked, else what the compiler said. The math library is part of the C library on Windows."""
    headers = [n for n in sources if n.endswith(".h")]
    shared = {
        n: _kept(command, sources, [n, *headers], ".o") for n in sorted(sources) if n.endswith(".c") and n not in OWN
    }
    kept.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=kept.parent, prefix=".building-") as folder, ThreadPoolExecutor() as pool:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        missing = {n: path for n, path in shared.items() if not path.exists()}
        said = pool.map(lambda n: _run([*command, *FLAGS, "-c", n], folder, missing[n]), missing)
        own = [n for n in OWN if n in sources]
        options = ["-shared", "-s", *own, *map(str, shared.values()), *([] if kept.suffix == ".dll" else ["-lm"])]
        return next(filter(None, said), None) or _run([*command, *FLAGS, *options], folder, kept)


def _run(line: Sequence[str], folder: str, made: Path) -> str | None:
    """None when the compiler made the file, else what it said."""
    there = Path(folder) / made.name
    done = _call([*line, "-o", made.name], folder)
    if done.returncode or not there.exists():
        return (done.stderr or done.stdout).strip()[-1500:] or "nothing"
    os.replace(there, made)
    return None


def _call(line: Sequence[str], folder: str | None = None) -> subprocess.CompletedProcess:
    """Run a compiler; one that is missing or hangs counts as a failure with a word on why."""
    environment = {**os.environ, "ZIG_GLOBAL_CACHE_DIR": _zig_cache(), "ZIG_LOCAL_CACHE_DIR": _zig_cache()}
    try:
        return subprocess.run(
            line, cwd=folder, capture_output=True, text=True, errors="replace", timeout=TIME_LIMIT, check=False,
            env=environment,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as failure:
        return subprocess.CompletedProcess(line, 1, "", str(failure))


@functools.cache
def _version(command: tuple[str, ...]) -> str:
    if "ziglang" in command:
        return importlib.metadata.version("ziglang")
    return _call((*command, "--version")).stdout.partition("\n")[0]


def _zig_cache() -> str:
    return os.environ.get("ZIG_GLOBAL_CACHE_DIR") or str(cache_folder() / "zig")
