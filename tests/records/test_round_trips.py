"""A record written and read again is the same record, in every format and unit."""

from __future__ import annotations

import hashlib
import os
import stat
import time as clock

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError, UnitError
from hydrotwin.records import Record, write_record
from tests.records.whole import whole

FORMATS = [(".csv", "5"), (".parquet", "5"), (".mat", "5"), (".mat", "7.3")]


@pytest.fixture
def record():
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.001, 0.02, 300))
    signals = {
        "arm_angle": rng.normal(size=300),
        "cylinder.cap_pressure": 1e7 * rng.normal(size=300),
        "cylinder_cap_pressure": 1e-9 * rng.normal(size=300),
        "flow": 1e-4 * rng.normal(size=300),
        "1_odd name": rng.integers(-3, 3, 300).astype(float),
    }
    units = {"arm_angle": "rad", "cylinder.cap_pressure": "Pa", "cylinder_cap_pressure": "m3/(s.sqrt(Pa))"}
    units |= {"flow": "m3/s", "1_odd name": "1"}
    return Record(t, signals, units, "run")


def assert_same(back: Record, record: Record, rtol: float):
    assert back.names == record.names
    assert back.units == record.units
    np.testing.assert_allclose(back.time, record.time, rtol=rtol, atol=0)
    for name in record:
        np.testing.assert_allclose(back[name], record[name], rtol=rtol, atol=0)


@pytest.mark.parametrize(("suffix", "version"), FORMATS)
def test_si_values_come_back_bit_for_bit(record, suffix, version, tmp_path):
    path = write_record(record, tmp_path / f"run{suffix}", mat_version=version)
    back = whole(path)
    assert_same(back, record, rtol=0)
    assert back.name == "run"
    assert back.source == str(path)
    assert back.digest == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(("suffix", "version"), FORMATS)
def test_values_in_display_units_come_back_to_1e_12(record, suffix, version, tmp_path):
    shown = {"arm_angle": "deg", "cylinder.cap_pressure": "bar", "flow": "L/min", "1_odd name": "%"}
    path = write_record(record, tmp_path / f"run{suffix}", units=shown, mat_version=version)
    back = whole(path)
    assert_same(back, record, rtol=1e-12)
    assert {n: back.display_units[n] for n in shown} == shown
    again = whole(write_record(back, tmp_path / f"again{suffix}", mat_version=version))
    assert_same(again, record, rtol=1e-12)
    assert again.display_units == back.display_units


def test_a_large_csv_comes_back_bit_for_bit_and_its_flaws_are_still_found(tmp_path):
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.001, 0.002, 50_000))
    record = Record(t, {"x": rng.normal(size=t.size), "p": 1e7 * rng.normal(size=t.size)}, {"x": "m", "p": "Pa"})
    path = write_record(record, tmp_path / "large.csv")
    assert path.stat().st_size > 2_000_000
    assert_same(whole(path), record, rtol=0)
    lines = path.read_text().split("\n")
    lines.insert(10, "")
    time, x, _ = lines[20_000].split(",")
    for flaw, says in (
        (f"{time},{x},", "row 20001, column 'p': no value"),
        (f"{time},{x},nan", "row 20001, column 'p': no value"),
        (f"{time},inf,1", "row 20001, column 'x': not finite"),
        (f"{time},a,1", "row 20001, column 'x': not a number"),
        (f"{time},1", "row 20001, column 'p': the row is too short"),
        (f"{lines[19_999].split(',')[0]},1,1", "row 20001, column 'time': the same time as in row 20000"),
    ):
        path.write_text("\n".join([*lines[:20_000], flaw, *lines[20_001:]]))
        with pytest.raises(DataError, match=says):
            whole(path)


def test_mdf_comes_back(record, tmp_path):
    pytest.importorskip("asammdf", reason="needs the extra hydrotwin[mdf]")
    path = write_record(record, tmp_path / "run.mf4", units={"arm_angle": "deg"})
    assert_same(whole(path), record, rtol=1e-12)


def test_a_csv_file_is_what_the_documentation_says(tmp_path):
    record = Record([0.0, 0.25], {"p": [1e5, 2.5e5], "x": [0.001, 0.1]}, {"p": "Pa", "x": "m"})
    path = write_record(record, tmp_path / "a.csv", units={"p": "bar", "x": "mm"})
    assert path.read_text() == "time [s],p [bar],x [mm]\n0.0,1.0,1.0\n0.25,2.5,100.0\n"


@pytest.mark.parametrize(
    "text",
    [
        "time [s];p [bar];x [mm]\n0,0;1,0;1,0\n0,25;2,5;100,0\n",
        "time [s]\tp [bar]\tx [mm]\n0.0\t1.0\t1.0\n0.25\t2.5\t100.0\n",
        'time [ms], "p [bar]", x [cm]\n0, 1.0, 0.1\n250, 2.5, 10\n',
        '# a note\r\n"time [s]","p [MPa]","x [m]"\r\n"0","0.1","0.001"\r\n"0.25","0.25","0.1"\r\n\r\n',
        "p [bar],time [s],x [mm]\n1,0,1\n2.5,0.25,100",
    ],
    ids=[
        "semicolon and decimal comma",
        "tab",
        "spaces and ms",
        "quoted, comment, CRLF",
        "time elsewhere, no last newline",
    ],
)
def test_dialects_of_csv_read_alike(text, tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode())
    record = whole(path)
    assert record.names == ("p", "x")
    np.testing.assert_allclose(record.time, [0, 0.25], rtol=1e-15)
    np.testing.assert_allclose(record.array(["p", "x"]), [[1e5, 1e-3], [2.5e5, 0.1]], rtol=1e-14)


