"""Blocks are trained and judged on the parts of recordings between their holes, and say so."""

from __future__ import annotations

import dataclasses

import numpy as np

from hydrotwin.learned import learn
from hydrotwin.learned.inverse.data import characteristic
from hydrotwin.records import Record
from tests.learned.toy_machine import toy_record


def holed(seed: int, name: str) -> Record:
    """A recording of the toy that lacks what is between 8 and 9.5 s."""
    whole = toy_record(seed)
    keep = (whole.time < 8.0) | (whole.time > 9.5)
    return Record(whole.time[keep], {n: v[keep] for n, v in whole.signals.items()}, whole.units, name, digest=name)


def test_a_block_is_trained_and_judged_on_the_parts_and_says_so():
    signals = ["command"], ["motor_speed"]
    block = learn("arx", [holed(1, "first"), toy_record(2)], *signals, validate=[holed(3, "judge")])
    plain = learn("arx", [toy_record(1), toy_record(2)], *signals, validate=[toy_record(3)])
    assert "first has a hole (7.98 s to 9.52 s)" in block.provenance["free_run"]["says"]
    errors = [b.provenance["validation"]["motor_speed"] for b in (block, plain)]
    assert errors[0] < 1.2 * errors[1]
    assert [r["name"] for r in block.provenance["validated_on"]] == ["judge"]
    assert [r["name"] for r in block.provenance["trained_on"]] == ["first (part 1)", "first (part 2)", "toy_2"]


def test_a_sample_that_is_unknown_is_a_hole_too():
    whole = toy_record(1)
    lost = whole.with_signals({"motor_speed": np.where(whole.time == whole.time[500], np.nan, whole["motor_speed"])})
    block = learn("arx", [dataclasses.replace(lost, name="lost")], ["command"], ["motor_speed"])
    assert "lost has a hole" in block.provenance["free_run"]["says"]


def test_a_characteristic_is_measured_in_the_parts():
    found = characteristic([holed(1, "first")], "command", "motor_speed", moving=True)
    assert [r["name"] for r in found.source["trained_on"]] == ["first (part 1)", "first (part 2)"]
