"""The overview over every model x variant x recording of a scenario, and the detailed page of each variant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime
from pathlib import Path

import numpy as np

from hydrotwin.comparison import Matrix, VariantRun
from hydrotwin.comparison.notices import notices_of_variants

from .acceptance import acceptance_data, acceptance_sections, verdict
from .figure import styles
from .format import difference_to_shown, number_text, with_unit
from .matrix_tables import (
    Shown,
    every_table,
    failed_table,
    grouped,
    headline,
    heat_maps,
    judged_model,
    outputs_of,
    page_of,
    tag_tables,
    variants_table,
    worst_table,
)
from .page import Page, Section, write_page
from .provenance import command_line, provenance_section
from .write import comparison_data, display_units, write_report
from .written import forget_others, note_written

LEVEL = 1.02  # variants whose errors differ by less are level


def write_variant(run: VariantRun, out_dir: str | Path, *, command: str | None = None) -> dict[str, Path]:
    """Write the detailed page of a variant into its folder below ``out_dir``; nothing where nothing was scored, or
    another variant has the same."""
    if not run.comparison.scores or run.same_as:
        return {}
    paths = write_report(run.comparison, Path(out_dir) / run.folder, accepted=run.accepted, command=command)
    note_written(Path(out_dir), paths.values())
    return paths


def write_matrix(
    matrix: Matrix, out_dir: str | Path, *, command: str | None = None, date: datetime | None = None
) -> dict[str, Path]:
    """Write the overview as report.html, report.md and compare.json into ``out_dir``; the paths as `write_report`.

    The pages of the variants are those of `write_variant`; those of variants that an earlier run had here and this one
    has not are removed. compare.json holds the base as it does without variants, and every variant under ``variants``.
    """
    paths = write_page(matrix_page(matrix, command=command, date=date), out_dir, data_name="compare.json")
    forget_others(Path(out_dir), {run.folder for run in matrix.runs if page_of(run)})
    return paths


def matrix_page(matrix: Matrix, *, command: str | None = None, date: datetime | None = None) -> Page:
    """The overview, not yet written."""
    base, accepted = matrix.base, matrix.accepted
    date = date or datetime.now().astimezone()
    command = command_line() if command is None else command
    how = Shown(display_units(base), styles(base.models))
    heat, failed = heat_maps(matrix, how), failed_table(matrix)
    made = (
        *(acceptance_sections(accepted, how.units) if accepted else ()),
        Section("variants", "What the variants change", (variants_table(matrix),)),
        Section("heat-map", "Where it is good and where not", (heat,) if heat else (), _heat_lead(matrix)),
        Section("worst", "The worst runs", (worst_table(matrix, how),), "One recording each."),
        Section(
            "conditions",
            "By operating condition",
            tuple(tag_tables(matrix, how)),
            "Mean RMSE over the recordings of each condition, the worst row first; the worst of a row is coloured.",
        ),
        Section("every", "Every model in every variant", tuple(every_table(matrix, how)), "Means over the recordings."),
        Section("failed", "What failed", (failed,) if failed else ()),
        provenance_section(base, command, date),
    )
    return Page(
        title=matrix.title,
        eyebrow=_eyebrow(matrix, date),
        answer=" ".join([*(verdict(accepted) if accepted else ()), _answer(matrix, how)]),
        facts=_facts(matrix, how),
        notices=tuple(notices_of_variants(matrix.runs)),
        headline=headline(matrix, how),
        sections=tuple(s for s in made if s.parts),
        data=comparison_data(base, (), command, date) | acceptance_data(accepted) | {"variants": variants_data(matrix)},
    )


def variants_data(matrix: Matrix) -> list[dict]:
    """What compare.json says of every variant, SI; the scores by recording are in the file of its own."""
    return [
        {
            "name": run.name,
            "changes": run.variant.changes,
            "page": page_of(run) or None,
            "failed": run.failed or None,
            "as_base": list(run.as_base),
            "same_as": run.same_as or None,
            "means": [asdict(s) for s in run.comparison.means],
            "failures": [asdict(f) for f in run.comparison.failures],
            **acceptance_data(run.accepted),
        }
        for run in matrix.runs
    ]


def _heat_lead(matrix: Matrix) -> str:
    what = "condition" if any(r.tags for r in matrix.base.records) else "recording"
    lead = f"Mean RMSE in {matrix.base.modes[0]} by {what}: dark is bad, the worst above and to the left."
    return lead + (" Models that a variant leaves as they are stand under base." if _left(matrix) else "")


def _left(matrix: Matrix) -> bool:
    return any(run.left for run in matrix.runs)


def _answer(matrix: Matrix, how: Shown) -> str:
    """Which variant and model is best and which is worst on the first output, in a sentence."""
    signal, mode = outputs_of(matrix)[0], matrix.base.modes[0]
    rows, groups, values = grouped(matrix, signal.name, mode, lambda record: "all")
    if not groups or not np.isfinite(values).any():
        return "No model could be scored: see what failed below."
    size = np.where(np.isfinite(values[:, 0]), values[:, 0], np.nan)
    (best, best_model), (last, last_model) = rows[int(np.nanargmin(size))], rows[int(np.nanargmax(size))]
    low, high = float(np.nanmin(size)), float(np.nanmax(size))
    told = [with_unit(number_text(float(difference_to_shown(v, signal.unit, how.units[signal.name]))),
                      how.units[signal.name]) for v in (low, high)]  # fmt: skip
    if high <= LEVEL * low:
        return f"All variants are level on {signal.name}: RMSE {told[0]}."
    return (
        f"On {signal.name}, {best_model} in variant {best.name} is best (RMSE {told[0]}) and {last_model} in variant "
        f"{last.name} is worst ({told[1]})."
    )


def _facts(matrix: Matrix, how: Shown) -> tuple[str, ...]:
    """How much the worst variant adds to the error of the judged model."""
    model, signal, mode = judged_model(matrix), outputs_of(matrix)[0], matrix.base.modes[0]
    mean = {r.name: next((s.rmse for s in r.comparison.ranking(signal.name, mode) if s.model == model), None)
            for r in matrix.runs if model not in r.left}  # fmt: skip
    known: Mapping[str, float] = {name: value for name, value in mean.items() if value is not None}
    base = known.get(matrix.runs[0].name)
    others = {name: value for name, value in known.items() if name != matrix.runs[0].name}
    if not base or not others:
        return ()
    last, best = max(others, key=others.__getitem__), min(others, key=others.__getitem__)
    told = f"{model} has {number_text(others[last] / base, 3)} times the error of the base in variant {last}"
    if last != best:
        told += f", and {number_text(others[best] / base, 3)} times in variant {best}"
    return (f"{told}.",)


def _eyebrow(matrix: Matrix, date: datetime) -> str:
    base = matrix.base
    counted = ((len(base.models), "model"), (len(matrix.runs), "variant"), (len(base.records), "recording"))
    words = [f"{n} {word}{'s' * (n != 1)}" for n, word in counted]
    return " · ".join([*words, f"{date:%-d %B %Y}"])
