"""The plain baseline on one short case, its memory, its limit; and the tables of stated probabilities."""

from __future__ import annotations

import dataclasses
import time

import pytest

from benchmarks.gap import calibration, plain
from benchmarks.gap.cases import Case, make
from benchmarks.gap.score import row_of

TWO = ("valve_overlap", "null_bias")


@pytest.fixture(scope="module")
def case():
    return make(Case("spool_valve", "single", ("valve_overlap",), 30.0, "position", "drive", 101, 8.0))


@pytest.fixture(scope="module")
def memory(tmp_path_factory):
    return tmp_path_factory.mktemp("fits")


@pytest.fixture(scope="module")
def answered(case, memory):
    return plain.plain(case, memory, TWO)


@pytest.mark.proof
def test_the_plain_baseline_names_the_better_of_two(case, answered):
    row = row_of(case, answered, method="plain")
    assert row["exact"] == [True] and row["gap_closed"] > 0.9 and row["parameters"][0]["error"] < 0.2
    (overlap,) = (score for label, score in answered.notes["bic"].items() if label.startswith("valve_overlap"))
    assert all(score > overlap for label, score in answered.notes["bic"].items() if "overlap" not in label)
    assert plain.BASE in answered.notes["bic"]


@pytest.mark.proof
def test_fits_that_are_known_are_not_made_again(case, memory, answered, monkeypatch):
    monkeypatch.setattr(plain._Work, "fitted", lambda *asked: pytest.fail("a fit was made again"))
    again = plain.plain(case, memory, TWO)
    assert again.named == answered.named and again.notes["bic"] == answered.notes["bic"]


@pytest.mark.proof
def test_what_takes_too_long_is_not_reached_and_the_rest_is(case, tmp_path, monkeypatch):
    monkeypatch.setattr(plain, "BEGIN", 0.0)
    task = plain.Task(case.spec, {}, case.fit, case.held_out, TWO, limit=0.05)
    began = time.perf_counter()
    found = {f.label: f for f in plain.fitted(task, tmp_path)}
    assert not found[plain.BASE].failed  # the base has a limit of its own
    assert {f.failed for label, f in found.items() if label != plain.BASE} == {plain.NOT_REACHED}
    assert time.perf_counter() - began < plain.BASE_LIMIT


def test_without_a_base_there_is_no_answer():
    with pytest.raises(RuntimeError, match="the base model has no fit"):
        plain.answer_of([plain.PlainFit(plain.BASE, failed="it diverges")])


def test_other_recordings_are_another_task(case):
    task = plain.Task(case.spec, {}, case.fit, case.held_out)
    other = dataclasses.replace(task, fit=case.fit[:2])
    assert plain.fingerprint(task) != plain.fingerprint(other) != plain.fingerprint(dataclasses.replace(task))


def rows(*stated, **more):
    usual = {"verdict": "named", "excitation": "drive", "machine": "cehA", "seconds": 50.0}
    return [{**usual, "stated": [pair], **more} for pair in stated]


def test_reliability_sets_what_is_stated_against_what_is_right():
    said = calibration.statements(rows((0.9, True), (0.9, True), (0.9, False), (0.3, False), (1.0, True)))
    bins = {b.low: b for b in calibration.reliability(said)}
    assert (bins[0.8].names, bins[0.8].stated, bins[0.8].right) == (4, pytest.approx(0.925), 0.75)
    assert (bins[0.2].names, bins[0.2].right, bins[0.0].names) == (1, 0.0, 0)


def test_tables_of_probabilities_and_seconds_go_by_style_and_machine():
    text = "\n".join(
        calibration.markdown([*rows((0.9, True)), *rows((0.7, False), machine="winch", seconds=400.0)], "x")
    )
    assert "| winch | - | - | - | 0.70: 0.00 (1) | - | 0.490 | 1 |" in text
    assert "| cehA | 50 | 50 | 50 | 0 | 1 | 0 | 0 | 0 |" in text
