"""Writing CSV."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ..record import Record


def write_csv(headers: list[str], columns: list[np.ndarray], record: Record, path: Path) -> None:
    """Write columns with the shortest digits that read back to the same number."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(headers)
        for start in range(0, len(columns[0]), 4096):
            rows = zip(*(c[start : start + 4096].tolist() for c in columns), strict=True)
            file.write("".join(",".join(map(repr, row)) + "\n" for row in rows))
