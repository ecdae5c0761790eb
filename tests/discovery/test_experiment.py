"""The input that tells two models apart which the recordings at hand cannot."""

from __future__ import annotations

import dataclasses
import re
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from hydrotwin.discovery.diagnosis.experiment import (
    DIVERGED,
    _absorbed,
    _Member,
    _rms,
    next_experiment,
)
from hydrotwin.discovery.fits.job import Job, Question
from hydrotwin.discovery.fits.whole import conclude, fit
from hydrotwin.identification.drives import candidates, seen_limits
from hydrotwin.identification.problem import Recording
from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable, fixed_start
from hydrotwin.simulation import prepare

NOISE = 2e-3
COMMAND = Signal("command", "V")


def lag(name, law, width):
    """speed' = (gain law(command, width) - speed) / time, speed measured; the second input adds to the speed."""
    t, x, u, p = (ca.SX.sym(letter, size) for letter, size in (("t", 1), ("x", 1), ("u", 2), ("p", 3)))
    ode = ca.Function(
        "ode", [t, x, u, p], [(p[0] * law(u[0], p[2]) + u[1] - x) / p[1], x], ["t", "x", "u", "p"], ["xdot", "y"]
    )
    return FlatModel(
        name=name,
        inputs=(Signal("load", "V", interpolation="linear"), COMMAND)[::-1],
        outputs=(Signal("speed", "m/s"),),
        states=(StateVariable("v", "m/s", measured_by="speed"),),
        parameters=(
            ParameterValue("gain", 1.0, "1", bounds=(0.0, 10.0)),
            ParameterValue("time", 0.1, "s", bounds=(0.01, 1.0)),
            ParameterValue("width", width, "V", bounds=(0.0, 1.0)),
        ),
        ode=ode,
        initialisation=fixed_start([0.0], ["v"], 2, 3),
        step=5e-3,
    )


def deadband(u, width):
    """Nothing below the width, less by the width above it."""
    return u - width * ca.tanh(u / (0.3 * width + 1e-3))


def smaller(u, width):
    """Less by the same share everywhere."""
    return u * (1 - width)


def square(time):
    return np.where(np.sin(2 * np.pi * time / 4.0) >= 0, 1.0, -1.0)


def sine(time):
    return np.sin(2 * np.pi * time / 10.0)


@pytest.fixture(scope="module")
def split():
    """A machine with a deadband, driven at full command only, and the two models that explain that equally well."""
    truth = lag("truth", deadband, 0.1)
    recordings = []
    for seed in range(2):
        time = np.arange(0.0, 20.0, 0.02)
        u = np.stack([square(time + seed), np.full(len(time), 0.05)], axis=1)
        y, _ = prepare(truth).run(time, u, truth.parameter_vector(), np.zeros(1))
        noisy = y + NOISE * np.random.default_rng(seed).standard_normal(y.shape)
        recordings.append(Recording(f"run_{seed}", None, time, u, noisy))
    question = Question(tuple(recordings), np.array([NOISE]))
    members = []
    for name, law, start in (("command_deadband", deadband, 0.2), ("displacement_error", smaller, 0.2)):
        flat = lag(name, law, start)
        free = ("gain", "time", "width") if law is deadband else ("time", "width")
        fitted = fit(Job(flat, free, question))
        members.append((name, flat, fitted.values, fitted.states))
    return SimpleNamespace(members=members, recordings=recordings, question=question, inputs=truth.inputs)


def proposed(split, **changes):
    asked = {"members": split.members, "inputs": split.inputs, "recordings": split.recordings} | changes
    return next_experiment(asked["members"], asked["inputs"], asked["recordings"], split.question)


def test_two_models_alike_at_full_command_are_told_apart_by_small_commands(split):
    found = proposed(split)
    assert found.input == "command" and found.unit == "V"
    assert found.now < 1.0 < 5.0 < found.separation
    moved = found.values[found.time > 2.0]
    assert np.mean(np.abs(moved) < 0.9) > 0.5


def test_the_sentence_names_the_input_the_members_and_the_figures(split):
    found = proposed(split)
    said = re.fullmatch(
        r"drive command with (.+): command_deadband and displacement_error then differ by ([\d.]+) times the noise "
        r"\(now ([\d.]+)\)",
        found.sentence,
    )
    assert said, found.sentence
    assert float(said[2]) == pytest.approx(found.separation, rel=0.05)
    assert float(said[3]) == pytest.approx(found.now, rel=0.06)


@pytest.mark.parametrize(("disturbed", "told"), [(40.0, True), (0.0, False)])
def test_what_neither_explains_is_told_where_it_hides_how_they_differ(split, disturbed, told):
    (deadband_, larger), recordings = split.members, split.recordings
    name, flat, values, states = larger
    apart = (name, flat, {**values, "width": values["width"] * 1.1}, states)
    shaken = [dataclasses.replace(r, y=r.y + disturbed * NOISE * np.sin(7 * r.time)[:, None]) for r in recordings]
    found = proposed(split, members=[deadband_, apart], recordings=shaken)
    hidden = re.search(r"\(now ([\d.]+) beside ([\d.]+) that neither explains\)", found.sentence)
    assert bool(hidden) == told, found.sentence
    assert not told or 3.0 <= float(hidden[1]) < float(hidden[2]) == pytest.approx(40.0 / np.sqrt(2), rel=0.1)