def test_units_left_out_of_a_file_can_be_given(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time,x\n0,1\n1,2\n")
    record = whole(path, units={"time": "min", "x": "mm"})
    np.testing.assert_allclose(record.time, [0, 60])
    np.testing.assert_allclose(record["x"], [1e-3, 2e-3])
    with pytest.raises(DataError, match="no column 'y', named in units"):
        whole(path, units={"y": "mm"})


def test_parquet_of_others_with_units_in_names_and_mixed_types(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet

    path = tmp_path / "a.parquet"
    columns = {
        "time [ms]": pa.array([0, 10, 20], pa.int64()),
        "x [mm]": pa.array([1, 2, 3], pa.float32()),
        "on [1]": pa.array([True, False, True]),
        "gear [1]": pa.array([1.0, 2.0, 1.0]).dictionary_encode(),
    }
    pyarrow.parquet.write_table(pa.table(columns), path)
    record = whole(path)
    np.testing.assert_allclose(record.time, [0, 0.01, 0.02])
    np.testing.assert_allclose(record.array(["x", "on", "gear"]), [[1e-3, 1, 1], [2e-3, 0, 2], [3e-3, 1, 1]])


def test_mat_files_of_others_take_units_from_a_struct_and_skip_scalars(tmp_path):
    import h5py
    import scipy.io

    t, x = np.arange(4.0), np.array([[1.0], [2.0], [3.0], [4.0]])
    path = tmp_path / "five.mat"
    scipy.io.savemat(path, {"time": t, "x": x, "Ts": 1.0, "note": "rig 3", "units": {"time": "s", "x": "mm"}})
    np.testing.assert_allclose(whole(path)["x"], 1e-3 * x.ravel())
    path = tmp_path / "seven.mat"
    with h5py.File(path, "w") as file:
        file["time"], file["x"], file["Ts"] = t[None, :], x.T, [[1.0]]
        for name, unit in {"time": "s", "x": "mm"}.items():
            text = file.create_dataset(f"units/{name}", data=np.frombuffer(unit.encode("utf-16-le"), "<u2")[:, None])
            text.attrs["MATLAB_class"] = np.bytes_("char")
    record = whole(path)
    assert record.names == ("x",)
    np.testing.assert_allclose(record["x"], 1e-3 * x.ravel())


def test_matlab_variables_are_legal_and_all_different(record, tmp_path):
    import scipy.io

    path = write_record(record, tmp_path / "run.mat")
    names = [n for n in scipy.io.loadmat(path) if not n.startswith("__")]
    assert len(names) == len(record.names) + 2  # time and the text that names the columns
    assert all(n.isidentifier() and n[0].isalpha() and len(n) <= 63 for n in names)


def test_a_failed_write_leaves_the_old_file_whole(record, tmp_path, monkeypatch):
    path = write_record(record, tmp_path / "run.csv")
    before = path.read_bytes()
    monkeypatch.setattr("csv.writer", lambda *a, **k: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(DataError, match="disk full"):
        write_record(record, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["run.csv"]


@pytest.mark.skipif(os.name == "nt", reason="file modes of POSIX")
def test_a_written_file_has_the_usual_mode(record, tmp_path):
    plain = tmp_path / "plain"
    plain.touch()
    path = write_record(record, tmp_path / "run.csv")
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_wrong_ways_to_write_are_refused(record, tmp_path):
    with pytest.raises(DataError, match=r"'.xlsx'"):
        write_record(record, tmp_path / "a.xlsx")
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match=r"a\.csv: cannot be written"):
        write_record(record, tmp_path / "file" / "a.csv")
    with pytest.raises(DataError, match="Did you mean 'arm_angle'"):
        write_record(record, tmp_path / "a.csv", units={"arm_angel": "deg"})
    with pytest.raises(UnitError, match="cannot become 'bar'"):
        write_record(record, tmp_path / "a.csv", units={"arm_angle": "bar"})
    with pytest.raises(DataError, match="mat_version"):
        write_record(record, tmp_path / "a.mat", mat_version="6")


def test_a_bench_recording_reads_well_under_a_third_of_a_second(tmp_path):
    rng = np.random.default_rng(0)
    t = np.arange(31 * 250) / 250
    names = [f"s{k}" for k in range(9)]
    record = Record(t, {n: rng.normal(size=t.size) for n in names}, dict.fromkeys(names, "Pa"))
    path = write_record(record, tmp_path / "bench.csv")
    whole(path)
    spent = []
    for _ in range(3):
        start = clock.process_time()
        whole(path)
        spent.append(clock.process_time() - start)
    assert min(spent) < 0.2
