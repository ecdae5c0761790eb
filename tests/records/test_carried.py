"""What a recording knows of itself, and what of that stays in what is made of it: kept exactly, or another one's."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.records import distinct, joined, unbroken
from hydrotwin.records.filters import one_euro, savitzky_golay
from hydrotwin.records.thinning import thinned
from hydrotwin.simulation import simulate
from tests.identification.drive import drive


@pytest.fixture(autouse=True)
def there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def written() -> ht.Record:
    """A recording as a file gives it: everything that a record can know."""
    path = Path("r.csv")
    time = np.arange(0, 4, 0.01)
    rows = [f"{t:.2f},{np.sin(t):.6f},{np.cos(t):.6f},K7,x" for t in time]
    path.write_text("\n".join(["time [s],command [mV],motor_speed [rpm],machine [1],odd [lightyear]", *rows]))
    return dataclasses.replace(ht.read_record(path), tags={"load": "2 t"})


def record_known(record: ht.Record) -> dict[str, object]:
    names = ("digest", "source", "tags", "words", "understood", "refused", "name")
    shown = {n: u for n, u in record.display_units.items() if n in ("command", "motor_speed")}
    return {n: getattr(record, n) for n in names} | {"display units": shown, "units": record.units["motor_speed"]}


def part(record):
    with_hole = record._at(np.r_[record.time[:200], record.time[200:] + 5], record.signals)
    return unbroken(with_hole, ["command"])[1]


def renamed(record):
    return distinct([record, record])[0][1]


def written_again(record):
    ht.write_record(record, "again.csv")
    return ht.read_record("again.csv")


RECORD = {
    "select": (lambda r: r.select(["motor_speed"]), {"display units"}),
    "window": (lambda r: r.window(1.0, 2.0), set()),
    "resample": (lambda r: r.resample(0.05), set()),
    "filter": (lambda r: savitzky_golay(r, ["motor_speed"], 11, 3), set()),
    "slope": (lambda r: one_euro(r, ["motor_speed"], derivative=1), set()),
    "signals": (lambda r: r.with_signals({"more": r["motor_speed"]}, {"more": "rad/s"}), set()),
    "thinned": (lambda r: thinned(r, 0.05), set()),
    "second of a name": (renamed, {"name"}),
    "part": (part, {"name"}),
    "joined": (lambda r: joined([part(r), part(r)._at(part(r).time + 9, part(r).signals)]), set()),
    "simulated": (lambda r: simulate(drive(), r), {"digest", "source", "name", "display units"}),
    "written": (written_again, {"digest", "source", "tags", "words", "refused", "name"}),
}


@pytest.mark.parametrize("change", RECORD)
def test_what_a_recording_knows_is_kept_by_what_is_made_of_it(change):
    make, dropped = RECORD[change]
    before, after = record_known(written()), record_known(make(written()))
    assert all(before.values())
    if change == "select":  # of what was taken out
        assert after["display units"] == {"motor_speed": "rpm"}
    kept = {row for row in before if row not in dropped}
    assert {row: after[row] for row in kept} == {row: before[row] for row in kept}
    assert not [row for row in dropped if after[row] == before[row]]
