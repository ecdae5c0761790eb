"""The rows of a comparison as tables: pandas and polars compute from them what the comparison says."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import polars
import pytest

from hydrotwin.comparison import FREE_RUN, Score, compare
from hydrotwin.comparison.field import FieldMetrics
from hydrotwin.models.language.errors import DeclarationError
from tests.comparison.toys import Toy, recording

TAGS = ({"load": "2", "mode": "up"}, {"load": "2"}, {"load": "5"})


@pytest.fixture(scope="module")
def found():
    records = [replace(recording(k, duration=2.0), tags=tags) for k, tags in enumerate(TAGS, 1)]
    return compare([Toy("a"), Toy("b", gain=126.0, fails_on="validation_3")], records, title="toys")


def test_scores_are_the_rows_with_their_tags_as_columns(found):
    frame = found.table().to_pandas()
    metrics = [f.name for f in fields(FieldMetrics)]
    names = [*(f.name for f in fields(Score) if f.name not in metrics), *metrics]
    assert names[:5] == ["model", "record", "output", "mode", "rmse"]
    assert list(frame.columns) == [*names, "load", "tag.mode"]  # mode is a column of its own
    assert len(frame) == len(found.scores)
    for row, score in zip(frame.to_dict("records"), found.scores, strict=True):
        np.testing.assert_equal([row[n] for n in names], [getattr(score, n) for n in names])
    told = frame.groupby("record")["load"].first()
    assert told.to_dict() == {"validation_1": "2", "validation_2": "2", "validation_3": "5"}
    assert set(frame.loc[frame["record"] != "validation_1", "tag.mode"].isna()) == {True}


def test_polars_finds_the_means_of_the_comparison_in_its_scores(found):
    means = polars.from_arrow(found.table()).group_by("model", "output", "mode").agg(polars.col("rmse").mean())
    told = {row[:3]: row[3] for row in means.rows()}
    for row in polars.from_arrow(found.table("means")).iter_rows(named=True):
        assert row["rmse"] == pytest.approx(told[row["model"], row["output"], row["mode"]], rel=1e-12)


def test_conditions_are_the_means_of_the_recordings_of_a_tag(found):
    scores, rows = found.table().to_pandas(), found.table("conditions").to_pandas()
    assert set(zip(rows["tag"], rows["value"], strict=True)) == {("load", "2"), ("load", "5"), ("mode", "up")}
    of = scores[(scores["mode"] == FREE_RUN) & (scores["output"] == "arm_angle") & (scores["load"] == "2")]
    row = rows[(rows["value"] == "2") & (rows["mode"] == FREE_RUN) & (rows["output"] == "arm_angle")]
    assert row.set_index("model")["rmse"].to_dict() == pytest.approx(of.groupby("model")["rmse"].mean().to_dict())
    assert set(rows.loc[rows["value"] == "5", "model"]) == {"a"}  # b failed there
    assert set(row["recordings"]) == {2}


def test_what_does_not_exist_is_null_and_a_table_without_rows_keeps_its_columns(found):
    table = found.table()
    assert table["coverage"].null_count == table.num_rows  # no toy has a band
    alone = replace(found, scores=(), failures=())
    assert alone.table().schema == table.schema
    assert alone.table("failures").schema == found.table("failures").schema
    assert found.table("failures")["load"].to_pylist() == ["5", "5"]
    assert set(found.table("timings")["model"].to_pylist()) == {"a", "b"}


def test_an_unknown_table_is_refused_with_the_nearest_name(found):
    with pytest.raises(DeclarationError, match=r"no table 'score' of a comparison. Did you mean 'scores'\?"):
        found.table("score")
