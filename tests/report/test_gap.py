"""The report of the gap workflow: gap.json keeps its contract, every section its figures and tables."""

from __future__ import annotations

import doctest
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from hydrotwin.discovery.answer.discovery import OutputGap, Rung
from hydrotwin.discovery.answer.words import percent, placed
from hydrotwin.report import Table, gap_data, gap_page, gap_text
from hydrotwin.report.gap import _title
from hydrotwin.report.gap_figures import overlay_groups, picture, region_groups, shift_figure, waterfall_figure
from hydrotwin.report.gap_tables import candidate_tables
from hydrotwin.report.gap_text import interval_words, value_text
from hydrotwin.report.gap_words import display_units
from tests.report.gap_discoveries import (
    ALL,
    CONDUCTANCE,
    DATE,
    DELAY,
    FORCE,
    NAN,
    discovery,
    first_screen,
    named,
    one_of_a_class,
    overlay,
    two_effects,
    unknown,
    written,
)
from tests.report.test_pieces import unpacked

CONTRACT = {"model", "verdict", "steps", "noise", "train", "validate", "separating_experiment", "seconds"}
CONTRACT |= {"probabilities", "untried"}
STEP = {"effect", "site", "class", "probability", "parameters", "gap_closed"}


@pytest.mark.parametrize("case", ALL)
def test_gap_json_keeps_its_contract(case, tmp_path):
    paths = written(ALL[case](), tmp_path)
    assert {p.name for p in paths.values()} == {"report.html", "report.md", "gap.json"}
    data = json.loads(paths["json"].read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert data.keys() >= CONTRACT
    assert data["verdict"] in ("named", "class", "none", "unknown")
    for step in data["steps"]:
        assert step.keys() >= STEP
        assert step["effect"] in step["class"]
        assert all(p.keys() >= {"value", "unit", "sigma"} for p in step["parameters"].values())
    for role in ("train", "validate"):
        assert data[role].keys() == data["noise"].keys()
        assert all(o.keys() >= {"rmse_before", "rmse_after", "gap_closed"} for o in data[role].values())
    assert gap_data(ALL[case]()) == {k: data[k] for k in gap_data(ALL[case]())}


def test_gap_json_is_in_si_at_full_precision():
    data = gap_data(one_of_a_class())
    (step,) = data["steps"]
    assert step["class"] == ["internal_leakage", "pump_slip"]
    assert step["members"][1] == {"effect": "pump_slip", "site": "pump"}
    assert step["parameters"]["leak.conductance"]["value"] == 1.2e-12
    assert step["parameters"]["leak.conductance"]["sigma"] == 3e-14
    assert data["validate"]["arm_angle"]["rmse_before"] == one_of_a_class().outputs["validate"][0].rmse_before
    assert data["separating_experiment"]["input"] == "command"
    assert len(data["separating_experiment"]["values"]) == 1501
    assert gap_data(named())["separating_experiment"] is None


def test_what_does_not_exist_is_null_in_gap_json():
    data = gap_data(named())
    assert data["validate"]["motor_speed"]["gap_closed"] is None
    (dropped,) = [c for c in data["candidates"] if c["effect"] == "backlash"]
    assert (dropped["share"], dropped["left"], dropped["gap_closed"]) == (None, None, None)
    assert (dropped["fate"], dropped["step"]) == ("not fitted", 1)
    assert not {"bic_gain", "paired_t"} & dropped.keys()
    json.dumps(data, allow_nan=False)


@pytest.mark.parametrize("case", ALL)
def test_markdown_holds_the_first_screen_and_every_table(case, tmp_path):
    page = gap_page(ALL[case](), command="", date=DATE)
    text = written(ALL[case](), tmp_path)["markdown"].read_text(encoding="utf-8")
    for told in (page.answer, *page.results, *page.facts, *page.notices):
        assert told in text
    for section in page.sections:
        assert f"## {section.title}" in text
    assert text.count("|:---") + text.count("|---:") >= len(list(page.tables))


@pytest.mark.parametrize("case", ALL)
def test_the_page_needs_nothing_from_elsewhere_and_stays_small(case, tmp_path):
    html = written(ALL[case](), tmp_path)["html"].read_text(encoding="utf-8")
    own = re.sub(r"<script>.*?</script>", "", html, flags=re.DOTALL)
    assert not re.search(r"""(src|href)=["']https?:""", own)
    assert len(own) < 3e6


def test_sections_of_a_named_effect_come_in_the_order_of_the_work():
    ids = [s.id for s in gap_page(named(), command="", date=DATE).sections]
    assert ids == [
        *("where", "candidates", "effects", "sure", "plots", "waterfall", "shifts", "apart", "recordings"),
        *("not-testable", "noise", "provenance"),
    ]
    assert {"unknown", "findings"} <= {s.id for s in gap_page(unknown(), command="", date=DATE).sections}


def test_residual_maps_show_before_and_after_in_shown_units_and_mark_what_differs():
    found = named()
    (angle, pressure) = region_groups(found, display_units(found))
    assert [f.label for f in angle.figures] == ["cylinder.rod.v", "command", "time"]
    spec = angle.figures[0].spec
    before, after = (t for t in spec["data"] if t.get("error_y"))
    assert before["y"] == pytest.approx(np.degrees(found.regions[0].mean_before))
    assert spec["layout"]["xaxis"]["title"]["text"] == "cylinder.rod.v [mm/s]"
    assert "#ffffff" not in before["marker"]["color"]
    assert set(after["marker"]["color"]) == {"#ffffff"}
    assert angle.figures[0].caption == "12 of 12 bins differ from zero before, 0 after."
    assert pressure.title == "pressure_cap"


def test_empty_bins_of_a_residual_map_leave_a_hole():
    found = named()
    hollow = replace(found.regions[0], mean_before=np.where(np.arange(12) == 3, np.nan, 1e-3))
    spec = region_groups(replace(found, regions=(hollow,)), display_units(found))[0].figures[0].spec
    assert spec["data"][1]["text"][3] == ""
    assert math.isnan(spec["data"][1]["y"][3])


def test_nothing_is_drawn_twice_when_nothing_was_added():
    found = unknown()
    shown = display_units(found)
    maps = region_groups(found, shown)[0].figures[0].spec["data"]
    assert {t["name"] for t in maps if "name" in t} == {"base model"}
    names = [t["name"] for t in overlay_groups(found, shown)[0].figures[0].spec["data"]]
    assert names == ["measured", "base model", "base model", "command"]


def test_overlays_put_unseen_recordings_first_and_the_error_below():
    found = named()
    group = overlay_groups(found, display_units(found))[0]
    assert [(f.row, f.label) for f in group.figures] == [
        *(("never used", "run_4"), ("never used", "slow_5")),
    ]
    measured, _, after, _, error, _ = group.figures[0].spec["data"]
    gap = np.asarray(unpacked(error["y"]))
    assert after["name"] == "after"
    assert np.std(gap) == pytest.approx(np.degrees(1.1e-4), rel=0.3)
    assert len(unpacked(measured["x"])) <= 2000


def test_the_picture_comes_right_after_the_answer_and_shows_the_largest_gap_of_an_unseen_recording(tmp_path):
    found = named()
    larger = replace(found.overlays[1], before={n: 2.0 * v for n, v in found.overlays[1].before.items()})
    fitted = replace(larger, record="run_1", role="fit", before={n: 3.0 * v for n, v in larger.before.items()})
    found = replace(found, overlays=(fitted, found.overlays[0], larger))
    shown = picture(found, display_units(found))
    assert shown.caption.startswith(f"arm_angle of {larger.record} (never used), where the gap shows most.")
    assert [t["name"] for t in shown.spec["data"][:3]] == ["measured", "before", "after"]
    html = written(found, tmp_path)["html"].read_text(encoding="utf-8")
    order = ['class="answer"', 'data-figure="picture"', 'class="result"', 'id="table-headline"']
    places = [html.index(mark) for mark in order]
    assert places == sorted(places)


def test_where_unseen_recordings_show_no_gap_the_picture_is_of_one_that_does():
    found = named()
    quiet = tuple(replace(o, before=o.measured) for o in found.overlays)
    loud = replace(found.overlays[0], record="run_1", role="fit")
    shown = picture(replace(found, overlays=(*quiet, loud)), display_units(found))
    assert " of run_1 (fitted)" in shown.caption
    assert picture(replace(found, overlays=()), {}) is None


def test_many_long_recordings_keep_the_page_small():
    overlays = tuple(overlay(f"run_{k}", "report", k) for k in range(40))
    found = replace(named(), overlays=overlays)
    groups = overlay_groups(found, display_units(found))
    size = sum(len(json.dumps(f.spec)) for g in groups for f in g.figures)
    assert size < 3e6
    plots = next(s for s in gap_page(found, command="", date=DATE).sections if s.id == "plots")
    assert re.search(r"\b3\d of 40 recordings are drawn", plots.lead)


def test_candidates_are_ranked_with_evidence_fate_and_reason():
    first, rest = candidate_tables(named().steps[0].ranked, "candidates_1", "First look")
    rows = {row[0].text: [c.text for c in row] for row in first.rows}
    assert [c.title for c in first.columns][2:5] == ["Promise", "Left", "Gap closed"]
    assert rows["Coulomb friction"][1:7] == [
        *("cylinder.rod", "83\u00a0%", "12.4", "99\u00a0%", "98\u00a0%", "named"),
    ]
    assert rows["Stribeck friction"][-1] == "Leaves more than what is told, or no less for more parameters."
    assert "0: nothing but noise is left" in first.note
    assert rest.folded and not rest.note
    assert [row[2].text for row in rest.rows if row[0].text == "Play"] == ["–"], "where nobody looked"
    assert len(rest.rows) == 3


def test_the_waterfall_falls_from_the_base_model_to_what_is_left():
    bars, noise = waterfall_figure(two_effects()).spec["data"]
    assert bars["text"] == ["68", "−56", "−9.4", "2.6"]
    tops = [b + s for b, s in zip(bars["base"], bars["y"], strict=True)]
    assert tops == pytest.approx([68.0, 68.0, 12.0, 2.6])
    assert noise["y"] == [1, 1]


def test_moves_are_told_in_sigmas_of_the_difference_and_bounds_are_marked():
    spec = shift_figure(two_effects().shifts).spec
    (moved,) = spec["data"]
    lag = moved["x"][moved["y"].index("motor.lag")]
    assert lag == pytest.approx((0.0304 - 0.051) / math.hypot(0.002, 0.0002))
    section = next(s for s in gap_page(two_effects(), command="", date=DATE).sections if s.id == "shifts")
    shifts = next(part for part in section.parts if isinstance(part, Table))
    (bound,) = [row for row in shifts.rows if row[0].text == "cylinder.cap_dead_volume"]
    assert [c.text for c in bound if c.tone == "warning"] == ["at bound"]


def test_a_recording_that_got_worse_is_marked_in_its_table():
    page = gap_page(two_effects(), command="", date=DATE)
    table = next(t for t in page.tables if t.id == "recordings_arm_angle")
    marked = [row[0].text for row in table.rows if row[3].tone == "warning"]
    assert marked == ["slow_5"]
    assert [row[1].text for row in table.rows] == ["never used"] * 2 + ["fitted"] * 3


def test_intervals_get_the_digits_that_they_give_sense_to():
    assert value_text(FORCE) + interval_words(FORCE) == "1234\u00a0N (95\u00a0%: 1205 to 1263)"
    assert value_text(CONDUCTANCE) == "7.20\u00a0mL/(min·bar)"
    assert value_text(DELAY) == "31.0\u00a0ms"
    sharp = replace(DELAY, sigma=1e-6, low=0.031 - 2e-6, high=0.031 + 2e-6)
    assert value_text(sharp) == "31.0000\u00a0ms"
    assert interval_words(replace(DELAY, low=NAN, high=NAN)) == " (interval not known)"
    assert interval_words(replace(DELAY, low=NAN, high=NAN, at_bound=True)) == " (on its limit)"


def test_shares_are_never_rounded_up_to_all():
    assert doctest.testmod(gap_text).attempted >= 1
    assert percent(0.99996) == "over 99.9\u00a0%"
    assert percent(-0.3) == "−30\u00a0%"
    assert percent(1e-6) == "under 1\u00a0%"


def test_a_bare_answer_is_still_a_report(tmp_path):
    bare = discovery(
        "none",
        outputs={},
        recordings=(),
        noise={},
        overlays=(),
        not_testable=(),
        provenance={},
        fit_before=None,
        fit_after=None,
    )
    paths = written(bare, tmp_path)
    assert "No effect is missing" in paths["markdown"].read_text(encoding="utf-8")
    assert json.loads(paths["json"].read_text(encoding="utf-8"))["train"] == {}


def test_what_is_not_known_leaves_a_dash_and_no_error(tmp_path):
    found = named()
    (step,) = found.steps
    lost = replace(FORCE, value=NAN, sigma=NAN, low=NAN, high=NAN)
    silent = [replace(o, measured=dict.fromkeys(o.measured, np.full(len(o.time), NAN))) for o in found.overlays]
    blind = OutputGap("arm_angle", "rad", 0.0, NAN, NAN, NAN)
    flat = (Rung("base model", 1.0), Rung("Coulomb friction", 1.0))
    found = replace(
        found,
        steps=(replace(step, parameters=(lost,), probability=NAN),),
        overlays=tuple(silent),
        outputs={"validate": (blind,)},
        waterfall=flat,
    )
    text = written(found, tmp_path)["markdown"].read_text(encoding="utf-8")
    assert "with force = –\u00a0N (interval not known). Probability –." in text
    assert "| arm_angle | – | – | ° | no gap | – |" in text


def test_many_outputs_are_told_by_their_range():
    rows = tuple(OutputGap(f"y{k}", "N", 1.0, 10.0, 2.0 + k, 1 - ((2.0 + k) ** 2 - 1) / 99) for k in range(5))
    text = first_screen(replace(named(), outputs={"validate": rows}))
    assert "97\u00a0% of the gap of y0 (RMSE 10.0 N to 2.00 N) and " in text
    assert "and from 65\u00a0% (y4) to 92\u00a0% (y1) of those of the 4 others" in text


def test_a_table_of_candidates_says_what_was_in_place_when_they_were_looked_for():
    found = two_effects()
    first, second = found.steps
    one, other = ((s.effect, s.site) for s in found.steps)

    def titles(*steps):
        shown = replace(found, steps=steps)
        return [_title(shown, k, s) for k, s in enumerate(steps, 1)]

    assert titles(first, replace(second, beside=(one,))) == ["First look", f"Look 2: after {placed(first)}"]
    again = titles(replace(first, beside=(other,)), replace(second, beside=(one,)))
    assert again == [f"Look 1, again: beside {placed(second)}", f"Look 2: after {placed(first)}"]
