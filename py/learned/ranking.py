"""Try every kind of learned model on the same recordings; rank them by how well they run freely on what is held out.

Each kind is trained in a process of its own, one per core, so that none can take the others with it. Of many kinds one
is the best by chance: among those that are as good, by one standard error over the stretches held out (`verdicts`), the
one with the fewest numbers is taken. What is held out chooses here, so the figure of the chosen is a little too good.
Where commands repeat, what is held out has been seen before: there every kind is trained a second time, on the first
course of the commands alone (`without_repeats`), and judged at the end of that as well. One that knows commands by
heart fails there; one that drifts fails over all.
"""

from __future__ import annotations

import json
import os
import signal
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing import connection, get_all_start_methods, get_context
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, HydrotwinError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.writing import write_whole
from hydrotwin.records import Record

from .block_file import LearnedBlock, read_block, write_block
from .interruption import INTERRUPTED
from .learning import KINDS, check_select, learn, takes
from .repeats import without_repeats
from .report_card import BLOCK
from .verdicts import as_good

ALONE = ("hybrid", "dual_gp")  # kinds that need more than recordings with inputs and outputs
QUICK = ("arx", "piecewise")  # tried first where time is short, and the first of them is never ended
LONG = (
    "nn",
    "gp",
    "state_nn",
    "symbolic",
)  # the longest first, where there is time for all: 120, 96, 48 and 31 s of 327 s
# for all kinds on 10 000 samples of the C-EHA; the others take 2 to 15 s
TRAINING = 0.5  # of a kind's share of the budget, for a kind that looks at the clock: its card takes the rest
GRACE = 5.0  # s beyond the budget after which such a kind is ended, too
TOO_LATE = "it was ended, for its share of the budget was over ({share:.3g} s). Give a longer --budget, or none."
ONCE = (
    "The commands repeat: kinds were also trained on the first {first:.3g} s of {all:.3g} s alone and judged at "
    "commands there that they had not seen, for at repeated ones what is known by heart seems best."
)
NO_FIRST = "On the first course of the commands alone, it cannot be judged: {why}"
NOT_TRIED = "it was not tried, for the budget was over. Give a longer --budget, or none."
CHECKED, LEAST = 0.5, 0.1  # s between looks at the clock; the least that a kind is given to train
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True, eq=False)
class Tried:
    """A kind that was tried.

    shares : by output, the RMS error of its free run on what was held out over the output's range. stretches : the same
    by output and stretch. seconds : of the training. failed : why there is no block, a sentence.
    """

    kind: str
    block: LearnedBlock | None = None
    shares: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    failed: str = ""
    stretches: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @property
    def numbers(self) -> int:
        """How many the block is made of: what it takes to write it down."""
        return sum(np.size(values) for values in self.block.arrays.values()) if self.block else 0

    @property
    def errors(self) -> list[float]:
        """By stretch, the mean over the outputs; none where there are none of some output."""
        known = len(self.stretches) == len(self.shares) > 0
        return [float(np.mean(part)) for part in zip(*self.stretches.values(), strict=True)] if known else []

    def as_good_as(self, best: Tried) -> bool:
        """Whether chance may be all that makes another one the best."""
        return self is best or bool(self.errors and best.errors and as_good(self.errors, best.errors))

    @property
    def share(self) -> float:
        """Mean over the outputs; infinite where it failed, or where nothing could be held out."""
        return sum(self.shares.values()) / len(self.shares) if self.shares else float("inf")

    def told(self) -> dict:
        """For the provenance and JSON."""
        answer = {"kind": self.kind, "seconds": round(self.seconds, 2)}
        answer |= {"numbers": self.numbers} if self.block else {}
        if self.shares:
            answer |= {"percent_of_range": {name: 100 * share for name, share in self.shares.items()}}
        if self.stretches:
            answer["stretches"] = {name: [100 * e for e in part] for name, part in self.stretches.items()}
        return answer | ({"failed": self.failed} if self.failed else {})


