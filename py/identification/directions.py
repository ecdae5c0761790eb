"""The directions in which a minimum of free runs may be left: parameters, starts, and what is taken for granted.

    others : every input half a sample later, every constant load larger by its nominal, every output offset by its own

Each adds one column to the sensitivities, from one run; a linear step along some of them says what they would explain.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible
from hydrotwin.simulation import prepare
from hydrotwin.simulation.inputs import as_seen

from .descent import Task, whole_runs
from .least_squares import Minimum
from .uncertainty import without_starts


@dataclass(frozen=True, eq=False)
class Step:
    """A linear step: gain in the sum of squares, step in q and along the ``others``, and the ``level`` of what it
    leaves: the variance of a sample, noise at least, times how many neighbours say the same thing."""

    gain: float
    q: np.ndarray
    others: np.ndarray
    level: float


@dataclass(frozen=True, eq=False)
class Seen:
    """A minimum in directions: per recording residuals (m,), d/dq (m, np), start columns (m, nz), others (m, k):
    every input half a sample later, every load a nominal larger, every output offset by its nominal."""

    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]
    floor: float  # of the sum of squares that is noise
    outputs: int  # that are measured: values of one sample

    def step(self, others: Sequence[int] = ()) -> Step:
        """The linear step in q, in the starts and along the ``others`` that leaves least."""
        bare = [without_starts(np.hstack([r[:, None], J, D[:, others], Z]), 1 + J.shape[1] + len(others))
                for r, J, Z, D in self.rows]  # fmt: skip
        whole = np.vstack(bare)
        size = np.linalg.norm(whole[:, 1:], axis=0)
        size = np.where(size > 0, size, 1.0)
        step = -np.linalg.lstsq(whole[:, 1:] / size, whole[:, 0], rcond=1e-9)[0] / size
        left = whole[:, 0] + whole[:, 1:] @ step
        before = sum(float(r @ r) for r, *_ in self.rows)
        energy, lag = float(left @ left), self.outputs
        rho = np.clip(float(left[:-lag] @ left[lag:]) / energy, 0.0, 0.97) if energy > 0 else 0.0
        level = max(energy, self.floor) / max(len(left), 1) * (1 + rho) / (1 - rho)
        shared = self.rows[0][1].shape[1]
        return Step(before - energy, step[:shared], step[shared:], level)

    @property
    def excess(self) -> float:
        """The sum of squares beyond the noise."""
        return max(sum(float(r @ r) for r, *_ in self.rows) - self.floor, np.finfo(float).tiny)


def seen_from(task: Task, found: Minimum, inputs: bool = False) -> Seen:
    """The directions of a minimum. Raises SolveError where a run diverges."""
    shooting, _ = whole_runs(task)
    late = [with_inputs(task, {s.name: {"shift": 0.5 * period_of(task)}}) if inputs else None for s in task.flat.inputs]
    others = [one and whole_runs(one)[0] for one in (*late, *(loaded(task, name) for name in loads_of(task)))]
    rows, shared = [], len(found.q)
    for i in range(len(task.recordings)):
        row, now = shooting.sensitivities(i, found.q, found.z[i]), shooting.residuals(i, found.q, found.z[i])
        moved = [one.residuals(i, found.q, found.z[i]) if one else now for one in others]
        if row is None or any(m is None for m in moved):
            raise SolveError("a run diverges")
        r, J = task.loss.linearised(*row[:2])
        here = np.isfinite(task.recordings[i].y) & (task.weights > 0)
        offsets = np.eye(len(task.weights)) * task.weights * [abs(s.nominal) for s in task.flat.outputs]
        moved += [now - offset for offset in offsets]
        rows.append((r, J[:, :shared], J[:, shared:], np.column_stack([(m - now)[here] for m in moved])))
    counts = np.sum([np.isfinite(r.y).sum(axis=0) for r in task.recordings], axis=0)
    used = task.weights > 0
    floor = float(counts[used] @ (task.weights[used] * task.noise[used]) ** 2)
    return Seen(rows, floor, max(int((counts[used] > 0).sum()), 1))


def loads_of(task: Task) -> list[str]:
    """Parameters that are held and act as a constant force or torque on a rate, whatever the state."""
    flat = task.flat
    if flat.black_box:
        return []
    t, x, u, p = (ca.SX.sym(n, flat.ode.size1_in(i)) for i, n in enumerate("txup"))
    slope, moving = ca.jacobian(flat.ode(t, x, u, p)[0], p), ca.vertcat(t, x, u)
    held = [k for k, q in enumerate(flat.parameters) if q.name not in task.free.names]
    held = [k for k in held if any(compatible(flat.parameters[k].unit, unit) for unit in ("N", "N.m"))]
    constant = [k for k in held if slope[:, k].nnz() and not ca.depends_on(ca.densify(slope[:, k]), moving)]
    return [flat.parameters[k].name for k in constant]


def loaded(task: Task, name: str) -> Task:
    """The task with a load that is larger by its nominal value."""
    values, k = task.free.all_values.copy(), task.flat.index_of(name)
    values[k] += abs(task.flat.parameters[k].nominal)
    return dataclasses.replace(task, free=dataclasses.replace(task.free, all_values=values))


def with_inputs(task: Task, changes: Mapping[str, Mapping]) -> Task:
    """The task whose inputs do something else; what is recorded is moved here, so that nothing below has to."""
    if not changes:
        return task
    flat = task.flat.with_inputs({n: {k: v for k, v in c.items() if k != "shift"} for n, c in changes.items()})
    recordings = tuple(dataclasses.replace(r, u=_columns(task.flat.inputs, changes, r)) for r in task.recordings)
    task = dataclasses.replace(task, flat=flat, recordings=recordings)
    kinds = any("interpolation" in c for c in changes.values())
    return dataclasses.replace(task, propagator=propagator_of(task)) if kinds else task


def _columns(signals: Sequence[Signal], changes: Mapping[str, Mapping], recording) -> np.ndarray:
    """Inputs (n, nu) with these changes; the others are moved already, and what is smooth is bent already."""
    columns = recording.u.copy()
    for j, s in enumerate(signals):
        if s.name in changes:
            kind = changes[s.name].get("interpolation", "hold" if s.held else "linear")
            seen = dataclasses.replace(s, interpolation=kind, shift=changes[s.name]["shift"])
            columns[:, j] = as_seen(seen, recording.time, columns[:, j])
    return columns


def propagator_of(task: Task):
    """What runs the task with every start free, by the step and method that were asked for."""
    states = [s.name for s in task.flat.states]
    step, method = getattr(task.propagator, "asked", (task.propagator.step, "auto"))
    return prepare(task.flat, free_parameters=task.free.names, free_states=states, step=step, method=method)


def period_of(task: Task) -> float:
    return float(np.median(np.concatenate([np.diff(r.time) for r in task.recordings])))
