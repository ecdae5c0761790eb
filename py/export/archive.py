"""Zip archives that are the same bytes for the same content; what is in an FMU, packed or unpacked."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from pathlib import Path

from hydrotwin.models.language.writing import replacing

EPOCH = (1980, 1, 1, 0, 0, 0)
REGULAR_FILE = 0o100644 << 16


def write_archive(path: str | os.PathLike, files: Mapping[str, str | bytes]) -> Path:
    """Write the files, sorted by name, dated 1980, paths with ``/``."""
    with replacing(path) as beside, zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            archive.writestr(_entry(name), files[name], compresslevel=9)
    return Path(path)


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, EPOCH)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = REGULAR_FILE
    entry.create_system = 3
    return entry


def file_names(path: Path) -> list[str]:
    """Files of an FMU, an archive or a folder, with ``/``."""
    if path.is_dir():
        return [f.relative_to(path).as_posix() for f in path.rglob("*") if f.is_file()]
    with zipfile.ZipFile(path) as archive:
        return archive.namelist()


def read_file(path: Path, name: str) -> bytes:
    """One of them. KeyError or OSError where there is none."""
    if path.is_dir():
        return (path / name).read_bytes()
    with zipfile.ZipFile(path) as archive:
        return archive.read(name)
