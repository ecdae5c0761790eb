"""Where jobs run: this machine's cores, this process, an executor of one's own, or a Dask cluster.

A job is a top-level function of this package with plain data, so that every executor gives the same answers.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import tempfile
import threading
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from multiprocessing import context

import casadi as ca

from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError, nearest
from hydrotwin.models.language.flat import FlatModel

KINDS = ("processes", "here", "dask", "dask://host:port")
BLAS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
MANY_MEASURED = 6  # up to so many measured states every subset of them may be given
PATIENCE = 20.0  # seconds to wait for a scheduler


# -- executors ---------------------------------------------------------------------------------------------------------
@contextmanager
def executor_for(spec: str | Executor | None = None, workers: int | None = None) -> Iterator[Executor]:
    """The executor that ``spec`` names, ready to use and closed at the end.

    ====================  ==================================================================================
    None, "processes"     local processes, as many as cores, each with one BLAS thread
    "here"                this process, one job after the other
    "dask://host:port"    the workers of a Dask scheduler (extra ``cluster``)
    "dask"                Dask workers of this machine, as many as cores, for as long as the work lasts
    an Executor           used as it is, and left open
    ====================  ==================================================================================

    Raises
    ------
    DeclarationError : no such executor, or its package is missing. DataError : no scheduler answers.
    """
    if isinstance(spec, Executor) or (hasattr(spec, "submit") and not isinstance(spec, str)):
        yield spec
    elif spec is None or spec == "processes":
        with _processes(workers or processors()) as pool:
            yield pool
    elif spec == "here":
        yield Here()
    elif spec == "dask":
        with _cluster(workers or processors()) as address, _dask(address) as pool:
            yield pool
    elif isinstance(spec, str) and spec.startswith("dask://"):
        with _dask(spec) as pool:
            yield pool
    else:
        raise DeclarationError(f"executor: no '{spec}'. {nearest(str(spec), KINDS)}")


def cores_of(executor: Executor) -> int:
    """Cores that its jobs may share among them: those of this machine for its processes, 1 for anything else."""
    return processors() if isinstance(executor, ProcessPoolExecutor) else 1


def processors() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def begin_early(executor: Executor, function: Callable) -> None:
    """Let processes of this machine begin now, and import what a function of jobs needs, not one by one with jobs."""
    if isinstance(executor, ProcessPoolExecutor):
        for _ in range(processors()):
            executor.submit(_imported, function)


def _imported(function: Callable) -> None:
    """In a worker: with the name of a function its module has come."""


class Here(Executor):
    """Runs every job at once, in the thread that submits it."""

    def submit(self, function, /, *arguments, **named) -> Future:
        future = Future()
        try:
            future.set_result(function(*arguments, **named))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def _processes(workers: int) -> Iterator[Executor]:
    """Spawned processes; they are stopped at once when the block ends with an error or Ctrl-C."""
    before = {name: os.environ.get(name) for name in BLAS}
    os.environ.update(dict.fromkeys(BLAS, "1"))  # read by a worker when it starts
    pool = ProcessPoolExecutor(workers, mp_context=_Spawned(), initializer=_begin_work)
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        running = list((getattr(pool, "_processes", None) or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in running:
            process.terminate()
        raise
    finally:
        for name, value in before.items():
            os.environ.pop(name, None) if value is None else os.environ.update({name: value})


def _begin_work() -> None:
    """In a worker: Ctrl-C is the parent's to handle, and a worker does not outlive its parent."""
    import multiprocessing

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        parent.join()
        os._exit(1)

    if parent is not None:
        threading.Thread(target=watch, daemon=True).start()


class _WithoutMain(context.SpawnProcess):
    """A spawned process that does not import the caller's script: jobs need nothing of it.

    Ctrl-C is the parent's from its first moment on: a signal that is ignored stays so in what is started.
    """

    @staticmethod
    def _Popen(process):
        main = sys.modules["__main__"]
        sys.modules["__main__"] = types.ModuleType("__main__")
        first = threading.current_thread() is threading.main_thread()  # no other may change what a signal does
        before = signal.signal(signal.SIGINT, signal.SIG_IGN) if first else None
        try:
            return context.SpawnProcess._Popen(process)
        finally:
            sys.modules["__main__"] = main
            if first:
                signal.signal(signal.SIGINT, before)


class _Spawned(context.SpawnContext):
    """Spawning that works from notebooks, from standard input and from scripts without ``if __name__ == ...``."""

    Process = _WithoutMain


@contextmanager
def _cluster(workers: int) -> Iterator[str]:
    """The address of a Dask scheduler of our own."""
    try:
        from distributed import LocalCluster
    except ImportError:
        raise _no_dask("dask") from None
    with tempfile.TemporaryDirectory(prefix="hydrotwin-dask-") as folder:
        quiet = {"dashboard_address": None, "silence_logs": logging.ERROR, "local_directory": folder}
        with LocalCluster(n_workers=workers, threads_per_worker=1, **quiet) as cluster:
            yield f"dask://{cluster.scheduler_address.removeprefix('tcp://')}"


