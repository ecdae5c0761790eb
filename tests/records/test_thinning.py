"""A recording at a longer sample time: its own samples, those of a slow sensor too."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.records import Record, unbroken
from hydrotwin.records.thinning import thinned

UNITS = {"u": "V", "y": "m"}
TIME = 0.01 * np.arange(2000)
RNG = np.random.default_rng(1)


def test_a_recording_is_thinned_out_to_samples_of_its_own():
    """On the line between two, noise is smaller, and a command has a value that nobody set."""
    time = 3.0 + 0.5 * np.arange(400)
    record = Record(time, {"u": np.where(time < 50.2, 1.0, 0.0), "y": RNG.normal(size=400)}, UNITS, "r")
    found = thinned(record, 0.7)
    assert set(found["u"]) == {0.0, 1.0} and np.isin(found["y"], record["y"]).all()
    assert np.abs(found.time - np.round((found.time - 3.0) / 0.7) * 0.7 - 3.0).max() <= 0.25 + 1e-9
    assert found.period == pytest.approx(0.7, abs=0.21) and 283 <= len(found) <= 286
    assert (thinned(record, 2.0)["y"] == record["y"][::4]).all() and thinned(record, 0.5) is record


@pytest.mark.parametrize("period", [0.02, 0.1, 0.25])
@pytest.mark.parametrize("slow", ["u", "y"])
def test_what_has_a_slower_raster_keeps_its_own_samples(slow: str, period: float):
    """A sensor in every tenth row, and in none that is kept of the others, was gone, and with it its criteria."""
    fast = RNG.normal(size=len(TIME))
    rows = np.arange(len(TIME)) % 10 == 3
    signals = {"u": fast, "y": fast} | {slow: np.where(rows, fast, np.nan)}
    found = thinned(Record(TIME, signals, UNITS, "r"), period)
    own, other = (found.time[np.isfinite(found[n])] for n in (slow, "u" if slow == "y" else "y"))
    assert len(own) == pytest.approx(20.0 / max(period, 0.1), abs=1) and np.isin(own, TIME[rows]).all()
    assert np.allclose(other, np.round(other / period) * period) and len(other) == pytest.approx(20.0 / period, abs=1)
    assert np.isin(found[slow][np.isfinite(found[slow])], fast[rows]).all()


def test_a_lost_sample_is_no_slower_raster():
    y = np.where(np.arange(len(TIME)) % 25 == 0, np.nan, 1.0)
    found = thinned(Record(TIME, {"u": np.ones(len(TIME)), "y": y}, UNITS, "r"), 0.05)
    assert found.uniform and len(found) == 400 and np.isnan(found["y"]).sum() == 80


def test_a_hole_stays_one():
    """Two of five steps of a longer period are no hole: inputs ran on over what the recording as it is was cut at."""
    keep = np.abs(TIME - 10.15) > 0.2
    record = Record(TIME[keep], {"u": TIME[keep], "y": TIME[keep]}, UNITS, "r")
    assert len(unbroken(record, ["u"])) == 2
    found = unbroken(thinned(record, 0.1), ["u"])
    assert [len(part) for part in found] == pytest.approx([100, 97], abs=1)
    assert all(np.isfinite(part["u"]).all() for part in found)
