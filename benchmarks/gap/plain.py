"""The plain baseline: every candidate added to the plain model alone, one `identify` from the shipped start, best BIC.

    BIC = sum over fit recordings, samples, outputs of (residual/noise)^2 + k ln n

Nothing is screened, nothing follows from anything else. Fits run one after the other in a process of their own, which
is ended where one takes too long: it counts as not reached. They are kept on disk, and not made again.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .score import Answer, Named

LIMIT = 120.0  # s, of one fit: what takes longer is not reached
BASE_LIMIT = 900.0  # s, of the base, without which there is nothing to compare with
BEGIN = 60.0  # s more for the first fit of a process, which loads everything
WITHIN = 10.0  # of the best BIC: what is told together with it (Kass and Raftery: very strong evidence)
BASE = "base"  # the fit without any candidate
NOT_REACHED = "not reached within the limit"


@dataclass(frozen=True)
class Task:
    """What is asked: a model as `hydrotwin.load` takes it, values of it that differ, recordings, globs of candidates.

    effects : as for `hydrotwin.models.effects.candidates`; None for all.
    """

    model: str
    values: Mapping[str, float]
    fit: tuple
    held_out: tuple
    effects: tuple[str, ...] | None = None
    limit: float = LIMIT


@dataclass(frozen=True)
class PlainFit:
    """One structure fitted, or why it is not.

    effect, site : of the candidate, "" of the base. start : values of its parameters at the start, by path.
    squares : sum over the fit recordings, by output, SI. samples : of all outputs. parameters : how many were free.
    noise : that `identify` found in the recordings. rmse : held out. Both by output, SI.
    """

    label: str
    effect: str = ""
    site: str = ""
    start: Mapping[str, float] = field(default_factory=dict)
    squares: Mapping[str, float] = field(default_factory=dict)
    samples: int = 0
    parameters: int = 0
    noise: Mapping[str, float] = field(default_factory=dict)
    rmse: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    failed: str = ""

    def bic(self, noise: Mapping[str, float]) -> float:
        """In units of that noise, which is the same for all."""
        chi2 = sum(squares / noise[name] ** 2 for name, squares in self.squares.items())
        return chi2 + self.parameters * float(np.log(self.samples))


def middle(typical: tuple[float, float]) -> float:
    """Of a usual range: geometric where it is positive."""
    low, high = typical
    return float(np.sqrt(low * high)) if low > 0 else 0.5 * (low + high)


def plain(made, memory: Path | None = None, effects: Sequence[str] | None = None, limit: float = LIMIT) -> Answer:
    """The plain baseline on a case of the benchmark. memory: a folder for its fits."""
    began = time.perf_counter()
    task = Task(made.spec, dict(made.case.settings), made.fit, made.held_out, effects and tuple(effects), limit)
    return answer_of(fitted(task, memory), time.perf_counter() - began)


def answer_of(fits: Sequence[PlainFit], waited: float = 0.0) -> Answer:
    """The best of the fits, and what is within `WITHIN` of it; seconds: those of all fits, whenever they were made."""
    base = next((f for f in fits if f.label == BASE), None)
    if base is None or base.failed:
        raise RuntimeError(f"plain: the base model has no fit ({base.failed if base else 'none was made'}).")
    done = sorted((f for f in fits if not f.failed), key=lambda f: f.bic(base.noise))
    scores = np.array([f.bic(base.noise) for f in done])
    weights = np.exp(-0.5 * (scores - scores[0]))
    notes = {
        "waited": waited,
        "bic": {f.label: float(s) for f, s in zip(done, scores, strict=True)},
        "chi2_per_sample": {f.label: f.bic(base.noise) / f.samples for f in done[:10]},
        "not_reached": {f.label: f.failed for f in fits if f.failed},
        "candidates": len(fits) - 1,
    }
    spent, best = sum(f.seconds for f in fits), done[0]
    if best is base:
        return Answer("none", (), base.rmse, base.rmse, spent, notes)
    members = [
        (f.effect, f.site) for f, s in zip(done, scores, strict=True) if s - scores[0] < WITHIN and f is not base
    ]
    own = tuple((name, best.values[name], np.nan, np.nan) for name in best.start)
    named = Named(best.effect, best.site, tuple(members), float(1 / weights.sum()), own)
    return Answer("class" if len(members) > 1 else "named", (named,), base.rmse, best.rmse, spent, notes)


def fitted(task: Task, memory: Path | None = None) -> list[PlainFit]:
    """Every fit of a task, base first; those that the folder ``memory`` holds are not made again."""
    file = memory / f"{fingerprint(task)}.jsonl" if memory else None
    known, fits, work = {f.label: f for f in _kept(file)}, [], _Work(task)
    try:
        for label, start in structures(task).items():
            fit = known.get(label)
            if fit is None or fit.start != start or (fit.failed == NOT_REACHED and fit.seconds < task.limit):
                fit = work.fitted(label, start)
                _keep(fit, file)
            fits.append(fit)
    finally:
        work.end()
    return fits


def fingerprint(task: Task) -> str:
    """Of what fits depend on: recordings, model, sources of parts, laws and effects; not of how they are fitted."""
    from hydrotwin import models

    seen = hashlib.sha256(json.dumps([Path(task.model).name, dict(task.values)], sort_keys=True).encode())
    for record in (*task.fit, *task.held_out):
        for values in (record.time, *(record[name] for name in record)):
            seen.update(np.ascontiguousarray(values, dtype=float).tobytes())
    user = Path(task.model.rpartition(":")[0])
    for source in [*sorted(Path(models.__file__).parent.rglob("*.py")), *([user] if user.suffix == ".py" else [])]:
        seen.update(source.read_bytes())
    return seen.hexdigest()[:16]


def structures(task: Task) -> dict[str, dict[str, float]]:
    """The start of every structure that is fitted, by its label."""
    return {BASE: {}, **{c.label: starting(c) for c in _candidates(task)}}


def starting(candidate) -> dict[str, float]:
    """Values of a candidate's parameters in the middle of their usual ranges; as they are where none is known."""
    usual = candidate.typical
    return {path: middle(usual[path]) if path in usual else candidate.neutral[path] for path in candidate.free}


