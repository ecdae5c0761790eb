"""Objects of MATLAB in MAT files: timeseries, Dataset, timetable; without their reader they say what to do."""

from __future__ import annotations

import importlib.util
import re
import warnings

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import read_record
from hydrotwin.records.mat_file import read_mat

pytest.importorskip("matio")
pd = pytest.importorskip("pandas")
from matio import save_to_mat  # noqa: E402
from matio.utils.matclass import MatlabOpaque  # noqa: E402

T = np.arange(6) * 0.01
P, Q = 35.0 + np.arange(6.0), np.array([0.0, 1, 0, -1, 0, 1])
EMPTY = np.empty((0, 0))


def column(values):
    return np.asarray(values, float)[:, None]


def text(value):
    return np.array([value])


def timeseries(name, values, unit="", time=T, uniform=False, units="seconds"):
    """As MATLAB stores it: data in ``Data_``, time in TimeInfo, or start, increment and length."""
    info = {"Units": text(units), "Length": np.array([[float(len(time))]]), "StartDate": text("")}
    info |= {"Time_": EMPTY if uniform else column(time)}
    info |= {
        "Start_": np.array([[time[0]]]) if uniform else EMPTY,
        "Increment_": np.array([[0.01]]) if uniform else EMPTY,
    }
    values = np.asarray(values, float)
    fields = {
        "Name": text(name),
        "Data_": values[:, None] if values.ndim == 1 else values,
        "DataInfo": MatlabOpaque({"Units": text(unit)}, "tsdata.datametadata"),
        "Time_": EMPTY,
        "TimeInfo": MatlabOpaque(info, "tsdata.timemetadata"),
    }
    return MatlabOpaque(fields, "timeseries")


def struct(**fields):
    one = np.empty((1, 1), dtype=[(name, object) for name in fields])
    for name, value in fields.items():
        one[0, 0][name] = value
    return one


def cell(*nodes):
    every = np.empty((1, len(nodes)), object)
    every[0, :] = nodes
    return every


def element(name, values, path="model/pump"):
    block = MatlabOpaque({"Path": cell(text(path)), "SubPath": text("")}, "Simulink.SimulationData.BlockPath")
    return MatlabOpaque({"Name": text(name), "BlockPath": block, "Values": values}, "Simulink.SimulationData.Signal")


def dataset(*elements):
    storage = MatlabOpaque(
        {"any": struct(Version=np.array([[2.0]]), Elements=cell(*elements))},
        "Simulink.SimulationData.Storage.RamDatasetStorage",
    )
    return MatlabOpaque({"Name": text("logsout"), "Storage_": storage}, "Simulink.SimulationData.Dataset")


@pytest.fixture(params=["v7", "v7.3"])
def table(request, tmp_path):
    def read(**variables):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            save_to_mat(tmp_path / "a.mat", variables, version=request.param)
        return read_mat(tmp_path / "a.mat")

    return read


@pytest.mark.parametrize("uniform", [False, True])
def test_a_timeseries_tells_time_name_and_unit(uniform, table):
    time, p = table(ts=timeseries("pressure_cap", P, "bar", uniform=uniform)).columns
    assert (time.name, time.unit, p.name, p.unit) == ("time", "s", "pressure_cap", "bar")
    np.testing.assert_allclose(time.values, T, rtol=1e-15)
    np.testing.assert_array_equal(p.values, P)


def test_a_timeseries_without_a_name_has_that_of_its_variable(table):
    assert [c.name for c in table(p=timeseries("unnamed", P), q=timeseries("", Q)).columns] == ["time", "p", "q"]


def test_a_wide_timeseries_is_a_column_per_element(table):
    columns = table(y=timeseries("y", np.column_stack([P, Q]))).columns
    assert [c.name for c in columns] == ["time", "y[0]", "y[1]"]
    np.testing.assert_array_equal(columns[2].values, Q)


def test_logged_signals_of_several_rates_meet_on_the_union(table):
    slow = timeseries("T", P[::3], "degC", T[::3] + 0.002)
    found = table(logsout=dataset(element("p", timeseries("p", P, "bar")), element("", slow, "model/oil/tank")))
    assert found.marks_unknown
    time, p, tank = found.columns
    assert [(c.name, c.unit) for c in (p, tank)] == [("p", "bar"), ("tank", "degC")]
    np.testing.assert_array_equal(time.values[np.isfinite(tank.values)], T[::3] + 0.002)
    np.testing.assert_array_equal(p.values[np.isfinite(p.values)], P)


