"""The pieces a page is made of: numbers, tables, figures, sections."""

from __future__ import annotations

import doctest
import json

import numpy as np
import pytest

import hydrotwin.report.format as number_format
from hydrotwin.report import (
    Figure,
    FigureGroup,
    Note,
    Page,
    Section,
    as_html,
    as_json,
    as_markdown,
    decimate,
    error_bars,
    layout,
    line,
    numbers,
    pretty_unit,
    shown_unit,
    styles,
    table,
    texts,
)
from hydrotwin.report.comparison_figures import error_range
from hydrotwin.report.figure import band, unpacked
from hydrotwin.report.format import number_texts
from hydrotwin.report.heat_map import heat_map


def test_the_examples_of_the_number_format_hold():
    found = doctest.testmod(number_format)
    assert found.attempted >= 6
    assert found.failed == 0


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([0.0123, 1.5], ["0.0123", "1.5000"]),
        ([1e-9, 2.0], ["1.00e−9", "2.00"]),
        ([12345.0, 100.0], ["12\u202f345", "100"]),
        ([-1e-5, 0.5, 0.02], ["−1.00e−5", "0.500", "0.0200"]),
        ([0.0, float("nan"), float("inf")], ["0", "–", "∞"]),
        ([None, 3.0], ["–", "3.00"]),
    ],
)
def test_numbers_of_a_column_share_decimals_unless_they_span_decades(values, expected):
    assert number_texts(values) == expected


def test_zero_has_no_minus():
    assert number_texts([-0.0001, 1.0], decimals=2) == ["0.00", "1.00"]


def test_units_are_those_engineers_read():
    assert shown_unit("rad/s", peak=1.0) == "deg/s"
    assert shown_unit("rad", preferred="rad") == "rad"
    assert shown_unit("Pa", preferred="mm") == "bar"
    assert shown_unit("m3/(s.sqrt(Pa))") == "m3/(s.sqrt(Pa))"
    assert pretty_unit("N.s/m") == "N·s/m"
    assert pretty_unit("cm3/rev") == "cm³/rev"


def test_errors_in_a_unit_with_a_zero_point_are_differences():
    column = numbers("e", "Error", [2.0], "K", "degC")
    assert column.cells[0].text == "2.00"
    assert numbers("t", "Temperature", [293.15], "K", "degC", difference=False).cells[0].text == "20.0"


def test_the_best_is_marked_among_those_allowed():
    column = numbers("r", "RMSE", [1.0, 0.5, 0.2], best="min", among=[True, True, False])
    assert [c.best for c in column.cells] == [False, True, False]
    assert [c.best for c in numbers("r", "RMSE", [1.0], best="min").cells] == [False]


def test_decimation_keeps_ends_and_every_peak():
    time = np.linspace(0.0, 10.0, 50_001)
    values = np.sin(time)
    values[31_234] = 9.0
    values[7_000] = -7.0
    t, v = decimate(time, values, 400)
    assert len(t) <= 400
    assert (np.diff(t) > 0).all()
    assert (t[0], t[-1], v.max(), v.min()) == (0.0, 10.0, 9.0, -7.0)
    assert t[np.argmax(v)] == time[31_234]


def test_decimation_leaves_short_signals_and_survives_gaps():
    time = np.linspace(0.0, 1.0, 1000)
    assert decimate(time, time, 1000)[0] is time
    values = np.where((time > 0.4) & (time < 0.6), np.nan, time)
    t, v = decimate(time, values, 100)
    assert np.isnan(v[(t > 0.45) & (t < 0.55)]).all()
    assert np.isfinite(v[t < 0.39]).all()


@pytest.mark.parametrize("points", [2000, 100])
def test_a_slow_sensor_among_fast_ones_is_a_line_and_one_that_failed_for_a_while_is_two(points):
    time = np.linspace(0.0, 1.0, 1001)
    slow = np.where(np.arange(1001) % 10 == 0, time, np.nan)
    trace = line(time, slow, "slow", "#0072B2", points=points)
    assert np.isfinite(unpacked(trace["y"])).all() and len(unpacked(trace["y"])) >= 40
    failed = np.where((time > 0.4) & (time < 0.6), np.nan, slow)
    t, v = (unpacked(line(time, failed, "failed", "#0072B2", points=points)[k]) for k in "xy")
    assert np.isnan(v).sum() == 1 and 0.4 < t[np.isnan(v)][0] < 0.6
    assert np.isfinite(v[t < 0.39]).all() and np.isfinite(v[t > 0.61]).all()
    never = line(time, np.full(1001, np.nan), "never", "#0072B2", points=points)
    assert np.isnan(unpacked(never["y"])).all()


@pytest.mark.parametrize("points", [2000, 100])
def test_a_sensor_that_turns_slower_is_one_line_and_a_pause_ends_it(points):
    """By the median of all its steps a line had ended at each of the slower samples."""
    time = np.concatenate([np.arange(0.0, 10.0, 0.01), np.arange(10.0, 40.0, 0.1)])
    fine = np.arange(0.0, 40.0, 0.01)
    turned = np.where((fine < 10.0) | (np.arange(4000) % 10 == 0), fine, np.nan)
    for x, y in ((time, time), (fine, turned)):
        v = unpacked(line(x, y, "y", "#0072B2", points=points, recorded=True)["y"])
        assert np.isfinite(v).all() and len(v) > points / 3
    paused = np.where(time > 5.0, time + 30.0, time)
    t, v = (unpacked(line(paused, time, "y", "#0072B2", points=points, recorded=True)[k]) for k in "xy")
    assert np.isnan(v).sum() == 1 and 5.0 < t[np.isnan(v)][0] < 35.01
    assert np.isfinite(unpacked(line(paused, time, "y", "#0072B2", points=points)["y"])).all()


