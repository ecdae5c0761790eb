"""The command as a shell runs it: exit codes, streams, signals."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.face.bad_files import make
from tests.face.command_line import hydrotwin


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make(tmp_path_factory.mktemp("shell"))


@pytest.fixture
def here(folder, monkeypatch):
    """Run a test in the folder."""
    monkeypatch.chdir(folder)


def shell(*words: str, **environment: str) -> subprocess.CompletedProcess:
    """The installed command in a process of its own."""
    command = [str(Path(sys.executable).with_name("hydrotwin")), *words]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=120, check=False, env={**os.environ, **environment}
    )


def test_the_shell_sees_exit_code_two_for_a_bad_recording(here):
    done = shell("simulate", "cehA", "--input", "bar.csv", "--out", "out.csv")
    assert (done.returncode, done.stdout) == (2, "")
    assert "bar.csv: column 'command' is in bar" in done.stderr and "Traceback" not in done.stderr


def test_a_compiler_that_fails_is_quoted_and_the_way_without_it_named(here):
    done = shell("simulate", "cehA", "--input", "good.csv", "--out", "out.csv", CC="false")
    assert (done.returncode, done.stdout) == (1, "")
    for words in ("the C compiler failed", "'false", "Set CC to one that works", "method='vm'"):
        assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_a_reader_that_has_gone_is_no_traceback():
    reader, writer = os.pipe()
    os.close(reader)
    command = [str(Path(sys.executable).with_name("hydrotwin")), "modelica", "cehA"]
    try:
        done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=120, check=False)
    finally:
        os.close(writer)
    assert done.returncode == 1
    assert done.stderr == ""


def test_control_c_stops_without_a_traceback(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("hydrotwin.commands.showing.load", interrupted)
    answer = hydrotwin("linearize", "cehA")
    assert answer.code == 130
    assert "Traceback" not in answer.said


def test_python_m_hydrotwin_is_the_same_command(here):
    command = [sys.executable, "-m", "hydrotwin", "linearize", "eq17"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert "'eq17' is no physical model" in done.stderr