def _no_dask(spec: str) -> DeclarationError:
    return DeclarationError(
        f"executor {spec}: the package 'distributed' is missing. Install it: pip install 'hydrotwin[cluster]'."
    )


@contextmanager
def _dask(spec: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError:
        raise _no_dask(spec) from None
    try:
        client = Client(f"tcp://{spec.removeprefix('dask://')}", timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise DataError(
            f"executor {spec}: no scheduler answers ({str(error).strip() or type(error).__name__}). "
            "Start one with 'dask scheduler', or correct host and port."
        ) from None
    with client:
        _same_versions(client, spec)
        pool = client.get_executor(pure=False, retries=1)
        try:
            yield pool
        finally:
            pool.shutdown(wait=False)


def _same_versions(client, spec: str) -> None:
    """Every worker must compute with what we compute with."""
    if not client.scheduler_info(n_workers=-1)["workers"]:
        raise DataError(f"executor {spec}: its scheduler has no workers. Start some with 'dask worker'.")
    own = versions()
    for worker, theirs in client.run(_versions_there, on_error="return").items():
        if isinstance(theirs, Exception) or theirs != own:
            told = theirs if isinstance(theirs, Mapping) else f"{type(theirs).__name__}: {theirs}"
            raise DataError(f"executor {spec}: worker {worker} has {told}, here is {own}. Install the same there.")


def _versions_there() -> Mapping[str, str]:
    from hydrotwin.work.executor import versions

    return versions()


def versions() -> dict[str, str]:
    """What an answer depends on besides its job."""
    return dict(_versions())


@cache
def _versions() -> Mapping[str, str]:
    from importlib.metadata import PackageNotFoundError, version

    found = {"casadi": ca.__version__}
    for package in ("hydrotwin", "numpy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


# -- jobs --------------------------------------------------------------------------------------------------------------
_one_at_a_time = threading.RLock()


def _alone(function: Callable, job):
    """``function(job)`` while no other thread of this process does a job.

    CasADi builds expressions in one thread at a time only, and a job's limit counts the time of its process.
    """
    with _one_at_a_time:
        return function(job)


def mapped(
    executor: Executor,
    function: Callable,
    jobs: Sequence,
    on_done: Callable[[int, object], None] | None = None,
) -> Iterator:
    """``function(job)`` of every job, in the order of the jobs; ``on_done(index, result)`` as each is finished.

    What has not begun is cancelled when the caller stops early, a job raises, or Ctrl-C is pressed.

    Raises
    ------
    SolveError : a worker died. Anything that ``function`` raises.
    """
    if isinstance(executor, Here):  # each is told before the next begins
        for k, job in enumerate(jobs):
            result = _alone(function, job)
            if on_done:
                on_done(k, result)
            yield result
        return
    futures = [executor.submit(_alone, function, job) for job in jobs]
    index = {future: k for k, future in enumerate(futures)}
    waiting, results, given = set(futures), {}, 0
    try:
        while waiting:
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in sorted(done, key=index.__getitem__):
                results[index[future]] = result = future.result()
                if on_done:
                    on_done(index[future], result)
            while given in results:  # not what ended since: it was not told yet
                yield results.pop(given)
                given += 1
    except BrokenExecutor as error:
        raise SolveError(
            f"executor: a worker process died ({error}). It was killed or ran out of memory. "
            "Try fewer processes or executor='here'."
        ) from None
    finally:
        for future in waiting:
            future.cancel()


@dataclass(frozen=True)
class Starts:
    """An ``initialisation`` that can travel: start functions by the states that are given."""

    functions: Mapping[tuple[str, ...], ca.Function]

    def __call__(self, given: tuple[str, ...]) -> ca.Function:
        found = self.functions.get(tuple(given))
        if found is None:
            known = "; ".join(", ".join(names) or "none" for names in self.functions)
            raise DeclarationError(
                f"start: no start with {', '.join(given) or 'none'} given travels with this model (got: {known}). "
                "Name them in portable(flat, [...])."
            )
        return found


def portable(flat: FlatModel, given_names: Sequence[Sequence[str]] = ()) -> FlatModel:
    """The same model as one that can be pickled, for a worker in another process.

    Its start values are kept for every subset of the measured states that a recording may give (for many measured
    states: none, one, all but one, all), for all states, and for each of ``given_names``.
    """
    if isinstance(flat.initialisation, Starts) and not given_names:
        return flat
    order = [s.name for s in flat.states]
    measured = [s.name for s in flat.states if s.measured_by is not None]
    n = len(measured)
    sizes = range(n + 1) if n <= MANY_MEASURED else sorted({0, 1, n - 1, n})
    wanted = [names for size in sizes for names in combinations(measured, size)]
    wanted += [tuple(order), *(tuple(names) for names in given_names)]
    return replace(flat, initialisation=Starts({names: flat.start_given(names) for names in dict.fromkeys(wanted)}))
