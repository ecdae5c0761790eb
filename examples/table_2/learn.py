"""Make every model of the comparison: ``python examples/table_2/learn.py [FOLDER] [MODEL...]``, a quarter of an hour.

Makes the recordings where they are missing. Every model comes out of one public function; README.md has the same as
commands.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from examples.table_2.make_recordings import make  # noqa: E402
from hydrotwin import discover, identify, load, read_record, write_model_file  # noqa: E402
from hydrotwin.learned import (  # noqa: E402
    learn_gaussian_process,
    learn_hybrid,
    learn_symbolic,
    published_formula,
    train_network,
    write_block,
    write_hybrid,
)
from hydrotwin.records import Record  # noqa: E402

FREE = ("motor.*", "cylinder.friction.viscous", "cylinder.oil.bulk_modulus")  # the rest is Table 1 of the paper
PERIOD = 0.01  # s, of the learned models
PATIENT = {"budget": 1200.0}  # s: a training ends by itself, so that a busy machine gets the same model
HEARD = ("arm_angle", "motor_speed")  # of the model, by the residual: its pressures wander in a free run
TOLD_SPEED, TOLD_COMMAND, ANGLE = ["command", "motor_speed"], ["command"], ["arm_angle"]
Learner = Callable[..., object]  # (training recordings, every tenth sample of them, folder, name, **options)


def dynamic(train: Sequence[Record], slow: Sequence[Record], folder: Path, name: str, **options) -> object:
    """The shipped model, identified."""
    fit = identify(load("cehA"), train, free=FREE, **{"starts": 1, **options})
    write_model_file(folder / f"{name}.toml", "cehA", fit.flat, {"fit": fit.message})
    return fit


def dynamic_with_effects(train: Sequence[Record], slow: Sequence[Record], folder: Path, name: str, **options) -> object:
    """The shipped model with the effects that the gap workflow names."""
    found = discover(load("cehA"), slow, free=FREE, **options)
    fitted = getattr(found.fit_after, "flat", None) or found.model.flat
    write_model_file(folder / f"{name}.toml", "cehA", fitted, {"verdict": found.verdict}, found.model.additions)
    return found


def hybrid(train: Sequence[Record], slow: Sequence[Record], folder: Path, name: str, **options) -> object:
    """The identified model with a learned residual; identified here when its file is not there."""
    if not (folder / "dynamic.toml").exists():
        dynamic(train, slow, folder, "dynamic")
    options = {"period": PERIOD, "features": HEARD, "hidden": 4, **PATIENT, **options}
    block = learn_hybrid(load(str(folder / "dynamic.toml")), train, ANGLE, name=name, **options)
    write_hybrid(block, folder / f"{name}.toml", "cehA")
    return block


def surrogate(
    learner: Callable, inputs: Sequence[str], train: Sequence[Record], slow: Sequence[Record], folder: Path, name: str,
    **options,
) -> object:  # fmt: skip
    """A learned block of ``inputs``."""
    block = learner(train, inputs, ANGLE, name=name, **{"period": PERIOD, **options})
    write_block(block, folder / f"{name}.toml")
    return block


def published(train: Sequence[Record], slow: Sequence[Record], folder: Path, name: str) -> object:
    """Eq. 17 for an amplifier that is at full speed with 5 V."""
    block = published_formula(voltage_unit=2.5)
    write_block(block, folder / f"{name}.toml")
    return block


LEARNERS: dict[str, Learner] = {
    "dynamic": dynamic,
    "eq17": published,
    "symbolic_paper": partial(surrogate, learn_symbolic, TOLD_SPEED, fit="paper"),
    "symbolic": partial(surrogate, learn_symbolic, TOLD_SPEED, **PATIENT),
    "network": partial(surrogate, train_network, TOLD_SPEED, **PATIENT),
    "network_from_command": partial(surrogate, train_network, TOLD_COMMAND, **PATIENT),
    "gaussian_process": partial(surrogate, learn_gaussian_process, TOLD_SPEED, rate=True, period=0.02, lags=3),
    "hybrid": hybrid,
    "dynamic_with_effects": dynamic_with_effects,
}


def read(folder: Path, kind: str) -> list[Record]:
    """The recordings of ``kind``: "train", "slow" or "validate"."""
    return [read_record(path) for path in sorted(folder.glob(f"{kind}_*.csv"))]


def learn(folder: Path, names: Sequence[str] = tuple(LEARNERS)) -> dict[str, object]:
    """Write one file per model into ``folder``; returns what the learners answered, by name."""
    if not (folder / "train_1.csv").exists():
        make(folder)
    train, slow, answers = read(folder, "train"), read(folder, "slow"), {}
    for name in names:
        answers[name] = LEARNERS[name](train, slow, folder, name)
        print(f"{name}: {getattr(answers[name], 'description', '') or name + '.toml'}", flush=True)
    return answers


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent / "out")
    parser.add_argument("models", nargs="*", metavar="MODEL", help=", ".join(LEARNERS))
    said = parser.parse_args()
    learn(said.folder, said.models or tuple(LEARNERS))
