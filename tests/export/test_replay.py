"""What an FMU carries along by FMI-LS-REF: written, told, run again; and whatever can be wrong with it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hydrotwin.export import check_fmu, export_fmu, read_fmu, reference_files, reference_run
from hydrotwin.export.archive import write_archive
from hydrotwin.export.experiments import experiments_of, series_of, series_text
from hydrotwin.export.foreign import describe_fmu
from hydrotwin.export.reference import reference_experiment
from hydrotwin.export.replay import carried_rows
from hydrotwin.models.language.credibility import FIT, JUDGE, Credibility, Evidence, versions
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.provenance import made_from
from hydrotwin.records import Record
from tests.export.systems import clocked_mass, lag_block

INSIDE = "extra/org.fmi-standard.fmi-ls-ref/"
MANIFEST, RECORD = f"{INSIDE}fmi-ls-manifest.xml", f"{INSIDE}credibility.toml"
EVIDENCE = Evidence(
    "compare", "2026-05-04T10:00:00+02:00", "a" * 64, versions(),
    ({"name": "bench_7", "sha256": "b" * 64, "role": JUDGE},), (),
    ({"text": "place.rmse < 1 mm", "passed": True, "value": 5e-4, "low": -np.inf, "high": 1e-3, "margin": 0.5},),
)  # fmt: skip


def bench(seconds: float = 2.0) -> Record:
    """A recording of the clocked mass: force, and a place that begins away from the model's own start."""
    time = 100.0 + np.arange(0.0, seconds, 0.02)
    force = 5 * np.sin(3 * (time - 100.0))
    return Record(time, {"force": force, "place": 0.3 + 0 * time}, {"force": "N", "place": "m"}, "bench_7")


def carrying(path: Path, **options) -> Path:
    """The clocked mass with its smoke test, one experiment and a record."""
    model = clocked_mass()
    given = {
        "reference": reference_run(model),
        "experiments": [reference_experiment(model, bench())],
        "credibility": Credibility((EVIDENCE,)),
    }
    return export_fmu(model, path, **(given | options))


@pytest.fixture(scope="module")
def fmu(tmp_path_factory) -> Path:
    return carrying(tmp_path_factory.mktemp("carrying") / "mass.fmu")


@pytest.fixture(scope="module")
def without_smoke(tmp_path_factory) -> Path:
    """Each run of an FMU is a process: of what is wrong one experiment tells enough."""
    return carrying(tmp_path_factory.mktemp("carrying") / "mass.fmu", reference=None)


def test_an_fmu_knows_the_recordings_that_it_was_fitted_to(tmp_path, fmu):
    """Judged on those it had passed without a word; of its model file that is told."""
    seen = ({"name": "bench_1", "sha256": "c" * 64, "role": FIT},)
    fitted = Evidence("identify", "2026-05-03T10:00:00+02:00", "a" * 64, versions(), seen)
    path = carrying(tmp_path / "m.fmu", credibility=Credibility((fitted, EVIDENCE)), experiments=(), reference=None)
    assert made_from(read_fmu(path).provenance) == {"c" * 64}
    assert made_from(read_fmu(fmu).provenance) == frozenset()
    damaged = edited(path, tmp_path / "damaged.fmu", {RECORD: "format = 3"})
    assert made_from(read_fmu(damaged).provenance) == frozenset()


def rows_of(path: Path, again: bool = True) -> dict[str, tuple[str, str]]:
    return dict(carried_rows(path, describe_fmu(path, {}, {}), True, again, 60.0)[0])


def edited(fmu: Path, target: Path, changes: dict) -> Path:
    """The FMU with some of its files changed; None takes one out, a text or a function makes it another."""
    with zipfile.ZipFile(fmu) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    for name, change in changes.items():
        before = files.pop(name, b"")
        after = change(before.decode()) if callable(change) else change
        assert after != before.decode(), name
        files |= {} if after is None else {name: after}
    return write_archive(target, files)


def swapped(before: str, after: str):
    def change(text: str) -> str:
        assert before in text, before
        return text.replace(before, after)

    return change


