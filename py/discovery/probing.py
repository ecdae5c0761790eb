"""Probes: candidates without a useful derivative at neutral (limits, thresholds), run at finite amplitudes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import Input, Port
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.model import Model
from hydrotwin.simulation import prepare

from .refit import Question, Refitted, likelihood, pooled_rmse
from .screen import Screen, Screened

APART = 1e6  # s between recordings that are seen as one


def amplitudes(candidate: Candidate, seen: Mapping[str, np.ndarray] | None) -> list[dict[str, float]]:
    """Finite amplitudes of a candidate, by path: at quantiles of what its part saw where the effect can say so."""
    own = []
    if seen is not None:
        proposed = candidate.effect.probes_for(seen)
        own = [{f"{candidate.name}.{k}": float(v) for k, v in probe.items()} for probe in proposed]
        own = [{n: v for n, v in probe.items() if n in candidate.free} for probe in own]
    return own or [dict(p) for p in candidate.probes]


def seen_by_parts(model: Model, screen: Screen, wanted: Sequence[Candidate]) -> dict[str, dict[str, np.ndarray]]:
    """What the parts of candidates see along the present fit: their inputs and ports, by label; ``model`` has them."""
    paths: dict[str, dict[str, str]] = {}
    for c in wanted:
        own: dict[str, str] = {}
        for name, declared in declarations(type(c.effect.at(c.site)) if not c.site.frees else c.effect).items():
            if isinstance(declared, Input):
                own[name] = f"{c.name}.{name}"
            elif isinstance(declared, Port):
                for letter, _ in (declared.potential, declared.flow):
                    own[f"{name}.{letter}"] = f"{c.name}.{name}.{letter}"
        paths[c.label] = own
    flat_paths = [p for own in paths.values() for p in own.values()]
    if not flat_paths:
        return {}
    observe = model.observe(flat_paths)
    p = screen.free.vector(screen.free.scaled(screen.free.start))
    values, times, begin = [], [], 0.0
    for recording, x in zip(screen.question.fit, screen.trajectories(), strict=True):
        t = recording.time
        values.append(observe(t[None, :], x.T, recording.u.T, p).full().T)
        times.append(t - t[0] + begin)
        begin = times[-1][-1] + APART
    table = dict(zip(flat_paths, np.concatenate(values).T, strict=True)) | {"time": np.concatenate(times)}
    return {
        label: {"time": table["time"], **{k: table[path] for k, path in own.items()}} for label, own in paths.items()
    }


def best_amplitude(screen: Screen, by_derivative: Screened, job: ProbeJob, runs: Sequence) -> Screened:
    """A candidate judged by the best of its runs, or by its derivative where that says more."""
    kept, visible = by_derivative, by_derivative.visible
    before = screen.weighted(job.fitted.residuals_fit)
    for values, residuals in zip(job.amplitudes, runs, strict=True):
        if residuals is not None:
            tried = screen.by_amplitude(by_derivative.candidate, values, screen.weighted(residuals) - before)
            visible = max(visible, tried.visible)
            kept = tried if tried.gain > kept.gain else kept
    return dataclasses.replace(kept, visible=visible)


@dataclass(frozen=True, eq=False)
class ProbeJob:
    """One structure run as it is, with one effect at several finite amplitudes."""

    flat: FlatModel
    question: Question
    fitted: Refitted
    amplitudes: tuple[Mapping[str, float], ...]
    label: str = ""


def probe(job: ProbeJob) -> list[tuple[np.ndarray, ...] | None]:
    """Residuals (n, ny) of the fit recordings at every amplitude, SI; None where a run diverges."""
    propagator = prepare(job.flat, step=job.question.step, few_runs=True)
    found = []
    for amplitude in job.amplitudes:
        try:
            found.append(tuple(_residuals(job, propagator, amplitude)))
        except SolveError:
            found.append(None)
    return found


def cost_of(ran: Sequence[np.ndarray] | None, q: Question) -> float:
    """L of a run's residuals (n, ny) per recording, SI; infinite where it diverged."""
    return np.inf if ran is None else likelihood(pooled_rmse(ran), q)


def _residuals(job: ProbeJob, propagator, amplitude: Mapping[str, float]):
    flat = job.flat
    p = flat.parameter_vector({**job.fitted.values, **amplitude})
    for recording, states in zip(job.question.fit, job.fitted.states, strict=True):
        names = tuple(s.name for s in flat.states if s.name in states)
        x0 = flat.start_given(names)(recording.u[0], p, [states[n] for n in names]).full().ravel()
        y, _ = propagator.run(recording.time, recording.u, p, x0)
        yield y - recording.y
