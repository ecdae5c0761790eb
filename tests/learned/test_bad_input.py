"""What every kind of learned model says to recordings, files and machines it cannot use: one sentence, nothing lost.

Each kind meets each case of the list: too few samples, constant input, constant output, NaN, inputs outside the
training domain at run time, a block file of another version, truncated arrays, a library that is not installed.
"""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import (
    learn_arx,
    learn_dual_gp,
    learn_gaussian_process,
    learn_grey_box,
    learn_hybrid,
    learn_linear,
    learn_narx,
    learn_piecewise,
    learn_rate_network,
    learn_state_network,
    learn_symbolic,
    train_network,
    write_block,
    write_hybrid,
)
from hydrotwin.learned.needs import LIBRARIES, needed_to_train
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import INSIDE_TRAINING, TRAINING_DISTANCE

PERIOD, MODEL = 0.02, "spool_valve:quasi_static"
UNITS = {"current": "1", "spool": "1", "position": "m"}


@dataclass(frozen=True)
class Kind:
    """How a kind is learned from recordings in a few seconds, and what it needs to be installed to do so."""

    learn: Callable
    needs: str | None


KINDS = {
    "arx": Kind(lambda r: learn_arx(r, ["current"], ["position"], lags=(2, 2), period=PERIOD), None),
    "linear": Kind(lambda r: learn_linear(r, ["current"], ["position"], order=2, period=PERIOD), None),
    "nn": Kind(lambda r: train_network(r, ["current"], ["position"], hidden=2, starts=1, effort=0.02, lags=(1, 2),
                                     period=PERIOD), None),
    "state_nn": Kind(lambda r: learn_state_network(r, ["current"], ["position"], hidden=2, hidden_states=1, starts=1,
                                                   effort=0.1, period=PERIOD), None),
    "nn paper": Kind(lambda r: learn_rate_network(r, ["current"], ["position"], iterations=20), "torch"),
    "gp": Kind(lambda r: learn_gaussian_process(r, ["current"], ["position"], rate=True, points=100, compress=10,
                                                lags=2), "gpytorch"),
    "dual_gp": Kind(lambda r: learn_dual_gp(r, ["current"], ["position"], points=100, compress=5, knots=8, lags=2),
                    "gpytorch"),
    "piecewise": Kind(lambda r: learn_piecewise(r, ["current"], ["position"], starts=1, dead_time=0.0), None),
    "symbolic": Kind(lambda r: learn_symbolic(r, ["current"], ["position"], starts=1, generations=3, population=40,
                                              lags=(0, 1), period=PERIOD), "pyoperon"),
    "narx": Kind(lambda r: learn_narx(r, ["current"], ["position"], terms=3, degree=2, lags=(1, 2), period=PERIOD),
                 "sympy"),
    "grey_box": Kind(lambda r: learn_grey_box(r, ["current"], ["position"], starts=1, effort=0.2, knots=5), None),
    "hybrid": Kind(lambda r: learn_hybrid(ht.load(MODEL), r, ["position"], hidden=0, starts=1, effort=0.02,
                                          features=["velocity"], period=PERIOD), None),
}  # fmt: skip
each_kind = pytest.mark.parametrize("kind", KINDS)


def recording(duration: float = 20.0, strength: float = 1.0) -> Record:
    """A spool that follows its current at once and a rod that follows the spool at 0.1 m/s, saturating."""
    t = np.arange(0, duration, PERIOD)
    u = strength * (0.6 * np.sin(1.3 * t) + 0.35 * np.sin(3.1 * t))
    noise = np.random.default_rng(0).normal(0, 1e-4, (2, len(t)))
    position = np.concatenate([[0.0], np.cumsum(0.1 * np.tanh(1.5 * u[:-1]) * PERIOD)])
    return Record(t, {"current": u, "spool": u + noise[0], "position": position + noise[1]}, UNITS, "made up")


def files(block, kind: str, folder: Path) -> tuple[Path, ...]:
    """Write a block, ``folder/kind.toml``."""
    path = folder / f"{kind}.toml"
    return write_hybrid(block, path, MODEL) if kind == "hybrid" else write_block(block, path)


@pytest.fixture(scope="module")
def blocks():
    """Every kind, learned once."""
    made = {}

    def of(kind: str):
        if KINDS[kind].needs:
            pytest.importorskip(KINDS[kind].needs)
        if kind not in made:
            made[kind] = KINDS[kind].learn([recording()])
        return made[kind]

    return of


@pytest.fixture
def written(blocks, tmp_path):
    """The files of a block, the header first and the file of its arrays last."""
    return lambda kind: files(blocks(kind), kind, tmp_path)


