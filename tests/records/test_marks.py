"""A recording is known again by its samples, in whatever file they lie."""

from __future__ import annotations

import dataclasses
import gzip

import numpy as np
import pytest

from hydrotwin.comparison import Wanted, acceptance, compare
from hydrotwin.comparison.notices import seen_before
from hydrotwin.models.language.credibility import FIT, LEARN, Credibility, Evidence, with_made_from
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.provenance import MARKED, made_from_rows
from hydrotwin.records import (
    Record,
    copies,
    follows,
    read_record,
    require_unseen,
    row_of,
    shares_samples,
    write_record,
)
from tests.comparison.toys import Toy, recording

SEEN = recording(1, name="train")


def told() -> dict:
    """As a provenance keeps it."""
    return row_of(SEEN)


def in_file(record: Record, path) -> Record:
    write_record(record, path)
    return read_record(path)


def lines_ended(folder):
    text = write_record(SEEN, folder / "other.csv").read_bytes()
    (folder / "other.csv").write_bytes(text.replace(b"\n", b"\r\n"))
    return read_record(folder / "other.csv")


def packed(folder):
    text = write_record(SEEN, folder / "other.csv").read_bytes()
    (folder / "packed.csv.gz").write_bytes(gzip.compress(text))
    return read_record(folder / "packed.csv.gz")


def in_degrees(folder):
    shown = dataclasses.replace(SEEN, display_units={"arm_angle": "deg", "pressure_cap": "bar"})
    return in_file(shown, folder / "degrees.csv")


def in_other_order(folder):
    names = [*reversed(SEEN.names)]
    more = SEEN.select(names).with_signals({"room": np.linspace(0, 1, len(SEEN))}, {"room": "1"})
    return in_file(more, folder / "order.csv")


def in_five_digits(folder):
    short = {n: np.array([float(f"{x:.5g}") for x in v]) for n, v in SEEN.signals.items()}
    return in_file(dataclasses.replace(SEEN, signals=short), folder / "digits.csv")


def its_end(folder):
    part = SEEN.window(5.0, 8.0)
    return in_file(dataclasses.replace(part, time=part.time - part.time[0]), folder / "end.csv")


def in_parquet(folder):
    return in_file(SEEN, folder / "other.parquet")


def holed(folder):
    silent = np.where((SEEN.time > 3) & (SEEN.time < 4), np.nan, SEEN["arm_angle"])
    return dataclasses.replace(SEEN.with_signals({"arm_angle": silent}), digest="")


WAYS = [lines_ended, packed, in_degrees, in_other_order, in_five_digits, its_end, in_parquet, holed]


@pytest.mark.parametrize("way", WAYS)
def test_what_a_model_was_made_from_is_known_in_any_file_of_the_same_samples(tmp_path, way):
    """Only the bytes of the file had counted: the errors of a training counted as those of a validation."""
    other = way(tmp_path)
    assert other.digest != SEEN.digest and follows([told()], other)
    model = Toy("fitted")
    model.provenance = {"trained_on": [told()]}
    found = compare([model], [other], repeats=0, modes=("free run",))
    (one,) = acceptance(found, Wanted(("arm_angle.rmse < 90 deg",))).judged
    assert f"judged on {other.name}, which the model was made from" in one.caution
    assert any(said.startswith(f"fitted was made from {other.name}") for said in seen_before(found))


@pytest.mark.parametrize("way", [lines_ended, its_end])
def test_what_was_named_as_training_is_known_so_too(tmp_path, way):
    other = way(tmp_path)
    found = compare([Toy("fmu")], [other], repeats=0, modes=("free run",), train_records=[SEEN])
    (one,) = acceptance(found, Wanted(("arm_angle.rmse < 90 deg",))).judged
    assert f"judged on {other.name}, named as what the models were made from, too" in one.caution


def test_criteria_do_not_look_through_a_recording_again(monkeypatch):
    """Each did, for each of its outputs: of 100 recordings and 12 outputs for half a minute."""
    model, asked = Toy("fitted"), []
    model.provenance = {"trained_on": [told()]}
    found = compare([model], [recording(2)], repeats=0, modes=("free run",), train_records=[SEEN])
    monkeypatch.setattr(
        "hydrotwin.comparison.comparison.follows", lambda *given: asked.append(given) or follows(*given)
    )
    judged = acceptance(found, Wanted(("fit > -1000 %", "arm_angle.rmse < 90 deg", "nrmse < 90 %"))).judged
    assert len(judged) == 3 and len(asked) == 2  # by what the model says, and by what was named


def test_another_run_of_the_same_command_is_another_recording():
    """A replayed command is the same to the last digit: what was measured tells."""
    random, sigma = np.random.default_rng(9), {"arm_angle": 2e-4, "motor_speed": 2.0, "pressure_cap": 8e3}
    again = {n: SEEN[n] + random.normal(0, s, len(SEEN)) for n, s in sigma.items()}
    replayed = dataclasses.replace(SEEN.with_signals(again), digest="1")
    assert not follows([told()], replayed) and not follows([told()], replayed.select(["command", "motor_speed"]))
    assert not any(follows([told()], recording(seed)) for seed in range(2, 8))


def of_two_commands(seed: int, what: str = "level") -> Record:
    """One course of two replayed commands, and a sensor that hardly moves: a level at its stops most of the time."""
    time, random = np.arange(0.0, 30.0, 0.01), np.random.default_rng(seed)
    commands = {"inlet": np.sin(1.9 * time), "outlet": np.cos(1.3 * time)}
    level = np.clip(3.0 * commands["inlet"] + 0.02 * random.standard_normal(len(time)), -1.0, 1.0)
    signals = commands | {what: level}
    return Record(time, signals, dict.fromkeys(signals, "1"), f"run_{seed}", digest=f"{what} {seed}")


