"""A hole in a recording is no effect that is missing, and hides none."""

from __future__ import annotations

import pytest

from tests.identification.test_holes import unknown, without

from .slides import found, record, records

ASKED = ["coulomb_friction", "null_bias"]
SORTS = {
    "rows": lambda r: without(r, (4, 5.5)),
    "one sample": lambda r: without(r, *[(t - 0.001, t + 0.001) for t in (1.78, 3.58, 5.38, 7.18, 8.98)]),
    "input": lambda r: unknown(r, 4, 5.5, "force"),
}


@pytest.mark.parametrize("sort", list(SORTS))
def test_nothing_is_missing_where_only_samples_are(sort):
    answer = found([SORTS[sort](r) for r in records(3)], ASKED, validate=[SORTS[sort](record(9))])
    assert answer.verdict == "none"
    assert sum("nobody knows" in f for f in answer.findings) == 4


@pytest.mark.parametrize("sort", ["input", *(pytest.param(s, marks=pytest.mark.proof) for s in ("rows", "one sample"))])
def test_what_is_hidden_is_named_beside_a_hole(sort):
    answer = found([SORTS[sort](r) for r in records(3, dry=60.0)], ASKED)
    assert answer.verdict == "named" and [s.effect for s in answer.steps] == ["coulomb_friction"]


def test_a_lone_recording_with_a_hole_is_cut_there_and_into_pieces():
    answer = found([without(record(0, dry=60.0, seconds=24.0), (7, 9))], ASKED)
    assert answer.verdict == "named" and [s.effect for s in answer.steps] == ["coulomb_friction"]
    assert [r.record for r in answer.recordings] == [f"run_0 (part {k})" for k in range(1, 13)]
