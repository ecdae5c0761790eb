"""Responses to first order: what every effect would change in the recordings, along runs that are known already.

In every window a run begins anew, measured states as measured, or it would soon be elsewhere than the machine. An
effect of a usual size changes the rates by df and the outputs by dh there; to first order in them

    d/dt dx = A dx + df,    dy = C dx + dh,    A = df/dx, C = dh/dx along the runs,

so that few runs and their Jacobians answer for every effect. What a least-squares fit of these responses, of those of
the base's parameters and of starts leaves of what the runs left is what an effect promises: in every window by itself,
and in all as one, in which slow effects show. States that an effect brings with it follow the runs, and do not act on
each other's.
Source: L. Ljung, System Identification, 1999, ch. 10 (the gradient of an output error); score tests.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import expm

from hydrotwin.identification.problem import Recording
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.simulation import equations, inputs
from hydrotwin.simulation.columns import by_columns

Response = list[tuple[np.ndarray, np.ndarray]]  # df (n - 1, nx, k), dh (n, ny, k) by stretch

WINDOWS = 4  # of a stretch


@dataclass(frozen=True, eq=False)
class Stretch:
    """Windows of a recording, one after the other, and a run through each.

    time (windows, n + 1), x (windows, n + 1, nx); left (windows, n, ny): what was measured less what the runs say.
    """

    recording: Recording
    time: np.ndarray
    x: np.ndarray
    left: np.ndarray

    @property
    def intervals(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where intervals begin and end (m,), and states in their middle (m, nx)."""
        middle = 0.5 * (self.x[:, 1:] + self.x[:, :-1])
        return self.time[:, :-1].ravel(), self.time[:, 1:].ravel(), middle.reshape(-1, middle.shape[-1])

    @property
    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Where intervals begin (m,), and states there (m, nx)."""
        return self.time[:, :-1].ravel(), self.x[:, :-1].reshape(-1, self.x.shape[-1])


class Promise(NamedTuple):
    """Of what is left: the share that is left with an effect; which of its sets alone explains most, and how large.

    size : of that set, 0 where it explains no more than chance, or only the other way round.
    """

    left: float
    which: int
    size: float


@dataclass(eq=False)
class Responses:
    """A model at values, along stretches of a run of it; free : parameters that a fit would move, too, by path.

    size : (ny,), SI, what a residual counts. plain : the model that effects are added to; None: the one that ran.
    """

    flat: FlatModel
    values: np.ndarray
    free: Sequence[str]
    stretches: Sequence[Stretch]
    size: np.ndarray
    plain: FlatModel | None = None
    _along: list[_Along] = field(default_factory=list)
    _plain: Response = field(default_factory=list)

    def __post_init__(self) -> None:
        functions = _linear(self.flat, [self.flat.index_of(n) for n in self.free])
        unit = np.array([abs(self.values[k]) or 1.0 for k in (self.flat.index_of(n) for n in self.free)])
        self._along = [_along(self.flat, functions, self.values, unit, s) for s in self.stretches]
        shared = {p.name: v for p, v in zip(self.flat.parameters, self.values, strict=True)}
        plain = self.plain or self.flat
        p = plain.parameter_vector({q.name: shared[q.name] for q in plain.parameters})
        self._plain = self._rates(plain, p[None])

    def of(self, flat: FlatModel, sets: np.ndarray) -> Response:
        """The response to an effect that a model has, by k sets of its parameters (k, np).

        The model may lack what the runs have beside it: states that it does not know are not changed by the effect.
        """
        with_it = zip(self._rates(flat, sets), self._plain, strict=True)
        return [(rates - plain, outputs - plainly) for (rates, outputs), (plain, plainly) in with_it]

    def _rates(self, flat: FlatModel, sets: np.ndarray) -> Response:
        """Rates of the states along the runs, 0 of those that a model lacks, and outputs, by sets of its parameters."""
        own, along = ([s.name for s in each.states] for each in (flat, self.flat))
        known = [i for i, name in enumerate(along) if name in own]
        found, parts = [], _apart(flat)
        for stretch in self.stretches:
            part = dataclasses.replace(stretch, x=stretch.x[..., known])
            rates, outputs = _excited(flat, parts, [own.index(along[i]) for i in known], part, sets)
            whole = np.zeros((len(rates), len(along), len(sets)))
            whole[:, known] = rates
            found.append((whole, outputs))
        return found

    def promises(self, effects: Sequence[Response]) -> list[Promise]:
        """What the run and a fit of the base leave, that one with each of the effects leaves less of."""
        sizes = [effect[0][0].shape[-1] for effect in effects]
        groups = [slice(end - k, end) for end, k in zip(np.cumsum(sizes), sizes, strict=True)]
        together = [
            tuple(np.concatenate([effect[i][k] for effect in effects], axis=-1) for k in range(2))
            for i in range(len(self.stretches))
        ]
        both = [self._promises(together, groups, as_one) for as_one in (True, False)]
        return [min(pair, key=lambda one: one.left) for pair in zip(*both, strict=True)]

    def _promises(self, together: Response, groups: Sequence[slice], as_one: bool) -> list[Promise]:
        along = zip(self.stretches, self._along, together, strict=True)
        rows = np.concatenate([self._rows(*each, as_one) for each in along])
        base, others, left = np.split(rows, [len(self.free), rows.shape[1] - 1], axis=1)
        others, left = _without(base, others), _without(base, left)
        return [_promise(others[:, group], left) for group in groups]

    def _rows(self, stretch: Stretch, along: _Along, added, as_one: bool) -> np.ndarray:
        """Rows of the least-squares fit: responses to base parameters and to what is added, what is left; no starts.

        as_one : the windows are one, at whose ends the run jumps, which what it differs by does not.
        """
        count, n, nx = stretch.x.shape[0], stretch.x.shape[1] - 1, stretch.x.shape[2]
        A, G, C, B, D, df, dh = (a.reshape(count, n, *a.shape[1:]) for a in (*vars(along).values(), *added))
        left, jumps = stretch.left, stretch.x[1:, 0] - stretch.x[:-1, -1]
        B, D = np.concatenate([B, df], axis=-1), np.concatenate([D, dh], axis=-1)
        if as_one:
            A, G, C, B, D, left = (a.reshape(1, count * n, *a.shape[2:]) for a in (A, G, C, B, D, left))
        z = np.zeros((len(A), nx, nx + B.shape[-1] + 1))  # starts, parameters and effects, what the jumps add up to
        z[:, :, :nx] = np.eye(nx)
        seen = []
        for k in range(A.shape[1]):
            if as_one and k and k % n == 0:
                z[0, :, -1] -= jumps[k // n - 1]
            y = C[:, k] @ z
            y[..., nx:-1] += D[:, k]
            seen.append(y)
            z = A[:, k] @ z
            z[..., nx:-1] += G[:, k] @ B[:, k]
        rows = np.stack(seen, axis=1)
        rows[..., -1] = left - rows[..., -1]
        used = np.isfinite(self.size) & (self.size > 0)
        rows = (
            np.where(np.isfinite(rows[..., -1:]) & used[:, None], rows, 0.0) / np.where(used, self.size, 1.0)[:, None]
        )
        rows = rows.reshape(len(A), -1, rows.shape[-1])
        return np.concatenate([_without(window[:, :nx], window[:, nx:]) for window in rows])


@dataclass(frozen=True, eq=False)
class _Along:
    """Over every interval A = exp(J h), its integral G (m, nx, nx), and B = df/dp; at its begin C, and D = dh/dp."""

    A: np.ndarray
    G: np.ndarray
    C: np.ndarray
    B: np.ndarray
    D: np.ndarray


def stretch_of(
    recording: Recording, states: np.ndarray, run: Callable, size: np.ndarray, T: float, most: int
) -> Stretch:
    """The part of a recording in which most is left in units of a size (ny,), ``T`` seconds long or more.

    states : (n, nx) at the samples, as measured where that is known; run : ``(part, x0) -> y, x`` through a part of the
    recording. It has no more than so many samples.
    """
    time, most = recording.time, max(most, 2 * WINDOWS)
    stride = max(1, int(np.ceil(np.searchsorted(time - time[0], min(T, time[-1] - time[0])) / most)))
    n = max(min(stride * most, len(time) - 1) // (stride * WINDOWS), 1) * stride
    begins = np.arange(0, len(time) - n, n)
    runs = [run(slice(k, k + n + 1), states[k]) for k in begins]
    left = [recording.y[k : k + n] - y[:-1] for k, (y, _) in zip(begins, runs, strict=True)]
    with np.errstate(divide="ignore", invalid="ignore"):
        much = [np.nan_to_num(np.nansum(np.square(part / size)), posinf=0.0) for part in left]
    gone = np.concatenate([[0.0], np.cumsum(much)])
    count = min(WINDOWS, len(begins))
    chosen = range(first := int(np.argmax(gone[count:] - gone[:-count])), first + count)
    part = [slice(begins[i], begins[i] + n + 1, stride) for i in chosen]
    return Stretch(
        recording,
        np.stack([time[p] for p in part]),
        np.stack([runs[i][1][::stride] for i in chosen]),
        np.stack([left[i][::stride] for i in chosen]),
    )


# -- along a stretch -------------------------------------------------------------------------------------------------
def _linear(flat: FlatModel, columns: Sequence[int]) -> ca.Function:
    """``(t, x, u, p) -> df/dx, df/dp, dh/dx, dh/dp``, dense."""
    arguments = equations.symbols(flat)
    _, x, _, p = arguments
    results = []
    for value in flat.ode(*arguments)[:2]:
        results += [ca.densify(ca.jacobian(value, x)), ca.densify(ca.jacobian(value, p)[:, list(columns)])]
    return ca.Function("linear", arguments, ca.cse(results))


def _along(flat: FlatModel, linear: ca.Function, p: np.ndarray, unit: np.ndarray, s: Stretch) -> _Along:
    begin, end, x = s.intervals
    h, nx, m = end - begin, x.shape[1], len(begin)
    J, B = linear((begin + h / 2)[None, :], x.T, _means(flat, p, s).T, p)[:2]
    C, D = linear(begin[None, :], s.samples[1].T, _behind(flat, p, s).T, p)[2:]
    both = np.zeros((m, 2 * nx, 2 * nx))
    both[:, :nx, :nx], both[:, :nx, nx:] = _by_sample(J, m), np.eye(nx)
    moved = expm(both * h[:, None, None])
    B, C, D = (_by_sample(value, m) for value in (B, C, D))
    return _Along(moved[:, :nx, :nx], moved[:, :nx, nx:], C, B * unit, D * unit)


def _by_sample(value: ca.DM, n: int) -> np.ndarray:
    """(n, rows, columns) of matrices that stand side by side."""
    value = value.full()
    return value.reshape(len(value), n, -1).transpose(1, 0, 2)


def _excited(
    flat: FlatModel, parts: Sequence[Callable], place: Sequence[int], s: Stretch, sets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rates (m, nx, k) of the base's states, outputs (m, ny, k), along a stretch with k sets of parameters.

    parts : of the model, see `_apart`.
    """
    begin, end, between = s.intervals
    middle, means = 0.5 * (begin + end), np.stack(_by_set(_means, flat, s, sets))
    x = np.empty((len(sets), 2, len(begin), len(flat.states)))
    x[:, 0][..., place], x[:, 1][..., place] = s.samples[1], between
    further = [i for i in range(len(flat.states)) if i not in place]
    if further:
        z = _followed(flat, place, further, s, sets, means)
        x[:, 0][..., further], x[:, 1][..., further] = z[:, :-1], 0.5 * (z[:, 1:] + z[:, :-1])
    (rates_of, outputs_of), rates, outputs = parts, [], []
    for (samples, middles), u, v, p in zip(x, means, _by_set(_behind, flat, s, sets), sets, strict=True):
        rates.append(rates_of(middle[None, :], middles.T, u.T, p)[0].T[:, place])
        outputs.append(outputs_of(begin[None, :], samples.T, v.T, p)[0].T)
    return np.stack(rates, axis=-1), np.stack(outputs, axis=-1)


