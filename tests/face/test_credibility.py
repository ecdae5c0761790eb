"""The block [credibility] of a model file: who writes it, who refuses it, and when it no longer holds."""

from __future__ import annotations

import json
import math
import re
import tomllib
import warnings
import zipfile
from pathlib import Path

import pytest

import hydrotwin as ht
from hydrotwin.comparison import PhysicalContender, Wanted, acceptance, compare, replay
from hydrotwin.models.language.credibility import Evidence, StaleEvidenceWarning
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.provenance import EDITED, SINCE
from tests.face.command_line import hydrotwin

LOOSE, TIGHT = "arm_angle.rmse < 20 deg", "arm_angle.rmse < 0.0001 deg"


@pytest.fixture(scope="module")
def identified(recordings, tmp_path_factory) -> str:
    """The text of a model file as identify writes it, from train_1 alone."""
    path = tmp_path_factory.mktemp("identified") / "m.toml"
    words = ("--validate", recordings / "validate_1.csv", "--free", "motor.gain", "--starts", 1, "--out", path)
    answer = hydrotwin("identify", "cehA", recordings / "train_1.csv", *words)
    assert answer.code == 0, answer.said
    return path.read_text(encoding="utf-8")


@pytest.fixture
def file(identified, tmp_path) -> Path:
    path = tmp_path / "m.toml"
    path.write_text(identified, encoding="utf-8")
    return path


def judged(file: Path, recordings: Path, *words, on=("validate_1",), mode="free run"):
    """`hydrotwin compare` of the file with --record."""
    files = [word for name in on for word in ("--validate", recordings / f"{name}.csv")]
    options = ("--mode", mode, "--output", "arm_angle", "--out", file.parent / "report", "--record", file)
    return hydrotwin("compare", "--model", file, *files, *options, *words)


def edited(file: Path, before: str, after: str) -> Path:
    text = file.read_text(encoding="utf-8")
    assert before in text
    file.write_text(text.replace(before, after, 1), encoding="utf-8")
    return file


def test_identify_says_from_what_it_made_the_values(identified, recordings):
    content = tomllib.loads(identified)
    [one] = content["credibility"]["evidence"]
    digests = {r.name: r.digest for r in (ht.read_record(recordings / f"{n}_1.csv") for n in ("train", "validate"))}
    rows = [(r["name"], r["role"], r["sha256"]) for r in one["recordings"]]
    assert rows == [("train_1", "fit", digests["train_1"]), ("validate_1", "judge", digests["validate_1"])]
    assert one["by"] == "identify" and set(one["versions"]) == {"hydrotwin", "python"} and one["date"]
    told = content["provenance"]
    of = {(m["output"], m["role"]): m["rmse"] for m in one["metrics"]}
    assert of["arm_angle", "judge"] == told["rmse"]["validate"]["arm_angle"]
    assert one["accuracy"] == told["accuracy"] and one["facts"]["chi2_per_sample"] == told["chi2_per_sample"]


def test_compare_records_criteria_with_their_margins_and_what_was_seen_in_the_fit(file, recordings):
    before = file.read_text(encoding="utf-8").partition("[credibility]")[0]
    answer = judged(file, recordings, "--accept", LOOSE, "--accept", TIGHT, on=("train_1", "validate_1"))
    assert answer.code == 1  # as without --record
    assert file.read_text(encoding="utf-8").partition("[credibility]")[0] == before
    one = ht.read_model_file(file).credibility.evidence[-1]
    assert [(r["name"], r["role"]) for r in one.recordings] == [("train_1", "fit"), ("validate_1", "judge")]
    data = json.loads((file.parent / "report/compare.json").read_text(encoding="utf-8"))
    told = {c["text"]: c for c in data["acceptance"]["criteria"]}
    for row in one.criteria:
        assert {k: row[k] for k in ("passed", "value", "margin")} == {
            k: told[row["text"]][k] for k in ("passed", "value", "margin")
        }
    assert one.passed is False
    [mean] = [m for m in data["means"] if m["model"] == "m.toml"]
    assert one.metrics[0]["rmse"] == mean["rmse"] and one.metrics[0]["role"] == "fit and judge"


def test_the_same_question_is_kept_once_and_another_one_beside_it(file, recordings):
    for criterion in (LOOSE, LOOSE, TIGHT):
        judged(file, recordings, "--accept", criterion)
    evidence = ht.read_model_file(file).credibility.evidence
    assert [(e.by, e.passed) for e in evidence] == [("identify", None), ("compare", True), ("compare", False)]


