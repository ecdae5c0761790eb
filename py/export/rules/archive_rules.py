"""What the standard requires of an FMU as an archive, and whether it can run on this machine."""

from __future__ import annotations

import stat
import zipfile
from pathlib import Path, PurePosixPath

from fmpy import platform as system
from fmpy import platform_tuple

from ..archive import file_names
from ..fmu_process.verdicts import FAIL, NOT_TRIED, PASS
from .declared import Declared
from .findings import Findings

METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
VERSION = 20  # of zip needed to extract: 2.0
ENCRYPTED = 1  # bit of the flags of a file
LIBRARIES = (".dll", ".so", ".dylib")
EXTRAS = ("documentation", "sources", "resources", "terminalsAndIcons", "extra")


def archive_rows(path: Path, declared: Declared) -> dict[str, tuple[str, str]]:
    """Row -> verdict and detail."""
    return {"files": _files(path), "platforms": _platforms(path, declared)}


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
    return sorted(_libraries(path))


def _libraries(path: Path) -> dict[str, set[str]]:
    """Folder of a platform -> its libraries, those of Windows in small letters."""
    found: dict[str, set[str]] = {}
    for parts in (PurePosixPath(n).parts for n in file_names(path)):
        if len(parts) == 3 and parts[0] == "binaries" and parts[2].endswith(LIBRARIES):
            found.setdefault(parts[1], set()).add(_as_found(parts[2]))
    return found


def _as_found(library: str) -> str:
    return library.lower() if library.endswith(".dll") else library


def _has_sources(path: Path) -> bool:
    return any(n.startswith("sources/") and n.endswith((".c", ".cpp")) for n in file_names(path))


def _platforms(path: Path, declared: Declared) -> tuple[str, str]:
    """There is an implementation, and a library has the name that each interface says it has."""
    found, libraries = Findings(), _libraries(path)
    has = [*sorted(libraries), *(["sources"] if _has_sources(path) else [])]
    if not has:
        found.breaks("", ["no binary and no sources for any platform"])
    for name in dict.fromkeys(e.get("modelIdentifier", "") for e in declared.interfaces):
        called = {_as_found(name + ending) for ending in LIBRARIES}
        lost = [f"{platform} has {', '.join(sorted(o)[:2])}" for platform, o in libraries.items() if not called & o]
        found.breaks(f"no library is called '{name}', the modelIdentifier", lost)
    return found.verdict(", ".join(has))


def why_not_here(path: Path) -> str:
    """Why the FMU cannot run on this machine, with the platforms that it has; "" where it has a binary for it."""
    found = platforms_of(path)
    if {system, platform_tuple} & set(found):
        return ""
    has = f"it has {', '.join(found)}" if found else "it has none"
    sources = ", and sources that could be compiled for it" if _has_sources(path) else ""
    where = f"Run it on such a machine, or ask its maker for {system}"
    return f"no binary for this machine ({system}), {has}{sources}. {where}"
