"""The driver sums plain squares itself, for all windows of a recording in one call: as numpy does, window by window."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.identification import descent, horizon
from hydrotwin.identification.horizon import window_starts
from hydrotwin.identification.least_squares import DampedStep, minimise
from hydrotwin.identification.shooting import WEAK_PRIOR, Shooting
from hydrotwin.models.language.errors import SolveError
from hydrotwin.simulation import prepare
from hydrotwin.simulation.library import Library
from tests.identification.test_parts import task


def with_gaps(t: descent.Task) -> descent.Task:
    """Samples that one sensor misses, in one recording; and an output that is not used."""
    first = dataclasses.replace(t.recordings[0], y=t.recordings[0].y.copy())
    first.y[3:9, 0] = np.nan
    first.y[-1, 1] = np.nan
    return dataclasses.replace(t, recordings=(first, *t.recordings[1:]))


def windows_of(t: descent.Task, q):
    states = horizon.first_guess(t.flat, t.recordings, t.propagator, t.free.vector(q), 1.0)
    return descent.windows(t, q, 1.0, states)


def one_by_one(shooting, monkeypatch):
    other = dataclasses.replace(shooting)
    monkeypatch.setitem(other.__dict__, "_in_one_call", False)
    return other


@pytest.mark.parametrize("cut", ["windows", "whole runs"])
@pytest.mark.parametrize(("threads", "dead_time"), [(1, False), (2, False), (1, True)])
def test_one_call_expands_what_many_do(cut, threads, dead_time, monkeypatch):
    t = dataclasses.replace(with_gaps(task(dead_time=dead_time, start={"delay": 0.13})), threads=threads)
    q = t.free.scaled(t.free.start) + 0.1
    shooting, z = windows_of(t, q) if cut == "windows" else descent.whole_runs(t)
    assert shooting._in_one_call
    at, other = shooting.linearise(q, z), one_by_one(shooting, monkeypatch).linearise(q, z)
    assert not at.diverged.any()
    np.testing.assert_allclose(at.costs, other.costs, rtol=1e-10)
    for ours, theirs in ((at.gradient, other.gradient), (at.hessian, other.hessian)):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12 * np.abs(theirs).max())
    assert shooting.cost(q, z) == pytest.approx(one_by_one(shooting, monkeypatch).cost(q, z), rel=1e-10)
    assert shooting.cost(q, z) == pytest.approx(at.cost, rel=1e-10)


def test_squares_are_those_of_what_was_measured_without_weights():
    t = with_gaps(task())
    q = t.free.scaled(t.free.start) + 0.1
    shooting, z = descent.whole_runs(t)
    left = [shooting.residuals(i, q, z[i]) / t.weights for i in range(len(z))]
    expected = [np.nansum(r**2, axis=0) for r in left]
    np.testing.assert_allclose(shooting.linearise(q, z).squares, expected, rtol=1e-9)
    assert dataclasses.replace(shooting, averaged=2).linearise(q, z).squares is None


@pytest.mark.parametrize("threads", [1, 2])
def test_under_other_weights_the_same_point_needs_no_other_run(threads, monkeypatch):
    t = dataclasses.replace(with_gaps(task()), threads=threads)
    q, runs, expansions = t.free.scaled(t.free.start) + 0.1, [], Library.expansions
    monkeypatch.setattr(Library, "expansions", lambda self, *a: runs.append(1) or expansions(self, *a))
    heavier = dataclasses.replace(t, weights=t.weights * [3.0, 0.2])
    (shooting, z), (other, _) = descent.whole_runs(t), descent.whole_runs(heavier)
    shooting.linearise(q, z)
    before, at = len(runs), other.linearise(q, z)
    assert before and len(runs) == before
    anew = dataclasses.replace(other, propagator=prepare(
        t.flat, free_parameters=t.free.names, free_states=[s.name for s in t.flat.states]
    ))  # fmt: skip
    np.testing.assert_array_equal(at.hessian, anew.linearise(q, z).hessian)
    moved = z + 1e-3
    assert other.linearise(q, moved).cost != at.cost
    assert other.linearise(q + 1e-3, z).cost != at.cost
    later = dataclasses.replace(other.recordings[0], y=other.recordings[0].y + 0.1)
    elsewhere = dataclasses.replace(other, recordings=(later, *other.recordings[1:]))
    assert elsewhere.linearise(q, z).cost != at.cost


def test_an_output_that_is_not_used_costs_nothing(monkeypatch):
    t = task()
    t = dataclasses.replace(t, weights=t.weights * [1.0, 0.0])
    q = t.free.scaled(t.free.start) + 0.1
    shooting, z = windows_of(t, q)
    at, other = shooting.linearise(q, z), one_by_one(shooting, monkeypatch).linearise(q, z)
    np.testing.assert_allclose(at.hessian, other.hessian, rtol=1e-9, atol=1e-12 * np.abs(other.hessian).max())


def test_a_window_that_leaves_the_finite_numbers_counts_as_diverged(monkeypatch):
    t = task()
    q = t.free.scaled(t.free.start)
    shooting, z = windows_of(t, q)
    z[2] = 1e300
    for one in (shooting, one_by_one(shooting, monkeypatch)):
        at = one.linearise(q, z)
        assert at.diverged.tolist() == [i == 2 for i in range(len(z))]
        assert at.squares is None or (~np.isfinite(at.squares)).all(axis=1).tolist() == at.diverged.tolist()
        assert np.isfinite(at.cost) and not at.gradient[2].any()
        assert one.cost(q, z) == pytest.approx(at.cost)


def test_without_a_compiler_the_sums_are_the_same():
    t = task()
    q = t.free.scaled(t.free.start) + 0.1
    names = {"free_parameters": t.free.names, "free_states": [s.name for s in t.flat.states]}
    t = dataclasses.replace(t, propagator=prepare(t.flat, method="explicit", **names))
    slow = dataclasses.replace(t, propagator=prepare(t.flat, method="vm", **names))
    (shooting, z), (other, _) = descent.whole_runs(t), descent.whole_runs(slow)
    assert not other._in_one_call
    with pytest.raises(SolveError, match="only compiled runs"):
        r = slow.recordings[0]
        slow.propagator.costs(r.time, r.u, t.free.vector(q), [[0, 0, 9]], np.zeros((1, 2)), r.y, t.weights)
    np.testing.assert_allclose(shooting.linearise(q, z).hessian, other.linearise(q, z).hessian, rtol=1e-8)


def test_cuts_outside_the_recording_are_refused():
    t = task()
    r, p = t.recordings[0], t.free.vector(t.free.scaled(t.free.start))
    x0 = np.zeros((1, len(t.flat.states)))
    for cut in ([0, 0, len(r.time) + 1], [5, 4, 9], [-1, 0, 9], [3, 3, 3]):
        with pytest.raises(SolveError, match="cuts must be rows"):
            t.propagator.costs(r.time, r.u, p, [cut], x0, r.y, t.weights)


def test_a_run_that_costs_more_than_its_limit_is_given_up():
    t = task()
    q = t.free.scaled(t.free.start) + 0.1
    shooting, z = descent.whole_runs(t)
    r, p, cuts = t.recordings[0], t.free.vector(q), [[0, 0, len(t.recordings[0].time)]] * 2
    x0, dx0 = (np.repeat(part[None], 2, axis=0) for part in shooting._seeds(r.u, p, z[0]))
    cost = t.propagator.costs(r.time, r.u, p, cuts, x0, r.y, t.weights)
    limited = t.propagator.costs(r.time, r.u, p, cuts, x0, r.y, t.weights, cost * [0.9, 1.1])
    assert np.isnan(limited[0]) and limited[1] == cost[1]
    asked = r.time, r.u, p, cuts, x0, dx0, r.y
    limits = np.array([[0.0] * len(t.weights), [np.inf] * len(t.weights)])
    given_up, _, _ = t.propagator.expansions(*asked, limits)
    squares, *_ = t.propagator.expansions(*asked)  # what was given up is not remembered
    assert np.isnan(given_up[0]).all() and np.isfinite(squares).all()
    np.testing.assert_array_equal(given_up[1], squares[1])


def test_a_step_that_costs_more_than_where_it_began_is_given_up_and_the_minimum_stays_the_same(monkeypatch):
    """Absurd parameters make a run a hundred times as dear as others, and how bad they are nobody needs to know."""
    t = task()
    shooting, z = descent.whole_runs(t)
    here, there = (t.free.scaled(t.free.start) + shift for shift in (0.0, 1.0))
    enough, whole = shooting.cost(here, z), shooting.cost(there, z)
    assert whole > 10 * enough
    for given_up in (shooting.linearise(there, z, enough), shooting.linearise(there, z, enough / 10)):
        assert given_up.diverged.all() and given_up.cost > enough
    assert shooting.cost(there, z, enough) > enough
    assert shooting.linearise(here, z, enough).cost == shooting.linearise(here, z).cost

    found, linearise, cost, steps = minimise(shooting, there, z), Shooting.linearise, Shooting.cost, []
    monkeypatch.setattr(Shooting, "linearise", lambda self, q, z, above=0: steps.append(above) or linearise(self, q, z))
    monkeypatch.setattr(Shooting, "cost", lambda self, q, z, above=0: cost(self, q, z))
    patient = minimise(shooting, there, z)
    assert np.array_equal(found.q, patient.q) and found.iterations == patient.iterations
    assert np.isfinite(steps[1:]).all() and sorted(steps[1:], reverse=True) == steps[1:], "each held against the last"


def test_windows_begin_again_in_the_states_where_they_began():
    """Also those that begin early to fill a delay line: what follows is told of the states there, not of a guess."""
    t = task(dead_time=True, start={"delay": 0.13})
    q = t.free.scaled(t.free.start)
    shooting, z = windows_of(t, q)
    assert any(s.begin < s.first for s in shooting.segments)
    moved = shooting.clip(z + np.linspace(-0.3, 0.3, z.size).reshape(z.shape))
    known = shooting.trajectories(q, moved)
    np.testing.assert_allclose(window_starts(shooting.segments, known, shooting.start), moved, rtol=1e-12)


def test_a_start_that_is_forgotten_before_its_first_residual_keeps_to_its_guess():
    """While a delay line fills, a fast drive forgets how fast it was: a step of thousands of nominals cost nothing."""
    t = task(dead_time=True, start={"delay": 0.13, "motor.time_constant": 0.003})
    blind = tuple(dataclasses.replace(r, y=r.y * [np.nan, 1.0]) for r in t.recordings)
    t = dataclasses.replace(t, recordings=blind)
    q = t.free.scaled(t.free.start) + 0.1
    shooting, z = windows_of(t, q)
    fills = np.array([s.begin < s.first for s in shooting.segments])
    at = shooting.linearise(q, z)
    assert 0 < fills.sum() < len(fills)
    known = np.einsum("sii->si", at.hessian)[:, len(q) :]
    assert np.all(known[fills] >= WEAK_PRIOR**2) and np.all(known[~fills, 0] > 100 * WEAK_PRIOR**2)
    step = DampedStep(at, len(q), np.einsum("sii->si", at.hessian), 1e-3)
    dq, dz = step.towards(at.gradient, np.full(len(q), -0.5), np.full(len(q), 0.5))
    assert np.abs(dz).max() < 1.0
    assert shooting.cost(q + dq, z + dz) < at.cost
