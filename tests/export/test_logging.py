"""What an FMU says in the log, and to whom."""

from __future__ import annotations

import ctypes as c
import math

import pytest

from tests.export.raw import DISCARD, ERROR, OK
from tests.export.test_contract import SIZE

ALL = ["logEvents", "logStatusDiscard", "logStatusError"]
WARNING = "logStatusWarning"


def heard(library, instance) -> set[str]:
    """The categories of what is said about an initialization, a discarded value and an error."""
    library.categories.clear()
    instance.Reset()
    instance.initialise()
    assert instance.set(library.names("input")[0], math.nan) == DISCARD
    assert instance.step(123.0, SIZE) == ERROR
    return set(library.categories)


def test_the_log_categories_are_those_of_the_description_and_can_be_chosen(library):
    listed = [category.get("name") for category in library.root.find("LogCategories")]
    assert listed == [ALL[0], WARNING, *ALL[1:]]
    instance = library.instance(logging=True)
    assert heard(library, instance) == set(ALL)
    for wanted in ([ALL[0]], [ALL[1]], ALL[:2], [ALL[2]]):
        names = (c.c_char_p * len(wanted))(*(n.encode() for n in wanted))
        assert instance.SetDebugLogging(1, c.c_size_t(len(wanted)), names) == OK
        assert heard(library, instance) == {*wanted, ALL[2]}  # an error is always told
    assert instance.SetDebugLogging(1, c.c_size_t(0), None) == OK
    assert heard(library, instance) == set(ALL)
    assert instance.SetDebugLogging(0, c.c_size_t(0), None) == OK
    assert heard(library, instance) == {ALL[2]}
    assert instance.SetDebugLogging(1, c.c_size_t(1), (c.c_char_p * 1)(b"logOfNobody")) == ERROR
    instance.free()


def test_without_logging_fmi3_tells_errors_alone(library):
    quiet = library.instance()
    assert heard(library, quiet) == ({ALL[2]} if library.fmi == 3 else set(ALL[1:]))
    quiet.free()


@pytest.mark.parametrize("fmi", [2, 3])
def test_leaving_the_training_data_is_warned_of_once_each_time(exchangers, fmi):
    library = exchangers["lag with domain", ("fmi", fmi)]
    instance = library.instance(logging=True).initialise()
    warned = []
    for k, command in enumerate([0.5, 2.0, 3.0, 0.5, 2.0, 0.1]):
        assert instance.set("command", command) == OK
        library.messages.clear(), library.categories.clear()
        assert instance.step(0.06 * k, 0.06) == OK  # three samples
        warned += [(k, text) for (_, text), name in zip(library.messages, library.categories, strict=True)
                   if name == WARNING]  # fmt: skip
    assert [k for k, _ in warned] == [1, 4]
    assert [text.split(" s:")[0].split("t = ")[1] for _, text in warned] == ["0.06", "0.24"]
    stored = instance.serialized()
    assert instance.set("command", 2.0) == OK
    for _ in range(2):  # a saved state knows where it was
        assert instance.restore(stored) == OK
        assert instance.set("command", 2.0) == OK
        library.categories.clear()
        assert instance.step(0.36, 0.06) == OK
        assert library.categories == [WARNING]
    instance.free()
