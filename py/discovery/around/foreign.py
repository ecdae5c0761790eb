"""around: what is asked of an FMU: which effect sits before its inputs or after its outputs."""

from __future__ import annotations

import dataclasses

import numpy as np

from hydrotwin.export.reader import FmuBlock
from hydrotwin.identification.problem import unbroken_for
from hydrotwin.models.effects import Candidate, candidates
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import Parameter
from hydrotwin.records.between import settled

from ..asked import Asked, Wanted, bounded, free_names
from ..recordings import split
from .surroundings import SurroundedFmu, around_only, ready, sized, surrounded

USUAL_PERIOD, MUCH_SLOWER = 0.01, 5.0  # s, times it


def around(fmu: FmuBlock | SurroundedFmu, wanted: Wanted) -> Asked:
    """What is asked of an FMU: effects stand before its inputs and after its outputs.

    free : globs over the parameters of the FMU to identify along; None: none. Everything else as in `discover`.

    Raises DeclarationError for an FMU without inputs or outputs, DataError for recordings that lack a signal,
    SolveError where the FMU fails, crashes or hangs.
    """
    model = fmu if isinstance(fmu, SurroundedFmu) else surrounded(fmu)
    model = settled(model, wanted.records, wanted.interpolation)
    records, validate = (unbroken_for(model.flat, some) for some in (wanted.records, wanted.validate))
    pieces, said, seconds = ready(model, records, validate, wanted.free)
    model = model if model.additions else sized(model, records)
    seen = {name for record in pieces for name in record.signals}
    period = min(float(np.median(np.diff(r.time))) for r in records)
    fitting = [at_pace(c, period) for c in around_only(model, candidates(model, wanted.effects, wanted.exclude), seen)]
    data = split(model.flat, pieces, validate, wanted.outputs, wanted.noise)
    data = dataclasses.replace(data, findings=(*said, *data.findings))
    names = free_names(model.flat, wanted.free or ())
    note = f"a run of the FMU takes {seconds:.2g} s, a search some hundred of them"
    within = bounded(model, names)
    return Asked(model, within, names, data, tuple(fitting), wanted.initial_states, note)


def at_pace(candidate: Candidate, period: float) -> Candidate:
    """The candidate with times that suit recordings with a sample every ``period`` s.

    The catalogue's times are those of machines sampled every 10 ms; a plant that is sampled every minute has others.
    """
    factor = period / USUAL_PERIOD
    times = {k: p for k, p in declarations(candidate.effect).items() if isinstance(p, Parameter) and p.unit == "s"}
    times = {k: p for k, p in times.items() if p.free}
    if factor <= MUCH_SLOWER or not times:
        return candidate
    slower = {
        k: dataclasses.replace(p, bounds=(p.bounds[0], factor * p.bounds[1]), nominal=factor * (p.nominal or 1.0))
        for k, p in times.items()
    }
    paths = {f"{candidate.name}.{k}" for k in times}
    typical = {n: tuple(factor * v for v in t) if n in paths else t for n, t in candidate.typical.items()}
    probes = tuple({n: factor * v if n in paths else v for n, v in probe.items()} for probe in candidate.probes)
    effect = type(candidate.effect.__name__, (candidate.effect,), slower)
    return dataclasses.replace(candidate, effect=effect, typical=typical, probes=probes)
