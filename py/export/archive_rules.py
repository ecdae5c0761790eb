"""What the standard requires of an FMU as an archive, and whether it can run on this machine."""

from __future__ import annotations

import stat
import zipfile
from pathlib import Path, PurePosixPath

from fmpy import platform as system
from fmpy import platform_tuple

from .archive import file_names
from .fmu_process.verdicts import FAIL, NOT_TRIED, PASS

METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
VERSION = 20  # of zip needed to extract: 2.0
ENCRYPTED = 1  # bit of the flags of a file
LIBRARIES = (".dll", ".so", ".dylib")
EXTRAS = ("documentation", "sources", "resources", "terminalsAndIcons", "extra")


def archive_rows(path: Path) -> dict[str, tuple[str, str]]:
    """Row -> verdict and detail."""
    return {"files": _files(path), "platforms": _platforms(path)}


def _files(path: Path) -> tuple[str, str]:
    if path.is_dir():
        return NOT_TRIED, "an unpacked folder"
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
    bad = {
        "paths that other systems cannot unpack": [e for e in entries if _strange(e.orig_filename)],
        "compressed by another method than deflate": [e for e in entries if e.compress_type not in METHODS],
        "encrypted": [e for e in entries if e.flag_bits & ENCRYPTED],
        "links": [e for e in entries if stat.S_ISLNK(e.external_attr >> 16)],
        "needing a later version of zip than 2.0": [e for e in entries if e.extract_version > VERSION],
    }
    told = [f"{what}: {', '.join(e.orig_filename for e in which[:3])}" for what, which in bad.items() if which]
    if told:
        return FAIL, "; ".join(told)
    size = f"{path.stat().st_size / 1000:.0f} kB, {len(entries)} files"
    extras = [w for w in EXTRAS if any(e.filename.startswith(f"{w}/") for e in entries)]
    return PASS, f"{size}, with {', '.join(extras) or 'no extras'}"


def _strange(name: str) -> bool:
    return "\\" in name or name.startswith("/") or ".." in name.split("/")


def platforms_of(path: Path) -> list[str]:
    """The folders of binaries that hold a library, by the names they have in the FMU."""
    parts = [PurePosixPath(n) for n in file_names(path)]
    libraries = [p.parts for p in parts if len(p.parts) == 3 and p.suffix in LIBRARIES]
    return sorted({platform for top, platform, _ in libraries if top == "binaries"})


def _has_sources(path: Path) -> bool:
    return any(n.startswith("sources/") and n.endswith((".c", ".cpp")) for n in file_names(path))


def _platforms(path: Path) -> tuple[str, str]:
    found = [*platforms_of(path), *(["sources"] if _has_sources(path) else [])]
    return PASS if found else FAIL, ", ".join(found) or "no binary and no sources for any platform"


def why_not_here(path: Path) -> str:
    """Why the FMU cannot run on this machine, with the platforms that it has; "" where it has a binary for it."""
    found = platforms_of(path)
    if {system, platform_tuple} & set(found):
        return ""
    has = f"it has {', '.join(found)}" if found else "it has none"
    sources = ", and sources that could be compiled for it" if _has_sources(path) else ""
    where = f"Run it on such a machine, or ask its maker for {system}"
    return f"no binary for this machine ({system}), {has}{sources}. {where}"
