"""Small still pictures that stand where plots will be."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from hydrotwin.comparison import compare
from hydrotwin.report import write_report
from hydrotwin.report.figure import error_bars, layout, line, styles
from hydrotwin.report.thumbnail import HIGH, POINTS, WIDE, thumbnail
from tests.comparison.toys import Toy, recording

TIME = np.linspace(0.0, 10.0, 5000)
PLAN = layout("time [s]", ["y [mm]", "error [mm]"], shares=(0.62, 0.38), height=520)


def paths(spec):
    found = ElementTree.fromstring(thumbnail(spec))
    return [(p.get("stroke"), re.findall(r"([ML])(-?\d+) (-?\d+)", p.get("d"))) for p in found]


def test_the_curves_of_the_first_axis_fill_the_picture():
    wave, other = np.sin(TIME), 2.0 + 0.0 * TIME
    data = [line(TIME, wave, "measured", "#111111"), line(TIME, other, "model", "#222222", dash="dash")]
    data += [line(TIME, wave - other, "model", "#222222", row=2), line(TIME, 9 * wave, "far", "#333333", hidden=True)]
    (dark, first), (pale, second) = paths({"data": data, "layout": PLAN})
    assert (dark, pale) == ("#111111", "#222222")
    x, y = (np.array([int(point[k]) for point in first]) for k in (1, 2))
    assert (x.min(), x.max(), y.max()) == (0, WIDE, HIGH) and y.min() == pytest.approx(HIGH / 3, abs=1)
    assert {point[2] for point in second} == {"0"} and len(first) <= POINTS


def test_it_lies_where_the_axis_will_be():
    told = thumbnail({"data": [line(TIME, TIME, "y", "#111111")], "layout": PLAN})
    assert "margin:44px 0 0 64px;width:calc(100% - 108px);height:248px" in told


def test_a_hole_breaks_the_line_and_what_has_no_lines_has_no_picture():
    holed = np.where((TIME > 4) & (TIME < 6), np.nan, TIME)
    ((_, points),) = paths({"data": [line(TIME, holed, "y", "#111111")], "layout": PLAN})
    assert [kind for kind, *_ in points].count("M") == 2
    assert not thumbnail(error_bars(["a"], {"m": [(0.0, 1.0, -1.0, 1.0)]}, styles(["m"]), "mm"))
    assert not thumbnail({"data": [line(TIME, np.nan * TIME, "y", "#111111")], "layout": PLAN})


def test_a_logarithmic_axis_is_one_here():
    spec = {"data": [line(10**TIME, 10**-TIME, "y", "#111111")], "layout": layout("f [Hz]", ["gain"])}
    for axis in ("xaxis", "yaxis"):
        spec["layout"][axis]["type"] = "log"
    ((_, points),) = paths(spec)
    assert all(int(x) / WIDE == pytest.approx(int(y) / HIGH, abs=0.02) for _, x, y in points)


def test_a_page_has_one_in_every_plot_that_it_opens_with(tmp_path):
    records = [recording(k, duration=2.0) for k in (1, 2)]
    page = write_report(compare([Toy("good")], records, modes=("free run",), repeats=0), tmp_path)["html"].read_text()
    frames = re.findall(r"<figure [^>]*>.*?</figure>", page, re.DOTALL)
    overlays = [f for f in frames if 'data-figure="arm_angle-free-run-' in f]
    assert ['class="thumb"' in f for f in overlays] == [" hidden" not in f.partition(">")[0] for f in overlays]
    assert any('class="thumb"' in f for f in overlays)
