"""Recordings as CSV with a header ``name [unit]``, written and read without the project's own reader."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .machines import machine_of

FACTORS = {"deg": 180 / np.pi, "mm": 1e3, "bar": 1e-5}
DIGITS = {"deg": 5, "mm": 4, "bar": 4, "rad/s": 3, "N": 2, "m/s": 6, "1": 6, "V": 6, "s": 9, "m": 7, "Pa": 1, "rad": 7}


def _text(values: np.ndarray, digits: int | None) -> list[str]:
    if digits is None:
        return [repr(float(v)) for v in values]
    return [f"{v:.{digits}f}" for v in values]


def file_units(machine: str) -> dict[str, str]:
    """The units the columns of this machine have in a file: degrees, bar and millimetres, as an engineer plots them."""
    m = machine_of(machine)
    return {"time": "s", m.input: m.input_unit, **dict(zip(m.outputs, m.file_units, strict=True))}


def write_csv(
    columns: Mapping[str, np.ndarray], path, *, units: Mapping[str, str], exact=("time", "command", "current")
) -> Path:
    """Write SI columns in the given file units; columns named in ``exact`` keep every digit."""
    path = Path(path)
    texts = []
    for name, values in columns.items():
        unit = units[name]
        scaled = np.asarray(values, dtype=float) * FACTORS.get(unit, 1.0)
        texts.append(_text(scaled, None if name in exact else DIGITS[unit]))
    header = ",".join(f"{name} [{units[name]}]" for name in columns)
    beside = path.with_name(path.name + ".part")
    with open(beside, "w", encoding="utf-8", newline="\n") as file:
        file.write(header + "\n")
        file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))
    os.replace(beside, path)
    return path


def read_csv(path) -> dict[str, np.ndarray]:
    """Columns in SI; only the units this rig writes."""
    with open(path, encoding="utf-8") as file:
        header = file.readline().strip().split(",")
        table = np.loadtxt(file, delimiter=",")
    columns = {}
    for label, values in zip(header, table.T, strict=True):
        name, unit = label.rstrip("]").split(" [")
        columns[name] = values / FACTORS.get(unit, 1.0)
    return columns