def _apart(flat: FlatModel) -> list[Callable]:
    """``(t, x, u, p)`` to rates, and to outputs."""
    arguments = equations.symbols(flat)
    return [by_columns(ca.Function("part", arguments, [value])) for value in flat.ode(*arguments)[:2]]


def _followed(flat: FlatModel, place, further, s: Stretch, sets: np.ndarray, means: np.ndarray) -> np.ndarray:
    """States that an effect brings along a stretch (k, m + 1, nz): linearly implicit Euler, the others as they are."""
    begin, end, x = s.intervals
    step = _one_step(flat, list(place), list(further)).mapaccum(len(begin))
    first = flat.start_given([flat.states[i].name for i in place])
    z = np.empty((len(sets), len(begin) + 1, len(further)))
    for k, p in enumerate(sets):
        z[k, 0] = first(means[k, 0], p, s.x[0, 0]).full().ravel()[further]
        known = np.column_stack([0.5 * (begin + end), end - begin, x, means[k]]).T
        z[k, 1:] = step(z[k, 0], known, np.broadcast_to(p[:, None], (len(p), len(begin)))).full().T
    return z


def _one_step(flat: FlatModel, place: list[int], further: list[int]) -> ca.Function:
    """``(z, [t; h; x; u], p) -> z`` an interval later."""
    t, x, u, p = equations.symbols(flat)
    h = ca.SX.sym("h")
    rate = flat.ode(t, x, u, p)[0][further]
    change = ca.solve(ca.SX.eye(len(further)) - h * ca.densify(ca.jacobian(rate, x[further])), h * rate)
    known, z = ca.vertcat(t, h, x[place], u), x[further]
    return ca.Function("step", [z, known, p], [ca.densify(z + change)])


