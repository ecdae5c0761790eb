"""What does not keep its value while it is recorded is no constant of the machine, and gets no name."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery import lasting
from hydrotwin.discovery.lasting import Change, _differs, changing, halved, with_two_values
from hydrotwin.discovery.structure import Structure
from hydrotwin.identification.problem import Recording
from hydrotwin.models.effects import candidates
from hydrotwin.models.language.errors import SolveError
from hydrotwin.records import Record

from .slides import NOISE, found, grown, pushes, question, records, searching, slid, slide, started


def named(runs, effect="coulomb_friction", **values):
    """A search in recordings of the slide, its base, and the base with an effect."""
    search, fitted = searching(question(runs), (effect,))
    base = Structure((), fitted)
    return search, base, grown(search, base, effect, **values)


def test_friction_that_trebles_half_way_is_found_with_both_values():
    search, base, now = named(records(3, dry=20.0, then=60.0), coulomb_friction=30.0)
    change = changing(search, now, base)
    assert (change.parameter, change.unit) == ("coulomb_friction.force", "N")
    assert (change.before, change.after) == (pytest.approx(20.0, rel=0.02), pytest.approx(60.0, rel=0.02))
    assert change.closed > 0.99
    assert "Coulomb friction at mass.flange would explain 100 % of the gap, but not as a constant" in change.told()
    assert f"(coulomb_friction.force is {change.before:.4g} N before the middle" in change.told()
    assert f" and {change.after:.4g} N after)" in change.told()


@pytest.mark.parametrize("then", [30.0, 36.0])
def test_friction_that_stays_or_hardly_changes_is_a_constant(then):
    search, base, now = named(records(3, dry=30.0, then=then), coulomb_friction=30.0)
    assert changing(search, now, base) is None


def test_what_explains_nothing_with_two_values_either_is_not_told():
    """A limit far above every force, where friction changes."""
    search, base, now = named(records(3, dry=20.0, then=60.0), "command_saturation")
    assert changing(search, now, base) is None


def test_of_several_parameters_one_does_the_others_work():
    """Friction that trebles, by a law with three parameters: nothing is said."""
    search, base, now = named(records(3, dry=20.0, then=60.0), "stribeck_friction")
    assert len(now.members[0].free) == 3 and changing(search, now, base) is None


def test_each_effect_is_asked_by_itself_and_the_surest_is_told(monkeypatch):
    search, fitted = searching(question(records(3, dry=20.0, then=60.0)), ("coulomb_friction", "null_bias"))
    base = Structure((), fitted)
    now = grown(search, base, "coulomb_friction", "null_bias", coulomb_friction=30.0)
    assert changing(search, now, base).parameter == "coulomb_friction.force"


def test_a_refit_that_diverges_says_nothing():
    search, base, now = named(records(3, dry=20.0, then=60.0), coulomb_friction=30.0)
    fails = dataclasses.replace(search, run=lambda function, jobs, stage: ["it diverges"] * len(jobs))
    assert changing(fails, now, base) is None


def test_a_delay_is_read_by_the_driver_and_has_one_value():
    search, fitted = searching(question(records(3, late=6)), ("dead_time",))
    base = Structure((), fitted)
    assert changing(search, grown(search, base, "dead_time", dead_time=0.1), base) is None


def test_something_that_changes_gets_no_name_but_is_told():
    runs = records(3, dry=20.0, then=60.0)
    answer = found(runs, ["coulomb_friction", "null_bias"], validate=records(1, 8, dry=20.0, then=60.0))
    assert answer.verdict == "unknown" and not answer.steps
    assert answer.answer.startswith("Something changes while it is recorded: Coulomb friction at mass.flange")
    assert not any("too little for a name" in str(f) for f in answer.findings)
    assert answer.model is not None and not answer.model.additions


LEANING = {"leaning": 40.0}
UNTOLD = ("drift", "sensor_drift", "constant_load", "viscous_friction", "coulomb_friction")


def test_what_changes_is_found_where_something_else_was_named():
    """A force that sets in half way, taken for a sensor that drifts."""
    search, fitted = searching(question(records(3, **LEANING)), UNTOLD)
    base = Structure((), fitted)
    drifting = grown(search, base, "sensor_drift", sensor_drift=0.02)
    change = changing(search, drifting, base)
    assert change.candidate.id == "constant_load" and abs(change.before) < 0.5
    assert abs(change.after) == pytest.approx(40.0, rel=0.02) and change.closed > 0.99


def test_nothing_is_asked_in_its_place_where_all_is_explained(monkeypatch):
    search, base, now = named(records(3, dry=30.0), coulomb_friction=30.0)
    monkeypatch.setattr(lasting, "_instead", lambda *_: pytest.fail("asked"))
    assert search.explained(now) and changing(search, now, base) is None


def test_a_screen_that_diverges_says_nothing(monkeypatch):
    search, fitted = searching(question(records(3, **LEANING)), ("drift", "constant_load"))
    base = Structure((), fitted)

    def diverging(*_):
        raise SolveError("it diverges")

    monkeypatch.setattr(lasting, "Screen", diverging)
    assert changing(search, base, base) is None


def test_a_force_that_sets_in_half_way_gets_no_name_whatever_explains_a_part_of_it():
    answer = found(records(3, **LEANING), UNTOLD, validate=records(1, 8, **LEANING))
    assert answer.verdict == "unknown" and not answer.steps
    assert answer.answer.startswith("Something changes while it is recorded: constant force at mass.flange")


def test_a_parameter_has_its_second_value_where_late_is_one():
    flat, _, force = started("coulomb_friction")
    two = with_two_values(flat, force)
    p, both = flat.parameter_vector({force: 20.0}), two.parameter_vector({force: 20.0, f"{force}.later": 60.0})
    x, u = np.array([0.1, 0.5, *np.zeros(len(flat.states) - 2)]), np.array([100.0])
    for late, value in ((0.0, 20.0), (1.0, 60.0)):
        ours = two.ode(0.0, x, [*u, late], both)
        theirs = flat.ode(0.0, x, u, flat.parameter_vector({force: value}))
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(a.full(), b.full(), rtol=1e-14)
    start, own = two.start_given(("mass.speed",)), flat.start_given(("mass.speed",))
    np.testing.assert_array_equal(start([*u, 0.0], both, [0.2]).full(), own(u, p, [0.2]).full())


def test_each_recording_has_its_middle_and_recordings_in_a_row_one():
    def at(*times):
        runs = [
            Recording(f"{a}-{b}", None, np.arange(a, b), np.zeros((b - a, 1)), np.zeros((b - a, 1))) for a, b in times
        ]
        return {name: r.u[:, 1].sum() for name, r in halved(runs).items()}

    assert at((0, 10), (0, 20)) == {"0-10": 5, "0-20": 10}
    assert at((20, 30), (0, 10), (10, 20)) == {"20-30": 10, "0-10": 0, "10-20": 5}
    assert at((5, 15)) == {"5-15": 5}


def test_all_parts_of_a_lone_recording_have_the_same_middle():
    time, force = pushes(0, seconds=36.0)
    friction = np.where(time < 18.0, 20.0, 60.0)
    noise = NOISE * np.random.default_rng(7).standard_normal(len(time))
    units = {"force": "N", "speed": "m/s"}
    lone = Record(time, {"force": force, "speed": slid(force, friction) + noise}, units, "lone")
    search, base, now = named([lone], coulomb_friction=30.0)
    assert len(search.question.fit) == 8 and len(search.question.select) == 4
    change = changing(search, now, base)
    assert (change.before, change.after) == (pytest.approx(20.0, rel=0.03), pytest.approx(60.0, rel=0.03))


def test_values_differ_as_they_are_or_beyond_neutral():
    (bias,) = candidates(slide(), ["null_bias"])
    name = bias.free[0]

    def differ(before, after, neutral):
        return _differs(Change(dataclasses.replace(bias, neutral={name: neutral}), name, "N", before, after, 1.0))

    assert differ(348.0, 518.0, 350.0) and differ(3.0, -3.0, 0.0) and differ(2.0, 4.1, 1e9)
    assert not differ(2.0, 3.9, 1e9) and not differ(1.02, 1.03, 1.0) and not differ(-5.0, -8.0, 0.0)
