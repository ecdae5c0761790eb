"""Windows: from a wrong base they lead an effect to its size, stage by stage, and say so when a run diverges."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.fits import first_steps, windows
from hydrotwin.discovery.fits.job import Job, Look, apart
from hydrotwin.discovery.fits.whole import step
from hydrotwin.discovery.fits.windows import look
from hydrotwin.identification.least_squares import minimise
from hydrotwin.models.language import Model
from tests.discovery.slides import MASS, NOISE, START, Unstable, drive_records, question, records, slide, started

LENGTHS = (0.4, 1.6)  # s


@pytest.fixture(scope="module")
def asked():
    """30 N of dry friction, looked at in windows of two lengths."""
    return dataclasses.replace(question(records(3, dry=30.0)), lengths=LENGTHS)


def rubbing(asked, *forces: float, stages=(0, 2), **more) -> Job:
    """The slide with dry friction, which begins at these forces; mass and damping a quarter off."""
    flat, free, force = started("coulomb_friction")
    return Job(flat, free, asked, tuple({force: f} for f in forces), stages=stages, **more)


@pytest.fixture(scope="module")
def led(asked):
    return look(rubbing(asked, 140.0))


def test_from_a_wrong_base_and_five_times_the_force_windows_come_near_the_truth(led):
    assert led.values["coulomb_friction.force"] == pytest.approx(30.0, rel=0.05)
    assert led.values["mass.mass"] == pytest.approx(MASS, rel=0.05)
    assert led.size == pytest.approx([NOISE], rel=0.2)


def test_a_look_tells_every_length_that_it_went_through(led):
    assert led.squares.shape == led.counts.shape == (2, 1)
    assert (led.counts < 1800).all() and (led.counts > 300).all(), "free start states are taken from the numbers"
    assert np.sqrt(led.squares[-1] / led.counts[-1]) == pytest.approx([NOISE], rel=0.2)
    assert len(led.trail) == 1 and led.trail[0] != led.values
    assert len(led.states) == 3 and led.states[0].keys() == {s.name for s in started("coulomb_friction")[0].states}


def test_sigmas_are_those_of_the_values(led):
    for name, true in {"mass.mass": MASS, "coulomb_friction.force": 30.0}.items():
        assert 0 < led.sigmas[name] < 0.05 * true
        assert abs(led.values[name] - true) < 10 * led.sigmas[name]


def test_one_length_after_the_other_is_as_both_at_once(asked, led):
    first = look(rubbing(asked, 140.0, stages=(0, 1)))
    then = look(dataclasses.replace(rubbing(asked, 1.0, stages=(1, 2)), starts=(first.values,), size=first.size))
    both = then.after(first)
    assert both.squares.shape == (2, 1) and both.trail == (first.values,)
    assert both.values["coulomb_friction.force"] == pytest.approx(led.values["coulomb_friction.force"], rel=0.02)


def test_of_several_starts_that_whose_first_steps_lead_lowest_is_followed(asked, led):
    several = look(rubbing(asked, 2000.0, 140.0, 900.0))
    assert several.values == pytest.approx(led.values, rel=1e-3)


def test_what_has_no_time_left_is_a_look_as_far_as_it_came(asked):
    hurried = look(rubbing(asked, 140.0, seconds=0.0))
    assert isinstance(hurried, Look) and hurried.squares.shape == (2, 1)


def test_the_base_alone_leaves_many_times_the_noise(asked):
    plain = look(Job(slide().flat, tuple(START), asked, stages=(0, 2)))
    left = np.sqrt(plain.squares / plain.counts)
    assert (left > 3 * NOISE).all()


def test_a_model_that_diverges_answers_a_sentence():
    model = Model(Unstable())
    far = dataclasses.replace(question(drive_records(2), model), lengths=LENGTHS)
    answer = look(Job(model.flat, ("gain",), far, stages=(0, 2)))
    assert isinstance(answer, str) and answer


def test_the_next_step_is_windows_where_there_are_lengths_and_else_whole_recordings(asked):
    there = step(rubbing(asked, 50.0))
    assert isinstance(there, Look) and there.left is None
    whole = step(rubbing(dataclasses.replace(asked, lengths=()), 50.0, stages=(0, 0)))
    assert isinstance(whole, Look) and whole.left.counts.sum() == 1800


def test_sizes_that_are_nothing_are_no_warning():
    nothing, some = np.array([0.0, 1.0, np.nan]), np.array([0.0, 2.0, np.nan])
    assert apart(nothing, some) == pytest.approx(np.log(2.0))
    assert apart(nothing, nothing) == 0.0
    assert apart(np.array([0.0]), np.array([1.0])) == np.inf


def test_a_look_along_a_known_course_leaves_no_more_than_what_knew_it(asked):
    known = look(rubbing(asked, 140.0, stages=(0, 1), tells_courses=True))
    states = {s.name for s in started("coulomb_friction")[0].states}
    assert [course.keys() for course in known.courses[0]] == [states] * 3
    again = dataclasses.replace(rubbing(asked, stages=(0, 1)), starts=(known.values,), size=known.size)
    along = look(dataclasses.replace(again, course=known.courses[0]))
    assert along.squares[0] <= known.squares[0] * 1.001 and along.courses == ()


def test_what_others_begin_along_is_led_to_its_end(asked, monkeypatch):
    most = []
    monkeypatch.setattr(
        first_steps, "minimise", lambda *a, **rules: most.append(rules["most"]) or minimise(*a, **rules)
    )
    look(rubbing(asked, 140.0, stages=(0, 1), tells_courses=True))
    assert set(most) == {100}
    most.clear()
    look(rubbing(asked, 140.0, stages=(0, 1)))
    assert set(most) == {12}


def test_its_weights_are_turned_until_they_settle(asked, monkeypatch):
    turns = []
    monkeypatch.setattr(windows, "CHANGED", -1.0)  # no turn is the last one
    monkeypatch.setattr(first_steps, "minimise", lambda *a, **rules: turns.append(1) or minimise(*a, **rules))
    look(rubbing(asked, 140.0, stages=(0, 1)))
    few, turns[:] = len(turns), []
    look(rubbing(asked, 140.0, stages=(0, 1), tells_courses=True))
    assert (few, len(turns)) == (windows.TURNS, windows.MOST_TURNS)


def test_windows_begin_along_a_course_without_a_run_that_guesses(asked, monkeypatch):
    """States that the course does not know, of an effect, start in every window as at the start of a recording."""
    flat, _, force = started("coulomb_friction")
    course = tuple({"mass.position": np.zeros(len(r.time)), "mass.speed": r.y[:, 0]} for r in asked.fit)
    monkeypatch.setattr(windows.horizon, "first_guess", lambda *_: pytest.fail("no run is needed"))
    job = rubbing(asked, 140.0, stages=(0, 1), course=course)
    own = [s.name for s in flat.states].index("coulomb_friction.bristles")
    states = windows._along(job, flat.parameter_vector({force: 140.0}))
    assert all(np.isfinite(x).all() and (x[:, own] == x[0, own]).all() for x in states)
    assert look(job).values[force] == pytest.approx(30.0, rel=0.1)
