"""Scores of answers whose worth is known: right, right class, wrong, abstaining, inventing."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import pytest

from benchmarks.gap import run
from benchmarks.gap.cases import Case, Made
from benchmarks.gap.score import Answer, Named, answer_of, row_of
from benchmarks.gap.tables import figures, markdown, misses

NOISE = {"position": 1e-4, "pressure_a": 2e4}


def made(kind="single", hidden=(("coulomb_friction", {"force": 100.0}),), visible=3.0, gap=5.0):
    case = Case("spool_valve", kind, tuple(n for n, _ in hidden), 5.0, "position+pressures", "drive", 101)
    return Made(case, (), (), {}, tuple(hidden), gap, visible, (gap,), NOISE)


def named(effect, site="cylinder.rod", probability=0.9, others=(), parameters=()):
    return Named(effect, site, ((effect, site), *others), probability, parameters)


def answer(*found, verdict=None, after=1.0):
    before = {name: 3 * sigma for name, sigma in NOISE.items()}
    left = {name: after * sigma for name, sigma in NOISE.items()}
    return Answer(verdict or ("named" if found else "none"), tuple(found), before, left, 10.0)


def row(*found, truth=None, **options):
    return row_of(truth or made(), answer(*found, **options), method="discover", oracle=dict(NOISE))


def test_the_right_name_is_exact_and_closes_the_gap():
    r = row(named("coulomb_friction", parameters=(("coulomb_friction.force", 104.0, 95.0, 110.0),)))
    assert r["exact"] == r["in_class"] == [True]
    assert r["gap_closed"] == pytest.approx(1.0)
    assert r["over_oracle"] == pytest.approx(1.0)
    assert r["parameters"][0]["error"] == pytest.approx(0.04)
    assert r["parameters"][0]["covered"]
    assert r["brier"] == pytest.approx(0.01)
    assert not r["confidently_wrong"] and not r["abstained"] and r["extra"] == 0


def test_a_class_that_holds_the_truth_is_right_but_not_exact():
    r = row(named("command_deadband", "current", others=(("coulomb_friction", "cylinder.rod"),)), verdict="class")
    assert r["exact"] == [False] and r["in_class"] == [True]
    assert not r["confidently_wrong"] and r["extra"] == 0


@pytest.mark.parametrize(("probability", "sure"), [(0.9, True), (0.4, False)])
def test_a_wrong_name_is_confidently_wrong_when_it_is_probable(probability, sure):
    r = row(named("dead_time", "current", probability))
    assert r["confidently_wrong"] is sure
    assert r["extra"] == 1 and r["in_class"] == [False]


def test_a_wrong_class_is_wrong_but_not_confidently():
    r = row(named("dead_time", "current", 0.9, others=(("sensor_delay", "position"),)), verdict="class")
    assert not r["confidently_wrong"] and r["in_class"] == [False]


def test_a_second_effect_that_is_not_there_counts():
    r = row(named("coulomb_friction"), named("dead_time", "current", 0.8))
    assert r["in_class"] == [True] and r["extra"] == 1 and r["confidently_wrong"]


def test_any_name_on_a_control_is_a_false_alarm():
    control = made("none", (), 0.0, 0.0)
    assert row(named("dead_time"), truth=control)["false_alarm"]
    quiet = row(truth=control)
    assert quiet["false_alarm"] is False and quiet["abstained"]


def test_what_no_catalogue_has_must_be_abstained_on():
    outside = made("out_of_library", (("external_push", {"force": 1.0}),))
    assert row(truth=outside, verdict="unknown")["abstained"]
    r = row(named("constant_load", probability=0.7), truth=outside)
    assert not r["abstained"] and r["confidently_wrong"]
    assert r["brier"] == pytest.approx(0.49)


def test_a_sensor_effect_must_be_found_at_its_sensor():
    truth = made(hidden=(("sensor_delay", {"output": "pressure_a", "seconds": 0.02}),))
    assert row(named("sensor_delay", "pressure_a"), truth=truth)["exact"] == [True]
    r = row(named("sensor_delay", "position"), truth=truth)
    assert r["exact"] == [False] and r["wrong_place"]


def test_a_slower_slide_is_a_slower_actuator():
    truth = made(hidden=(("spool_lag", {"factor": 0.5}),))
    assert row(named("actuator_lag", "current"), truth=truth)["exact"] == [True]


def test_pairs_want_both_names():
    truth = made("pairs", (("coulomb_friction", {"force": 1.0}), ("dead_time", {"seconds": 0.02})))
    both = row(named("dead_time", "current"), named("coulomb_friction"), truth=truth)
    assert both["in_class"] == [True, True]
    assert row(named("dead_time", "current"), truth=truth)["in_class"] == [False, True]


@pytest.mark.parametrize(
    ("lacking", "said", "seen", "swallowed"),
    [
        ((1.5, 3.0), ("coulomb_friction", "dead_time"), 1.0, None),
        ((1.5, 3.0), ("dead_time",), 0.0, None),
        ((), ("dead_time",), 0.0, None),
        ((1.02, 3.0), ("dead_time",), None, 1.0),
        ((1.02, 3.0), ("coulomb_friction",), None, 0.0),
        ((1.02, 3.0), ("dead_time", "null_bias"), None, 0.0),
    ],
)
def test_pairs_of_which_one_leaves_no_trace_are_told_apart(lacking, said, seen, swallowed):
    truth = made("pairs", (("coulomb_friction", {"force": 1.0}), ("dead_time", {"seconds": 0.02})))
    without = [{name: k * sigma for name, sigma in NOISE.items()} for k in lacking]
    names = [named(name, *([] if name == "coulomb_friction" else ["current"])) for name in said]
    r = row_of(truth, answer(*names), method="discover", oracle=dict(NOISE), lacking=without)
    by = {f.what: (f.value if f.cases else None) for f in figures([r])}
    assert by["pairs, each of the two seen: both named"] == seen
    assert by["pairs, one swallowed: the other named, and no more"] == swallowed
    assert by["all pairs: both named"] == float(len(said) == 2 and "null_bias" not in said)


@pytest.mark.parametrize(("left", "amiss"), [(1.01, 0.0), (1.2, 1.0), (None, 1.0)])
def test_a_name_for_what_no_catalogue_has_counts_apart_when_it_does_not_predict(left, amiss):
    truth = made("out_of_library", (("payload_change", {"factor": 2.0}),))
    after = {name: left * sigma for name, sigma in NOISE.items()} if left else None  # a method may predict nothing
    said = dataclasses.replace(answer(named("payload_error", "load.mass")), rmse_after=after)
    by = {f.what: f for f in figures([row_of(truth, said, method="discover")])}
    assert by["out-of-library, gap seen: abstains"].value == 0
    assert by["out-of-library, gap seen: named, and a gap is left that can be seen"].value == amiss


def test_a_leak_to_the_surroundings_is_not_one_to_the_tank():
    leak = made(hidden=(("external_leakage", {"cap": 1e-14}),))
    outside = named("external_leakage", "cylinder.cap", parameters=(("external_leakage.conductance", 1e-14, 0.0, 1.0),))
    assert row(outside, truth=leak)["parameters"][0]["covered"]
    assert row(named("internal_leakage", "cylinder.cap-tank.port"), truth=leak)["exact"] == [False]


def test_a_gap_that_the_base_swallowed_is_not_held_against_silence():
    before = {name: 1.005 * sigma for name, sigma in NOISE.items()}
    quiet = Answer("none", (), before, before, 5.0)
    r = row_of(made(visible=0.05), quiet, method="discover")
    assert r["seen"] is False and r["gap_closed"] is None
    assert misses([r]) == []


def test_a_base_that_could_not_follow_makes_the_gap_count():
    assert row_of(made(visible=0.05), answer(), method="discover")["seen"]


def test_the_answer_of_a_discovery_keeps_sites_members_and_what_was_weighed():
    parameter = SimpleNamespace(name="coulomb_friction.force", value=99.0, low=90.0, high=120.0)
    step = SimpleNamespace(
        effect="coulomb_friction",
        site="cylinder.rod",
        members=(("coulomb_friction", "cylinder.rod"), ("stribeck_friction", "cylinder.rod")),
        probability=0.8,
        parameters=(parameter,),
        ranked=(
            SimpleNamespace(
                label="null_bias at current", share=0.1, left=float("nan"), probability=0.0, fate="not fitted"
            ),
        ),
    )
    late = SimpleNamespace(
        effect="dead_time", site="current", members=(("dead_time", "current"),), probability=0.9, parameters=()
    )
    gaps = tuple(SimpleNamespace(output=n, rmse_before=2 * s, rmse_after=s) for n, s in NOISE.items())
    found = SimpleNamespace(
        verdict="class",
        steps=(step, late),
        outputs={"validate": gaps},
        seconds=3.0,
        reason="",
        untried=("drift at current",),
        screened=2,
        fitted=1,
        probabilities={"nothing": 0.0, "coulomb_friction at cylinder.rod + dead_time at current": 0.7},
    )
    a = answer_of(found, {"effort": "quick"})
    assert [n.effect for n in a.named] == ["coulomb_friction", "dead_time"]
    r = row_of(made(), a, method="discover")
    assert r["exact"] == [True] and r["extra"] == 1
    assert r["parameters"][0]["covered"]
    assert r["probabilities"] == found.probabilities
    assert r["notes"]["effort"] == "quick" and r["notes"]["untried"] == ["drift at current"]
    (bias,) = r["notes"]["candidates"]
    assert (bias["share"], bias["left"], bias["fate"]) == (0.1, None, "not fitted")


FRICTION, LATE = "coulomb_friction at cylinder.rod", "dead_time at current"
TOLD = {"nothing": 0.05, FRICTION: 0.6, f"{FRICTION} + {LATE}": 0.2, LATE: 0.05, "something else": 0.1}


@pytest.mark.parametrize(
    ("truth", "left", "probability"),
    [
        (made(), 3.0, 0.6),
        (made(), 1.005, 0.65),  # the base swallowed it: nothing is right, too
        (made("pairs", (("dead_time", {"seconds": 0.02}), ("coulomb_friction", {"force": 1.0}))), 3.0, 0.2),
        (made("none", (), 0.0, 0.0), 3.0, 0.05),
        (made("out_of_library", (("external_push", {"force": 1.0}),)), 3.0, 0.1),
        (made(hidden=(("null_bias", {"value": 1.0}),)), 3.0, 0.0),
    ],
)
def test_what_is_hidden_has_the_probability_of_its_own_structure_and_of_no_other(truth, left, probability):
    before = {name: left * sigma for name, sigma in NOISE.items()}
    said = dataclasses.replace(answer(), rmse_before=before, probabilities=TOLD)
    assert row_of(truth, said, method="discover")["of_truth"] == pytest.approx(probability)


def test_the_log_loss_is_of_those_that_state_probabilities():
    stating = [row_of(made(), dataclasses.replace(answer(), probabilities=TOLD), method="discover")]
    by = {f.what: f for f in figures([*stating, row()])}
    assert by["log loss of what is hidden, nats"].value == pytest.approx(0.511, abs=1e-3)
    assert by["log loss of what is hidden, nats"].cases == 1


def test_the_table_counts_what_the_rows_say():
    rows = [row(named("coulomb_friction")) for _ in range(19)] + [row(named("dead_time", "current"))]
    rows += [row(truth=made("none", (), 0.0, 0.0)) for _ in range(4)]
    by = {f.what: f for f in figures(rows)}
    assert by["single, gap seen: exact or right class"].value == pytest.approx(0.95)
    assert by["single, gap seen: exact or right class"].met
    assert by["false alarm on `none`"].value == 0
    assert by["confidently wrong"].value == pytest.approx(1 / 24)
    assert by["confidently wrong"].met is False
    pairs = by["pairs, each of the two seen: both named"]
    assert pairs.cases == 0 and pairs.met is None
    text = markdown([*rows, {"case": "a/b", "method": "discover", "unreachable": "too small"}])
    assert "| 20 |" in text and "1 misses" in text and "a/b: too small" in text
    json.dumps(rows, allow_nan=False)


def test_finished_rows_are_not_run_again_and_a_cut_off_line_is_passed_over(tmp_path):
    path = tmp_path / "rows.jsonl"
    path.write_text('{"case": "x", "method": "discover", "verdict": "none"}\n{"case": "y", "meth', encoding="utf-8")
    assert [r["case"] for r in run.read_rows(path)] == ["x"]


def test_the_command_line_lists_the_cases_it_would_run(tmp_path, capsys):
    wanted = ["--list", "--seeds", "fresh", "--machine", "cehA", "--kinds", "none", "--limit", "5"]
    assert run.main([*wanted, "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.split()
    assert len(lines) == 5
    assert all(Case.from_name(line).seed > 200 for line in lines)


def test_a_search_is_given_an_effort_and_a_limit():
    given = run._options(["--effort", "quick", "--time-limit", "20"])
    assert (given.effort, given.time_limit) == ("quick", 20.0)
    assert run._options([]).time_limit == run.LIMIT


def test_a_case_that_cannot_be_made_is_a_row_with_its_reason():
    name = "spool_valve/single/payload_error/30/position/drive/101/4s"
    (found,) = run.rows_of(name, ["discover"], False)
    assert found["case"] == name and "largest plausible" in found["unreachable"]
