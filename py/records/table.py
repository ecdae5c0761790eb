"""From a Table, what a file holds, to a Record in SI: names, units, time and values are checked.

A column that cannot be used refuses no file: the record keeps its sentence, and says it to whoever needs the column.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hydrotwin.models.language.errors import DataError, UnitError, nearest
from hydrotwin.models.language.units import parse_unit, to_si

from .clocks import PERIODS, called_time, counts_time, holds_stamps, in_seconds, sampled_at, time_column
from .columns import ZEROS_BEFORE, Column, Table
from .constants import with_constants
from .reading import Reading
from .record import EXACT, Record
from .repairs import order_of

SLOWER = 0.05  # share of the steps that leaving rows out may lengthen; beyond, what is left is another sampling
FEW = 3  # steps that may always be longer: a short table with a flaw or two


def record_from_table(table: Table, name: str, reading: Reading) -> Record:
    """Check a table and convert it to SI. Raises `DataError` or `UnitError` naming file, row and column."""
    refused: dict[str, str] = {}
    reading = _by_name(table, reading)
    table = _named(table, reading, refused)
    table = _with_units(table, reading)
    table = _with_time(table, reading, refused)
    _check_length(table)
    words = _words(table)
    table = _usable(table, reading, refused)
    if np.isnan(table.columns[0].values).any():
        table = _with_clock(_without_missing(table, reading, refused), reading.clock)
    else:  # a repair counts the samples of a stamp: none may be gone before
        table = _without_missing(_with_clock(table, reading.clock), reading, refused)
    table = with_constants(table, reading, refused)
    kept = {n: said for n, said in words.items() if n in refused or ZEROS_BEFORE.fullmatch(said[0])}
    return _in_si(table, name, reading, refused, kept)


# -- names and units ---------------------------------------------------------------------------------------------------
def _by_name(table: Table, reading: Reading) -> Reading:
    """The reading with names in place of the places of columns; what has no name gets one."""
    names = [c.name for c in table.columns]

    places = {r: int(r[1:]) - 1 for r in reading.columns.values() if re.fullmatch(r"#[0-9]+", r) and r not in names}
    left = [name for k, name in enumerate(names) if k not in places.values()]

    def name_of(reference: str) -> str:
        if reference in names or not re.fullmatch(r"#[0-9]+", reference):
            return reference
        name = names[_place(reference, names, table.path, "a column")]
        plain = name and left.count(name) == 1 and name not in reading.columns and reference not in places
        return name if plain else reference

    units, scale = ({name_of(n): v for n, v in m.items()} for m in (reading.units, reading.scale))
    columns = {
        v: names[places[r]] if places.get(r, len(names)) < len(names) and names.count(names[places[r]]) == 1 else r
        for v, r in reading.columns.items()
    }
    time = reading.time and name_of(reading.time)
    for reference in (time, *units, *scale):
        if reference and reference.startswith("#") and reference not in (*names, *columns.values(), *columns):
            columns[reference] = reference
    return replace(reading, units=units, scale=scale, columns=columns, time=time)


def _named(table: Table, reading: Reading, refused: dict[str, str]) -> Table:
    """Columns under the names that a person gives them; of two with one name neither can be meant."""
    columns = table.columns
    names = [c.name for c in columns]
    taken = {variable: _place(ref, names, table.path, variable) for variable, ref in reading.columns.items()}
    given = [replace(columns[k], name=variable) for variable, k in taken.items()]
    rest = [c for k, c in enumerate(columns) if c.name and k not in taken.values() and c.name not in taken]
    for n in {c.name for c in rest if [r.name for r in rest].count(c.name) > 1}:
        places = [k for k, name in enumerate(names, start=1) if name == n]
        refused[n] = (
            f"{table.path}: {table.header}, columns {' and '.join(map(str, places))} are both named '{n}'. Names must "
            f"differ: rename one, or say which is meant: --column '{n}=#{places[0]}'."
        )
        if called_time(n) and not reading.rate and reading.time is None:
            raise DataError(f"{refused[n]} Channels with times of their own belong into files of their own.")
    kept = [*given, *(c for c in rest if c.name not in refused)]
    for k, column in enumerate(columns, start=1):
        if column.name or k - 1 in taken.values() or _is_empty(column):
            continue
        if (holds_stamps(column) or counts_time(column)) and not any(called_time(c.name) for c in kept):
            kept.insert(0, replace(column, name="time"))  # the index of a data frame
            continue
        refused[f"#{k}"] = (
            f"{table.path}: {table.header}, column {k} has no name. Write 'name [unit]' in the header, or name it: "
            f"--column 'name=#{k}'."
        )
    unused = (v for v in taken if v in names and names.index(v) not in taken.values())
    own = [f"the column '{v}' of the file is not used" for v in unused]
    said = [f"{v} is '{r}'" for v, r in reading.columns.items()]
    return _told(replace(table, columns=tuple(kept)), *said, *own)


def _is_empty(column: Column) -> bool:
    return bool(np.isnan(column.values).all()) and not any(cell and cell.strip() for cell in column.texts or ())


def _told(table: Table, *words: str) -> Table:
    """The table with further words on how it was read."""
    return replace(table, understood=", ".join(w for w in (table.understood, *words) if w))


def _place(reference: str, names: list[str], path: str, variable: str) -> int:
    """Index of the column that is meant, by its name or as ``#3``."""
    if names.count(reference) == 1:
        return names.index(reference)
    if re.fullmatch(r"#[0-9]+", reference) and 0 < int(reference[1:]) <= len(names):
        return int(reference[1:]) - 1
    if reference in names:
        raise DataError(
            f"{path}: two columns are named '{reference}'. Say which is '{variable}' by its place: "
            f"--column '{variable}=#{names.index(reference) + 1}'."
        )
    raise DataError(f"{path}: no column '{reference}' for '{variable}'. {nearest(reference, names)}")


