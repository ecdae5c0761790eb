"""Local minima of the base: other frequencies, and structures that show that it was stuck."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmarks.gap.cases import Case, make
from hydrotwin.discovery.answer.standing import standing
from hydrotwin.discovery.fits.job import Fitted
from hydrotwin.discovery.fits.windows import look
from hydrotwin.discovery.structures import search as module
from hydrotwin.discovery.structures.extent import beginnings
from hydrotwin.discovery.structures.jobs import Jobs
from hydrotwin.identification.frequencies import detuned
from hydrotwin.identification.problem import free_parameters
from tests.discovery.slides import NOISE, begun, records, tried

SOME = ("coulomb_friction", "dead_time", "sensor_scale")


def test_one_force_sensor_and_a_frequency_a_third_off_lead_windows_to_the_noise():
    """The C-EHA as an independent simulator records it, nothing hidden: stiffness and volumes are 30 to 45 % off."""
    case = make(Case.from_name("cehA/none/nothing/0/piston_force/strokes/405/13s/16bit/wide"))
    search = begun(case.fit, ("sensor_bias",), model=case.model, noise=case.noise)
    search.table.question = dataclasses.replace(search.table.question, lengths=(0.18,), step=None)
    base, noise = search.table.entry(), search.table.noise

    def left(starts):
        search.base.find_valley(starts)
        found = look(search.jobs.of(base, [search.jobs.begin], stages=(0, 1)))
        return np.nanmax(np.sqrt(found.squares[0] / np.maximum(found.counts[0], 1)) / noise), found.values

    flat, free = case.model.flat, free_parameters(case.model.flat, search.table.free)
    starts = detuned(flat, search.table.question.fit, free, search.table.question.usual)
    assert left(starts[:1])[0] > 2.0, "the user's start alone ends in another minimum"
    size, values = left(starts)
    assert size < 1.1
    stiffness, true = values["cylinder.oil.bulk_modulus"], case.truth["cylinder.oil.bulk_modulus"]
    assert stiffness == pytest.approx(true, rel=0.05)
    search.jobs.begin = {}
    search.identify()
    assert search.jobs.begin, "it is so where a base is identified"


def stuck(search, factor=200.0):
    """As if the first fits of the base had ended in a hollow: what they leave is far more than what is there."""
    real, fits = search.run, []

    def run(function, jobs, stage):
        found = real(function, jobs, stage)
        for k, (job, fit) in enumerate(zip(jobs, found, strict=True)):
            if isinstance(fit, Fitted) and job.label == "slide" and len(fits) < 3:
                fits.append(job)
                left = dataclasses.replace(fit.left, squares=factor * fit.left.squares)
                found[k] = dataclasses.replace(fit, left=left)
        return found

    search.run = run
    return search


def test_a_base_that_was_stuck_is_freed_by_what_contains_it_and_nothing_is_named():
    search = stuck(begun(records(3), SOME))
    base = search.identify()
    assert search.table.score(base) > 1000.0
    asked, real = [], search.run
    search.run = lambda function, jobs, stage: asked.extend(jobs) or real(function, jobs, stage)
    search.go()
    assert search.table.score(base) == pytest.approx(0.0, abs=1.0)
    assert standing(search.table).verdict == "none"
    assert not asked[-1].free[2:], "it begins again with the base, which lacks nothing"


def test_a_base_that_is_freed_only_in_part_is_looked_beside_anew():
    search = stuck(begun(records(3, dry=30.0), SOME), 1e4)
    base = search.identify()
    before = search.table.score(base)
    search.go()
    assert search.table.score(base) < 0.5 * before
    assert [c.id for c in standing(search.table).order] == ["coulomb_friction"]
    assert search.table.seen_all(), "also those that were seen beside the base as it was before"


def test_a_base_that_diverges_in_fewer_windows_keeps_its_look():
    search = begun(records(3, dry=150.0), SOME)

    def run(function, jobs, stage):
        fewer = search.table.question.windows < 200
        return ["it diverges" if fewer and job.stages else function(job) for job in jobs]

    search.run = run
    base = search.identify()
    assert search.table.question.windows < 200, "or this tests nothing"
    assert base.look and base.fitted
    search.go()


def test_a_base_that_lacks_an_effect_is_not_freed(monkeypatch):
    search = begun(records(3, dry=30.0), SOME)
    raised = []
    monkeypatch.setattr(module.Freed, "__init__", lambda self: raised.append(1))
    search.go()
    assert not raised and standing(search.table).verdict == "named"


def test_what_was_looked_at_from_a_bent_base_is_fitted_from_its_own_start_too(monkeypatch):
    """As if whole recordings led to a hollow: through windows the friction is found all the same."""
    search = begun(records(3, dry=30.0), SOME)
    search.identify()
    search._to_whole_recordings()
    monkeypatch.setattr(Jobs, "whole", lambda self, entry: self.of(entry, [{"mass.mass": 900.0}], iterations=1))
    entry = search.table.entry([next(c for c in search.table.candidates if c.id == "coulomb_friction")])
    tried(search, entry)
    force = next(v for n, v in entry.fitted.values.items() if n.endswith(".force"))
    assert force == pytest.approx(30.0, rel=0.03) and entry.fitted.rmse == pytest.approx([NOISE], rel=0.05)


def test_the_users_start_is_fitted_only_where_windows_led_nowhere():
    def fits(**more):
        search = begun(records(3, **more), SOME)
        real, fitted = search.run, []
        search.run = lambda f, jobs, stage: fitted.extend(j for j in jobs if j.stages is None) or real(f, jobs, stage)
        search.identify()
        return len(fitted)

    assert fits() == 1
    assert fits(pulse=80.0) > 1


def test_what_was_fitted_in_a_part_is_no_look_in_another():
    """A search that is freed goes through another part of the recordings: looks at the first compare with nothing."""
    search = begun(records(3, dry=30.0), SOME)
    search.identify()
    search._to_whole_recordings()
    entry = search.table.entry([next(c for c in search.table.candidates if c.id == "coulomb_friction")])
    tried(search, entry)
    shorter = beginnings(search.table.question, 0.25)
    search.table.look_anew()
    search.table.entry().look = search._ran([search.jobs.glance(search.table.entry(), shorter)])[0]
    assert search.table.promise(entry) == search.table.share(entry) < 0.1, "what its fit left"
