"""Real recordings, where the environment variable HYDROTWIN_MEASURED_DATA names their folder."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hydrotwin.records import noise_floor, read_record, write_record

FOLDER = os.environ.get("HYDROTWIN_MEASURED_DATA", "")
pytestmark = pytest.mark.skipif(
    not (FOLDER and Path(FOLDER).is_dir()), reason="HYDROTWIN_MEASURED_DATA does not name a folder of recordings"
)


def recordings(pattern: str = "**/*.csv") -> list[Path]:
    return sorted(Path(FOLDER).glob(pattern)) if FOLDER else []


@pytest.mark.parametrize("path", recordings(), ids=lambda p: f"{p.parent.name}/{p.name}")
@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat"])
def test_a_measured_recording_survives_each_format(path, suffix, tmp_path):
    record = read_record(path)
    assert record.uniform
    back = read_record(write_record(record, tmp_path / f"copy{suffix}"))
    for name in record:
        np.testing.assert_allclose(back[name], record[name], rtol=1e-12, atol=0)


@pytest.mark.parametrize("path", recordings("eha_bench/*.csv"), ids=lambda p: p.name)
def test_the_bench_has_the_noise_its_notes_state(path):
    floor = noise_floor(read_record(path))
    assert floor["position"].quantum == pytest.approx(0.025e-3, rel=1e-3)
    assert 0.4e5 < floor["pressure_a"].sigma < 0.8e5
    assert 1.5e5 < floor["pressure_b"].sigma < 2.5e5
