"""The best structure grows by what promises most beside it: in windows along its own course, else to first order."""

from __future__ import annotations

import dataclasses

from hydrotwin.discovery.fits.job import Look
from hydrotwin.discovery.fits.whole import step
from hydrotwin.discovery.structures.growth import Growth
from tests.discovery.slides import begun, records

SOME = ("coulomb_friction", "null_bias", "viscous_friction", "dead_time")


def grown(promising: dict[str, float]):
    """A search whose friction is fitted, and of what is beside it in windows which share is left; labels of jobs."""
    search = begun(records(3, dry=30.0, leaning=8.0), SOME, most=2)
    search.identify()
    (friction,) = (c for c in search.table.candidates if c.id == "coulomb_friction")
    best = search.table.entry([friction])
    (best.fitted,) = search._ran([search.jobs.of(best, search.jobs.starts(best))])
    asked, look = [], search.table.entry().look
    shown = dataclasses.replace(look, squares=look.squares[:1], counts=look.counts[:1], trail=())

    def run(jobs):
        found = []
        for job in jobs:
            asked.append(job)
            share = 0.5 * next((v for name, v in promising.items() if name in job.label), 1.0)
            seen = dataclasses.replace(shown, values=dict(best.fitted.values), squares=shown.squares * share)
            found.append(seen if job.stages else step(job))
        return found

    growth = Growth(search.table, search.jobs, run, batch=4, most=2)
    growth.grow(1)
    return search, asked


def test_what_leaves_clearly_less_in_windows_is_fitted_and_nothing_else():
    search, asked = grown({"null_bias": 0.001})
    looks, fits = [j for j in asked if j.stages], [j for j in asked if not j.stages]
    assert looks[0].tells_course and not any(j.tells_course for j in looks[1:])
    assert len(looks) == 1 + len(search.table.candidates) - 1  # the best itself, then all others beside it
    assert all(j.course and "coulomb_friction" in j.label for j in looks)
    assert ["null_bias" in j.label for j in fits] == [True]
    (pair,) = (e for e in search.table.entries.values() if len(e.key) == 2)
    assert isinstance(pair.look, Look) and search.table.share(pair) < search.table.share(search.table.parts(pair)[-1])


def test_where_windows_show_nothing_beside_it_first_order_tells():
    _, asked = grown({})
    fits = [j for j in asked if not j.stages]
    assert fits and any("null_bias" in j.label for j in fits)
