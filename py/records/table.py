"""Table: what a file holds before it is checked; and the checks that turn it into a Record."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.errors import DataError, UnitError, nearest
from hydrotwin.models.language.units import compatible, parse_unit, to_si

from .record import Record
from .scale import Scale

MISSING = ("error", "drop rows", "keep")
SLOWER = 0.05  # share of the steps that leaving rows out may lengthen; beyond, what is left is another sampling
UNSEEN, ROUGH = 1e-4, 1e-2  # of a step: rounding of the time that nobody sees; that makes steps uneven
FEW = 3  # steps that may always be longer: a short table with a flaw or two


@dataclass(frozen=True)
class Column:
    """One column as the file has it: ``unit`` is None where the file names none.

    unusable : why the column holds no numbers, a sentence; its ``values`` are all NaN then.
    """

    name: str
    unit: str | None
    values: np.ndarray
    unusable: str = ""


@dataclass(frozen=True)
class Table:
    """Columns of one file.

    ``row`` maps a sample index to the row number a person sees in the file; ``header`` says where the names stand.
    ``marks_unknown``: the format marks unknown samples itself, so NaN is no fault of the file.
    """

    path: str
    columns: tuple[Column, ...]
    row: Callable[[int], int]
    digest: str
    header: str = "header"
    marks_unknown: bool = False


def split_header(text: str) -> tuple[str, str | None]:
    """``"arm_angle [rad]"`` -> ``("arm_angle", "rad")``; the unit is None when there are no filled brackets."""
    match = re.fullmatch(r"(.*?)\s*\[([^\]]*)\]", text.strip(), flags=re.DOTALL)
    name, unit = (match[1], match[2].strip()) if match else (text, "")
    return name.strip().lstrip("\ufeff"), unit or None


def record_from_table(
    table: Table, name: str, scale: Mapping[str, Scale], units: Mapping[str, str], missing: str
) -> Record:
    """Check a table and convert it to SI. Raises `DataError` or `UnitError` naming file, row and column."""
    if missing not in MISSING:
        raise DataError(f"missing: not a choice (got {missing!r}). {nearest(str(missing), MISSING)}")
    table = _named_columns(table)
    table = _time_first(_with_units(table, scale, units))
    _check_length(table)
    table = _without_missing(table, missing)
    _check_finite(table)
    _check_time(table)
    table = _from_first_time(table)
    return _in_si(table, name, scale)


def _named_columns(table: Table) -> Table:
    seen: dict[str, int] = {}
    for number, column in enumerate(table.columns, start=1):
        if not column.name:
            raise DataError(
                f"{table.path}: {table.header}, column {number} has no name. Write 'name [unit]' in the header."
            )
        if column.name in seen:
            raise DataError(
                f"{table.path}: {table.header}, columns {seen[column.name]} and {number} "
                f"are both named '{column.name}'. Names must differ; rename one."
            )
        seen[column.name] = number
    return table


def _with_units(table: Table, scale: Mapping[str, Scale], units: Mapping[str, str]) -> Table:
    names, where = [c.name for c in table.columns], f"{table.path}: {table.header}"
    for wanted, option in [*((n, "scale") for n in scale), *((n, "units") for n in units)]:
        if wanted not in names:
            raise DataError(f"{table.path}: no column '{wanted}', named in {option}. {nearest(wanted, names)}")
    return replace(table, columns=tuple(_with_unit(where, c, c.name in scale, units) for c in table.columns))


def _with_unit(where: str, column: Column, scaled: bool, units: Mapping[str, str]) -> Column:
    unit = units.get(column.name, column.unit)
    if unit is None and scaled:
        unit = "1"
    if unit is None:
        raise DataError(
            f"{where}, column '{column.name}' has no unit. "
            f"Write '{column.name} [unit]' in the header ([1] for a pure number), or read it with units=."
        )
    try:
        parse_unit(unit)
    except UnitError as error:
        raise UnitError(f"{where}, column '{column.name}': {error}") from None
    return replace(column, unit=unit)


def _time_first(table: Table) -> Table:
    if not table.columns:
        raise DataError(f"{table.path}: {table.header} names no column. The first one must be 'time [s]'.")
    names = [c.name for c in table.columns]
    if "time" not in names:
        found = ", ".join(names[:8])
        raise DataError(
            f"{table.path}: {table.header} has no column 'time' (got {found}). Name the time axis 'time [s]'."
        )
    at = names.index("time")
    time = table.columns[at]
    if not compatible(time.unit, "s"):
        raise UnitError(f"{table.path}: {table.header}, column 'time' is in {time.unit}. Time is in s, ms, min or h.")
    return replace(table, columns=(time, *table.columns[:at], *table.columns[at + 1 :]))


def _check_length(table: Table) -> None:
    time = table.columns[0].values
    for column in table.columns:
        if len(column.values) != len(time):
            raise DataError(
                f"{table.path}: column '{column.name}' has {len(column.values)} rows, 'time' has {len(time)}: "
                f"row {table.row(min(len(column.values), len(time)))} is incomplete. All columns need the same length."
            )
    if len(time) < 2:
        what = f"only one row of values (row {table.row(0)})" if len(time) else "a header and no row of values"
        raise DataError(f"{table.path}: {what}, column 'time' needs two or more. Record longer, or check the export.")


def _without_missing(table: Table, missing: str) -> Table:
    absent = np.array([np.isnan(c.values) for c in table.columns])  # the first is time
    rows = absent.any(axis=0)
    kept_unknown = missing == "keep" or (missing == "error" and table.marks_unknown)
    if not rows.any() or (kept_unknown and not absent[0].any()):
        return table
    if missing != "drop rows":
        _fail_missing(table, absent[:1] if kept_unknown else absent)
    kept = np.flatnonzero(~rows)
    if len(kept) < 2:
        raise DataError(
            f"{table.path}: {len(kept)} rows are complete, column 'time' needs two or more. {_keep_instead(absent)}"
        )
    _check_rate(table, absent, kept)
    row = table.row
    columns = tuple(replace(c, values=c.values[kept]) for c in table.columns)
    return replace(table, columns=columns, row=lambda k: row(int(kept[k])))


def _check_rate(table: Table, absent: np.ndarray, kept: np.ndarray) -> None:
    """Refuse to leave out so many rows that every column, inputs too, would be sampled more slowly."""
    longer = int((np.diff(kept) > 1).sum())
    if longer <= max(FEW, SLOWER * len(kept)):
        return
    time, unit = table.columns[0].values, table.columns[0].unit
    before, after = (float(np.nanmedian(np.diff(t))) for t in (time, time[kept]))
    lacks, name = max((int(a.sum()), c.name) for a, c in zip(absent, table.columns, strict=True))
    raise DataError(
        f"{table.path}: column '{name}' has no value in {lacks} of {len(time)} rows. \"drop rows\" would leave "
        f"{len(kept)} rows and sample every column, inputs too, more slowly (a row every {after:.3g} {unit}, recorded "
        f"every {before:.3g} {unit}; {longer} steps are longer). {_keep_instead(absent)}"
    )


def _keep_instead(absent: np.ndarray) -> str:
    if absent[0].any():
        return "Time itself is missing there."
    return 'Let the missing values stay unknown: missing="keep" (--missing keep).'


def _fail_missing(table: Table, absent: np.ndarray) -> None:
    """Raise for the first missing value; the remedy that loses nothing comes first."""
    rows = absent.any(axis=0)
    k = int(np.argmax(rows))
    column = table.columns[int(np.argmax(absent[:, k]))].name
    raise DataError(
        f"{table.path}: row {table.row(k)}, column '{column}': no value (NaN or empty; {rows.sum()} of {len(rows)} "
        f"rows have one). {_keep_instead(absent)} "
        'Repair the file, or leave these rows out of every column, inputs too: missing="drop rows".'
    )


def _check_finite(table: Table) -> None:
    for column in table.columns:
        infinite = np.isinf(column.values)
        if infinite.any():
            k = int(np.argmax(infinite))
            raise DataError(
                f"{table.path}: row {table.row(k)}, column '{column.name}': not finite (got {column.values[k]}; "
                f"{infinite.sum()} in this column). Remove the row, or empty the cell and read with "
                'missing="drop rows".'
            )


def _check_time(table: Table) -> None:
    time, unit = table.columns[0].values, table.columns[0].unit
    wrong = np.diff(time) <= 0
    if not wrong.any():
        return
    k = int(np.argmax(wrong))
    before, now, where = time[k], time[k + 1], f"{table.path}: row {table.row(k + 1)}, column 'time'"
    if before == now:
        raise DataError(
            f"{where}: the same time as in row {table.row(k)} (got {now:.9g} {unit}; {wrong.sum()} such steps). "
            "Time must grow from row to row: remove one of the two, or write time with more digits."
        )
    raise DataError(
        f"{where}: time runs backward (got {now:.9g} {unit} after {before:.9g} {unit}; {wrong.sum()} such steps). "
        "Sort the rows, or split the file if it joins two recordings."
    )


def rounding_of(time: np.ndarray) -> float:
    """How much double precision rounds a time of this size, as a share of the usual step; (n,) finite or not."""
    time = time[np.isfinite(time)]
    usual = float(np.median(np.abs(np.diff(time)))) if len(time) > 1 else 0.0
    return float(np.spacing(np.abs(time).max())) / usual if usual else np.inf


def _from_first_time(table: Table) -> Table:
    """Time counted from the first sample where its size, as microseconds since 1970, would cost digits of its steps."""
    time = table.columns[0]
    share = rounding_of(time.values)
    if share <= UNSEEN:
        return table
    first = time.values[0]
    if share > ROUGH and (time.values != np.round(time.values)).any():
        raise DataError(
            f"{table.path}: column 'time' begins at {first:.17g} {time.unit}, and a number of that size is rounded to "
            f"{np.spacing(first):.2g} {time.unit}, {100 * share:.2g} % of a step. The steps of the recording are lost. "
            "Store time from the start of the recording, or as whole numbers."
        )
    return replace(table, columns=(replace(time, values=time.values - first), *table.columns[1:]))


def _in_si(table: Table, name: str, scale: Mapping[str, Scale]) -> Record:
    signals, units, display = {}, {}, {}
    for column in table.columns:
        values, unit = to_si(column.values, column.unit)
        shown = column.unit
        if column.name in scale:
            values, unit = scale[column.name].apply(values, unit)
            shown = unit
        signals[column.name], units[column.name], display[column.name] = values, unit, shown
    time = signals.pop("time")
    return Record(time, signals, units, name, table.path, table.digest, display)