# -- what is written -----------------------------------------------------------------------------------------------
def test_the_manifest_names_every_file_with_its_role_and_nothing_is_missing(fmu):
    with zipfile.ZipFile(fmu) as archive:
        root, names = ET.fromstring(archive.read(MANIFEST)), archive.namelist()
    space = "{http://fmi-standard.org/fmi-ls-manifest}"
    assert (root.tag, root.get(f"{space}fmi-ls-name")) == ("fmiReferences", "org.fmi-standard.fmi-ls-ref")
    assert root.get(f"{space}fmi-ls-version") and root.get(f"{space}fmi-ls-description").startswith("Layered Standard")
    told = [(e.get("source"), e.get("role"), e.get("type")) for e in root]
    assert told == [
        ("smoke-test.exp", "experiment/smoke-test", "application/x-ma-hs-experiments"),
        ("validation.exp", "experiment/validation", "application/x-ma-hs-experiments"),
        ("credibility.toml", "report", "application/toml"),
    ]
    assert all(INSIDE + source in names for source, _, _ in told)
    with zipfile.ZipFile(fmu) as archive:
        text = archive.read("documentation/fmi-ls-ref.txt").decode()
    assert all(source in text for source, _, _ in told) and "less than 1e-06 of the range" in text


def test_an_experiment_has_the_inputs_and_the_starts_of_the_recording_and_none_of_its_outputs(fmu):
    with zipfile.ZipFile(fmu) as archive:
        [one] = experiments_of(archive.read(f"{INSIDE}validation.exp"), f"{INSIDE}validation.exp")
        stimuli, expected = (series_of(archive.read(name), name) for name in (one.stimuli, one.references))
        starts = archive.read(one.parameters).decode()
    assert (one.name, one.start, round(one.stop, 9), one.held) == ("bench_7", 0.0, 1.98, True)
    assert (stimuli.columns["force"] == bench()["force"]).all() and list(stimuli.columns) == ["force"]
    assert list(expected.columns) == ["place", "power", "clock"]
    assert expected.columns["place"][0] == 0.3 and np.ptp(expected.columns["place"]) > 0.05
    assert re.findall(r'name="([^"]+)">\s*<ssv:Real value="([^"]+)" unit="m"', starts) == [("mass.s.start", "0.3")]


def test_without_being_asked_nothing_of_a_recording_goes_along(tmp_path):
    path = carrying(tmp_path / "m.fmu", experiments=())
    with zipfile.ZipFile(path) as archive:
        names = [n.removeprefix(INSIDE) for n in archive.namelist() if n.startswith(INSIDE)]
    smoke = ["smoke-test-in.csv", "smoke-test-ref.csv", "smoke-test-start.ssv", "smoke-test.exp"]
    assert names == ["credibility.toml", "fmi-ls-manifest.xml", *smoke]


def test_a_smoke_test_that_is_not_small_stays_out_and_the_rest_goes_along(tmp_path, monkeypatch):
    monkeypatch.setattr(reference_files, "SMALL", 100)
    rows = rows_of(carrying(tmp_path / "m.fmu"))
    assert rows["related files"] == ("pass", "FMI-LS-REF: 1 experiment/validation, 1 report; experiments: bench_7")


def test_the_same_arguments_give_the_same_bytes(fmu, tmp_path):
    assert carrying(tmp_path / "again.fmu").read_bytes() == fmu.read_bytes()


def test_what_was_asked_and_is_too_much_is_refused_and_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr(reference_files, "LARGEST", 1000)
    with pytest.raises(DeclarationError, match=r"1 experiments are .* Take fewer or shorter recordings"):
        carrying(tmp_path / "m.fmu")
    assert not list(tmp_path.iterdir())


