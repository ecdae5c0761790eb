"""Start states from the first part of a recording, against a motion whose start is known in closed form."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import hydrotwin
from hydrotwin.comparison import HoldLast, PhysicalContender, Wanted, acceptance, compare
from hydrotwin.comparison.notices import notices, starts_told
from hydrotwin.identification.beginning import estimate_start
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.provenance import SPREAD
from hydrotwin.records import Record, read_record
from hydrotwin.report.acceptance import verdict
from tests.comparison.toys import Toy, recording
from tests.identification.drive import drive, recorded

SHIPPED = Path(__file__).resolve().parents[2] / "examples"
NOISE, SPEED, POSITION, GAIN, LAG, DISPLACEMENT = 0.002, 5.0, 1.5, 10.0, 0.1, 0.2


def moved(seed: int = 0, duration: float = 10.0) -> Record:
    """The drive under a constant command from a known speed and position; only its position is measured, with noise.

    s(t) = k u + (s0 - k u) e^(-t/T),  x(t) = x0 + c (k u t + T (s0 - k u) (1 - e^(-t/T)))
    """
    time = np.arange(0.0, duration, 0.02)
    u, decayed = 0.1, 1 - np.exp(-time / LAG)
    position = POSITION + DISPLACEMENT * (GAIN * u * time + LAG * (SPEED - GAIN * u) * decayed)
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(time))
    signals = {"command": np.full_like(time, u), "position": position + noise}
    return Record(time, signals, {"command": "V", "position": "m"}, f"moved_{seed}")


@pytest.mark.parametrize("how", ["auto", "free"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_start_is_within_its_confidence(how, seed):
    found = {s.name: s for s in estimate_start(drive(), moved(seed), how).states}
    assert set(found) == {"motor.speed", "piston.position"}
    for name, truth in (("motor.speed", SPEED), ("piston.position", POSITION)):
        assert found[name].value == pytest.approx(truth, abs=3.5 * found[name].sigma)
        assert 0 < found[name].sigma < 0.1 * truth
    assert found["motor.speed"].assumed == 0.0


def test_the_score_falls_to_the_noise_and_says_from_what():
    record, how = moved(), {}
    for name in ("measured", "auto", "free"):
        how[name] = compare([PhysicalContender(drive())], [record], modes=["free run"], repeats=1, initial_states=name)
    assert how["measured"].scores[0].rmse > 20 * NOISE and how["measured"].starts[0].estimate.note
    assert how["auto"].scores[0].rmse == pytest.approx(NOISE, rel=0.1)
    assert how["free"].scores[0].rmse == pytest.approx(NOISE, rel=0.1)
    assert how["auto"].scores[0].samples == len(record.time)
    (started,) = how["auto"].starts
    assert started.estimate.samples == 50 and started.estimate.seconds == (0.0, pytest.approx(0.98))
    assert "0 s to 0.98 s" in str(started) and "scored too" in str(started)


def test_nothing_after_the_first_part_is_looked_at():
    record = moved()
    late = record["position"].copy()
    late[50:] += 3.0
    spoilt = record.with_signals({"position": late})
    assert estimate_start(drive(), spoilt).values == estimate_start(drive(), record).values


def test_a_start_that_is_right_is_not_freed_without_a_reason():
    time = np.arange(0.0, 10.0, 0.02)
    x = POSITION + NOISE * np.random.default_rng(3).standard_normal(len(time))
    rest = Record(time, {"command": 0 * time, "position": x}, {"command": "V", "position": "m"}, "rest")
    assert set(estimate_start(drive(), rest, "auto").values) == {"piston.position"}


@pytest.mark.parametrize("how", ["auto", "free"])
def test_a_start_far_from_what_the_model_thinks_is_found_where_the_machine_rests(how):
    """Nobody measured the arm: beside noise alone, a rod that starts where the model thinks is a thousand sigma off."""
    whole = read_record(SHIPPED / "cehA" / "recordings" / "validate_1.csv").window(end=8.0)
    record = whole.select([name for name in whole.names if name != "arm_angle"])
    (start,) = (s for s in estimate_start(hydrotwin.load("cehA"), record, how).states if s.name == "arm.angle")
    assert start.assumed == 0.0 and start.value == pytest.approx(whole["arm_angle"][:50].mean(), abs=2e-3)


def test_a_start_that_is_given_stays():
    known = estimate_start(drive(), moved(), "free", {"motor.speed": SPEED})
    assert set(known.values) == {"piston.position"}


def test_what_cannot_be_estimated_says_so_and_is_scored_as_before():
    short = moved(duration=0.5)
    with pytest.raises(DataError, match="too short"):
        estimate_start(drive(), short)
    with pytest.raises(DeclarationError, match=r"no initial_states 'fre'\. Did you mean 'free'"):
        compare([PhysicalContender(drive())], [short], initial_states="fre")
    told = compare([PhysicalContender(drive())], [short], modes=["free run"], repeats=1, initial_states="auto")
    assert "too short" in str(told.starts[0]) and told.scores
    toys = compare([Toy("toy")], [recording()], modes=["free run"], repeats=1, initial_states="free")
    assert "only the start states of a model with equations" in str(toys.starts[0]) and toys.scores
    assert not compare([Toy("toy")], [recording()], modes=["free run"], repeats=1, initial_states="auto").starts


def test_a_start_that_was_not_recorded_is_told_and_not_called_estimated():
    """The first samples are unknown: the model starts at zero, far from where the machine is."""
    record = moved()
    position = record["position"].copy()
    position[:5] = np.nan
    record = record.with_signals({"position": position})
    found = compare([PhysicalContender(drive(), "drive")], [record], modes=["free run"], repeats=0)
    (started,) = found.starts
    assert "drive on moved_0" in str(started) and "first sample of position is not known" in str(started)
    assert not started.estimate.states and found.scores[0].rmse > 0.5
    given = PhysicalContender(drive(), "drive", start={"piston.position": POSITION, "motor.speed": SPEED})
    assert not compare([given], [record], modes=["free run"], repeats=0).starts


def test_a_criterion_beside_a_model_that_started_otherwise_says_so():
    """The same equations twice, of which only one has its start estimated, as an FMU beside its model."""
    given = PhysicalContender(drive(), "given", start={"piston.position": 1.4, "motor.speed": 4.0})
    asked = {"modes": ["free run"], "repeats": 0, "initial_states": "auto"}
    found = compare([PhysicalContender(drive(), "drive"), given, HoldLast((drive().outputs[0],))], [moved()], **asked)
    sentences = ("position not worse than drive", 'position not worse than "hold last sample"', "position.rmse < 9 m")
    beside, yardstick, alone = acceptance(found, Wanted(sentences, model="given")).judged
    assert "The start of drive was estimated on moved_0, and that of given was not" in beside.caution
    assert not beside.passed and not yardstick.caution and not alone.caution


def test_the_yardstick_holds_what_is_known():
    record = moved()
    position = record["position"].copy()
    position[[0, 1, 7]] = np.nan
    held = HoldLast((drive().outputs[0],))
    record = record.with_signals({"position": position})
    assert set(held.free_run(record)["position"]) == {position[2]}
    steps = held.one_step(record)["position"]
    assert steps[:4].tolist() == [position[2]] * 4 and steps[8] == position[6] and steps[9] == position[8]


def two_sensors():
    """The drive whose position two sensors read; only the first tells where a run starts."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 5)
    own = drive()
    xdot, _ = own.ode(t, x, u, p)
    ode = ca.Function("ode", [t, x, u, p], [xdot, ca.vertcat(x[1], x[1])], ["t", "x", "u", "p"], ["xdot", "y"])
    speed, position = own.states
    outputs = (own.outputs[0], Signal("second", "m", nominal=1.0))
    states = (dataclasses.replace(speed, measured_by=None), position)
    return dataclasses.replace(own, outputs=outputs, states=states, ode=ode)


