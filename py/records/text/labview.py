"""LabVIEW measurement files (.lvm): a header of keys for the file, and one for each segment of numbers.

Source: NI, Specification for the LabVIEW Measurement File (.lvm).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from hydrotwin.models.language.errors import DataError

from .layout import Layout, Lines, cells_of

END = "***End_of_Header***"
_DELIMITERS = {"tab": "\t", "comma": ","}


def is_labview(line: str) -> bool:
    """Whether a text that begins so is one."""
    return line.lstrip("\ufeff").startswith("LabVIEW Measurement")


def labview_layout(lines: Lines, path) -> tuple[Layout, str, tuple[float, float] | None]:
    """The layout, the decimal sign, and (start, step) [s] where the file counts samples instead of giving their time.

    Raises `DataError` for several segments of numbers, whose times have origins of their own.
    """
    ends = [k for k, line in enumerate(lines.head[:400]) if line.startswith(END)]
    if len(ends) < 2 or len(lines) < ends[1] + 3:
        raise DataError(f"{path}: the header of a LabVIEW file has no end ('{END}'), or no numbers. Export it again.")
    keys = _keys(lines.head[: ends[0]])
    delimiter = _DELIMITERS.get(keys.get("separator", ["tab"])[0].lower(), "\t")
    decimal = "," if keys.get("decimal_separator", ["."])[0] == "," else "."
    own = {key: [cell.strip() for cell in cells] for key, cells in _keys(lines.head[ends[0] + 1 : ends[1]]).items()}
    names = cells_of(lines[ends[1] + 1], delimiter)
    while names and names[-1] in ("Comment", ""):
        names.pop()
    last = _one_segment(lines, ends[1] + 2, path)
    units = own.get("y_unit_label", [])
    has_time = keys.get("x_columns", ["One"])[0].lower()
    if has_time == "multi":
        raise DataError(
            f"{path}: every channel has a time column of its own (X_Columns Multi). Export it with one: X_Columns One."
        )
    first = ends[1] + 2
    clock = None
    if has_time == "no":
        blank = len(cells_of(lines[first], delimiter)) >= len(names)  # the column of times is there, and empty
        names = names if blank else names[1:]
        clock = _number(own.get("x0"), decimal, 0.0), _number(own.get("delta_x"), decimal, 1.0)
    width = len(names)
    row_of_units = ["s", *units] if names[:1] == ["X_Value"] else units
    cells = tuple((row_of_units + [""] * width)[:width])
    units_at = next((k for k in range(*ends[:2]) if lines[k].startswith("Y_Unit_Label")), None)
    numeric = frozenset(range(width))
    layout = Layout(first, last, delimiter, width, tuple(names), cells, ends[1] + 1, units_at, numeric)
    return layout, decimal, clock


def _keys(lines: Sequence[str]) -> dict[str, list[str]]:
    found = {}
    for line in lines:
        key, *cells = re.split(r"[\t,](?!\d)|\t", line.rstrip())
        found[key.strip().lower()] = cells or [""]
        if key.strip().lower() in ("separator", "decimal_separator"):
            found[key.strip().lower()] = [line[len(key) + 1 :].strip()]
    return found


def _one_segment(lines: Lines, first: int, path) -> int:
    last = len(lines)
    while last > first and not lines[last - 1].strip():
        last -= 1
    again = lines.line_with("Channels", first)
    if again is not None:
        raise DataError(
            f"{path}: row {again + 1}: another segment begins here, with a header and a time of its own. Save each "
            "segment as a file of its own (Multi_Headings No)."
        )
    return last


def _number(cells: Sequence[str] | None, decimal: str, default: float) -> float:
    try:
        return float(cells[0].replace(decimal, "."))
    except (TypeError, ValueError, IndexError):
        return default
