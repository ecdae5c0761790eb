"""The same walk as ``driver.c`` on the CasADi virtual machine: for machines without a C compiler."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import FlatModel

from . import equations, inputs
from .equations import Directions
from .inputs import Substeps

DONE, STATE, OUTPUT, GAVE_UP, NO_MEMORY = 0, 1, 2, 3, 4  # status codes of driver.c
CHUNK = 100  # substeps per call of the virtual machine


class VirtualMachine:
    """Runs one model with CasADi's interpreter: the answers of the compiled library, ten times slower.

    Threads may share it, but do not gain from it: the interpreter lock is held.
    """

    def __init__(self, flat: FlatModel, to: Directions, implicit: bool):
        self._flat, self._to, self._implicit = flat, to, implicit
        self._linear = [s.interpolation == "linear" for s in flat.inputs]
        self._delays = equations.delays(flat)
        self._output = equations.output(flat)
        self._substep = equations.implicit_substep(flat) if implicit else equations.rk4_substep(flat)

    def propagate(self, time, u, p, step, x0, restart=None):
        """``(status, where, y, x)`` as the C driver's ``propagate``; where: time and last finite state of a stop."""
        cut = self._cut(time, u, p, step)
        try:
            after = self._walk(cut, x0, p) if restart is None else self._walk_each(cut, restart, p)
        except RuntimeError:  # the integrator inside gave up
            return GAVE_UP, np.array([time[0], *x0]), None, None
        status, where = _first_stop(cut, after, x0, restart)
        if status:
            return status, where, None, None
        x = np.vstack([x0, after[cut.last]])
        y = self._output(time[None, :], x.T, self._seen(time, u, p).T, p).full().T
        return *_checked(time, x, y), y, x

    def propagate_tangent(self, time, u, p, step, x0, dx0, with_states=True):
        """``(status, where, y, dy, x, dx)`` as the C driver's ``propagate_tangent``."""
        cut = self._cut(time, u, p, step)
        try:
            after, tangent = self._walk_tangent(cut, x0, dx0, p)
        except RuntimeError:
            return GAVE_UP, np.array([time[0], *x0]), None, None, None, None
        status, where = _first_stop(cut, after, x0, None)
        if status:
            return status, where, None, None, None, None
        x = np.vstack([x0, after[cut.last]])
        dx = np.concatenate([dx0[None], tangent[cut.last]])
        y, dy = self._seen_tangent(time, u, p, x, dx)
        return *_checked(time, x, y), y, dy, x, dx if with_states else None

    def _dead_time(self, p):
        return [None if d is None else float(p[d]) for d in self._delays]

    def _cut(self, time, u, p, step) -> Substeps:
        return inputs.substeps(time, u, step, self._linear, self._dead_time(p))

    def _seen(self, time, u, p):
        """The inputs that the outputs see: delayed, at the samples."""
        seen = u.copy()
        for j, Td in enumerate(self._dead_time(p)):
            if Td is not None:
                seen[:, j] = inputs.at(time, u[:, j], time - Td, self._linear[j], "right")
        return seen

    def _walk(self, cut: Substeps, x, p):
        """States after every substep (m, nx), each from the one before."""
        after = np.empty((len(cut.time), len(x)))
        data = np.column_stack([cut.time, cut.mean, cut.length])
        for first in range(0, len(data), CHUNK):
            part = _padded(data[first : first + CHUNK])
            made = self._many(x, part.T, p).full().T[: len(data) - first]
            after[first : first + CHUNK] = made
            x = made[-1]
        return after

    def _walk_each(self, cut: Substeps, restart, p):
        """States after every substep (m, nx), every interval from its own start: all intervals side by side."""
        firsts = cut.first
        counts = cut.last - firsts + 1
        after = np.empty((len(cut.time), restart.shape[1]))
        for level in range(counts.max(initial=0)):
            at = (firsts + level)[counts > level]
            x = restart[:-1][counts > level] if level == 0 else after[at - 1]
            after[at] = self._substep(cut.time[at][None, :], x.T, cut.mean[at].T, p, cut.length[at][None, :]).full().T
        return after

    def _walk_tangent(self, cut: Substeps, x, dx, p):
        after, tangent = np.empty((len(cut.time), len(x))), np.empty((len(cut.time), *dx.shape))
        rate = cut.mean_rate[:, [j for j, _ in self._to.dead]]
        data = np.column_stack([cut.time, cut.mean, rate, cut.length])
        for first in range(0, len(data), CHUNK):
            part = data[first : first + CHUNK]
            x_many, dx_many = self._many_tangents(x, dx, _padded(part).T, p)
            after[first : first + CHUNK] = x_many.full().T[: len(part)]
            blocks = dx_many.full().reshape(len(x), CHUNK, dx.shape[1]).transpose(1, 0, 2)
            tangent[first : first + CHUNK] = blocks[: len(part)]
            x, dx = after[first + len(part) - 1], tangent[first + len(part) - 1]
        return after, tangent

    def _seen_tangent(self, time, u, p, x, dx):
        rate = np.zeros((len(time), len(self._to.dead)))
        for m, (j, _) in enumerate(self._to.dead):
            delayed = time - p[self._delays[j]]
            rate[:, m] = -inputs.slope_at(time, u[:, j], delayed, self._linear[j])
        columns = dx.transpose(1, 0, 2).reshape(x.shape[1], len(time) * self._to.count)
        y, dy = self._output_tangent(time[None, :], x.T, self._seen(time, u, p).T, p, columns, rate.T)
        return y.full().T, dy.full().reshape(y.size1(), len(time), self._to.count).transpose(1, 0, 2).copy()

    @functools.cached_property
    def _many(self):
        return self._on_axis(0).mapaccum("walk", CHUNK, 1)

    @functools.cached_property
    def _many_tangents(self):
        return self._on_axis(len(self._to.dead), tangent=True).mapaccum("walk_tangent", CHUNK, 2)

    def _on_axis(self, rates: int, tangent: bool = False):
        """The substep as ``(x[, dx], [t; u; du; h], p) -> x[, dx]``: the order of arguments that mapaccum takes."""
        kind = ca.MX if self._implicit else ca.SX
        nx, nu = len(self._flat.states), len(self._flat.inputs)
        x, p = kind.sym("x", nx), kind.sym("p", len(self._flat.parameters))
        data = kind.sym("data", nu + rates + 2)
        t, u, du, h = data[0], data[1 : nu + 1], data[nu + 1 : nu + 1 + rates], data[nu + 1 + rates]
        if not tangent:
            return ca.Function("on_axis", [x, data, p], [self._substep(t, x, u, p, h)])
        dx = kind.sym("dx", nx, self._to.count)
        return ca.Function("on_axis", [x, dx, data, p], self._tangent_substep(t, x, u, p, h, dx, du))

    def _tangent_substep(self, t, x, u, p, h, dx, du):
        if self._implicit:
            after = equations.implicit_tangent(self._flat, self._to)(t, x, u, p, h, dx, du)
            return [self._substep(t, x, u, p, h), after]
        return list(equations.rk4_tangent(self._flat, self._to)(t, x, u, p, h, dx, du))

    @functools.cached_property
    def _output_tangent(self):
        return equations.output_tangent(self._flat, self._to)


def _padded(part):
    """Rows up to the chunk's length: substeps of length 0, which change nothing."""
    filled = np.repeat(part[-1:], CHUNK, axis=0)
    filled[: len(part)] = part
    filled[len(part) :, -1] = 0.0
    return filled


def _first_stop(cut: Substeps, after, x0, restart):
    bad = ~np.isfinite(after).all(axis=1)
    if not bad.any():
        return DONE, None
    k = int(np.argmax(bad))
    before = after[k - 1] if k else x0
    if restart is not None and k in cut.first:
        before = restart[np.searchsorted(cut.first, k)]
    return STATE, np.array([cut.time[k], *before])


def _checked(time, x, y):
    bad = ~np.isfinite(y).all(axis=1)
    if not bad.any():
        return DONE, None
    k = int(np.argmax(bad))
    return OUTPUT, np.array([time[k], *x[k]])
