"""MAT files: v5 (scipy) and v7.3 (HDF5). Every signal is one variable; the text ``columns`` names them and their units.

``columns`` has one line ``variable: name [unit]`` per column, because a MATLAB variable cannot be called
``cylinder.cap_pressure``. Files of others need no ``columns``: every numeric vector is a column under its own name, the
unit comes from a struct ``units`` with the same field names, or from ``read_record(..., units=)``.
"""

from __future__ import annotations

import hashlib
import io
import re
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from .binary_files import as_numbers, unreadable
from .columns import Column, Table
from .headings import split_header
from .record import Record

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 512  # MATLAB's own text before the HDF5 part of a v7.3 file


def read_mat(path: Path) -> Table:
    """The table of a MAT file of either version."""
    content = path.read_bytes()
    if not content:
        raise DataError(f"{path}: row 1: the file is empty. Copy or export it again.")
    is_hdf5 = (
        _HDF5_SIGNATURE in (content[:8], content[_HEADER_BYTES : _HEADER_BYTES + 8]) or b"MATLAB 7.3" in content[:16]
    )
    try:
        variables, texts = (_read_hdf5 if is_hdf5 else _read_v5)(content)
    except Exception as error:  # both parsers raise many kinds for a damaged file
        raise unreadable(path, "MAT", error) from None
    columns = [_column(path, *item) for item in _named(variables, texts, path)]
    length = max((len(c.values) for c in columns), default=0)
    columns = [c for c in columns if len(c.values) > 1 or length <= 1]
    return Table(str(path), tuple(columns), lambda k: k + 1, hashlib.sha256(content).hexdigest())


def write_mat(headers: list[str], columns: list[np.ndarray], record: Record, path: Path) -> None:
    """Write MAT v5: column vectors and the text ``columns``."""
    import scipy.io

    variables = _variables(headers)
    content = dict(zip(variables, (c[:, None] for c in columns), strict=True))
    content["columns"] = _columns_text(variables, headers)
    scipy.io.savemat(path, content, format="5", do_compression=True, long_field_names=True, appendmat=False)


def write_mat73(headers: list[str], columns: list[np.ndarray], record: Record, path: Path) -> None:
    """Write MAT v7.3: the same variables, as HDF5 with MATLAB's header and class attributes."""
    import h5py

    variables = _variables(headers)
    with h5py.File(path, "w", userblock_size=_HEADER_BYTES) as file:
        for variable, values in zip(variables, columns, strict=True):
            file.create_dataset(variable, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        text = np.frombuffer(_columns_text(variables, headers).encode("utf-16-le"), dtype="<u2")
        dataset = file.create_dataset("columns", data=text[:, None])
        dataset.attrs["MATLAB_class"] = np.bytes_("char")
        dataset.attrs["MATLAB_int_decode"] = np.int32(2)
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, written by hydrotwin".ljust(124) + b"\x00\x02IM")


def _variables(headers: list[str]) -> list[str]:
    """A MATLAB identifier for every column: at most 63 letters, digits and underscores, all different."""
    taken = {"columns", "units"}
    variables = []
    for header in headers:
        stem = re.sub(r"[^A-Za-z0-9_]", "_", split_header(header)[0])[:55]
        stem = stem if re.match(r"[A-Za-z]", stem) else f"x{stem}"
        variable, count = stem, 2
        while variable in taken:
            variable, count = f"{stem}_{count}", count + 1
        taken.add(variable)
        variables.append(variable)
    return variables


def _columns_text(variables: list[str], headers: list[str]) -> str:
    return "\n".join(f"{v}: {h}" for v, h in zip(variables, headers, strict=True))


def _named(variables: dict, texts: dict[str, str], path: Path) -> list[tuple[str, str | None, np.ndarray]]:
    """``(name, unit, values)`` of every column."""
    if "columns" not in texts:
        return [(name, texts.get(f"units.{name}"), values) for name, values in variables.items()]
    named = []
    for line in texts["columns"].splitlines():
        variable, _, header = line.partition(": ")
        if variable not in variables:
            raise DataError(f"{path}: 'columns' names '{variable}', which the file lacks. Export it again whole.")
        named.append((*split_header(header), variables[variable]))
    return named


def _column(path: Path, name: str, unit: str | None, values: np.ndarray) -> Column:
    values = np.asarray(values)
    if values.ndim > 1 and max(values.shape) != values.size:
        shape = " x ".join(map(str, values.shape))
        raise DataError(
            f"{path}: row 1, column '{name}': one value per sample is needed (got a {shape} array). "
            "Save each of its columns as a variable of its own."
        )
    return Column(name, unit, as_numbers(values.ravel(), path, name))


def _read_v5(content: bytes) -> tuple[dict, dict[str, str]]:
    import scipy.io

    loaded = scipy.io.loadmat(io.BytesIO(content), chars_as_strings=True, struct_as_record=True)
    variables, texts = {}, {}
    for name, value in loaded.items():
        if name.startswith("__"):
            continue
        if value.dtype.names:  # a struct: only the text of `units` is of use here
            fields = {f: value[f].flat[0] for f in value.dtype.names} if value.size else {}
            texts |= {f"{name}.{f}": _joined(v) for f, v in fields.items() if np.asarray(v).dtype.kind == "U"}
        elif value.dtype.kind == "U":
            texts[name] = _joined(value)
        elif value.dtype.kind != "O":
            variables[name] = value
    return variables, texts


def _joined(text: np.ndarray) -> str:
    return "\n".join(str(line) for line in np.ravel(text))


def _read_hdf5(content: bytes) -> tuple[dict, dict[str, str]]:
    import h5py

    variables: dict[str, np.ndarray] = {}
    texts: dict[str, str] = {}

    def visit(name: str, item) -> None:
        if name.startswith("#") or not isinstance(item, h5py.Dataset):
            return
        kind = item.attrs.get("MATLAB_class", b"")
        if kind == b"char":
            texts[name.replace("/", ".")] = np.ravel(item[()]).astype("<u2").tobytes().decode("utf-16-le")
        elif "/" not in name and item.dtype.kind in "fiubcSO" and kind != b"cell":
            variables[name] = item[()]

    with h5py.File(io.BytesIO(content), "r") as file:
        file.visititems(visit)
    return variables, texts
