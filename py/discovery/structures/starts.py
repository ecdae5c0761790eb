"""Starts: the values at which an effect enters a fit, usual ones of the catalogue or of what its part would see."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from hydrotwin.identification.problem import Recording
from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import Input, Port
from hydrotwin.models.language.model import Model

APART = 1e6  # s between recordings that are seen as one
NEARLY = 0.1  # of an effect's usual size, at which it joins a structure that does better without it
MOST = 16  # starts of one effect: each costs a run


def usual(candidate: Candidate, seen: Mapping[str, np.ndarray] | None = None) -> list[dict[str, float]]:
    """Values by path: from what its part sees, else the middle of the usual ranges; then the effect's own probes."""
    own = []
    if seen is not None:
        proposed = candidate.effect.probes_for(seen)
        own = [{f"{candidate.name}.{k}": float(v) for k, v in probe.items()} for probe in proposed]
        own = [{n: v for n, v in probe.items() if n in candidate.free} for probe in own]
    else:
        low = [candidate.typical.get(n, (0.0, 0.0))[0] for n in candidate.free]
        if low and min(low) > 0 and not candidate.site.frees:
            own = [{n: float(np.sqrt(np.prod(candidate.typical[n]))) for n in candidate.free}]
    found = [{**candidate.neutral, **start} for start in (*own, *candidate.probes)]
    return [start for i, start in enumerate(found) if start not in found[:i]][:MOST]


def looks(candidate: Candidate) -> bool:
    """Whether it proposes its values from what its part sees."""
    return hasattr(candidate.effect, "probes_for")


def seen_by(
    candidate: Candidate,
    model: Model,
    recordings: Sequence[Recording],
    states: Sequence[str],
    runs: Sequence[np.ndarray],
    values: Mapping[str, float],
) -> dict[str, np.ndarray]:
    """What the part of a candidate sees, (n,) by name of its inputs and ports: ``model`` holds it, at neutral values.

    runs : trajectories (n, nx) of the ``states`` of the model without it, by recording; values : of its parameters, by
    path.
    """
    paths = _paths(candidate)
    flat, p = model.flat, model.flat.parameter_vector({**values, **candidate.neutral})
    observe = model.observe(list(paths.values()))
    table, times, begin = [], [], 0.0
    for recording, known in zip(recordings, runs, strict=True):
        u, own = recording.u, [s.name for s in flat.states]
        first = flat.start_given(())(u[0], p, []).full().ravel()
        x = np.tile(first, (len(recording.time), 1))
        for j, name in enumerate(own):
            if name in states:
                x[:, j] = known[:, states.index(name)]
        table.append(observe(recording.time[None, :], x.T, u.T, p).full().T)
        times.append(recording.time - recording.time[0] + begin)
        begin = times[-1][-1] + APART
    columns = np.concatenate(table).T
    return {"time": np.concatenate(times), **dict(zip(paths, columns, strict=True))}


def _paths(candidate: Candidate) -> dict[str, str]:
    """Paths of the inputs and of what stands at the ports of a candidate's part, by their names in the part."""
    found = {}
    for name, declared in declarations(type(candidate.effect.at(candidate.site))).items():
        if isinstance(declared, Input):
            found[name] = f"{candidate.name}.{name}"
        elif isinstance(declared, Port):
            for letter, _ in (declared.potential, declared.flow):
                found[f"{name}.{letter}"] = f"{candidate.name}.{name}.{letter}"
    return found


def different(starts: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    """Where windows led to at last, the user's start, and where they led to first: one alone may lead on."""
    chosen = [*starts[:1], starts[-1], *starts[1:-1][:1]]
    return [start for i, start in enumerate(chosen) if start not in chosen[:i]]


def small(candidate: Candidate, start: Mapping[str, float]) -> dict[str, float]:
    """An effect at a tenth of a size."""
    return sized(candidate, start, NEARLY)


def sized(candidate: Candidate, start: Mapping[str, float], part: float) -> dict[str, float]:
    """An effect at a part of a size: what is nothing where it is absent, or of the model, goes that part of the way.

    What is far away where it is absent, such as a limit, and what says how an effect acts are as in ``start``.
    """
    grows = [n for n in candidate.free if candidate.site.frees or candidate.neutral[n] == 0]
    return {**start, **{n: candidate.neutral[n] + part * (start[n] - candidate.neutral[n]) for n in grows}}


def usually(candidate: Candidate, start: Mapping[str, float]) -> dict[str, float]:
    """A start of a parameter of the model that goes no further from its value than usual: no mass is negative.

    How large other effects are depends on the machine, and usual sizes may be far too small for it.
    """
    if not candidate.site.frees:
        return dict(start)
    away = {n: (*candidate.typical[n], candidate.neutral[n]) for n in candidate.typical if n in start}
    return {**start, **{n: float(np.clip(start[n], min(values), max(values))) for n, values in away.items()}}


def compatible(members: Sequence[Candidate]) -> bool:
    """Whether effects may stand together: none is a finer form of another, or the same parameter."""
    pairs = itertools.permutations(members, 2)
    return not any(a.refines(b) or (a.site.frees and set(a.free) & set(b.free)) for a, b in pairs)


def diagonal(each: Sequence[Sequence[dict]]) -> Iterator[tuple[dict, ...]]:
    """All combinations, those of first choices first."""
    ranked = itertools.product(*(range(len(starts)) for starts in each))
    for choice in sorted(ranked, key=sum):
        yield tuple(starts[i] for starts, i in zip(each, choice, strict=True))
