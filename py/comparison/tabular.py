"""The rows of a comparison as Arrow tables: what pandas, polars and DuckDB read as they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.records import Record

from .comparison import Comparison, Failure, Score, Timing, mean_scores

if TYPE_CHECKING:
    import pyarrow

TABLES = ("scores", "means", "conditions", "timings", "failures")


def arrow_table(comparison: Comparison, what: str) -> pyarrow.Table:
    """One of TABLES as columns, see `Comparison.table`. Raises DeclarationError for another name."""
    made: Mapping[str, Callable[[], pyarrow.Table]] = {
        "scores": lambda: _of(Score, comparison.scores, behind=_tags(comparison, Score, comparison.scores)),
        "means": lambda: _of(Score, comparison.means, without=("record",)),
        "conditions": lambda: _conditions(comparison),
        "timings": lambda: _of(Timing, comparison.timings),
        "failures": lambda: _of(Failure, comparison.failures, behind=_tags(comparison, Failure, comparison.failures)),
    }
    if what not in made:
        raise DeclarationError(f"table: no table '{what}' of a comparison. {nearest(str(what), TABLES)}")
    return made[what]()


def _conditions(comparison: Comparison) -> pyarrow.Table:
    """Means over the recordings that share the value of a tag; recordings that do not tell the tag are left out."""
    groups: dict[tuple[str, str], list[Score]] = {}
    tags_of = {r.name: r.tags for r in comparison.records}
    for score in comparison.scores:
        for tag, value in tags_of[score.record].items():
            groups.setdefault((tag, value), []).append(score)
    rows = [(key, mean) for key, scores in groups.items() for mean in mean_scores(tuple(scores))]
    front = {"tag": [tag for (tag, _), _ in rows], "value": [value for (_, value), _ in rows]}
    return _of(Score, [mean for _, mean in rows], front=front, without=("record",))


def _tags(comparison: Comparison, kind: type, rows: Sequence[Score | Failure]) -> dict[str, list[str | None]]:
    """A column for each tag of the recordings; a tag named as another column is ``tag.<name>``."""
    taken = {f.name for f in dataclasses.fields(kind)}
    records: dict[str, Record] = {r.name: r for r in comparison.records}
    names = dict.fromkeys(tag for r in comparison.records for tag in r.tags)
    return {f"tag.{tag}" if tag in taken else tag: [records[row.record].tags.get(tag) for row in rows] for tag in names}


def _in_order(kind: type) -> list[dataclasses.Field]:
    """Its own fields first: of which model, recording and output a row is, before the metrics of the field."""
    own = kind.__annotations__
    return sorted(dataclasses.fields(kind), key=lambda field: field.name not in own)


def _of(
    kind: type,
    rows: Sequence,
    *,
    front: Mapping[str, list] | None = None,
    behind: Mapping[str, list] | None = None,
    without: Sequence[str] = (),
) -> pyarrow.Table:
    """The fields of a dataclass as typed columns, also without rows; NaN, a number that does not exist, is null."""
    import pyarrow

    types = {"str": pyarrow.string(), "float": pyarrow.float64(), "int": pyarrow.int64()}
    columns = {name: pyarrow.array(values, pyarrow.string()) for name, values in (front or {}).items()}
    for field in _in_order(kind):
        if field.name not in without:
            values = [getattr(row, field.name) for row in rows]
            columns[field.name] = pyarrow.array(values, types[str(field.type)], from_pandas=True)
    columns |= {name: pyarrow.array(values, pyarrow.string()) for name, values in (behind or {}).items()}
    return pyarrow.table(columns)
