"""The demo on a few seconds of the shipped recordings: every file is there, whole, and agrees with the others."""

from __future__ import annotations

import json
from functools import partial
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from junitparser import JUnitXml

import hydrotwin as ht
from hydrotwin.commands import demonstrating
from tests.face.command_line import SHIPPED, contents, hydrotwin, short

FILES = [
    "cehA_identified.fmu",
    "cehA_network.fmu",
    "compare.json",
    "criteria.xml",
    "friction.html",
    "friction.json",
    "friction.md",
    "gap/gap.json",
    "gap/model.mo",
    "gap/model.toml",
    "gap/report.html",
    "gap/report.md",
    "model.toml",
    "network.npz",
    "network.toml",
    "report.html",
    "report.md",
]
discover = import_module("hydrotwin.discovery.discover")  # the package has a function of that name
SOUGHT = ["internal_leakage", "dead_time"]
CONTENDERS = [
    "cehA as given",
    "identified",
    "with the named effect",
    "network",
    "eq17",
    "identified, as FMU",
    "network, as FMU",
]


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The folder of the C-EHA after ``hydrotwin demo`` on 6 s of each recording, and what the demo said.

    Of the catalogue it looks at two effects only: searches of all of it are tested where they are made.
    """
    examples, out = tmp_path_factory.mktemp("examples"), tmp_path_factory.mktemp("out")
    for source in sorted((SHIPPED / "cehA/recordings").glob("*.csv")):
        short(source, examples / "cehA/recordings" / source.name, 60.0 if "friction" in source.name else 6.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demonstrating, "EXAMPLES", examples)
        patch.setattr(discover, "discover", partial(discover.discover, effects=SOUGHT, effort="quick"))
        answer = hydrotwin("demo", "--machine", "cehA", "--budget", "2", "--out", out)
    return out / "cehA", answer


@pytest.fixture(scope="module")
def data(demo):
    return json.loads((demo[0] / "compare.json").read_text(encoding="utf-8"))


def rmse(data: dict, model: str, output: str, mode: str = "free run") -> float:
    (mean,) = (m for m in data["means"] if (m["model"], m["output"], m["mode"]) == (model, output, mode))
    return mean["rmse"]


def test_the_demo_writes_every_file_and_no_other(demo):
    folder, answer = demo
    assert answer.code == 0, answer.said
    assert list(contents(folder)) == FILES


def test_the_demo_tells_every_stage(demo):
    said = demo[1].said
    stages = ("identify", "friction test", "learn", "export and check", "what is missing", "compare")
    places = [said.find(f"cehA: {stage}") for stage in stages]
    assert -1 not in places and places == sorted(places)
    assert "done in" in said
    assert said.count("all checks passed") == 2 and "FAILED" not in said


def test_all_seven_contenders_ran_without_a_failure(data):
    assert [m["name"] for m in data["models"]] == CONTENDERS
    assert data["failures"] == []
    assert {s["model"] for s in data["scores"]} == set(CONTENDERS)
    assert len(data["fits"]) == 1


def test_identification_brings_the_model_nearer_to_the_machine(data):
    assert rmse(data, "identified", "pressure_cap") < rmse(data, "cehA as given", "pressure_cap")


def test_the_demo_names_what_the_recordings_hide_and_adds_it(demo):
    folder, answer = demo
    found = json.loads((folder / "gap/gap.json").read_text(encoding="utf-8"))
    (step,) = found["steps"]
    assert found["verdict"] in ("named", "class"), "six seconds may not tell laws of a leak apart"
    assert step["effect"] == "internal_leakage" and step["probability"] > 0.4
    assert "cylinder.cap" in step["site"] and "cylinder.annulus" in step["site"]
    (conductance,) = step["parameters"].values()
    assert conductance["value"] == pytest.approx(1e-14, rel=0.05)
    assert "extends" in (folder / "gap/model.mo").read_text(encoding="utf-8")
    for words in ("Missing in the model: internal leakage", "95 % interval", "gap closed"):
        assert words in answer.said


def test_the_named_effect_brings_the_model_to_the_noise_of_its_sensors(demo, data):
    noise = json.loads((demo[0] / "gap/gap.json").read_text(encoding="utf-8"))["noise"]
    for output in ("rod_position", "pressure_cap", "pressure_rod"):
        left = rmse(data, "with the named effect", output)
        assert left < 2 * noise[output], output
        assert left < rmse(data, "identified", output), output


def test_the_demo_scores_the_speed_of_the_arm_for_all_contenders(data):
    scored = {m["model"] for m in data["means"] if m["output"] == "arm_angle.rate"}
    assert scored == set(CONTENDERS)
    assert {m["unit"] for m in data["means"] if m["output"] == "arm_angle.rate"} == {"rad/s"}


def test_the_fmu_of_the_model_scores_like_the_model(data):
    for output in ("arm_angle", "motor_speed", "pressure_cap", "pressure_rod"):
        assert rmse(data, "identified, as FMU", output) == pytest.approx(rmse(data, "identified", output), rel=1e-6)


def test_the_fmu_of_the_network_is_the_network(demo):
    folder, _ = demo
    record = ht.read_record(SHIPPED / "cehA/recordings/validate_1.csv").window(0.0, 4.0)
    network, fmu = ht.load(folder / "network.toml"), ht.load(folder / "cehA_network.fmu")
    angles = [run["arm_angle"] for run in (ht.simulate(network, record), fmu.free_run(record))]
    assert angles[1] == pytest.approx(angles[0], abs=1e-9)


def suite(folder):
    """The criteria as a public parser of JUnit reads them."""
    (found,) = JUnitXml.fromfile(str(folder / "criteria.xml"))
    return found


def test_the_completed_model_meets_the_criteria_and_every_screen_says_so(demo, data):
    folder, answer = demo
    assert "PASS: with the named effect meets all 5 criteria" in answer.said
    assert data["answer"].startswith("PASS: with the named effect") and data["acceptance"]["passed"]
    assert "PASS: with the named effect" in (folder / "report.md").read_text(encoding="utf-8")
    found = suite(folder)
    assert (found.tests, found.failures) == (5, 0)
    assert [case.name for case in found] == list(demonstrating.CRITERIA["cehA"])


def test_the_demo_has_bands_of_every_kind_and_its_recordings_have_tags(data):
    sources = {m["name"]: {b["source"] for b in m["bands"].values()} for m in data["models"]}
    assert sources["identified"] == sources["with the named effect"] == {"sensitivities"}
    assert sources["network"] == {"conformal"} and not sources["eq17"]
    untrusted = [n for n in data["notices"] if "bands of identified cannot be trusted" in n]
    assert untrusted, "an effect is missing in it"
    assert [r["tags"] for r in data["recordings"] if r["role"] == "validate"] == [{"run": "1"}, {"run": "2"}]


def test_the_wrong_model_fails_the_demo(demo, monkeypatch):
    folder, _ = demo
    recordings = [ht.read_record(SHIPPED / f"cehA/recordings/validate_{k}.csv").window(0.0, 3.0) for k in (1, 2)]
    wrong, network = ht.load(folder / "model.toml"), ht.load(folder / "network.toml")  # what is missing is not in it
    fit = SimpleNamespace(name="fit", parameters=())
    told = []
    monkeypatch.setattr("hydrotwin.report.write_report", lambda *a, accepted, **b: told.append(accepted) or {})
    other = folder.parent / "wrong"
    other.mkdir()
    models = (wrong, wrong, network, [])
    assert demonstrating.compare_all("cehA", other, models, fit, [], recordings) is False
    (accepted,) = told
    assert accepted.model == "with the named effect" and not accepted.passed
    found = suite(other)
    assert found.failures > 0 and sum(bool(case.result) for case in found) == found.failures
    monkeypatch.setattr(demonstrating, "run_machine", lambda *_: False)
    assert hydrotwin("demo", "--machine", "cehA", "--out", other).code == 1


def test_what_the_demo_wrote_loads_and_runs(demo):
    folder, _ = demo
    record = ht.read_record(SHIPPED / "cehA/recordings/validate_1.csv").window(0.0, 4.0)
    for name in ("model.toml", "network.toml", "gap/model.toml"):
        angle = ht.simulate(ht.load(folder / name), record)["arm_angle"]
        assert np.isfinite(angle).all()
    assert "<html" in (folder / "report.html").read_text(encoding="utf-8")
    assert "cehA: physical, learned and exported models" in (folder / "report.md").read_text(encoding="utf-8")


def test_the_demo_without_its_recordings_says_how_to_make_them(tmp_path, monkeypatch):
    monkeypatch.setattr(demonstrating, "EXAMPLES", tmp_path / "nothing")
    answer = hydrotwin("demo", "--machine", "spool_valve", "--out", tmp_path / "out")
    assert answer.code == 2
    assert "examples/spool_valve/make_recordings.py" in answer.said
    assert not (tmp_path / "out/spool_valve").exists()


def test_the_recordings_and_the_machines_of_the_demo_ship_together():
    for machine, (column_in, column_out) in demonstrating.LEARNED.items():
        folder = demonstrating.EXAMPLES / machine / "recordings"
        for pattern in ("train_*.csv", "validate_*.csv"):
            first = ht.read_record(min(folder.glob(pattern)))
            assert column_in in first and column_out in first
        assert (folder.parent / "make_recordings.py").is_file()
