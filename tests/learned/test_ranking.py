"""Every kind on the same recordings, ranked by its free run on what was held out."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned import learn, ranking
from hydrotwin.learned.ranking import Tried, learn_best
from hydrotwin.models.language.errors import DataError, DeclarationError
from tests.learned.toy_machine import toy_record

INPUTS, OUTPUTS = ["command"], ["arm_angle"]


@pytest.fixture(scope="module")
def records():
    return [toy_record(1, 10.0), toy_record(2, 10.0)]


@pytest.fixture(scope="module")
def best(records):
    told = []
    block = learn_best(
        records, INPUTS, OUTPUTS, kinds=("piecewise", "grey_box"), progress=lambda *words: told.append(words)
    )
    return block, told


def test_the_best_is_what_its_kind_alone_would_have_learnt(best, records):
    block, _ = best
    rows = block.provenance["ranking"]
    assert {row["kind"] for row in rows} == {"piecewise", "grey_box"}
    shares = [row["percent_of_range"]["arm_angle"] for row in rows]
    assert shares == sorted(shares) and shares[0] < shares[1]
    alone = learn(rows[0]["kind"], records, INPUTS, OUTPUTS)
    assert all(np.array_equal(block.arrays[name], alone.arrays[name]) for name in alone.arrays)
    assert block.provenance["free_run"]["outputs"]["arm_angle"]["percent_of_range"] == pytest.approx(shares[0])
    assert all(row["seconds"] > 0 for row in rows)


def test_progress_tells_what_ended_and_what_is_best(best):
    _, told = best
    assert [words[:2] for words in told] == [(1, 2), (2, 2)]
    assert "best so far" in told[-1][2]


def test_a_kind_that_fails_costs_only_itself(records):
    block = learn_best(records, ["command", "motor_speed"], OUTPUTS, kinds=("piecewise", "gp"))
    last = block.provenance["ranking"][-1]
    assert block.provenance["ranking"][0]["kind"] == "gp" and last["kind"] == "piecewise"
    assert "piecewise" in last["failed"] and "percent_of_range" not in last


def test_nothing_that_can_be_learnt_is_said_with_every_reason(records):
    short = [records[0].window(0.0, 0.1)]
    with pytest.raises(DataError, match=r"no kind could be trained. .*piecewise: .*too few"):
        learn_best(short, INPUTS, OUTPUTS, kinds=("piecewise",))


def test_a_process_that_broke_is_told(tmp_path):
    assert "without an answer" in ranking._answer("nn", tmp_path).failed
    assert Tried("nn").share == float("inf")


def test_kinds_that_cannot_be_tried_are_refused(records):
    for kind in ("hybrid", "nm"):
        with pytest.raises(DeclarationError, match="to try"):
            learn_best(records, INPUTS, OUTPUTS, kinds=(kind,))
