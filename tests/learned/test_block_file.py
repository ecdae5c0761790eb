"""Learned blocks as files: what is written comes back, damage is named, and no training library is needed."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from hydrotwin.learned import learned_kinds, published_formula, read_block, write_block
from hydrotwin.learned.block_file import LearnedKind, register_kind
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import Block
from tests.learned import (
    test_arx,
    test_formula_block,
    test_grey_box,
    test_linear,
    test_piecewise,
    test_static_formula,
)
from tests.learned.test_compensator import small_compensator
from tests.learned.test_dual_gp import random_dual_gp
from tests.learned.test_feedback_gp import random_feedback
from tests.learned.test_gaussian_equations import random_gaussian_process
from tests.learned.test_inverse import small_network, small_table
from tests.learned.test_rate_network import random_rate_network
from tests.learned.test_state_network import random_state_network
from tests.learned.toy_machine import toy_record, untrained_block

EXAMPLES = {
    "arx": test_arx.written_block,
    "linear": test_linear.written_block,
    "network": untrained_block,
    "state_network": random_state_network,
    "rate_network": random_rate_network,
    "published_formula": published_formula,
    "gaussian_process": random_gaussian_process,
    "gaussian_feedback": random_feedback,
    "dual_gaussian_process": random_dual_gp,
    "piecewise": test_piecewise.written_block,
    "grey_box": test_grey_box.written_block,
    "symbolic": lambda: test_formula_block.formula_block(test_formula_block.PLAIN),
    "static_formula": test_static_formula.static_block,
    "inverse_table": small_table,
    "inverse_network": small_network,
    "compensator": small_compensator,
}


@pytest.fixture
def written(tmp_path):
    return write_block(untrained_block(), tmp_path / "arm.toml")


@pytest.mark.parametrize("kind", [k.name for k in learned_kinds()])
def test_a_block_of_every_kind_comes_back_from_its_file_step_for_step(kind, tmp_path):
    block = EXAMPLES[kind]()
    path, _ = write_block(block, tmp_path / "block.toml")
    again = read_block(path)
    rng = np.random.default_rng(0)
    p = block.parameter_vector()
    for _ in range(20):
        x, u = rng.normal(size=len(block.states)), rng.normal(size=len(block.inputs))
        for one, other in zip(block.step(x, u, p), again.step(x, u, p), strict=True):
            assert np.array_equal(one.full(), other.full())
        y = rng.normal(size=len(block.outputs))
        assert np.array_equal(block.start(u, y, p).full(), again.start(u, y, p).full())


@pytest.mark.parametrize("kind", [k.name for k in learned_kinds()])
def test_the_header_keeps_signals_states_domain_certificate_and_provenance(kind, tmp_path):
    block = EXAMPLES[kind]()
    again = read_block(write_block(block, tmp_path / "block.toml")[0])
    for field in ("name", "inputs", "outputs", "states", "parameters", "period", "domain", "certificate", "kind"):
        assert getattr(again, field) == getattr(block, field), field
    assert again.provenance == block.provenance and again.description == block.description


def test_a_block_runs_where_torch_cannot_be_imported(written):
    program = f"""
        import sys
        for heavy in ("torch", "gpytorch", "pyoperon"):
            sys.modules[heavy] = None
        import numpy as np
        from hydrotwin.learned import learn_gaussian_process, read_block
        from hydrotwin.models.language.errors import DeclarationError
        from hydrotwin.records import Record
        block = read_block({str(written[0])!r})
        print(block.step(np.ones(len(block.states)), 0.5, [])[0].full().sum())
        t = 0.02 * np.arange(400)
        record = Record(t, {{"u": np.sin(t), "y": np.cos(t)}}, {{"u": "V", "y": "rad"}})
        try:
            learn_gaussian_process([record], ["u"], ["y"])
        except DeclarationError as error:
            print(error)
    """
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True)
    value, sentence = run.stdout.splitlines()
    block = read_block(written[0])
    assert float(value) == pytest.approx(block.step(np.ones(len(block.states)), 0.5, [])[0].full().sum(), rel=1e-15)
    assert "hydrotwin[learned]" in sentence


def test_a_read_block_runs_in_the_simulation_room(written):
    record = toy_record(1, duration=3.0)
    original, again = simulate(untrained_block(), record), simulate(read_block(written[0]), record)
    assert np.array_equal(original["arm_angle"], again["arm_angle"])
    assert np.ptp(original["arm_angle"]) > 0


def test_writing_again_replaces_the_files_whole_and_leaves_nothing_beside(written, tmp_path):
    write_block(untrained_block(seed=7), written[0])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.npz", "arm.toml"]
    assert read_block(written[0]).provenance["seed"] == 7


def test_another_version_is_refused_with_both_versions(written):
    _edit(written[0], "version = 1", "version = 99")
    with pytest.raises(DataError, match=r"version 99 of 'network', this hydrotwin reads version 1"):
        read_block(written[0])


def test_an_unknown_kind_is_refused_with_the_nearest(written):
    _edit(written[0], 'kind = "network"\nversion', 'kind = "netwrk"\nversion')
    with pytest.raises(DataError, match="Did you mean 'network'"):
        read_block(written[0])


def test_missing_arrays_are_named(written):
    written[1].unlink()
    with pytest.raises(DataError, match=r"arrays are missing.*arm\.npz.*Keep the \.npz beside"):
        read_block(written[0])


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_cut_off_array_file_is_refused(written, share):
    whole = written[1].read_bytes()
    written[1].write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(DataError, match="cut off or belongs to another block"):
        read_block(written[0])


def test_a_header_whose_counts_do_not_fit_the_arrays_is_refused(written):
    _edit(written[0], "hidden = 4", "hidden = 5")
    with pytest.raises(DataError, match=r"array 'hidden_weights' has the wrong shape \(got \(4, 9\)\)"):
        read_block(written[0])


def test_a_header_without_its_counts_is_refused(written):
    _edit(written[0], "hidden = 4\n", "hiden = 4\n")
    with pytest.raises(DataError, match=r"not the counts of a network \(got .*hiden"):
        read_block(written[0])


def test_pickled_arrays_are_never_loaded(written, tmp_path):
    import hashlib

    old = hashlib.sha256(written[1].read_bytes()).hexdigest()
    np.savez(written[1], hidden_weights=np.array([{"a": 1}], dtype=object))
    _edit(written[0], old, hashlib.sha256(written[1].read_bytes()).hexdigest())
    with pytest.raises(DataError, match="not a readable array file"):
        read_block(written[0])


@pytest.mark.parametrize("text", ["kind = ", "", 'kind = "network"\nversion = 1\n', "[kind]\n"])
def test_a_damaged_header_is_a_sentence_not_a_traceback(tmp_path, text):
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(DataError, match=r"bad\.toml: "):
        read_block(tmp_path / "bad.toml")


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        read_block(tmp_path / "nowhere.toml")


def test_only_learned_blocks_have_block_files(tmp_path):
    b = untrained_block()
    plain = Block(b.name, b.inputs, b.outputs, b.states, b.parameters, b.step, b.start, b.period)
    with pytest.raises(DataError, match="only learned blocks"):
        write_block(plain, tmp_path / "plain.toml")
    with pytest.raises(DataError, match=r"is a \.toml file"):
        write_block(b, tmp_path / "plain.npz")


def test_a_kind_is_registered_once():
    with pytest.raises(DeclarationError, match="registered twice"):
        register_kind(LearnedKind("network", 2, None, None))


def _edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
