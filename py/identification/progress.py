"""Progress of a fit: a function of stage, iteration and cost, or a bar in the terminal."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager

Report = Callable[[str, int, float], None]


@contextmanager
def reporting(progress: bool | Report | None, name: str):
    """The function to call with ``(stage, iteration, cost)``: the caller's, a terminal bar's, or one that is silent."""
    if callable(progress):
        yield progress
    elif progress:
        with _bar(name) as report:
            yield report
    else:
        yield lambda stage, iteration, cost: None


@contextmanager
def _bar(name: str):
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    cost = TextColumn("{task.fields[cost]}")
    with Progress(SpinnerColumn(), TextColumn("{task.description}"), cost, TimeElapsedColumn(), transient=True) as bar:
        row = bar.add_task(f"identify {name}", total=None, cost="")

        def report(stage: str, iteration: int, cost: float):
            shown = f"cost {cost:.6g}" if cost == cost else ""
            bar.update(row, description=f"identify {name}: {stage}, iteration {iteration}", cost=shown)

        yield report
