"""Compile the sources of an FMU for one platform: zig for any of them, the system's compiler for this one."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import platformdirs
from hydrotwin.models.language.errors import DeclarationError, SolveError, nearest

TARGETS = {  # FMI 2 folder -> (zig target, suffix of the library)
    "linux64": ("x86_64-linux-gnu.2.17", ".so"),
    "win64": ("x86_64-windows-gnu", ".dll"),
    "darwin64": ("x86_64-macos", ".dylib"),
    "aarch64-linux": ("aarch64-linux-gnu.2.17", ".so"),
    "aarch64-darwin": ("aarch64-macos", ".dylib"),
}
STRICT = ("-std=c99", "-pedantic", "-Wall", "-Werror")
FLAGS = (*STRICT, "-O2", "-fPIC", "-ffp-contract=off", "-fvisibility=hidden", "-shared", "-s")
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


def compile_for(target_platform: str, identifier: str, sources: Mapping[str, str]) -> tuple[str, bytes]:
    """File name and bytes of the shared library with exactly the FMI functions exported.

    Raises DeclarationError for an unknown platform, SolveError with the compilers' own words when none works.
    """
    if target_platform not in TARGETS:
        raise DeclarationError(f"platform: no '{target_platform}'. {nearest(target_platform, TARGETS)}")
    target, suffix = TARGETS[target_platform]
    words = []
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        for command in _compilers(target, target_platform):
            made = Path(folder) / f"{identifier}{suffix}"
            said = _compile(command, folder, sorted(n for n in sources if n.endswith(".c")), made)
            if said is None:
                return made.name, made.read_bytes()
            words.append(f"'{' '.join(command[:4])}' said: {said}")
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


def _compile(command: list[str], folder: str, files: list[str], made: Path) -> str | None:
    """None when it worked, else what the compiler said. The math library is part of the C library on Windows."""
    libraries = [] if made.suffix == ".dll" else ["-lm"]
    line = [*command, *FLAGS, *files, "-o", made.name, *libraries]
    try:
        done = subprocess.run(
            line, cwd=folder, capture_output=True, text=True, errors="replace", timeout=TIME_LIMIT, check=False,
            env=_environment(),
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as failure:
        return str(failure)
    if done.returncode or not made.exists():
        return (done.stderr or done.stdout).strip()[-1500:] or "nothing"
    return None


def _environment() -> dict[str, str]:
    """zig keeps what it compiled in the user's cache folder, which makes the second build quick."""
    cache = os.environ.get("ZIG_GLOBAL_CACHE_DIR") or platformdirs.user_cache_dir("hydrotwin-zig", appauthor=False)
    return {**os.environ, "ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache}
