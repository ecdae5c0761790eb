"""The table of the metrics of the field: what is in it, and what is claimed where a model has a band."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hydrotwin.comparison import compare
from hydrotwin.comparison.metric import METRICS
from hydrotwin.report.comparison_tables import NONE
from hydrotwin.report.field_tables import DEFINITIONS, field_section
from tests.comparison.toys import Toy, recording

SHOWN = {"arm_angle": "deg", "motor_speed": "rpm", "pressure_cap": "bar"}


class Sure(Toy):
    """A toy with a band: the same standard deviation of the angle everywhere, rad."""

    width = 0.02

    def deviations(self, record):
        return {"arm_angle": np.full(len(record.time), self.width)}


def rows_of(section):
    return {(row[0].text, row[1].text): row for row in section.parts[0].rows}


def test_json_holds_the_metrics_in_si_as_the_comparison_does(comparison, report):
    data = json.loads(report["json"].read_text(encoding="utf-8"))
    rows = data["tables"]["field"]["rows"]
    assert {r["model"]["value"] for r in rows}.isdisjoint(comparison.yardsticks) and len(rows) == 9
    for row in rows:
        best = next(s for s in comparison.ranking(row["output"]["value"]) if s.model == row["model"]["value"])
        assert row["r2"]["value"] == pytest.approx(best.r2) and row["lag"]["value"] == pytest.approx(best.lag)
        assert row["iso18571"]["value"] == pytest.approx(best.iso18571)
    assert all(f"| {source}" in report["markdown"].read_text(encoding="utf-8") for *_, source in DEFINITIONS)
    assert {metric for _, metric, *_ in DEFINITIONS} <= set(METRICS)


def test_nothing_is_claimed_below_the_uncertainty_of_the_validation():
    section = field_section(compare([Sure("sure"), Toy("plain")], [recording(1)], repeats=1), SHOWN, {})
    assert "Nothing is claimed below u_val" in section.lead
    rows = rows_of(section)
    assert rows["arm_angle", "sure"][-1].text.endswith("(nothing claimed)")
    assert rows["arm_angle", "sure"][-2].value == pytest.approx(0.02)
    assert rows["arm_angle", "plain"][-1].text == NONE


def test_without_bands_nothing_is_said_of_them_and_without_a_free_run_there_is_no_section():
    plain = field_section(compare([Toy("plain")], [recording(1)], repeats=1), SHOWN, {})
    assert "u_val" not in plain.lead
    assert not field_section(compare([Toy("plain")], [recording(1)], repeats=1, modes=("one step",)), SHOWN, {}).parts
