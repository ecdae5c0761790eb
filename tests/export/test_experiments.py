"""Experiments that an FMU carries along: their tables and settings, and what is none."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

from hydrotwin.export import check_fmu, export_fmu, read_fmu
from hydrotwin.export.experiments import experiments_of, experiments_text, series_of, series_text
from hydrotwin.export.reference import reference_experiment
from hydrotwin.learned.evidence import credibility_of_block
from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError
from hydrotwin.records import Record
from hydrotwin.simulation.simulate import InaccurateWarning
from tests.export.systems import clocked_mass, lag_block
from tests.export.test_replay import INSIDE, bench, carrying


def test_a_table_gives_every_bit_back_and_the_last_of_equal_times_counts():
    time = np.array([0.0, 0.1 + 0.2, 1e-300 + 1.0])
    columns = {"a": np.array([1 / 3, -0.0, 5e-324]), "x[1]": np.arange(3.0)}
    series = series_of(series_text(time, columns).encode(), "t.csv")
    assert (series.time == time).all() and all((series.columns[n] == columns[n]).all() for n in columns)
    twice = series_of(b"\xef\xbb\xbfTime, a ,on,word\n0,1,false,x\n0,2,true,y\n1,3,true,z\n", "t.csv")
    assert (twice.time == [0, 1]).all() and (twice.columns["a"] == [2, 3]).all()
    assert (twice.columns["on"] == [1, 1]).all() and twice.others == {"word": "x"}
    for text in (b"", b"time,a\n0,1\n", b"a,time\n0,1\n1,2\n", b"\xff\xfe\x00"):
        with pytest.raises(DataError, match=r"t\.csv: "):
            series_of(text, "t.csv")


def test_experiments_are_read_as_they_were_written():
    experiment = experiments_of(
        experiments_text("s", [], INSIDE.rstrip("/")).encode(), f"{INSIDE}a.exp"
    )  # fmt: skip
    assert experiment == ()
    with pytest.raises(DataError, match="experiment 'x': 'stopTime' is no number"):
        experiments_of(b'<Experiments><Experiment name="x" stopTime="soon"/></Experiments>', "a.exp")


def test_a_recording_that_cannot_be_an_experiment_is_refused(tmp_path):
    record = bench()
    with pytest.raises(DataError, match="as an experiment of clocked mass it lacks force"):
        carrying(tmp_path / "m.fmu", experiments=[Record(record.time, {"place": record["place"]}, {"place": "m"}, "r")])
    with pytest.raises(DeclarationError, match=r"'implicit' .* starts in equilibrium"):
        reference_experiment(clocked_mass(), record, method="implicit")
    assert not list(tmp_path.iterdir())


def test_a_run_that_half_the_step_changes_is_no_experiment(tmp_path):
    from tests.simulation.small_models import small_model

    record = Record(np.arange(0.0, 60.0, 0.01), {}, {}, "wild")
    chaotic = small_model(
        "lorenz", ["x", "y", "z"], {"r": 28.0},
        lambda t, x, u, p: (ca.vertcat(10 * (x[1] - x[0]), x[0] * (p[0] - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]), x),
        start=[1.0, 1.0, 1.0], step=0.01,
    )  # fmt: skip
    refused = pytest.raises(SolveError, match=r"half the step changes .* so nobody can meet its results")
    with pytest.warns(InaccurateWarning), refused:
        reference_experiment(chaotic, record)


def test_the_fmu_of_a_learned_block_knows_what_it_was_trained_on_and_its_card(tmp_path):
    """It carried no record, so that a criterion on its training recordings passed without a caution."""
    card = {"outputs": {"angle": {"unit": "rad", "rmse": 0.01, "band": {}}}, "says": "held out: 0.01 rad"}
    rows = [{"name": "train_1", "sha256": "a" * 64, "samples": 9}]
    told = {"kind": "arx", "trained_on": rows, "selected_on": "parts of the training", "free_run": card}
    block = dataclasses.replace(lag_block(), provenance=told)
    fmu = export_fmu(block, tmp_path / "lag.fmu", credibility=credibility_of_block(block))
    assert read_fmu(fmu).provenance["trained_on"] == [{"name": "train_1", "sha256": "a" * 64}]
    (row,) = (row for row in check_fmu(fmu).rows if row.name == "record")
    assert row.verdict == "pass" and "1 recording to fit: no criteria; angle RMSE 0.01 rad" in row.detail
    assert credibility_of_block(lag_block()) is None
