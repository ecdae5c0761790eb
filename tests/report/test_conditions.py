"""Scores by operating condition: a run that failed is not hidden by the mean of the others."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from hydrotwin.comparison import Matrix, Variant, VariantRun, compare
from hydrotwin.models.language.units import convert
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


def test_every_recording_is_a_dot_in_its_condition_the_worst_first():
    section = next(s for s in comparison_page(found()).sections if s.id == "conditions")
    group = section.parts[0]
    assert (group.id, [f.label for f in group.figures]) == ("by-load", ["arm_angle", "motor_speed", "pressure_cap"])
    comparison, spec = found(), group.figures[1].spec
    table = next(t for t in section.parts if t.id == "by_load_motor_speed").as_json()
    assert spec["layout"]["xaxis"]["ticktext"] == [row["load"]["value"] for row in table["rows"]]
    unit = display_units(comparison)["motor_speed"]
    for trace in spec["data"]:
        rows = [s for s in comparison.scores if (s.model, s.output) == (trace["name"], "motor_speed")]
        assert sorted(trace["y"]) == pytest.approx(sorted(convert(s.rmse, s.unit, unit) for s in rows))
        of = [spec["layout"]["xaxis"]["ticktext"][round(x)] for x in trace["x"]]
        loads = {r.name: r.tags["load"] for r in RECORDS}
        assert sorted(of) == sorted(loads[s.record] for s in rows)


def test_one_condition_needs_no_plot():
    alike = [dataclasses.replace(r, tags={"load": "1"}) for r in RECORDS]
    page = comparison_page(compare([Toy("a", gain=121.0)], alike, modes=("free run",), repeats=0))
    section = next(s for s in page.sections if s.id == "conditions")
    assert section.parts and all(hasattr(part, "columns") for part in section.parts)