@pytest.mark.parametrize("points", [2000, 100])
def test_a_band_ends_at_a_pause_and_keeps_the_peaks_of_both_sides(points):
    """It was filled over the pause, and its sides took every so-manieth sample, along another curve than the line's."""
    time = np.arange(0.0, 10.0, 0.005)
    wave = np.sin(2 * np.pi * 40.0 * time)
    paused = np.where(time > 5.0, time + 30.0, time)
    sides = [np.where(time < 1.0, np.nan, wave + w) for w in (-0.5, 0.5)]
    trace = band(paused, sides, "m", "#0072B2", row=1, points=points, hidden=False)
    x, y = unpacked(trace["x"]), unpacked(trace["y"])
    areas = np.split(x, np.flatnonzero(np.isnan(x)) + 1)
    assert trace["fill"] == "toself" and [len(a) > 1 for a in areas] == [True, True, False]
    assert [(np.nanmin(a), np.nanmax(a)) for a in areas[:2]] == [
        (pytest.approx(1.0), pytest.approx(5.0)),
        (pytest.approx(35.005), pytest.approx(39.995)),
    ]
    assert (np.nanmin(y), np.nanmax(y)) == pytest.approx((-1.5, 1.5), abs=0.06) and len(x) <= 2 * points + 4


def test_a_line_carries_its_numbers_as_32_bit_floats():
    trace = line(np.array([0.0, 1.0]), np.array([2.0, 3.5]), "a<b>", "#0072B2")
    assert unpacked(trace["y"]).tolist() == [2.0, 3.5]
    assert "<b>" not in trace["hovertemplate"]


def test_each_model_keeps_its_style_and_the_palette_never_repeats_one():
    names = [f"model {k}" for k in range(20)]
    look = styles(names)
    assert len(set(look.values())) == 20
    assert look["model 0"] == styles(names[:3])["model 0"]


def test_error_bars_reach_from_lowest_to_highest():
    spec = error_bars(["a", "b"], {"m": [(1.0, 0.5, -2.0, 4.0), None]}, styles(["m"]), "mm")
    reach, spread, marker = spec["data"]
    assert (marker["x"], marker["y"]) == ([0.0], [1.0])
    assert (reach["error_y"]["array"], reach["error_y"]["arrayminus"]) == ([3.0], [3.0])
    assert spread["error_y"]["array"] == [0.5]


def test_a_model_that_runs_away_does_not_set_the_error_axis():
    low, high = error_range([np.array([0.0, 0.1]), np.array([-0.1, 0.4]), np.array([0.0, 60.0])])
    assert (low, high) == pytest.approx((-0.13, 0.43))
    assert error_range([np.array([0.1]), np.array([0.4])]) is None


def page():
    figure = Figure("f", "one", {"data": [], "layout": layout("t", ["y"])}, caption="</script><b>")
    other = Figure("g", "two", {"data": [], "layout": layout("t", ["a", "b"])})
    rows = table("rows", "Rows", [texts("n", "Name", ["a|b"]), numbers("v", "Value", [1.0], "Pa", "bar")])
    parts = (rows, figure, FigureGroup("both", "Both", (figure, other)), Note(("A word.",), tone="warning"))
    return Page("Gap", "today", "Leakage.", table("headline", "", []), (Section("s", "First", parts, "Lead."),))


def test_other_rooms_compose_a_page_of_the_same_pieces():
    html, markdown, data = as_html(page()), as_markdown(page()), json.loads(as_json(page()))
    assert html.count('class="plot"') == 3
    assert "&lt;/script&gt;&lt;b&gt;" in html
    assert "| a\\|b | 1.00e−5 |" in markdown
    assert data["tables"]["rows"]["rows"] == [
        {"n": {"value": "a|b", "shown": "a|b"}, "v": {"value": 1.0, "shown": "1.00e−5"}}
    ]


def test_axes_of_stacked_plots_do_not_overlap():
    plan = layout("t", ["a", "b"], shares=(0.6, 0.4))
    assert plan["yaxis2"]["domain"][1] < plan["yaxis"]["domain"][0]
    assert plan["yaxis2"]["domain"][0] == pytest.approx(0.0)
    assert plan["xaxis"]["anchor"] == "y2"


@pytest.mark.parametrize(("low", "high"), [(0.014, 19.3), (1.0, 1.2), (0.3, 4.0), (1e-6, 1e3), (2.0, 2.0)])
def test_the_bar_of_a_heat_map_has_a_few_marks_that_lie_in_it(low, high):
    """The smallest map is a row high: marks of every decade would lie on each other."""
    bar = heat_map("a", "a", (["r"], ["x", "y"]), np.array([[low, high]]), "deg").spec["data"][0]["colorbar"]
    assert 1 <= len(bar["tickvals"]) <= 6 and len(set(bar["ticktext"])) == len(bar["ticktext"])
    assert all(np.log10(low) <= mark <= np.log10(high) for mark in bar["tickvals"])


@pytest.mark.parametrize("first", [0.0, 1e5, 1.7e9])
def test_a_curve_has_its_samples_wherever_its_clock_begins(first):
    """Seconds since 1970 in 32 bits: twelve seconds at 100 Hz had been one instant."""
    time = first + 0.01 * np.arange(1200)
    drawn = line(time, 5e6 + np.sin(time - first), "arm", "#000")
    np.testing.assert_allclose(unpacked(drawn["x"]) - first, time - first, rtol=0, atol=1e-4)
    np.testing.assert_allclose(unpacked(drawn["y"]), 5e6 + np.sin(time - first), rtol=0, atol=1e-4)
    assert drawn["x"]["dtype"] == ("f4" if first == 0.0 else "f8")
