"""The base identified in the hollow it belongs to."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.base import identified
from hydrotwin.discovery.discover import KEPT
from hydrotwin.discovery.recordings import split
from hydrotwin.discovery.refit import Question, RefitJob, lead, refit
from hydrotwin.discovery.resume import packed, unpacked
from hydrotwin.discovery.search import Search
from tests.identification.hanging import FREE, MASS, NOISE, hanging, swinging


def begun(stiffness: float, true: float) -> Search:
    """A search of the mass on a spring, without candidates."""
    model = hanging(stiffness)
    data = split(model.flat, [swinging(k, true) for k in range(3)], [], noise={"position": NOISE})
    run = lambda function, jobs, stage, meanwhile=(): [function(job) for job in jobs]  # noqa: E731
    return Search(model, FREE, (), Question(data.fit, data.select, data.noise), run, lambda *said: None)


@pytest.mark.parametrize(("stiffness", "true"), [(4.2e6, 8e6), (3e6, 6e6), (6e6, 4e6)])
def test_a_base_whose_oscillation_is_far_off_is_found_where_one_descent_ends_elsewhere(stiffness, true):
    """46 Hz for 64, which 100 Hz shows as 36; 39 for 55; 55 for 45."""
    search = begun(stiffness, true)
    alone = refit(RefitJob(search.base.flat, FREE, search.question, (search.first,), coarse=True))
    assert abs(alone.values["body.mass"] / MASS - 1) > 0.3, "the trap is set"
    found = identified(search)
    assert found.likelihood < alone.likelihood
    assert found.values["body.mass"] == pytest.approx(MASS, rel=0.01)
    assert found.values["body.stiffness"] == pytest.approx(true, rel=0.01)
    assert search.first["body.mass"] != pytest.approx(MASS)  # it began elsewhere, and whoever begins again does so too


def test_a_base_that_diverges_from_one_start_is_found_from_another_and_from_none_is_said():
    search = begun(3e6, 3e6)
    run = search.run

    def first_diverges(function, jobs, stage, meanwhile=()):
        return ["diverges", *run(function, jobs[1:], stage)]

    search.run = first_diverges
    assert identified(search).values["body.mass"] == pytest.approx(MASS, rel=0.01)
    search.run = lambda function, jobs, stage, meanwhile=(): [f"diverges {k}" for k in range(len(jobs))]
    assert identified(search) == "diverges 0"


def test_starts_that_the_first_windows_lead_to_one_place_are_followed_once():
    search = begun(1e6, 1.1e6)
    run, asked = search.run, {}

    def counting(function, jobs, stage, meanwhile=()):
        asked[function.__name__] = [job.starts[0] for job in jobs]
        return run(function, jobs, stage)

    search.run = counting
    found = identified(search)
    assert found.values["body.stiffness"] == pytest.approx(1.1e6, rel=0.01)
    assert len(asked["lead"]) == 5 and len(asked["refit"]) <= 3
    assert asked["refit"][0] == asked["lead"][0], "the first of them"


def test_a_fit_that_goes_on_from_its_first_windows_ends_where_it_would_have_ended():
    search = begun(6e6, 8e6)
    whole = RefitJob(search.base.flat, FREE, search.question, (search.first,), coarse=True)
    first = unpacked(packed(lead(whole)), {kind.__name__: kind for kind in KEPT})  # as a memory keeps it
    found, known = refit(dataclasses.replace(whole, led=first)), refit(whole)
    assert found.values == known.values and found.likelihood == known.likelihood
    assert all(map(np.array_equal, found.residuals_fit, known.residuals_fit))
