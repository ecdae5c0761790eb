"""Compiling once, compilers that fail, machines without one."""

from __future__ import annotations

import ctypes
import subprocess
import warnings

import numpy as np
import pytest

from hydrotwin.models.language.errors import SolveError
from hydrotwin.simulation import compiler, prepare
from hydrotwin.simulation.compiler import compile_library
from hydrotwin.simulation.engines import MODEL
from hydrotwin.simulation.equations import directions
from hydrotwin.simulation.source import TANH, functions_of, model_source
from tests.simulation.small_models import explosion, lag

TIME = np.linspace(0, 0.3, 31)
COMMAND = np.sin(20 * TIME)[:, None]


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("HYDROTWIN_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("CC", raising=False)
    return tmp_path / "cache"


def run(model, **options):
    propagator = prepare(model, **options)
    return propagator, propagator.run(TIME, COMMAND, model.parameter_vector(), np.zeros(1))[0]


def test_a_model_is_compiled_once_and_found_again(empty_cache, monkeypatch):
    _, first = run(lag())
    files = sorted(empty_cache.iterdir())
    assert [f.name.partition("-")[0] for f in files] == ["driver", "lag"]  # nothing half-built is left
    monkeypatch.setattr(subprocess, "run", lambda *a, **k: pytest.fail("compiled again"))
    _, second = run(lag())  # a model of its own: only the file on disk is shared
    assert (first == second).all() and sorted(empty_cache.iterdir()) == files


def test_other_equations_are_another_library(new_cache):
    run(lag())
    run(lag("linear"))  # inputs are told to the driver
    prepare(explosion())
    assert [f.name.partition("-")[0] for f in sorted(new_cache.iterdir())] == ["driver", "explosion", "lag"]


def test_a_chosen_compiler_that_fails_is_quoted(empty_cache, monkeypatch, tmp_path):
    broken = tmp_path / "broken-cc"
    broken.write_text("#!/bin/sh\necho 'math.h: no such thing' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(SolveError, match=r"lag: the C compiler failed .*math\.h: no such thing.*Set CC"):
        prepare(lag())
    assert list(empty_cache.iterdir()) == []


def test_a_chosen_compiler_that_is_missing_is_named(empty_cache, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler-here")
    with pytest.raises(SolveError, match=r"no-such-compiler-here"):
        prepare(lag())


def test_the_next_compiler_is_tried_when_the_first_fails(new_cache, monkeypatch):
    monkeypatch.setattr(compiler, "compilers", lambda: [("false",), ("cc",)])
    with pytest.warns(UserWarning, match="'false' said: nothing.*Trying the next one"):
        propagator, _ = run(lag())
    assert propagator.engine == "c"


def test_the_compiler_of_the_zig_wheel_serves_where_there_is_no_cc(empty_cache, monkeypatch):
    pytest.importorskip("ziglang")
    _, expected = run(lag(), method="vm")
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    assert [command[1:] for command in compiler.compilers()] == [("-m", "ziglang", "cc")]
    propagator, y = run(lag())
    assert propagator.engine == "c"
    np.testing.assert_array_max_ulp(y, expected, 4)


def test_without_any_compiler_the_interpreter_runs_and_says_so(empty_cache, monkeypatch):
    monkeypatch.setattr(compiler, "compilers", lambda: [])
    model = lag()
    with pytest.warns(UserWarning, match="no C compiler found.*pip install ziglang"):
        propagator = prepare(model)
    assert propagator.engine == "vm"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        y = run(model)[1]  # said once
    monkeypatch.undo()
    assert y == pytest.approx(run(lag())[1], rel=1e-14)


@pytest.mark.parametrize("which", ["lag", "driver"])
def test_a_damaged_library_is_compiled_again(new_cache, which):
    model = lag()
    if which == "lag":
        source = model_source(functions_of(model, directions(model, (), ()), implicit=False))
        damaged = compile_library(source, "lag", MODEL)  # built, not loaded
    else:
        [damaged] = new_cache.iterdir()
    damaged.write_bytes(b"not a library")
    _, y = run(model)
    assert y == pytest.approx(run(lag(), method="vm")[1], rel=1e-14)
    assert len(list(new_cache.iterdir())) == 2 and damaged.stat().st_size > 1000


def test_a_cache_that_cannot_be_written_is_not_needed(tmp_path, monkeypatch):
    occupied = tmp_path / "a_file"
    occupied.write_text("")
    monkeypatch.setenv("HYDROTWIN_CACHE", str(occupied / "cache"))
    monkeypatch.delenv("CC", raising=False)
    propagator, _ = run(lag())
    assert propagator.engine == "c"


def test_the_tanh_of_the_driver_is_that_of_the_library(tmp_path, monkeypatch):
    monkeypatch.setenv("HYDROTWIN_CACHE", str(tmp_path))
    text = TANH + '__attribute__((visibility("default"))) double ours(double x) { return tanh(x); }'
    ours = ctypes.CDLL(str(compile_library(text, "tanh"))).ours
    ours.argtypes, ours.restype = [ctypes.c_double], ctypes.c_double
    random = np.random.default_rng(0)
    sizes = [random.uniform(0, 1, 2000), random.uniform(0.39, 0.41, 500), random.uniform(0, 25, 500)]
    x = np.concatenate([*sizes, 10 ** random.uniform(-300, 0, 500), [0.0, 5e-324, 1e308, np.inf]])
    x = np.concatenate([x, -x])
    np.testing.assert_array_max_ulp(np.array([ours(v) for v in x]), np.tanh(x), 4)
    assert np.isnan(ours(np.nan)) and np.signbit(ours(-0.0))
