"""read_record and write_record: one pair of verbs for every file format."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from hydrotwin.models.language.errors import DataError, nearest
from hydrotwin.models.language.units import convert
from hydrotwin.models.language.writing import replacing

from .binary_files import read_parquet, write_parquet
from .csv_file import read_csv, write_csv
from .decimal_sign import SIGNS
from .mat_file import read_mat, write_mat, write_mat73
from .mdf_file import read_mdf, write_mdf
from .record import Record
from .scale import Scale, scales_of
from .table import record_from_table
from .tdms_file import read_tdms, write_tdms
from .xlsx_file import read_xlsx, write_xlsx

_FORMATS = {
    ".csv": (read_csv, write_csv),
    ".txt": (read_csv, write_csv),
    ".parquet": (read_parquet, write_parquet),
    ".mat": (read_mat, write_mat),
    ".mf4": (read_mdf, write_mdf),
    ".mdf": (read_mdf, write_mdf),
    ".tdms": (read_tdms, write_tdms),
    ".xlsx": (read_xlsx, write_xlsx),
    ".xlsm": (read_xlsx, write_xlsx),
    ".xls": (read_xlsx, write_xlsx),
    ".ods": (read_xlsx, write_xlsx),
}


def read_record(
    path: str | os.PathLike,
    *,
    scale: Mapping[str, str | Scale] | Sequence[str | Scale] | str | None = None,
    units: Mapping[str, str] | None = None,
    missing: str = "error",
    decimal: str | None = None,
) -> Record:
    """Read a recording (CSV, Parquet, MAT v5 or v7.3, MDF 4) and convert it to SI.

    scale : what one unit of a column stands for, ``"command=0.05 V/%"``.
    units : units of the columns for which the file names none.
    missing : "error" refuses NaN and empty cells (not what an MDF file itself marks as unknown), "keep" keeps them as
        NaN: what a slower sensor lacks is no reason to lose what the others measured. "drop rows" leaves rows with one
        out, and is refused where that would sample the other columns more slowly.
    decimal : decimal sign of a CSV file, "." or ",", where its numbers do not tell it from that of thousands.

    Non-uniform time is normal; holes in it are listed in ``Record.gaps``. Raises `DataError` or `UnitError` naming the
    file, the row (as an editor counts it; binary files count samples from 1) and the column.
    """
    path = Path(path)
    read, _ = _format_of(path)
    if decimal is not None and decimal not in SIGNS:
        raise DataError(f"decimal: not a decimal sign (got {decimal!r}). Write '.' or ','.")
    if not path.is_file():
        raise DataError(f"{path}: {_why_absent(path)}")
    table = read(path, decimal) if read is read_csv else read(path)
    return record_from_table(table, path.stem, scales_of(scale), units or {}, missing)


def write_record(
    record: Record, path: str | os.PathLike, *, units: Mapping[str, str] | None = None, mat_version: str = "5"
) -> Path:
    """Write a record; each column in the unit of ``units``, else the one it was read in, else SI.

    The suffix picks the format; MAT is v5 unless ``mat_version="7.3"``. A failed write leaves an old file whole.
    """
    path = Path(path)
    _, write = _format_of(path)
    if mat_version not in ("5", "7.3"):
        raise DataError(f"mat_version: not a choice (got {mat_version!r}). {nearest(str(mat_version), ('5', '7.3'))}")
    if path.suffix.lower() == ".mat" and mat_version == "7.3":
        write = write_mat73
    shown = {**record.units, **record.display_units, **(units or {})}
    for name in units or {}:
        record[name]
    columns = [record.time, *(convert(record[n], record.units[n], shown[n]) for n in record)]
    headers = ["time [s]", *(f"{n} [{shown[n]}]" for n in record)]
    with replacing(path) as beside:
        write(headers, columns, record, beside)
    return path


def _format_of(path: Path):
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        raise DataError(f"{path}: not a recording format (got '{suffix}'). {nearest(suffix, _FORMATS)}")
    return _FORMATS[suffix]


def _why_absent(path: Path) -> str:
    if path.is_dir():
        return "a folder, not a recording. Name a file in it."
    if not path.parent.is_dir():
        return f"no such file: the folder '{path.parent}' does not exist."
    beside = [p.name for p in path.parent.iterdir() if p.suffix.lower() in _FORMATS]
    return f"no such file. {nearest(path.name, sorted(beside))}"