def test_the_wrong_member_fails_as_predicted_when_the_experiment_is_made(split):
    found = proposed(split)
    truth = lag("truth", deadband, 0.1)
    u = np.stack([found.values, np.full(len(found.time), 0.05)], axis=1)
    y, _ = prepare(truth).run(found.time, u, truth.parameter_vector(), np.zeros(1))
    measured = y + NOISE * np.random.default_rng(9).standard_normal(y.shape)
    more = Recording("new", None, found.time, u, measured)
    question = Question((*split.recordings, more), np.array([NOISE]))
    left = {}
    for name, flat, values, _ in split.members:
        known = fit(Job(flat, tuple(values), question, starts=(values,)))
        job = Job(flat, tuple(values), question, (known.values,), known.states, known.rmse)
        left[name] = conclude(job).residuals_fit[-1] / NOISE
    assert np.sqrt(np.mean(left["command_deadband"] ** 2)) < 1.1
    wrong = np.sqrt(np.mean(left["displacement_error"] ** 2) - 1.0)
    assert wrong > 0.7 * found.separation  # predicted for the member that comes nearer to the other


def test_a_difference_that_a_new_fit_absorbs_does_not_count(split):
    _, flat, values, states = split.members[1]
    slower = {**values, "time": values["time"] + 2e-4}
    twins = [("one", flat, values, states), ("other", flat, slower, states)]
    found = proposed(split, members=twins)
    assert found is None or found.separation < 0.2


def test_the_input_stays_within_the_amplitude_and_rate_seen():
    time = np.arange(0.0, 30.0, 0.01)
    recording = Recording("slow", None, time, 2.0 + 3.0 * sine(time)[:, None], np.zeros((3000, 1)))
    limits = seen_limits([recording], 0)
    fastest = np.max(np.abs(np.diff(recording.u[:, 0]))) / 0.01
    kinds = set()
    for tried in candidates(limits, "V"):
        kinds.add(tried.kind)
        assert tried.values.min() >= recording.u.min() - 1e-9 and tried.values.max() <= recording.u.max() + 1e-9
        assert np.max(np.abs(np.diff(tried.values))) / np.diff(limits.time)[0] <= fastest * 1.001
        assert tried.values[0] == limits.middle == 0.0
        assert np.ptp(tried.values) > 0
    assert kinds == {"triangle", "steps with pauses", "holding levels", "sweep", "multisine", "slow ramp"}


@pytest.mark.parametrize(("period", "count", "lasts"), [(0.01, 3000, 30.0), (1.0, 1200, 1199.0), (20.0, 300, 5980.0)])
def test_a_slow_machine_is_driven_as_long_as_it_was_recorded_and_no_faster_than_samples_show(period, count, lasts):
    """A minute of 4 Hz in samples of a second is another input, and tells nothing of what takes ten minutes."""
    time = period * np.arange(count)
    recording = Recording("heat", None, time, sine(time / period / 100)[:, None], np.zeros((count, 1)))
    limits = seen_limits([recording], 0)
    assert limits.time[-1] == pytest.approx(lasts, abs=1.01 * period)
    tried = list(candidates(limits, "V"))
    tops = {float(m[1]) for c in tried if (m := re.search(r"(?:to|up to) ([\d.e+-]+) Hz", c.words))}
    assert tops and max(tops) <= 0.1 / period * 1.01
    for one in (c for c in tried if c.kind == "multisine"):
        power = np.abs(np.fft.rfft(one.values - one.values.mean())) ** 2
        seen = np.fft.rfftfreq(len(one.values), period)
        assert power[seen < 0.15 / period].sum() > 0.95 * power.sum()  # none of it is another frequency
    kept = [c.words for c in tried if c.kind == "multisine"]
    assert len(set(kept)) == len(kept)


def test_an_input_that_never_changed_sign_keeps_its_sign():
    time = np.arange(0.0, 30.0, 0.01)
    recording = Recording("lift", None, time, 3.0 + 2.0 * square(time)[:, None], np.zeros((3000, 1)))
    limits = seen_limits([recording], 0)
    assert limits.middle == pytest.approx(3.0)
    assert all(c.values.min() >= 1.0 - 1e-9 for c in candidates(limits, "V"))


def test_what_cannot_be_asked_is_not_proposed(split):
    assert proposed(split, members=split.members[:1]) is None
    still = [Recording(r.name, None, r.time, np.zeros_like(r.u), r.y) for r in split.recordings]
    assert proposed(split, recordings=still) is None


def test_a_member_that_is_the_same_as_another_is_said_to_stay_alike(split):
    twin = ("area_error", *split.members[1][1:])
    found = proposed(split, members=[*split.members, twin])
    assert "displacement_error and area_error stay alike" in found.sentence


def test_a_run_that_diverges_is_a_large_difference_and_no_overflow():
    size, output = _rms(np.array([[1.0, 1e300], [1.0, np.inf]]))
    assert (size, output) == (DIVERGED, 1)


def test_a_parameter_of_which_nothing_is_known_absorbs_nothing():
    """What rounding leaves of its information, once the start states are eliminated, may be less than nothing."""
    column, member = np.linspace(-1.0, 1.0, 50), SimpleNamespace(free=("gain", "bias"))
    columns = np.stack([column, np.zeros(50)], axis=1)[:, None, :]
    d = (3 * column + 0.5)[:, None]
    left = _absorbed(d, columns, np.array([[0.0, 1e3], [1e3, -1e10]]), member)
    np.testing.assert_allclose(left, 0.5, rtol=1e-9)


def test_a_run_that_all_but_diverges_has_no_sensitivities(split):
    member = _Member(*split.members[0], split.question)
    time, u = np.arange(0.0, 1.0, 0.02), np.ones((50, 2))
    assert member.sensitivities(time, u) is not None
    member.unit = member.unit * 1e200
    assert member.sensitivities(time, u) is None
