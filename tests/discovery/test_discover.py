"""From recordings to a name: dry friction, dead time, nothing, what no catalogue has; anywhere, interrupted."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from types import SimpleNamespace

import numpy as np
import pytest

from hydrotwin.discovery import discover
from hydrotwin.discovery.answer import answering
from hydrotwin.discovery.answer.discovery import FATES
from hydrotwin.discovery.answer.view import View
from hydrotwin.discovery.evidence.deciding import DECIDING
from hydrotwin.discovery.fits import whole
from hydrotwin.models.components.mechanical import Freewheel
from hydrotwin.models.effects import candidates
from hydrotwin.models.language import Input, Model, connect, der
from hydrotwin.models.language.errors import DeclarationError, SolveError
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.work.memory import Memory
from tests.discovery.slides import (
    DAMPING,
    MASS,
    NOISE,
    PERIOD,
    Drive,
    Inline,
    Slide,
    drive_records,
    found,
    record,
    records,
    slid,
    slide,
)  # fmt: skip

SOUND = 1 - DECIDING.something_else

LIBRARY = [
    "coulomb_friction", "dead_time", "null_bias", "drift", "command_deadband", "command_saturation", "actuator_lag",
]  # fmt: skip
FEW = ["null_bias", "dead_time", "command_deadband"]


@pytest.fixture(scope="module")
def rubbing():
    """30 N of dry friction in a slide whose model has none."""
    return found(records(3, dry=30.0), LIBRARY, validate=[record(9, dry=30.0)])


# -- one hidden effect -------------------------------------------------------------------------------------------------
def test_dry_friction_is_named_at_its_place_with_its_size(rubbing):
    assert rubbing.verdict == "named"
    (step,) = rubbing.steps
    assert (step.effect, step.site) == ("coulomb_friction", "mass.flange")
    assert 0.94 < step.probability <= SOUND + 1e-9 and not step.is_class and step.gap_closed > 0.98
    (force,) = step.parameters
    assert force.value == pytest.approx(30.0, rel=0.01) and force.unit == "N"
    assert force.low < force.value < force.high < 1.05 * force.value and force.sigma < 0.01 * force.value


@pytest.mark.parametrize("effect", ["drift", "sensor_drift"])
def test_what_drifts_is_named_by_whatever_clock_it_was_recorded(effect):
    """Two loggers that had been running for an hour; a gain or a reading that creeps off from where each run begins."""
    if effect == "drift":
        runs = drive_records(3, command=lambda u: u * (1 + 0.02 * PERIOD * np.arange(len(u))))
    else:
        runs = [r.with_signals({"rate": r["rate"] + 0.5 * r.time}) for r in drive_records(3)]
    later = [Record(r.time + 3600.0, dict(r.signals), dict(r.units), r.name) for r in runs]
    asked = ["drift", "sensor_drift", "null_bias", "sensor_bias", "direction_asymmetry", "dead_time"]
    answer = found(later, asked, model=Model(Drive()))
    assert answer.verdict == "named" and [s.effect for s in answer.steps] == [effect]
    (rate,) = answer.steps[0].parameters
    assert rate.value == pytest.approx(0.02 if effect == "drift" else 0.5, rel=0.02)


def test_the_base_parameters_lose_what_they_had_swallowed(rubbing):
    true = {"mass.mass": MASS, "mass.damping": DAMPING}
    for shift in rubbing.shifts:
        assert shift.after == pytest.approx(true[shift.name], rel=0.01)
    damping = next(s for s in rubbing.shifts if s.name == "mass.damping")
    assert damping.before > 1.1 * DAMPING


def test_the_gap_shrinks_to_the_noise_on_a_recording_that_was_never_used(rubbing):
    (gap,) = rubbing.outputs["validate"]
    assert gap.rmse_before > 10 * NOISE and gap.rmse_after < 1.15 * NOISE
    assert gap.gap_closed == pytest.approx(1.0, abs=0.01)
    assert [r.role for r in rubbing.recordings] == ["fit", "fit", "fit", "report"]
    assert [rung.label for rung in rubbing.waterfall] == ["identified base", "coulomb_friction at mass.flange"]
    assert rubbing.waterfall[0].times_noise > 10 > 1.2 > rubbing.waterfall[1].times_noise


def test_the_model_that_is_returned_follows_the_machine_and_the_one_given_is_unchanged(rubbing):
    run = record(30, dry=30.0)
    answer = simulate(rubbing.model, run)["speed"]
    true = slid(run.signals["force"], 30.0)
    assert np.sqrt(np.mean((answer - true)[50:] ** 2)) < NOISE
    assert not slide().additions and [a.effect for a in rubbing.model.additions] == ["coulomb_friction"]
    assert not rubbing.base.additions


def test_what_differs_by_direction_is_one_effect_though_its_mean_is_off_as_well():
    """The model's gain of 8 is held; the drive has 10 one way and 8 the other: e = 1/9, g = 1/8."""
    drive = Model(Drive(), settings={"gain": {"free": False}})
    runs = drive_records(4, command=lambda u: np.where(u < 0, 0.8, 1.0) * u)
    wanted = ["command_gain", "direction_asymmetry", "sensor_scale", "null_bias"]
    answer = discover(drive, runs[:3], validate=runs[3:], effects=wanted, executor=Inline(), step=5e-3)
    (step,) = answer.steps
    assert step.effect == "direction_asymmetry" and not step.is_class
    values = {p.name.partition(".")[2]: p.value for p in step.parameters}
    assert values == pytest.approx({"asymmetry": 1 / 9, "gain": 1 / 8}, rel=0.02)


