"""Models under a controller: the loop is a block, and behaves as the rig under the same controller."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import control
import numpy as np
import pytest

import hydrotwin
from hydrotwin.comparison import Variant, as_contender, read_scenario, run_scenario
from hydrotwin.comparison.band import bands_of
from hydrotwin.comparison.loop import Loop, in_loop, read_loop
from hydrotwin.comparison.running import load_contenders
from hydrotwin.learned import learn
from hydrotwin.models.language.errors import DeclarationError, TopologyError
from hydrotwin.models.language.provenance import made_from
from hydrotwin.simulation import lower
from hydrotwin.simulation.closed_loop import close_loop
from hydrotwin.simulation.control_system import from_control
from hydrotwin.work.memory import key_of
from tests.learned.toy_machine import ANGLE, COMMAND, toy_record, with_deviation

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "cehA" / "closed_loop"
PERIOD = 0.01
GAIN = Loop("reference", "arm_angle", "command", PERIOD, (40.0,), (1.0,), (-5.0, 5.0))


def steps(values, columns=("reference",)):
    time = np.arange(len(values)) * PERIOD
    signals = {name: np.asarray(values, float) for name in columns}
    return hydrotwin.Record(time, signals, dict.fromkeys(columns, "rad"), "steps")


def test_the_shipped_scenario_agrees_with_the_rig_up_to_the_noise_of_the_sensor():
    comparison = run_scenario(read_scenario(EXAMPLE / "scenario.toml"), hydrotwin.load, repeats=1)
    assert not comparison.failures
    scores = {(s.model, s.output): s for s in comparison.scores}
    assert scores["cehA", "arm_angle"].rmse < 1.1e-4  # the rig's sensor noise is 1e-4 rad
    assert scores["cehA", "command"].rmse < 0.01  # V of 5, in spite of the leak that the model lacks


def test_a_proportional_loop_reaches_its_reference_without_remaining_error():
    record = steps(np.where(np.arange(600) < 50, 0.1, 0.3))
    record = record.with_signals({"arm_angle": np.full(600, 0.1)}, units={"arm_angle": "rad"})
    run = in_loop(hydrotwin.load("cehA"), GAIN).free_run(record)
    assert run["arm_angle"][-1] == pytest.approx(0.3, abs=1e-4)
    assert run["command"].max() == pytest.approx(5.0)  # 40 V/rad times 0.2 rad saturates


def test_the_loop_equals_controller_and_machine_stepped_by_hand():
    plant = lower(hydrotwin.load("cehA"), PERIOD)
    loop = in_loop(hydrotwin.load("cehA"), GAIN).block
    x = np.array(plant.start([0.0], [0.1] + [np.nan] * 5, plant.parameter_vector())).ravel()
    x_loop = np.array(loop.start([0.2], [0.1] + [np.nan] * 6, loop.parameter_vector())).ravel()
    p = plant.parameter_vector()
    for _ in range(50):
        angle = float(plant.step(x, [0.0], p)[1][0])
        x, y = plant.step(x, [np.clip(40 * (0.2 - angle), -5, 5)], p)
        x_loop, y_loop = loop.step(x_loop, [0.2], p)
        np.testing.assert_allclose(np.array(y_loop).ravel()[:6], np.array(y).ravel(), rtol=1e-12)


def test_an_output_that_depends_on_the_command_at_once_is_an_algebraic_loop():
    static = control.ss([[0.0]], [[1.0]], [[0.0]], [[2.0]], PERIOD, inputs=["u"], outputs=["y"], name="static")
    gain = control.ss([[0.0]], [[0.0]], [[0.0]], [[1.0]], PERIOD, inputs=["e"], outputs=["c"], name="gain")
    with pytest.raises(TopologyError, match="algebraic loop"):
        close_loop(from_control(static), from_control(gain), feedback={"e": "y"}, command={"u": "c"})


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"measured": "arm_angel"}, "Did you mean 'arm_angle'"),
        ({"command": "voltage"}, "no input 'voltage'"),
        ({"gain": 3}, "unknown key 'gain'"),
        ({"period": "fast"}, "no number"),
    ],
)
def test_a_wrong_loop_says_what_is_wrong(change, sentence):
    table = {"reference": "reference", "measured": "arm_angle", "command": "command", "period": PERIOD,
             "numerator": [40.0], "denominator": [1.0]} | change  # fmt: skip
    with pytest.raises(DeclarationError, match=sentence):
        in_loop(hydrotwin.load("cehA"), read_loop(table, "scenario.toml"))


def test_a_loop_has_no_bands_and_says_what_its_model_was_made_from():
    """What held an open run, in which nothing makes up for errors, had been told of the loop: all of it lay inside."""
    learnt = learn("arx", [toy_record(1), toy_record(2)], [COMMAND], [ANGLE])
    rows = [{"name": "toy_9", "role": "train", "sha256": toy_record(9).digest}]
    fitted = hydrotwin.load("cehA").with_settings({}, {"recordings": rows})
    looped = [in_loop(one, dataclasses.replace(GAIN, period=one.period)) for one in (learnt, with_deviation(learnt))]
    for own in (as_contender(learnt), as_contender(with_deviation(learnt))):
        assert bands_of(own)
    for one in looped:
        assert not bands_of(one) and not one.half_widths and one.domain is learnt.domain
        assert made_from(one.provenance) == {toy_record(k).digest for k in (1, 2)}
        assert [s.name for s in one.outputs] == ["arm_angle", "command"]
    assert made_from(in_loop(fitted, GAIN).provenance) == {toy_record(9).digest}
    record = toy_record(3).with_signals({"reference": np.full(len(toy_record(3)), 0.4)}, {"reference": "rad"})
    plain, bare = (one.free_run(record)["arm_angle"] for one in looped)
    assert (plain == bare).all()


def test_a_variant_of_a_loop_steps_as_it_says():
    """Its step and its method reached no loop: the variant was the base again, and met its criteria."""
    scenario = read_scenario(EXAMPLE / "scenario.toml")

    def stepped(**changes):
        variant = Variant("v", **changes) if changes else None
        return next(c for c in load_contenders(scenario, hydrotwin.load, variant) if c.name == "cehA").content

    keys = [key_of(stepped(**changes)) for changes in ({}, {"step": 2e-4}, {"method": "implicit"}, {"method": "auto"})]
    assert len(set(keys)) == 3 and keys[3] == keys[0]