def _by_set(inputs_of: Callable, flat: FlatModel, s: Stretch, sets: np.ndarray) -> list[np.ndarray]:
    """Inputs along a stretch for every set of parameters, which differ by delays alone."""
    late = [tuple(_late(flat, p)) for p in sets]
    found = {key: inputs_of(flat, p, s) for key, p in dict(zip(late, sets, strict=True)).items()}
    return [found[key] for key in late]


def _means(flat: FlatModel, p: np.ndarray, s: Stretch) -> np.ndarray:
    """Means of the inputs over every interval of a stretch (m, nu), late ones as they arrive."""
    begin, end, _ = s.intervals
    found = np.empty((len(begin), len(flat.inputs)))
    for j, (signal, late) in enumerate(zip(flat.inputs, _late(flat, p), strict=True)):
        time, u = s.recording.time, s.recording.u[:, j]
        found[:, j] = inputs.mean_over(time, u, begin - late, end - late, not signal.held)
    return found


def _behind(flat: FlatModel, p: np.ndarray, s: Stretch) -> np.ndarray:
    """The inputs (m, nu) that the outputs see."""
    time, u = s.recording.time, s.recording.u
    begin, found = s.samples[0], np.empty((s.time[:, :-1].size, len(flat.inputs)))
    for j, (signal, late) in enumerate(zip(flat.inputs, _late(flat, p), strict=True)):
        found[:, j] = inputs.at(time, u[:, j], begin - late, not signal.held, "right")
    return found