# -- run again -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("options", [{"kind": "me"}, {"fmi": 3, "kind": "both"}], ids=str)
def test_every_experiment_gives_its_numbers_again(tmp_path, options):
    path = carrying(tmp_path / "m.fmu", **options)
    found, replays = carried_rows(path, describe_fmu(path, {}, {}), True, True, 60.0)
    rows = dict(found)
    assert {name: rows[name][0] for name in ("replay reference", "replay bench_7")} == {
        "replay reference": "pass",
        "replay bench_7": "pass",
    }
    assert [(r.experiment, r.output) for r in replays[3:]] == [("bench_7", n) for n in ("place", "power", "clock")]
    allowed = 1e-2 if options.get("kind") == "me" else 1e-6
    assert all(r.allowed == allowed and r.passed and 0.9 < r.margin <= 1 for r in replays)


@pytest.mark.parametrize("period", [0.01, 0.03])
def test_a_learned_block_starts_and_runs_as_simulate_does_at_its_own_samples(tmp_path, period):
    block = lag_block()
    time = np.arange(0.0, 3.0, period)
    columns = {"command": np.sin(time), "angle": 0.1 + 0 * time, "rate": 0.2 + 0 * time}
    record = Record(time, columns, {"command": "V", "angle": "rad", "rate": "rad/s"}, "bench")
    path = export_fmu(block, tmp_path / "lag.fmu", experiments=[reference_experiment(block, record)])
    assert rows_of(path)["replay bench"][0] == "pass"


def test_check_tells_what_is_inside_and_runs_it_again_only_when_asked(fmu):
    rows, replays = carried_rows(fmu, describe_fmu(fmu, {}, {}), True, False, 60.0)
    assert [name for name, _ in rows] == ["related files", "record"] and not replays
    again = check_fmu(fmu, replay=True)
    assert "1 experiment/validation" in again["related files"].detail and again["related files"].passed
    assert "PASS, held: “place.rmse < 1 mm” (+50 %)" in again["record"].detail and again["record"].passed
    assert again.passed and len(again.replays) == 6 and again["replay bench_7"].passed


def test_other_numbers_fail_with_the_output_and_how_far_it_is_off(fmu, tmp_path):
    name = f"{INSIDE}validation-ref.csv"

    def more(text: str) -> str:
        series = series_of(text.encode(), name)
        place = series.columns["place"] + np.where(series.time > 1.0, 0.02 * np.ptp(series.columns["place"]), 0.0)
        return series_text(series.time, {**series.columns, "place": place})

    path = edited(fmu, tmp_path / "m.fmu", {name: more})
    found, replays = carried_rows(path, describe_fmu(path, {}, {}), True, True, 60.0)
    rows = dict(found)
    verdict, detail = rows["replay bench_7"]
    assert verdict == "FAIL" and detail.startswith("3 outputs, missed: place 0.02")
    place, power = replays[3:5]
    assert (place.passed, power.passed) == (False, True) and place.margin < -1000
    assert rows["replay reference"][0] == "pass"
    assert "validation-ref.csv" in rows["record"][1]  # the record knows the file by its hash


