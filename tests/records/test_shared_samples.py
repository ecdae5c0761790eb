"""A copy or a part of a recording is known as such, whatever was cut off, rounded or renamed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrotwin.records import Record, copies, follows, require_unseen, row_of, shares_samples


def recording(seed: int, seconds: float = 20.0) -> Record:
    time = np.arange(0.0, seconds, 0.01)
    command = np.sign(np.sin(time))  # the same in all
    noise = 1e-3 * np.random.default_rng(seed).standard_normal((2, len(time)))
    signals = {"command": command, "angle": np.sin(time) + noise[0], "speed": np.cos(time) + noise[1]}
    return Record(time, signals, dict.fromkeys(signals, "1"), f"run_{seed}", digest=f"digest {seed}")


def begun_anew(record: Record) -> Record:
    return Record(record.time - record.time[0], dict(record.signals), record.units, "anew", digest="anew")


def changed(record: Record, **signals) -> Record:
    return Record(record.time, {**record.signals, **signals}, record.units, "other", digest="other")


ONE = recording(1)


@pytest.mark.parametrize(
    "copy",
    [
        changed(ONE),
        changed(ONE).select(["command", "angle"]),
        changed(ONE).select(["speed", "angle", "command"]),
        changed(ONE, angle=ONE["angle"] + 1e-5),
        changed(ONE, speed=np.round(ONE["speed"], 5)),
        changed(ONE).window(0.0, 15.0),
        changed(ONE).window(12.0, 19.0),
        begun_anew(changed(ONE).window(12.0, 19.0)),
        begun_anew(changed(ONE).select(["command", "speed"]).window(5.0, 9.0)),
        Record(ONE.time + 100.0, dict(ONE.signals), ONE.units, "later", digest="later"),
        Record(ONE.time[::2], {k: v[::2] for k, v in ONE.signals.items()}, ONE.units, "thinned", digest="thinned"),
    ],
)
def test_a_copy_or_a_part_is_known(copy):
    assert shares_samples(copy, ONE) and shares_samples(ONE, copy)


@pytest.mark.parametrize(
    "other",
    [
        recording(2),
        recording(2).window(0.0, 5.0),
        recording(2).select(["command", "angle"]),
        changed(ONE, angle=-ONE["angle"]),
        changed(ONE).select(["command"]),  # commands alone may be repeated
        begun_anew(recording(2).window(5.0, 9.0)),
    ],
)
def test_another_recording_of_the_same_commands_is_another(other):
    assert not shares_samples(other, ONE) and not shares_samples(ONE, other)


def test_a_column_that_rests_is_the_same_in_another_unit():
    """It is so but for the last digit of a float, which had made two recordings of one."""
    units = {"pressure": "Pa"}
    one, other = (
        replace(ONE.with_signals({"pressure": np.full(len(ONE), value)}, units), digest=name)
        for name, value in (("bar", 1.01353e5), ("psi", 14.7 * 6894.757293168361))
    )
    assert shares_samples(one, other) and copies([one, other]) == [(one, other)]
    assert shares_samples(begun_anew(other.window(12.0, 19.0)), one)


def test_a_column_that_nobody_needs_is_not_asked_for():
    """One bad value in it, of the longer of two, had refused both."""
    broken = replace(recording(2), refused={"oil": "row 35, column 'oil': no value."})
    part = ONE.window(0.0, 15.0)
    oil = part.with_signals({"oil": np.full(len(part), 313.0)}, {"oil": "K"})
    require_unseen([oil], [broken], ("angle",))
    assert not follows([row_of(oil) | {"marks": row_of(oil)["marks"] | {"oil": "0" * 8 * 48}}], broken)


def test_copies_among_many_are_found_and_no_recording_of_the_same_commands_is_one():
    many = [recording(seed, 5.0) for seed in range(3, 9)]
    again = changed(many[2], angle=np.round(many[2]["angle"], 6))
    shorter = changed(many[1]).window(0.0, 4.0)  # a part is no copy
    assert copies([*many, again, shorter]) == [(many[2], again)]
    assert copies(many) == [] and copies([]) == []
