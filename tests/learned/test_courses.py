"""Commands that repeat: what is held out inside a training is held out every time it is repeated."""

from __future__ import annotations

import dataclasses

import numpy as np

from hydrotwin.learned.repeats import Course, courses
from hydrotwin.learned.state_network.learn import used_samples
from hydrotwin.learned.symbolic.data import prepare
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

U, Y = Signal("u", "V"), Signal("y", "m")
COURSE = 200  # samples


def periodic(seed: int = 1, count: float = 4.5, noise: float = 0.01) -> Record:
    """A motion that is made ``count`` times, with a little that is not repeated."""
    rng, n = np.random.default_rng(seed), int(count * COURSE)
    u = np.tile(np.repeat(rng.uniform(-1, 1, COURSE // 10), 10), 5)[:n] + noise * rng.normal(size=n)
    y = np.cumsum(u - u.mean()) * 0.01 + 1e-4 * rng.normal(size=n)
    return Record(0.02 * np.arange(n), {"u": u, "y": y}, {"u": "V", "y": "m"}, f"periods {seed}")


def test_what_is_begun_again_is_one_course():
    one, other = periodic(), periodic(2, count=1.0)
    copy = dataclasses.replace(one, name="copy")
    found = courses([r.array(["u"]) / r["u"].std() for r in (one, other, copy)])
    assert found == [Course((0, 2), COURSE), Course((1,), COURSE)]
    assert courses([periodic(noise=1.0).array(["u"])]) == [Course((0,), 900)]


def test_no_formula_is_judged_by_a_command_that_its_constants_were_fitted_to():
    data = prepare([periodic(), periodic()], [], (U,), (Y,), 0.02, (1, 2), False)
    places = [[_places(pieces) for pieces in fold] for fold in data.folds]
    assert len(places) == 5 and all(not fitted & judged for fitted, judged in places)
    assert set.union(*(judged for _, judged in places)) == set(range(COURSE))
    assert all(sum(b - a for p in part for a, b in p.ranges) == 1800 for part in ([*f, *j] for f, j in data.folds))


def test_commands_that_do_not_repeat_are_cut_in_a_row():
    data = prepare([periodic(noise=1.0)], [], (U,), (Y,), 0.02, (1, 2), False)
    assert [p.ranges for _, (p,) in data.folds] == [((k, k + 180),) for k in range(0, 900, 180)]


def test_what_chooses_a_network_is_at_the_same_places_of_every_course():
    used = used_samples(900, COURSE)
    assert (used == np.tile(used_samples(COURSE, COURSE), 5)[:900]).all()
    assert used[:COURSE].sum() == 0.7 * COURSE and not used[60:90].any() and not used[170:200].any()


def _places(pieces) -> set[int]:
    return {k % COURSE for p in pieces for a, b in p.ranges for k in range(a, b)}
