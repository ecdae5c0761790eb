"""What a criterion says itself of how it was judged: on a server, in a row and in a model file it stands alone."""

from __future__ import annotations

import dataclasses

import numpy as np

from hydrotwin.comparison import Wanted, acceptance, compare, junit
from hydrotwin.comparison.band import Band
from hydrotwin.comparison.comparison import DomainShare, Inaccurate
from hydrotwin.comparison.notices import notices
from hydrotwin.records import Record
from hydrotwin.records.sizes import made_by_few
from hydrotwin.report.acceptance import acceptance_data, verdict
from tests.comparison.toys import Toy, recording


def test_a_criterion_that_was_judged_one_step_ahead_says_so_itself():
    """A server and a model file had read the same PASS as that of a free run."""
    asked, said = Wanted(("arm_angle.rmse < 10 deg",)), "judged one step ahead, and not in a free run"
    (free,), (ahead,) = (
        acceptance(compare([Toy("good")], [recording(1)], repeats=0, modes=modes), asked).judged
        for modes in (("free run", "one step"), ("one step", "free run"))
    )
    assert (free.caution, ahead.caution) == ("", said)


def test_a_criterion_that_was_judged_on_what_was_named_as_training_says_so_itself():
    """Of an FMU nothing else tells it."""
    one, other = recording(1), recording(2)
    comparison = compare([Toy("good")], [one, other], repeats=0, modes=("free run",), train_records=[one])
    (judged,) = acceptance(comparison, Wanted(("arm_angle.rmse < 10 deg",))).judged
    assert judged.caution == f"judged on {one.name}, named as what the models were made from, too"


def test_recordings_in_which_nothing_rests_are_named_and_not_left_out_without_a_word():
    """Of ten recordings one with a move had met the criterion for all."""
    comparison = compare([Toy("good")], [recording(1), recording(2)], repeats=0, modes=("free run",))
    values = {"validation_1": 0.01, "validation_2": float("nan")}
    scores = tuple(
        dataclasses.replace(s, settling=values[s.record], steady=values[s.record]) for s in comparison.scores
    )
    known = dataclasses.replace(comparison, scores=scores)
    texts = ("arm_angle.settling < 1 s", "arm_angle.steady < 1 rad", "settling < 1 s", "arm_angle.rmse < 1 rad")
    found = acceptance(known, Wanted(texts))
    assert found.passed
    said = [
        f"not judged on validation_2, where {metric} is not defined" for metric in ("settling", "steady", "settling")
    ]
    assert [one.caution for one in found.judged] == [*said, ""]


def test_a_range_that_one_sample_makes_is_told_where_it_decides():
    """A reading of ten times the range had halved nrmse, and more: what missed 4 % met it, without a word."""
    record, asked = recording(1), Wanted(("motor_speed.nrmse < 4 %", "motor_speed.rmse < 1 rpm"))
    found = compare([Toy("slow", lag=0.2)], [record], repeats=0, modes=("free run",))
    assert not acceptance(found, asked).judged[0].passed and not any("range" in one for one in notices(found))
    wrong = record["motor_speed"].copy()
    wrong[300] = 5e3 * np.ptp(wrong)
    found = compare(
        [Toy("slow", lag=0.2)], [record.with_signals({"motor_speed": wrong})], repeats=0, modes=("free run",)
    )
    by_range, other = acceptance(found, asked).judged
    assert by_range.passed and by_range.caution == "motor_speed of validation_1: one sample makes its range"
    assert not other.caution
    assert any("one sample makes its range" in one and "at 3 s" in one for one in notices(found))


def test_noise_and_levels_are_no_range_of_a_few():
    random, time = np.random.default_rng(0), np.arange(2000) * 0.01
    columns = {"noise": random.standard_normal(2000), "level": np.where(time > 10, 1.0, 0.0), "few": time[:] % 1}
    columns["start"] = np.r_[1.4, 1.11, 1.0, 0.9, 0.8, 0.7, 0.5 * np.sin(time[6:])]  # it starts in motion
    assert not made_by_few([Record(time, columns, dict.fromkeys(columns, "m"), "r")], columns)
    for n in (50, 200, 500):
        noise = {"n": random.standard_normal(n)}
        assert not made_by_few([Record(time[:n], noise, {"n": "m"}, "r")], noise)


def test_one_step_ahead_of_a_slower_sensor_is_told_to_be_the_free_run():
    record = recording(1)
    slow = record.with_signals({"arm_angle": np.where(np.arange(len(record)) % 4 == 0, record["arm_angle"], np.nan)})
    for modes, said in ((("one step",), True), (("free run",), False)):
        found = notices(compare([Toy("good")], [slow, recording(2)], repeats=0, modes=modes))
        assert any(one.startswith("arm_angle of validation_1 has no value in the row before") for one in found) is said


def test_an_error_below_what_seems_noise_in_a_free_run_too_has_seen_no_sample():
    """Of a slow sensor its motion counts as noise: a right model was told to be too good to be true."""
    record = recording(1)
    own = compare([Toy("good")], [record], repeats=0)
    for free, said in ((0.1, False), (1.0, True)):
        noise = {"free run": free, "one step": 0.1}
        scores = [dataclasses.replace(s, noise=10.0, rmse=10.0 * noise[s.mode]) for s in own.scores]
        found = notices(dataclasses.replace(own, scores=tuple(scores)))
        assert any("too good to be true" in one for one in found) is said


