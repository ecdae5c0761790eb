"""Columns of a file before they are checked."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

ZEROS_BEFORE = re.compile(r"0\d+")  # as no number is written: 0012 is the name of something
UNSEEN = 1e-4  # of a step: rounding of the time that nobody sees


@dataclass(frozen=True)
class Column:
    """One column as the file has it: ``unit`` is None where the file names none.

    unusable : why the column holds no numbers, a sentence. texts : its cells as they are written, of a column that
    holds no numbers, or numbers with more digits than a float has, or zeros before them; numbers with a decimal point.
    """

    name: str
    unit: str | None
    values: np.ndarray
    unusable: str = ""
    texts: Sequence[str] | None = None


@dataclass(frozen=True)
class Table:
    """Columns of one file.

    ``row`` maps a sample index to the row number a person sees in the file; ``header`` says where the names stand.
    ``marks_unknown``: the format marks unknown samples itself, so NaN is no fault of the file. ``understood``: in
    words, how the file was read.
    """

    path: str
    columns: tuple[Column, ...]
    row: Callable[[int], int]
    digest: str
    header: str = "header"
    marks_unknown: bool = False
    understood: str = ""


def rounding_of(time: np.ndarray) -> float:
    """How much double precision rounds a time of this size, as a share of the usual step; (n,) finite or not."""
    time = time[np.isfinite(time)]
    usual = float(np.median(np.abs(np.diff(time)))) if len(time) > 1 else 0.0
    return float(np.spacing(np.abs(time).max())) / usual if usual else np.inf