def test_a_gain_that_is_off_and_a_sensor_that_shows_too_much_are_a_class():
    drive = Model(Drive(), settings={"gain": {"free": False}})
    answer = discover(drive, drive_records(4), effects=["command_gain", "sensor_scale", "null_bias"],
                      executor=Inline(), step=5e-3)  # fmt: skip
    (step,) = answer.steps
    assert {m[0] for m in step.members} == {"command_gain", "sensor_scale"}
    assert answer.steps[0].parameters[0].value == pytest.approx(0.25, rel=0.02)
    told = [r for r in step.ranked if r.fate in ("named", "in class")]
    assert {r.effect for r in told} == {"command_gain", "sensor_scale"}
    for p in (p for r in told for p in r.parameters):
        assert p.low < p.value < p.high and p.high - p.low < abs(p.value), "rivals come with intervals, too"


def test_a_final_fit_that_diverges_is_a_sentence(monkeypatch):
    monkeypatch.setattr(answering, "conclude", lambda job: "identify: every run diverges.")
    with pytest.raises(SolveError, match="every run diverges"):
        discover(Model(Drive()), drive_records(4), effects=["null_bias"], executor=Inline(), step=5e-3)


class TwoCommands(Drive):
    """A drive with a second command that adds to the first."""

    second = Input("V", "second command")

    def equations(self):
        yield self.time_constant * der(self.turning) + self.turning == self.gain * (self.command + self.second)
        yield self.rate == self.turning


def test_the_same_effect_at_another_place_has_an_interval_too():
    runs = []
    for r in drive_records(4, command=lambda u: u + 0.4):
        half = {"command": r["command"] / 2, "second": r["command"] / 2, "rate": r["rate"]}
        runs.append(Record(r.time, half, {"command": "V", "second": "V", "rate": "rad/s"}, r.name))
    answer = discover(Model(TwoCommands()), runs, effects=["null_bias"], executor=Inline(), step=5e-3)
    (step,) = answer.steps
    assert answer.verdict == "named" and {m[1] for m in step.members} == {"command", "second"}
    (other,) = [r.parameters[0] for r in step.ranked if r.fate == "in class"]
    assert other.low < 0.4 < other.high and other.high - other.low < 0.2


def test_a_rival_whose_final_fit_diverges_is_told_without_interval(monkeypatch):
    fit, number = whole.conclude, iter(range(9))
    monkeypatch.setattr(answering, "conclude", lambda job: fit(job) if next(number) < 2 else "it diverges")
    drive = Model(Drive(), settings={"gain": {"free": False}})
    answer = discover(drive, drive_records(4), effects=["command_gain", "sensor_scale"], executor=Inline(), step=5e-3)
    (other,) = [r for r in answer.steps[0].ranked if r.fate == "in class"]
    assert np.isfinite(other.parameters[0].value) and np.isnan(other.parameters[0].low)


def test_every_candidate_has_its_evidence_and_its_fate(rubbing):
    rows = rubbing.steps[0].ranked
    assert rows[0].effect == "coulomb_friction" and rows[0].fate == "named"
    assert {r.fate for r in rows} <= set(FATES) and len(rows) >= 4
    assert all(r.reason for r in rows[1:])
    assert sum(r.probability for r in rows) == pytest.approx(SOUND, abs=5e-3), "the rest is that of something else"
    assert rows[0].probability == rubbing.steps[0].probability
    assert rubbing.screened >= len(rows)


