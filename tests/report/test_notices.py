"""Notices: what a reader of the page, of Markdown or of the JSON must not miss, not of the terminal alone."""

from __future__ import annotations

import dataclasses
import json
from xml.etree import ElementTree

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.comparison import Wanted, acceptance
from hydrotwin.comparison.comparison import Inaccurate
from hydrotwin.comparison.junit import junit
from hydrotwin.comparison.notices import notices
from hydrotwin.report import write_report


@pytest.fixture(scope="module")
def compared():
    record = ht.read_record("examples/cehA/recordings/validate_1.csv").window(0, 3)
    holed = record.array(["arm_angle"])[:, 0].copy()
    holed[50:80] = np.nan
    signals = {n: (holed if n == "arm_angle" else record[n]) for n in record}
    holes = ht.Record(record.time, signals, record.units, name="holes")
    return ht.compare([ht.load("cehA")], [record, holes], modes=["free run"])


def test_samples_that_an_output_lacks_are_told_by_recording(compared):
    (told,) = (n for n in notices(compared) if "no value" in n)
    assert told.startswith("holes: no value of arm_angle in 30 of 301 samples")


def test_runs_that_miss_their_accuracy_are_told_once_for_every_model(compared, tmp_path):
    sentence = "cehA: not accurate: half the step changes arm_angle by 1.2 of its range."
    wrong = dataclasses.replace(compared, inaccurate=tuple(Inaccurate("cehA", r, sentence) for r in ("one", "two")))
    told = [n for n in notices(wrong) if "not those of its equations" in n]
    assert len(told) == 1 and "on one: not accurate: half the step" in told[0] and told[0].endswith("1 more.")
    write_report(wrong, tmp_path)
    assert told[0] in (tmp_path / "report.md").read_text(encoding="utf-8")
    assert told[0] in json.loads((tmp_path / "compare.json").read_text(encoding="utf-8"))["notices"]


def test_a_recording_that_is_named_as_one_of_the_training_too_is_told(compared):
    judge = compared.records[0]
    copy = dataclasses.replace(judge, digest="0" * 64)  # the same in a file of other bytes
    other = copy.with_signals({n: -copy[n] for n in copy})
    for train, count in ((judge, 1), (copy, 1), (other, 0)):
        told = [n for n in notices(dataclasses.replace(compared, train_records=(train,))) if "Named as what" in n]
        assert len(told) == count and all("made from, too: validate_1" in n for n in told)


def test_a_model_that_was_made_from_what_judges_it_is_told_first(compared):
    own = [{"role": "train", "sha256": r.digest} for r in compared.records if r.digest]
    seen = dataclasses.replace(compared.entrants[0], provenance={"recordings": own})
    told = notices(dataclasses.replace(compared, entrants=(seen,)))
    assert own and told[0].startswith("cehA was made from") and "say nothing of other recordings" in told[0]


def test_servers_are_told_what_a_reader_must_not_miss(compared):
    found = junit(acceptance(compared, Wanted(("arm_angle.rmse < 90 deg",))), "here", notices(compared))
    (suite,) = ElementTree.fromstring(found.partition("?>")[2]).iter("testsuite")
    assert "no value of arm_angle in 30 of 301" in suite.findtext("system-out")
