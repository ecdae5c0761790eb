"""Where the jobs of a search begin: where the user put the base, or where what is known leads."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.fits.job import factor
from hydrotwin.discovery.fits.whole import led, step, trajectories
from tests.discovery.slides import begun, records, tried
from tests.discovery.test_table import leaving

SOME = ("coulomb_friction", "null_bias")


@pytest.fixture
def search():
    found = begun(records(3, dry=30.0), SOME)
    found.identify()
    return found


def friction(search):
    return search.table.entry([next(c for c in search.table.candidates if c.id == "coulomb_friction")])


def test_looks_begin_where_the_shortest_windows_led_the_base_and_fits_where_looks_ended(search):
    entry, led = friction(search), search.table.entry().look.shortest
    first = search.jobs.next(entry, 1)
    assert first.stages == (0, 1) and all(start["mass.mass"] == led["mass.mass"] for start in first.starts)
    search._look([entry])
    then = search.jobs.next(entry, 1)
    assert then.stages is None and then.starts[0] == entry.look.values


SEEN = [((0.5, 0.1), 0.1), ((3.0, 0.1), 0.1), ((3.0, 4.0), 3.0), ((0, 0.01), 0.01), ((0, 0.3), 0)]


@pytest.mark.parametrize(("promised", "again"), SEEN)
def test_of_looks_from_a_bent_base_and_from_the_users_start_the_better_one_counts(search, monkeypatch, promised, again):
    """The look that is kept: of two that explain all that from the user's start, else that which leaves less."""
    entry, looks = friction(search), {}

    def run(jobs, function=None):
        found = [search.run(step, [job], "")[0] for job in jobs]
        looks.update({id(look): promised[len(looks)] for look in found})
        return found

    monkeypatch.setattr(search, "_ran", run)
    monkeypatch.setattr(search.table, "promise", lambda e, most=None: looks[id(e.look)] if e.look else 1.0)
    search._look([entry])
    search._look_again([entry])
    assert looks[id(entry.look)] == again


def test_another_frequency_is_where_structures_begin_beside_the_users(search):
    search.jobs.begin = {"mass.mass": 7.0}
    *moved, users = search.jobs.starts(friction(search))
    assert all(start["mass.mass"] == 7.0 for start in moved) and "mass.mass" not in users
    assert search.jobs.starts(search.table.entry()) == [{"mass.mass": 7.0}]


def bent(search):
    """The same search whose base a fit took farther from where windows led it than a few steps do."""
    base, led = search.table.entry(), dict(search.table.entry().look.values)
    object.__setattr__(base.fitted.left, "squares", base.fitted.left.squares / 9)
    return led


def test_looks_begin_where_windows_led_the_base_if_its_fit_bent_it_far_from_there(search):
    led = bent(search)
    search._to_whole_recordings()
    base = search.table.entry()
    assert search.jobs.led == led != base.fitted.values and base.look.left is not None
    assert search.jobs.glance(base, None).starts == (led,)
    job = search.jobs.next(friction(search), 0)
    assert job.stages == (0, 0) and all(start["mass.mass"] == led["mass.mass"] for start in job.starts)


def test_what_lies_below_the_noise_is_no_factor():
    noise = np.array([0.1, np.nan, 0.0])
    assert factor(noise, 0.9 * noise, 0.0 * noise) == 1.0 == factor(noise, 0.0 * noise, noise)
    assert np.isclose(factor(noise, 3.0 * noise, 0.0 * noise), 3.0) and np.isclose(factor(noise, noise, 3 * noise), 3.0)


def test_else_looks_begin_where_the_base_ended_in_the_part_they_see(search):
    base = search.table.entry()
    search._to_whole_recordings()
    assert search.jobs.led is None and base.look.left is not None
    values = {n: 1.01 * v for n, v in base.look.values.items()}
    object.__setattr__(base.look, "values", values)
    job = search.jobs.next(friction(search), 0)
    assert all(start["mass.mass"] == values["mass.mass"] for start in job.starts)


def test_a_fit_from_its_own_start_goes_through_the_windows_that_looks_left_out(search):
    lengths = search.table.question.lengths
    search._to_whole_recordings()
    job = search.jobs.plain_soon(friction(search))
    assert lengths and job.question.lengths == lengths and not search.table.question.lengths
    assert all("mass.mass" not in start for start in job.starts)


def test_a_look_at_whole_recordings_begins_where_a_part_of_the_structure_ended_too(search):
    search._to_whole_recordings()
    part = friction(search)
    (part.fitted,) = search._ran([search.jobs.plain_soon(part)], led)
    both = search.table.entry(search.table.candidates)
    job = search.jobs.next(both, 0)
    bias = next(n for n in search.table.names(both) if n not in part.fitted.values)
    there = [start[bias] for start in job.starts if part.fitted.values.items() <= start.items()]
    assert len(there) == 2 and 0 < abs(there[0]) < abs(there[1])  # at a tenth of its usual size, and at it
    assert job.states == part.fitted.states
    alone = search.jobs.next(search.table.entry([c for c in both.members if c not in part.members]), 0)
    assert all(start["mass.mass"] == search.table.entry().fitted.values["mass.mass"] for start in alone.starts)


def test_a_limit_that_joins_a_structure_begins_where_the_run_of_that_structure_just_exceeds_it():
    """Beside what was bent while something was missing, a limit that its run never reaches would lead nowhere."""
    search = begun(records(3, dry=30.0), ("coulomb_friction", "sensor_saturation"))
    search.identify()
    search._to_whole_recordings()
    part, limit = friction(search), next(c for c in search.table.candidates if c.id == "sensor_saturation")
    tried(search, part)
    doubled = dict(part.fitted.values, **{"mass.damping": part.fitted.values["mass.damping"] / 2})
    part.fitted = dataclasses.replace(part.fitted, values=doubled)
    job = search.jobs.from_part(search.table.entry([*part.members, limit]), part)
    highest = {e.key: peak(search.table, e) for e in (part, search.table.entry())}
    begins = job.starts[0]["sensor_saturation.limit"]
    assert 0.95 * highest[part.key] < begins < highest[part.key]
    assert highest[part.key] > 1.1 * highest[()]  # along the base's run it would begin lower


def peak(table, entry):
    flat = table.model(entry).flat
    runs = trajectories(flat, table.question, entry.fitted)
    return max(np.abs(x[:, [s.name for s in flat.states].index("mass.speed")]).max() for x in runs)


def test_a_structure_is_looked_at_along_the_course_of_the_base_and_on_its_scale(search):
    base, job = search.table.entry().look, search.jobs.next(friction(search), 1)
    assert job.course is base.courses[0] and len(base.courses[0]) == 3
    assert job.size == pytest.approx(np.sqrt(base.squares[0] / base.counts[0]))


@pytest.mark.parametrize(("left", "lengths"), [(4.0, 0), (6.0, 2)])
def test_looks_go_through_whole_recordings_where_the_base_leaves_little_of_them(search, left, lengths):
    search.base.entry.fitted = leaving(left)
    assert search.base.looks_through(2) == lengths
