"""Every kind of bad recording is refused with the file, the row (as an editor counts it), the column, the next step."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError, UnitError
from hydrotwin.records import Record, write_record
from tests.records.whole import whole

GOOD = """time [s],arm_angle [deg],pressure_cap [bar]
0.00,10.0,20.0
0.01,10.5,21.0
0.02,11.0,22.0
0.03,11.5,23.0
"""


def changed(old: str, new: str) -> str:
    assert GOOD.count(old) == 1
    return GOOD.replace(old, new)


BAD_CSV = {
    "text in a number": (changed("10.5", "ten"), ["row 3", "'arm_angle'", "not a number (got 'ten')", "Write a"]),
    "a unit in the cell": (changed("21.0", "21.0 bar"), ["row 3", "'pressure_cap'", "got '21.0 bar'", "no unit in"]),
    "no thousands separator": (changed("22.0", '"1,02.0"'), ["row 4", "'pressure_cap'", "groups of three digits"]),
    "an underscore": (changed("22.0", "1_022"), ["row 4", "'pressure_cap'", "not a number"]),
    "text in time": (changed("0.02,", "12:30:01,"), ["row 4", "'time'", "not a number"]),
    "NaN": (changed("10.5", "NaN"), ["row 3", "'arm_angle'", "1 of 4 rows", 'missing="drop rows"']),
    "an empty cell": (changed("11.0", ""), ["row 4", "'arm_angle'", "no value", 'missing="drop rows"']),
    "infinity": (changed("21.0", "inf"), ["row 3", "'pressure_cap'", "not finite (got inf", "Remove the row"]),
    "minus infinity": (changed("23.0", "-Inf"), ["row 5", "'pressure_cap'", "not finite (got -inf"]),
    "a duplicate time": (changed("0.02,", "0.01,"), ["row 4", "'time'", "same time as in row 3", "remove one"]),
    "time running backward": (changed("0.02,", "-5,"), ["row 4", "'time'", "runs backward", "sort the rows"]),
    "a short row": (changed("0.01,10.5,21.0", "0.01,10.5"), ["row 3", "'pressure_cap'", "too short (got 2", "Repair"]),
    "a long row": (changed("10.5,21.0", "10,5,21.0"), ["row 3", "column 4", "got 4 values", "decimal comma"]),
    "a truncated file": (GOOD[:-6], ["row 5", "'pressure_cap'", "ends in the middle", "copy it again"]),
    "an empty file": ("", ["row 1", "empty", "header"]),
    "only white space": ("\n  \n", ["row 1", "empty", "header"]),
    "only comments": ("# a\n# b\n", ["row 1", "only comments", "Write a header"]),
    "only a header": (GOOD.split("\n")[0] + "\n", ["'time'", "no row of values", "two or more"]),
    "one row": ("\n".join(GOOD.split("\n")[:2]), ["row 2", "'time'", "only one row", "Record longer"]),
    "no header": (GOOD.split("\n", 1)[1], ["row 1", "got 1, 2, 3", "--time '1'", "--rate 1000"]),
    "no unit in the header": (changed(" [deg]", ""), ["row 1", "'arm_angle'", "no unit", "[1] for a pure number"]),
    "empty brackets": (changed("[deg]", "[]"), ["row 1", "'arm_angle'", "no unit"]),
    "an unknown unit": (changed("[bar]", "[barr]"), ["row 1", "'pressure_cap'", "'barr'", "Did you mean 'bar'?"]),
    "an ambiguous unit": (changed("[bar]", "[m3/s.Pa]"), ["row 1", "'pressure_cap'", "ambiguous"]),
    "duplicate columns": (
        changed("pressure_cap", "arm_angle"),
        ["row 1", "columns 2 and 3", "both named 'arm_angle'", "rename"],
    ),
    "a nameless column": (changed("arm_angle [deg]", ""), ["row 1", "column 2", "no name", "'name [unit]'"]),
    "no time column": (changed("time [s]", "Weg [m]"), ["row 1", "got Weg, arm_angle", "--time 'Weg'", "--rate"]),
    "time in metres": (changed("time [s]", "time [m]"), ["row 1", "'time'", "is in m", "s, ms"]),
    "zero bytes": (GOOD.replace("0.00", "\x00"), ["row 1", "zero bytes"]),
}


@pytest.mark.parametrize("kind", BAD_CSV)
def test_a_bad_csv_names_file_row_column_and_next_step(kind, tmp_path):
    content, says = BAD_CSV[kind]
    path = tmp_path / "train_2.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises((DataError, UnitError)) as error:
        whole(path)
    for words in ("train_2.csv: ", *says):
        assert words in str(error.value)


def test_rows_are_counted_with_comments_and_blank_lines(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# rig 3\n\n" + GOOD.replace("0.01,10.5", "\n0.01,10.5").replace("23.0", "nan"))
    with pytest.raises(DataError, match=r"row 8, column 'pressure_cap'"):
        whole(path)
    path.write_text("# rig 3\n\n" + GOOD.replace("0.01,10.5", "\n0.01,10.5").replace("0.03,", "0.02,"))
    with pytest.raises(DataError, match=r"row 8, column 'time': the same time as in row 7"):
        whole(path)


def test_a_header_below_comments_is_named_by_its_true_row(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# rig 3\n# day 2\n" + changed("[bar]", "[barr]"))
    with pytest.raises(DataError, match=r"a.csv: row 3, column 'pressure_cap': unit 'barr'"):
        whole(path)
    path.write_text("# rig 3\n# day 2\n" + changed("pressure_cap", "arm_angle"))
    with pytest.raises(DataError, match=r"a.csv: row 3, columns 2 and 3"):
        whole(path)


def test_windows_line_ends_and_a_byte_order_mark_do_not_shift_the_row(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("22.0", "x").replace("\n", "\r\n").encode())
    with pytest.raises(DataError, match="row 4, column 'pressure_cap'"):
        whole(path)


def test_a_missing_file_names_the_nearest_one(tmp_path):
    (tmp_path / "train_1.csv").write_text(GOOD)
    with pytest.raises(DataError, match=r"train_l.csv: no such file. Did you mean 'train_1.csv'\?"):
        whole(tmp_path / "train_l.csv")
    with pytest.raises(DataError, match="does not exist"):
        whole(tmp_path / "nowhere" / "a.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(DataError, match="a folder"):
        whole(tmp_path / "folder.csv")


def test_an_unknown_format_names_the_known_ones(tmp_path):
    with pytest.raises(DataError, match=r"'.docx'.*\.csv"):
        whole(tmp_path / "train.docx")


def test_dropping_rows_is_an_explicit_choice_and_keeps_true_row_numbers(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(changed("10.5", ""))
    record = whole(path, missing="drop rows")
    np.testing.assert_allclose(record.time, [0, 0.02, 0.03])
    path.write_text(changed("10.5", "").replace("0.03,", "0.02,"))
    with pytest.raises(DataError, match=r"row 5, column 'time': the same time as in row 4"):
        whole(path, missing="drop rows")
    with pytest.raises(DataError, match="not a choice"):
        whole(path, missing="interpolate")
    path.write_text("time [s],a [1]\n0,\n1,\n2,3\n")
    with pytest.raises(DataError, match="1 rows are complete"):
        whole(path, missing="drop rows")


def test_what_a_slower_sensor_lacks_may_stay_unknown_but_time_may_not(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time [s],fast [1],slow [mm]\n0,1,7\n0.01,2,\n0.02,3,nan\n0.03,4,9\n")
    record = whole(path, missing="keep")
    np.testing.assert_array_equal(record["fast"], [1, 2, 3, 4])
    np.testing.assert_allclose(record["slow"], [7e-3, np.nan, np.nan, 9e-3])
    path.write_text("time [s],fast [1]\n0,1\n,2\n0.02,3\n")
    with pytest.raises(DataError, match="row 3, column 'time': no value"):
        whole(path, missing="keep")


@pytest.mark.parametrize("cell", ["", "nan"])
def test_a_column_that_is_empty_throughout_may_stay_unknown_too(tmp_path, cell):
    path = tmp_path / "a.csv"
    path.write_text(f"time [s],fast [1],slow [mm]\n0,1,{cell}\n0.01,2,{cell}\n0.02,3,{cell}\n")
    record = whole(path, missing="keep")
    assert np.isnan(record["slow"]).all() and record.units["slow"] == "m"
    with pytest.raises(DataError, match="'slow'"):
        whole(path)


def test_infinity_is_refused_even_when_rows_may_be_dropped(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(changed("10.5", "inf"))
    with pytest.raises(DataError, match="row 3, column 'arm_angle': not finite"):
        whole(path, missing="drop rows")


@pytest.fixture
def good_record():
    t = np.linspace(0, 1, 200)
    return Record(t, {"arm_angle": np.sin(t)}, {"arm_angle": "rad"}, "good")


@pytest.mark.parametrize(("suffix", "version"), [(".parquet", "5"), (".mat", "5"), (".mat", "7.3")])
@pytest.mark.parametrize("part", [0.0, 0.3, 0.9])
def test_a_truncated_binary_file_is_refused(good_record, suffix, version, part, tmp_path):
    content = write_record(good_record, tmp_path / f"whole{suffix}", mat_version=version).read_bytes()
    cut = tmp_path / f"cut{suffix}"
    cut.write_bytes(content[: int(part * len(content))])
    with pytest.raises(DataError, match=rf"cut{suffix}: .*[Cc]opy") as error:
        whole(cut)
    assert len(str(error.value)) < 500


def test_a_parquet_null_is_a_missing_value(tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet

    path = tmp_path / "a.parquet"
    pyarrow.parquet.write_table(pa.table({"time [s]": [0.0, 1.0, 2.0], "x [mm]": [1, None, 3]}), path)
    with pytest.raises(DataError, match="row 2, column 'x': no value"):
        whole(path)
    np.testing.assert_allclose(whole(path, missing="drop rows")["x"], [1e-3, 3e-3])


def test_mdf_without_its_package_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "asammdf", None)
    path = tmp_path / "a.mf4"
    path.write_bytes(b"MDF     4.10")
    with pytest.raises(DataError, match=r"a.mf4: .*asammdf.*hydrotwin\[mdf\]"):
        whole(path)


def test_rows_are_not_left_out_where_that_samples_the_inputs_more_slowly(tmp_path):
    path = tmp_path / "a.csv"
    rows = "".join(f"{k / 100},{k % 7},{k if k % 10 == 0 else ''}\n" for k in range(200))
    path.write_text("time [s],force [N],slow [mm]\n" + rows)
    with pytest.raises(
        DataError, match=r'row 3, column \'slow\'.*stay unknown: missing="keep".*every column.*"drop rows"'
    ):
        whole(path)
    with pytest.raises(
        DataError, match=r"column 'slow' has no value in 180 of 200 rows.*0.1 s, recorded every 0.01 s.*keep"
    ):
        whole(path, missing="drop rows")
    assert np.isfinite(whole(path, missing="keep")["slow"]).sum() == 20
    gap = "".join(f"{k / 100},{k % 7},{'' if 50 <= k < 90 else k}\n" for k in range(200))
    path.write_text("time [s],force [N],slow [mm]\n" + gap)
    assert len(whole(path, missing="drop rows")) == 160
