"""MAT files of Dymola and OpenModelica: names as columns of a char matrix, values by data set and index."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.io

from hydrotwin.records.mat_file import read_mat

T = np.arange(5) * 0.1
P = 1e5 * np.array([1.0, 2, 3, 4, 5])
VARIABLES = {  # name: description, data set, signed index
    "time": ("Simulation time [s]", 0, 1),
    "cylinder.p": ("Pressure in the chamber [Pa|bar]", 2, 2),
    "cylinder.port.q": ("[m3/s] :#(type=Real)", 2, -2),
    "mass.m": ("Mass [kg]", 1, 2),
    "valve.open": ("", 2, 3),
}


def chars(texts):
    longest = max(map(len, texts))
    return np.array([list(text.ljust(longest)) for text in texts])


@pytest.mark.parametrize("turned", [True, False])
def test_what_changes_is_read_with_unit_and_sign(turned, tmp_path):
    info = np.array([[of, index, 0, -1] for _, of, index in VARIABLES.values()], "i4")
    data = np.column_stack([T, P, T > 0.2])
    content = {
        "name": chars(list(VARIABLES)),
        "description": chars([text for text, *_ in VARIABLES.values()]),
        "dataInfo": info,
        "data_1": np.array([[0.0, 95.0], [0.4, 95.0]]),
        "data_2": data,
    }
    content = {name: np.ascontiguousarray(value.T) if turned else value for name, value in content.items()}
    kind = "binTrans" if turned else "binNormal"
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"Aclass": chars(["Atrajectory", "1.1", "", kind]), **content}, format="4")
    time, p, q, valve = read_mat(path).columns
    assert [(c.name, c.unit) for c in (time, p, q, valve)] == [
        ("time", "s"), ("cylinder.p", "Pa"), ("cylinder.port.q", "m3/s"), ("valve.open", None)
    ]  # fmt: skip
    np.testing.assert_array_equal([time.values, p.values, q.values, valve.values], [T, P, -P, T > 0.2])