def test_a_missed_criterion_is_not_replaced_by_the_same_words_judged_otherwise(file, recordings):
    """One step ahead, in another scale, or under another tag it is another question: it had taken the place of a FAIL,
    and check had ended with 0."""
    tight = "arm_angle.rmse < 1e-6 deg"
    judged(file, recordings, "--accept", tight)
    judged(file, recordings, "--accept", tight, mode="one step")
    for words in (("--scale", "arm_angle=1e-9 rad/rad"), ("--tags", "validate_{run}")):
        judged(file, recordings, "--accept", tight, *words)
    evidence = [e for e in ht.read_model_file(file).credibility.evidence if e.by == "compare"]
    assert len(evidence) == 4 and evidence[0].passed is False
    judged(file, recordings, "--accept", tight, "--tags", "validate_{run}")
    assert len([e for e in ht.read_model_file(file).credibility.evidence if e.by == "compare"]) == 4
    assert hydrotwin("check", file).code == 1


def test_a_missed_criterion_beside_another_model_is_not_replaced_by_one_beside_a_worse_one(file, recordings):
    record, model = ht.read_record(recordings / "validate_1.csv"), ht.load(str(file))
    for gain in ({}, {"motor.gain": 60.0}):
        other = PhysicalContender(model, "other", parameters=gain)
        found = compare([model, other], [record], modes=("free run",), outputs=["arm_angle"], repeats=0)
        judged_so = acceptance(found, Wanted(("arm_angle not worse than other by -50 %",)))
        ht.record_comparison(file, found, judged_so)
    assert [e.passed for e in ht.read_model_file(file).credibility.evidence] == [None, False, True]


def test_what_to_know_of_a_criterion_stays_in_the_record(file, recordings):
    judged(file, recordings, "--accept", LOOSE, on=("train_1",))
    one = ht.read_model_file(file).credibility.evidence[-1]
    assert "judged on train_1, which the model was made from" in one.criteria[0]["caution"]
    assert "judged on train_1, which the model was made from" in hydrotwin("check", file).said.replace("\n", " ")


def test_edited_values_are_told_and_recording_anew_drops_what_no_longer_holds(file, recordings):
    judged(file, recordings, "--accept", LOOSE)
    assert hydrotwin("check", file).code == 0
    value = ht.read_model_file(file).settings["motor.gain"]["value"]
    edited(file, f"value = {value!r}", f"value = {value * 1.01!r}")
    with pytest.warns(StaleEvidenceWarning, match="edited after identify .* and compare .* no longer holds"):
        ht.load(str(file))
    answer = hydrotwin("check", file)
    assert answer.code == 1 and answer.said.count("STALE") == 2 and "no longer holds" in answer.said
    judged(file, recordings, "--accept", LOOSE)
    assert [e.by for e in ht.read_model_file(file).credibility.evidence] == ["compare"]
    assert hydrotwin("check", file).code == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error", StaleEvidenceWarning)
        told = ht.load(str(file)).provenance
    assert told[SINCE] == [EDITED] and not told.keys() & {"rmse", "findings", "chi2_per_sample", "spread"}


@pytest.mark.parametrize("edit", [("bounds = [20.0,", "bounds = [10.0,"), ("identified from train_1", "my bench")])
def test_bounds_and_sources_may_be_edited(file, edit):
    assert not ht.read_model_file(edited(file, *edit)).stale


def test_edited_values_have_no_intervals_of_the_fit(file, recordings):
    """An archive had an interval of 0.01 around a value that was typed in."""
    assert any(p.sigma for p in ht.load(str(file)).flat.parameters)
    value = ht.read_model_file(file).settings["motor.gain"]["value"]
    edited(file, f"value = {value!r}", "value = 60.0")
    with pytest.warns(StaleEvidenceWarning, match="nor do the intervals of its fit"):
        model = ht.load(str(file))
    assert not any(p.sigma for p in model.flat.parameters) and "spread" not in model.provenance
    words = ("--mode", "free run", "--output", "arm_angle", "--ssp", file.parent / "a.ssp", "--ssp-version", "2.0")
    answer = hydrotwin("compare", "--model", file, "--validate", recordings / "validate_1.csv", *words,
                       "--out", file.parent / "report")  # fmt: skip
    assert answer.code == 0, answer.said
    with zipfile.ZipFile(file.parent / "a.ssp") as archive:
        told = [archive.read(n).decode() for n in archive.namelist() if n.endswith("identified.ssv")]
    assert "Interval" not in "".join(told)
    judged(file, recordings, "--accept", LOOSE)
    known = ht.read_model_file(file)
    assert not known.stale and "spread" not in known.provenance, "recorded anew, they do not come back"
    assert not any("sigma" in row for row in known.settings.values())


