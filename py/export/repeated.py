"""An FMU that is run many times: its process stays alive between the runs, and a run known already is not made again.

Whatever an FMU keeps from one run to the next would be taken for physics, so its first run is made twice. An FMU that
does not repeat itself gets a new process for each run.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.records import Record

from .child_process import HANG, end_child, way_of_death
from .reader import FmuBlock

_BOOT = (
    "import sys, runpy; sys.path.append(sys.argv.pop(1)); runpy.run_module('fmu_process.serve', run_name='__main__')"
)
KEPT_BYTES = 2e8  # of runs remembered
SHOWN = 600  # characters of what the child said last


@dataclass(frozen=True, eq=False)
class RepeatedFmu(FmuBlock):
    """An `FmuBlock` whose free runs share one process."""

    def _run(self, record: Record, first: Record | None = None) -> Record:
        job, arrays = self._job("run", record, first or record)
        return self._record(record, _process_of(self.path).run(job, arrays, self.time_limit))


def repeated(block: FmuBlock) -> RepeatedFmu:
    """The same FMU, to be run many times."""
    known = {name: getattr(block, name) for name in block.__dataclass_fields__}
    return RepeatedFmu(**known | {"description": replace(block.description, source=None)})  # so that it can travel


def runs_made(path: str) -> int:
    """Runs of the FMU in this process, without those that were known already."""
    return _process_of(path).made


_known: dict[str, _Process] = {}
_opening = threading.Lock()


def _process_of(path: str) -> _Process:
    with _opening:
        if path not in _known:
            if not _known:
                atexit.register(_close_all)
            _known[path] = _Process(path)
        return _known[path]


def _close_all() -> None:
    for process in _known.values():
        process.close()


@dataclass
class _Process:
    """The child process of one FMU file, with the runs that are remembered."""

    path: str
    made: int = 0
    _child: subprocess.Popen | None = None
    _folder: tempfile.TemporaryDirectory | None = None
    _lines: queue.Queue = field(default_factory=queue.Queue)
    _repeats: bool | None = None  # not known yet
    _runs: OrderedDict = field(default_factory=OrderedDict)
    _bytes: int = 0
    _turn: threading.Lock = field(default_factory=threading.Lock)

    def run(self, job: dict, arrays: dict[str, np.ndarray], limit: float) -> np.ndarray:
        """Outputs (n, k). Raises SolveError for a failure, crash or hang, which is remembered as well."""
        key = _key(job, arrays)
        with self._turn:
            if key not in self._runs:
                self._keep(key, self._tried(job, arrays, limit))
            self._runs.move_to_end(key)
            found = self._runs[key]
        if isinstance(found, str):
            raise SolveError(f"{self.path}: {found}. Look at it with: hydrotwin check {self.path}.")
        return found

    def _tried(self, job, arrays, limit: float) -> np.ndarray | str:
        if self._repeats is None:
            first, second = self._made(job, arrays, limit), self._made(job, arrays, limit)
            if isinstance(first, str):
                return first
            self._repeats = not isinstance(second, str) and np.array_equal(first, second, equal_nan=True)
            if not self._repeats:
                self.close()
            return first
        if not self._repeats:
            self.close()
        return self._made(job, arrays, limit)

    def _made(self, job, arrays, limit: float) -> np.ndarray | str:
        self.made += 1
        if self._child is None or self._child.poll() is not None:
            self._begin()
        folder = Path(self._folder.name)
        np.savez(folder / "input.npz", **arrays)
        try:
            self._child.stdin.write(json.dumps(job) + "\n")
            self._child.stdin.flush()
            line = self._lines.get(timeout=limit)
        except queue.Empty:
            self.close()
            return f"{HANG} (got {limit:g} s). Raise time_limit or shorten the record"
        except OSError:
            line = ""
        if not line:
            return self._died()
        answer = json.loads(line)
        if not answer["done"]:
            return self._with_words(answer["error"])
        y = np.load(folder / "output.npy", allow_pickle=False)
        return y if np.isfinite(y).all() else _not_finite(job, arrays, y)

    def _begin(self) -> None:
        self.close()
        self._folder = tempfile.TemporaryDirectory(prefix="hydrotwin-fmu-", ignore_cleanup_errors=True)
        folder, self._lines = self._folder.name, queue.Queue()
        with (Path(folder) / "said.txt").open("wb") as said:
            self._child = subprocess.Popen(
                [sys.executable, "-c", _BOOT, str(Path(__file__).parent), folder], stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=said, cwd=folder, text=True, encoding="utf-8", start_new_session=True,
            )  # fmt: skip
        threading.Thread(target=_listen, args=(self._child.stdout, self._lines), daemon=True).start()

    def _died(self) -> str:
        text = self._with_words(f"the FMU ended its process ({way_of_death(self._child.wait())})")
        self.close()
        return text

    def _with_words(self, text: str) -> str:
        said = (Path(self._folder.name) / "said.txt").read_text(encoding="utf-8", errors="replace").strip()
        return f"{text}; it said: {said[-SHOWN:]}" if said else text

    def _keep(self, key: bytes, found: np.ndarray | str) -> None:
        self._runs[key] = found
        self._bytes += getattr(found, "nbytes", 0)
        while self._bytes > KEPT_BYTES and len(self._runs) > 1:
            self._bytes -= getattr(self._runs.popitem(last=False)[1], "nbytes", 0)

    def close(self) -> None:
        """End the child; the next run begins another."""
        child, self._child = self._child, None
        if child is not None:
            if child.poll() is None:
                end_child(child)
            child.stdin.close()
            self._folder.cleanup()


def _listen(stream, lines: queue.Queue) -> None:
    """Every line that the child says, then an empty one when it has gone."""
    for line in stream:
        lines.put(line)
    lines.put("")
    stream.close()


def _key(job: dict, arrays: dict[str, np.ndarray]) -> bytes:
    told = hashlib.sha256(json.dumps(job, sort_keys=True).encode())
    for name in sorted(arrays):
        told.update(np.ascontiguousarray(arrays[name]).tobytes())
    told.update(str(os.stat(job["path"]).st_mtime_ns).encode())
    return told.digest()


def _not_finite(job: dict, arrays: dict[str, np.ndarray], y: np.ndarray) -> str:
    k, j = np.argwhere(~np.isfinite(y))[0]
    return f"output '{job['outputs'][j]}' is not finite at t = {arrays['time'][k]:.6g} s (got {y[k, j]})"
