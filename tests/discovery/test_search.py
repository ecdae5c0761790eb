"""The search, on slides whose exact motion is known: windows find effects from a wrong base, and fits end there."""

import dataclasses
import time

import numpy as np
import pytest

from hydrotwin.discovery.evidence.score import Spectrum
from hydrotwin.discovery.structures import foreseen as foreseen_module
from hydrotwin.discovery.structures import search as search_module
from hydrotwin.discovery.structures.foreseen import foreseen, larger, singles
from hydrotwin.discovery.structures.jobs import EFFORTS
from hydrotwin.discovery.structures.starts import compatible
from tests.discovery.slides import NOISE, begun, found, records, searched, slide, tried

SOME = ("coulomb_friction", "null_bias", "dead_time", "sensor_bias", "sensor_scale", "command_saturation")


def one(search, name):
    """The entry of an effect alone."""
    return search.table.entry([next(c for c in search.table.candidates if c.id == name)])


@pytest.fixture(scope="module")
def rubbing():
    """30 N of dry friction."""
    return searched(records(3, dry=30.0), SOME)


def test_friction_is_found_with_its_force_from_a_base_that_is_30_percent_off(rubbing):
    search, said = rubbing
    assert said.verdict == "named"
    assert [c.id for c in said.order] == ["coulomb_friction"]
    values = said.best.fitted.values
    assert next(v for n, v in values.items() if n.endswith(".force")) == pytest.approx(30.0, rel=0.03)
    assert values["mass.mass"] == pytest.approx(50.0, rel=0.02)
    assert said.probability(said.best.key[0]) == pytest.approx(0.97, abs=0.01)
    assert search.complete


def test_every_candidate_was_looked_at_and_none_is_worse_than_the_base_it_contains(rubbing):
    search, _ = rubbing
    table = search.table
    singles = [table.entries[(c.label,)] for c in table.candidates]
    assert all(e.seen for e in singles)
    base = table.score(table.entry())
    assert all(table.score(e) < base + 2.0 for e in table.fitted)


def test_nothing_is_missing_where_nothing_is():
    _, said = searched(records(3), SOME)
    assert said.verdict == "none"
    assert said.told()["nothing"] > 0.95
    assert not said.kept.members


def test_a_push_that_no_effect_holds_gets_no_name():
    _, said = searched(records(3, pulse=80.0), ("null_bias", "sensor_scale", "dead_time"))
    assert said.verdict == "unknown"
    assert said.told()["something else"] > 0.9


def test_two_effects_of_which_neither_explains_the_gap_are_found_together():
    _, said = searched(records(3, dry=50.0, late=3), SOME)
    assert {c.id for c in said.order} == {"coulomb_friction", "dead_time"}
    values = said.best.fitted.values
    assert next(v for n, v in values.items() if n.endswith(".time")) == pytest.approx(0.06, abs=0.002)


def test_a_time_limit_ends_the_search_with_what_is_known():
    began = time.monotonic()
    search, said = searched(records(3, dry=30.0), SOME, time_limit=0.0)
    assert not search.complete
    assert said.verdict in ("unknown", "named")
    assert time.monotonic() - began < 30
    assert search.table.entry().fitted


def test_with_a_time_limit_no_more_than_a_few_jobs_run_before_the_time_is_asked():
    search = begun(records(2, pulse=80.0), SOME, effort="quick", most=1, until=time.monotonic() + 1e6)
    run, sizes = search.run, []
    search.run = lambda function, jobs, stage: (sizes.append(len(jobs)), run(function, jobs, stage))[1]
    search.go()
    assert search.table.seen_all() and len(search.table.candidates) > search.effort.together
    assert max(sizes) <= search.effort.together


def test_a_candidate_that_fails_costs_only_itself(monkeypatch):
    from hydrotwin.discovery.structures import table

    real = table.Table.model

    def broken(self, entry):
        if any("null_bias" in label for label in entry.key):
            from hydrotwin.models.language.errors import SolveError

            raise SolveError("no solution here")
        return real(self, entry)

    monkeypatch.setattr(table.Table, "model", broken)
    search, said = searched(records(3, dry=30.0), ("coulomb_friction", "null_bias"))
    assert said.verdict == "named"
    assert [e.failed for e in search.table.entries.values() if e.failed] == ["no solution here"]


def test_finer_forms_do_not_stand_beside_what_they_refine(rubbing):
    from hydrotwin.models.effects import candidates

    plain, finer = candidates(slide(), ["coulomb_friction"]), candidates(slide(), ["stribeck_friction"])
    assert not compatible((*plain, *finer))
    assert compatible(candidates(slide(), ["coulomb_friction", "dead_time"]))


def test_efforts_grow():
    small, usual, large = (dataclasses.asdict(EFFORTS[e]) for e in ("quick", "normal", "thorough"))
    assert all(small[k] <= usual[k] <= large[k] for k in ("fits", "pool", "look", "seconds", "iterations"))


