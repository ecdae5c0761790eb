"""The recordings as sensitivities see them: every run with its inputs, its start and what was measured of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import cuts, distinct
from hydrotwin.records.between import settled
from hydrotwin.simulation import prepare
from hydrotwin.simulation.simulate import filled, inputs_of, since_start

from ..bands import given_starts
from ..beginning import estimate_start
from ..problem import unbroken_for
from ..start_states import StartStates


@dataclass(frozen=True, eq=False)
class Run:
    """One recording: time (n,) from its first sample, u (n, nu), y (n, ny), SI, nan where nothing was measured.

    starts : the start states that are given; z their values; noisy : of these, the ones that an output measures.
    edges : (stretches + 1,) samples at which its stretches of time begin and end.
    """

    name: str
    digest: str | None
    time: np.ndarray
    u: np.ndarray
    y: np.ndarray
    starts: StartStates
    z: np.ndarray
    noisy: tuple[str, ...]
    edges: np.ndarray

    def start(self, p: np.ndarray) -> np.ndarray:
        """Start states (nx,) at parameters (np,)."""
        return self.starts(self.u[0], p, self.z)[0]


@dataclass(frozen=True, eq=False)
class Runs:
    """A model and all its runs; ``propagator`` has the sensitivities to ``names`` and to the start states ``noisy``.

    cuts : what was made of recordings with holes, a sentence each.
    """

    flat: FlatModel
    names: tuple[str, ...]
    runs: tuple[Run, ...]
    noisy: tuple[str, ...]
    propagator: object
    cuts: tuple[str, ...] = ()

    @property
    def p(self) -> np.ndarray:
        """Parameters of the model as it is, (np,)."""
        return self.flat.parameter_vector()

    def sensitivities(self, run: Run) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (n, ny) and derivatives (n, ny, k) to the parameters, then the noisy start states. SI.

        Raises Diverged where the nominal run stops.
        """
        x0, by_p, by_z = run.starts(run.u[0], self.p, run.z)
        seeds = np.zeros((len(x0), len(self.names) + len(self.noisy)))
        seeds[:, : len(self.names)] = by_p
        for k, name in enumerate(self.noisy):
            if name in run.noisy:
                seeds[:, len(self.names) + k] = by_z[:, run.starts.names.index(name)]
        y, dy, _, _ = self.propagator.sensitivity(run.time, run.u, self.p, x0, seeds, with_states=False)
        return y, dy


def runs_over(
    model,
    records: Sequence,
    names: Sequence[str],
    stretches: int,
    interpolation: Mapping[str, str] | None = None,
    start: Mapping[str, float] | None = None,
) -> Runs:
    """Runs of a model over recordings, each cut into ``stretches`` equal parts of its time.

    A state starts from ``start``, else from the first sample of the output that measures it, else from the model.
    A recording with holes is the parts between them; behind one it starts as the first samples there tell.

    Raises DataError without a recording, or for a missing input.
    """
    name = getattr(model, "name", "")
    if not len(records):
        raise DataError(f"sensitivity: no recording to run {name} on. Give at least one with its inputs.")
    if stretches < 1:
        raise DeclarationError(f"sensitivity: a recording has at least one stretch (got {stretches}). Give 1 or more.")
    model = settled(model, records, interpolation)
    flat: FlatModel = getattr(model, "flat", model)
    order = [p.name for p in flat.parameters]
    index = np.array([order.index(n) for n in names], dtype=int)
    parts = unbroken_for(flat, distinct(records)[0])
    runs = tuple(_run(flat, record, index, stretches, _begun(flat, record, start or {})) for record in parts)
    noisy = tuple(s.name for s in flat.states if any(s.name in run.noisy for run in runs))
    propagator = prepare(flat, free_parameters=names, free_states=noisy)
    return Runs(flat, tuple(names), runs, noisy, propagator, tuple(cuts(parts)))


def _begun(flat: FlatModel, record, start: Mapping[str, float]) -> Mapping[str, float]:
    """Start states that are given; behind a hole, where a machine is in motion, those that its first part tells."""
    seen = any(s.name in record for s in flat.outputs)
    return estimate_start(flat, record).values if record.in_motion and seen else start


def _run(flat: FlatModel, record, index: np.ndarray, stretches: int, start: Mapping[str, float]) -> Run:
    record = filled(record, flat)
    if len(record.time) < 2 * stretches:
        raise DataError(
            f"{record.name}: {len(record.time)} samples are too few for {stretches} stretches of time. "
            "Give a longer recording, or fewer stretches."
        )
    given, measured = given_starts(flat, record, start)
    starts = StartStates(flat, list(given), index)
    time = since_start(record)
    edges = np.searchsorted(time, np.linspace(time[0], time[-1], stretches + 1)[1:-1])
    y = np.full((len(time), len(flat.outputs)), np.nan)
    for j, signal in enumerate(flat.outputs):
        if signal.name in record.signals:
            y[:, j] = record[signal.name]
    z = np.array([given[n] for n in starts.names])
    edges = np.unique(np.concatenate([[0], edges, [len(time)]])).astype(int)
    return Run(record.name, record.digest, time, inputs_of(flat, record), y, starts, z, tuple(measured), edges)
