"""compare: every model x variant x recording, where it runs, and what is said of it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.records.between import sentences

from .recordings import tell_read
from .shared import err, mark, out, progress_bar, table

KEPT = ".runs"  # folder of finished runs, where they are many: a second call makes only what is new
AUTO = "auto"
MANY = 40  # models x variants x recordings from which on processes are worth their start


@dataclass(frozen=True)
class Runs:
    """How the runs are made: executor, workers, what is kept is used, nothing is shown."""

    executor: str
    workers: int | None = None
    resume: bool = True
    silent: bool = False


def run(described, resolve: Callable[[str], object], output: Path, how: Runs):
    """The `Matrix` of a scenario; pages of its variants are written as soon as they are done."""
    from hydrotwin.comparison import Where, run_matrix
    from hydrotwin.report import write_variant
    from hydrotwin.report.comparison_figures import CURVES
    from hydrotwin.work.executor import KINDS, executor_for

    count = len(described.models) * max(1, len(described.variants)) * len(described.validate)
    spec = how.executor if how.executor != AUTO else "processes" if count >= MANY else "here"
    if how.workers and spec not in ("processes", "dask"):
        if how.executor != AUTO:
            raise DeclarationError(f"compare: --workers says how many processes, and {spec} has its own. Leave it out.")
        spec = "processes"
    if how.executor != AUTO and not how.executor.startswith("dask://") and how.executor not in KINDS:
        raise DeclarationError(f"executor: no '{how.executor}'. {nearest(how.executor, (AUTO, *KINDS))}")
    many = bool(described.variants) or count >= MANY or spec != "here"
    memory = _finished(output, how) if many else None

    def done(found) -> None:
        if described.variants:
            write_variant(found, output)

    try:
        with executor_for(spec, how.workers) as pool, telling(how.silent) as told:
            where = Where(pool, memory, told, CURVES, tell_read)
            matrix = run_matrix(described, resolve, where, on_variant=done if described.variants else None)
    except KeyboardInterrupt:
        if memory is not None:
            err.print(f"stopped; finished runs kept: {len(memory)}. The same command goes on from there.", style="dim")
        raise
    if memory is not None:
        memory.forget_others()
    return matrix


def _finished(output: Path, how: Runs):
    """The `Memory` of runs that an earlier call has finished."""
    from hydrotwin.work.memory import Memory

    memory = Memory(output / KEPT)
    if not how.resume:
        memory.remove()
    elif len(memory) and not how.silent:
        told = f"an earlier call left {len(memory)} runs: those of the same data and models stand (--fresh: none)"
        err.print(told, style="dim")
    return memory


@contextlib.contextmanager
def telling(silent: bool) -> Iterator[Callable[[int, int, str], None] | None]:
    """What moves a bar with (runs done, runs in all, what was done); None where nothing is to be shown."""
    if silent:
        yield None
        return
    with progress_bar() as bar:
        row = bar.add_task("compare", total=None)

        def told(done: int, total: int, what: str) -> None:
            words = f"compare: {done} of {total}{', ' if what else ''}{what}"
            bar.update(row, completed=done, total=total, description=words)

        yield told


def write(matrix, output: Path, several: bool) -> dict[str, Path]:
    """The report: of one comparison, or the overview over its variants."""
    from hydrotwin.report import write_matrix, write_report

    if several:
        return write_matrix(matrix, output)
    only = matrix.runs[0]
    return write_report(only.comparison, output, accepted=only.accepted)


def tell_between_of(entrants) -> None:
    """What inputs do between samples, with the models where these do not all take them alike."""
    from hydrotwin.comparison.criteria import some_of

    told: dict[str, list[str]] = {}
    for one in entrants:
        for sentence in sentences(one.inputs):
            told.setdefault(sentence, []).append(one.name)
    for sentence, names in told.items():
        alike = all(
            sentence in sentences([s]) for e in entrants for s in e.inputs if sentence.startswith(f"input {s.name} ")
        )
        err.print(sentence if alike else f"{some_of(names)}: {sentence}", style="dim")


def notes(matrix) -> list[str]:
    """What a user must know of inputs that nobody recorded, of starts that were estimated, which variants are the same,
    and what `notices` tell that was not told yet; but for variants of the base."""
    from hydrotwin.export.fmu_settings import AT_REST, REDEFINED
    from hydrotwin.report import remarks, starts_told, twins

    told = [
        (e.name, e.provenance[key]) for e in matrix.base.entrants for key in (REDEFINED, AT_REST) if key in e.provenance
    ]
    found = [f"{name}: {what}" for name, what in told if what]
    found += starts_told(matrix.base.starts)
    return found + twins(matrix.runs) + remarks(matrix.base)


def print_matrix(matrix) -> None:
    """The variants for a reader: mean RMSE of each model on the first output, criteria, what failed."""
    from hydrotwin.report import display_units, matrix_page
    from hydrotwin.report.acceptance import acceptance_lines

    page = matrix_page(matrix)
    headings = [c.heading for c in page.headline.columns]
    table(page.title, headings, [[cell.plain for cell in row] for row in page.headline.rows])
    out.print(page.headline.note)
    out.print()
    for run in matrix.runs:
        if run.failed:
            mark(out, "failed", f"variant {run.name}: {run.failed}")
    accepted = matrix.accepted
    for good, line in acceptance_lines(accepted, display_units(matrix.base)) if accepted else ():
        out.print(line, style="green" if good else "red")
    out.print(" ".join([page.answer if not accepted or not accepted.judged else "", *page.facts]).strip())
