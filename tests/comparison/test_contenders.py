"""The adapters over real simulation: a model, a block made from it, and its FMU predict the same."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.comparison import BlockContender, Contender, PhysicalContender, as_contender, compare
from hydrotwin.models import cehA
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.records import Record
from hydrotwin.simulation import lower, simulate

MODEL = cehA.model()


@pytest.fixture(scope="module")
def record():
    """Two seconds of the C-EHA moving gently, simulated."""
    time = np.arange(0.0, 2.0, 0.01)
    command = 1.5 * np.sin(2 * np.pi * 0.4 * time)
    driven = Record(
        time, {"command": command, "arm_angle": np.full_like(time, 0.3)}, {"command": "V", "arm_angle": "rad"}
    )
    outputs = simulate(MODEL, driven)
    return Record(time, {"command": command, **outputs.signals}, {"command": "V", **outputs.units}, "gentle")


def test_a_model_reproduces_its_own_simulation(record):
    comparison = compare([PhysicalContender(MODEL)], [record], repeats=1)
    assert not comparison.failures
    for score in comparison.scores:
        assert score.rmse <= 1e-6 * np.abs(record[score.output]).max(), score


def test_a_model_takes_part_as_it_is(record):
    comparison = compare([MODEL], [record], modes=["free run"], repeats=1)
    assert {s.model for s in comparison.scores} == {"cehA"} and not comparison.failures
    with pytest.raises(DeclarationError, match="a str cannot take part"):
        compare(["cehA"], [record])


def test_a_start_may_belong_to_one_recording(record):
    raised = PhysicalContender(MODEL, "raised", start={"gentle": {"arm.angle": 0.5}, "other": {"arm.angle": 0.1}})
    assert raised.free_run(record)["arm_angle"][0] == pytest.approx(0.5)
    unknown = Record(record.time, record.signals, record.units, "unknown")
    assert raised.free_run(unknown)["arm_angle"][0] == pytest.approx(0.3)


def test_changed_parameters_and_starts_change_the_prediction(record):
    gain = PhysicalContender(MODEL, "more gain", parameters={"motor.gain": 132.0})
    comparison = compare([PhysicalContender(MODEL), gain], [record], modes=["free run"], repeats=1)
    assert [s.model for s in comparison.ranking("motor_speed")] == ["cehA", "more gain"]
    assert comparison.ranking("motor_speed")[1].fit_percent == pytest.approx(90.0, abs=1.0)


def test_a_lowered_block_competes_with_its_model(record):
    block = lower(MODEL, period=1e-3)
    contender = BlockContender(block, kind="lowered", name="block")
    assert isinstance(contender, Contender)
    comparison = compare([PhysicalContender(MODEL), contender], [record], modes=["free run"], repeats=1)
    assert not comparison.failures
    block_score = next(s for s in comparison.scores if s.model == "block" and s.output == "arm_angle")
    assert block_score.fit_percent > 99.0


def test_as_contender_takes_models_flat_models_and_blocks():
    assert as_contender(MODEL).kind == "physical"
    assert as_contender(MODEL.flat, "mine").name == "mine"
    assert as_contender(lower(MODEL, period=1e-3)).kind == "learned"
    assert as_contender(MODEL).parameters == MODEL.flat.parameters


def test_a_block_says_what_it_is_in_its_provenance():
    from hydrotwin.learned import published_formula

    assert as_contender(published_formula()).kind == "formula"