def test_replayed_commands_tell_nothing_where_what_was_measured_seldom_moves():
    """Where the sensor rested its marks were empty, and the commands alone made half of them."""
    one, again = of_two_commands(1), of_two_commands(2)
    assert follows([row_of(one)], dataclasses.replace(one, digest="copy"))
    assert follows([row_of(one)], dataclasses.replace(one.window(5.0, 15.0), digest="part"))
    assert not follows([row_of(one)], again)


def test_replayed_commands_alone_make_no_recording_one_with_other_sensors():
    """Two runs of which each has what the other lacks had been told to be one: a model of both was made from either."""
    level, flow = of_two_commands(1), of_two_commands(2, "flow")
    assert not follows([row_of(level)], flow, ("level", "flow"))
    assert not copies([level, flow], ("level", "flow")) and not shares_samples(level, flow, ("level", "flow"))
    require_unseen([level], [flow], ("level", "flow"))
    more = dataclasses.replace(level.with_signals({"flow": flow["flow"]}, {"flow": "1"}), digest="more")
    assert copies([level, more], ("level", "flow")) == [(level, more)] and follows([row_of(level)], more, ("level",))


def test_a_recording_that_is_mostly_new_is_another():
    new = recording(2)
    after = [np.r_[SEEN[n][:100], new[n]] for n in SEEN.names]
    longer = Record(np.arange(len(after[0])) * 0.01, dict(zip(SEEN.names, after, strict=True)), SEEN.units, "longer")
    assert not follows([told()], longer)


def test_rows_without_marks_go_by_the_bytes_of_the_file():
    old = {"name": "train", "sha256": SEEN.digest}
    assert follows([old], SEEN) and not follows([old], dataclasses.replace(SEEN, digest="1"))
    for damaged in ({}, {"marks": "x", "samples": 800}, {"marks": {"arm_angle": "zz", "command": 7}, "samples": 800}):
        assert not follows([old | {"sha256": "2"} | damaged], SEEN)


def test_steps_and_what_follows_them_are_known_again():
    """A command of two values moves, too."""
    time = np.arange(0.0, 4.0, 0.01)
    force = 50.0 * np.sign(np.sin(4.0 * time + 0.1))
    way = np.cumsum(np.cumsum(force)) * 1e-6 + 1e-5 * np.random.default_rng(1).standard_normal(len(time))
    one = Record(time, {"force": force, "way": way}, {"force": "N", "way": "m"}, "steps", digest="1")
    moved = one.with_signals({"way": way + 1e-5 * np.random.default_rng(2).standard_normal(len(time))})
    assert follows([row_of(one)], dataclasses.replace(one, digest="2"))
    assert not follows([row_of(one)], dataclasses.replace(moved, digest="2"))


def test_marks_tell_no_sample_and_are_few():
    marks = told()[MARKED]
    assert {len(text) for text in marks.values()} == {8 * 48} and set(marks) == set(SEEN.names)
    still = SEEN.with_signals({n: np.full(len(SEEN), 1.0) for n in SEEN.names[1:]})
    assert MARKED not in row_of(still) and MARKED not in row_of(SEEN.window(0, 0.1))


def test_marks_go_along_with_what_a_model_was_made_from():
    """Into the record of an FMU, and back."""
    provenance = {"recordings": [told() | {"role": "train"}, {"name": "v", "role": "validate", "sha256": "3"}]}
    known = with_made_from(None, provenance)
    assert follows(known.fitted_on, dataclasses.replace(SEEN, digest="1"))
    assert follows(made_from_rows(provenance), dataclasses.replace(SEEN, digest="1"))
    rows = (told() | {"role": FIT},)
    old = (({"name": SEEN.name, "sha256": SEEN.digest, "role": FIT}),)
    new, before = (Evidence(LEARN, "", "", {}, some) for some in (rows, old))
    assert new.same_question(before) and len(Credibility((before,)).plus(new).evidence) == 1


def test_one_recording_in_two_files_counts_once_in_a_fit_and_does_not_judge_it(tmp_path):
    """A copy of other bytes had counted twice, and had judged what was fitted to it."""
    from hydrotwin.identification import identify
    from hydrotwin.records import require_once
    from tests.identification.drive import drive, recorded

    one = write_record(SEEN, tmp_path / "one.csv")
    (tmp_path / "two.csv").write_bytes(one.read_bytes().replace(b"\n", b"\r\n"))
    both = [read_record(tmp_path / name) for name in ("one.csv", "two.csv")]
    require_once(both)
    with pytest.raises(DataError, match=r"two\.csv: the same recording as .*one\.csv"):
        require_once(both, copies(both))
    run = recorded(drive(), 1, noise={"position": 1e-3})
    with pytest.raises(DataError, match="Only an unseen recording can judge"):
        identify(drive(), [run], validate=[dataclasses.replace(run, name="copy", digest="2")])


def test_a_learned_block_is_marked_by_the_columns_that_it_is_about(tmp_path):
    """Of a log of many channels the ones that move most had been marked, and a file without them was another."""
    from hydrotwin.learned import learn, read_block, write_block

    random = np.random.default_rng(3)
    channels = {f"channel_{k}": random.standard_normal(len(SEEN)) for k in range(12)}
    log = SEEN.with_signals(channels, dict.fromkeys(channels, "1"))
    block = learn("arx", [log], ["command"], ["arm_angle"])
    write_block(block, tmp_path / "arx.toml")
    rows = made_from_rows(read_block(tmp_path / "arx.toml").provenance)
    assert {name for row in rows for name in row[MARKED]} == {"command", "arm_angle"}
    assert follows(rows, dataclasses.replace(SEEN.select(["command", "arm_angle"]), digest="2"))
