"""The report of the gap workflow: a person who reads only the first screen knows the answer."""

from __future__ import annotations

import json
import math
from dataclasses import replace

from hydrotwin.report import gap_data, gap_page
from hydrotwin.report.gap_text import typical_remark
from hydrotwin.report.gap_words import display_units, notices, results
from tests.report.gap_discoveries import (
    DATE,
    FORCE,
    NAN,
    first_screen,
    named,
    none,
    one_of_a_class,
    output_gaps,
    two_effects,
    unknown,
    written,
)


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
    assert "74 candidates were looked at and 2 of them fitted; none is needed." in text
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
    page = gap_page(named(), command="", date=DATE)
    assert page.notices == (), "those that judge show the gap, and that it is closed"
    (lead,) = (s.lead for s in page.sections if s.id == "candidates")
    assert "on the recordings of the fit." in lead
    still = tuple(
        replace(r, outputs=tuple(replace(o, gap_closed=float("nan")) for o in r.outputs)) if r.role == "report" else r
        for r in named().recordings
    )
    (notice,) = gap_page(replace(named(), recordings=still), command="", date=DATE).notices
    assert notice.startswith("No recording confirms this")


def test_a_part_of_what_is_missing_is_told_as_that_and_not_as_turned_down():
    page = gap_page(replace(named(), verdict="unknown", reason="Leak is a part of it."), command="", date=DATE)
    assert page.title.endswith("a part of the missing effect") and page.answer == "Leak is a part of it."
    assert not any("none is named" in fact for fact in page.facts)
    bare = gap_page(replace(named(), verdict="unknown", steps=()), command="", date=DATE)
    assert bare.title.endswith("a gap without a name")


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
