"""MAT files of every version, and other HDF5: what others store is found by its layout (`mat_layouts`).

hydrotwin writes v5 and v7.3. There every signal is one variable, and the text ``columns`` has one line
``variable: name [unit]`` per column, because a MATLAB variable cannot be called ``cylinder.cap_pressure``.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError

from .binary_files import content_of, unreadable
from .clocks import called_time
from .columns import Table
from .headings import split_header
from .mat_layouts import signals_of
from .mat_trajectory import is_trajectory, signals_of_trajectory
from .mat_tree import HEADER_BYTES, Struct, read_tree
from .rasters import Signal, table_of
from .record import Record


def read_mat(path: Path) -> Table:
    """The table of a MAT file of any version, from 4 to 7.3."""
    content = content_of(path)
    try:
        tree = read_tree(path, content)
        signals = _signals(tree, path)
    except DataError:
        raise
    except Exception as error:  # the parsers raise many kinds for a damaged file
        raise unreadable(path, "MAT", error) from None
    if not any(not s.unusable for s in signals):
        raise DataError(f"{path}: {_why_empty(tree, signals)}")
    return _in_seconds(table_of(path, signals, hashlib.sha256(content).hexdigest()))


def _signals(tree: Struct, path: Path) -> list[Signal]:
    if _is_written_here(tree):
        return _written_here(tree, path)
    return signals_of_trajectory(tree) if is_trajectory(tree) else signals_of(tree)


def _in_seconds(table: Table) -> Table:
    """MATLAB counts time in seconds where nothing says otherwise; the size of a date tells what it is."""
    columns = list(table.columns)
    for k, column in enumerate(columns):
        large = np.nanmax(np.abs(column.values), initial=0.0) >= _DATES
        if called_time(column.name) and column.unit is None and not (column.unusable or large):
            columns[k] = replace(column, unit="s")
            said = f"{column.name} in s, as MATLAB counts it"
            return replace(table, columns=tuple(columns), understood=said)
    return table


_DATES = 7e5  # days of MATLAB since the year 0, and seconds since 1970, are larger


def _is_written_here(tree: Struct) -> bool:
    text = tree.get("columns")
    return isinstance(text, str) and any(line.partition(": ")[0] in tree for line in text.splitlines())


def _written_here(tree: Struct, path: Path) -> list[Signal]:
    """The signals that the text ``columns`` names, which hydrotwin writes."""
    found = []
    for line in tree["columns"].splitlines():
        variable, _, header = line.partition(": ")
        if variable not in tree:
            raise DataError(f"{path}: 'columns' names '{variable}', which the file lacks. Export it again whole.")
        name, unit = split_header(header)
        found.append(Signal(name, unit, np.asarray(tree[variable]), path=variable))
    return found


def _why_empty(tree: Struct, signals: list[Signal]) -> str:
    objects = [s for s in signals if "object of MATLAB" in s.unusable]
    if objects:
        return f"variable '{objects[0].path}': {objects[0].unusable} {_AS_STRUCT}"
    held = ", ".join(list(tree)[:6]) or "nothing"
    return f"no signal over time (it holds {held}). Save the signals and their time as vectors or as a struct of them."


_AS_STRUCT = (
    "Or save it in MATLAB as plain arrays: for a timeseries ts, "
    "time = ts.Time; x = ts.Data; save('run.mat', 'time', 'x')."
)


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
    with h5py.File(path, "w", userblock_size=HEADER_BYTES) as file:
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
