"""Every model x variant x recording: the same numbers wherever and however often, and what fails costs itself."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hydrotwin
from hydrotwin.comparison import Where, compare, read_scenario, run_matrix, run_scenario
from hydrotwin.comparison.comparison import Inaccurate
from hydrotwin.models import cehA
from hydrotwin.models.language.errors import DeclarationError, UnitError
from hydrotwin.records import read_record, row_of, write_record
from hydrotwin.report import as_html, as_markdown, matrix_page
from hydrotwin.report.matrix import variants_data
from hydrotwin.work.executor import executor_for
from hydrotwin.work.memory import Memory
from tests.comparison.toys import Toy
from tests.identification.drive import drive, recorded

MODELS = """
models = [{model = "drive", name = "good"}, {model = "weak", name = "weak"}, "hold_last"]
validate = ["load*.csv"]
tags = "load{load}"
"""
VARIANTS = """
[variants.cold]
parameters = {"motor.time_constant" = "200 ms"}
models = ["good"]
[variants.slow]
period = 0.04
[variants.started]
initial_states = "auto"
"""


def models(name: str):
    """What a scenario of these tests may name."""
    return {"drive": drive(), "weak": drive().with_parameters({"motor.gain": 9.0}), "toy": Toy("toy")}[name]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("matrix")
    for k in (1, 2):
        write_record(recorded(drive(), k, noise={"position": 1e-3, "motor_speed": 0.05}), path / f"load{k}.csv")
    return path


def scenario(folder: Path, text: str):
    path = folder / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    return read_scenario(path)


@pytest.fixture(scope="module")
def described(folder):
    return scenario(folder, MODELS + VARIANTS)


@pytest.fixture(scope="module")
def here(described):
    return run_matrix(described, models, repeats=1)


def numbers(matrix) -> list:
    """All that a matrix found, without run times."""
    found = []
    for run in matrix.runs:
        c = run.comparison
        found += [repr(rows) for rows in (c.scores, c.means, c.residuals, c.starts, c.failures, c.unscored, c.domains)]
        found += [
            (t.model, t.record, t.mode, n, v.tobytes()) for t in c.trajectories for n, v in t.prediction.signals.items()
        ]
    return found


def test_every_variant_is_the_comparison_that_it_says(described, here, folder):
    assert [run.name for run in here.runs] == ["base", "cold", "slow", "started"]
    assert numbers_of(here, "base") == repr(run_scenario(described, models, repeats=1).scores)
    cold = here["cold"].comparison
    rmse = {s.model: s.rmse for s in cold.means if (s.output, s.mode) == ("motor_speed", "free run")}
    base = {s.model: s.rmse for s in here.base.means if (s.output, s.mode) == ("motor_speed", "free run")}
    assert rmse["good"] > 2 * base["good"] and rmse["weak"] == base["weak"]
    alone = compare([drive().with_parameters({"motor.time_constant": 0.2})], here.base.records, repeats=1)
    assert rmse["good"] == next(s.rmse for s in alone.means if s.output == "motor_speed" and s.mode == "free run")
    assert [len(r.time) for r in here["slow"].comparison.records] == [250, 250]
    assert {s.model for s in here["started"].comparison.starts} == {"good", "weak"} and not here.base.starts


def numbers_of(matrix, name: str) -> str:
    return repr(matrix[name].comparison.scores)


def test_models_that_a_variant_leaves_as_they_are_are_told(here):
    assert here["cold"].as_base == ("weak", "hold last sample")
    assert here["slow"].as_base == () and here["started"].as_base == ("hold last sample",)


def test_the_rows_of_all_variants_are_one_table(here):
    rows = here.table("means").to_pylist()
    assert {r["variant"] for r in rows} == {"base", "cold", "slow", "started"}
    assert {r["load"] for r in here.table().to_pylist()} == {"1", "2"}


def test_a_notebook_and_plotly_show_the_matrix(here):
    assert ">cold</td>" in here._repr_html_() and "4 variants" in repr(here)
    assert [name for name in hydrotwin.figures(here) if name.startswith("heat-")] == [
        "heat-position",
        "heat-motor_speed",
    ]


def test_processes_give_the_same_numbers_to_the_last_bit(described, here):
    with executor_for("processes", workers=2) as pool:
        assert numbers(run_matrix(described, models, Where(pool), repeats=1)) == numbers(here)


def test_two_dask_workers_give_the_same_numbers_to_the_last_bit(described, here):
    pytest.importorskip("distributed")
    with executor_for("dask", workers=2) as pool:
        assert numbers(run_matrix(described, models, Where(pool), repeats=1)) == numbers(here)


KILLED = """
import os, signal, sys
from hydrotwin.comparison import Where, read_scenario, run_matrix
from hydrotwin.work.memory import Memory
from tests.comparison.test_matrix import models

