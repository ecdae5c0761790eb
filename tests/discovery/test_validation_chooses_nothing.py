"""Recordings given to validate choose nothing: whatever they are, what is found is the same to the bit."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from hydrotwin.discovery.discover import discover
from hydrotwin.discovery.verdict import DOUBTED
from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.models.language import Model
from hydrotwin.records import Record
from hydrotwin.report.gap_data import gap_data
from tests.discovery.slides import NOISE, Inline, TwoSensors, drive_records, found, record, records

EFFECTS = ("coulomb_friction", "dead_time", "null_bias", "stribeck_friction")
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


@pytest.fixture(scope="module")
def alone():
    """What is learned without any recording to validate, by what was hidden."""
    return {name: found(records(3, **more), EFFECTS, noise={"speed": NOISE}) for name, more in LEARNED.items()}


@pytest.mark.parametrize("hidden", LEARNED)
@pytest.mark.parametrize("judging", VALIDATION)
def test_whatever_validates_what_is_learned_is_the_same_to_the_bit(alone, hidden, judging):
    more, first = LEARNED[hidden], alone[hidden]
    answer = found(records(3, **more), EFFECTS, validate=VALIDATION[judging](more), noise={"speed": NOISE})
    assert answer.verdict in (first.verdict, "unknown")
    if answer.verdict == first.verdict:
        assert learned(answer) == learned(first)
    else:
        assert not answer.steps and answer.findings != first.findings
        assert [p.value for p in answer.fit_before.parameters] == [p.value for p in first.fit_before.parameters]
    assert [s.probability for s in answer.steps] <= [s.probability for s in first.steps]


def test_a_start_that_only_validation_measures_does_not_reach_the_fit():
    """With it the equations of the fit would be compiled for one more free start."""
    runs = [late_to_begin(r) for r in records(3, dry=DRY)]
    first = found(runs, EFFECTS, noise={"speed": NOISE})
    answer = found(runs, EFFECTS, validate=records(1, first=7, dry=DRY), noise={"speed": NOISE})
    assert [s.effect for s in answer.steps] == ["coulomb_friction"]
    assert learned(answer) == learned(first)


def test_an_effect_that_validation_speaks_against_stays_less_probable_and_with_a_warning(alone):
    judged = VALIDATION["one without the dead time"](LEARNED["two effects"])
    answer = found(records(3, dry=DRY, late=LATE), EFFECTS, validate=judged, noise={"speed": NOISE})
    before, after = ({s.effect: s.probability for s in a.steps} for a in (alone["two effects"], answer))
    assert after["dead_time"] < 0.1 * before["dead_time"]
    assert after["coulomb_friction"] > 0.9 * before["coulomb_friction"]
    (note,) = [f for f in answer.findings if DOUBTED in f]
    assert "dead_time at force is named by what was learned from" in note
    confirmed = found(records(3, dry=DRY, late=LATE), EFFECTS, validate=records(2, first=7, dry=DRY, late=LATE),
                      noise={"speed": NOISE})  # fmt: skip
    assert not [f for f in confirmed.findings if DOUBTED in f]


# -- around an FMU -----------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def two_sensors(tmp_path_factory):
    """The drive as it is, measured twice, as an FMU."""
    path = tmp_path_factory.mktemp("fmus") / "two_sensors.fmu"
    export_fmu(Model(TwoSensors(), step=2e-3).with_parameters({"gain": 10.0, "time_constant": 0.3}), path)
    return read_fmu(path)


def biased(count, first, bias=0.3, shift=0.8):
    return drive_records(count, first, command=lambda u: u + bias, other=lambda w, time: w + shift)


@pytest.mark.parametrize("judging", ["more of the same", "one without the bias", "another machine"])
def test_around_an_fmu_what_validates_chooses_as_little(two_sensors, judging):
    judged = {
        "more of the same": biased(1, 7),
        "one without the bias": biased(1, 7, shift=0.0),
        "another machine": [dataclasses.replace(r, signals={**r.signals, "rate": -r["rate"]}) for r in biased(1, 7)],
    }[judging]
    asked = {"effects": ["sensor_bias", "null_bias"], "executor": Inline()}
    first = discover(two_sensors, biased(3, 0), **asked)
    answer = discover(two_sensors, biased(3, 0), validate=judged, **asked)
    assert {(s.effect, s.site) for s in first.steps} == {("sensor_bias", "other"), ("null_bias", "command")}
    if answer.verdict == "unknown":
        assert not answer.steps and judging == "another machine"
        return
    assert learned(answer) == learned(first)
    assert bool([f for f in answer.findings if DOUBTED in f]) == (judging == "one without the bias")
