"""A formula from recordings: searched, chosen by free runs, printed, certified, kept and exported."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import domain_share, read_block, write_block
from hydrotwin.learned.symbolic.block import CONSTANT, MULTIPLY, VARIABLE, Formula
from hydrotwin.learned.symbolic.data import prepare
from hydrotwin.learned.symbolic.front import front_rows
from hydrotwin.learned.symbolic.learn import learn_symbolic
from hydrotwin.learned.symbolic.refit import FreeRun, laid_out
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.simulation import simulate
from tests.learned.toy_machine import ANGLE, COMMAND, PERIOD, SPEED, toy_record

QUICK = {"period": PERIOD, "lags": (1, 3), "starts": 1, "generations": 15}
BRIEF = QUICK | {"generations": 10, "population": 100}


def rmse_deg(block, record):
    return float(np.degrees(np.sqrt(np.mean((simulate(block, record)["arm_angle"] - record["arm_angle"]) ** 2))))


@pytest.fixture(scope="module")
def recordings():
    return [toy_record(s, duration=10.0) for s in (1, 2, 3)]


@pytest.fixture(scope="module")
def brief_recording():
    return toy_record(1, duration=6.0)


@pytest.fixture(scope="module")
def validation():
    return toy_record(9, name="validation")


@pytest.fixture(scope="module")
def learned(recordings):
    pytest.importorskip("pyoperon")
    return learn_symbolic(recordings, [COMMAND], [ANGLE], **QUICK)


def test_a_free_run_of_the_search_is_the_free_run_of_the_block(learned, recordings):
    data = prepare(recordings, recordings[:1], (COMMAND,), (ANGLE,), PERIOD, (1, 3), False)
    formula = Formula(tuple(int(t) for t in learned.arrays["tokens"]), tuple(learned.arrays["constants"]))
    run, runs = FreeRun(formula, [0], data.shape, data.bounds), laid_out(data.series, data.judged, [0], data.shape)
    angle = run.outputs(formula.constants, runs)[0, :, 0] * data.scales["output_scale"] + data.scales["output_centre"]
    assert np.allclose(angle, simulate(learned, recordings[0])["arm_angle"], rtol=0, atol=1e-12)


def test_the_learned_formula_follows_an_unseen_recording_within_a_degree(learned, validation):
    assert rmse_deg(learned, validation) < 1.0
    assert np.degrees(np.std(validation["arm_angle"])) > 5.0


def test_free_runs_choose_better_than_the_paper_s_one_step_error(learned, recordings, validation):
    paper = learn_symbolic(recordings, [COMMAND], [ANGLE], fit="paper", generations=40, population=600)
    assert paper.period == PERIOD and paper.structure["output_lags"] == 0
    assert paper.certificate.holds
    assert rmse_deg(paper, validation) > 3 * rmse_deg(learned, validation)


def test_the_formula_can_be_read_with_its_units(learned):
    text, latex = learned.provenance["equation"], learned.provenance["latex"]
    assert text == learned.description and text.startswith("arm_angle[k+1] = arm_angle[k] + 0.00")
    assert " rad * (" in text and "command[k" in text and " V)" in text
    assert r"\mathrm{arm\_angle}[k+1] =" in latex and r"\,\mathrm{V}" in latex


def test_the_printed_formula_is_the_deployed_one(learned):
    sympy = pytest.importorskip("sympy")
    text = learned.provenance["equation"].split("; ")
    expression = sympy.parse_expr(text[0].split(" rad * ", 1)[1])
    meanings = dict(part.split(" = ", 1) for part in text[1:])
    a, y, d, u = learned.arrays, 0.55, 0.003, (0.8, -0.5, 0.3)
    read = {"arm_angle[k]": y, "arm_angle[k-1]": y - d, "command[k]": u[0], "command[k-1]": u[1], "command[k-2]": u[2]}

    def value(meaning):
        for name, number in read.items():
            meaning = meaning.replace(name, f"({number})")
        return sympy.parse_expr(meaning.replace(" rad", "").replace(" V", ""))

    increment = float(expression.subs({name: value(m) for name, m in meanings.items()})) * a["increment_scale"][0]
    after, _ = learned.step([y, d, u[1], u[2]], u[0], [])
    assert float(after[0]) - y == pytest.approx(increment, rel=5e-3)


def test_the_certificate_holds_and_catches_a_changed_constant(learned):
    from hydrotwin.learned.symbolic.certify import certify

    assert learned.certificate.holds and learned.certificate.difference <= 1e-12
    tokens, constants = (learned.arrays[name].tolist() for name in ("tokens", "constants"))
    formula = Formula(tuple(int(t) for t in tokens), tuple(constants))
    assert certify(learned, formula) == learned.certificate
    assert not certify(learned, Formula(formula.tokens, (constants[0] + 1e-6, *constants[1:]))).holds


def test_a_learned_formula_comes_back_from_its_file(learned, validation, tmp_path):
    again = read_block(write_block(learned, tmp_path / "arm.toml")[0])
    assert np.array_equal(simulate(again, validation)["arm_angle"], simulate(learned, validation)["arm_angle"])
    assert again.provenance["equation"] == learned.provenance["equation"]


def test_the_fmu_of_a_formula_runs_as_the_block_does(learned, validation, tmp_path):
    fmu = read_fmu(export_fmu(learned, tmp_path / "formula.fmu"))
    short = validation.window(None, 4.0)
    apart = simulate(learned, short)["arm_angle"] - fmu.free_run(short)["arm_angle"]
    assert np.abs(apart).max() < 1e-9


def test_the_same_seed_gives_the_same_formula_in_another_process(brief_recording):
    pytest.importorskip("pyoperon")
    block = learn_symbolic([brief_recording], [COMMAND], [ANGLE], seed=3, **BRIEF)
    lines = "from tests.learned.test_symbolic import *\nrecord = toy_record(1, duration=6.0)\n"
    lines += "b = learn_symbolic([record], [COMMAND], [ANGLE], seed=3, **BRIEF)\nprint(b.arrays['constants'])"
    again = subprocess.run([sys.executable, "-c", lines], check=True, capture_output=True, text=True)
    assert again.stdout.strip() == str(block.arrays["constants"])


def test_interrupting_the_search_keeps_the_best_so_far(brief_recording):
    pytest.importorskip("pyoperon")
    seen = []

    def interrupt(step):
        seen.append(step)
        if len(seen) == 5:
            raise KeyboardInterrupt

    block = learn_symbolic([brief_recording], [COMMAND], [ANGLE], progress=interrupt, **BRIEF)
    assert block.provenance["stopped"] == "interrupted" and block.certificate.holds
    assert block.provenance["held_out_error"] < 0.5


def test_interrupting_the_selection_keeps_the_best_so_far(brief_recording):
    pytest.importorskip("pyoperon")

    def interrupt(step):
        if getattr(step, "done", 0) == 3:
            raise KeyboardInterrupt

    block = learn_symbolic([brief_recording], [COMMAND], [ANGLE], progress=interrupt, **BRIEF)
    assert block.provenance["stopped"] == "interrupted" and block.certificate.holds


def test_the_time_budget_ends_the_work_early(brief_recording):
    pytest.importorskip("pyoperon")
    block = learn_symbolic([brief_recording], [COMMAND], [ANGLE], **BRIEF | {"budget": 1e-3})
    assert "time budget" in block.provenance["stopped"]


def test_progress_reports_every_generation_with_a_falling_error(brief_recording):
    pytest.importorskip("pyoperon")
    steps = []
    learn_symbolic([brief_recording], [COMMAND], [ANGLE], progress=steps.append, **BRIEF)
    found = [s for s in steps if hasattr(s, "generation")]
    assert [s.generation for s in found] == list(range(11))
    assert [s.best for s in found] == sorted((s.best for s in found), reverse=True)
    assert found[-1].evaluations > 100 * (1 + 10 * 3)  # with the steps on the constants of every offspring
    assert all(hasattr(s, "candidates") for s in steps[11:]) and len(steps) > 15


def test_two_outputs_are_learnt_together(recordings, validation):
    pytest.importorskip("pyoperon")
    options = BRIEF | {"select": [toy_record(5, duration=8.0)], "lags": (1, 2)}
    block = learn_symbolic(recordings[:1], ["command"], ["arm_angle", "motor_speed"], **options)
    run = simulate(block, validation)
    assert rmse_deg(block, validation) < 2.0
    error = np.sqrt(np.mean((run["motor_speed"] - validation["motor_speed"]) ** 2))
    assert error < 0.1 * np.std(validation["motor_speed"])
    assert block.outputs[1].unit == SPEED.unit and block.provenance["selected_on"][0]["name"] == "toy_5"


def test_the_domain_is_the_training_range(learned, recordings):
    assert domain_share(learned, recordings[0]).inside == 1.0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"outputs": ["arm_angel"]}, "Did you mean 'arm_angle'"),
        ({"outputs": ["command"]}, "named both as input and output"),
        ({"period": 2.0}, "too few samples"),
        ({"records": []}, "no recordings"),
    ],
)
def test_what_no_formula_can_be_learnt_from_is_refused(recordings, change, sentence):
    pytest.importorskip("pyoperon")
    asked = {"records": recordings[:1], "inputs": ["command"], "outputs": ["arm_angle"], **BRIEF} | change
    with pytest.raises(DataError, match=sentence):
        learn_symbolic(asked.pop("records"), asked.pop("inputs"), asked.pop("outputs"), **asked)


@pytest.mark.parametrize(
    "option",
    [
        {"fit": "papier"},
        {"starts": 0},
        {"population": 3},
        {"lags": (-1, 2)},
        {"tolerance": -1},
        {"budget": 0},
        {"nodes": 2},
        {"functions": "add,sinus"},
        {"static": True, "fit": "paper"},
    ],
)
def test_impossible_options_of_a_search_are_refused(recordings, option):
    pytest.importorskip("pyoperon")
    with pytest.raises(DeclarationError, match=next(iter(option))):
        learn_symbolic(recordings[:1], ["command"], ["arm_angle"], **BRIEF | option)


def test_recordings_to_validate_with_choose_nothing(brief_recording, validation):
    pytest.importorskip("pyoperon")
    other = validation.with_signals({"arm_angle": -3.0 * validation["arm_angle"]})
    blocks = [
        learn_symbolic([brief_recording], [COMMAND], [ANGLE], validate=v, **BRIEF) for v in ([validation], [other])
    ]
    for name, array in blocks[0].arrays.items():
        assert np.array_equal(array, blocks[1].arrays[name])
    timeless = [{k: v for k, v in b.provenance.items() if "second" not in k} for b in blocks]
    assert timeless[0] == timeless[1]


def test_recordings_to_select_with_choose(brief_recording):
    pytest.importorskip("pyoperon")
    chosen = [
        learn_symbolic([brief_recording], [COMMAND], [ANGLE], select=[toy_record(s, duration=6.0)], **BRIEF)
        for s in (7, 8)
    ]
    assert chosen[0].provenance["selected_on"][0]["name"] == "toy_7"
    assert chosen[0].provenance["held_out_error"] != chosen[1].provenance["held_out_error"]


def test_the_front_of_error_and_size_is_told(learned):
    rows = front_rows(learned)
    assert len(rows) > 2 and sum(r["chosen"] for r in rows) == 1
    assert [r["size"] for r in rows] == sorted({r["size"] for r in rows})
    assert [r["error"] for r in rows] == sorted((r["error"] for r in rows), reverse=True)
    assert rows[0]["unit"] == "deg" and rows[0]["error"] < 30
    assert all(r["equation"].startswith("arm_angle[k+1] = arm_angle[k] + ") for r in rows)


def test_a_formula_that_diverges_is_not_chosen(recordings):
    from hydrotwin.learned.symbolic.select import Choice, Selection

    data = prepare(recordings, [], (COMMAND,), (ANGLE,), PERIOD, (1, 3), False)
    away = Formula((CONSTANT,), (1e-3 + 3.0 / len(recordings[0]) / data.bounds.ratio[0],))  # to 3 scales within a run
    run, runs = data.run(away, [0]), data.laid_out(data.judged, [0])
    error, rms = run.errors(away.constants, runs)
    assert np.isfinite(error) and rms == error
    error, rms = run.errors([100 * away.constants[0]], runs)
    assert error == np.inf and np.isfinite(rms)
    selection = Selection(data, ["arm_angle"], Choice(1e9, 0, ()))
    assert selection._candidate(Formula((MULTIPLY, CONSTANT, VARIABLE), (1e9,)), 0, brief=False).size == 3
    assert all(np.isfinite(c.error) for c in (selection.choose([[away]]) and selection.fronts[0]))
