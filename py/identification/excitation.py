"""What recordings can say of a model's parameters, before anything is fitted: from the sensitivities at its start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.records import cuts
from hydrotwin.simulation import prepare

from .descent import Task, whole_runs
from .identifiability import identifiability
from .least_squares import Minimum
from .loss import Loss
from .noise import output_noise
from .noise import weights as by_noise
from .problem import FreeParameters, free_parameters, recordings, unbroken_for

WELL, BARELY = 0.05, 0.5  # of the value (or of its range): known to so much or better is well, beyond barely is not


@dataclass(frozen=True)
class Excited:
    """How well recordings excite a parameter: one sigma [SI] at the model's start value, infinite where nothing shows.

    verdict : "well", "weakly" or "not".
    """

    name: str
    unit: str
    value: float
    sigma: float
    verdict: str

    @property
    def said(self) -> str:
        """The sigma for a person: in % of the value where it has one."""
        if not np.isfinite(self.sigma):
            return "unknown"
        return f"{100 * self.sigma / abs(self.value):.2g} %" if self.value else f"{self.sigma:.2g}"


def excitation(
    model, records: Sequence, free: Sequence[str] | None = None
) -> tuple[tuple[Excited, ...], tuple[str, ...]]:
    """How well each free parameter could be identified, and what cannot be told apart, in sentences.

    Linear, at the values the model has now, with the noise that the sensors show: a preview, not a fit.
    Source: Cramer-Rao bound, S. Kay, Fundamentals of Statistical Signal Processing (1993), ch. 3.

    Raises SolveError where the model diverges over every recording.
    """
    flat = getattr(model, "flat", model)
    parameters = free_parameters(flat, free)
    if not parameters.names:
        return (), ("the model declares no parameter free. Give --free.",)
    records = unbroken_for(flat, records)
    train = recordings(flat, records, None, "record")
    noise = output_noise(flat, train, None)
    states = [s.name for s in flat.states]
    propagator = prepare(flat, free_parameters=parameters.names, free_states=states)
    loss = Loss("linear", 1.0)
    task = Task(flat, parameters, propagator, train, by_noise(noise), loss, "auto", 1, _silent, noise)
    shooting, z = whole_runs(task)
    q = parameters.scaled(parameters.start)
    at = shooting.linearise(q, z)
    if at.diverged.all():
        raise SolveError(f"inspect: {flat.name} diverges over every recording at its start values.")
    start = Minimum(q, z, at, 0, True, "")
    rows = [_row(parameters, j, s) for j, s in enumerate(sigmas(start, parameters))]
    held = np.zeros(len(rows), dtype=bool)
    findings = identifiability(flat, parameters, start.information(), {}, held)
    said = [*cuts(records), *(f.sentence.removeprefix("identify: ") for f in findings)]
    if at.diverged.any():
        lost = [r.name for r, d in zip(train, at.diverged, strict=True) if d]
        said.insert(0, f"the model diverges over {', '.join(lost)} at its start values: not counted here.")
    return tuple(rows), tuple(said)


def _silent(*_) -> None:
    pass


def _row(free: FreeParameters, j: int, sigma: float) -> Excited:
    value = float(free.start[j])
    size = abs(value) if free.logarithmic[j] else float(free.unit[j] * free.sizes[j])
    relative = sigma / size if size else np.inf
    verdict = "well" if relative <= WELL else "weakly" if relative <= BARELY else "not"
    return Excited(free.names[j], free.units[j], value, sigma, verdict)


def sigmas(found: Minimum, free: FreeParameters) -> list[float]:
    """Standard deviations of the free parameters, SI, infinite where nothing shows or a run diverged."""
    information = found.information()
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    seen = size > 0
    if not np.isfinite(information).all() or not seen.any():
        return [np.inf] * len(size)
    scaled = information[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
    sigma = np.full(len(size), np.inf)
    sigma[seen] = np.sqrt(np.maximum(np.diag(np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)), 0.0)) / size[seen]
    return (sigma * np.abs(free.slope(found.q))).tolist()