@each_kind
@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda r: r.window(None, 0.5), "too few samples"),
        (lambda r: r.with_signals({"current": np.full(len(r), 0.3)}), "'current' never changes"),
        (lambda r: r.with_signals({"position": np.full(len(r), 0.3)}), "'position' never changes"),
        (lambda r: r.with_signals({"position": np.where(r.time == 4.0, np.nan, r["position"])}),
         "'position' has 1 values that are not numbers, the first at 4 s"),
    ],
    ids=["few", "constant input", "constant output", "NaN"],
)  # fmt: skip
def test_recordings_that_teach_nothing_are_refused(kind, change, sentence):
    if KINDS[kind].needs:
        pytest.importorskip(KINDS[kind].needs)
    with pytest.raises(DataError, match=sentence):
        KINDS[kind].learn([change(recording())])


@each_kind
def test_outside_its_training_domain_a_block_runs_and_flags_it_with_the_distance(kind, blocks, tmp_path):
    block, usual, strong = blocks(kind), recording(4.0), recording(4.0, strength=3.0)
    run = simulate(block, strong)
    assert all(np.isfinite(run[name]).all() for name in run.names)
    fmu = read_fmu(export_fmu(block, tmp_path / "block.fmu"))
    inside, outside = fmu.free_run(usual), fmu.free_run(strong)
    assert np.mean(inside[INSIDE_TRAINING]) > 0.9 and inside[TRAINING_DISTANCE].max() < 0.1
    seen = recording()["current"]
    beyond = np.maximum(strong["current"] - seen.max(), seen.min() - strong["current"]) / np.ptp(seen)
    assert outside[TRAINING_DISTANCE].max() >= 0.95 * beyond.max() > 0.2
    assert outside[INSIDE_TRAINING].min() == 0 and outside[INSIDE_TRAINING].max() == 1


@each_kind
def test_a_file_of_another_version_is_refused(kind, written):
    path = written(kind)[0]
    text = path.read_text(encoding="utf-8")
    path.write_text(re.sub(r"version = \d\n", "version = 7\n", text, count=1), encoding="utf-8")
    with pytest.raises(DataError, match=rf"{path.name}: .*version 7.* version \d"):
        ht.load(str(path))


@each_kind
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_truncated_arrays_are_refused(kind, share, written):
    *_, arrays = written(kind)
    content = arrays.read_bytes()
    arrays.write_bytes(content[: int(share * len(content))])
    with pytest.raises(DataError, match=rf"{arrays.name}: not the arrays this header was written with"):
        ht.load(str(arrays.with_suffix(".toml") if kind != "hybrid" else arrays.with_name("hybrid.toml")))


@pytest.fixture(scope="module")
def bare(blocks, tmp_path_factory):
    """What a Python without the libraries of the extra says of each kind: the last position, and of its training."""
    folder, kinds = tmp_path_factory.mktemp("bare"), []
    for kind, needs in KINDS.items():
        if needs.needs and not importlib.util.find_spec(needs.needs):
            continue
        files(blocks(kind), kind, folder)
        kinds.append(kind)
    program = f"""
import json, sys
from pathlib import Path
class Missing:
    def find_spec(name, *_):
        if name in {(*LIBRARIES,)}:
            raise ModuleNotFoundError(name=name)
sys.meta_path.insert(0, Missing)
import hydrotwin as ht
from tests.learned.test_bad_input import KINDS, recording
said = {{}}
for kind in {kinds}:
    block = ht.load(str(Path({str(folder)!r}) / (kind + ".toml")))
    last = ht.simulate(block, recording(2.0))["position"][-1]
    try:
        said[kind] = last, KINDS[kind].learn([recording()]).name
    except ht.models.language.errors.DeclarationError as error:
        said[kind] = last, str(error)
print(json.dumps(said))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@each_kind
def test_without_the_extra_a_block_runs_and_training_says_what_to_install(kind, written, bare, blocks):
    block = ht.load(str(written(kind)[0]))
    value, said = bare[kind]
    assert value == simulate(block, recording(2.0))["position"][-1]
    if KINDS[kind].needs:
        assert any(f"{library} is not installed" in said for library in LIBRARIES.values()), said  # the first it needs
        assert said.endswith("Install it with: pip install 'hydrotwin[learned]'.")
    else:
        assert said == blocks(kind).name


@pytest.mark.parametrize("library", LIBRARIES)
def test_every_library_of_the_extra_is_named(library):
    sentence = f"learn: {LIBRARIES[library]} is not installed"
    with pytest.raises(DeclarationError, match=sentence), needed_to_train("learn"):
        raise ModuleNotFoundError(name=library)


def test_a_missing_module_of_ours_is_no_missing_library():
    with pytest.raises(ModuleNotFoundError), needed_to_train("learn"):
        raise ModuleNotFoundError(name="hydrotwin.learned.nothing")
