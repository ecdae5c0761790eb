"""Where a model leaves what it was trained on: counted per recording and told in a sentence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.comparison import DomainShare, Trajectory, compare, domain_shares
from hydrotwin.comparison.notices import notices
from hydrotwin.simulation.block import TrainingDomain
from tests.comparison.toys import Toy, recording


def run(contenders, records, **options):
    return compare(contenders, records, repeats=1, **options)


def test_training_domain_shares_count_samples_outside():
    record = recording(1)
    half = TrainingDomain(("command",), (0.0,), (100.0,))
    comparison = run([Toy("boxed", domain=half)], [record], train_records=[record])
    own, shared = comparison.domains
    assert (own.model, own.source, own.beyond) == ("boxed", "model", ("command",))
    assert own.inside_percent == pytest.approx(100 * np.mean(record["command"] >= 0.0))
    assert (shared.model, shared.inside_percent, shared.beyond) == ("", 100.0, ())


def test_a_model_extrapolates_where_two_slow_sensors_never_meet_in_a_row():
    """Rows in which all were known were counted, and of two rasters there is none: nothing was told."""
    record, rows = recording(1), np.arange(len(recording(1)))
    seen = {n: np.where(rows % 4 == k, record[n], np.nan) for k, n in enumerate(("arm_angle", "motor_speed"))}
    box = TrainingDomain(("arm_angle", "motor_speed"), (-10.0, 0.0), (10.0, 1e4))
    [own] = run([Toy("boxed", domain=box)], [record.with_signals(seen)]).domains
    assert own.beyond == ("motor_speed",) and own.inside_percent < 90


def test_an_fmu_of_a_learned_block_extrapolates_where_its_run_says_so():
    """It has no box, and an output that tells the distance from it."""
    record, toy = recording(1), Toy("block.fmu")
    distance = np.where(np.arange(len(record)) < len(record) / 4, 0.5, 0.0)
    told = toy.free_run(record).with_signals({"training_distance": distance}, {"training_distance": "1"})
    [share] = domain_shares([toy], [record], (), [Trajectory("block.fmu", record.name, "free run", told)])
    outside = 100 * np.mean(distance > 0)
    assert share.inside_percent == pytest.approx(100 - outside)
    assert share.farthest == 0.5 and share.source == "model"
    assert share.extrapolates == (
        f"block.fmu extrapolates in {outside:.2g} % of {record.name}: it leaves what it was trained on, by up to 0.5 "
        "of its range."
    )
    untold = Trajectory("block.fmu", record.name, "free run", record)
    assert not domain_shares([toy], [record], (), [untold])
    assert "in 100 % of" in dataclasses.replace(share, inside_percent=0.0).extrapolates


def test_where_a_model_extrapolates_is_said_in_a_sentence():
    far = DomainShare("network", "run", 76.0, 1.2, ("command", "arm_angle"), "model")
    assert far.extrapolates == (
        "network extrapolates in 24 % of run: command and arm_angle leave what it was trained on, by up to 1.2 of its "
        "range."
    )
    one = DomainShare("network", "run", 98.0, 0.1, ("command",), "model")
    assert "command leaves what it" in one.extrapolates
    inside, others = (
        DomainShare("network", "run", 99.5, 0.1, ("command",), "model"),
        DomainShare("", "run", 50.0, 1.0, ("command",), "recordings"),
    )
    assert inside.extrapolates == others.extrapolates == ""


def test_models_that_leave_their_training_are_told_once_each():
    found = compare([Toy("a")], [recording(k) for k in (1, 2)])
    rows = [DomainShare("net", f"run_{k}", 100.0 - 10 * k, 0.1 * k, ("command",), "model") for k in range(1, 6)]
    told = [n for n in notices(dataclasses.replace(found, domains=tuple(rows))) if "extrapolates" in n]
    assert told == [f"{rows[-1].extrapolates} It does so on run_4, run_3, run_2 and 1 more, too."]