class _Work:
    """A process that fits, replaced where it had to be ended."""

    def __init__(self, task: Task):
        self.task, self.pool = task, None

    def fitted(self, label: str, start: Mapping[str, float]) -> PlainFit:
        fresh = self.pool is None
        if fresh:
            context = multiprocessing.get_context("spawn")
            self.pool = ProcessPoolExecutor(1, mp_context=context, initializer=_begin, initargs=(self.task,))
        limit = max(self.task.limit, BASE_LIMIT) if label == BASE else self.task.limit
        began = time.perf_counter()
        try:
            return self.pool.submit(_fitted, label).result(limit + (BEGIN if fresh else 0.0))
        except TimeoutError:
            why = NOT_REACHED
        except BrokenProcessPool:
            why = "its process ended"
        self.end()
        effect, _, site = label.partition(" at ")
        return PlainFit(label, effect, site, start, seconds=time.perf_counter() - began, failed=why)

    def end(self) -> None:
        if self.pool is not None:
            for process in list((self.pool._processes or {}).values()):
                process.kill()
            self.pool.shutdown(wait=True, cancel_futures=True)
            self.pool = None


def _kept(file: Path | None) -> list[PlainFit]:
    """The fits of a file; a last line that was cut off is passed over."""
    kept = []
    for line in file.read_text(encoding="utf-8").splitlines() if file and file.exists() else ():
        try:
            kept.append(PlainFit(**json.loads(line)))
        except (json.JSONDecodeError, TypeError):
            continue
    return kept


def _keep(fit: PlainFit, file: Path | None) -> None:
    if file:
        file.parent.mkdir(parents=True, exist_ok=True)
        with open(file, "a", encoding="utf-8") as stream:
            stream.write(json.dumps(vars(fit)) + "\n")


def _model(task: Task):
    import hydrotwin

    model = hydrotwin.load(task.model)
    return model.with_parameters(dict(task.values)) if task.values else model


def _candidates(task: Task):
    from hydrotwin.models.effects import candidates

    return candidates(_model(task), task.effects)


def _begin(task: Task) -> None:
    """In the process that fits."""
    global _HERE
    _HERE = (task, _model(task), {c.label: c for c in _candidates(task)})


def _fitted(label: str) -> PlainFit:
    """One structure from its start; whatever goes wrong is its own."""
    task, model, known = _HERE
    candidate, began = known.get(label), time.perf_counter()
    try:
        found = _identified(task, model, candidate)
    except Exception as error:
        found = {"failed": f"{type(error).__name__}: {error}"}
    own = dict(effect=candidate.id, site=candidate.site.name, start=starting(candidate)) if candidate else {}
    return PlainFit(label, seconds=time.perf_counter() - began, **own, **found)


def _identified(task: Task, model, candidate) -> dict:
    from hydrotwin.identification import identify

    free, start = [p.name for p in model.flat.parameters if p.free], {}
    if candidate:
        model, start = model.plus([candidate.addition]), starting(candidate)
        free = list(dict.fromkeys([*free, *candidate.free]))
    fit = identify(model, task.fit, free=free, validate=task.held_out, start=start, starts=1, threads=1)
    train = [r for r in fit.residuals if r.role == "train"]
    outputs = dict.fromkeys(r.output for r in train)
    return {
        "squares": {o: float(sum(r.samples * r.rmse**2 for r in train if r.output == o)) for o in outputs},
        "samples": int(sum(r.samples for r in train)),
        "parameters": len(free),
        "noise": {name: float(sigma) for name, sigma in fit.noise.items()},
        "rmse": {name: float(value) for name, value in fit.rmse.get("validate", {}).items()},
        "values": {name: float(value) for name, value in fit.values.items()},
    }