def _with_units(table: Table, reading: Reading) -> Table:
    """Columns in the units that a person states; names of the file and of the record are both understood."""
    back = {variable: reference for variable, reference in reading.columns.items()}
    names = {c.name for c in table.columns}
    known = sorted(names | {r for v, r in back.items() if v in names})
    for option, wanted, more in (("scale", reading.scale, reading.constants), ("units", reading.units, ())):
        for name in wanted:
            if name not in known and name not in more:
                raise DataError(f"{table.path}: no column '{name}', named in {option}. {nearest(name, known)}")

    def stated(column: Column) -> Column:
        other = back.get(column.name)
        keys = [k for k in (column.name, None if other in back else other) if k in reading.units]
        return replace(column, unit=reading.units[keys[0]]) if keys else column

    words = [f"{name} in {unit}" for name, unit in reading.units.items()]
    words += [f"{name} times {s.factor:g} {s.unit}" for name, s in reading.scale.items()]
    return _told(replace(table, columns=tuple(map(stated, table.columns))), *words)


def _scale_of(name: str, reading: Reading):
    """The scale of a column under its own name, or under that of the file where no other column has that name now."""
    reference = reading.columns.get(name, "")
    return reading.scale.get(name) or (reading.scale.get(reference) if reference not in reading.columns else None)


# -- time --------------------------------------------------------------------------------------------------------------
def _with_time(table: Table, reading: Reading, refused: Mapping[str, str]) -> Table:
    """The time axis [s] first. Raises DataError, UnitError where there is none."""
    columns = list(table.columns)
    if not columns:
        raise DataError(f"{table.path}: {table.header} names no column. The first one must be 'time [s]'.")
    if reading.rate:
        count = max(len(c.values) for c in columns)
        times = [c.name for c in columns if c.name == "time" or called_time(c.name)]
        columns = [c for c in columns if c.name not in times]
        instead = f" in place of {', '.join(times)}" if times else ""
        table = replace(table, columns=(sampled_at(reading.rate, count), *columns))
        return _told(table, f"sampled at {reading.rate:g} Hz{instead}")
    renamed = {reference: variable for variable, reference in reading.columns.items()}
    wanted = renamed.get(reading.time, reading.time) if reading.time else None
    unnamed = next((name for name in refused if name.startswith("#")), "")
    at = time_column(columns, wanted, f"{table.path}: {table.header}", unnamed)
    if _scale_of(columns[at].name, reading):
        raise DataError(
            f"{table.path}: column '{columns[at].name}' is the time, which takes no scale. State its unit (--unit "
            f"'{columns[at].name}=ms'), or the sampling rate: --rate 1000."
        )
    time, said = in_seconds(columns, at, table.path, table.header)
    own = "" if columns[at].name == "time" else f"time is '{columns[at].name}'"
    words = ", ".join(w for w in (table.understood, own, f"{said} as time" if said else "") if w)
    time = replace(time, name="time", texts=None)
    rest = [c for k, c in enumerate(columns) if k != at and c.name != "time"]
    return replace(table, columns=(time, *rest), understood=words)


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
    infinite = np.isinf(time)
    if infinite.any():
        raise DataError(_not_finite(table, table.columns[0]))