def test_a_recording_that_the_model_was_made_from_is_told_when_it_is_compared_there(file, recordings):
    answer = judged(file, recordings, "--accept", LOOSE, on=("train_1",))
    assert answer.code == 0 and "was made from train_1: its errors there say nothing of other" in answer.said
    assert "was made from" not in judged(file, recordings, "--accept", LOOSE).said


def test_an_effect_that_is_added_by_hand_is_told(file):
    edited(file, "[parameters]", '[[effects]]\neffect = "coulomb_friction"\nsite = "arm.pin"\n\n[parameters]')
    assert "no longer holds" in ht.read_model_file(file).stale


def test_a_file_of_before_has_no_block_and_is_read(file):
    file.write_text(file.read_text(encoding="utf-8").partition("[credibility]")[0], encoding="utf-8")
    assert ht.load(str(file)).flat.parameters
    answer = hydrotwin("check", file)
    assert answer.code == 0 and "no record is inside" in answer.said


DAMAGED = {
    "cut off": (lambda t: t[: t.rindex("sha256 = ")], "evidence 1 is damaged: 'sha256' is missing"),
    "a result": (lambda t: t.replace('role = "judge"', 'role = "fit"'), "was changed after it was written"),
    "newer": (lambda t: t.replace("[credibility]\nformat = 1", "[credibility]\nformat = 9"), "of a newer version"),
    "no format": (lambda t: t.replace("[credibility]\nformat = 1", "[credibility]"), "has no 'format'"),
    "a key": (lambda t: t.replace('by = "identify"', 'buy = "identify"'), "'buy' has no place in it"),
    "a form": (lambda t: t.replace("criteria = []", "criteria = 3"), "'criteria' has the wrong form"),
    "no table": (lambda t: t.partition("[credibility]")[0].replace("count", "credibility = 3\ncount"), "is no table"),
}


@pytest.mark.parametrize("what", DAMAGED)
def test_a_damaged_block_is_refused_with_what_to_do(file, recordings, what):
    damage, says = DAMAGED[what]
    text = damage(file.read_text(encoding="utf-8"))
    file.write_text(text, encoding="utf-8")
    words = ("--input", recordings / "validate_1.csv", "--out", file.parent / "s.csv")
    for answer in (hydrotwin("simulate", file, *words), hydrotwin("check", file), judged(file, recordings)):
        assert answer.code == 2 and says in answer.said, answer.said
    assert not (file.parent / "s.csv").exists() and file.read_text(encoding="utf-8") == text


@pytest.mark.parametrize("words", [("check",), ("compare", "--model", "cehA", "--validate", "{v}", "--record")])
def test_a_learned_block_has_another_card(words, recordings, tmp_path):
    (tmp_path / "block.toml").write_text('kind = "arx"\nversion = 1\n')
    said = [w.format(v=recordings / "validate_1.csv") for w in words]
    answer = hydrotwin(*said, tmp_path / "block.toml")
    assert answer.code == 2 and "a learned block (arx), and only model files" in answer.said


