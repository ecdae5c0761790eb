"""Progress of long work: a function of stage, jobs done, jobs in all and a note, or a bar in the terminal."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager

Report = Callable[[str, int, int, str], None]


@contextmanager
def reporting(progress: bool | Report | None, name: str = "gap"):
    """The function to call with ``(stage, done, total, note)``: the caller's, a terminal bar's, or a silent one.

    total : 0 where it is not known. note : the candidate or recording that was last dealt with.
    """
    if callable(progress):
        yield progress
    elif progress:
        with _bar(name) as report:
            yield report
    else:
        yield lambda stage, done, total, note="": None


@contextmanager
def _bar(name: str):
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    text = TextColumn("{task.description}", markup=False)
    with Progress(SpinnerColumn(), text, BarColumn(), TimeElapsedColumn(), transient=True) as bar:
        row = bar.add_task(name, total=None)

        def report(stage: str, done: int, total: int, note: str = "") -> None:
            bar.update(row, description=described(name, stage, done, total, note), completed=done, total=total or None)

        yield report


def described(name: str, stage: str, done: int, total: int, note: str = "") -> str:
    """One line about where the work stands.

    >>> described("cehA", "refit", 3, 12, "dead_time at command")
    'cehA: refit 3 of 12, dead_time at command'
    """
    counted = f" {done} of {total}" if total else ""
    return f"{name}: {stage}{counted}{', ' if note else ''}{note}"
