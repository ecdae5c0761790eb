"""Zip archives that are the same bytes for the same content."""

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
