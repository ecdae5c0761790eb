"""Whether a model is good enough: by criteria, by condition, against an earlier comparison; for scripts and servers."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from hydrotwin.comparison import Scenario, Tags, Wanted, acceptance, compare, junit, read_scenario, run_scenario
from hydrotwin.comparison.band import Band
from hydrotwin.comparison.notices import notices
from hydrotwin.comparison.scenario import ModelEntry
from hydrotwin.models.language.errors import DataError, DeclarationError, UnitError
from hydrotwin.records import Reading, Record, write_record
from hydrotwin.report import write_report
from hydrotwin.report.acceptance import acceptance_data, acceptance_lines, verdict
from tests.comparison.toys import Toy, recording

MODELS = {"good": Toy("good"), "bad": Toy("bad", gain=130.0), "broken": Toy("broken", fails_on="load2_stroke1")}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("recordings")
    for load in (1, 2):
        for stroke in (1, 2):
            write_record(recording(10 * load + stroke), found / f"load{load}_stroke{stroke}.csv")
    return found


def scenario(folder, *models, **more):
    return Scenario(
        "Toys",
        tuple(ModelEntry(m, m) for m in models),
        tuple(sorted(folder.glob("load*.csv"))),
        modes=("free run",),
        tags=Tags("load{load}_stroke{stroke}"),
        **more,
    )


def run(folder, *models, **wanted):
    asked = scenario(folder, *models, wanted=Wanted(**wanted))
    comparison = run_scenario(asked, MODELS.__getitem__, repeats=1)
    return comparison, acceptance(comparison, asked.wanted)


def test_a_criterion_that_is_judged_on_what_the_model_was_made_from_says_so(folder):
    accept = ("motor_speed.rmse < 3 rad/s", "load=1: motor_speed.rmse < 3 rad/s")
    comparison, plain = run(folder, "good", "bad", accept=accept)
    own = [{"role": "train", "sha256": r.digest} for r in comparison.records if r.tags["load"] == "2"]
    made = [dataclasses.replace(e, provenance={"recordings": own}) for e in comparison.entrants if e.name == "good"]
    seen = dataclasses.replace(comparison, entrants=(*made, *comparison.entrants[1:]))
    overall, other = acceptance(seen, Wanted(accept)).judged
    assert overall.caution == "judged on load2_stroke1, load2_stroke2, which the model was made from"
    assert not other.caution and not any(one.caution for one in plain.judged)
    assert acceptance_data(acceptance(seen, Wanted(accept)))["acceptance"]["criteria"][0]["caution"] == overall.caution
    assert not any(one.seen for one in acceptance(seen, Wanted(accept, model="bad")).judged)


def test_criteria_are_judged_over_all_recordings_and_by_condition(folder):
    comparison, found = run(
        folder,
        "good",
        "bad",
        accept=("motor_speed.rmse < 3 rad/s", "load=2: motor_speed.max < 20 rad/s", "motor_speed not worse than bad"),
    )
    assert found.model == "good" and found.passed
    everywhere, second, _ = (one.value for one in found.judged)
    means = {s.model: s for s in comparison.means if s.output == "motor_speed"}
    assert everywhere == means["good"].rmse
    of_load = [s.maximum for s in comparison.scores if (s.model, s.output) == ("good", "motor_speed")
               and s.record.startswith("load2")]  # fmt: skip
    assert second == max(of_load) and len(of_load) == 2


def test_a_criterion_is_about_recordings_of_several_tags_at_once(folder):
    accept = ("load=2, stroke=1: motor_speed.max < 20 rad/s", "stroke = 1.0 ,load=2: motor_speed.max < 20 rad/s")
    comparison, found = run(folder, "good", accept=accept)
    one = next(s for s in comparison.scores if (s.record, s.output) == ("load2_stroke1", "motor_speed"))
    assert [(j.value, j.samples) for j in found.judged] == [(one.maximum, one.samples)] * 2
    with pytest.raises(DeclarationError, match="no recordings 'stroke=3'"):
        run(folder, "good", accept=("load=2, stroke=3: motor_speed.max < 20 rad/s",))
    with pytest.raises(DeclarationError, match=r"none of all at once\. They have load=1, stroke=1; load=1, stroke=2"):
        run(folder, "good", accept=("load=1, load=2: motor_speed.max < 20 rad/s",))


def test_a_wrong_model_fails_and_says_what_it_misses(folder):
    _, found = run(folder, "bad", "good", accept=("motor_speed.rmse < 3 rad/s", "motor_speed not worse than good"))
    assert not found.passed and not any(one.passed for one in found.judged)
    _, found = run(folder, "good", "bad", model="bad", accept=("motor_speed.rmse < 3 rad/s",))
    assert found.model == "bad" and not found.passed


def test_a_recording_that_failed_passes_nothing(folder):
    _, found = run(folder, "broken", accept=("motor_speed.rmse < 1e6 rad/s", "load=1: motor_speed.rmse < 3 rad/s"))
    assert [one.passed for one in found.judged] == [False, True]


@pytest.mark.parametrize(
    ("wanted", "says"),
    [
        ({"accept": ("load=3: motor_speed.rmse < 3 rad/s",)}, "no recordings 'load=3'. .*load=2"),
        ({"accept": ("motor_speed not worse than goood",)}, "no model 'goood'.*good"),
        ({"accept": ("motor_speed.rmse < 3 mm",)}, "does not fit"),
        ({"model": "worse", "accept": ("motor_speed.rmse < 3 rad/s",)}, "no model 'worse'"),
        ({"against": Path("nowhere.json")}, "cannot be read"),
        ({"accept": ("motor_speed.coverage in [0.9, 0.99]",)}, "no band"),
    ],
)
def test_what_cannot_be_judged_is_refused(folder, wanted, says):
    with pytest.raises((DataError, DeclarationError, UnitError), match=says):
        run(folder, "good", **wanted)


def test_an_earlier_comparison_shows_what_became_better_and_worse(folder, tmp_path):
    before, _ = run(folder, "bad", "broken")
    write_report(before, tmp_path)
    mended = {"bad": MODELS["good"], "good": MODELS["good"]}
    asked = scenario(folder, "bad", "good", wanted=Wanted(against=tmp_path / "compare.json", base=tmp_path))
    comparison = run_scenario(asked, mended.__getitem__, repeats=1)
    found = acceptance(comparison, asked.wanted)
    speed = next(c for c in found.changes if c.output == "motor_speed")
    assert speed.model == "bad" and speed.better and not speed.worse and speed.now < 0.5 * speed.before
    assert (found.new, found.gone) == (("good",), ("broken",))
    kept = Wanted(("motor_speed not worse than compare.json by 5 %",), "bad", base=tmp_path)
    assert acceptance(comparison, kept).passed
    with pytest.raises(DeclarationError, match="has no motor_speed of 'good'"):
        acceptance(comparison, Wanted(("motor_speed not worse than compare.json",), "good", base=tmp_path))


def test_a_change_that_may_come_from_how_it_was_asked_is_told(folder, tmp_path):
    """Starts estimated now and not then, and a recording that was read with fewer samples."""
    before, _ = run(folder, "good")
    write_report(before, tmp_path)
    told = json.loads((tmp_path / "compare.json").read_text())
    (tmp_path / "same.json").write_text(json.dumps(told))
    told["recordings"][0]["samples"] -= 1
    told["starts"] = [{"model": "good", "record": "load1_stroke1", "states": [{"name": "speed"}]}]
    (tmp_path / "other.json").write_text(json.dumps(told))
    same, other = (acceptance(before, Wanted(against=tmp_path / f"{name}.json")) for name in ("same", "other"))
    assert same.otherwise == () and len(other.otherwise) == 2
    lines = [text for _, text in acceptance_lines(other, {})]
    assert any("The start of good was estimated then, and not now" in text for text in lines)
    assert any("load1_stroke1 had another number of samples then" in text for text in lines)


@pytest.mark.parametrize("more", [{"against": "compare.json"}, {"accept": ["motor_speed not worse than compare.json"]}])
def test_an_earlier_comparison_of_other_recordings_judges_nothing(folder, tmp_path, more):
    """The same file names with other content, and one recording less."""
    before, _ = run(folder, "bad")
    write_report(before, tmp_path)
    others = tmp_path / "others"
    others.mkdir()
    for file in sorted(folder.glob("load*.csv"))[1:]:
        shutil.copy(file, others)
    write_record(recording(99), others / "load2_stroke2.csv")
    wanted = {name: tmp_path / value if isinstance(value, str) else value for name, value in more.items()}
    with pytest.raises(DeclarationError, match=r"load2_stroke2 is new, load1_stroke1 is gone, load2_stroke2 is gone"):
        run(others, "good", base=tmp_path, **wanted)


def test_an_earlier_comparison_of_more_recordings_judges_nothing(folder, tmp_path):
    before, _ = run(folder, "bad")
    write_report(before, tmp_path)
    (tmp_path / "few").mkdir()
    shutil.copy(next(iter(sorted(folder.glob("load*.csv")))), tmp_path / "few")
    with pytest.raises(DeclarationError, match="load1_stroke2 is gone"):
        run(tmp_path / "few", "good", against=tmp_path / "compare.json")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"means": [{"model": "a"}]}', '{"means": 3}'])
def test_a_file_that_is_no_comparison_is_refused(tmp_path, text):
    (tmp_path / "compare.json").write_text(text)
    comparison = compare([MODELS["good"]], [recording(1)], repeats=1, modes=("free run",))
    with pytest.raises(DataError, match=r"not the compare\.json"):
        acceptance(comparison, Wanted(against=tmp_path / "compare.json"))


def test_servers_read_the_criteria_as_test_cases(folder):
    _, found = run(folder, "bad", accept=("motor_speed.rmse < 3 rad/s", "motor_speed.fit > 10 %"))
    root = ElementTree.fromstring(junit(found, "Toys & more").encode())
    (suite,) = root
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("Toys & more", "2", "1")
    failed, passed = suite
    assert failed.get("name") == "motor_speed.rmse < 3 rad/s" and failed.find("failure") is not None
    assert passed.find("failure") is None


def test_a_run_that_failed_is_the_reason_and_passes_nothing_even_beside_another(folder):
    failing = ("motor_speed.rmse < 3 rad/s", "motor_speed not worse than worse", "load=2: motor_speed.fit > 1 %")
    asked = scenario(folder, "broken", "worse", wanted=Wanted(accept=(*failing, "load=1: motor_speed.rmse < 3 rad/s")))
    models = {**MODELS, "worse": Toy("worse", fails_on="load2_stroke2")}
    found = acceptance(run_scenario(asked, models.__getitem__, repeats=1), asked.wanted)
    assert [one.passed for one in found.judged] == [False, False, False, True]
    *failed, passed = ElementTree.fromstring(junit(found, "Toys").encode())[0]
    assert all("load2_stroke1: broken: the run left the finite numbers" in f.find("failure").text for f in failed)
    assert passed.find("failure") is None


def test_a_criterion_on_few_samples_says_how_few():
    few = recording(1).window(end=0.04)
    comparison = compare([MODELS["good"]], [few], repeats=0, modes=("free run",))
    asked = Wanted(("arm_angle.rmse < 10 deg", "arm_angle.max < 10 deg"))
    accepted = acceptance(comparison, asked)
    assert accepted.passed and [one.samples for one in accepted.judged] == [5, 5]
    told, careful = verdict(accepted)
    assert told.startswith("PASS") and careful.startswith(
        "Careful with “arm_angle.rmse < 10 deg”: judged on only 5 samples. The table"
    )
    lines = [line for _, line in acceptance_lines(accepted, {"arm_angle": "deg"})]
    assert all("judged on only 5 samples" in line for line in lines[1:])
    assert junit(accepted, "few").count("<system-out>judged on only 5 samples</system-out>") == 2
    assert [row["samples"] for row in acceptance_data(accepted)["acceptance"]["criteria"]] == [5, 5]
    many = acceptance(compare([MODELS["good"]], [recording(1)], repeats=0, modes=("free run",)), asked)
    assert len(verdict(many)) == 1 and "system-out" not in junit(many, "many")


def test_the_page_says_first_whether_it_is_good_enough(folder, tmp_path):
    comparison, found = run(folder, "bad", accept=("motor_speed.rmse < 3 rad/s", "motor_speed.fit > 10 %"))
    files = write_report(comparison, tmp_path, accepted=found)
    text = files["markdown"].read_text(encoding="utf-8")
    assert "**FAIL: bad misses 1 of 2 criteria: “motor_speed.rmse < 3 rad/s”: found " in text
    assert "## By operating condition" in text and "| FAIL |" in text and "| PASS |" in text
    told = json.loads(files["json"].read_text(encoding="utf-8"))["acceptance"]
    assert not told["passed"] and [one["passed"] for one in told["criteria"]] == [False, True]


def test_a_scenario_file_holds_tags_and_criteria(folder):
    path = folder / "scenario.toml"
    path.write_text(
        'models = ["good"]\n'
        'validate = ["load1_*.csv", {file = "load2_stroke1.csv", tags = {oil = "cold", load = 20}}]\n'
        'tags = "load{load}_*"\naccept = ["oil=cold: motor_speed.rmse < 3 rad/s"]\njudge = "good"\n'
    )
    asked = read_scenario(path)
    comparison = run_scenario(asked, MODELS.__getitem__, repeats=1)
    assert [r.tags for r in comparison.records] == [{"load": "1"}, {"load": "1"}, {"load": "20", "oil": "cold"}]
    assert acceptance(comparison, asked.wanted).passed


def test_a_recording_that_knows_no_sample_of_an_output_is_left_out_and_cannot_test_it_alone(folder, tmp_path):
    unknown = recording(3)
    unknown = unknown.with_signals({"motor_speed": np.full(len(unknown), np.nan)}, {"motor_speed": "rad/s"})
    write_record(unknown, tmp_path / "unknown.csv")
    asked = dataclasses.replace(
        scenario(folder, "good", wanted=Wanted(("motor_speed.rmse < 3 rad/s",))),
        validate=(folder / "load1_stroke1.csv", tmp_path / "unknown.csv"),
        tags=Tags(),
        reading=Reading(missing="keep"),
    )
    (one,) = acceptance(run_scenario(asked, MODELS.__getitem__, repeats=0), asked.wanted).judged
    assert one.passed and one.without == ("unknown",)
    about = dataclasses.replace(asked, wanted=Wanted(("unknown: motor_speed.rmse < 3 rad/s",)))
    with pytest.raises(DeclarationError, match="nothing can test it"):
        run_scenario(about, MODELS.__getitem__, repeats=0)


@pytest.mark.parametrize("group", ["valve a=b=1", "valve a=b = 1", "at=x=3", "at = x=3"])
def test_a_tag_may_have_a_sign_of_equality_in_its_name_and_its_value(folder, group):
    path = folder / "equal.toml"
    path.write_text(
        'models = ["good"]\nvalidate = ["load1_stroke2.csv", {file = "load2_stroke1.csv", tags = {"valve a=b" = 1, '
        f'at = "x=3"}}}}]\naccept = ["{group}: motor_speed.rmse < 3 rad/s"]\n'
    )
    asked = read_scenario(path)
    (one,) = acceptance(run_scenario(asked, MODELS.__getitem__, repeats=0), asked.wanted).judged
    assert one.passed and one.samples == len(recording(21).time)  # of the one recording alone


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ('tags = "load{load}_*"\nvalidate = ["other.csv"]', "does not fit 'other.csv'"),
        ('tags = "load"\nvalidate = ["load1_stroke1.csv"]', "names no tag"),
        ('tags = 3\nvalidate = ["load1_stroke1.csv"]', "is no text"),
        ('validate = [{file = "load1_stroke1.csv", tag = {a = 1}}]', "unknown key 'tag'"),
        ("validate = [{tags = {a = 1}}]", "a recording with tags is"),
        ('validate = ["a.csv"]\ntags = {a = 1}', "'tags' is a pattern of file names"),
        ("validate = [3]", "holds no text"),
    ],
)
def test_tags_that_do_not_fit_are_refused(folder, line, says):
    write_record(recording(3), folder / "other.csv")
    path = folder / "refused.toml"
    path.write_text(f'models = ["good"]\n{line}\n')
    with pytest.raises(DeclarationError, match=says):
        run_scenario(read_scenario(path), MODELS.__getitem__, repeats=1)


@pytest.mark.parametrize(
    ("pattern", "name", "tags"),
    [
        ("load{load}_*", "load1.5_validate_2.csv", {"load": "1.5"}),
        ("load{load}_*", "load2_x.csv.gz", {"load": "2"}),
        ("load{load}_*", "load2_x.parquet", {"load": "2"}),
        ("*_{oil}oil_{temperature}", "run-3_coldoil_-20", {"oil": "cold", "temperature": "-20"}),
        ("{date}_*_{machine}", "2026-11-28_a_b_press 2.csv", {"date": "2026-11-28", "machine": "press 2"}),
    ],
)
def test_a_tag_is_the_whole_of_what_stands_in_a_name(pattern, name, tags):
    assert Tags(pattern).put(recording(1), Path(name)).tags == tags


@pytest.mark.parametrize(
    ("pattern", "name"),
    [("load{load}", "load1_x.csv"), ("{oil}_x", "very_cold_x.csv"), ("load{load}_*", "overload2_x.csv")],
)
def test_no_tag_is_cut_without_a_word(pattern, name):
    with pytest.raises(DeclarationError, match="does not fit"):
        Tags(pattern).put(recording(1), Path(name))


def test_a_result_is_told_in_the_unit_of_its_criterion_everywhere(tmp_path):
    """The files are in SI and so is the page; the criteria are not."""
    comparison = compare([MODELS["good"], MODELS["bad"]], [recording(1)], repeats=0, modes=("free run",))
    texts = ("arm_angle.rmse < 300 mrad", "arm_angle.fit > 0.1", "arm_angle.fit > 10 %", "arm_angle.lag < 1 s")
    texts += ("arm_angle.max < 900 deg", "arm_angle.nrmse not worse than bad")
    accepted = acceptance(comparison, Wanted(texts, model="good"))
    score = next(s for s in comparison.scores if (s.model, s.output) == ("good", "arm_angle"))
    lines = {
        one.criterion.text: line
        for one, (_, line) in zip(accepted.judged, acceptance_lines(accepted, {})[1:], strict=True)
    }
    assert f": {1000 * score.rmse:.3g}" in lines[texts[0]] and "\u00a0mrad," in lines[texts[0]]
    assert f": {score.fit_percent / 100:.3f}," in lines[texts[1]]
    assert f": {score.fit_percent:.1f}\u00a0%," in lines[texts[2]]
    assert "\u00a0s, " in lines[texts[3]] and "ms" not in lines[texts[3]] and "°, " in lines[texts[4]]
    assert "\u00a0%, " in lines[texts[5]]
    write_report(comparison, tmp_path, accepted=accepted)
    told = json.loads((tmp_path / "compare.json").read_text(encoding="utf-8"))
    rows = {row["criterion"]["value"]: row["found"]["shown"] for row in told["tables"]["acceptance"]["rows"]}
    assert all(f": {rows[text]}, " in lines[text] for text in texts)
    first = told["acceptance"]["criteria"][0]
    assert first["unit"] == "mrad" and first["as_written"]["high"] == pytest.approx(300)
    assert first["as_written"]["value"] == pytest.approx(1000 * score.rmse)


def test_what_is_not_defined_names_the_recording_and_the_output():
    still = recording(2, name="still")
    still = still.with_signals({"arm_angle": np.full(len(still), 0.4)})
    comparison = compare([MODELS["good"], MODELS["bad"]], [recording(1), still], repeats=0, modes=("free run",))
    asked = Wanted(("arm_angle.r2 > 0.5", "arm_angle.nrmse not worse than bad", "motor_speed.r2 > 0.5"))
    one, other, fine = acceptance(comparison, asked).judged
    assert one.undefined == other.undefined == "not defined on still: arm_angle does not move there"
    assert one.lacking == ("still",) and not fine.lacking and fine.passed


def test_a_mean_over_very_different_numbers_of_samples_is_told():
    short = recording(2, name="short").window(end=0.6)
    comparison = compare([MODELS["good"]], [recording(1), short], repeats=0, modes=("free run",))
    mean, largest = acceptance(comparison, Wanted(("arm_angle.rmse < 9 deg", "arm_angle.max < 9 deg"))).judged
    assert mean.caution == "a mean over recordings of 61 to 800 samples"
    assert not largest.caution
    (told,) = (n for n in notices(comparison) if "Means of" in n)
    assert told.startswith("Means of arm_angle, motor_speed, pressure_cap: short with 61 samples counts")
    alike = compare([MODELS["good"]], [recording(1), recording(2)], repeats=0, modes=("free run",))
    assert not any("Means of" in n for n in notices(alike))


def test_what_is_taken_of_a_doubted_band_passes_nothing_and_others_say_that_it_is(tmp_path):
    """Coverage and E / u_val had passed, exit code 0, on a band that the page says is not to be trusted."""
    comparison = compare([MODELS["good"]], [recording(1)], repeats=0, modes=("free run",))
    entrant = dataclasses.replace(comparison.entrants[0], bands=(Band("arm_angle", "own", False, "it is too narrow."),))
    scores = tuple(dataclasses.replace(s, coverage=0.95) for s in comparison.scores)
    doubted = dataclasses.replace(comparison, entrants=(entrant,), scores=scores)
    asked = Wanted(("arm_angle.coverage in [0.9, 0.99]", "arm_angle.rmse < 9 deg", "motor_speed.rmse < 900 rpm"))
    accepted = acceptance(doubted, asked)
    assert [one.passed for one in accepted.judged] == [False, True, True]
    cases = list(ElementTree.fromstring(junit(accepted, "here").partition("?>")[2]).iter("testcase"))
    why = "cannot be tested, for the band of arm_angle cannot be trusted: it is too narrow."
    assert cases[0].find("failure").text == why
    said = [case.findtext("system-out") for case in cases]
    assert said[0] is None and said[1] == "its band cannot be trusted: it is too narrow" and said[2] is None
    files = write_report(doubted, tmp_path, accepted=accepted)
    row = next(
        r for r in files["markdown"].read_text(encoding="utf-8").splitlines() if r.startswith(f"| {asked.accept[0]}")
    )
    first = acceptance_data(accepted)["acceptance"]["criteria"][0]
    assert first["undefined"] in row and first["undefined"] == why and not first["caution"]
    assert first["doubt"] == "it is too narrow." and not first["passed"]
    said = f"FAIL: good misses 1 of 3 criteria: “{asked.accept[0]}”: {why}"
    assert said in files["markdown"].read_text(encoding="utf-8")


def test_a_criterion_says_that_it_was_judged_in_parts_around_a_hole():
    """What inputs did there nobody knows: neither a pass nor a fail is the model's alone."""
    whole = recording(5)
    keep = (whole.time < 3.0) | (whole.time > 4.0)
    holed = Record(whole.time[keep], {n: v[keep] for n, v in whole.signals.items()}, whole.units, "holed")
    compared = compare([Toy("good")], [whole, holed], modes=["free run"], repeats=0)
    asked = ("arm_angle.rmse < 9 rad", "validation_5: arm_angle.rmse < 9 rad")
    both, alone = acceptance(compared, Wanted(asked)).judged
    assert "judged in parts, with a start of its own behind every hole: 2.99 s to 4.01 s of holed" in both.caution
    assert not alone.caution
