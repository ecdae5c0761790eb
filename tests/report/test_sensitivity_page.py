"""The page of a sensitivity study: its sections, its tables as data, its figures as Plotly objects."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import pytest

from hydrotwin.identification import identify, profile, sensitivity
from hydrotwin.report import as_html, as_json, as_markdown, figures, sensitivity_page
from hydrotwin.simulation import simulate
from tests.identification.influences import exploding, product, record, steps


@pytest.fixture(scope="module")
def studied():
    driven = record(u=steps, x_seen=0.0)
    seen = simulate(product(), driven)["x_seen"]
    driven = record(u=steps, x_seen=seen + 0.05 * np.random.default_rng(0).standard_normal(len(seen)))
    fit = identify(product(), [driven], free=["*"])
    found = sensitivity(fit, [driven], parameters=["*"], over="20%", samples=32, stretches=3)
    return found, profile(fit, [driven], parameters=["a", "tau"])


def test_the_page_tells_everything_once(studied):
    found, profiles = studied
    page = sensitivity_page(found, profiles=profiles, command="hydrotwin sensitivity")
    assert [s.id for s in page.sections] == ["drivers", "when", "apart", "profiles", "next", "asked", "provenance"]
    assert page.answer.startswith("x_seen is driven by") and "a_seen is driven by a (" in page.answer
    text = as_markdown(page)
    assert text.count("a and b cannot be told apart") == 1
    assert "neither downwards nor upwards" in text and "the quadratic interval holds" in text
    assert "A sensor of a_seen" in text
    assert "<table" in as_html(page)


def test_tables_and_data_say_the_same(studied):
    found, profiles = studied
    data = json.loads(as_json(sensitivity_page(found, profiles=profiles)))
    for row in data["tables"]["shares"]["rows"]:
        for output in ("x_seen", "a_seen"):
            assert row[output]["value"] == data["sobol"]["whole"]["total"][output][row["parameter"]["value"]]
    intervals = {p["name"]: (p["low"], p["high"]) for p in data["profiles"]["profiles"]}
    assert intervals["a"] == (None, None) and None not in intervals["tau"]
    left = [row["left"]["value"] for row in data["tables"]["measure_next"]["rows"]]
    assert left == pytest.approx([100 * min(m["narrowed"].values()) for m in data["measure_next"]])


def test_its_figures_are_plotly_objects(studied):
    found, profiles = studied
    drawn = figures(found) | figures(profiles)
    assert {"shares", "correlation", "next-bars", "indices-x_seen", "course-x_seen-run", "profile-tau"} <= set(drawn)
    assert all(isinstance(figure, go.Figure) for figure in drawn.values())
    stacked = np.sum([bar.y for bar in drawn["course-x_seen-run"].data if bar.type == "bar"], axis=0)
    assert stacked == pytest.approx([100.0] * 3)


def test_a_page_without_indices_or_recorded_outputs_leaves_those_sections_out():
    found = sensitivity(exploding(), [record(seconds=1.0)], parameters=["a"], samples=0, stretches=2)
    page = sensitivity_page(found)
    assert [s.id for s in page.sections] == ["drivers", "when", "asked", "provenance"]
    assert "Shares of the squared local sensitivities" in as_markdown(page)
    diverged = sensitivity(exploding(), [record(seconds=2.0)], parameters=["a"], given={"a": (0.2, 0.8)}, samples=64)
    assert "parameter sets diverged" in sensitivity_page(diverged).notices[0]


def test_an_interval_that_does_not_exist_is_told_in_words_on_the_page(studied):
    found, profiles = studied
    none = replace(profiles.profiles[0], quadratic=None, unknown="the fit rests on its bound. Widen it")
    page = sensitivity_page(found, profiles=replace(profiles, profiles=(none, *profiles.profiles[1:])))
    (cells,) = [
        [c.text for c in column.cells]
        for section in page.sections
        for part in section.parts
        if getattr(part, "id", "") == "profile_intervals"
        for column in part.columns
        if column.key == "quadratic_low"
    ]
    assert cells[0] == "none" and cells[1] != "none"
    data = json.loads(as_json(page))
    assert data["profiles"]["profiles"][0]["quadratic"] is None
    assert "It has no quadratic interval: the fit rests on its bound" in as_json(page)