# -- what can be wrong ---------------------------------------------------------------------------------------------
WRONG = {
    "a file is missing": (
        {f"{INSIDE}validation-ref.csv": None}, "replay bench_7", "'extra/.*validation-ref.csv' is not in the FMU"
    ),
    "cut off after a row": (
        {f"{INSIDE}validation-ref.csv": lambda t: "".join(t.splitlines(True)[:40])},
        "replay bench_7", r"ends at 0.76 s and the experiment at 1.98 s, so it was cut",
    ),
    "cut off in a row": (
        {f"{INSIDE}validation-in.csv": lambda t: t[: t.rindex(",")]}, "replay bench_7", "row 101 has 1 of 2 numbers"
    ),
    "a word in a column": (
        {f"{INSIDE}validation-in.csv": lambda t: re.sub(r"(?m)^(1\.\d+),.*$", r"\1,broken", t, count=1)},
        "replay bench_7", "row 52 holds 'broken', which is no number",
    ),
    "time runs back": (
        {f"{INSIDE}validation-in.csv": lambda t: t + "0.5,1\n"}, "replay bench_7", "time runs back after 1.98 s"
    ),
    "an unknown output": (
        {f"{INSIDE}validation-ref.csv": swapped("power", "powr")}, "replay bench_7", "no variable 'powr' .* 'power'"
    ),
    "an unknown input": (
        {f"{INSIDE}validation-in.csv": swapped("force", "forec")}, "replay bench_7", "no variable 'forec' .* 'force'"
    ),
    "an output as input": (
        {f"{INSIDE}validation-in.csv": swapped("force", "place")}, "replay bench_7", "'place' is no input of the FMU"
    ),
    "an unknown parameter": (
        {f"{INSIDE}validation-start.ssv": swapped("mass.s.start", "mass.s.stat")},
        "replay bench_7", "no variable 'mass.s.stat' .* 'mass.s.start'",
    ),
    "a unit that does not fit": (
        {f"{INSIDE}validation-ref.csv": swapped("place", "place [kg]")}, "replay bench_7", "'place': .*kg"
    ),
    "a start in another unit": (
        {f"{INSIDE}validation-start.ssv": swapped('unit="m"', 'unit="s"')}, "replay bench_7", "'mass.s.start': .*s"
    ),
    "results outside": (
        {f"{INSIDE}validation.exp": swapped("validation-ref.csv", "../../../../etc/passwd")},
        "replay bench_7", "etc/passwd' is no file inside the FMU",
    ),
    "no results but the time": (
        {f"{INSIDE}validation-ref.csv": lambda t: re.sub(r"(?m),.*$", "", t)},
        "replay bench_7", "no column but the time",
    ),
    "two columns of a name": (
        {f"{INSIDE}validation-ref.csv": swapped("power", "place")}, "replay bench_7", "'place' stands in two columns"
    ),
    "a result that is no finite number": (
        {f"{INSIDE}validation-ref.csv": lambda t: re.sub(r"(?m)^(1\.\d+),[^,]*", r"\1,nan", t, count=1)},
        "replay bench_7", "row 52 of 'place' holds no finite number",
    ),
    "an endless agreement": (
        {f"{INSIDE}validation.exp": lambda t: re.sub('agreement="[^"]*"', 'agreement="inf"', t)},
        "replay bench_7", "its agreement is inf",
    ),
    "an agreement below nothing": (
        {f"{INSIDE}validation.exp": lambda t: re.sub('agreement="[^"]*"', 'agreement="-1"', t)},
        "replay bench_7", "its agreement is -1",
    ),
    "an end before the beginning": (
        {f"{INSIDE}validation.exp": lambda t: re.sub('stopTime="[^"]*"', 'stopTime="-4"', t)},
        "replay bench_7", "it ends at -4 s and begins at 0 s",
    ),
    "no step": (
        {f"{INSIDE}validation.exp": lambda t: re.sub('stopTime="', 'stepSize="0" stopTime="', t) if "stepSize" not in t
         else re.sub('stepSize="[^"]*"', 'stepSize="0"', t)},
        "replay bench_7", "its step is 0 s",
    ),
    "no XML": ({f"{INSIDE}validation.exp": "<Experiments"}, "replay validation.exp", "this is no XML"),
    "another XML": ({f"{INSIDE}validation.exp": "<A/>"}, "replay validation.exp", "no experiments .* 'A'"),
    "no manifest": ({MANIFEST: "<A/>"}, "related files", "no manifest of FMI-LS-REF"),
    "no role": ({MANIFEST: '<fmiReferences><Related source="a"/></fmiReferences>'}, "related files", "has no role"),
    "edited parameters": (
        {"modelDescription.xml": swapped('start="2.0"', 'start="2.5"')}, "record", "no longer holds: parameter values"
    ),
    "a newer record": (
        {RECORD: swapped("hydrotwin-credibility/1", "hydrotwin-credibility/2")}, "record", "of another version"
    ),
    "half a record": ({RECORD: lambda t: t[: len(t) // 2]}, "record", "damaged"),
    "a record that was improved": ({RECORD: swapped("value = 0.0005", "value = 0.0001")}, "record", "was changed"),
    "no record": ({RECORD: None}, "record", "is not in the FMU"),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_said_and_fails_where_it_is_to_be_run_again(without_smoke, tmp_path, what):
    changes, row, says = WRONG[what]
    path = edited(without_smoke, tmp_path / "m.fmu", changes)
    verdict, detail = rows_of(path)[row]
    assert verdict == "FAIL" and re.search(says, detail), detail
    told = rows_of(path, again=False)
    assert all(v != "FAIL" for v, _ in told.values())  # the layered standard is no rule of FMI
    assert row.startswith("replay bench") or told[row][0] == "remark"


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("modelDescription.xml", '<BaseUnit m="1" />', '<BaseUnit m="1" factor="0.001" />'),  # the same numbers, in mm
        ("modelDescription.xml", 'measured="place"', 'measured="power"'),  # where a comparison lets a state start
        ("sources/model.c", "{", "{ "),  # of who compiles it elsewhere
    ],
)
def test_an_fmu_that_says_or_computes_another_thing_has_no_record_any_more(
    without_smoke, tmp_path, name, before, after
):
    path = edited(without_smoke, tmp_path / "m.fmu", {name: swapped(before, after)})
    verdict, detail = rows_of(path, again=False)["record"]
    assert verdict == "remark" and f"changed or are gone: {name}." in detail


def test_an_fmu_may_be_passed_on_without_its_sources(without_smoke, tmp_path):
    with zipfile.ZipFile(without_smoke) as archive:
        sources = [name for name in archive.namelist() if name.startswith("sources/")]
    path = edited(without_smoke, tmp_path / "m.fmu", dict.fromkeys(sources))
    assert len(sources) > 5 and rows_of(path, again=False)["record"][0] == "pass"


def test_a_missing_file_of_the_manifest_is_a_remark(fmu, tmp_path):
    path = edited(fmu, tmp_path / "m.fmu", {f"{INSIDE}validation.exp": None})
    verdict, detail = rows_of(path, again=False)["related files"]
    assert verdict == "remark" and "not in the FMU: validation.exp" in detail


def test_an_fmu_without_experiments_has_nothing_to_run_again(fmus, fmu, tmp_path):
    with pytest.raises(
        DeclarationError, match=r"nothing to run again \(it carries no experiments along\).*--experiment"
    ):
        check_fmu(fmus["lag"], replay=True)
    with pytest.raises(DeclarationError, match="starts at 3 s, and runs begin at 0 here"):
        late = {name: swapped('startTime="0.0"', 'startTime="3.0"') for name in _sets()}
        check_fmu(edited(fmu, tmp_path / "late.fmu", late), replay=True)


def _sets() -> list[str]:
    return [f"{INSIDE}{name}.exp" for name in ("smoke-test", "validation")]


def test_a_record_with_a_missed_criterion_is_a_remark(tmp_path):
    missed = Evidence(**{**vars(EVIDENCE), "criteria": ({**EVIDENCE.criteria[0], "passed": False, "margin": -0.5},)})
    path = carrying(tmp_path / "m.fmu", credibility=Credibility((missed,)), experiments=())
    verdict, detail = rows_of(path, again=False)["record"]
    assert verdict == "remark" and "FAIL, missed: “place.rmse < 1 mm” (-50 %)" in detail


def test_a_missed_criterion_fails_a_replay_as_it_fails_the_check_of_a_model_file(tmp_path):
    missed = Evidence(**{**vars(EVIDENCE), "criteria": ({**EVIDENCE.criteria[0], "passed": False, "margin": -0.5},)})
    found = check_fmu(carrying(tmp_path / "m.fmu", credibility=Credibility((missed,))), replay=True)
    assert not found.passed and {r.name: r.verdict for r in found.rows}["record"] == "FAIL"


def test_a_binary_that_came_later_is_none_that_the_record_is_of(without_smoke, tmp_path):
    """One for Windows in an FMU of Linux had passed a replay, and would run there."""
    path = edited(without_smoke, tmp_path / "more.fmu", {"binaries/win64/mass.dll": "of another machine"})
    verdict, detail = rows_of(path)["record"]
    assert verdict == "FAIL" and "were added after it was made: binaries/win64/mass.dll." in detail
