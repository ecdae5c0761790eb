"""The layouts in which others store recordings in MAT files; each in version 5 and in 7.3."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import read_record
from hydrotwin.records.mat_file import read_mat
from tests.records.matlab_files import write_v5, write_v73

T = np.arange(6) * 0.01
P, Q = 35.0 + np.arange(6.0), np.array([0.0, 1, 0, -1, 0, 1])
PQ = np.column_stack([P, Q])
EMPTY = np.empty((0, 0))


def column(values):
    return np.asarray(values)[:, None]


@pytest.fixture(params=[write_v5, write_v73], ids=["v5", "v7.3"])
def table(request, tmp_path):
    def read(variables):
        request.param(tmp_path / "a.mat", variables)
        return read_mat(tmp_path / "a.mat")

    return read


def values_of(table):
    return {c.name: c.values.tolist() for c in table.columns if not c.unusable}


def signals(*labels, **more):
    every = [{"values": column(v), "dimensions": 1.0, "label": label} for label, v in zip(labels, (P, Q), strict=False)]
    return [{**one, **{name: value[k] for name, value in more.items()}} for k, one in enumerate(every)]


TIME = {"time": T.tolist()}
LAYOUTS = {
    "vectors": ({"time": T, "p": P, "q": column(Q)}, {**TIME, "p": P, "q": Q}),
    "vectors with tout": ({"tout": column(T), "p": column(P), "on": Q > 0}, {**TIME, "p": P, "on": Q > 0}),
    "vectors with t": ({"t": T, "p": P}, {"t": T, "p": P}),
    "numbers of every kind": (
        {"time": T, "a": P.astype("f4"), "b": P.astype("i2"), "c": P.astype("u1"), "d": P.astype("i8")},
        {**TIME, "a": P, "b": P, "c": P, "d": P},
    ),
    "settings beside them": ({"time": T, "p": P, "Ts": 0.01, "note": "rig 3", "none": EMPTY}, {**TIME, "p": P}),
    "tout and yout": ({"tout": column(T), "yout": PQ}, {**TIME, "yout[0]": P, "yout[1]": Q}),
    "a matrix in rows": ({"time": T, "y": PQ.T}, {**TIME, "y[0]": P, "y[1]": Q}),
    "To Workspace of a matrix": (
        {"tout": T, "m": np.stack([np.outer([1, 2], [p, -p]) for p in P], axis=2)},
        {**TIME, "m[0][0]": P, "m[0][1]": -P, "m[1][0]": 2 * P, "m[1][1]": -2 * P},
    ),
    "To File": ({"ans": np.vstack([T, P, Q])}, {**TIME, "ans[0]": P, "ans[1]": Q}),
    "To File of one signal": ({"ans": np.vstack([T, P])}, {**TIME, "ans": P}),
    "From Workspace": ({"u": np.column_stack([T, P, Q])}, {**TIME, "u[0]": P, "u[1]": Q}),
    "structure with time": (
        {"simout": {"time": column(T), "signals": signals("p", "q"), "blockName": "model/Scope"}},
        {**TIME, "p": P, "q": Q},
    ),
    "structure with time, one signal": (
        {"simout": {"time": column(T), "signals": signals("")[0], "blockName": "model/To Workspace"}},
        {**TIME, "simout": P},
    ),
    "structure with time, a wide signal": (
        {"y": {"time": column(T), "signals": {"values": PQ, "dimensions": 2.0, "label": "v"}}},
        {**TIME, "v[0]": P, "v[1]": Q},
    ),
    "structure with time, a label per element": (
        {"y": {"time": column(T), "signals": {"values": PQ, "dimensions": 2.0, "label": ("p", "q")}}},
        {**TIME, "p": P, "q": Q},
    ),
    "structure with time, named by blocks": (
        {"yout": {"time": column(T), "signals": signals("", "", blockName=["m/pump/p", "m/arm/angle/Out1"])}},
        {**TIME, "p": P, "angle": Q},
    ),
    "structure with time, without names": (
        {"yout": {"time": column(T), "signals": signals("", "")}},
        {**TIME, "yout_1": P, "yout_2": Q},
    ),
    "structure without time": (
        {"tout": column(T), "yout": {"time": EMPTY, "signals": signals("p", "q")}},
        {**TIME, "p": P, "q": Q},
    ),
    "struct of arrays": ({"run": {"time": T, "p": P, "q": Q}}, {**TIME, "p": P, "q": Q}),
    "struct of structs": (
        {"run": {"time": T, "pump": {"pressure": P, "shaft": {"speed": Q}}}},
        {**TIME, "pump.pressure": P, "pump.shaft.speed": Q},
    ),
    "structs beside a time": ({"time": T, "pump": {"p": P}, "arm": {"p": Q}}, {**TIME, "pump.p": P, "arm.p": Q}),
    "timeseries as a struct": (
        {"p": {"Name": "unnamed", "Data": column(P), "Time": column(T), "DataInfo": {"Units": "bar"}}},
        {**TIME, "p": P},
    ),
    "timeseries as a struct, uniform time": (
        {
            "x": {
                "Name": "p",
                "Data_": column(P),
                "Time_": EMPTY,
                "TimeInfo": {"Start_": 0.0, "Increment_": 0.01, "Length": 6.0},
            }
        },
        {**TIME, "p": P},
    ),
    "timeseries as a struct, time last": (
        {"v": {"Data": np.stack([PQ.T], axis=0), "Time": column(T)}},
        {**TIME, "v[0]": P, "v[1]": Q},
    ),
    "structures in a struct": (
        {"out": {"scope": {"time": column(T), "signals": signals("p", "q"), "blockName": "m/Scope"}, "Ts": 0.01}},
        {**TIME, "p": P, "q": Q},
    ),
    "settings with units": (
        {"time": T, "p": P, "supply": {"value": 200.0, "unit": "bar"}, "fit": {"data": 1.0, "name": "gain"}},
        {**TIME, "p": P},
    ),
    "a cell of timeseries": (
        {"logs": tuple({"Name": n, "Data": column(v), "Time": column(T)} for n, v in (("p", P), ("q", Q)))},
        {**TIME, "p": P, "q": Q},
    ),
    "a value beside its unit": (
        {"time": {"value": T, "unit": "s"}, "p": {"value": P, "unit": "bar"}, "q": {"value": column(Q), "unit": "V"}},
        {**TIME, "p": P, "q": Q},
    ),
    "labels with slashes and of Simulink": (
        {"s": {"time": column(T), "signals": signals("p/p0", "<q>")}},
        {**TIME, "p/p0": P, "q": Q},
    ),
    "axes of a scope with titles": (
        {"s": {"time": column(T), "signals": signals("", "", title=["p", "%<SignalLabel>"])}},
        {**TIME, "p": P, "s_2": Q},
    ),
    "a bus in a structure with time": (
        {"s": {"time": column(T), "signals": {"values": {"p": column(P), "arm": {"q": column(Q)}}, "label": "bus"}}},
        {**TIME, "bus.p": P, "bus.arm.q": Q},
    ),
    "a text that is called columns": ({"columns": "my notes", "time": T, "p": P}, {**TIME, "p": P}),
    "a table of channels": (
        {"time": T, "channel": [{"name": "p", "unit": "bar", "data": P}, {"name": "q [V]", "unit": "", "data": Q}]},
        {**TIME, "p": P, "q": Q},
    ),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_signals_are_found_with_their_time_and_names(layout, table):
    variables, expected = LAYOUTS[layout]
    found = values_of(table(variables))
    assert set(found) == set(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], np.asarray(values, float), rtol=1e-15, err_msg=name)


HEADERS = ("Zeit [ms]", "p [bar]", "q")


@pytest.mark.parametrize(
    "variables",
    [
        {"data": np.column_stack([1e3 * T, PQ]), "colheaders": HEADERS, "textdata": ("Messung 7",)},
        {"run": {"y": np.column_stack([1e3 * T, PQ]).T, "names": HEADERS}},
        {"y": np.column_stack([1e3 * T, PQ]), "names": ("Zeit", "p", "q"), "units": ("ms", "bar", "")},
    ],
    ids=["importdata", "in a struct, in rows", "units in a list of their own"],
)
def test_a_list_of_names_beside_a_matrix_names_its_columns(variables, table):
    columns = table(variables).columns
    assert [(c.name, c.unit) for c in columns] == [("Zeit", "ms"), ("p", "bar"), ("q", None)]
    np.testing.assert_array_equal(columns[1].values, P)


def capture(**more):
    y = [
        {"Name": '"Model Root"/"pump"/"pressure"', "Path": "", "Data": P, "Unit": "bar", **more},
        {"Name": "Out1", "Path": "Platform()://Model Root/arm/angle", "Data": Q.astype("f4"), "Unit": "", **more},
    ]
    return {"X": {"Name": "Time", "Data": T - 0.02, "Unit": "s"}, "Y": y, "Capture": {"SamplingPeriod": 0.01}}


def test_a_capture_of_controldesk_tells_time_name_and_unit(table):
    time, pressure, angle = table({"rec1_001": capture()}).columns
    np.testing.assert_array_equal(time.values, T - 0.02)
    assert [(c.name, c.unit) for c in (time, pressure, angle)] == [("time", "s"), ("pressure", "bar"), ("angle", None)]
    np.testing.assert_array_equal(pressure.values, P)


def test_a_capture_of_several_rasters_takes_the_time_that_its_index_names(table):
    fast, slow = {"Data": T, "Unit": "s"}, {"Data": T[::3] + 0.005, "Unit": "s"}
    y = [{"Name": "p", "Data": P, "XIndex": 1.0}, {"Name": "T", "Data": Q[::3], "XIndex": 2.0}]
    found = table({"c": {"X": [fast, slow], "Y": y}})
    assert found.marks_unknown
    time, p, temperature = (c.values for c in found.columns)
    np.testing.assert_array_equal(time, np.union1d(T, T[::3] + 0.005))
    np.testing.assert_array_equal(time[np.isfinite(temperature)], T[::3] + 0.005)
    np.testing.assert_array_equal(p[np.isfinite(p)], P)


def test_structs_with_a_time_of_their_own_meet_on_the_union(table):
    fast, slow = {"time": T, "p": P, "x": Q}, {"time": T[::2] + 0.001, "T": P[::2], "x": Q[::2]}
    found = table({"fast": fast, "slow": slow})
    columns = {c.name: c.values for c in found.columns}
    assert set(columns) == {"time", "p", "T", "fast.x", "slow.x"} and found.marks_unknown
    known = np.isfinite(columns["T"])
    np.testing.assert_array_equal(columns["time"][known], T[::2] + 0.001)
    np.testing.assert_array_equal(columns["slow.x"][known], Q[::2])


def test_one_time_stored_twice_is_one_axis(table):
    found = table({"a": {"time": T, "p": P}, "b": {"time": column(T), "q": Q}})
    assert not found.marks_unknown and values_of(found) == {"time": T.tolist(), "p": P.tolist(), "q": Q.tolist()}


def test_times_in_other_units_meet_in_seconds(table):
    minutes = {"Data": column(P), "Time": column(T / 60), "TimeInfo": {"Units": "minutes"}}
    found = table({"p": minutes, "q": {"Data": column(Q), "Time": column(T), "TimeInfo": {"Units": "seconds"}}})
    np.testing.assert_allclose(found.columns[0].values, T, rtol=1e-12)
    assert all(np.isfinite(c.values).all() for c in found.columns)


@pytest.mark.parametrize("where", ["beside", "inside"])
def test_a_struct_of_units_names_those_of_its_neighbours(where, table):
    units = {"units": {"time": "ms", "p": "bar"}}
    columns = table({"time": T, "p": P} | units if where == "beside" else {"run": {"time": T, "p": P, **units}}).columns
    assert [(c.name, c.unit) for c in columns] == [("time", "ms"), ("p", "bar")]


def test_units_of_a_timeseries_and_in_names_are_kept(table):
    one = {"Name": "p", "Data": column(P), "Time": column(T), "DataInfo": {"Units": "bar"}}
    two = {"Name": "flow [L/min]", "Data": column(Q), "Time": column(T), "DataInfo": {"Units": ""}}
    three = {"Name": "speed", "Data": column(Q), "Time": column(T), "DataInfo": {"Units": {"Name": "rad/s"}}}
    columns = table({"a": one, "b": two, "c": three}).columns[1:]
    assert [(c.name, c.unit) for c in columns] == [("p", "bar"), ("flow", "L/min"), ("speed", "rad/s")]


def test_what_cannot_be_used_says_why_and_costs_nothing_else(table):
    found = {
        c.name: c
        for c in table({"time": T, "p": P, "z": Q * 1j, "short": P[:4], "spectrum": np.ones((6, 300))}).columns
    }
    assert found["p"].values.tolist() == P.tolist() and not found["p"].unusable
    for name, says in {
        "z": "complex",
        "short": "has 4 values, time has 6",
        "spectrum": "sample of it is an array",
    }.items():
        assert re.search(rf"a.mat: column '{name}': .*{says}.*\. (Save|Name) ", found[name].unusable), found[
            name
        ].unusable
        assert len(found[name].values) == 6 and np.isnan(found[name].values).all()


def test_a_cell_of_texts_as_long_as_time_is_a_column_without_numbers(table):
    (mode,) = (c for c in table({"time": T, "p": P, "mode": ("auto",) * 6, "log": ("a", "b")}).columns if c.unusable)
    assert mode.name == "mode" and "no numbers (got 'auto')" in mode.unusable


def test_a_time_called_t_must_grow_to_be_one(table):
    found = table({"t": Q, "time": T, "p": P})
    assert values_of(found) == {"time": T.tolist(), "t": Q.tolist(), "p": P.tolist()}
    assert values_of(table({"t": Q, "p": P})) == {"t": Q.tolist(), "p": P.tolist()}


def test_names_that_occur_twice_are_told_apart(table):
    twice = [{"Name": "p", "Data": column(P), "Time": column(T)}, {"Name": "p", "Data": column(Q), "Time": column(T)}]
    names = [c.name for c in table({"a": twice[0], "b": twice[1]}).columns]
    assert names == ["time", "a", "b"]


def test_a_file_without_a_signal_says_what_it_holds(table):
    with pytest.raises(DataError, match=r"a.mat: no signal over time \(it holds Ts, note\)\. Save the signals"):
        table({"Ts": 0.01, "note": "rig 3"})


def test_version_4_reads_alike(tmp_path):
    write_v5(tmp_path / "a.mat", {"time": T, "p": P, "y": PQ, "note": "rig 3"}, format="4")
    assert values_of(read_mat(tmp_path / "a.mat")) == {
        "time": T.tolist(), "p": P.tolist(), "y[0]": P.tolist(), "y[1]": Q.tolist()
    }  # fmt: skip


def test_a_record_needs_no_more_than_units(tmp_path):
    write_v73(tmp_path / "a.mat", {"simout": {"time": column(T), "signals": signals("p", "q")}})
    record = read_record(tmp_path / "a.mat", units={"p": "bar", "q": "V"})
    np.testing.assert_allclose(record["p"], P * 1e5)
    np.testing.assert_array_equal(record.time, T)


def test_hdf5_of_others_reads_alike_with_the_units_of_its_attributes(tmp_path):
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/time"], file["run/pump/p"], file["run/y"] = T, P, PQ
        file["run/time"].attrs["units"], file["run/pump/p"].attrs["unit"] = "ms", np.bytes_("bar")
        file["run/mode"] = np.array(["auto"] * 6, h5py.string_dtype())
    columns = {c.name: c for c in read_mat(tmp_path / "a.h5").columns}
    assert {n: c.unit for n, c in columns.items() if not c.unusable} == {
        "time": "ms", "pump.p": "bar", "y[0]": None, "y[1]": None
    }  # fmt: skip
    np.testing.assert_array_equal(columns["y[1]"].values, Q)
    assert "no numbers (got 'auto')" in columns["mode"].unusable


def test_time_without_a_unit_is_in_seconds_and_said_to_be(tmp_path):
    write_v5(tmp_path / "a.mat", {"zeit": T, "p": P, "units": {"p": "bar"}})
    record = read_record(tmp_path / "a.mat")
    np.testing.assert_array_equal(record.time, T)
    assert "zeit in s, as MATLAB counts it" in record.understood
    assert read_record(tmp_path / "a.mat", units={"zeit": "ms"}).time[-1] == pytest.approx(T[-1] / 1000)


def test_days_of_matlab_and_counts_since_1970_are_told_by_their_size(tmp_path):
    for time in (739_000.5 + T / 86_400, (1_700_000_000_000 + 1000 * T).astype("i8")):
        write_v5(tmp_path / "a.mat", {"time": time, "p": P, "units": {"p": "bar"}})
        record = read_record(tmp_path / "a.mat")
        np.testing.assert_allclose(record.time - record.time[0], T, atol=2e-5)


def test_a_cell_of_dates_is_the_time(table, tmp_path):
    stamps = tuple(f"04.05.2026 10:00:00.{k:02d}" for k in range(6))
    table({"Zeit": stamps, "p": P, "units": {"p": "bar"}})
    record = read_record(tmp_path / "a.mat")
    np.testing.assert_allclose(record.time, T, atol=1e-12)
    np.testing.assert_allclose(record["p"], P * 1e5)


def test_packed_numbers_of_hdf5_are_unpacked(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = np.arange(5) / 10
        file["time"].attrs["units"] = "s"
        file["p"] = np.arange(5, dtype=np.int16)
        file["p"].attrs.update({"units": "bar", "scale_factor": 0.1, "add_offset": 5.0})
    np.testing.assert_allclose(read_record(tmp_path / "a.h5")["p"], 1e5 * (5 + np.arange(5) / 10))
