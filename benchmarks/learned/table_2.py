"""The experiment of the C-EHA paper on recordings of the rig: Table 2 for every model, over several sets of recordings.

Mean absolute error (Eq. 18) and RMS of the arm angle in free run on three recordings of 80 s, degrees, and the mean
absolute error over that of the identified dynamic model; the least, the median and the largest over the data sets.
``python benchmarks/learned/table_2.py [SEEDS] [MODEL...] [--starts N] [--folder DIR]``: 3 data sets and all models of
examples/table_2/learn.py unless said; with ``--starts`` what is learned is learned N times from the first data set.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from examples.table_2.learn import LEARNERS, read
from examples.table_2.make_recordings import make
from hydrotwin import load
from hydrotwin.comparison import FREE_RUN, HoldLast, as_contender, compare
from hydrotwin.records import Record

ANGLE, DYNAMIC, HOLD = "arm_angle", "dynamic", "hold_last"
APART = 10  # seeds between two starts: one learning tries the next few itself
UNSEEDED = ("dynamic", "dynamic_with_effects", "eq17", "gaussian_process", "symbolic_paper")


@dataclass(frozen=True)
class Row:
    """One model on one data set: degrees per validation recording, and what its making took."""

    model: str
    mae: np.ndarray
    rms: np.ndarray
    seconds: float

    @property
    def mean(self) -> float:
        """Mean of the mean absolute errors [deg]."""
        return float(self.mae.mean())


def scored(name: str, path: Path | None, judged: Sequence[Record], seconds: float) -> Row:
    """Free runs of the model of a file; without one, of the yardstick that holds the first angle."""
    angle = next(s for s in load("cehA").flat.outputs if s.name == ANGLE)
    contender = as_contender(load(str(path)), name) if path else HoldLast((angle,), name)
    found = compare([contender], judged, modes=[FREE_RUN], outputs=[ANGLE], repeats=1)
    by_record = {s.record: s for s in found.scores}
    scores = [by_record[r.name] for r in judged]
    return Row(name, *(np.degrees([getattr(s, which) for s in scores]) for which in ("mae", "rmse")), seconds)


def learned(name: str, folder: Path, file: str, **options) -> tuple[Path, float]:
    """The file of a model made from the recordings in ``folder``, and the processor seconds it took."""
    began = time.process_time()
    LEARNERS[name](read(folder, "train"), read(folder, "slow"), folder, file, **options)
    return folder / f"{file}.toml", time.process_time() - began


def rows_of(seed: int, folder: Path, wanted: Sequence[str]) -> list[Row]:
    """Every model on one data set."""
    if not (folder / "validate_3.csv").exists():
        make(folder, seed)
    judged, rows = read(folder, "validate"), []
    for name in wanted:
        row = scored(name, *_then(learned(name, folder, name), judged))
        print(f"   data set {seed}, {name}: {_figures(row)}", flush=True)
        rows.append(row)
    return [*rows, scored(HOLD, None, judged, 0.0)]


def _then(made: tuple[Path, float], judged: Sequence[Record]):
    return made[0], judged, made[1]


def _figures(row: Row) -> str:
    sets = " ".join(f"{value:.3f}" for value in row.mae)
    return f"MAE {sets}, mean {row.mean:.3f}; RMS mean {row.rms.mean():.3f} deg; {row.seconds:.0f} CPU-s"


def starts_of(folder: Path, wanted: Sequence[str], starts: int) -> None:
    """The same recordings, other seeds of the learning."""
    judged = read(folder, "validate")
    for name in (n for n in wanted if n not in UNSEEDED):
        means = []
        for seed in range(starts):
            file = name if seed == 0 else f"{name}_{seed}"
            path = folder / f"{file}.toml"
            if seed:
                learned(name, folder, file, seed=APART * seed)
            means.append(scored(name, path, judged, 0.0).mean)
        told = " ".join(f"{m:.3f}" for m in means)
        print(f"   {name}: mean MAE over {starts} starts {told} deg, median {np.median(means):.3f}", flush=True)


def main(seeds: int, wanted: Sequence[str], starts: int, folder: Path) -> None:
    tables = [rows_of(seed, folder / f"data_{seed}", wanted) for seed in range(seeds)]
    if starts > 1:
        starts_of(folder / "data_0", wanted, starts)
    print(f"\n{seeds} data sets; mean absolute error (Eq. 18), over the dynamic model's: least median largest")
    print(f"{'model':24s} {'MAE [deg]':>22s} {'ratio':>22s} {'RMS [deg]':>10s} {'CPU-s':>6s}")
    for rows in zip(*tables, strict=True):
        means = np.array([r.mean for r in rows])
        bases = [next((r.mean for r in table if r.model == DYNAMIC), np.nan) for table in tables]
        ranges = [_range(means), _range(means / bases)]
        rms, seconds = (np.median(v) for v in ([r.rms.mean() for r in rows], [r.seconds for r in rows]))
        print(f"{rows[0].model:24s} {ranges[0]:>22s} {ranges[1]:>22s} {rms:10.3f} {seconds:6.0f}")


def _range(values: np.ndarray) -> str:
    return f"{values.min():.3f} {np.median(values):.3f} {values.max():.3f}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", type=int, nargs="?", default=3)
    parser.add_argument("models", nargs="*", default=[])
    parser.add_argument("--starts", type=int, default=1)
    parser.add_argument("--folder", type=Path)
    said = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        main(said.seeds, said.models or tuple(LEARNERS), said.starts, said.folder or Path(temporary))