def test_an_output_that_the_fit_could_not_follow_does_not_bend_the_start():
    """A fine sensor whose zero is off: the first part cannot tell which of the two is, the fit of the model can."""
    off, fine, model, record = 0.05, 1e-4, two_sensors(), moved()
    second = record["position"] + off + fine * np.random.default_rng(5).standard_normal(len(record.time))
    record = Record(record.time, {**record.signals, "second": second}, {**record.units, "second": "m"}, "moved")
    left = {"position": NOISE, "second": off}
    bent, straight = (estimate_start(model, record, left=told).values for told in (None, left))
    assert abs(bent["piston.position"] - POSITION) > 4 * NOISE
    assert straight["piston.position"] == pytest.approx(POSITION, abs=NOISE)
    spread = {"names": [], "covariance": [], "noise": {"position": NOISE}, "left": left, "explained": ["position"]}
    contender = PhysicalContender(model, provenance={SPREAD: spread})
    found = compare([contender], [record], modes=["free run"], repeats=0, initial_states="auto")
    assert next(s.coverage for s in found.scores if s.output == "position") > 0.9
    assert next(b.trusted for b in found.entrants[0].bands if b.output == "position")


def test_a_model_whose_fit_estimated_starts_tells_that_nothing_does_here():
    """Its fit had left the noise, and compare 40 times as much on the same recording, without a word on why."""
    for how, said in (("free", True), ("auto", False)):
        model = PhysicalContender(drive(), "m", provenance={"asked": {"initial_states": how}})
        found = compare([model], [moved()], modes=["free run"], repeats=0)
        (judged,) = acceptance(found, Wanted(("position.rmse < 1 um",))).judged
        assert ("its fit estimated where motor.speed began" in "".join(map(str, found.starts))) is said
        assert ("On moved_0 m starts as without an estimate: its fit estimated" in judged.caution) is said
    model = PhysicalContender(drive(), "m", provenance={"asked": {"initial_states": "free"}})
    twice = compare([model], [moved(), moved(1)], modes=["free run"], repeats=0)
    [told] = starts_told(twice.starts)
    assert told.startswith("m on moved_0, moved_1 starts as without an estimate: its fit")
    estimated = compare([model], [moved()], modes=["free run"], repeats=0, initial_states="auto")
    assert not any(s.estimate.note for s in estimated.starts)


