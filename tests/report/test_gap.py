"""The report of the gap workflow: the first screen tells the answer, gap.json keeps its contract."""

from __future__ import annotations

import doctest
import json
import math
import re
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from hydrotwin.discovery.discovery import OutputGap, Rung
from hydrotwin.discovery.words import percent, placed
from hydrotwin.report import gap_data, gap_page, gap_text, write_gap_report
from hydrotwin.report.gap import _title
from hydrotwin.report.gap_figures import overlay_groups, region_groups, shift_figure, waterfall_figure
from hydrotwin.report.gap_tables import candidate_tables
from hydrotwin.report.gap_text import interval_words, typical_remark, value_text
from hydrotwin.report.gap_words import display_units, notices, results
from tests.report.gap_discoveries import (
    ALL,
    CONDUCTANCE,
    DELAY,
    FORCE,
    NAN,
    discovery,
    named,
    none,
    one_of_a_class,
    output_gaps,
    overlay,
    two_effects,
    unknown,
)
from tests.report.test_pieces import unpacked

DATE = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
CONTRACT = {"model", "verdict", "steps", "noise", "train", "validate", "separating_experiment", "seconds"}
STEP = {"effect", "site", "class", "probability", "parameters", "gap_closed"}


def written(found, folder):
    return write_gap_report(found, folder, command="hydrotwin gap cehA run_1.csv", date=DATE)


def first_screen(found):
    """What stands above the first section, as text."""
    page = gap_page(found, command="", date=DATE)
    return "\n".join((page.title, page.answer, *page.results, *page.facts, *page.notices))


def headline(found):
    return {row[0].text: [c.text for c in row[1:]] for row in gap_page(found, command="", date=DATE).headline.rows}


def test_an_output_of_which_a_run_diverges_is_shown_as_such(tmp_path):
    first = named().outputs["validate"][0]
    for after in (first.rmse_after, math.inf):
        worst = replace(first, rmse_before=math.inf, rmse_after=after, gap_closed=NAN)
        found = replace(named(), outputs={**named().outputs, "validate": (worst, *named().outputs["validate"][1:])})
        assert headline(found)[first.output][0] == "∞"
        told = json.loads(written(found, tmp_path)["json"].read_text(encoding="utf-8"))
        assert first.output in str(told["validate"])


def test_a_named_effect_is_told_with_place_equation_value_interval_and_certainty():
    text = first_screen(named())
    assert "Coulomb friction at cylinder.rod: F = Fc sign(v)" in text
    assert "force = 1234\u00a0N (95\u00a0%: 1205 to 1263)" in text
    assert "Probability 98\u00a0%." in text


def test_a_named_effect_is_told_with_what_it_closes_on_unseen_recordings_and_what_is_left():
    text = first_screen(named())
    assert "On recordings never used for fitting it closes over 99.9\u00a0% of the gap of arm_angle" in text
    assert "(RMSE 0.756° to 0.00705°)" in text
    assert "pressure_cap (RMSE 2.88 bar to 0.08" in text
    assert "What is left: 1.1 times the noise on arm_angle; 2 other outputs are at the noise." in text
    assert headline(named())["motor_speed"][-2] == "no gap"


def test_what_is_left_over_a_far_finer_sensor_is_told_in_its_unit():
    first, *others = named().outputs["validate"]
    fine = replace(named(), outputs={"validate": (replace(first, noise=1e-5 * first.rmse_after), *others)})
    text = first_screen(fine)
    assert "What is left: 0.00705° on arm_angle, whose sensor is far finer; 2 other outputs are at" in text


def test_without_recordings_held_back_nothing_claims_to_be_unseen():
    seen = replace(named(), outputs={"train": named().outputs["train"]})
    text = first_screen(seen)
    assert "On the recordings of the fit (none were held back)" in text
    assert "never used for fitting" not in text
    assert "none were held back" in gap_page(seen, command="", date=DATE).headline.note


def test_a_class_names_every_member_and_the_experiment_that_would_tell():
    text = first_screen(one_of_a_class())
    assert "Either internal leakage at cylinder.cap-cylinder.annulus, probability 62\u00a0%: q = G (p_A - p_B)" in text
    assert "Or slip of the pump at pump, probability 36\u00a0%: q = G dp / (1 + w/w0), with conductance" in text
    assert "conductance = 7.50\u00a0mL/(min·bar) (95\u00a0%: 6.91 to 8.09)" in text
    assert "These recordings cannot tell them apart. The experiment that would tell: hold the arm" in text
    assert text.count("times the noise (now 0.8)") == 1


def test_a_large_class_leaves_the_first_screen_readable():
    found = one_of_a_class()
    (step,) = found.steps
    many = (*step.members, *(("external_leakage", f"line_{k}.port") for k in range(20)))
    told = results(replace(found, steps=(replace(step, members=many),)))
    assert len(told) == 4
    assert told[-1] == "Or one of 19 others, listed below."


def test_a_class_without_an_experiment_says_so():
    assert "No input within the limits was found" in first_screen(replace(one_of_a_class(), experiment=None))


def test_one_effect_at_two_possible_places_is_told_as_either_or():
    (step,) = named().steps
    twice = replace(step, members=((step.effect, step.site), (step.effect, "arm.joint")))
    told = results(replace(named(), steps=(twice,)))
    assert told[0].startswith("Either Coulomb friction at cylinder.rod, probability 98\u00a0%: F = Fc sign(v)")
    assert told[1] == "Or coulomb_friction at arm.joint."


def test_no_gap_is_told_plainly_and_promises_no_more_than_the_recordings_can_hold():
    text = first_screen(none())
    assert "No effect is missing: the model agrees with the recordings to within the noise of the sensors." in text
    assert "at most 1.01 times it, on arm_angle" in text
    assert "74 candidates were screened and 2 of them fitted; none is needed." in text
    assert "These recordings cannot judge entrained air at cylinder.cap" in text
    assert "closes" not in text


