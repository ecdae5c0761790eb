"""Start a child process for a job on an FMU: a crash or a hang there is a SolveError here."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import SolveError

# The child needs numpy and FMPy only; importing the rest of hydrotwin would take longer than most runs.
_BOOT = "import sys, runpy; sys.path.append(sys.argv.pop(1)); runpy.run_module('fmu_process', run_name='__main__')"
HANG = "the FMU did not come to an end"
LOOK = 1.0  # s between looks at the clock
SHOWN = 600  # characters of what the child said last


def run_child(job: Mapping, arrays: Mapping[str, np.ndarray], limit: float) -> dict[str, np.ndarray]:
    """Do ``job`` in a child process and return its arrays. Raises SolveError for a failure, crash or hang."""
    with tempfile.TemporaryDirectory(prefix="hydrotwin-fmu-", ignore_cleanup_errors=True) as folder:
        failure = start_child(job, arrays, Patience(limit), Path(folder))
        if failure:
            raise SolveError(f"{job['path']}: {failure}. Look at it with: hydrotwin check {job['path']}.")
        with np.load(Path(folder) / "output.npz", allow_pickle=False) as stored:
            return dict(stored)


@dataclass
class Patience:
    """How long a child may take, in s from ``since``."""

    limit: float
    since: float = field(default_factory=time.monotonic)

    def over(self) -> bool:
        """Whether it has taken too long."""
        return time.monotonic() - self.since >= self.limit


def start_child(job: Mapping, arrays: Mapping[str, np.ndarray], patience: Patience, folder: Path) -> str | None:
    """None when the job was done, else a sentence on what went wrong. Files stay in ``folder``."""
    (folder / "job.json").write_text(json.dumps(dict(job)), encoding="utf-8")
    np.savez(folder / "input.npz", **arrays)
    with (folder / "said.txt").open("wb") as said:
        child = subprocess.Popen(
            [sys.executable, "-c", _BOOT, str(Path(__file__).parent), str(folder)],
            stdin=subprocess.PIPE, stdout=said, stderr=subprocess.STDOUT, cwd=folder, start_new_session=True,
        )  # fmt: skip
        try:
            code = _waited(child, patience)
        except subprocess.TimeoutExpired:
            end_child(child)
            return f"{HANG} (got {patience.limit:g} s). Raise time_limit or shorten the record"
        except BaseException:
            end_child(child)
            raise
        finally:
            child.stdin.close()  # the child ends where this process does: see fmu_process
    answer = folder / "answer.json"
    if answer.exists():
        told = json.loads(answer.read_text(encoding="utf-8"))
        return None if told["done"] else _with_words(told["error"], folder)
    return _with_words(f"the FMU ended its process ({way_of_death(code)})", folder)


def _waited(child: subprocess.Popen, patience: Patience) -> int:
    """Its exit code. TimeoutExpired when patience is over."""
    while True:
        try:
            return child.wait(timeout=min(LOOK, patience.limit))
        except subprocess.TimeoutExpired:
            if patience.over():
                raise


def end_child(child: subprocess.Popen):
    """The child and whatever it started."""
    if os.name == "posix":
        os.killpg(child.pid, signal.SIGKILL)
    else:
        child.kill()
    child.wait()


def way_of_death(code: int) -> str:
    """How a process ended."""
    if code < 0:
        return f"signal {signal.Signals(-code).name}"
    return f"exit code {code}"


def _with_words(text: str, folder: Path) -> str:
    said = (folder / "said.txt").read_text(encoding="utf-8", errors="replace").strip()
    return f"{text}; it said: {said[-SHOWN:]}" if said else text
