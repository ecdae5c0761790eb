"""Hidden effects that the code is not told: named, or abstained on, or nothing found where nothing is hidden.

Eight cases of the benchmark (`benchmarks/gap`), with recordings of 20 s and every sensor; each runs the whole workflow.
"""

from __future__ import annotations

import importlib.util

import pytest

from benchmarks.gap.cases import Case, make
from benchmarks.gap.run import Here
from benchmarks.gap.score import answer_of, row_of

SECONDS = 20.0
READY = importlib.util.find_spec("hydrotwin.discovery.discover") is not None
needs_discover = pytest.mark.skipif(not READY, reason="hydrotwin.discovery has no discover yet")

HIDDEN = [
    ("cehA", "coulomb_friction", 5.0),
    ("cehA", "internal_leakage", 30.0),
    ("cehA", "dead_time", 30.0),
    ("spool_valve", "valve_overlap", 30.0),
    ("spool_valve", "dead_time", 30.0),
    ("spool_valve", "internal_leakage", 5.0),
]


def judged(machine, kind, effects, severity):
    """The row of one case."""
    from hydrotwin.discovery.discover import discover

    made = make(Case(machine, kind, effects, severity, "all", "drive", 101, SECONDS))
    found = discover(made.model, made.fit, validate=made.held_out, executor=Here())
    return row_of(made, answer_of(found), method="discover")


@needs_discover
@pytest.mark.parametrize(("machine", "effect", "severity"), HIDDEN)
def test_a_hidden_effect_is_named_or_in_the_class_and_the_gap_closes(machine, effect, severity):
    row = judged(machine, "single", (effect,), severity)
    assert row["seen"]
    assert row["in_class"] == [True], row["named"]
    assert not row["confidently_wrong"], row["named"]
    assert row["gap_closed"] > 0.9


@needs_discover
def test_nothing_is_named_where_nothing_is_hidden():
    row = judged("cehA", "none", (), 0.0)
    assert row["verdict"] == "none"
    assert not row["false_alarm"], row["named"]


@needs_discover
def test_a_push_from_outside_gets_no_name():
    row = judged("spool_valve", "out_of_library", ("external_push",), 30.0)
    assert row["seen"]
    assert row["abstained"], row["named"]
    assert row["verdict"] == "unknown"