def test_an_unknown_gap_is_placed_and_gets_no_name():
    text = first_screen(unknown())
    assert "a gap without a name" in text
    assert "it gets no physical name" in text
    assert "arm_angle is 102 noise off where cylinder.rod.v < -0.01 m/s. It follows command (correlation −0.83" in text
    assert "grows with the fifth power of the velocity" in text
    assert "The nearest, internal leakage at cylinder.cap-cylinder.annulus, was turned down" in text
    assert "120 times the noise on arm_angle" in text


def test_findings_start_like_sentences_and_keep_the_names_of_quantities():
    found = replace(unknown(), findings=("gap: no validation recording", "gap: motor.gain and pump.c are one"))
    (note,) = next(s for s in gap_page(found, command="", date=DATE).sections if s.id == "findings").parts
    assert note.paragraphs == ("No validation recording.", "motor.gain and pump.c are one.")


def test_an_unknown_rest_beside_a_named_effect_keeps_the_name():
    rest = replace(two_effects(), verdict="unknown", unknown=unknown().unknown)
    text = first_screen(rest)
    assert "Something is missing beyond Coulomb friction at cylinder.rod and internal leakage" in text
    assert "1. Coulomb friction at cylinder.rod: F = Fc sign(v)" in text


def test_the_sentence_of_the_discovery_is_the_answer():
    assert gap_page(replace(named(), reason="Friction.")).answer == "Friction."
    assert gap_data(replace(named(), reason="Friction."))["answer"] == "Friction."


def test_a_recording_that_gets_worse_a_wild_value_and_a_bound_are_notices():
    worse, wild, bound = gap_page(two_effects(), command="", date=DATE).notices
    assert worse.startswith("slow_5 (never used) got worse on arm_angle (RMSE 0.126° to 0.378°) and pressure_cap")
    assert "leak.conductance = 1800\u00a0mL/(min·bar) is above its typical range (0.0600 to 60.0)" in wild
    assert bound.startswith("cylinder.cap_dead_volume rests on its bound")
    assert gap_page(named(), command="", date=DATE).notices == ()


def test_an_answer_that_no_recording_confirms_says_so_on_the_first_screen():
    roles = {"select": "fit"}
    fitted = tuple(replace(r, role=roles.get(r.role, r.role)) for r in named().recordings)
    page = gap_page(replace(named(), recordings=fitted), command="", date=DATE)
    assert page.notices == (), "those that judge show the gap, and that it is closed"
    (lead,) = (s.lead for s in page.sections if s.id == "candidates")
    assert "for choosing" not in lead and "the same, all there are" in lead
    still = tuple(
        replace(r, outputs=tuple(replace(o, gap_closed=float("nan")) for o in r.outputs)) if r.role == "report" else r
        for r in fitted
    )
    (notice,) = gap_page(replace(named(), recordings=still), command="", date=DATE).notices
    assert notice.startswith("No recording confirms this")
    chosen = tuple(replace(r, role="select") if r.record == "run_3" else r for r in still)
    assert gap_page(replace(named(), recordings=chosen), command="", date=DATE).notices == ()


def test_the_typical_range_of_a_size_with_a_sign_is_that_of_the_size():
    against = replace(FORCE, value=-36.0, low=-38.0, high=-33.0, typical=(1.0, 2000.0))
    assert typical_remark(against) == ""
    assert typical_remark(replace(against, typical=(1.0, 20.0))) == "above its typical range"
    assert typical_remark(replace(against, typical=(100.0, 200.0))) == "below its typical range"


def test_many_warnings_leave_the_first_screen_readable():
    found = two_effects()
    ruined = tuple(replace(r, outputs=output_gaps(0.2, 0.6)) for r in found.recordings)
    told = notices(replace(found, recordings=ruined), display_units(found))
    assert len(told) == 4
    assert told[-1] == "4 more warnings are marked in the tables below."


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
    assert (dropped["bic_gain"], dropped["fate"], dropped["step"]) == (None, "not refitted", 1)
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
        *("where", "candidates", "effects", "plots", "waterfall", "shifts", "apart", "recordings"),
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
        *(("never used", "run_4"), ("never used", "slow_5"), ("for choosing", "run_3")),
    ]
    measured, _, after, _, error, _ = group.figures[0].spec["data"]
    gap = np.asarray(unpacked(error["y"]))
    assert after["name"] == "after"
    assert np.std(gap) == pytest.approx(np.degrees(1.1e-4), rel=0.3)
    assert len(unpacked(measured["x"])) <= 2000


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
    assert rows["Coulomb friction"][1:8] == [
        *("cylinder.rod", "83\u00a0%", "5210", "14", "99\u00a0%", "98\u00a0%", "named"),
    ]
    assert rows["Stribeck friction"][-1] == "Refines Coulomb friction by 4 BIC: not worth its name."
    assert rest.folded
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
    (bound,) = [row for row in section.parts[0].rows if row[0].text == "cylinder.cap_dead_volume"]
    assert [c.text for c in bound if c.tone == "warning"] == ["at bound"]


def test_a_recording_that_got_worse_is_marked_in_its_table():
    page = gap_page(two_effects(), command="", date=DATE)
    table = next(t for t in page.tables if t.id == "recordings_arm_angle")
    marked = [row[0].text for row in table.rows if row[3].tone == "warning"]
    assert marked == ["slow_5"]
    assert [row[1].text for row in table.rows] == ["never used"] * 2 + ["for choosing"] + ["fitted"] * 2


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
        timings={},
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
