"""LabVIEW measurement files (.lvm): a header of keys for the file, and one for each segment of numbers.

Source: NI, Specification for the LabVIEW Measurement File (.lvm).
"""

from __future__ import annotations

from collections.abc import Sequence

from hydrotwin.models.language.errors import DataError

from .layout import Layout, Lines, cells_of

END = "***End_of_Header***"


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
    keys = _keys(lines.head[: ends[0]], "\t")
    separator = next((line[len("Separator") :] for line in lines.head[: ends[0]] if line.startswith("Separator")), "")
    delimiter = "," if separator[:1] == "," else "\t"
    decimal = "," if "," in keys.get("decimal_separator", ["."])[0] and delimiter != "," else "."
    own = _keys(lines.head[ends[0] + 1 : ends[1]], delimiter)
    names = cells_of(lines[ends[1] + 1], delimiter)
    while names and not names[-1]:
        names.pop()
    first, last = ends[1] + 2, _one_segment(lines, ends[1] + 2, path)
    has_time = (keys.get("x_columns") or _keys(lines.head[: ends[0]], delimiter).get("x_columns", ["One"]))[0].lower()
    if has_time == "multi":
        raise DataError(
            f"{path}: every channel has a time column of its own (X_Columns Multi). Export it with one: X_Columns One."
        )
    over = {cell for cell in own.get("x_dimension", []) if cell} or {"Time"}
    clock = None
    if has_time == "no":
        channels = len(names) - 1 - (names[-1:] == ["Comment"])
        blank = len(cells_of(lines[first], delimiter)) > channels  # the column of times is there, and empty
        names = ["", *names[1:]] if blank else names[1:]
        clock = _clock(own, decimal, path) if over == {"Time"} else None
    units = own.get("y_unit_label", [])
    if names[:1] == [""]:
        units = ["", *units]
    if names[:1] == ["X_Value"]:
        names[0] = "X_Value" if over == {"Time"} else next(iter(over))
        units = ["s" if over == {"Time"} else "", *units]
    width = len(names)
    cells = tuple((units + [""] * width)[:width])
    units_at = next((k for k in range(*ends[:2]) if lines[k].startswith("Y_Unit_Label")), None)
    numeric = frozenset(range(width - (names[-1:] == ["Comment"])))
    layout = Layout(first, last, delimiter, width, tuple(names), cells, ends[1] + 1, units_at, numeric)
    return layout, decimal, clock


def _clock(own: dict[str, list[str]], decimal: str, path) -> tuple[float, float] | None:
    """Start and step [s] that all channels share; None where the file does not say."""
    starts, steps = ({_number(cell, decimal) for cell in own.get(key, []) if cell} for key in ("x0", "delta_x"))
    for key, values in (("X0", starts), ("Delta_X", steps)):
        if len(values) > 1:
            told = ", ".join("?" if v is None else f"{v:g}" for v in values)
            raise DataError(
                f"{path}: its channels have times of their own ({key} {told} s). Export one file per channel, or "
                "resample them alike before the export."
            )
    if len(steps) != 1 or None in steps or None in starts:
        return None
    return next(iter(starts), 0.0), next(iter(steps))


def _keys(lines: Sequence[str], delimiter: str) -> dict[str, list[str]]:
    """The cells behind every key of a header."""
    found = {}
    for line in lines:
        key, *cells = line.rstrip().split(delimiter)
        found[key.strip().lower()] = [cell.strip() for cell in cells] or [""]
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


def _number(cell: str, decimal: str) -> float | None:
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        return None
