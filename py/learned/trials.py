"""Trainings of kinds in processes of their own, one per core, so that none can take the others with it."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing import connection, get_all_start_methods, get_context
from pathlib import Path

from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.models.language.writing import write_whole
from hydrotwin.records import Record

from .block_file import LearnedBlock, read_block, write_block
from .learning import takes, trained
from .report_card import figures

ALWAYS = "arx"  # never ended, so that there is an answer
QUICK = (ALWAYS, "piecewise")  # tried first where time is short
LONG = ("gp", "symbolic", "nn", "state_nn")  # the longest first, where there is time for all: 48, 43, 31 and 25 s of
# the processor of 190 s for all kinds on EMPS; the others take 2 to 14 s
TRAINING = 0.5  # of a kind's share of the budget, for a kind that looks at the clock: its card takes the rest
GRACE = 5.0  # s beyond the budget after which such a kind is ended, too
TOO_LATE = "it was ended, for its share of the budget was over ({share:.3g} s). Give a longer --budget, or none."
NOT_TRIED = "it was not tried, for the budget was over. Give a longer --budget, or none."
CHECKED, LEAST = 0.5, 0.1  # s between looks at the clock; the least that a kind is given to train
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Trial:
    """A kind, and the recordings that it is trained on by their name."""

    kind: str
    on: str


@dataclass(frozen=True)
class Asked:
    """What all trials have in common: recordings by a name, signals, options of `learn`."""

    records: Mapping[str, Sequence[Record]]
    inputs: Sequence
    outputs: Sequence
    options: Mapping


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a trial.

    shares : by output, the RMS error of its free run on what was held out over the output's range. stretches : the same
    by output and stretch. why : nothing was held out. seconds : of the processor. failed : why there is no block; late:
    that is, that the budget was over.
    """

    block: LearnedBlock | None = None
    shares: Mapping[str, float] = field(default_factory=dict)
    stretches: Mapping[str, Sequence[float]] = field(default_factory=dict)
    why: str = ""
    seconds: float = 0.0
    failed: str = ""
    late: bool = False


class Clock:
    """When the trials end, and what each may take."""

    def __init__(self, budget: float | None, workers: int):
        self.end, self.workers = None if budget is None else time.time() + budget, workers

    @property
    def over(self) -> bool:
        return self.end is not None and time.time() >= self.end

    def share(self, waiting: int) -> tuple[float, float] | None:
        """Begin and end of the next trial, when so many are to be started yet."""
        if self.end is None:
            return None
        now = time.time()
        return now, now + (self.end - now) * min(1.0, self.workers / waiting)

    def late(self, kind: str, share: tuple[float, float] | None, others: bool) -> bool:
        """Whether a trial has had its time: its share while others wait, else all that is left.

        A kind that looks at the clock itself has time to write its block. `ALWAYS` ends: there is an answer.
        """
        if share is None or kind == ALWAYS:
            return False
        if takes(kind, "budget"):
            return time.time() > self.end + GRACE
        return time.time() > (share[1] if others else self.end)


class Trials:
    """Trials run in processes that leave their outcomes in a folder; as a context, it ends those that still run."""

    def __init__(self, asked: Asked, folder: Path, workers: int | None, budget: float | None):
        self.asked, self.folder = asked, folder
        self.workers = workers or len(os.sched_getaffinity(0))
        self.clock, self._running = Clock(budget, self.workers), {}

    def __enter__(self) -> Trials:
        return self

    def __exit__(self, *_) -> None:
        for child, _ in self._running.values():
            child.terminate()
            child.join()

    def outcomes(self, trials: Sequence[Trial], later: int):
        """Each trial with its `Outcome`, as they end. later : trials that may follow, for the shares of a budget."""
        ends = self.clock.end is not None
        waiting, running = sorted(trials, key=_quickest_first if ends else _longest_first), self._running
        while waiting or running:
            while waiting and len(running) < self.workers and not self.clock.over:
                one = waiting.pop(0)
                share = self.clock.share(1 if one.kind in QUICK else len(waiting) + 1 + later)
                running[one] = _start(one, self.asked, share, self.folder), share
            if self.clock.over:
                yield from ((one, Outcome(failed=NOT_TRIED, late=True)) for one in waiting)
                waiting.clear()
            connection.wait([child.sentinel for child, _ in running.values()], CHECKED if ends else None)
            others = bool(waiting or later)
            late = [one for one, (_, share) in running.items() if self.clock.late(one.kind, share, others)]
            for one in [one for one, (child, _) in running.items() if not child.is_alive() or one in late]:
                yield one, _ended(*running.pop(one), one, self.folder)


def _longest_first(trial: Trial) -> tuple:
    """The order that keeps all processes busy to the end, behind one that has an answer at once."""
    return trial.kind != ALWAYS, LONG.index(trial.kind) if trial.kind in LONG else len(LONG)


def _quickest_first(trial: Trial) -> tuple:
    return trial.kind not in QUICK, not takes(trial.kind, "budget")


def _ended(child, share, trial: Trial, folder: Path) -> Outcome:
    """What became of a trial; one that still runs is ended."""
    late = child.is_alive()
    if late:
        child.terminate()
    child.join()
    if late and not _file(folder, trial, "json").exists():
        return Outcome(failed=TOO_LATE.format(share=time.time() - share[0]), late=True)
    return answer(trial, folder)


def _context():
    """Processes that begin with what all of them import, where the system has such; else anew."""
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload(["hydrotwin.learned.learning"])
    return context


def _start(trial: Trial, asked: Asked, share, folder: Path):
    """A process that trains one kind, with one thread: there are as many processes as cores."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        child = _context().Process(target=_try, args=(trial, asked, share and share[1], folder), daemon=True)
        child.start()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
    return child


def answer(trial: Trial, folder: Path) -> Outcome:
    """What a process left behind; one that broke costs only itself."""
    file = _file(folder, trial, "json")
    if not file.exists():
        return Outcome(failed="its process ended without an answer.")
    told = json.loads(file.read_text(encoding="utf-8"))
    return Outcome(read_block(_file(folder, trial, "toml")) if not told["failed"] else None, **told)


def _file(folder: Path, trial: Trial, ending: str) -> Path:
    return folder / f"{trial.kind}_{trial.on}.{ending}"


def _try(trial: Trial, asked: Asked, until: float | None, folder: Path) -> None:
    """Train one kind, and write its block and what it did. Runs in a child, which Ctrl-C ends from outside."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    began, records, options = time.process_time(), asked.records[trial.on], dict(asked.options)
    if until is not None:
        options["budget"] = max(TRAINING * (until - time.time()), LEAST)
    told = {"shares": {}, "stretches": {}, "why": "", "failed": ""}
    try:
        options = {k: v for k, v in options.items() if takes(trial.kind, k)}
        block, split = trained(trial.kind, records, asked.inputs, asked.outputs, **options)
        names = [getattr(s, "name", s) for s in asked.outputs]
        told["shares"], told["stretches"] = figures(block, split, names, records)
        told["why"] = "" if split.parts else split.why
        write_block(block, _file(folder, trial, "toml"))
    except HydrotwinError as error:
        told["failed"] = str(error)
    write_whole(_file(folder, trial, "json"), json.dumps(told | {"seconds": time.process_time() - began}))