REFUSED = {
    "not compared": (("compare", "--model", "cehA", "--validate", "{v}", "--record", "{m}"), "none of the models has"),
    "another judged": (
        ("compare", "--model", "cehA", "--model", "{m}", "--validate", "{v}", "--accept", LOOSE, "--record", "{m}"),
        "the criteria are about 'cehA', the file is 'm.toml'. Judge that one: --judge m.toml",
    ),
    "no file": (("compare", "--model", "{m}", "--validate", "{v}", "--record", "{m}x.toml"), "no such file"),
    "a reference": (("check", "{m}", "--reference", "{v}"), "is a model file, whose record is told"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_recorded_is_refused_before_anything_runs(file, recordings, what):
    words, says = REFUSED[what]
    before = file.read_bytes()
    answer = hydrotwin(*(w.format(m=file, v=recordings / "validate_1.csv") for w in words), *_out(words, file))
    assert answer.code == 2 and says in answer.said, answer.said
    assert file.read_bytes() == before and not (file.parent / "report").exists()


def _out(words, file: Path) -> tuple:
    return ("--out", file.parent / "report") if words[0] == "compare" else ()


def test_a_scenario_that_sets_other_values_is_refused(file, recordings):
    recording = (recordings / "validate_1.csv").as_posix()
    scenario = file.parent / "s.toml"
    scenario.write_text(
        f'models = [{{model = "m.toml", set = {{"motor.gain" = 100.0}}}}]\nvalidate = ["{recording}"]\n'
    )
    answer = hydrotwin("compare", scenario, "--out", file.parent / "report", "--record", file)
    assert answer.code == 2 and "sets other values" in answer.said


def test_from_python_a_comparison_is_recorded_of_the_model_with_the_values_of_the_file(file, recordings):
    record = ht.read_record(recordings / "validate_1.csv")
    model = PhysicalContender(ht.load(str(file)), "mine")
    other = PhysicalContender(ht.load("cehA"), "as shipped")
    found = compare([other, model], [record], modes=["free run"], outputs=["arm_angle"])
    accepted = acceptance(found, Wanted((LOOSE,), "mine"))
    [_, one] = ht.record_comparison(file, found, accepted).evidence
    assert one.facts["model"] == "mine" and one.passed and one.accuracy["reached"]
    with pytest.raises(DeclarationError, match="'as shipped' is not the model of this file"):
        ht.record_comparison(file, found, model="as shipped")
    with pytest.raises(DeclarationError, match="no such model"):
        ht.record_comparison(file, found, model="nobody")


def test_a_block_that_cannot_be_told_from_the_rest_is_left_alone(file, recordings):
    text = file.read_text(encoding="utf-8").partition("[credibility]")[0]
    file.write_text(text.replace("count =", "credibility = { format = 1 }\ncount =", 1), encoding="utf-8")
    before = file.read_bytes()
    answer = judged(file, recordings)
    assert answer.code == 2 and "cannot be told from the rest" in answer.said
    assert file.read_bytes() == before
    with pytest.raises(DataError):
        ht.record_comparison(file.parent / "absent.toml", None)


def test_a_link_stays_a_link_and_what_it_points_to_is_written(file, recordings):
    link = file.with_name("link.toml")
    link.symlink_to(file.name)
    answer = judged(link, recordings, "--accept", LOOSE)
    assert answer.code == 0, answer.said
    assert link.is_symlink() and len(ht.read_model_file(file).credibility.evidence) == 2
    words = (recordings / "train_1.csv", "--free", "motor.gain", "--starts", 1, "--out", link)
    assert hydrotwin("identify", "cehA", *words).code == 0
    assert link.is_symlink() and len(ht.read_model_file(file).credibility.evidence) == 1


def test_a_read_only_file_is_refused_before_anything_runs(file, recordings):
    before = file.read_bytes()
    file.chmod(0o444)
    link = file.with_name("link.toml")
    link.symlink_to(file.name)
    written = (
        judged(file, recordings),
        judged(link, recordings),
        hydrotwin("identify", "cehA", recordings / "train_1.csv", "--out", file),
    )
    for answer in written:
        assert answer.code == 2 and "read-only" in answer.said, answer.said
    assert file.read_bytes() == before and not (file.parent / "report").exists()


def test_an_entry_that_was_pasted_twice_counts_once(file):
    text = file.read_text(encoding="utf-8")
    block = text[text.index("[[credibility.evidence]]") :]
    file.write_text(f"{text}\n{block}", encoding="utf-8")
    assert len(ht.read_model_file(file).credibility.evidence) == 1
    answer = hydrotwin("check", file, "--json")
    assert answer.code == 0 and len(json.loads(answer.out)["evidence"]) == 1


def test_a_band_that_is_not_to_be_trusted_is_in_the_record(file, recordings):
    model = PhysicalContender(ht.load(str(file)), "m")
    spread = model.provenance["spread"]
    model.provenance["spread"] = spread | {"explained": [n for n in spread["explained"] if n != "arm_angle"]}
    found = compare([model], [ht.read_record(recordings / "validate_1.csv")], outputs=["arm_angle"], repeats=0)
    known = ht.record_comparison(file, found).evidence[-1]
    assert list(known.facts["untrusted_bands"]) == ["arm_angle"]
    assert known.told.endswith("Its bands cannot be trusted for arm_angle")


def test_an_archive_of_ssp_2_0_says_where_the_values_come_from(file, recordings):
    archive = file.parent / "m.ssp"
    answer = judged(file, recordings, "--accept", LOOSE, "--ssp", archive, "--ssp-version", "2.0")
    assert answer.code == 0, answer.said
    with zipfile.ZipFile(archive) as files:
        told = files.read("resources/identified.srmd").decode()
        assert 'version="2.0"' in files.read("SystemStructure.ssd").decode()
    assert 'keyword="made by">identify<' in told and "recording to fit" in told and "validate_1, SHA-256" in told


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--ssp-version", "3"), "--ssp-version 3: there is none"),
        (("--ssp-version", "2.0"), "Say where it goes: --ssp"),
    ],
)
def test_a_version_of_no_archive_is_refused(file, recordings, words, says):
    answer = judged(file, recordings, *words)
    assert answer.code == 2 and says in answer.said
    assert not (file.parent / "report").exists()