def test_scores_are_finite_and_the_noise_is_the_sensors(rubbing):
    search, _ = rubbing
    assert np.isfinite(list(search.table.scores().values())).all()
    assert search.table.noise == pytest.approx([NOISE])


def test_no_candidate_is_forbidden_what_promises_little_only_waits():
    search = begun(records(3, pulse=80.0), ("null_bias", "sensor_scale", "dead_time"), most=1)
    search.effort = dataclasses.replace(search.effort, fits=99)
    search.go()
    assert search.complete and not search.waiting()
    assert all(one(search, c.id).fitted for c in search.table.candidates)


def test_a_search_that_its_time_limit_ended_says_so_and_what_it_would_have_tried():
    answer = found(records(3, dry=30.0), SOME, time_limit=0.0)
    assert answer.verdict in ("unknown", "named", "class")
    assert answer.untried or answer.screened == 0
    assert any("the time limit ended the search" in f for f in answer.findings)


def test_a_fit_that_diverges_costs_only_its_candidate_which_is_told(monkeypatch):
    from hydrotwin.discovery.structures import search as module

    real = module.step
    monkeypatch.setattr(module, "step", lambda job: "it diverges" if "null_bias" in job.label else real(job))
    answer = found(records(3, dry=30.0), ("coulomb_friction", "null_bias"))
    assert [s.effect for s in answer.steps] == ["coulomb_friction"]
    assert any("null_bias at force cannot be tried here (it diverges)" in f for f in answer.findings)


@pytest.mark.parametrize("worse", [50.0, 1.0])
def test_a_structure_is_never_left_worse_than_a_part_of_it(worse):
    """As if the first fit of the pair had ended in a hollow: it goes on from where its part did."""
    search, asked = begun(records(3, dry=30.0), ("coulomb_friction", "null_bias")), []
    search.identify()
    alone = one(search, "coulomb_friction")
    tried(search, alone)
    table, real = search.table, search.run

    def hollow(function, jobs, stage):
        fits = real(function, jobs, stage)
        asked.extend(job for job, f in zip(jobs, fits, strict=True) if hasattr(f, "at_bound"))
        if len(asked) == 1 and hasattr(fits[0], "at_bound"):
            left = dataclasses.replace(fits[0].left, squares=worse * fits[0].left.squares)
            fits = [dataclasses.replace(fits[0], left=left)]
        return fits

    search.run = hollow
    pair = table.entry(table.candidates)
    tried(search, pair)
    assert table.score(pair) <= table.score(alone) + 1.0
    assert len(asked) == (2 if worse > 1.0 else 1)
    if worse > 1.0:
        assert asked[1].starts[0]["mass.mass"] == alone.fitted.values["mass.mass"]


def test_between_its_batches_a_search_pauses_and_a_base_is_identified_once():
    paused = []
    search = begun(records(3, dry=30.0), ("coulomb_friction", "null_bias"))
    search.pause = paused.append
    base = search.identify()
    assert search.identify() is base
    search.go()
    assert len(paused) > 3 and set(map(id, paused)) == {id(search)}


def test_an_effect_that_is_idle_beside_two_others_is_dropped():
    _, said = searched(records(3, dry=50.0, late=1), ("coulomb_friction", "dead_time", "null_bias"))
    assert {c.id for c in said.order} == {"coulomb_friction", "dead_time"}


def test_a_search_stops_where_windows_say_that_a_structure_is_right_and_longer_runs_not(monkeypatch):
    search = begun(records(2, dry=200.0, seconds=6.0), SOME[:2], most=2)
    monkeypatch.setattr(search.table, "explained", lambda by=(): False)
    monkeypatch.setattr(search.table, "was_right", lambda entry, share: "coulomb_friction" in str(entry.key))
    surprise = search.go()
    assert surprise.fitted and "coulomb_friction" in str(surprise.key)
    again = begun(records(2, dry=200.0, seconds=6.0), SOME[:2], most=2)
    again.identify()
    again.take_looks(search)
    taken = {key: e.look for key, e in again.table.entries.items() if e.members}
    assert taken and all(search.table.entries[key].look.squares is look.squares for key, look in taken.items() if look)
    while search.go():
        pass
    assert len(search.surprises) == 2 and search.complete


@pytest.mark.parametrize(("dry", "far_off"), [(30.0, True), (0.0, False)])
def test_each_start_of_the_base_has_a_look_s_time_and_only_one_that_may_be_right_goes_on_to_its_rest(dry, far_off):
    search, asked = begun(records(2, dry=dry), SOME), []
    done = search.run

    def run(function, jobs, stage):
        asked.extend(jobs)
        return [dataclasses.replace(f, converged=False) if hasattr(f, "converged") else f
                for f in done(function, jobs, stage)]  # fmt: skip

    search.run = run
    search.identify()
    assert bool(search.first) is far_off
    fits = [job for job in asked if job.stages is None]
    starts, further = (fits, []) if far_off else (fits[:-1], fits[-1:])
    assert starts and {job.seconds for job in starts} == {search.effort.look}
    for job in further:
        assert job.seconds == search.effort.seconds and job.starts == (search.table.entry().fitted.values,)