def test_samples_that_an_output_lacks_are_told_where_it_is_judged(tmp_path):
    """Read with missing = "keep", a silent sensor was told as a note alone: PASS on the rest, without a word."""
    record = recording(1)
    silent = np.where((record.time > 2) & (record.time < 5), np.nan, record["arm_angle"])
    found = compare([Toy("good")], [record.with_signals({"arm_angle": silent})], repeats=0, modes=("free run",))
    texts = ("arm_angle.rmse < 9 deg", "motor_speed.rmse < 900 rpm", "fit > 1 %")
    accepted = acceptance(found, Wanted(texts))
    angle, speed, every = accepted.judged
    said = "not judged on 299 of 800 samples of validation_1, where arm_angle is not known or nothing was run"
    assert (angle.caution, speed.caution) == (said, "") and said in every.caution
    assert said in " ".join(verdict(accepted)) and said in junit(accepted, "here")
    assert any(said in row["caution"] for row in acceptance_data(accepted)["acceptance"]["criteria"])


def test_a_slower_sensor_lacks_no_samples():
    record = recording(1)
    slow = record.with_signals({"arm_angle": np.where(np.arange(len(record)) % 4 == 0, record["arm_angle"], np.nan)})
    found = compare([Toy("good")], [slow], repeats=0, modes=("free run",))
    assert not acceptance(found, Wanted(("arm_angle.rmse < 9 deg",))).judged[0].caution


def test_a_bound_that_the_metric_cannot_pass_is_none():
    """``theil in [0, 10] %`` named the best output as the worst, and its caution was lost."""
    record = recording(1)
    silent = record.with_signals({"pressure_cap": np.where(record.time > 4, np.nan, record["pressure_cap"])})
    found = compare([Toy("soft", stiffness=3.6e6)], [silent], repeats=0, modes=("free run",))
    texts = ("theil in [0, 10] %", "theil <= 10 %", "arm_angle.mae in [0, 1] rad", "arm_angle.fit in [90, 100] %")
    ranged, plain, error, share = acceptance(found, Wanted(texts)).judged
    assert ranged.criterion.output == plain.criterion.output == "pressure_cap"
    assert ranged.margin == plain.margin and ranged.caution == plain.caution != ""
    assert np.isclose(error.margin, 1 - error.value) and np.isclose(share.margin, share.value / 0.9 - 1)


def test_what_is_known_of_the_runs_stands_in_the_criterion_too():
    """Inaccurate runs, a training that is left, a sensor that sets nothing, a recording in two files: notices alone."""
    record = recording(1)
    slow = record.with_signals({"arm_angle": np.where(np.arange(len(record)) % 4 == 0, record["arm_angle"], np.nan)})
    again = dataclasses.replace(recording(1, name="again"), digest="2")
    asked = Wanted(("arm_angle.rmse < 9 deg", "motor_speed.max < 900 rpm"))
    ahead = compare([Toy("good")], [slow], repeats=0, modes=("one step", "free run"))
    assert "so that this is its free run" in acceptance(ahead, asked).judged[0].caution
    twice = compare([Toy("good")], [record, again], repeats=0, modes=("free run",))
    mean, largest = acceptance(twice, asked).judged
    assert "again is validation_1, and counts twice" in mean.caution and not largest.caution
    told = dataclasses.replace(
        compare([Toy("good")], [record], repeats=0, modes=("free run",)),
        inaccurate=(Inaccurate("good", record.name, "off"),),
        domains=(DomainShare("good", record.name, 70.0, 0.5, ("command",), "model"),),
    )
    (one, _) = acceptance(told, asked).judged
    assert "are not those of its equations" in one.caution and "good extrapolates on validation_1" in one.caution


def test_a_band_that_does_not_hold_is_no_measure_for_another():
    good, other = Toy("good"), Toy("other")
    comparison = compare([good, other], [recording(1)], repeats=0, modes=("free run",))
    bands = [Band("arm_angle", "own", trusted, "it is too narrow.") for trusted in (True, False)]
    entrants = tuple(dataclasses.replace(e, bands=(b,)) for e, b in zip(comparison.entrants, bands, strict=True))
    scores = tuple(dataclasses.replace(s, vv20=2.0) for s in comparison.scores)
    known = dataclasses.replace(comparison, entrants=entrants, scores=scores)
    (one,) = acceptance(known, Wanted(("arm_angle.vv20 not worse than other",))).judged
    assert not one.passed and one.undefined.startswith("other is no measure, its band cannot be trusted")


def test_a_band_that_nothing_was_held_against_is_told_where_it_counts():
    comparison = compare([Toy("good")], [recording(1)], repeats=0, modes=("free run",))
    bands = (Band("arm_angle", "own", None, "it was judged on nothing that was held out"),)
    scores = tuple(dataclasses.replace(s, vv20=0.5) for s in comparison.scores)
    entrants = (dataclasses.replace(comparison.entrants[0], bands=bands),)
    known = dataclasses.replace(comparison, entrants=entrants, scores=scores)
    band, other = acceptance(known, Wanted(("arm_angle.vv20 < 2", "arm_angle.rmse < 9 deg"))).judged
    assert band.passed and "it was judged on nothing that was held out" in band.caution and not other.caution
