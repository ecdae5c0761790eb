"""Learn every model of Table I that has a block file: ``python examples/table_1/learn.py [FOLDER]``, a few minutes.

Makes the recordings where they are missing.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from examples.table_1.make_recordings import make  # noqa: E402
from hydrotwin.learned import LearnedBlock, write_block  # noqa: E402
from hydrotwin.learned.gaussian.dual import learn_dual_gp  # noqa: E402
from hydrotwin.learned.gaussian.single import learn_gaussian_process  # noqa: E402
from hydrotwin.learned.grey_box.learn import learn_grey_box  # noqa: E402
from hydrotwin.learned.network.rate import learn_rate_network  # noqa: E402
from hydrotwin.learned.piecewise.learn import learn_piecewise  # noqa: E402
from hydrotwin.records import read_record  # noqa: E402

LEARN: dict[str, tuple[Callable[..., LearnedBlock], dict]] = {
    "piecewise": (learn_piecewise, {}),
    "grey_box": (learn_grey_box, {}),
    "gaussian_process": (learn_gaussian_process, {"rate": True, "period": 0.1}),
    "dual_gp": (learn_dual_gp, {"period": 0.1}),
    "network": (learn_rate_network, {"iterations": 1000}),
}


def learn(folder: Path) -> list[Path]:
    """Write one block file per model into ``folder``; returns their paths."""
    if not (folder / "train_1.csv").exists():
        make(folder)
    train, paths = read_record(folder / "train_1.csv"), []
    for name, (learner, options) in LEARN.items():
        block = learner([train], ["current"], ["position"], name=name, **options)
        print(f"{name}: {block.description}", flush=True)
        paths.append(write_block(block, folder / f"{name}.toml")[0])
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent / "out")
    learn(parser.parse_args().folder)