def _with_clock(table: Table, clock: str | None) -> Table:
    """The samples in the order and at the times that the clock's repair makes of them; time must grow then."""
    time = table.columns[0]
    order, times = np.arange(len(time.values)), time.values
    period = next((p for words, p in PERIODS.items() if words in table.understood), 0.0)
    for repair in re.split(r"\s*,\s*", clock or ""):
        kept, times = order_of(times, repair, period)
        order = order[kept]
    row = table.row
    columns = [replace(time, values=times), *(replace(c, values=c.values[order]) for c in table.columns[1:])]
    words = ", ".join(w for w in (table.understood, f"clock: {clock}" if clock else "") if w)
    table = replace(table, columns=tuple(columns), row=lambda k: row(int(order[min(k, len(order) - 1)])))
    _check_time(table, clock)
    return replace(table, understood=words)


def _check_time(table: Table, clock: str | None) -> None:
    time, unit = table.columns[0].values, "s"
    wrong = np.diff(time) <= 0
    if not wrong.any():
        return
    k = int(np.argmax(wrong))
    before, now, where = time[k], time[k + 1], f"{table.path}: row {table.row(k + 1)}, column 'time'"
    after = f" Even after --clock {clock}." if clock else ""
    if before == now:
        raise DataError(
            f"{where}: the same time as in row {table.row(k)} (got {now:.9g} {unit}; {wrong.sum()} such steps).{after} "
            "Time must grow from row to row: write it with more digits, or say what to do: --clock spread (a coarse "
            "clock: the samples lie evenly between), first or last (remove one of the two)."
        )
    raise DataError(
        f"{where}: time runs backward (got {now:.9g} {unit} after {before:.9g} {unit}; {wrong.sum()} such steps)."
        f"{after} {_backward(table, float(now - before), clock)}"
    )


def _backward(table: Table, step: float, clock: str | None) -> str:
    """What may be done about a step back [s]."""
    period = next((p for words, p in PERIODS.items() if words in table.understood), 0.0)
    unwrap, ways = "let a clock that began anew go on: --clock unwrap", ["sort the rows: --clock sort"]
    if "unwrap" not in (clock or ""):
        ways.insert(0 if period and step < -period / 3 else 1, unwrap)
    return f"Split the file if it joins two recordings; {'; or '.join(ways)}."


# -- values ------------------------------------------------------------------------------------------------------------
def _usable(table: Table, reading: Reading, refused: dict[str, str]) -> Table:
    """The columns that hold numbers with a unit; why the others do not."""
    kept = [table.columns[0]]
    for column in table.columns[1:]:
        unknown = _is_empty(column) and _keeps(table, reading)
        why = ("" if unknown else column.unusable) or _wrong_unit(table, column, reading)
        if not why and np.isinf(column.values).any():
            why = _not_finite(table, column)
        if why:
            refused[column.name] = why
        else:
            kept.append(column if column.unit is not None else replace(column, unit="1"))
    return replace(table, columns=tuple(kept))


def _words(table: Table) -> dict[str, tuple[str, ...]]:
    """What columns say, as they write it: a text, of one that changes the first two; a number that keeps all of its
    digits, or has zeros before it, and stays the same."""
    found = {}
    for column in table.columns[1:]:
        if column.texts is None and not (np.abs(column.values[:1]) < EXACT).all():
            continue
        texts = [f"{v:.15g}" for v in column.values[:1]] if column.texts is None else column.texts
        cells = tuple(dict.fromkeys(text.strip() for text in texts))[:2]
        same = column.texts is not None or (column.values == column.values[0]).all()
        changing = len(cells) > 1 and np.isfinite(column.values).any()  # numbers: they tell themselves
        if same and not changing and "" not in cells:
            found[column.name] = cells
    return found


def _wrong_unit(table: Table, column: Column, reading: Reading) -> str:
    where = f"{table.path}: {table.header}, column '{column.name}'"
    if column.unit is None:
        if _scale_of(column.name, reading):
            return ""
        return (
            f"{where} has no unit. Write '{column.name} [unit]' in the header ([1] for a pure number), or state it: "
            f"--unit '{column.name}=UNIT' (units= in Python)."
        )
    if " or " in column.unit:
        return f"{where}: its unit is {column.unit}, the file does not tell. State it: --unit '{column.name}=UNIT'."
    try:
        parse_unit(column.unit)
    except UnitError as error:
        return f"{where}: {error} Or state it when reading: --unit '{column.name}=UNIT'."
    return ""


