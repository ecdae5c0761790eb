"""Jobs run anywhere with the same answers; Ctrl-C, dead workers and missing schedulers end in order."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
import warnings
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import pytest

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.work.executor import Here, cores_of, executor_for, mapped, portable
from tests.discovery.slides import Inline
from tests.language.parts import Oscillator
from tests.work.jobs import Fitting, died, fitted, one_thread, refused, slept


@pytest.fixture(scope="module")
def jobs():
    """One recording of a heavier oscillator, fitted from three starts."""
    flat = Model(Oscillator()).flat
    t = np.arange(0.0, 1.0, 0.01)
    force = 30 * np.sin(7 * t) + 10 * np.sign(np.sin(23 * t))
    pushed = Record(t, {"force": force}, {"force": "N"}, "pushed")
    true = {"mass.mass": 2.6, "damper.friction.viscous": 60.0}
    position = simulate(flat, pushed, parameters=true)["position"] + 1e-5 * np.random.default_rng(1).normal(size=100)
    starts = [{"mass.mass": m, "damper.friction.viscous": d} for m, d in ((2.0, 100.0), (3.0, 30.0), (2.2, 80.0))]
    return [Fitting(portable(flat), t, force, position, start) for start in starts]


@pytest.fixture(scope="module")
def here(jobs):
    """The answers of this process."""
    return [fitted(job) for job in jobs]


def same(found, expected) -> bool:
    """Equal to the last bit."""
    return all(
        a["values"] == b["values"] and np.array_equal(a["left"], b["left"])
        for a, b in zip(found, expected, strict=True)
    )


def test_the_fits_find_the_mass(here):
    assert [answer["values"]["mass.mass"] for answer in here] == pytest.approx([2.6] * 3, rel=1e-3)


@pytest.mark.parametrize("spec", ["processes", "here", None])
def test_processes_and_this_process_give_the_same_answers_to_the_last_bit(spec, jobs, here):
    told = []
    with executor_for(spec, workers=2) as executor:
        found = list(mapped(executor, fitted, jobs, lambda k, answer: told.append((k, answer["values"]))))
    assert same(found, here)
    assert sorted(told, key=lambda pair: pair[0]) == [(k, answer["values"]) for k, answer in enumerate(here)]


def test_two_dask_workers_give_the_same_answers_to_the_last_bit(jobs, here, tmp_path):
    distributed = pytest.importorskip("distributed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cluster = distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path)
        )
        with cluster, executor_for(f"dask://{cluster.scheduler_address.removeprefix('tcp://')}") as executor:
            found = list(mapped(executor, fitted, jobs))
    assert same(found, here)


def test_an_executor_of_ones_own_is_used_and_left_open(jobs, here):
    with ThreadPoolExecutor(1) as own:
        with executor_for(own) as executor:
            assert executor is own
            assert same(list(mapped(executor, fitted, jobs)), here)
        assert own.submit(abs, -1).result() == 1


def test_the_command_line_which_opens_the_executor_itself_shares_cores_as_well(monkeypatch):
    monkeypatch.setattr("hydrotwin.work.executor.processors", lambda: 5)
    for spec in ("processes", None):
        with executor_for(spec, workers=1) as executor:
            assert cores_of(executor) == 5
    assert cores_of(Inline()) == 1, "nobody knows where it runs"
    assert cores_of(Here()) == 1


class LastFirst:
    """An executor that does nothing before it has ``count`` jobs, then the last of them first."""

    def __init__(self, count):
        self.count, self.jobs = count, []

    def submit(self, function, *words):
        self.jobs.append((Future(), function, words))
        if len(self.jobs) == self.count:
            for future, call, given in reversed(self.jobs):
                future.set_result(call(*given))
        return self.jobs[-1][0]


def test_results_come_in_the_order_of_the_jobs_whichever_ends_first():
    assert list(mapped(LastFirst(3), abs, [-1, -2, -3])) == [1, 2, 3]


class FirstAtOnce:
    """An executor whose first job ends at once, the others when the test says so."""

    def __init__(self):
        self.futures = []

    def submit(self, function, *words):
        future = Future()
        if not self.futures:
            future.set_result(function(*words))
        self.futures.append(future)
        return future


def test_an_answer_is_told_before_it_is_given_even_if_it_comes_while_another_is_told():
    executor, told = FirstAtOnce(), []

    def on_done(index, answer):
        told.append(index)
        if index == 0:  # the last job ends here, after the wait for the first and before its answer is given
            executor.futures[1].set_result(1)

    answers = mapped(executor, abs, [-7, -1], on_done)
    assert [(answer, list(told)) for answer in answers] == [(7, [0]), (1, [0, 1])]


def test_a_job_that_fails_raises_its_sentence_and_cancels_the_rest():
    began = time.perf_counter()
    with pytest.raises(SolveError, match="diverged"), executor_for("processes", workers=1) as executor:
        list(mapped(executor, refused, [1, -1, 2]))
    assert time.perf_counter() - began < 20


def counted(together: list) -> int:
    """How many of these jobs are at work at once."""
    together.append(1)
    time.sleep(0.02)
    together.pop()
    return len(together) + 1


def test_threads_of_one_process_do_one_job_at_a_time():
    """CasADi would end the process otherwise."""
    together: list = []
    with ThreadPoolExecutor(4) as executor:
        assert list(mapped(executor, counted, [together] * 8)) == [1] * 8


def test_stopping_early_cancels_what_has_not_begun():
    with ThreadPoolExecutor(1) as executor:
        answers = mapped(executor, slept, [0.0, *[0.2] * 20])
        next(answers)
        answers.close()
        began = time.perf_counter()
    assert time.perf_counter() - began < 1.0


def test_a_worker_that_dies_becomes_a_sentence():
    with pytest.raises(SolveError, match="worker process died"), executor_for("processes", workers=1) as executor:
        list(mapped(executor, died, [0]))


def test_a_worker_has_one_blas_thread_and_the_parent_keeps_its_own(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    with executor_for("processes", workers=1) as executor:
        (found,) = mapped(executor, one_thread, ["OPENBLAS_NUM_THREADS"])
    assert found == "1"
    assert os.environ["OPENBLAS_NUM_THREADS"] == "7"


SCRIPT = """
from hydrotwin.work.executor import executor_for, mapped
with executor_for("processes", workers=1) as executor:
    print(list(mapped(executor, abs, [-1, -2])))
