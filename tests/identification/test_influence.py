"""Sensitivities against closed forms, finite differences, and what must be refused."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

import hydrotwin
from hydrotwin.identification import identify, sensitivity
from hydrotwin.identification.influence import sobol
from hydrotwin.models.language import DataError, DeclarationError
from hydrotwin.simulation import simulate
from hydrotwin.simulation.many import run_many
from tests.identification.influences import (
    ISHIGAMI_FIRST,
    ISHIGAMI_TOTAL,
    PI,
    exploding,
    ishigami,
    product,
    record,
    steps,
    waves,
    weighted,
)

ALL = {"parameters": ["*"]}
LOCAL = {**ALL, "samples": 0, "stretches": 2}


def one_wild_set(*asked):
    """`run_many`, of whose sets one nearly diverges in y, as in steps that are too long for it."""
    y, stops = run_many(*asked)
    y[3, 50:, 0] *= 1e9
    return y, stops


def test_indices_of_ishigami_are_those_on_paper():
    found = sensitivity(ishigami(), [record(seconds=0.1)], **ALL, given=PI, samples=2048, stretches=1).sobol.whole
    assert found.first[0] == pytest.approx(ISHIGAMI_FIRST, abs=0.03)
    assert found.total[0] == pytest.approx(ISHIGAMI_TOTAL, abs=0.03)
    assert (np.abs(found.total[0] - ISHIGAMI_TOTAL) <= 2 * found.total_half[0]).all()
    assert (found.total_half[0] < 0.1).all()


def test_shares_of_a_linear_course_are_those_of_its_terms():
    """y = a u + b v over intervals of half width 0.1 and 0.2: variances 0.01 u^2/3 and 0.04 v^2/3, over all samples."""
    driven = record(u=lambda t: np.where(t < 1.0, 3.0, 0.5), v=lambda t: np.where(t < 1.0, 0.5, 1.5))
    found = sensitivity(weighted(), [driven], **ALL, over="10%", samples=256, stretches=2)
    u, v = driven["u"], driven["v"]

    def share(part: slice) -> float:
        of_a, of_b = 0.01 * np.sum(u[part] ** 2), 0.04 * np.sum(v[part] ** 2)
        return of_a / (of_a + of_b)

    early, late = found.sobol.by_stretch[0]
    for indices, part in ((found.sobol.whole, slice(None)), (early, slice(100)), (late, slice(100, None))):
        assert indices.first[0] == pytest.approx([share(part), 1 - share(part)], abs=0.02)
        assert indices.total[0] == pytest.approx([share(part), 1 - share(part)], abs=0.02)
        assert indices.first[1] == pytest.approx([1.0, 0.0], abs=0.02)
    assert found.drivers("z") == [("a", pytest.approx(1.0, abs=0.02))]
    exact = found.local.moved[0] ** 2 / np.sum(found.local.moved[0] ** 2)
    assert exact == pytest.approx([share(slice(None)), 1 - share(slice(None))], rel=1e-9)


@pytest.mark.parametrize("of", ["course", "deviation"])
def test_recordings_count_by_their_samples_however_few_are_kept(of):
    """A long recording in which a acts alone, and one of a fiftieth of it in which b does: the shares are those of sums
    over all samples, of whose variances a has nearly all; as many instants each would give b two thirds."""
    runs = [record("long", seconds=50.0, u=1.0, v=0.0), record("short", seconds=1.0, u=0.0, v=1.0)]
    found = sensitivity(weighted(), runs, **ALL, over="10%", samples=256, stretches=2, of=of).sobol.whole
    of_a, of_b = 0.01 * 50.0, 0.04 * 1.0
    if of == "course":
        assert found.total[0] == pytest.approx([of_a / (of_a + of_b), of_b / (of_a + of_b)], abs=0.02)
        assert found.spread[0] == pytest.approx(np.sqrt((of_a + of_b) / 3 / 51.0), rel=0.02)
    else:  # of sqrt(50 x^2 + 4 y^2), x and y uniform in 0 to 0.1, by a sum over a grid
        x = (np.arange(400) + 0.5) / 4000
        distance = np.sqrt(50 * x[:, None] ** 2 + 4 * x**2)
        parts = [distance.var(axis=axis).mean() / distance.var() for axis in (0, 1)]
        assert found.total[0] == pytest.approx(parts, abs=0.03)


def test_indices_of_courses_of_many_shapes_are_those_of_all_instants():
    """Against the integrals over the intervals: E(y | a) = sin(a t), E(y | b) = b times the mean of sin(a t)."""
    run, intervals = record(seconds=4.0), {"a": (2.0, 20.0), "b": (0.2, 1.8)}
    found = sensitivity(waves(), [run], **ALL, given=intervals, samples=1024, stretches=1).sobol.whole
    a, kept = np.linspace(2.0, 20.0, 4001), run.time
    of_a, of_b = np.sin(np.outer(kept, a)), 1.6**2 / 12
    whole = (1 + of_b) * (of_a**2).mean(axis=1) - of_a.mean(axis=1) ** 2
    alone = [of_a.var(axis=1).sum() / whole.sum(), (of_b * of_a.mean(axis=1) ** 2).sum() / whole.sum()]
    assert found.first[0] == pytest.approx(alone, abs=0.02)
    assert found.total[0] == pytest.approx([1 - alone[1], 1 - alone[0]], abs=0.02)
    assert (found.total_half[0] < 0.05).all()


def test_local_sensitivities_that_do_not_hold_over_the_intervals_are_told():
    """After 4 s the phase of b sin(a t) has gone through many periods."""
    for low, high, told in ((2.0, 20.0, ["beyond"]), (9.9, 10.1, [])):
        asked = {"given": {"a": (low, high), "b": (0.9, 1.1)}, "samples": 64, "stretches": 1}
        found = sensitivity(waves(), [record(seconds=4.0)], **ALL, **asked)
        assert [f.kind for f in found.findings if f.kind == "beyond"] == told


def test_the_deviation_is_told_as_one_number():
    """The root mean square of y - y_nominal is |a - 1| |u| where a acts alone: a has it all."""
    found = sensitivity(
        weighted(), [record(u=1.0, v=0.0)], **ALL, over="10%", samples=256, stretches=1, of="deviation"
    ).sobol.whole
    assert found.total[1] == pytest.approx([1.0, 0.0], abs=0.05)


def test_local_sensitivities_are_finite_differences():
    model, driven = product(), record(u=steps, x_seen=0.0)
    found = sensitivity(model, [driven], **LOCAL, over="10%")
    for k, interval in enumerate(found.parameters):
        step = 1e-5 * interval.value
        up, down = (simulate(model, driven, parameters={interval.name: interval.value + s}) for s in (step, -step))
        for j, signal in enumerate(found.outputs):
            slope = (up[signal.name] - down[signal.name]) / (2 * step) * 0.1 * interval.value
            assert found.local.moved[j, k] == pytest.approx(np.sqrt(np.mean(slope**2)), rel=1e-5, abs=1e-12)
            parts = [np.sqrt(np.mean(part**2)) for part in np.split(slope, 2)]
            assert found.local.by_stretch[0][:, j, k] == pytest.approx(parts, rel=1e-5, abs=1e-12)


def test_a_product_is_told_with_the_output_that_would_part_it():
    seen = simulate(product(), record(u=steps, x_seen=0.0))["x_seen"]
    noisy = seen + 0.01 * np.random.default_rng(0).standard_normal(len(seen))
    found = sensitivity(product(), [record(u=steps, x_seen=noisy)], **LOCAL)
    told = [f for f in found.findings if f.kind == "indistinguishable"]
    assert [f.parameters for f in told] == [("a", "b")]
    assert "record a_seen" in told[0].sentence
    assert found.known.correlation[0, 1] == pytest.approx(-1.0, abs=1e-6)


def test_what_a_sensor_would_tell_is_what_the_normal_equations_say():
    """y = a u + b v with an error of 0.1, z = a u with one of 0.2: everything is known on paper."""
    rng = np.random.default_rng(1)
    driven = record(u=lambda t: np.sin(3 * t), v=lambda t: np.sin(3 * t) + 0.1 * t)
    u, v = driven["u"], driven["v"]
    y = u + 2 * v + 0.1 * rng.standard_normal(len(u))
    driven = record(u=u, v=v, y=y)
    found = sensitivity(weighted(), [driven], **LOCAL, noise={"y": 0.1, "z": 0.2})
    columns = np.column_stack([u, 2 * v])  # dy/dq: q is p over its value
    error = max(0.1, np.sqrt(np.mean((y - u - 2 * v) ** 2)))
    H = columns.T @ columns / error**2
    sensor = H + np.diag([u @ u, 0.0]) / 0.2**2
    for kind, then in (("sensor", sensor), ("repeat", 2 * H)):
        told = next(m for m in found.measurements if m.kind == kind)
        now, after = (np.linalg.inv(matrix + np.eye(2)) for matrix in (H, then))
        assert list(told.narrowed.values()) == pytest.approx(np.sqrt(np.diag(after) / np.diag(now)), rel=1e-6)
        assert told.gain == pytest.approx(0.5 * np.log(np.linalg.det(now) / np.linalg.det(after)), rel=1e-6)
        band = np.sum((columns @ after) * columns) / np.sum((columns @ now) * columns)
        assert told.bands["y"] == pytest.approx(np.sqrt(band), rel=1e-6)
    assert [m.gain for m in found.measurements] == sorted([m.gain for m in found.measurements], reverse=True)


def test_the_sensor_that_parts_a_product_comes_first_and_a_goal_changes_the_order():
    seen = simulate(product(), record(u=steps, x_seen=0.0))["x_seen"]
    driven = record(u=steps, x_seen=seen + 0.01 * np.random.default_rng(0).standard_normal(len(seen)))
    first = sensitivity(product(), [driven], **LOCAL).measurements[0]
    assert (first.kind, first.what) == ("sensor", "a_seen")
    assert (
        first.sentence.startswith("A sensor of a_seen (error ")
        and "which these recordings leave open" in first.sentence
    )
    for_tau = sensitivity(product(), [driven], **LOCAL, goal=["tau"]).measurements
    assert for_tau[0].kind != "sensor" and "tau" in for_tau[0].sentence
    assert {m.kind for m in for_tau} == {"sensor", "repeat", "drive"}
    with pytest.raises(DeclarationError, match="neither a parameter asked about nor an output"):
        sensitivity(product(), [driven], **LOCAL, goal=["tua"])


def test_a_parameter_without_effect_is_told_once_and_refused_alone():
    driven = record(u=1.0, v=0.5)
    found = sensitivity(weighted(idle=True), [driven], **ALL, samples=64, stretches=1)
    assert [f.parameters for f in found.findings if f.kind == "without_effect"] == [("idle",)]
    assert not [f for f in found.findings if f.kind == "no_effect"]
    assert found.sobol.whole.total[0, 2] == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(DeclarationError, match=r"idle moves no output of weighted"):
        sensitivity(weighted(idle=True), [driven], parameters=["idle"])


@pytest.mark.parametrize(("how", "cut"), [("10%", False), ("100%", False), ("200%", True), ("bounds", False)])
def test_an_interval_that_the_bounds_make_narrower_says_so(how, cut):
    from hydrotwin.identification.influence.intervals import intervals

    bounded = [dataclasses.replace(p, bounds=(0.0, 25.0)) for p in waves().parameters]
    for one in intervals(dataclasses.replace(waves(), parameters=tuple(bounded)), ["a"], how):
        assert ("cut at a bound" in one.source) == cut, (one, how)


def test_intervals_come_from_the_fit_and_what_is_correlated_there_is_told():
    driven = record(u=lambda t: np.sin(3 * t), v=lambda t: np.sin(3 * t) + 0.1 * t)
    y = simulate(weighted(), driven)["y"] + 0.1 * np.random.default_rng(1).standard_normal(len(driven.time))
    driven = driven.with_signals({"y": y}, {"y": "1"})
    fit = identify(weighted(), [driven], free=["*"])
    found = sensitivity(fit, [driven], **LOCAL)
    for interval, fitted in zip(found.parameters, fit.parameters, strict=True):
        assert (interval.low, interval.high) == pytest.approx(
            (fitted.value - 1.959964 * fitted.sigma, fitted.value + 1.959964 * fitted.sigma)
        )
        assert interval.source == "fit, 95 %"
    told = next(f for f in found.findings if f.kind == "correlated")
    assert told.parameters == ("a", "b") and found.known.correlation[0, 1] < -0.7
    assert found.known.noise[0] == fit.noise["y"]
    assert not [f for f in sensitivity(weighted(), [driven], **LOCAL).findings if f.kind == "correlated"]


def test_sets_that_diverge_are_counted_and_told():
    """x = 1 / (1 - a t) leaves the numbers before 2 s for a > 0.5: half of the interval."""
    short = record(seconds=2.0)
    found = sensitivity(exploding(), [short], **ALL, given={"a": (0.2, 0.8)}, samples=64, stretches=1)
    assert 0.35 * found.sobol.sets < found.sobol.diverged < 0.65 * found.sobol.sets
    assert found.sobol.used < 64 and np.isfinite(found.sobol.whole.total).all()
    told = next(f for f in found.findings if f.kind == "diverged")
    assert f"{found.sobol.diverged} of {found.sobol.sets} parameter sets diverged" in told.sentence


def test_sets_that_nearly_diverge_in_the_steps_of_the_nominal_one_are_run_as_they_need(monkeypatch):
    driven = [record(u=1.0, v=0.5)]
    asked = {**ALL, "over": "10%", "samples": 64, "stretches": 1}
    right = sensitivity(weighted(), driven, **asked).sobol.whole

    monkeypatch.setattr(sobol, "run_many", one_wild_set)
    found = sensitivity(weighted(), driven, **asked).sobol
    assert found.whole.total == pytest.approx(right.total, abs=1e-6) and found.diverged == 0


def test_an_output_at_rest_makes_no_set_far(monkeypatch):
    monkeypatch.setattr(sobol, "controlled_many", lambda *_: pytest.fail("a set is run again"))
    for u in (1.0, 0.0):
        sensitivity(weighted(), [record(u=u, v=0.5)], **ALL, over="10%", samples=16, stretches=1)


def test_what_no_method_runs_accurately_counts_as_diverged(monkeypatch):
    controlled = sobol.controlled_many

    def coarse(*asked):
        return [ran._replace(accuracy=replace(ran.accuracy, error=1.0)) for ran in controlled(*asked)]

    monkeypatch.setattr(sobol, "run_many", one_wild_set)
    monkeypatch.setattr(sobol, "controlled_many", coarse)
    found = sensitivity(weighted(), [record(u=1.0, v=0.5)], **ALL, over="10%", samples=64, stretches=1).sobol
    assert found.diverged == -(-found.sets // (sobol.AT_ONCE - 1)) and "nearly diverges" in found.reason


def test_total_indices_that_add_up_to_less_than_one_are_none():
    half, spread = np.full((2, 2), 0.01), np.ones(2)
    total = np.array([[0.46, 0.0], [0.99, 0.0]])
    assert sobol.Indices(total, half, total, half, spread).vague.tolist() == [True, False]


def test_a_total_index_beyond_one_is_known_no_better_than_that():
    half, spread = np.full((1, 2), 0.05), np.ones(1)
    for total, error in ((1.37, 0.37), (1.02, 0.05), (np.nan, 0.05)):
        found = np.array([[total, 0.0]])
        assert sobol.Indices(found, half, found, half, spread).error == pytest.approx(error)


def test_nothing_is_said_to_drive_an_output_of_which_a_few_sets_make_the_variance(monkeypatch):
    """They are told to be accurate: as near a pole of the equations."""

    monkeypatch.setattr(sobol, "run_many", one_wild_set)
    monkeypatch.setattr(sobol, "_run_far_ones_again", lambda *_: None)
    found = sensitivity(weighted(), [record(u=1.0, v=0.5)], **ALL, over="10%", samples=64, stretches=1)
    assert found.sobol.whole.vague.tolist() == [True, False]
    assert np.isnan(found.shares[0]).all() and found.sentences() == ["z is driven by a (99 %)."]
    assert next(f for f in found.findings if f.kind == "vague").sentence.count("what drives y:") == 1


def test_all_sets_diverge_is_an_error():
    with pytest.raises(DataError, match=r"diverged, which leaves too few for indices.*narrower"):
        sensitivity(exploding(), [record(seconds=2.0)], **ALL, given={"a": (0.4, 4000.0)}, samples=16, stretches=1)


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"parameters": ["tua"]}, DeclarationError, "Did you mean 'tau'"),
        ({"given": {"a": (2.0, 2.0)}}, DeclarationError, "a: its interval has no width"),
        ({"given": {"a": (3.0, 4.0)}}, DeclarationError, "lies outside its interval"),
        ({"given": {"aa": (3.0, 4.0)}}, DeclarationError, "aa"),
        ({"over": "bound"}, DeclarationError, "Did you mean 'bounds'"),
        ({"over": "bounds"}, DeclarationError, "its bounds are not finite"),
        ({"over": "fit"}, DeclarationError, "no fit tells how sure it is"),
        ({"samples": 100}, DeclarationError, "power of two"),
        ({"of": "curse"}, DeclarationError, "Did you mean 'course'"),
        ({"stretches": 0}, DeclarationError, "at least one stretch"),
        ({"noise": {"x": 1.0}}, DeclarationError, "no output 'x'"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_a_sentence(options, kind, words):
    with pytest.raises(kind, match=words):
        sensitivity(product(), [record(u=steps, x_seen=0.0)], **{**ALL, "samples": 16, **options})


def test_no_recording_and_no_parameter_are_refused():
    with pytest.raises(DataError, match="no recording"):
        sensitivity(product(), [], **ALL)
    with pytest.raises(DeclarationError, match=r"--parameters"):
        sensitivity(product(), [record(u=steps)])


def test_the_same_seed_gives_the_same_indices_on_any_number_of_threads():
    driven = [record(u=steps, x_seen=0.0), record("other", u=1.0)]
    first, second = (sensitivity(product(), driven, **ALL, samples=64, threads=n).sobol.whole.total for n in (1, 2))
    assert (first == second).all()


def test_the_answer_is_data_and_html():
    import json

    found = hydrotwin.sensitivity(product(), [record(u=steps, x_seen=0.0)], **ALL, samples=16, stretches=2)
    data = json.loads(json.dumps(found.as_data()))
    assert data["format"] == "hydrotwin-sensitivity/1"
    assert set(data["sobol"]["whole"]["total"]["x_seen"]) == {"a", "b", "tau"}
    assert len(data["local"]["stretches"]["run"]) == 2
    assert data["recordings"][0]["edges"] == pytest.approx([0.0, 1.0, 1.99])
    assert "Total Sobol indices" in found._repr_html_()
    assert "x_seen" in found.summary()