def test_a_dead_time_is_named_to_a_thousandth_of_a_second():
    d = found(records(3, late=4), LIBRARY, validate=[record(9, late=4)])
    assert d.verdict == "named" and [s.effect for s in d.steps] == ["dead_time"]
    assert d.steps[0].parameters[0].value == pytest.approx(0.08, abs=1e-3)
    assert d.outputs["validate"][0].rmse_after < 1.15 * NOISE


# -- none and unknown --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("first", [0, 10, 20])
def test_nothing_is_named_where_nothing_is_missing(first):
    d = found(records(3, first), LIBRARY)
    assert d.verdict == "none" and d.steps == () and d.unknown == ()
    assert d.model.additions == ()
    assert [rung.label for rung in d.waterfall] == ["identified base"]
    assert not d.outputs["train"][0].gap_closed > 0


def test_a_pulse_at_seven_seconds_is_unknown_and_described_in_time():
    d = found(records(3, pulse=150.0), FEW, validate=[record(9, pulse=150.0)])
    assert d.verdict == "unknown" and d.steps == () and d.model.additions == ()
    assert any("time" in row.inputs for row in d.unknown)
    over = [r for r in d.regions if r.over == "time"]
    edges = [(r.edges[:-1][r.significant_before], r.edges[1:][r.significant_before]) for r in over]
    assert any(((low <= 8.0) & (high >= 7.0)).any() for low, high in edges)


def test_what_is_unknown_is_described_without_a_validation_recording_whatever_their_lengths():
    runs = [record(k, pulse=150.0, seconds=s) for k, s in enumerate((15.0, 12.0, 13.0))]
    d = found(runs, FEW)
    assert d.verdict == "unknown"
    assert any("time" in row.inputs and row.explained > 0.5 for row in d.unknown)


def test_files_of_one_name_in_several_folders_are_different_recordings():
    runs = [dataclasses.replace(r, name="run") for r in records(3, dry=60.0)]
    d = found(runs, LIBRARY, validate=[dataclasses.replace(record(5, dry=60.0), name="run")])
    assert [(r.record, r.role) for r in d.recordings] == [
        ("run", "fit"), ("run (2)", "fit"), ("run (3)", "fit"), ("run (4)", "report"),
    ]  # fmt: skip
    assert [s.effect for s in d.steps] == ["coulomb_friction"]


@pytest.mark.proof
def test_friction_is_not_named_in_place_of_a_pulse_it_cannot_explain():
    d = found(records(3, pulse=60.0, dry=0.0), ["coulomb_friction", "stribeck_friction", "viscous_friction"])
    assert d.verdict == "unknown" and d.steps == ()


# -- again -------------------------------------------------------------------------------------------------------------
def test_an_answer_is_asked_what_it_lacks(rubbing):
    """The model with its friction goes on to other recordings, which show a dead time besides."""
    later = found(records(3, 20, dry=30.0, late=3), ("dead_time", "null_bias", "coulomb_friction"), model=rubbing.model)
    assert [(s.effect, s.site) for s in later.steps] == [("dead_time", "force")]
    assert [a.effect for a in later.model.additions] == ["coulomb_friction", "dead_time"]
    assert [a.effect for a in later.base.additions] == ["coulomb_friction"]
    values = {p.name: p.value for p in later.model.flat.parameters}
    assert values["coulomb_friction.force"] == pytest.approx(30.0, rel=0.02)
    assert later.steps[0].parameters[0].value == pytest.approx(3 * 0.02, rel=0.02)


# -- anywhere, and interrupted -----------------------------------------------------------------------------------------
def figures(d):
    """What must not depend on where or when it was computed."""
    return (
        d.verdict,
        [(s.effect, s.site, s.probability, s.gap_closed, [(p.value, p.sigma) for p in s.parameters]) for s in d.steps],
        [(s.name, s.before, s.after) for s in d.shifts],
        [(o.rmse_before, o.rmse_after) for o in d.outputs["validate"]],
    )


def test_this_process_and_an_executor_of_ones_own_give_the_same_answer(rubbing):
    runs, judged = records(3, dry=30.0), [record(9, dry=30.0)]
    same_here = found(runs, LIBRARY, executor="here", validate=judged)
    assert figures(same_here) == figures(rubbing)


class Counting(Inline):
    """An inline executor that remembers what it was asked to do."""

    def __init__(self):
        self.asked = []

    def submit(self, function, *words):
        self.asked.append(function.__name__)
        return super().submit(function, *words)


