"""Criteria that name no output: the worst of every compared output counts, and is named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import hydrotwin
from hydrotwin.comparison import (
    Wanted,
    acceptance,
    as_contender,
    compare,
    criteria_of,
    judge,
    junit,
    record_comparison,
    worst,
)  # fmt: skip
from hydrotwin.comparison.asked import Asked, check_wanted
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.model_file import write_model_file
from hydrotwin.records import Record
from hydrotwin.report import write_report
from hydrotwin.report.acceptance import acceptance_lines, verdict
from tests.comparison.toys import ANGLE, PRESSURE, UNITS, Toy, recording

SHIPPED = Path(__file__).resolve().parents[2] / "examples"
GOOD, BAD, ARM = Toy("good", gain=121.0), Toy("bad", gain=135.0), Toy("arm", outputs=(ANGLE,), gain=135.0)
FIRST, SECOND = recording(1), recording(2)


@pytest.fixture(scope="module")
def comparison():
    return compare([GOOD, BAD, ARM], [FIRST, SECOND], modes=["free run"], repeats=0)


def judged(comparison, text, model="good"):
    (one,) = acceptance(comparison, Wanted((text,), model)).judged
    return one


def of_outputs(comparison, what, model="good"):
    return {s.output: getattr(s, what) for s in comparison.means if s.model == model}


@pytest.mark.parametrize(("share", "passed"), [(90, True), (99.99, False)])
def test_the_worst_output_counts_and_is_named(comparison, share, passed):
    fits = of_outputs(comparison, "fit_percent")
    worst = min(fits, key=fits.get)
    one = judged(comparison, f"fit > {share} %")
    assert (one.passed, one.criterion.output, set(one.among)) == (passed, worst, set(fits))
    assert one.value == pytest.approx(fits[worst] / 100) and one.criterion.overall
    each = [judged(comparison, f"{name}.fit > {share} %") for name in fits]
    assert one.passed == all(e.passed for e in each) and one.margin == min(e.margin for e in each)


@pytest.mark.parametrize("group", ["", f"{FIRST.name}: "])
def test_not_worse_than_another_is_about_every_output_where_none_is_named(comparison, group):
    bare, said = (judged(comparison, f"{group}{metric}not worse than bad by 3 %") for metric in ("", "rmse "))
    assert (bare.passed, bare.value, bare.high, bare.among) == (said.passed, said.value, said.high, said.among)
    assert bare.passed and bare.criterion.overall and bare.criterion.group == said.criterion.group
    assert not judged(comparison, f"{group}not worse than good", "bad").passed


def test_a_group_is_judged_by_its_own_worst_output(comparison):
    fits = {s.output: s.fit_percent for s in comparison.scores if (s.record, s.model) == (FIRST.name, "bad")}
    one = judged(comparison, f"{FIRST.name}: fit > 10 %", "bad")
    assert one.value == pytest.approx(min(fits.values()) / 100) and one.criterion.group == FIRST.name


def test_one_bound_on_outputs_in_different_units_is_refused_with_what_to_write(comparison):
    with pytest.raises(DeclarationError, match=r"no one bound fits all.*arm_angle in deg.*pressure_cap in bar") as told:
        judged(comparison, "rmse < 2 bar")
    assert "arm_angle.rmse" in str(told.value) and "nrmse" in str(told.value)
    with pytest.raises(DeclarationError, match="no one bound fits all"):
        check_wanted(Wanted(("max < 2 bar",)), Asked.of(comparison))


def test_outputs_that_share_a_unit_take_one_bound_in_it():
    signals = (Signal("p_a", "Pa"), Signal("p_b", "Pa"))
    found = criteria_of("rmse < 2 bar", signals)
    assert [(one.output, one.high, one.overall) for one in found] == [("p_a", 2e5, True), ("p_b", 2e5, True)]


def test_not_worse_than_another_goes_by_ratios_whatever_the_units(comparison):
    good, bad = of_outputs(comparison, "rmse"), of_outputs(comparison, "rmse", "bad")
    ratios = {name: bad[name] / good[name] for name in good}
    one = judged(comparison, "rmse not worse than good", "bad")
    assert not one.passed and one.criterion.output == max(ratios, key=ratios.get)
    assert judged(comparison, "rmse not worse than bad", "good").passed


def test_outputs_that_the_model_does_not_give_are_told_and_those_of_the_other_model_too(comparison):
    one = judged(comparison, "fit > 10 %", "arm")
    assert one.among == ("arm_angle",) and "not judged on motor_speed, pressure_cap, which arm does not" in one.caution
    one = judged(comparison, "rmse not worse than arm", "good")
    assert one.among == ("arm_angle",) and "which arm does not give" in one.caution


def test_an_output_that_one_recording_lacks_is_told_though_another_is_the_worst():
    lacking = Record(SECOND.time, {n: SECOND[n] for n in SECOND if n != "arm_angle"},
                     {n: u for n, u in UNITS.items() if n != "arm_angle"}, SECOND.name)  # fmt: skip
    toy = NoStart("toy", outputs=(ANGLE, PRESSURE), stiffness=1e6)
    found = compare([toy], [FIRST, lacking], modes=["free run"], repeats=0)
    one = judged(found, "fit > 1 %", "toy")
    assert one.criterion.output == "pressure_cap" and f"of arm_angle: not judged on {SECOND.name}" in one.caution


class NoStart(Toy):
    """A toy that does not need the angle to start."""

    def free_run(self, record):
        angle = record["arm_angle"] if "arm_angle" in record else np.full(len(record), 0.4)
        return super().free_run(Record(record.time, {**record.signals, "arm_angle": angle}, UNITS, record.name))


def test_a_metric_that_one_output_has_not_fails_and_says_of_which():
    still = FIRST.with_signals({"arm_angle": np.full(len(FIRST), 0.4)})
    one = judged(compare([GOOD], [still], modes=["free run"], repeats=0), "fit > 90 %")
    assert not one.passed and one.criterion.output == "arm_angle" and "does not move" in one.undefined


def test_page_screen_json_and_junit_name_the_worst(comparison, tmp_path):
    found = acceptance(comparison, Wanted(("fit > 99.99 %",), "bad"))
    worst = found.judged[0].criterion.output
    says = f"{worst}, the worst of 3 outputs"
    assert says in verdict(found)[0] and any(says in line for _, line in acceptance_lines(found, {}))
    (case,) = ElementTree.fromstring(junit(found, "toys")).iter("failure")
    assert says in case.text
    paths = write_report(comparison, tmp_path, accepted=found)
    (row,) = json.loads((tmp_path / "compare.json").read_text())["acceptance"]["criteria"]
    assert (row["output"], row["overall"], len(row["among"])) == (worst, True, 3)
    assert all(says in Path(paths[kind]).read_text() for kind in ("html", "markdown"))


def test_the_record_of_a_model_file_names_the_worst(tmp_path):
    model = hydrotwin.load("cehA")
    write_model_file(tmp_path / "model.toml", "cehA", model.flat, {})
    record = hydrotwin.read_record(SHIPPED / "cehA" / "recordings" / "validate_1.csv").window(end=4.0)
    found = compare([as_contender(model, "m")], [record], modes=["free run"], repeats=0)
    told = record_comparison(tmp_path / "model.toml", found, acceptance(found, Wanted(("fit > 99.99 %",), "m")), "m")
    (row,) = told.evidence[-1].criteria
    assert row["worst"] in {s.name for s in model.flat.outputs} and f"({row['worst']}, " in told.evidence[-1].told


def test_the_band_of_an_output_that_is_not_the_worst_is_doubted_by_its_name():
    """With a slope as the worst of its outputs, PASS had come without a word of bands that cannot be trusted."""
    signals = [Signal(n, "m") for n in ("position", "position_rate")]
    sure, doubted = (judge(c, lambda *_: 0.5) for c in criteria_of("rmse < 1 m", signals))
    one = worst([replace(sure, high=0.6), replace(doubted, doubt="only 3 % of load_2 lies in it")])
    assert one.criterion.output == "position" and one.passed
    assert any("of position_rate: its band cannot be trusted" in words for words in one.cautions), one.cautions
