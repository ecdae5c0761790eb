"""Which band a model has: of its fit, its own, conformal from what was held out, or none; and which is not trusted."""

from __future__ import annotations

import dataclasses
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from hydrotwin.comparison import FREE_RUN, BlockContender, as_contender, compare
from hydrotwin.comparison.band import SEEN, Band, bands_of, held_here
from hydrotwin.comparison.notices import notices
from hydrotwin.comparison.travel import Carried
from hydrotwin.learned import learn
from hydrotwin.learned.bands import WIDE
from hydrotwin.models.language.flat import Signal
from hydrotwin.report import write_report
from tests.comparison.toys import OUTPUTS, Toy, recording
from tests.learned.toy_machine import ANGLE, COMMAND, toy_record, untrained_block


@pytest.fixture(scope="module")
def arx():
    return learn("arx", [toy_record(1), toy_record(2)], [COMMAND], [ANGLE])


def judged(block, **told):
    """The block with another band on its card."""
    card = dict(block.provenance["free_run"])
    row = dict(card["outputs"]["arm_angle"])
    card["outputs"] = {"arm_angle": row | {"band": row["band"] | told}}
    return dataclasses.replace(block, provenance={**block.provenance, "free_run": card})


def test_a_learned_block_has_the_band_of_what_was_held_out_in_free_run_only(arx):
    told = arx.provenance["free_run"]["outputs"]["arm_angle"]["band"]
    assert told["source"] == "conformal" and told["half_width"] > 0
    found = compare([as_contender(arx, "arx")], [toy_record(3), toy_record(4)], repeats=0)
    drawn = found.deviation("arx", "toy_3", "arm_angle")
    assert drawn == pytest.approx(np.full(len(toy_record(3)), told["half_width"] / WIDE))
    free = [s for s in found.scores if s.mode == FREE_RUN]
    measured = [
        np.mean(np.abs(found.trajectory("arx", s.record, FREE_RUN)["arm_angle"] - r["arm_angle"]) <= told["half_width"])
        for s, r in zip(free, found.records, strict=True)
    ]
    assert [s.coverage for s in free] == pytest.approx(measured)
    assert np.isnan([s.coverage for s in found.scores if s.mode != FREE_RUN]).all()
    (band,) = found.entrants[0].bands
    assert (band.output, band.source, band.half_width) == ("arm_angle", "conformal", told["half_width"])


def test_a_block_of_which_nothing_was_held_out_has_none(arx):
    known = {k: v for k, v in arx.provenance.items() if k != "free_run"}
    for block in (untrained_block(), dataclasses.replace(arx, provenance=known)):
        assert bands_of(as_contender(block)) == () and as_contender(block).deviations(toy_record(3)) == {}
    for wrong in ({"half_width": "wide"}, {"half_width": float("nan")}, {"coverage": None}, {"source": "other"}):
        assert bands_of(as_contender(judged(arx, **wrong))) == (), wrong


def test_the_width_travels_and_another_width_is_another_run(arx):
    own, wider = as_contender(arx), as_contender(judged(arx, half_width=1.0))
    arrived = pickle.loads(pickle.dumps(own.to_travel()))
    assert arrived.half_widths == own.half_widths != wider.half_widths
    assert Carried(own).content == Carried(own.to_travel()).content != Carried(wider).content
    assert BlockContender(arx, half_widths={}).deviations(toy_record(3)) == {}


def test_a_band_that_did_not_hold_what_was_held_out_is_told_on_the_page_and_in_the_data(arx, tmp_path):
    bad = judged(arx, coverage=0.7, trustworthy=False)
    found = compare([as_contender(bad, "bad"), Toy("toy", outputs=OUTPUTS[:1])], [recording(1)], modes=[FREE_RUN])
    files = write_report(found, tmp_path)
    text = files["markdown"].read_text(encoding="utf-8")
    assert "The bands of bad cannot be trusted for arm_angle: 70 % of what was held out lay in it." in text
    assert "| conformal | no |" in text and "| none |" in text
    fine = compare([as_contender(judged(arx, coverage=0.95, trustworthy=True), "fine")], [toy_record(3)])
    assert fine.entrants[0].bands[0].trusted and "cannot be trusted" not in write_report(fine, tmp_path / "fine")[
        "markdown"
    ].read_text(encoding="utf-8")


def test_own_deviations_are_told_and_doubted_where_they_had_to_be_stretched():
    block = SimpleNamespace(outputs=(ANGLE, Signal("arm_angle.sd", "rad")), provenance={})
    (unjudged,) = bands_of(block)
    assert (unjudged.output, unjudged.source, unjudged.trusted) == ("arm_angle", "own", None)
    row = {"source": "own", "coverage": {"free_run": 0.4}, "trustworthy": False, "says": "It errs by other means."}
    held = {"source": "own", "coverage": 0.95, "trustworthy": True}
    block.provenance = {"band": {"arm_angle": row}, "free_run": {"outputs": {"arm_angle": {"band": held}}}}
    (band,) = bands_of(block)
    assert (band.source, band.trusted, band.why) == ("own", False, "It errs by other means.")
    block.provenance = {"band": {"arm_angle": row | {"trustworthy": True}}, "free_run": block.provenance["free_run"]}
    assert bands_of(block)[0].trusted and bands_of(block)[0].why == "95 % of what was held out lay in it"


def test_a_hybrid_has_the_band_of_what_was_held_out_and_says_where_its_physics_had_seen_it():
    from tests.identification.drive import drive, recorded

    records = [recorded(drive(), k, noise={"position": 2e-3}) for k in (1, 2)]
    seen = [{"name": r.name, "sha256": r.digest, "role": "train"} for r in records]
    wrong = SimpleNamespace(flat=drive().with_parameters({"motor.gain": 8.0}), provenance={"recordings": seen})
    block = learn("hybrid", records, outputs=["position"], model=wrong, hidden=0, starts=1)
    contender = as_contender(block, "hybrid")
    (band,) = [b for b in bands_of(contender) if b.output == "position"]
    assert band.source == "conformal" and band.why.endswith(SEEN)
    assert contender.to_travel().half_widths == {"position": band.half_width}
    assert not [b for b in bands_of(contender) if b.output != "position"], "what is not corrected was not judged"


def test_a_band_that_misses_what_is_measured_here_is_not_trusted():
    """Whatever it held before: doubted are those of the outputs that it missed, those it held stay."""
    before = (Band("arm", "own", True), Band("rod", "own", None, "never judged"), Band("p", "own", False, "known"))
    arm, rod, p = held_here(before, {"arm": 0.1, "rod": 0.9, "p": 0.0})
    assert arm.trusted is False and "only 10 % of what was measured here" in arm.why
    assert (rod, p) == before[1:] and held_here(before, {}) == before


def test_a_comparison_holds_its_bands_against_what_it_measured(arx):
    sure = judged(arx, coverage=0.95, trustworthy=True, half_width=1e-9)
    found = compare([as_contender(sure, "sure")], [toy_record(3)], modes=[FREE_RUN], repeats=0)
    (band,) = found.entrants[0].bands
    assert band.trusted is False and "measured here" in band.why
    assert any("bands of sure cannot be trusted" in n for n in notices(found))