def test_a_base_that_had_not_come_to_rest_is_not_freed_where_its_own_fit_leads_there_too():
    search = begun(records(2, dry=30.0), SOME)
    base = search.identify()
    rest, best = base.fitted, one(search, "coulomb_friction")
    tried(search, best)
    own = search.table.score(base)
    left = Spectrum(1e6 * rest.left.squares, rest.left.counts)
    base.fitted, search.least = dataclasses.replace(rest, left=left, converged=False), np.inf
    assert search.table.score(base) > 2.1 * own  # where it comes to rest it would seem to be freed
    search._free_base([best])
    assert search.table.score(base) == pytest.approx(own, rel=0.02)


def test_what_windows_show_in_part_is_fitted_before_pairs_are_made_of_it(monkeypatch):
    """Load-dependent flow promised a quarter in short windows and explained all of whole recordings."""
    search, pairs = begun(records(3, dry=200.0), SOME[:3], most=2), []
    search.identify()
    monkeypatch.setattr(search_module, "larger", lambda jobs, size: pairs.append(size) or [])
    monkeypatch.setattr(search, "_promises_much", lambda entry: False)
    search._through(2)
    assert one(search, "coulomb_friction").fitted and search.table.explained() and not pairs
    rest = [one(search, name) for name in SOME[1:3]]
    assert all(e.open or search.table.share(e) <= search.table.promise(e) for e in rest)


def test_what_promises_most_is_fitted_as_it_stands_once(monkeypatch):
    search, stood = begun(records(2, pulse=80.0), ("null_bias", "sensor_scale", "dead_time"), most=1), []
    search.identify()
    monkeypatch.setattr(search, "_promises_much", lambda entry: False)
    real = search.fits.fit

    def fit(entries, **how):
        stood.extend(e.key for e in entries)
        real(entries, **how)

    monkeypatch.setattr(search.fits, "fit", fit)
    entries = [search.table.entry([c]) for c in search.table.candidates]
    search._looked(entries)
    search._looked(entries)
    assert len(stood) == len(set(stood)) >= 1
    lowest = min(entries, key=lambda e: search.table.promise(e))
    assert lowest.key in stood


def test_to_the_best_structure_everything_is_added_that_promises_much_beside_it():
    """Alone a bias promises less than others do here: it does not belong to the pairs of what promises most alone."""
    search = begun(records(3, dry=30.0, leaning=8.0), SOME)
    search.identify()
    search._to_whole_recordings()
    search._looked(singles(search.jobs))
    search.jobs.effort = dataclasses.replace(search.effort, pool=1)
    rubbing = one(search, "coulomb_friction")
    tried(search, rubbing)
    shares = foreseen(search.table, search.jobs, rubbing)
    wanted = min(shares, key=lambda label: shares[label].left)
    assert {wanted, *rubbing.key} in [set(e.key) for e in larger(search.jobs, 2)]


def test_what_explains_much_is_fitted_with_what_promises_most_beside_it_before_others_are_looked_at():
    """Looks had gone through all single effects first, and pairs had come last."""
    search = begun(records(3, dry=30.0, leaning=8.0), SOME, most=2)
    search.identify()
    rubbing = one(search, "coulomb_friction")
    tried(search, rubbing)
    assert not search.table.explained() and search.table.share(rubbing) < 0.4
    search.growth.grow(search.first)
    best = min(search.table.fitted, key=search.table.score)
    assert len(best.key) == 2 and set(rubbing.key) < set(best.key)
    assert search.table.score(best) < 0.9 * search.table.score(rubbing)
    assert [e for e in search.table.entries.values() if e.members and e.look] == [rubbing]
    known = len(search.table.entries)
    search.growth.grow(search.first)
    assert len(search.table.entries) == known  # once


def test_looks_at_what_first_order_puts_first_try_every_start(monkeypatch):
    """From where it costs least nothing had led on, and the right effect had seemed to explain nothing."""
    monkeypatch.setattr(foreseen_module, "LIKELY", 1)
    search = begun(records(3, dry=30.0), SOME)
    search.identify()
    search._to_whole_recordings()
    first, *others = singles(search.jobs)
    assert search.jobs.next(first, 0).tries and not any(search.jobs.next(e, 0).tries for e in others)
    tried(search, first)
    assert search.jobs.whole(first).tries and search.jobs.plain_soon(others[0]).tries
    assert not search.jobs.glance_from(first, others[0], {}, search.table.question, 3).tries
