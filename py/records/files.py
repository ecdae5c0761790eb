"""read_record and write_record: one pair of verbs for every file format."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from hydrotwin.models.language.errors import DataError, nearest
from hydrotwin.models.language.units import convert
from hydrotwin.models.language.writing import printable, replacing

from .binary_files import read_arrow, read_parquet, write_parquet
from .columns import Table
from .mat_file import read_mat, write_mat, write_mat73
from .mdf_file import is_mdf, read_mdf, write_mdf
from .reading import Reading, beside, reading_of
from .record import Record
from .table import record_from_table
from .tdms_file import read_tdms
from .text.read import Stated, read_text
from .text.write import write_csv
from .workbook import read_workbook

_TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm", ".prn")
_PACKED = ".gz"
_BINARY = {".parquet": read_parquet, ".mat": read_mat, ".mf4": read_mdf, ".mdf": read_mdf, ".tdms": read_tdms}
_BINARY |= {".feather": read_arrow, ".arrow": read_arrow, ".h5": read_mat, ".hdf5": read_mat}
_WORKBOOKS = (".xlsx", ".xlsm", ".xls", ".ods")
_WRITERS = {".csv": write_csv, ".txt": write_csv, ".parquet": write_parquet, ".mat": write_mat}
_WRITERS |= {".mf4": write_mdf, ".mdf": write_mdf}
WRITTEN = tuple(_WRITERS)
SUFFIXES = (*_TEXT, *_BINARY, *_WORKBOOKS, *(f"{suffix}{_PACKED}" for suffix in _TEXT))


def read_record(path: str | os.PathLike, reading: Reading | None = None, **said) -> Record:
    """Read a recording and convert it to SI.

    Text of any layout (``.csv .txt .tsv .dat .asc .lvm``, also packed with gzip), Parquet, MAT, MDF, TDMS, workbooks.
    What is said beats ``import.toml`` in the folder of the file, and that beats what the file says.

    ====================  ==========================================================================================
    columns               name in the record -> column of the file: ``{"command": "Ventil_Soll"}``, ``"command=#3"``
    units                 units of columns, in place of what the file says: ``{"Druck A": "bar"}``
    scale                 what one unit of a column stands for, ``"command=0.05 V/%"``
    constants             what was not recorded: ``{"supply_pressure": "35 bar"}``
    time, rate            the column that is the time; or samples per second [Hz] in place of one
    clock                 repair of the time: "spread", "first", "last", "unwrap", "sort" (see `clocks.order_of`)
    missing               "error": a column with NaN or empty cells cannot be used (not what a file itself marks as
                          unknown). "keep": they stay NaN: what a slower sensor lacks is no reason to lose what the
                          others measured. "drop rows": rows with one are left out, unless that would sample the other
                          columns more slowly
    decimal, delimiter    of a text file: "." or ",", and the sign between cells
    encoding, sheet       of a text file; of a workbook
    ====================  ==========================================================================================

    A column that cannot be used (text, no unit, missing values) refuses no file: ``Record.refused`` says why, and the
    sentence is raised where that column is asked for. Non-uniform time is normal; holes in it are listed in
    ``Record.gaps``. ``Record.understood`` says how the file was read.

    Raises `DataError` or `UnitError` naming the file, the row (as an editor counts it; binary files count samples from
    1) and the column.
    """
    path = Path(path)
    _reader(path)
    stated = reading_of(**said).over(reading or Reading())
    if not path.is_file():
        raise DataError(f"{path}: {_why_absent(path)}")
    near, file = beside(path)
    record = read_by(path, stated.over(near))
    return replace(record, understood=f"{record.understood}, by {file}".removeprefix(", ")) if file else record


def read_by(path: Path, stated: Reading) -> Record:
    """As `read_record`, by what is said alone, whatever ``import.toml`` lies beside it."""
    return record_from_table(_reader(path)(path, stated), _stem(path), stated)


def _text(path: Path, reading: Reading) -> Table:
    if is_mdf(path):  # INCA gives version 3 the suffix of a text
        return read_mdf(path)
    return read_text(path, Stated(reading.encoding, reading.delimiter, reading.decimal))


def _reader(path: Path):
    """``read(path, reading) -> Table``."""
    suffix = path.suffix.lower()
    if suffix in _BINARY:
        return lambda p, _: _BINARY[suffix](p)
    if suffix in _WORKBOOKS:
        return lambda p, reading: read_workbook(p, reading.sheet, reading.decimal)
    if suffix in _TEXT or (suffix == _PACKED and Path(path.stem).suffix.lower() in _TEXT):
        return _text
    raise DataError(f"{path}: not a recording format (got '{suffix}'). {nearest(suffix, SUFFIXES)}")


def _stem(path: Path) -> str:
    return printable(Path(path.stem).stem if path.suffix.lower() == _PACKED else path.stem)


def write_record(
    record: Record, path: str | os.PathLike, *, units: Mapping[str, str] | None = None, mat_version: str = "5"
) -> Path:
    """Write a record; each column in the unit of ``units``, else the one it was read in, else SI.

    Signals alone are written: tags, words and the hash of the file that it was read from stay behind, so that who was
    made from that file is not told to be made from the new one. The suffix picks the format; MAT is v5 unless
    ``mat_version="7.3"``. A failed write leaves an old file whole.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _WRITERS:
        raise DataError(f"{path}: not a format that is written (got '{suffix}'). {nearest(suffix, _WRITERS)}")
    write = _WRITERS[suffix]
    if mat_version not in ("5", "7.3"):
        raise DataError(f"mat_version: not a choice (got {mat_version!r}). {nearest(str(mat_version), ('5', '7.3'))}")
    if suffix == ".mat" and mat_version == "7.3":
        write = write_mat73
    shown = {**record.units, **record.display_units, **(units or {})}
    for name in units or {}:
        record[name]
    columns = [record.time, *(convert(record[n], record.units[n], shown[n]) for n in record)]
    headers = ["time [s]", *(f"{n} [{shown[n]}]" for n in record)]
    with replacing(path) as beside:
        write(headers, columns, record, beside)
    return path


def _why_absent(path: Path) -> str:
    if path.is_dir():
        return "a folder, not a recording. Name a file in it."
    if not path.parent.is_dir():
        return f"no such file: the folder '{path.parent}' does not exist."
    beside = [p.name for p in path.parent.iterdir() if p.name.lower().endswith(SUFFIXES)]
    return f"no such file. {nearest(path.name, sorted(beside))}"