def test_a_bus_names_its_elements_with_dots(table):
    bus = struct(pressure=timeseries("a", P, "bar"), arm=struct(angle=timeseries("b", Q, "deg")))
    columns = table(logsout=dataset(element("plant", bus), element("u", timeseries("u", Q)))).columns
    assert [c.name for c in columns] == ["time", "plant.pressure", "plant.arm.angle", "u"]
    assert [c.unit for c in columns] == ["s", "bar", "deg", None]


def test_a_dataset_of_bare_timeseries_and_arrays_beside_it(table):
    columns = table(yout=dataset(timeseries("p", P), timeseries("q", Q)), tout=column(T), Ts=np.array([[0.01]])).columns
    assert [c.name for c in columns] == ["time", "p", "q"]


@pytest.mark.parametrize(
    ("units", "seconds"),
    [("days", 86400), ("hours", 3600), ("minutes", 60), ("milliseconds", 1e-3), ("nanoseconds", 1e-9)],
)
def test_the_units_of_the_time_of_a_timeseries_are_known(units, seconds, table, tmp_path):
    table(p=timeseries("p", P, "bar", units=units))
    np.testing.assert_allclose(read_record(tmp_path / "a.mat").time, T * seconds, rtol=1e-12)


@pytest.mark.parametrize("kind", ["duration", "stamp"])
def test_a_timetable_is_exact(kind, table):
    steps = np.arange(6) * np.timedelta64(10, "ms")
    index = (
        pd.TimedeltaIndex(steps) if kind == "duration" else pd.DatetimeIndex(np.datetime64("2026-05-04T10:00") + steps)
    )
    found = table(run=pd.DataFrame({"p": P, "mode": ["auto"] * 6}, index=index.rename("Time")))
    columns = {c.name: c for c in found.columns}
    assert columns["time"].unit == "s" and columns["time"].values.tolist() == [0, 0.01, 0.02, 0.03, 0.04, 0.05]
    assert columns["p"].values.tolist() == P.tolist() and "no numbers" in columns["mode"].unusable


def test_timetables_that_start_apart_stay_apart(table):
    start, step = np.datetime64("2026-05-04T10:00"), np.timedelta64(10, "ms")
    fast = pd.DataFrame({"p": P}, index=pd.DatetimeIndex(start + np.arange(6) * step, name="Time"))
    late = pd.DataFrame({"q": Q[:2]}, index=pd.DatetimeIndex(start + np.array([3, 8]) * step, name="Time"))
    columns = table(a=fast, b=late).columns
    np.testing.assert_array_equal(columns[0].values, [0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.08])
    np.testing.assert_array_equal(columns[2].values, [np.nan] * 3 + [0, np.nan, np.nan, 1])


def test_durations_and_stamps_as_a_time_vector(table):
    steps = (np.arange(6) * np.timedelta64(10, "ms"))[:, None]
    for time in (steps, np.datetime64("2026-05-04T10:00", "ms") + steps):
        columns = table(t=time, p=column(P)).columns
        assert columns[0].unit == "s" and columns[0].values.tolist() == [0, 0.01, 0.02, 0.03, 0.04, 0.05]


@pytest.fixture
def without_reader(monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "matio" else found(name, *rest)
    )


def test_without_their_reader_objects_name_the_extra_and_the_way_round(table, without_reader):
    with pytest.raises(
        DataError,
        match=r"a.mat: variable 'ts': it is an object of MATLAB \(timeseries\).*mat-io.*hydrotwin\[mat\].*save",
    ):
        table(ts=timeseries("p", P))


def test_without_their_reader_the_other_variables_are_read(table, without_reader):
    found = {
        c.name: c for c in table(ts=timeseries("p", P), more=timeseries("q", Q), time=column(T), x=column(P)).columns
    }
    assert found["x"].values.tolist() == P.tolist()
    for name in ("ts", "more"):
        assert re.search(rf"a.mat: column '{name}': .*object of MATLAB .timeseries", found[name].unusable)
        assert len(found[name].values) == 6


def test_an_object_without_signals_is_none(table):
    found = {
        c.name: c for c in table(time=column(T), x=column(P), other=MatlabOpaque({"Gain": EMPTY}, "my.Block")).columns
    }
    assert list(found) == ["time", "x"]


def test_where_the_reader_fails_the_rest_is_read_without_it(table, monkeypatch):
    def fail(*_, **__):
        raise ValueError("a new kind of subsystem")

    monkeypatch.setattr("matio.load_from_mat", fail)
    found = {c.name: c for c in table(time=column(T), x=column(P), ts=timeseries("p", P)).columns}
    assert found["x"].values.tolist() == P.tolist()
    assert "object of MATLAB (timeseries) that mat-io cannot read" in found["ts"].unusable
