"""Ctrl-C in a training of two processes: a real signal to a real command line, and what the class makes of it."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
import threading
import time

import pytest

from hydrotwin.learned import read_block
from hydrotwin.learned.gaussian.dual import learn_dual_gp
from hydrotwin.learned.interruption import CtrlC
from hydrotwin.records import write_record
from tests.learned.test_gaussian_process import valve_record

FIRST, SECOND = "process spool", "process position.slope"  # what the progress bar says of each


class Learning:
    """``hydrotwin learn dual_gp`` in a session of its own, its progress bar on a terminal that we read."""

    def __init__(self, folder):
        file = write_record(valve_record(1, 30.0), folder / "valve.csv")
        line = f"learn dual_gp {file} --input current --output position"
        ours, theirs = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hydrotwin", *line.split(), "--fit", "paper", "--out", "dual.toml"],
            cwd=folder, stdout=theirs, stderr=theirs, start_new_session=True, env=os.environ | {"TERM": "xterm"},
        )  # fmt: skip
        os.close(theirs)
        self.said, self._terminal = "", ours

    def until(self, words: str) -> None:
        """Read until it has said ``words``; to its end where it never does."""
        while words not in self.said:
            try:
                self.said += re.sub(
                    r"\x1b\[[^a-zA-Z]*[a-zA-Z]", "", os.read(self._terminal, 4096).decode(errors="replace")
                )
            except OSError:  # the other end is closed
                return

    def ended(self) -> int:
        """The exit code, after everything was read."""
        self.until("\0")
        os.close(self._terminal)
        return self.process.wait(timeout=60)


@pytest.mark.parametrize(("send", "when"), [pytest.param(os.kill, SECOND, marks=pytest.mark.proof), (os.killpg, FIRST)])
def test_ctrl_c_ends_both_processes_and_keeps_the_best_of_both(tmp_path, send, when):
    pytest.importorskip("gpytorch")
    learning = Learning(tmp_path)
    learning.until(when)
    assert when in learning.said, learning.said
    send(learning.process.pid, signal.SIGINT)
    assert learning.ended() == 0, learning.said
    assert "Traceback" not in learning.said
    assert re.search(r"note.*stopped by Ctrl-C: dual\.toml holds the best so far", learning.said)
    block = read_block(tmp_path / "dual.toml")
    spool, slope = block.provenance["processes"]
    assert block.provenance["stopped"] == "interrupted" and block.certificate.holds
    assert slope["stopped"] == "interrupted"
    if when == FIRST:
        assert spool["stopped"] == "interrupted" and spool["iterations"] < 100
    else:
        assert spool["iterations"] == 100 and slope["iterations"] < 100


def test_a_second_ctrl_c_ends_at_once_and_leaves_nothing(tmp_path):
    pytest.importorskip("gpytorch")
    learning = Learning(tmp_path)
    learning.until(FIRST)
    for _ in range(2):
        os.kill(learning.process.pid, signal.SIGINT)
        time.sleep(0.3)
    assert learning.ended() == 130, learning.said
    assert "Traceback" not in learning.said and not (tmp_path / "dual.toml").exists()


def test_a_process_whose_turn_had_not_come_is_fitted_on_few_rows():
    pytest.importorskip("gpytorch")
    seen = []

    def interrupt(step):
        seen.append(step.process)
        if len(seen) == 5:
            raise KeyboardInterrupt

    asked = [valve_record(1, 30.0, jitter=0.2)], ["current"], ["position"]
    block = learn_dual_gp(*asked, points=None, progress=interrupt)
    assert [p["stopped"] for p in block.provenance["processes"]] == ["interrupted"] * 2
    assert seen[:5] == ["spool"] * 5 and set(seen[5:]) == {"position.slope"}
    told = block.provenance["errors"]["training"]
    whole = learn_dual_gp(*asked, points=None)
    assert told["slope_on_measured_spool"] < 1.1 * whole.provenance["errors"]["training"]["slope_on_measured_spool"]


def test_the_first_signal_is_noted_and_the_second_raised():
    with CtrlC() as ctrl_c:
        assert not ctrl_c.came
        os.kill(os.getpid(), signal.SIGINT)
        assert ctrl_c.came
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)


def test_somebody_else_s_handler_and_other_threads_are_left_alone():
    heard = []
    before = signal.signal(signal.SIGINT, lambda *_: heard.append(1))
    try:
        with CtrlC() as ctrl_c:
            os.kill(os.getpid(), signal.SIGINT)
        assert heard == [1] and not ctrl_c.came
    finally:
        signal.signal(signal.SIGINT, before)

    def elsewhere():
        with CtrlC():
            heard.append(2)

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert heard == [1, 2] and signal.getsignal(signal.SIGINT) is before