def told(done, total, what):
    if done >= 6:
        os.kill(os.getpid(), signal.SIGKILL)

run_matrix(read_scenario(sys.argv[1]), models, Where(memory=Memory(sys.argv[2]), progress=told), repeats=1)
"""


def test_a_killed_run_goes_on_where_it_was_and_a_second_call_makes_none(described, here, folder, tmp_path, monkeypatch):
    words = [sys.executable, "-c", KILLED, str(folder / "scenario.toml"), str(tmp_path / "kept")]
    answer = subprocess.run(words, cwd=Path(__file__).resolve().parents[2], capture_output=True, text=True, timeout=120)
    assert answer.returncode == -signal.SIGKILL, answer.stderr
    memory = Memory(tmp_path / "kept")
    assert len(memory) == 3  # two modes each
    assert numbers(run_matrix(described, models, Where(memory=memory), repeats=1)) == numbers(here)

    def never(job):
        raise AssertionError("a finished run is made again")

    never.__module__, never.__qualname__ = "hydrotwin.comparison.job", "run_job"
    monkeypatch.setattr("hydrotwin.comparison.run.run_job", never)
    assert numbers(run_matrix(described, models, Where(memory=memory), repeats=1)) == numbers(here)


def test_only_what_a_call_asked_for_is_kept(described, folder, tmp_path):
    Memory(tmp_path).put("ab", {"old": 1})
    memory = Memory(tmp_path)
    run_matrix(replace(described, variants=()), models, Where(memory=memory), repeats=1)
    count = len(memory)
    memory.forget_others()
    assert len(memory) == count - 1 == 6 and memory.get("ab") is None


def test_a_variant_that_fails_costs_itself_and_says_why(folder, here):
    broken = '[variants.broken]\nparameters = {"motor.time_constant" = -1e-4}\nmodels = ["good", "weak"]\n'
    found = run_matrix(scenario(folder, MODELS.replace(', "hold_last"', "") + broken + VARIANTS), models, repeats=1)
    assert "left the finite numbers" in found["broken"].failed
    assert len(found["broken"].comparison.failures) == 8 and not found["broken"].comparison.scores
    good = [s.rmse for s in here["cold"].comparison.means if s.model == "good"]
    assert [s.rmse for s in found["cold"].comparison.means if s.model == "good"] == good


def test_criteria_are_about_every_variant_or_those_they_name(folder):
    said = 'accept = ["position.rmse < 100 m", "variant=c*: load=2: motor_speed.rmse < 0.01 rad/s"]\n'
    found = run_matrix(scenario(folder, said + MODELS + VARIANTS), models, repeats=1)
    texts = [[one.criterion.text for one in run.accepted.judged] for run in found.runs]
    assert [len(own) for own in texts] == [1, 2, 1, 1]
    assert not found.accepted.passed and found["slow"].accepted.passed
    assert found.accepted.judged[0].criterion.text == "variant=cold: load=2: motor_speed.rmse < 0.01 rad/s"
    assert [one.passed for one in found.accepted.judged] == [False, True, True, True, True]


def test_recordings_of_a_training_are_known_where_a_variant_thins_them_out(folder):
    """Of a copy in other bytes every variant said that the model was made from it, but for the one with a period."""
    seen = drive().with_parameters({"motor.gain": 9.0})
    row = row_of(read_record(folder / "load1.csv"), ("command", "position")) | {
        "sha256": "other bytes",
        "role": "train",
    }
    seen = replace(seen, provenance={"recordings": [row]})
    said = 'accept = ["position.rmse < 100 m"]\nmodes = ["free run"]\n'
    text = (
        said + MODELS.replace('{model = "weak", name = "weak"}, "hold_last"', "") + "[variants.slow]\nperiod = 0.04\n"
    )
    found = run_matrix(scenario(folder, text), lambda name: seen, repeats=0)
    assert [one.seen for one in found.accepted.judged] == [("load1",), ("load1",)]


def test_a_variant_that_an_earlier_comparison_does_not_have_costs_only_itself(folder):
    from hydrotwin.report import write_report

    write_report(run_scenario(scenario(folder, MODELS), models, repeats=1), folder / "earlier")
    (folder / "earlier" / "compare.json").replace(folder / "last.json")
    said = "accept = ['position not worse than last.json by 1 %']"
    found = run_matrix(scenario(folder, f"{said}\n{MODELS}[variants.new]\nstep = 0.02"), models, repeats=1)
    assert [run.accepted.passed for run in found.runs] == [True, False]
    assert found.runs[1].accepted.judged[0].undefined == "last.json has no rmse to compare with"


def test_variants_that_are_new_gone_or_others_than_in_the_earlier_comparison_are_told(folder, tmp_path):
    from hydrotwin.report import write_matrix

    def varied(tables):
        return run_matrix(scenario(folder, f"against = '{tmp_path / 'then'}/compare.json'\n{MODELS}{tables}"), models)

    now = "[variants.slow]\nperiod = 0.04\n[variants.weak]\nparameters = {'motor.gain' = 9}\n"
    write_matrix(run_matrix(scenario(folder, MODELS + now), models), tmp_path / "then")
    assert varied(now).accepted.otherwise == ()
    told = varied("[variants.weak]\nparameters = {'motor.gain' = 8}\n[variants.fine]\nstep = 0.01\n").accepted.otherwise
    assert told == (
        "Variants new against the earlier comparison: fine.",
        "Variants no longer compared: slow.",
        "weak changed something else then: errors may differ by that alone.",
    )
    assert varied("").runs[0].accepted.otherwise == ("Variants no longer compared: slow, weak.",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "parameters = {'motor.gian' = 1}",
            "variant 'x': no model has a parameter 'motor.gian'. Did you mean 'motor.gain",
        ),
        ("parameters = {'motor.gain' = '3 bar'}", "variant 'x': .*bar"),
        ("parameters = {'motor.gain' = 'much'}", "'much' is no number"),
        ("models = ['god']\nstep = 0.1", "no model 'god'. Did you mean 'good'"),
        ("effects_off = ['leak']", "no model has an effect 'leak' to put off. None of its"),
        ("effects_on = ['leak']", "none of its models has equations"),
        ("period = 0.001", "load1 has a sample every 0.02 s .* cannot be thinned to 0.001 s"),
        ("period = 100", "cannot be thinned to 100 s"),
    ],
)
def test_what_no_model_knows_is_refused_before_anything_runs(folder, text, message, tmp_path):
    refuse(scenario(folder, f"{MODELS}[variants.x]\n{text}"), message, tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("variant=y: position.rmse < 1 m", "no variant 'y'. Known: base, x"),
        ("variant=x: positon.rmse < 1 m", "'positon'. Did you mean 'position'"),
        ("variant=x: load=3: position.rmse < 1 m", "no recordings 'load=3'. Did you mean 'load="),
    ],
)
def test_a_criterion_that_nothing_can_be_judged_by_is_refused_before_anything_runs(folder, text, message, tmp_path):
    refuse(scenario(folder, f"accept = ['{text}']\n{MODELS}[variants.x]\nstep = 0.1"), message, tmp_path)


def test_a_tag_cannot_be_called_as_variants_are(folder, tmp_path):
    text = MODELS.replace("load{load}", "load{variant}")
    refuse(scenario(folder, text + VARIANTS), "no tag can be called so", tmp_path)


def refuse(described, message: str, tmp_path) -> None:
    memory = Memory(tmp_path / "kept")
    with pytest.raises((DeclarationError, UnitError), match=message):
        run_matrix(described, models, Where(memory=memory))
    assert not memory.folder.exists()


def test_what_cannot_travel_runs_here_and_is_not_kept(folder, tmp_path):
    memory = Memory(tmp_path)
    toys = scenario(folder, 'models = ["toy", "drive"]\nvalidate = ["load1.csv"]\noutputs = ["position"]')
    found = run_matrix(toys, lambda name: models(name), Where(memory=memory), repeats=1)
    assert found.base.models == ("toy", "drive") and len(memory) == 1


def test_an_effect_is_taken_out_and_added_with_its_values():
    from hydrotwin.comparison.variants import Variant
    from hydrotwin.comparison.varied import Thing, check_variant, varied

    plain = cehA.model()
    on = Variant("leaky", {"internal_leakage.conductance": 1e-12}, effects_on=("internal_leakage",))
    check_variant([Thing("m", plain)], on, "s")
    leaky = varied(Thing("m", plain), on)
    value = leaky.flat.parameter_vector()[leaky.flat.index_of("internal_leakage.conductance")]
    assert value == 1e-12 and [a.effect for a in leaky.additions] == ["internal_leakage"]
    for word in ("internal_leakage", "internal_leakage at cylinder.annulus-cylinder.cap", "*leak*"):
        off = Variant("tight", effects_off=(word,))
        check_variant([Thing("m", leaky)], off, "s")
        tight = varied(Thing("m", leaky), off)
        assert not tight.additions and tight.settings == plain.settings
        assert [p.name for p in tight.flat.parameters] == [p.name for p in plain.flat.parameters]
    with pytest.raises(DeclarationError, match=r"no effect|Did you mean 'internal_leakage"):
        check_variant([Thing("m", leaky)], Variant("x", effects_off=("internal_leakges",)), "s")
    with pytest.raises(DeclarationError, match=r"changes nothing at the values .*internal_leakage\.conductance"):
        check_variant([Thing("m", plain)], Variant("x", effects_on=("internal_leakage",)), "s")


def test_a_run_differs_by_its_step_and_method(folder):
    text = MODELS + '[variants.fine]\nstep = 0.001\nmethod = "explicit"\n'
    found = run_matrix(scenario(folder, text), models, repeats=1)
    coarse, fine = (next(s.rmse for s in r.comparison.means if s.model == "good") for r in found.runs)
    assert coarse != fine and coarse == pytest.approx(fine, rel=1e-3)
    assert np.isfinite(fine) and found["fine"].as_base == ("hold last sample",)


TWINS = """
accept = ["variant=same: position.rmse < 100 m", "variant=again: motor_speed.rmse < 1e-9 rad/s"]
[variants.same]
parameters = {"motor.time_constant" = "100 ms", "motor.gain" = 10.0}
models = ["good"]
step = 0.01
method = "auto"
period = 0.02
initial_states = "measured"
[variants.cold]
parameters = {"motor.time_constant" = 0.2}
models = ["good"]
[variants.again]
parameters = {"motor.time_constant" = "200 ms"}
models = ["good"]
"""


def test_a_variant_that_comes_to_the_same_as_another_is_run_once_and_told(folder, tmp_path):
    done, written = [], []
    accept, _, tables = TWINS.strip().partition("\n")
    described = scenario(folder, f"{accept}\n{MODELS}\n{tables}")
    where = Where(progress=lambda n, total, what: done.append((n, total)))
    found = run_matrix(described, models, where, repeats=0, on_variant=lambda run: written.append(run.name))
    assert [run.same_as for run in found.runs] == ["", "base", "", "cold"] and written == ["base", "cold"]
    assert done[-1] == (24, 24), "3 models, 2 recordings, 2 modes, 2 variants"
    assert repr(found["again"].comparison.scores) == repr(found["cold"].comparison.scores)
    assert found["same"].as_base == ("good", "weak", "hold last sample")
    assert found["again"].as_base == ("weak", "hold last sample")
    assert (found["same"].accepted.passed, found["again"].accepted.passed) == (True, False)
    page = matrix_page(found)
    assert "Variant same comes to the same as base, and its runs stand for both." in page.notices
    assert "Variant again comes to the same as cold, and its runs stand for both." in page.notices
    every = next(t for t in page.tables if t.id == "every_position")
    assert [(r[0].text, r[1].text) for r in every.rows].count(("again", "good")) == 0
    assert {r[0].text for r in every.rows} == {"base", "cold"}
    told = {v["name"]: (v["same_as"], v["page"]) for v in variants_data(found)}
    assert told["again"] == ("cold", "cold/report.html") and told["cold"] == (None, "cold/report.html")


def test_what_is_told_of_variants_stands_on_the_overview(folder):
    """Once what all share, else behind the names of the variants that it is about."""
    text = '[variants.slow]\nperiod = 0.04\n[variants.broken]\nparameters = {"motor.time_constant" = -1e-4}\n'
    found = run_matrix(scenario(folder, MODELS.replace(', "hold_last"', "") + text), models, repeats=0)
    lost = Inaccurate("good", "load1", "good: not accurate.")
    runs = [replace(run, comparison=replace(run.comparison, inaccurate=(lost,))) for run in found.runs]
    slow = replace(runs[1], comparison=replace(runs[1].comparison, inaccurate=(lost, replace(lost, model="weak"))))
    page = matrix_page(replace(found, runs=(runs[0], slow, runs[2])))
    of = [n for n in page.notices if "not those of its equations" in n]
    assert [n.partition("The numbers")[0] for n in of] == ["", "slow: "]
    assert page.notices[0].startswith("Variant broken could not be scored: drive.motor.speed: ")
    text = as_markdown(page)
    assert all(f"> {notice}" in text for notice in page.notices)
    assert all(notice in as_html(page).replace("&#39;", "'") for notice in of)
