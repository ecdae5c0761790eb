"""What a report has written below its folder, so that pages of variants that are no more do not pass for current ones.

The folder holds MANIFEST: every file beside the overview (the pages of variants, criteria as JUnit) by its way from
there, with its SHA-256. A file goes only where it is listed and still has these bytes: what somebody else has put
there, or changed, stays.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

from hydrotwin.models.language.writing import write_whole

MANIFEST = ".written.json"
FORMAT = "hydrotwin-written/1"


def note_written(folder: Path, paths: Iterable[Path]) -> None:
    """List files that were just written, of those that lie in ``folder`` or a folder below; others stay listed."""
    below = {_way(folder, path): path for path in paths}
    _list(folder, {**_listed(folder), **{way: _sha256(path) for way, path in below.items() if _is_below(way)}})


def forget_others(folder: Path, kept: Iterable[str] = ()) -> list[Path]:
    """Remove the listed files that are not in the folders ``kept``, by name, and their folders where nothing is left.

    Returns what was removed. Does nothing in a folder that has no list.
    """
    listed = _listed(folder)
    kept = set(kept)
    others = {way: digest for way, digest in listed.items() if PurePosixPath(way).parts[0] not in kept}
    gone = [folder / way for way, digest in others.items() if _removed(folder, way, digest)]
    for below in {(folder / way).parent for way in others} - {folder}:
        with contextlib.suppress(OSError):  # there is more in it, or it is gone
            below.rmdir()
    if others:
        _list(folder, {way: digest for way, digest in listed.items() if way not in others})
    return gone


def listed_files(folder: Path) -> list[Path]:
    """The listed files that are there as they were written, and not by a link."""
    return [folder / way for way, digest in _listed(folder).items() if _is_own(folder, way, digest)]


def _removed(folder: Path, way: str, digest: str) -> bool:
    if not _is_own(folder, way, digest):
        return False
    (folder / way).unlink(missing_ok=True)
    return True


def _is_own(folder: Path, way: str, digest: str) -> bool:
    path = folder / way
    linked = path.is_symlink() or (path.parent != folder and path.parent.is_symlink())
    return not linked and path.is_file() and _sha256(path) == digest


def _listed(folder: Path) -> dict[str, str]:
    """The files that are listed; of a list that was damaged or changed, those that can be the report's."""
    try:
        told = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        files = told["files"] if told["format"] == FORMAT else {}
        return {way: digest for way, digest in files.items() if _is_below(way) and isinstance(digest, str)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _is_below(way: str) -> bool:
    """Whether a way leads to a file in the folder of the report or in one of its folders, and nowhere else."""
    parts = PurePosixPath(way).parts
    return len(parts) in (1, 2) and not set(parts) & {"..", "/"} and "\\" not in way and ":" not in parts[0]


def _list(folder: Path, files: Mapping[str, str]) -> None:
    if files:
        told = {"format": FORMAT, "files": dict(sorted(files.items()))}
        write_whole(folder / MANIFEST, json.dumps(told, indent=1) + "\n")
    else:
        (folder / MANIFEST).unlink(missing_ok=True)


def _way(folder: Path, path: Path) -> str:
    """The way of a file from the folder; ".." begins that of a file elsewhere."""
    path, folder = path.absolute(), folder.absolute()
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else "../"


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