def learn_best(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    kinds: Sequence[str] | None = None,
    workers: int | None = None,
    budget: float | None = None,
    progress: Callable[[int, int, str], None] | None = None,
    **options,
) -> LearnedBlock:
    """Train every kind as `learn` does, and answer the block that runs best on what was held out.

    Of those that run as well, by one standard error over the stretches held out, it is the one with the fewest numbers.
    ``provenance["ranking"]`` lists all kinds, the best first: share of the range in percent, over all and by stretch;
    numbers of the block; seconds; which are ``as_good`` as the first, which is ``chosen``; why one failed.

    Args:
        records, inputs, outputs: as in `learn`.
        kinds: names of `KINDS`; None: all that need nothing else.
        workers: processes; None: one per core.
        budget: s on the clock that all trials may take together; None: as long as they take. What is left is shared
            evenly among the kinds still to try; `QUICK` ones come first. A kind that looks at no clock is ended with
            its share, and says so in the ranking. On a busier machine the same budget gives other blocks.
        progress: called with (kinds done, kinds in all, what was found).
        options: those of `learn` that a kind takes are passed on to it (seed, validate, select, name).

    Ctrl-C ends the trials with the best so far. `refitted` trains the chosen kind again on all recordings.

    Raises:
        DataError: no kind could be trained; the sentence of each is in it. DeclarationError: a kind that is not known.
    """
    every = [k for k in KINDS if k not in ALONE]
    chosen = list(dict.fromkeys(kinds)) if kinds is not None else every
    for kind in chosen:
        if kind not in every:
            raise DeclarationError(f"learn auto: no kind '{kind}' to try. {nearest(kind, every)}")
    check_select("auto", records, options.get("select"))
    records, (inputs, outputs) = list(records), (list(inputs), list(outputs))
    first = without_repeats(records, *([getattr(s, "name", s) for s in part] for part in (inputs, outputs)))
    again = sum(map(len, first)) < sum(map(len, records))
    given = (records, first if again else [], inputs, outputs, options)
    found = _tried(chosen, given, (workers, budget), progress)
    ranked = sorted(found, key=lambda t: (t.share, t.block is None, chosen.index(t.kind)))
    if not ranked or ranked[0].block is None:
        raise DataError(f"learn auto: no kind could be trained. {_reasons(found)}")
    good = [t for t in ranked if t.block is not None and t.as_good_as(ranked[0])]
    taken = min(good, key=lambda t: t.numbers)
    rows = [t.told() | {"as_good": t in good, "chosen": t is taken} for t in ranked]
    told = {"ranking": rows, "chosen_on": "what was held out of the training recordings"}
    stopped = {"stopped": INTERRUPTED} if len(found) < len(chosen) else {}
    if again:
        seconds = {"first": sum(r.duration for r in first), "all": sum(r.duration for r in records)}
        card = taken.block.provenance["free_run"]
        told["free_run"] = card | {"says": f"{card['says']} {ONCE.format(**seconds)}"}
    return replace(taken.block, provenance={**taken.block.provenance, **told, **stopped})


def _tried(kinds: Sequence[str], given: tuple, means: tuple, progress: Callable | None) -> list[Tried]:
    """What became of each kind, in the order of their ends; those that ended before Ctrl-C.

    means : workers, and s on the clock; None: one per core, as long as it takes.
    """
    found: list[Tried] = []
    workers, budget = means[0] or len(os.sched_getaffinity(0)), means[1]
    waiting = sorted(kinds, key=_longest_first if budget is None else _quickest_first)
    clock, running = _Clock(budget, workers), {}
    with tempfile.TemporaryDirectory() as folder:
        try:
            while waiting or running:
                while waiting and len(running) < workers and not clock.over:
                    share = clock.share(1 if waiting[0] in QUICK else len(waiting))
                    running[waiting[0]] = _start(waiting[0], given, share, Path(folder)), share
                    waiting.pop(0)
                if clock.over:
                    found += [Tried(kind, failed=NOT_TRIED) for kind in waiting]
                    waiting.clear()
                connection.wait([child.sentinel for child, _ in running.values()], budget and CHECKED)
                late = [kind for kind, (_, share) in running.items() if clock.late(kind, share, bool(waiting))]
                for kind in [k for k, (child, _) in running.items() if not child.is_alive() or k in late]:
                    child, share = running.pop(kind)
                    found.append(_ended(child, kind, share, Path(folder)))
                    if progress:
                        best = min(found, key=lambda t: t.share)
                        progress(len(found), len(kinds), f"{kind} ended, best so far {best.kind}")
        except KeyboardInterrupt:
            if not any(t.block for t in found):
                raise
        finally:
            for child, _ in running.values():
                child.terminate()
                child.join()
    return found


