"""What the command line does with its arguments before a command sees them."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin import cli
from hydrotwin.cli import spread
from tests.face.command_line import hydrotwin


def test_a_shells_list_of_validation_recordings_belongs_to_its_option():
    given = ["identify", "cehA", "t1.csv", "t2.csv", "--validate", "v1.csv", "v2.csv", "--out", "m.toml"]
    wanted = ["identify", "cehA", "t1.csv", "t2.csv", "--validate", "v1.csv", "--validate", "v2.csv", "--out", "m.toml"]
    assert spread(given) == wanted
    assert spread(["compare", "--model", "a", "--validate", "v.csv", "--json"]) == [
        "compare", "--model", "a", "--validate", "v.csv", "--json",
    ]  # fmt: skip


def test_the_version_is_told():
    answer = hydrotwin("--version")
    assert (answer.code, answer.out.strip()) == (0, f"hydrotwin {ht.__version__}")


def test_notes_are_hydrotwins_words_and_no_warnings_of_numpy(monkeypatch):
    def warned(args):
        warnings.simplefilter("default", RuntimeWarning)  # as outside of tests
        np.square(np.full(2, 1e200))
        warnings.warn("the recording is short", stacklevel=1)

    monkeypatch.setattr(cli, "app", warned)
    answer = hydrotwin("compare")
    assert answer.code == 0 and answer.err.strip() == "note the recording is short"


@pytest.mark.parametrize("command", ["compare", "identify", "gap", "sensitivity"])
@pytest.mark.parametrize(
    ("given", "meant"),
    [("motor.gain=100 rad/(s.V)", "It is a parameter: "), ("comand=2V", "Did you mean 'command'")],
)
def test_what_set_names_and_nothing_reads_is_refused(command, given, meant, tmp_path):
    """The command told that it had set the parameter, and ran with its old value."""
    record = Path("examples/cehA/recordings/validate_1.csv").resolve()
    words = ("--model", "cehA", "--validate", record, "--out", tmp_path / "out")
    if command != "compare":
        words = ("cehA", record, *(("--out", tmp_path / "out.toml") if command != "sensitivity" else ()))
    answer = hydrotwin(command, *words, "--set", given)
    said = " ".join(answer.said.split())
    assert answer.code == 2 and "is neither an input nor an output here, so that nothing would read it" in said
    assert meant in said and not list(tmp_path.iterdir())