def test_a_start_that_nobody_told_is_told_where_it_makes_most_of_the_error():
    """It had stood beside a doubted band alone: a right model missed its criterion, and nothing said why."""
    found = compare([PhysicalContender(drive(), "m")], [moved(), recorded(drive(), 2, noise={"position": NOISE})],
                    modes=["free run"], repeats=0)  # fmt: skip
    accepted = acceptance(found, Wanted(("position.rmse < 5 mm", "run_2: position.rmse < 5 mm")))
    missed, other = accepted.judged
    said = "On moved_0 m starts as without an estimate: no sample tells where motor.speed began"
    assert not missed.passed and said in missed.caution and said in verdict(accepted)[-1]
    assert other.passed and not other.caution, "the same state, at rest as the model says"
    assert any("no sample tells where motor.speed began" in notice for notice in notices(found))
    given = PhysicalContender(drive(), "m", start={"motor.speed": SPEED})
    assert not compare([given], [moved()], modes=["free run"], repeats=0).starts


def test_a_start_that_one_noisy_sample_tells_is_told_where_it_makes_most_of_the_error():
    """A right model with an integrator began with the error of one sample of a speed, and missed without a word."""
    record, random = moved(), np.random.default_rng(3)
    speed = GAIN * 0.1 + (SPEED - GAIN * 0.1) * np.exp(-record.time / LAG) + random.standard_normal(len(record.time))
    speed[0] = SPEED + 2.0  # two standard deviations
    noisy = record.with_signals(
        {**record.signals, "motor_speed": speed}, units={**record.units, "motor_speed": "rad/s"}
    )
    found = compare([PhysicalContender(drive(), "m")], [noisy], modes=["free run"], repeats=0)
    (missed,) = acceptance(found, Wanted(("position.rmse < 5 mm",))).judged
    assert not missed.passed and "the first sample alone tells where motor.speed" in missed.caution
    estimated = compare(
        [PhysicalContender(drive(), "m")], [noisy], modes=["free run"], repeats=0, initial_states="auto"
    )
    assert acceptance(estimated, Wanted(("position.rmse < 5 mm",))).judged[0].passed


def test_a_bad_first_reading_is_told_where_it_makes_most_of_the_error():
    """Far beyond the noise, it sets the start of the run all the same; the samples behind it say so."""
    record = moved()
    position = record["position"].copy()
    position[0] += 0.5
    bad = record.with_signals({**record.signals, "position": position}, units=record.units)
    given = PhysicalContender(drive(), "m", start={"motor.speed": SPEED})
    (told,) = compare([given], [bad], modes=["free run"], repeats=0).starts
    assert told.estimate.note.startswith("the first sample alone tells where piston.position began")


def test_a_wrong_model_is_not_excused_by_noise_of_its_first_samples():
    wrong = PhysicalContender(drive().with_parameters({"motor.gain": 14.0}), "wrong")
    record = recorded(drive(), 2, noise={"position": NOISE, "motor_speed": 0.1})
    assert not compare([wrong], [record], modes=["free run"], repeats=0).starts


def test_a_wrong_model_is_not_excused_by_its_start():
    wrong = PhysicalContender(drive().with_parameters({"motor.gain": 14.0}), "wrong")
    found = compare([wrong], [recorded(drive(), 2, noise={"position": NOISE}, outputs=("position",))],
                    modes=["free run"], repeats=0)  # fmt: skip
    assert not found.starts


def test_one_step_ahead_of_what_nothing_sets_is_refused_and_passes_nothing():
    """Its free run had been told as one step ahead, and had met the criterion for that."""
    states = tuple(dataclasses.replace(s, measured_by=None) for s in drive().states)
    deaf = PhysicalContender(dataclasses.replace(drive(), states=states), "deaf")
    record = recorded(drive(), 2, noise={"position": NOISE})
    found = compare([deaf, PhysicalContender(drive(), "right")], [record], modes=["one step", "free run"], repeats=0)
    one, other = (acceptance(found, Wanted(("position.rmse < 9 m",), model=m)).judged[0] for m in ("deaf", "right"))
    assert not one.passed and "no output that is measured sets a state of it" in one.undefined and other.passed
    scored = {(s.model, s.mode) for s in found.scores}
    assert scored == {("deaf", "free run"), ("right", "free run"), ("right", "one step")}
    blind = dataclasses.replace(drive(), states=(drive().states[0], states[1]))  # what sets its speed is not recorded
    alone = record.select(["command", "position"])
    found = compare([PhysicalContender(blind, "blind")], [alone], modes=["one step"], repeats=0)
    assert not found.scores and "would be its free run" in found.unscored[0].reason
