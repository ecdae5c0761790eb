"""Which band a model has: of its fit, its own, conformal from what was held out, or none; and which is not trusted."""

from __future__ import annotations

import dataclasses
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from hydrotwin.comparison import FREE_RUN, ONE_STEP, BlockContender, PhysicalContender, as_contender, compare
from hydrotwin.comparison.band import SEEN, Band, Held, bands_of, held_here
from hydrotwin.comparison.elsewhere import other_reasons
from hydrotwin.comparison.notices import notices
from hydrotwin.comparison.travel import Carried
from hydrotwin.identification import Spread, identify
from hydrotwin.learned import learn
from hydrotwin.learned.bands import WIDE
from hydrotwin.learned.hybrid.files import read_hybrid, write_hybrid
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.provenance import SPREAD
from hydrotwin.records import Record
from hydrotwin.report import write_report
from tests.comparison.toys import OUTPUTS, Toy, recording
from tests.identification.drive import drive, recorded
from tests.learned.toy_machine import ANGLE, COMMAND, toy_record, untrained_block, with_deviation


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
    assert (
        "The bands of bad cannot be trusted for arm_angle: 70 % of what was held out lay in it, and a right one" in text
    )
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


def test_a_band_that_held_too_much_says_what_a_right_one_holds():
    """Alone, '100 % of what was held out lay in it' reads as if that were good."""
    told = {"source": "own", "coverage": 0.999, "trustworthy": False}
    block = SimpleNamespace(outputs=(ANGLE, Signal("arm_angle.sd", "rad")), provenance={"band": {"arm_angle": told}})
    (band,) = bands_of(block)
    assert band.why == "99.9 % of what was held out lay in it, and a right one of 95 % holds 90 to 99 %"


def test_a_hybrid_has_the_band_of_what_was_held_out_and_says_where_its_physics_had_seen_it(tmp_path):
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
    write_hybrid(block, tmp_path / "h.toml", "drive.py:drive")
    assert bands_of(as_contender(read_hybrid(tmp_path / "h.toml", None), "hybrid")) == bands_of(contender)


def test_a_band_that_misses_what_is_measured_here_is_not_trusted():
    """Whatever it held before: doubted are those of the outputs that it missed, those it held stay."""
    before = (Band("arm", "own", True), Band("rod", "own", None, "never judged"), Band("p", "own", False, "known"))
    told = {name: [Held("run", inside)] for name, inside in {"arm": 0.1, "rod": 0.9, "p": 0.0}.items()}
    arm, rod, p = held_here(before, told)
    assert arm.trusted is False and "only 10 % of what was measured here" in arm.why
    assert p.trusted is False and p.why == "known; only 0 % of what was measured here lies in it"
    assert rod == before[1] and held_here(before, {}) == before


def test_a_band_of_a_fit_is_doubted_where_chance_does_not_explain_what_lies_outside():
    """Of several recordings the chance is that of each times their number; above 90 % nothing is doubted."""
    before = (Band("arm", "sensitivities", True),)
    told = {(0.8, 1e-5): False, (0.8, 6e-5): True, (0.8, 1e-2): True, (0.5, 1e-2): True, (0.95, 1e-9): True}
    for (inside, chance), trusted in told.items():
        (band,) = held_here(before, {"arm": [Held("cold", inside, chance), Held("warm", 0.95, 0.5)]})
        assert band.trusted is trusted, (inside, chance)
    (band,) = held_here(before, {"arm": [Held("cold", 0.82, 1e-80), Held("warm", 0.95, 0.5)]})
    assert "only 82 % of cold lies in it, fewer than chance explains" in band.why


def test_a_band_is_doubted_where_it_was_missed_and_not_on_other_recordings():
    """A criterion on one load could not be tested, for the sake of a recording of another one."""
    before = (Band("arm", "sensitivities", True),)
    (band,) = held_here(before, {"arm": [Held("load_1", 0.95, 0.5), Held("load_2", 0.03, 1e-80)]})
    assert band.trusted is False and band.on(["load_2"]).trusted is False
    assert band.on(["load_1"]).trusted is True and not band.on(["load_1"]).why
    (known,) = held_here((Band("arm", "sensitivities", False, "known"),), {"arm": [Held("load_1", 0.95, 0.5)]})
    assert known.on(["load_1"]).trusted is False, "what its fit left is left everywhere"


@pytest.fixture(scope="module")
def identified():
    """A drive identified on one recording, with what the fit knows of its errors."""
    noise = {"position": 2e-3, "motor_speed": 0.05}
    fit = identify(drive(), [recorded(drive(), 1, noise=noise)], free=["motor.gain", "pump.displacement"])
    return fit, noise, PhysicalContender(fit.flat, "fitted", provenance={SPREAD: Spread.of(fit).told()})


def test_a_fit_takes_part_as_its_model_does(identified):
    """It has hashes of its own where a model says what it was made of: band and training were lost behind them."""
    fit, noise, _ = identified
    itself, model = as_contender(fit), as_contender(fit.flat)
    assert itself.provenance == model.provenance and SPREAD in itself.provenance
    found = compare([fit], [recorded(drive(), 2, noise=noise)], modes=[FREE_RUN], repeats=0)
    assert np.isfinite([s.coverage for s in found.scores]).all()


