"""Recordings given to validate choose nothing: whatever they are, what is found is the same to the bit."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from functools import cache

import numpy as np
import pytest

from hydrotwin.discovery.discover import discover
from hydrotwin.discovery.fits import job, whole
from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.models.language import Model
from hydrotwin.records import Record
from hydrotwin.report.gap_data import gap_data
from hydrotwin.work.memory import Memory
from tests.discovery.slides import (
    NOISE,
    START,
    Inline,
    TwoSensors,
    drive_records,
    fitted,
    found,
    question,
    record,
    records,
    slide,
)

DOUBTED = "the recordings that judge are explained better without it"
EFFECTS = ("coulomb_friction", "dead_time", "stribeck_friction")
DRY, LATE = 50.0, 1  # N, samples
JUDGED = ("probability", "role", "validate", "findings", "recordings", "provenance", "seconds", "verdict", "answer")


def learned(answer) -> str:
    """All of gap.json that recordings to validate must not change."""

    def kept(value):
        if isinstance(value, dict):
            return {k: kept(v) for k, v in value.items() if k not in JUDGED}
        return [kept(v) for v in value] if isinstance(value, list) else value

    rows = [r for r in gap_data(answer)["recordings"] if r["role"] != "report"]
    fits = [[(p.name, p.value, p.sigma) for p in fit.parameters] for fit in (answer.fit_before, answer.fit_after)]
    return json.dumps([kept(gap_data(answer)), rows, fits], allow_nan=True)


def turned(run: Record) -> Record:
    """A sensor mounted the wrong way round."""
    return run.with_signals({"speed": -run["speed"]})


def late_to_begin(run: Record) -> Record:
    """A sensor that wakes up after half a second: no start is measured."""
    return run.with_signals({"speed": np.where(run.time < 0.5, np.nan, run["speed"])})


LEARNED = {
    "two effects": {"dry": DRY, "late": LATE},
    "a pulse that no effect explains": {"pulse": 150.0, "dry": DRY},
    "nothing missing": {},
}
VALIDATION = {
    "more of the same": lambda more: records(2, first=7, **more),
    "one without the dead time": lambda more: records(2, first=7, dry=DRY),
    "one far outside": lambda more: [record(8, highest=2e3, **more)],
    "another machine": lambda more: [record(8, dry=200.0, late=6)],
    "a sensor the wrong way round": lambda more: [turned(record(8, **more))],
    "noise": lambda more: [record(8).with_signals({"speed": np.random.default_rng(3).standard_normal(600)})],
}


CASES = [("two effects", judging) for judging in VALIDATION]
CASES += [("nothing missing", "one far outside")]
CASES += [pytest.param("a pulse that no effect explains", "another machine", marks=pytest.mark.proof)]


class Kept(Memory):
    """A memory of what is data: final fits carry equations and are made anew."""

    def put(self, key, answer):
        with contextlib.suppress(TypeError):
            super().put(key, answer)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """What is learned without any recording to validate, and every fit of the search, by what was hidden."""

    @cache
    def learned_from(hidden):
        memory = Kept(tmp_path_factory.mktemp("fits"))
        return searched(records(3, **LEARNED[hidden]), memory), memory

    return learned_from


def searched(runs, memory=None, validate=()):
    return found(runs, EFFECTS, validate=validate, memory=memory, noise={"speed": NOISE})


@pytest.mark.parametrize(("hidden", "judging"), CASES)
def test_whatever_validates_what_is_learned_is_the_same_to_the_bit(alone, hidden, judging):
    """No fit of the search is another one, and neither is what follows from them."""
    more, (first, memory) = LEARNED[hidden], alone(hidden)
    fits = len(memory)
    answer = searched(records(3, **more), memory, VALIDATION[judging](more))
    assert len(memory) == fits > 0
    assert answer.verdict in (first.verdict, "unknown")
    if answer.verdict == first.verdict:
        assert learned(answer) == learned(first)
    else:
        assert not answer.steps and answer.findings != first.findings
        assert [p.value for p in answer.fit_before.parameters] == [p.value for p in first.fit_before.parameters]
    assert [s.probability for s in answer.steps] <= [s.probability for s in first.steps]


def test_a_start_that_only_validation_measures_does_not_reach_the_equations_of_the_fit(monkeypatch):
    """They would be compiled for one more free start, and need not round alike."""
    prepared, asked = [], question([late_to_begin(r) for r in records(3)])
    asked = dataclasses.replace(asked, select=question(records(1, first=7), noise={"speed": NOISE}).fit[:1])
    compiled = job.prepare
    for module in (job, whole):
        monkeypatch.setattr(module, "prepare", lambda *a, **w: prepared.append(w["free_states"]) or compiled(*a, **w))
    known = fitted(asked)
    prepared.clear()
    last = job.Job(slide().flat, tuple(START), asked, (known.values,), known.states, known.rmse)
    concluded = whole.conclude(last)
    assert prepared == [[], ["mass.speed"]]
    assert len(concluded.residuals_report) == 1 and np.isfinite(concluded.residuals_report[0]).all()


def test_an_effect_that_validation_speaks_against_stays_less_probable_and_with_a_warning(alone):
    first, memory = alone("two effects")
    for late in (0, LATE):
        judged = records(2, first=7, dry=DRY, late=late)
        answer = searched(records(3, **LEARNED["two effects"]), memory, judged)
        before, after = ({s.effect: s.probability for s in a.steps} for a in (first, answer))
        assert set(after) == {"coulomb_friction", "dead_time"}
        assert after["coulomb_friction"] > 0.9 * before["coulomb_friction"]
        notes = [f for f in answer.findings if DOUBTED in f]
        assert [n.partition(" is named")[0] for n in notes] == ["gap: dead_time at force"] * (not late)
        assert (after["dead_time"] < 0.5 * before["dead_time"]) == (not late)


# -- around an FMU -----------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def around(tmp_path_factory):
    """An FMU of the drive, measured twice, what stands around it, and every fit of the search."""
    folder = tmp_path_factory.mktemp("fmus")
    export_fmu(Model(TwoSensors(), step=2e-3).with_parameters({"gain": 10.0, "time_constant": 0.3}), folder / "two.fmu")
    fmu, memory = read_fmu(folder / "two.fmu"), Kept(folder / "fits")
    return fmu, drives_around(fmu, memory), memory


def drives(count, first, late=3, scale=1.1):
    def later(u):
        return np.concatenate([np.full(late, u[0]), u[: len(u) - late]])

    return drive_records(count, first, command=later, other=lambda w, time: scale * w)


def drives_around(fmu, memory, validate=()):
    asked = {"effects": ["dead_time", "sensor_scale"], "executor": Inline(), "memory": memory}
    return discover(fmu, drives(3, 0), validate=validate, **asked)


@pytest.mark.parametrize(
    ("judging", "doubts"),
    [
        (drives(1, 7), []),
        (drives(1, 7, scale=1.03), ["sensor_scale at other"]),
        (drives(1, 7, late=9, scale=0.5), None),
    ],
)
def test_around_an_fmu_what_validates_chooses_as_little(around, judging, doubts):
    fmu, first, memory = around
    fits = len(memory)
    answer = drives_around(fmu, memory, judging)
    assert len(memory) == fits > 3
    assert {(s.effect, s.site) for s in first.steps} == {("dead_time", "command"), ("sensor_scale", "other")}
    if doubts is None:
        assert (answer.verdict, answer.steps) == ("unknown", ())
        return
    assert learned(answer) == learned(first)
    assert [f.partition(" is named")[0] for f in answer.findings if DOUBTED in f] == [f"gap: {d}" for d in doubts]
