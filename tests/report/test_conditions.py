"""Scores by operating condition: a run that failed is not hidden by the mean of the others."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np

from hydrotwin.comparison import Matrix, Variant, VariantRun, compare
from hydrotwin.report import comparison_page, display_units
from hydrotwin.report.figure import styles
from hydrotwin.report.matrix_tables import grouped, tag_tables
from tests.comparison.toys import Toy, recording

RECORDS = [
    dataclasses.replace(recording(k, duration=2.0), tags={"load": load}) for k, load in enumerate(("1", "2", "2"), 1)
]


def found():
    return compare([Toy("whole", gain=121.0), Toy("broken", fails_on="validation_2")], RECORDS, modes=("free run",))


def test_a_condition_in_which_a_run_failed_says_on_how_many_recordings_it_stands():
    section = next(s for s in comparison_page(found()).sections if s.id == "conditions")
    table = next(t for t in section.parts if t.id == "by_load_motor_speed").as_json()
    (one,) = (row for row in table["rows"] if row["load"]["value"] == "1")
    (two,) = (row for row in table["rows"] if row["load"]["value"] == "2")
    assert "of" not in one["broken"]["shown"] and two["broken"]["shown"].endswith(" (1 of 2)")
    assert "of" not in two["whole"]["shown"]


def test_the_condition_in_which_the_best_model_failed_comes_first():
    alone = compare([Toy("broken", fails_on="validation_1")], RECORDS, modes=("free run",), repeats=0)
    section = next(s for s in comparison_page(alone).sections if s.id == "conditions")
    table = next(t for t in section.parts if t.id == "by_load_arm_angle").as_json()
    assert [row["load"]["value"] for row in table["rows"]] == ["1", "2"]


def test_in_the_overview_such_a_condition_has_no_mean():
    run = VariantRun(Variant(), found())
    rows, columns, values = grouped(Matrix("toys", (run,)), "arm_angle", "free run", lambda r: r.tags["load"])
    assert [model for _, model in rows] == ["whole", "broken"] and columns == ["1", "2"]
    assert np.isfinite(values).tolist() == [[True, True], [True, False]]
    how = SimpleNamespace(units=display_units(run.comparison), look=styles(run.comparison.models))
    (table,) = tag_tables(Matrix("toys", (run,)), how)
    assert {row["model"]["value"]: row["2"]["value"] is None for row in table.as_json()["rows"]} == {
        "whole": False,
        "broken": True,
    }