class Kept(Memory):
    """A memory of what is data: final fits carry equations and are made anew."""

    def put(self, key, answer):
        with contextlib.suppress(TypeError):
            super().put(key, answer)


def test_an_interrupted_search_goes_on_from_its_memory_and_says_the_same(rubbing, tmp_path):
    runs, judged = records(3, dry=30.0), [record(9, dry=30.0)]

    number = iter(range(99))

    def interrupting(stage, done, total, note=""):
        if stage == "search" and done == total and next(number) == 3:
            raise KeyboardInterrupt

    began = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        found(runs, LIBRARY, validate=judged, memory=Kept(tmp_path), progress=interrupting)
    first = time.perf_counter() - began
    kept = len(Kept(tmp_path))
    assert kept >= 2
    whole, rest = Counting(), Counting()
    found(runs, LIBRARY, validate=judged, executor=whole)
    began = time.perf_counter()
    again = found(runs, LIBRARY, validate=judged, memory=Kept(tmp_path), executor=rest)
    second = time.perf_counter() - began
    assert again.seconds == pytest.approx(first + second, rel=0.1), "of both parts"
    assert figures(again) == figures(rubbing)
    assert len(rest.asked) == len(whole.asked) - kept


def test_a_plain_memory_can_be_given():
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        found(records(3), ["null_bias"], memory=Memory(folder))


def test_progress_tells_every_stage_in_order():
    told = []
    found(records(3, dry=30.0), ["coulomb_friction", "null_bias"], progress=lambda *said: told.append(said))
    stages = list(dict.fromkeys(stage for stage, *_ in told))
    assert stages == ["identify the base", "search", "what was assumed", "final fit"]
    assert all(0 <= done <= total for _, done, total, _ in told if total)


# -- words -------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def excluded():
    """Dry friction, which the search is not allowed to try."""
    judged = [record(9, dry=30.0)]
    return found(records(3, dry=30.0), [*FEW, "coulomb_friction"], exclude=["coulomb_friction"], validate=judged)


def test_excluded_effects_are_not_tried(excluded):
    rows = [r.effect for step in excluded.steps for r in step.ranked] + [r.effect for r in excluded.last_ranked]
    assert "coulomb_friction" not in rows and rows


def test_what_leaves_many_times_the_noise_is_not_named(excluded):
    (gap,) = excluded.outputs["validate"]
    assert gap.rmse_after < 3 * gap.noise or excluded.verdict == "unknown"


class FreeSlide(Slide):
    """The slide with a free end bolted on: the same equations."""

    end = Freewheel()

    def equations(self):
        yield from super().equations()
        yield connect(self.mass.flange, self.end.flange)


def test_a_free_end_does_not_take_the_friction_sites_away():
    fitting = {c.id for c in candidates(Model(FreeSlide()))}
    assert {c.id for c in candidates(slide())} <= fitting


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ({"effects": ["colomb_friction"]}, "Did you mean 'coulomb_friction'"),
        ({"exclude": ["driff"]}, "Did you mean 'drift'"),
        ({"max_effects": 0}, "at least 1"),
        ({"free": ["mass.mas"]}, "mass.mass"),
        ({"noise": {"sped": 1.0}}, "speed"),
        ({"executor": "her"}, "Did you mean 'here'"),
    ],
)
def test_words_that_mean_nothing_are_refused(words, says):
    asked = {"effects": LIBRARY} | words
    with pytest.raises(DeclarationError, match=says):
        found(records(2), asked.pop("effects"), **asked)


def test_one_recording_is_enough_for_a_clear_effect():
    d = found([record(3, dry=30.0, seconds=30.0)], ["coulomb_friction", "null_bias", "drift"])
    assert d.verdict == "named" and [s.effect for s in d.steps] == ["coulomb_friction"]
    assert d.steps[0].parameters[0].value == pytest.approx(30.0, rel=0.02)


def test_a_recording_on_which_the_base_diverges_keeps_its_row():
    residual = np.full((5, 1), np.inf)
    flat = slide().flat
    data = SimpleNamespace(noise=np.array([NOISE]), train=(), report=("run",))
    sides = [SimpleNamespace(residuals_report=(r,)) for r in (residual, np.full((5, 1), NOISE))]
    (gap,) = View(flat, data, *sides).pooled("report")
    assert (gap.output, gap.rmse_before, gap.rmse_after) == ("speed", np.inf, pytest.approx(NOISE))
