"""Files are written beside and then renamed: a failed write leaves the old file whole and no debris.

Also what values become on their way into TOML and JSON, which know neither arrays nor, JSON, NaN; and names of files,
which may be no text.
"""

from __future__ import annotations

import math
import os
import stat
import tempfile
import unicodedata
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from pathlib import Path

import numpy as np

from .errors import DataError

_WRITING = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH
_NEXT = "Check the folder, its permissions and the free space."


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """A path beside ``path`` to write to; it takes the place of ``path`` when the block ends without an error.

    A link stays one: what it points to is replaced.

    Raises
    ------
    DataError : the folder does not exist and cannot be made, or may not be written to; the file is read-only.
    """
    path = target(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, beside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error}). {_NEXT}") from None
    os.close(handle)
    try:
        yield Path(beside)
        os.chmod(beside, 0o666 & ~_umask())
        os.replace(beside, path)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error}). {_NEXT}") from None
    finally:
        Path(beside).unlink(missing_ok=True)


def target(path: Path | str) -> Path:
    """The file that is written where ``path`` is: that behind a link.

    Raises DataError for a file that is read-only: somebody means it to stay, and a rename would not ask.
    """
    path = Path(path)
    try:
        if path.is_symlink():
            path = Path(os.path.realpath(path, strict=False))
        if path.is_file() and not (path.stat().st_mode & _WRITING and os.access(path, os.W_OK)):
            raise DataError(f"{path}: it is read-only and stays as it is. Write elsewhere, or make it writable.")
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error}). {_NEXT}") from None
    return path


def write_whole(path: Path | str, content: str | bytes) -> None:
    """Write text (UTF-8, line ends as they are) or bytes as a whole file.

    A sentence with the path of a file whose name is no UTF-8 is written as `printable` has it.
    """
    with replacing(path) as beside:
        beside.write_bytes(_encoded(content) if isinstance(content, str) else content)


def _encoded(text: str) -> bytes:
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError:
        return "".join(_printable(s) if unicodedata.category(s) == "Cs" else s for s in text).encode("utf-8")


def printable(text: str) -> str:
    """Text that every file and screen can hold, for names of files: control signs as spaces, letters of names that are
    no UTF-8 as the old code page of Western Europe has them.

    >>> printable("rig_\\udcd6l\\n2")
    'rig_Öl 2'
    """
    return "".join(_printable(sign) for sign in text)


def _printable(sign: str) -> str:
    if "\udc80" <= sign <= "\udcff":  # how Python keeps a byte that is no UTF-8
        sign = bytes([ord(sign) - 0xDC00]).decode("cp1252", errors="replace")
    kind = unicodedata.category(sign)
    return " " if kind == "Cc" else "\ufffd" if kind == "Cs" else sign


def json_values(value):
    """Only what JSON knows: dataclasses as tables, tuples as lists, arrays as numbers, NaN and infinity as null.

    >>> json_values({"a": np.array([1.0, np.nan])})
    {'a': [1.0, None]}
    """
    if is_dataclass(value) and not isinstance(value, type):
        return json_values(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): json_values(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [json_values(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return json_values(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | int | bool) else str(value)


def toml_values(value):
    """Only what TOML knows: tuples as lists, arrays as numbers, None left out of tables; NaN stays.

    >>> toml_values({"a": np.float64(1.5), "b": None})
    {'a': 1.5}
    """
    if isinstance(value, Mapping):
        return {str(k): toml_values(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [toml_values(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return toml_values(value.tolist())
    return value if isinstance(value, str | int | float | bool) else str(value)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
