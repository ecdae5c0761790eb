"""The best structure grows by what promises most beside it: in windows along its own course, else to first order."""

from __future__ import annotations

import dataclasses

from hydrotwin.discovery.fits.job import Look
from hydrotwin.discovery.fits.whole import step
from hydrotwin.discovery.structures import growth as growing
from hydrotwin.discovery.structures.foreseen import Foreseen
from hydrotwin.discovery.structures.growth import Growth
from tests.discovery.slides import begun, records

SHOWN = 0.8  # of what the base leaves in windows, by the friction in all of them
SOME = ("coulomb_friction", "null_bias", "viscous_friction", "dead_time")


def grown(promising: dict[str, float], left: tuple[float, ...] = (SHOWN, SHOWN), batch: int = 4):
    """A search whose friction is fitted, and of what is beside it in windows which share is left; labels of jobs.

    left : by length of windows, the share of what the base leaves that the friction leaves alone.
    """
    search = begun(records(3, dry=30.0, leaning=8.0), SOME, most=2)
    search.identify()
    (friction,) = (c for c in search.table.candidates if c.id == "coulomb_friction")
    best = search.table.entry([friction])
    (best.fitted,) = search._ran([search.jobs.of(best, search.jobs.starts(best))])
    asked, look = [], search.table.entry().look

    def run(jobs, function=step):
        found = []
        for job in jobs:
            asked.append(job)
            if not job.stages:
                found.append(function(job))
                continue
            k, values = job.stages[0], dict(best.fitted.values)
            share = left[k] * next((v for name, v in promising.items() if name in job.label), 1.0)
            one = {"squares": look.squares[k : k + 1] * share, "counts": look.counts[k : k + 1], "begin": k}
            one["courses"] = (look.courses[k],) if job.tells_courses else ()
            found.append(dataclasses.replace(look, values=values, trail=(), **one))
        return found

    growth = Growth(search.table, search.jobs, run, batch=batch, most=2)
    growth.grow(1)
    return search, asked


def test_what_leaves_clearly_less_in_windows_is_fitted_and_nothing_else():
    search, asked = grown({"null_bias": 0.001})
    looks, fits = [j for j in asked if j.stages], [j for j in asked if not j.stages]
    assert looks[0].tells_courses and not any(j.tells_courses for j in looks[1:])
    assert len(looks) == 1 + len(search.table.candidates) - 1  # the best itself, then all others beside it
    assert all(j.course and "coulomb_friction" in j.label for j in looks)
    assert fits and all("null_bias" in j.label for j in fits)
    (pair,) = (e for e in search.table.entries.values() if len(e.key) == 2)
    assert isinstance(pair.look, Look) and search.table.share(pair) < search.table.share(search.table.parts(pair)[-1])


def test_where_windows_show_nothing_beside_it_first_order_tells():
    _, asked = grown({})
    fits = [j for j in asked if not j.stages]
    assert fits and any("null_bias" in j.label for j in fits)


def test_it_grows_in_the_shortest_windows_in_which_the_best_leaves_anything():
    """Over a fraction of a second one effect may explain all: what is missing beside it shows in longer windows."""
    search, asked = grown({}, left=(0.0, SHOWN))
    looks = [j.stages for j in asked if j.stages]
    assert looks[:2] == [(0, 1), (1, 2)] and set(looks[2:]) == {(1, 2)}
    courses = search.table.entry().look.courses
    assert asked[0].course is courses[0] and asked[1].course is courses[1]


def test_where_the_best_leaves_nothing_in_windows_nothing_is_looked_at_beside_it():
    _, asked = grown({}, left=(0.0, 0.0))
    assert [j.stages for j in asked if j.stages] == [(0, 1), (1, 2)]


def steps(asked) -> list[tuple[str, str]]:
    """What was done with which effect beside the friction, after the look at that alone."""
    names = ("dead", "viscous", "null")
    return [("look" if j.stages else "fit", next(n for n in names if n in j.label)) for j in asked[1:]]


def test_what_explains_all_in_windows_is_fitted_before_others_are_looked_at():
    _, asked = grown({"null_bias": 0.001}, batch=1)
    assert steps(asked)[:2] == [("look", "null"), ("fit", "null")]


def test_a_fit_begins_where_its_user_put_it_and_where_that_leaves_more_than_promised_from_the_look_too():
    search, asked = grown({"null_bias": 0.001}, batch=1)
    plain, again = [j for j in asked if not j.stages]
    (pair,) = (e for e in search.table.entries.values() if len(e.key) == 2)
    assert plain.question.lengths and all("mass.mass" not in start for start in plain.starts)
    assert again.starts[0] == pair.look.values and search.table.share(pair) > search.table.promise(pair)


def test_what_leaves_clearly_less_than_all_before_it_is_fitted_at_once():
    _, asked = grown({"viscous_friction": 0.02, "dead_time": 0.001, "null_bias": 0.03}, batch=1)
    done = list(dict.fromkeys(steps(asked)))
    assert done[:4] == [("look", "null"), ("fit", "null"), ("look", "dead"), ("fit", "dead")]
    assert done[4:] == [("look", "viscous"), ("fit", "viscous")], "what leaves more waits"


def test_what_first_order_expects_beside_the_best_is_looked_at_as_early_as_what_promises_most_alone(monkeypatch):
    """What the best hides promises nothing alone; first order beside it may know nothing of it."""
    known = {"viscous_friction": 0.1, "dead_time": 0.5, "null_bias": 0.9}
    monkeypatch.setattr(growing, "foreseen", lambda table, jobs, best: {
        c.label: Foreseen(next(v for n, v in known.items() if n in c.label), {}) for c in table.candidates
        if c not in best.members})  # fmt: skip
    alone = ("null_bias", "dead_time", "viscous_friction", "coulomb_friction")
    monkeypatch.setattr(growing, "promising", lambda table: sorted(table.candidates, key=lambda c: alone.index(c.id)))
    _, asked = grown({}, batch=1)
    assert [name for what, name in steps(asked) if what == "look"] == ["viscous", "null", "dead"]