"""


@pytest.mark.parametrize("way", ["file", "standard input"])
def test_a_script_without_a_main_guard_may_use_processes(way, tmp_path):
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    command = [sys.executable, str(path)] if way == "file" else [sys.executable, "-"]
    given = None if way == "file" else SCRIPT
    answer = subprocess.run(command, input=given, capture_output=True, text=True, timeout=60)
    assert (answer.stdout.strip(), answer.returncode) == ("[1, 2]", 0), answer.stderr


INTERRUPTED = """
import os, signal, sys, threading, time
from hydrotwin.work.executor import executor_for, mapped
jobs = [60.0] * 4
try:
    with executor_for("processes", workers=2) as executor:
        threading.Timer(float(sys.argv[1]), lambda: os.killpg(os.getpgrp(), signal.SIGINT)).start()
        list(mapped(executor, time.sleep, jobs))
except KeyboardInterrupt:
    print("stopped", flush=True)
"""


@pytest.mark.parametrize("seconds", ["0.2", "3.0"])
def test_ctrl_c_stops_running_jobs_at_once_and_leaves_no_process_and_no_word_of_one(seconds):
    """As a terminal sends it: to all processes at once, to those that are only beginning, too."""
    began = time.perf_counter()
    command = [sys.executable, "-c", INTERRUPTED, seconds]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=50, start_new_session=True)
    assert answer.stdout.strip() == "stopped", answer.stderr
    assert "Traceback" not in answer.stderr, answer.stderr
    assert time.perf_counter() - began < 40  # output pipes close when the last worker is gone


@pytest.mark.parametrize(
    ("spec", "kind", "says"),
    [
        ("process", DeclarationError, "Did you mean 'processes'"),
        (3, DeclarationError, "no '3'"),
        ("dask://127.0.0.1:1", DataError, "no scheduler answers"),
        ("dask://nonsense", DataError, "no scheduler answers"),
    ],
)
def test_an_executor_that_is_not_there_is_refused_in_a_sentence(spec, kind, says, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("hydrotwin.work.executor.PATIENCE", 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(kind, match=says), executor_for(spec):
            pass


def test_a_missing_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(DeclarationError, match=r"hydrotwin\[cluster\]"), executor_for("dask://127.0.0.1:8786"):
        pass


# -- travelling models ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("model", [cehA.model(), spool_valve.model()], ids=lambda m: m.name)
def test_a_model_that_travelled_has_the_same_equations_and_starts(model):
    flat = model.flat
    there = pickle.loads(pickle.dumps(portable(flat)))
    u, p = [0.3], flat.parameter_vector()
    measured = [s.name for s in flat.states if s.measured_by]
    for given in ((), tuple(measured), tuple(measured[:1]), tuple(s.name for s in flat.states)):
        z = [0.1 * s.nominal for s in flat.states if s.name in given]
        x = flat.start_given(given)(u, p, z)
        assert np.array_equal(np.array(x), np.array(there.start_given(given)(u, p, z)), equal_nan=True)
        assert np.array_equal(np.array(flat.ode(0, x, u, p)[0]), np.array(there.ode(0, x, u, p)[0]), equal_nan=True)
    assert (there.parameters, there.states, there.inputs) == (flat.parameters, flat.states, flat.inputs)


def test_a_start_that_was_not_packed_is_refused_and_can_be_packed():
    flat = cehA.model().flat
    rare = ("arm.angle", "arm.angular_velocity")
    with pytest.raises(DeclarationError, match="travels with this model"):
        portable(flat).start_given(rare)
    assert portable(flat, [rare]).start_given(rare) is not None