def _not_finite(table: Table, column: Column) -> str:
    infinite = np.isinf(column.values)
    k = int(np.argmax(infinite))
    return (
        f"{table.path}: row {table.row(k)}, column '{column.name}': not finite (got {column.values[k]}; "
        f"{infinite.sum()} in this column). Remove the row, or empty the cell and read with "
        'missing="keep" or "drop rows".'
    )


def _keeps(table: Table, reading: Reading) -> bool:
    """Whether missing values stay unknown."""
    missing = reading.missing or "error"
    return missing == "keep" or (missing == "error" and table.marks_unknown)


def _without_missing(table: Table, reading: Reading, refused: dict[str, str]) -> Table:
    """What missing values mean: their column is refused, they stay unknown, or their rows are left out."""
    absent = np.array([np.isnan(c.values) for c in table.columns])  # the first is time
    rows = absent.any(axis=0)
    if not rows.any() or (_keeps(table, reading) and not absent[0].any()):
        return table
    if reading.missing == "drop rows":
        return _without_rows(table, absent)
    if absent[0].any():
        raise DataError(_missing(table, absent, 0))
    for j in range(1, len(absent)):
        if absent[j].any():
            refused[table.columns[j].name] = _missing(table, absent, j)
    return replace(table, columns=tuple(c for c in table.columns if c.name not in refused))


def _without_rows(table: Table, absent: np.ndarray) -> Table:
    kept = np.flatnonzero(~absent.any(axis=0))
    if len(kept) < 2:
        raise DataError(
            f"{table.path}: {len(kept)} rows are complete, column 'time' needs two or more. {_keep_instead(absent)}"
        )
    _check_rate(table, absent, kept)
    row = table.row
    columns = tuple(replace(c, values=c.values[kept]) for c in table.columns)
    table = replace(table, columns=columns, row=lambda k: row(int(kept[min(k, len(kept) - 1)])))
    return _told(table, f"{absent.shape[1] - len(kept)} of {absent.shape[1]} rows left out")


def _check_rate(table: Table, absent: np.ndarray, kept: np.ndarray) -> None:
    """Refuse to leave out so many rows that every column, inputs too, would be sampled more slowly."""
    longer = int((np.diff(kept) > 1).sum())
    if longer <= max(FEW, SLOWER * len(kept)) and 2 * len(kept) > absent.shape[1]:
        return
    time = table.columns[0].values
    before, after = (float(np.nanmedian(np.diff(t))) for t in (time, time[kept]))
    lacks, name = max((int(a.sum()), c.name) for a, c in zip(absent, table.columns, strict=True))
    raise DataError(
        f"{table.path}: column '{name}' has no value in {lacks} of {len(time)} rows. \"drop rows\" would leave "
        f"{len(kept)} rows and sample every column, inputs too, more slowly (a row every {after:.3g} s, recorded "
        f"every {before:.3g} s; {longer} steps are longer). {_keep_instead(absent)}"
    )


def _keep_instead(absent: np.ndarray) -> str:
    if absent[0].any():
        return "Time itself is missing there."
    return 'Let the missing values stay unknown: missing="keep" (--missing keep).'


def _missing(table: Table, absent: np.ndarray, j: int) -> str:
    """What is said of the first missing value of a column; the remedy that loses nothing comes first."""
    k = int(np.argmax(absent[j]))
    return (
        f"{table.path}: row {table.row(k)}, column '{table.columns[j].name}': no value (NaN or empty; "
        f"{absent[j].sum()} of {absent.shape[1]} rows have one). {_keep_instead(absent)} "
        'Repair the file, or leave these rows out of every column, inputs too: missing="drop rows".'
    )


# -- the record --------------------------------------------------------------------------------------------------------
def _in_si(table: Table, name: str, reading: Reading, refused: dict[str, str], words: dict[str, str]) -> Record:
    signals, units, display = {}, {}, {}
    for column in table.columns:
        values, unit = to_si(column.values, column.unit)
        shown, scale = column.unit, _scale_of(column.name, reading)
        if scale and parse_unit(column.unit).offset:
            raise DataError(
                f"{table.path}: column '{column.name}' is in {column.unit}, whose zero is none: a scale of it means "
                f"nothing. State another unit: --unit '{column.name}=K'."
            )
        if scale:
            values, unit = scale.apply(values, unit)
            shown = unit
        signals[column.name], units[column.name], display[column.name] = values, unit, shown
    time = signals.pop("time")
    return Record(time, signals, units, name, table.path, table.digest, display, refused, table.understood, words=words)
