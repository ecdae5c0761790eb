"""Where a recording has holes, and the parts between them; nobody knows what its inputs did there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import Record, cuts, unbroken
from hydrotwin.records.steps import few_lost, holes_at, missing_at


def even(count: int = 1000, period: float = 0.01) -> np.ndarray:
    return period * np.arange(count)


def recording(time=None, lost=(), **unknown) -> Record:
    """A recording of u and y without the samples ``lost`` and with the named signals unknown at some."""
    time = even() if time is None else time
    signals = {"u": np.sin(time), "y": np.cos(time)}
    for name, at in unknown.items():
        signals[name][at] = np.nan
    keep = np.setdiff1d(np.arange(len(time)), np.concatenate([np.r_[one] for one in lost]) if lost else [])
    return Record(time[keep], {n: v[keep] for n, v in signals.items()}, {"u": "V", "y": "m"}, "run", digest="d")


def spans(parts) -> list[tuple[float, float, int]]:
    return [(round(float(p.time[0]), 3), round(float(p.time[-1]), 3), len(p)) for p in parts]


# -- what the steps say ------------------------------------------------------------------------------------------------
def test_one_sample_that_is_missing_shows_on_an_even_clock_and_a_late_stamp_is_none():
    time = np.delete(even(), [300, 301, 302, 500])
    assert missing_at(time).tolist() == [299, 496] and holes_at(time).tolist() == [] and few_lost(time) == 4
    late = even()
    late[400] += 0.008
    assert missing_at(late).tolist() == []
    assert holes_at(np.delete(even(), slice(300, 306))).tolist() == [299]


def test_uneven_steps_lack_nothing_until_one_is_far_longer_than_the_usual_long_ones():
    random = np.random.default_rng(1)
    jittered = even() + 0.004 * random.uniform(-1, 1, 1000)
    assert not len(missing_at(jittered))
    lost = np.delete(jittered, slice(400, 430))
    assert missing_at(lost).tolist() == [399] == holes_at(lost).tolist()
    assert not len(missing_at(np.cumsum(random.exponential(0.01, 1000) + 1e-3)))
    two_rasters = np.union1d(np.arange(0, 6, 0.010).round(6), np.arange(0, 6, 0.015).round(6))
    assert not len(missing_at(two_rasters))


def test_a_logger_that_turns_slower_lacks_nothing():
    """Ten times slower, every step was a hole, and all of its samples were left out."""
    time = np.concatenate([np.arange(0, 20, 0.01), np.arange(20, 60, 0.1), np.arange(60, 70, 0.01)])
    assert missing_at(time).tolist() == [] == holes_at(time).tolist() and few_lost(time) == 0
    slow = np.delete(time, [2100, *range(2200, 2210), *range(2600, 2700)])
    assert holes_at(slow).tolist() == [2198, 2588] and few_lost(slow) == 1
    whole = recording(time)
    assert unbroken(whole, ["u"], every=True) == (whole,)


def test_an_input_may_turn_slower_within_its_recording():
    ticks = np.arange(2000)
    slower = recording(even(2000), u=(ticks > 1000) & (ticks % 10 > 0))
    assert unbroken(slower, ["u"]) == (slower,)
    holed = recording(even(2000), u=(ticks > 1000) & (ticks % 10 > 0) | (ticks > 1400) & (ticks < 1500))
    assert [len(part) for part in unbroken(holed, ["u"])] == [1401, 500]


# -- parts -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("made", "expected"),
    [
        ({"lost": [slice(300, 400)]}, [(0, 2.99, 300), (4, 9.99, 600)]),
        ({"lost": [slice(300, 400), slice(700, 710)]}, [(0, 2.99, 300), (4, 6.99, 300), (7.1, 9.99, 290)]),
        ({"u": slice(300, 400)}, [(0, 2.99, 300), (4, 9.99, 600)]),
        ({"u": slice(300, 400), "y": slice(300, 400)}, [(0, 2.99, 300), (4, 9.99, 600)]),
        ({"u": slice(0, 100)}, [(1, 9.99, 900)]),
        ({"u": slice(900, None)}, [(0, 8.99, 900)]),
        ({"lost": [slice(20, 100)]}, [(1, 9.99, 900)]),
        ({"lost": [slice(900, 980)]}, [(0, 8.99, 900)]),
        ({"u": slice(300, 400), "lost": [slice(350, 500)]}, [(0, 2.99, 300), (5, 9.99, 500)]),
    ],
    ids=["rows", "two", "input", "all", "begin", "end", "short begin", "short end", "both"],
)
def test_a_recording_is_cut_at_its_holes_whatever_they_are(made, expected):
    whole = recording(**made)
    parts = unbroken(whole, ["u"])
    assert spans(parts) == expected
    named = [f"run (part {k + 1})" for k in range(len(parts))] if len(parts) > 1 else ["run"]
    assert [p.name for p in parts] == named
    assert [p.in_motion for p in parts] == [p.time[0] > 0 for p in parts] and {p.begins for p in parts} == {0.0}
    assert {p.whole for p in parts} == {"run"} and {p.digest for p in parts} == {"d"}
    (said,) = cuts(parts)
    assert said.startswith("run has ") and "nobody knows" in said
    assert all(unbroken(p, ["u"]) == (p,) for p in parts)


def test_what_no_hole_is_stays_as_it_is():
    whole = recording(y=slice(300, 400))
    assert unbroken(whole, ["u"]) == (whole,) and cuts([whole]) == []
    slow = recording(u=np.arange(1000) % 5 > 0)
    assert unbroken(slow, ["u"]) == (slow,)
    nothing = recording(u=slice(None))
    assert unbroken(nothing, ["u"]) == (nothing,)  # who needs it says so


def test_a_slower_raster_is_cut_where_its_own_samples_are_missing():
    slow = recording(u=(np.arange(1000) % 5 > 0) | ((np.arange(1000) > 400) & (np.arange(1000) < 500)))
    assert spans(unbroken(slow, ["u"])) == [(0, 4, 401), (5, 9.99, 500)]


def test_few_samples_are_cut_out_for_who_follows_the_noise_and_told_to_others():
    lossy = recording(lost=[slice(300, 302), slice(500, 501)])
    (kept,) = unbroken(lossy, ["u"])
    assert len(kept) == 997 and not kept.in_motion
    assert cuts([kept]) == [
        "run lacks 3 samples, one or few at a time; inputs are carried on there, which may look like an error of a "
        "model."
    ]
    assert spans(unbroken(lossy, ["u"], every=True)) == [(0, 2.99, 300), (3.02, 4.99, 198), (5.01, 9.99, 499)]


def test_where_too_much_would_be_lost_it_is_told_and_not_cut():
    lost = np.sort(np.random.default_rng(0).permutation(np.arange(1, 999))[:100])
    (kept,) = unbroken(recording(lost=[lost]), ["u"], every=True)
    assert len(kept) == 900 and "lacks 100 samples" in cuts([kept])[0]


def test_a_short_recording_that_lacks_a_sample_is_no_less_than_it_was():
    (kept,) = unbroken(recording(even(40), lost=[slice(20, 21)]), ["u"], every=True)
    assert len(kept) == 39 and "lacks 1 sample;" in cuts([kept])[0]


def test_short_parts_are_left_out_and_told_and_without_any_other_it_is_refused():
    parts = unbroken(recording(lost=[slice(300, 400), slice(430, 500)]), ["u"])
    assert spans(parts) == [(0, 2.99, 300), (5, 9.99, 500)]
    assert "30 samples beside them are left out" in cuts(parts)[0]
    torn = recording(u=np.arange(1000) % 60 > 40)
    with pytest.raises(DataError, match=r"run: nothing to learn from .* the longest part has 41 samples"):
        unbroken(torn, ["u"])


def test_a_recording_tells_few_missing_samples_and_names_five_holes_at_most():
    lost = [slice(100 * k, 100 * k + 10) for k in range(1, 8)]
    holes = recording(lost=[*lost, slice(850, 852)]).holes
    assert len(holes) == 7 and holes[5:] == ("2 further gaps", "2 samples are missing, one or few at a time")


def test_the_time_of_a_model_goes_on_behind_a_hole():
    from hydrotwin.simulation.simulate import since_start

    whole = recording(lost=[slice(300, 400)])
    later = dataclasses.replace(whole, time=whole.time + 100.0)
    assert since_start(unbroken(later, ["u"])[1])[0] == pytest.approx(4.0)