def _late(flat: FlatModel, p: np.ndarray) -> list[float]:
    return [0.0 if k is None else float(p[k]) for k in equations.delays(flat)]


# -- least squares ---------------------------------------------------------------------------------------------------
def _without(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """What a least-squares fit of columns leaves of rows; columns that say nothing, or no number, are left out."""
    sizes = np.linalg.norm(columns, axis=0)
    used = np.isfinite(sizes) & (sizes > 0)
    if not used.any():
        return rows
    q, r = np.linalg.qr(columns[:, used] / sizes[used])
    q = q[:, np.abs(np.diagonal(r)) > 1e-9]
    return rows - q @ (q.T @ rows)


def _promise(columns: np.ndarray, left: np.ndarray) -> Promise:
    """Of rows (n, k) and (n, 1). A size is told where it explains more than a parameter costs (Schwarz 1978)."""
    whole, along = float(np.sum(left**2)), (columns.T @ left)[:, 0]
    if not whole > 0:
        return Promise(1.0, 0, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = along / np.sum(columns**2, axis=0)
    alone = np.nan_to_num(sizes * along, nan=0.0, posinf=0.0, neginf=0.0) * len(left) / whole
    which = int(np.argmax(alone))
    surely = alone[which] > np.log(len(left)) and sizes[which] > 0
    together = float(np.sum(_without(columns, left) ** 2)) / whole
    return Promise(together, which, float(sizes[which]) if surely else 0.0)
