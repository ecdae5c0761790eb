"""Columns far larger than what a model declares as usual: most likely in another unit."""

from __future__ import annotations

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.records.sizes import far_from_usual

PRESSURE = Signal("p", "Pa", nominal=1e6)
UNITS = {"p": "Pa", "x": "m"}


def of(name: str, p: float, x: float = 1.0) -> Record:
    return Record(np.arange(3.0), {"p": np.array([0.0, p, np.nan]), "x": np.array([0.0, x, 0.0])}, UNITS, name)


def test_a_column_a_hundred_times_as_large_as_usual_is_told_once_and_others_are_not():
    """Pa, read as bar: an identification had run for minutes, and said that every run diverges."""
    records = [of("right", 2e7), of("bar", -3e11), of("more", 2e11)]
    (told,) = far_from_usual(records, [PRESSURE, Signal("p", "Pa"), Signal("x", "m"), Signal("z", "m", nominal=0.1)])
    assert told.startswith("p of bar (and 1 more) is as large as 3e+06 bar, 3e+05 times")
    assert "usual (10 bar). Check its unit: --unit 'p=bar'" in told
    assert not far_from_usual(records[:1], [PRESSURE])
    assert not far_from_usual(
        [of("far", 0.0, 1e9)], [Signal("x", "m"), Signal("x", "1", nominal=0.1), Signal("y", "m")]
    )
    assert not far_from_usual([of("other", 1e12)], [Signal("p", "m", nominal=1e-3)])
