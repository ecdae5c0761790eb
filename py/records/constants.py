"""What was not recorded and was constant, at the value that a person gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .columns import Column, Table
from .reading import Reading, constant, is_alone


def with_constants(table: Table, reading: Reading, refused: dict[str, str]) -> Table:
    """The table with what was not recorded; it replaces a column of that name.

    A number alone says no more than a column without a unit (50 of a valve may be 50 % or 5000 %), and is ``refused``
    as one, unless a scale says what one of it stands for. 0 is 0 in every unit of a pure number.
    """
    if not reading.constants:
        return table
    n = len(table.columns[0].values)
    given = {name: constant(name, text) for name, text in reading.constants.items()}
    told = _told(given, reading)
    columns = [c for c in table.columns if c.name not in given]
    columns += [Column(name, unit, np.full(n, value)) for name, (value, unit) in told.items()]
    for name in given:
        refused.pop(name, None)
    refused |= {name: _no_unit(name, reading.constants[name]) for name in given.keys() - told.keys()}
    here = {c.name for c in table.columns}
    said = ", ".join(
        f"{name} = {text}{' in place of what was recorded' if name in here else ''}"
        for name, text in reading.constants.items()
    )
    return replace(table, columns=tuple(columns), understood=f"{table.understood}, set {said}".removeprefix(", "))


def _told(given: Mapping[str, tuple[float, str]], reading: Reading) -> Mapping[str, tuple[float, str]]:
    """Those of which it is told what they are."""
    alone = {n for n in given if is_alone(reading.constants[n]) and n not in reading.scale}
    return {n: (value, unit) for n, (value, unit) in given.items() if n not in alone or value == 0.0}


def _no_unit(name: str, text: str) -> str:
    return (
        f"set: '{name} = {text}' has no unit. Write it behind the number, --set '{name}={text} UNIT', or "
        f"'{name}={text} 1' for a pure number."
    )