def _reasons(found: Sequence[Tried]) -> str:
    """Why kinds failed, each reason once behind all that have it."""
    kinds: dict[str, list[str]] = {}
    for one in found:
        kinds.setdefault(one.failed.removeprefix("learn: "), []).append(one.kind)
    return " ".join(f"{'all' if len(kinds) == 1 else ', '.join(own)}: {why}" for why, own in kinds.items())


def _longest_first(kind: str) -> tuple:
    """The order that keeps all processes busy to the end, behind one that has an answer at once."""
    return kind != QUICK[0], LONG.index(kind) if kind in LONG else len(LONG)


def _quickest_first(kind: str) -> tuple:
    return kind not in QUICK, not takes(kind, "budget")


class _Clock:
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

        A kind that looks at the clock itself has time to write its card. The first of `QUICK` ends: there is an answer.
        """
        if share is None or kind == QUICK[0]:
            return False
        if takes(kind, "budget"):
            return time.time() > self.end + GRACE
        return time.time() > (share[1] if others else self.end)


def _ended(child, kind: str, share, folder: Path) -> Tried:
    """What became of a trial; one that still runs is ended."""
    late = child.is_alive()
    if late:
        child.terminate()
    child.join()
    if late and not (folder / f"{kind}.json").exists():
        return Tried(kind, failed=TOO_LATE.format(share=time.time() - share[0]))
    return _answer(kind, folder)


def _context():
    """Processes that begin with what all of them import, where the system has such; else anew."""
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload(["hydrotwin.learned.learning"])
    return context


def _start(kind: str, given: tuple, share, folder: Path):
    """A process that trains one kind, with one thread: there are as many processes as cores."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        child = _context().Process(target=_try, args=(kind, *given, share and share[1], folder), daemon=True)
        child.start()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
    return child


def _answer(kind: str, folder: Path) -> Tried:
    """What a process left behind; one that broke costs only itself."""
    answer = folder / f"{kind}.json"
    if not answer.exists():
        return Tried(kind, failed="its process ended without an answer.")
    told = json.loads(answer.read_text(encoding="utf-8"))
    file = folder / f"{kind}.toml"
    block = read_block(file) if file.exists() else None
    return Tried(kind, block, told["shares"], told["seconds"], told["failed"], told["stretches"])


def _try(kind: str, records, first, inputs, outputs, options: Mapping, until: float | None, folder: Path) -> None:
    """Train one kind, and write its block and what it did. Runs in a child, which Ctrl-C ends from outside.

    first : what of the recordings is trained on a second time, to be judged at commands that do not repeat; or nothing.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    began, shares, stretches, failed = time.process_time(), {}, {}, ""
    if until is not None:
        options = {**options, "budget": max(TRAINING * (until - time.time()) / (2 if first else 1), LEAST)}
    try:
        options = {k: v for k, v in options.items() if takes(kind, k)}
        block = learn(kind, records, inputs, outputs, **options)
        write_block(block, folder / f"{kind}.toml")
        shares, stretches = _judged(block)
        if first:
            other = learn(kind, first, inputs, outputs, **options)
            shares, stretches = _both((shares, stretches), _judged(other))
            failed = "" if stretches else NO_FIRST.format(why=other.provenance["free_run"]["says"])
    except HydrotwinError as error:
        failed = NO_FIRST.format(why=error) if shares else str(error)
    if failed:  # where there is a block, nothing says how good it is
        shares, stretches = {}, {}
    told = {"shares": shares, "stretches": stretches, "seconds": time.process_time() - began, "failed": failed}
    write_whole(folder / f"{kind}.json", json.dumps(told))


def _judged(block: LearnedBlock) -> tuple[dict, dict]:
    """By output, what was missed where a block was judged, over the range of the output: over all, and by stretch."""
    rows = block.provenance["free_run"]["outputs"]
    shares = {name: row.get("percent_of_range", float("inf")) / 100 for name, row in rows.items()}
    by_output = {name: (row["stretches"].get(BLOCK), row["range"]) for name, row in rows.items()}
    return shares, {n: [e / range_ for e in errors] for n, (errors, range_) in by_output.items() if errors}


def _both(one: tuple[dict, dict], other: tuple[dict, dict]) -> tuple[dict, dict]:
    """Two judgements as one: root of the mean square, and the stretches of both."""
    shares = {n: float(np.sqrt((share**2 + other[0].get(n, np.inf) ** 2) / 2)) for n, share in one[0].items()}
    return shares, {n: [*part, *other[1][n]] for n, part in one[1].items() if n in other[1]}