ASKED = ("--accept", LOOSE, "--accept", "load=1: arm_angle.rate.rmse < 90 deg/s", "--slope", "arm_angle")
ASKED += ("--initial-states", "auto", "--tags", "validate_{load}", "--interpolation", "command=linear")


def test_a_comparison_is_made_again_from_the_record_alone(file, recordings, tmp_path):
    """Where recordings were, and, once they have moved, wherever their hash is found."""
    own = tmp_path / "own"
    own.mkdir()
    (own / "validate_1.csv").write_bytes((recordings / "validate_1.csv").read_bytes())
    assert judged(file, own, *ASKED).code == 0
    row = ht.read_model_file(file).credibility.evidence[-1].recordings[0]
    assert (row["file"], row["tags"]) == ("own/validate_1.csv", {"load": "1"})
    again = next(row for row in replay(file, ht.load(str(file))) if row.what == LOOSE)
    assert again.unit == "deg" and again.scale == pytest.approx(math.radians(1.0)) and again.passed
    answer = hydrotwin("check", file, "--replay")
    assert answer.code == 0 and "OTHER" not in answer.said and "15 of 15 numbers are the same" in answer.said
    (own / "validate_1.csv").rename(own / "moved.csv")
    answer = hydrotwin("check", file, "--replay")
    assert answer.code == 1 and "not where it was (own/validate_1.csv)" in answer.said.replace("\n", " ")
    answer = hydrotwin("check", file, "--replay", "--recordings", tmp_path, "--json")
    assert answer.code == 0 and all(row["passed"] for row in json.loads(answer.out)["again"])
    (own / "moved.csv").write_text((own / "moved.csv").read_text() + "\n")
    assert hydrotwin("check", file, "--replay", "--recordings", tmp_path).code == 1


def test_another_model_is_told_number_by_number(file, recordings):
    beside = "--model", "shipped=cehA", "--judge", "m.toml"
    ran = judged(file, recordings, *beside, "--accept", LOOSE, "--accept", "arm_angle not worse than shipped by 900 %")
    assert ran.code == 0, ran.err
    rows = replay(file, ht.load("cehA").with_parameters({"motor.gain": 200.0}))
    by_what = {row.what: row for row in rows}
    assert by_what["arm_angle, free run: rmse"].passed is False and by_what[LOOSE].passed is False
    assert by_what["arm_angle not worse than shipped by 900 %"].passed is False
    text = file.read_text(encoding="utf-8")
    file.write_text(re.sub(r"(?<=value = )[0-9.]+", "121.5", text, count=1), encoding="utf-8")
    assert [(row.what, row.passed) for row in replay(file, ht.load("cehA"))] == [("all", None)]


def test_a_record_without_a_comparison_cannot_be_made_again(file):
    answer = hydrotwin("check", file, "--replay")
    assert answer.code == 2 and "no comparison is in its record" in answer.said
    answer = hydrotwin("check", file, "--replay", "--recordings", file.parent / "nowhere")
    assert answer.code == 2 and "no such folder" in answer.said


def test_criteria_that_are_not_named_in_a_record_are_counted():
    """Of four that held it named three, as if these were all."""
    rows = tuple({"text": f"y.rmse < {k} m", "passed": True, "margin": 3.5} for k in range(1, 6))
    told = Evidence("compare", "2026-11-29", "", {}, criteria=rows).told
    assert (
        told.partition("PASS, held: ")[2] == "; ".join(f"“y.rmse < {k} m” (+350 %)" for k in (1, 2, 3)) + " and 2 more"
    )