def test_a_first_sample_that_is_off_leaves_a_right_band_and_a_machine_that_is_another_does_not(identified):
    fit, noise, contender = identified
    record = recorded(drive(), 2, noise=noise)
    position = record["position"].copy()
    position[0] = 2.8 * noise["position"]  # once in 200 recordings: the piston starts at 0
    unlucky = record.with_signals({"position": position})
    gain = fit.values["motor.gain"] + 12.0 * fit.sigma["motor.gain"]
    other = recorded(drive(), 2, noise=noise, parameters={"motor.gain": gain})
    for one, trusted in ((unlucky, True), (other, False)):
        found = compare([contender], [one], modes=[FREE_RUN], repeats=0)
        (score,) = (s for s in found.scores if s.output == "position")
        (band,) = (b for b in found.entrants[0].bands if b.output == "position")
        assert score.coverage < 0.9 and (score.chance > 1e-3) is trusted and band.trusted is trusted


def test_a_right_model_far_off_is_told_what_else_may_be_the_reason(identified):
    """A start that no sample tells, where the recording begins or behind a hole, beside a gap in the model."""
    _, noise, contender = identified
    whole = recorded(drive(), 3, noise=noise, start=(40.0, 0.0), outputs=("position",))
    driven = recorded(drive(), 3, noise=noise)
    keep = (driven.time < 3.0) | (driven.time > 5.0)
    holed = Record(driven.time[keep], {n: v[keep] for n, v in driven.signals.items()}, driven.units, "holed")
    said = {}
    for record in (whole, holed):
        found = compare([contender], [record], modes=[FREE_RUN], repeats=0)
        said[record.name] = next(b.why for b in found.entrants[0].bands if b.output == "position")
    started, behind = said.values()
    assert started.endswith(
        ", or it starts elsewhere, for no sample there tells motor.speed (initial_states auto estimates it)"
    )
    assert behind == ""
    wrong = as_contender(drive().with_parameters({"motor.gain": 11.0}), "wrong")
    reasons = other_reasons(wrong, holed, (), [wrong])
    assert reasons == ", or it starts elsewhere behind a hole (2.98 s to 5.02 s)"
    other = Toy("other")
    other.inputs = (Signal("wind", "N"),)  # of which a hole cuts the runs of all
    lacks = driven.with_signals({"wind": np.where((driven.time > 3) & (driven.time < 5), np.nan, 1.0)}, {"wind": "N"})
    assert "behind a hole" in other_reasons(wrong, lacks, (), [wrong, other])
    assert "behind a hole" not in other_reasons(wrong, lacks, (), [wrong])


def test_a_comparison_holds_its_bands_against_what_it_measured(arx):
    sure = judged(arx, coverage=0.95, trustworthy=True, half_width=1e-9)
    found = compare([as_contender(sure, "sure")], [toy_record(3)], modes=[FREE_RUN], repeats=0)
    (band,) = found.entrants[0].bands
    assert band.trusted is False and "measured here" in band.why
    assert any("bands of sure cannot be trusted" in n for n in notices(found))


class Claims(Toy):
    """A toy with a deviation (n,) of its angle, rad."""

    def __init__(self, told):
        super().__init__("claims")
        self.told = told

    def deviations(self, record):
        return {"arm_angle": self.told}


def coverage(told) -> float:
    found = compare([Claims(told)], [recording(1)], modes=[FREE_RUN], repeats=0, outputs=["arm_angle"])
    return found.scores[0].coverage


def test_what_is_claimed_to_be_known_exactly_is_missed_and_what_is_not_told_is_no_band():
    """Such samples were left out: a band of nothing in nine of ten covered all."""
    n = len(recording(1))
    wide, nothing = np.full(n, 1.0), np.zeros(n)
    assert coverage(wide) == 1.0 and coverage(np.where(np.arange(n) % 10, 0.0, wide)) == pytest.approx(0.1, abs=0.01)
    assert np.isnan(coverage(nothing)) and np.isnan(coverage(np.where(np.arange(n) == n // 2, np.nan, wide)))


def test_deviations_of_one_step_are_those_of_a_step_of_the_recording(arx):
    """Of a recording twice as slow the second step was told as if it were the first: 82 % lay in the band of a Gaussian
    process that held 95."""
    block, record = with_deviation(arx), toy_record(3)
    assert block.period in (0.02, 0.04)
    slow = dataclasses.replace(record, time=record.time[::3], signals={n: v[::3] for n, v in record.signals.items()})
    own = record.resample(block.period)
    found = compare([as_contender(block)], [own, dataclasses.replace(slow, name="slow")], repeats=0)
    known = {(s.record == "slow", s.mode): np.isfinite(s.coverage) for s in found.scores if s.output == "arm_angle"}
    assert known == {(False, FREE_RUN): True, (True, FREE_RUN): True, (False, ONE_STEP): True, (True, ONE_STEP): False}
