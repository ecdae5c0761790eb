"""The same walk as ``driver.c`` on the CasADi virtual machine: for machines without a C compiler."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import FlatModel

from . import equations, inputs
from .control import BURST, Control
from .equations import Directions
from .inputs import Substeps
from .refining import Dear, is_rough, refine

DONE, STATE, OUTPUT, GAVE_UP, NO_MEMORY, DEAR = 0, 1, 2, 3, 4, 5  # status codes of driver.c
CHUNK = 100  # substeps per call of the virtual machine


class VirtualMachine:
    """Runs one model with CasADi's interpreter: the answers of the compiled library, ten times slower.

    Threads may share it, but do not gain from it: one runs at a time, for functions are built as they are needed.
    """

    def __init__(self, flat: FlatModel, to: Directions, implicit: bool):
        self.flat, self.to, self.implicit = flat, to, implicit
        self.linear = [not s.held for s in flat.inputs]
        self._delays = equations.delays(flat)
        self.nominal = np.array([s.nominal for s in flat.states])
        self._kept = equations.states_with_rows(flat, to)
        self._output = equations.output(flat)
        self.substep = _smooth(equations.implicit_substep(flat)) if implicit else equations.rk4_substep(flat)

    @equations.alone
    def propagate(self, time, u, p, control, x0, restart=None):
        """``(status, where, y, x)`` as the C driver's ``propagate``; where: time and last finite state of a stop."""
        walk = _Walk(self, time, u, p, control)
        try:
            after = walk.states(x0) if restart is None else walk.each(restart)
        except RuntimeError:  # the integrator inside gave up
            return GAVE_UP, np.array([time[0], *x0]), None, None
        except Dear:
            return DEAR, np.array([time[0], *x0]), None, None
        status, where = _first_stop(walk.cut, after, x0, restart)
        if status:
            return status, where, None, None
        x = np.vstack([x0, after[walk.cut.last]])
        y = self._output(time[None, :], x.T, self._seen(time, u, p).T, p).full().T
        return *_checked(time, x, y), y, x

    @equations.alone
    def propagate_tangent(self, time, u, p, control, x0, dx0, with_states=True):
        """``(status, where, y, dy, x, dx)`` as the C driver's ``propagate_tangent``."""
        walk = _Walk(self, time, u, p, control)
        try:
            after, tangent = walk.tangents(x0, dx0)
        except RuntimeError:
            return GAVE_UP, np.array([time[0], *x0]), None, None, None, None
        except Dear:
            return DEAR, np.array([time[0], *x0]), None, None, None, None
        status, where = _first_stop(walk.cut, after, x0, None)
        if status:
            return status, where, None, None, None, None
        x = np.vstack([x0, after[walk.cut.last]])
        dx = np.concatenate([dx0[None], tangent[walk.cut.last]])
        y, dy = self._seen_tangent(time, u, p, x, dx)
        return *_checked(time, x, y), y, dy, x, dx if with_states else None

    def units_of_errors(self, p) -> np.ndarray:
        """Of an error in each state (nx,); infinite where parameters are zero and no output sees it."""
        seen = np.isin(np.arange(len(self.nominal)), self._kept) | bool(p[list(self.to.zero)].any())
        return np.where(seen, self.nominal, np.inf)

    def dead_time(self, p):
        return [None if d is None else float(p[d]) for d in self._delays]

    def units_of_sensitivities(self, p) -> np.ndarray:
        return equations.units_of_sensitivities(self.flat, self.to, ca.DM(p)).full() if self.to.count else np.empty(0)

    def _seen(self, time, u, p):
        """The inputs that the outputs see: delayed, at the samples."""
        seen = u.copy()
        for j, Td in enumerate(self.dead_time(p)):
            if Td is not None:
                seen[:, j] = inputs.at(time, u[:, j], time - Td, self.linear[j], "right")
        return seen

    def _seen_tangent(self, time, u, p, x, dx):
        rate = np.zeros((len(time), len(self.to.dead)))
        for m, (j, _) in enumerate(self.to.dead):
            delayed = time - p[self._delays[j]]
            rate[:, m] = -inputs.slope_at(time, u[:, j], delayed, self.linear[j])
        columns = dx.transpose(1, 0, 2).reshape(x.shape[1], len(time) * self.to.count)
        y, dy = self._output_tangent(time[None, :], x.T, self._seen(time, u, p).T, p, columns, rate.T)
        return y.full().T, dy.full().reshape(y.size1(), len(time), self.to.count).transpose(1, 0, 2).copy()

    @functools.cached_property
    def many(self) -> ca.Function:
        """CHUNK substeps: (x, data (.., CHUNK), p) -> x and roughness (nx, CHUNK)."""
        return self._on_axis().mapaccum("walk", CHUNK, 1)

    @functools.cached_property
    def many_tangents(self) -> ca.Function:
        """The same with dx (nx, n_theta), one beside the other, behind x."""
        return self._tangent_on_axis().mapaccum("walk_tangent", CHUNK, 2)

    def _on_axis(self):
        """The substep as ``(x, [t; u; h], p) -> x, roughness``: the order that mapaccum takes."""
        x, data, p = self._symbols(0)
        t, u, h = ca.vertsplit(data, [0, 1, data.numel() - 1, data.numel()])
        return ca.Function("on_axis", [x, data, p], self.substep.call([t, x, u, p, h]))

    def _tangent_on_axis(self):
        """``(x, dx, [t; u; du; behind; before; h], p) -> x, dx, roughness``."""
        nu, rates, columns = len(self.flat.inputs), len(self.to.dead), len(equations.dead_columns(self.to))
        x, data, p = self._symbols(rates + nu * (1 + columns))
        dx = type(x).sym("dx", x.numel(), self.to.count)
        places = np.cumsum([0, 1, nu, rates, nu, nu * columns, 1]).tolist()
        t, u, du, behind, before, h = ca.vertsplit(data, places)
        (jumped,) = self.jump.call([t, x, p, behind, ca.reshape(before, nu, columns), dx])
        return ca.Function("on_axis", [x, dx, data, p], self.tangent_substep.call([t, x, u, p, h, jumped, du]))

    def _symbols(self, further: int):
        """x, what a substep is told beside it, p."""
        kind, flat = ca.MX if self.implicit else ca.SX, self.flat
        sizes = {"x": len(flat.states), "data": 2 + len(flat.inputs) + further, "p": len(flat.parameters)}
        return [kind.sym(name, size) for name, size in sizes.items()]

    @functools.cached_property
    def jump(self) -> ca.Function:
        return equations.jump_tangent(self.flat, self.to)

    @functools.cached_property
    def tangent_substep(self) -> ca.Function:
        """``(t, x, u, p, h, dx, du) -> x, dx, roughness``."""
        if not self.implicit:
            return equations.rk4_tangent(self.flat, self.to)
        within = equations.implicit_tangent(self.flat, self.to)
        arguments = within.mx_in()
        x, smooth = self.substep.call(arguments[:5])
        return ca.Function("tangent", arguments, [x, *within.call(arguments), smooth])

    @functools.cached_property
    def _output_tangent(self):
        return equations.output_tangent(self.flat, self.to)


class _Walk:
    """One run: the substeps of the recording, those that are rough refined."""

    def __init__(self, machine: VirtualMachine, time, u, p, control: Control):
        self.machine, self.time, self.u, self.p, self.control = machine, time, u, p, control
        self.cut = inputs.substeps(time, u, control.step, machine.linear, machine.dead_time(p))
        self.units = machine.units_of_errors(p)
        self.left = [BURST + control.trials * ((time[-1] - time[0]) / control.step + len(time))] * 2

    def states(self, x):
        """States after every substep (m, nx), each from the one before."""
        cut = self.cut
        data = np.column_stack([cut.time, cut.mean, cut.length])

        def many(part, z):
            made, rough = self.machine.many(*z, part.T, self.p)
            return (made.full().T,), rough.full().T

        return self._through(data, (x,), many)[0]

    def tangents(self, x, dx):
        """The same, and the derivatives (m, nx, n_theta)."""
        cut, (nx, nt) = self.cut, dx.shape
        self.behind, self.before = self._beside_jumps()
        sides = self.behind, self.before.reshape(len(cut.time), -1)
        data = np.column_stack([cut.time, cut.mean, cut.mean_rate[:, self._dead], *sides, cut.length])

        def many(part, z):
            made, tangent, rough = self.machine.many_tangents(*z, part.T, self.p)
            tangent = tangent.full().reshape(nx, CHUNK, nt).transpose(1, 0, 2)
            return (made.full().T, tangent), rough.full().T

        return self._through(data, (x, dx), many)

    def _beside_jumps(self):
        """Inputs (m, nu) behind the start of every substep; before it, of those with one dead time (m, columns, nu)."""
        cut, to, linear, Td = self.cut, self.machine.to, self.machine.linear, self.machine.dead_time(self.p)
        behind = inputs.behind(self.time, self.u, cut.interval, cut.time, linear, Td)
        before = np.repeat(behind[:, None], len(columns := equations.dead_columns(to)), axis=1)
        for j, column in to.dead:
            if not linear[j]:
                seen = inputs.at(self.time, self.u[:, j], cut.time - Td[j], False, "left")
                before[:, columns.index(column), j] = seen
        return behind, before

    def each(self, restart):
        """States after every substep, every interval from its own start: all intervals side by side."""
        cut, first = self.cut, self.cut.first
        after = np.empty((len(cut.time), restart.shape[1]))
        counts = cut.last - first + 1
        for level in range(counts.max(initial=0)):
            at = (first + level)[counts > level]
            x = restart[:-1][counts > level] if level == 0 else after[at - 1]
            start, length = cut.time[at][None, :], cut.length[at][None, :]
            made, rough = self.machine.substep(start, x.T, cut.mean[at].T, self.p, length)
            after[at] = made.full().T
            for i in np.flatnonzero(self._rough(rough.full().T, x)):
                after[at[i]] = self._refined(at[i], (x[i],))[0]
        return after

    def _through(self, data, z, many):
        after = tuple(np.empty((len(data), *part.shape)) for part in z)
        first = 0
        while first < len(data):
            made, rough = many(_padded(data[first : first + CHUNK]), z)
            before = np.vstack([z[0], made[0][:-1]])
            rough = self._rough(rough, before)[: len(data) - first]
            smooth = int(np.argmax(rough)) if rough.any() else len(rough)
            for whole, part in zip(after, made, strict=True):
                whole[first : first + smooth] = part[:smooth]
            z = tuple(part[smooth - 1] for part in made) if smooth else z
            first += smooth
            if rough.any():
                z = self._refined(first, z)
                for whole, part in zip(after, z, strict=True):
                    whole[first] = part
                first += 1
        return after

    def _rough(self, roughness, x):
        controlled = np.isfinite(self.control.tolerance) and not self.machine.implicit
        return is_rough(roughness, x, self.control, self.units) if controlled else np.zeros(len(x), bool)

    def _refined(self, j: int, z):
        """After the rough substep j."""
        k = int(self.cut.interval[j])
        if len(z) > 1:
            z = z[0], self.machine.jump(self.cut.time[j], z[0], self.p, self.behind[j], self.before[j].T, z[1]).full()

        def trial(t, h, z):
            window = np.array([k]), np.array([t]), np.array([h])
            dead = self.machine.dead_time(self.p)
            (mean,), (rate,) = inputs.means(self.time, self.u, *window, self.machine.linear, dead)
            if len(z) == 1:
                made = self.machine.substep(t, *z, mean, self.p, h)
            else:
                made = self.machine.tangent_substep(t, z[0], mean, self.p, h, z[1], rate[self._dead])
            return tuple(part.full().reshape(old.shape) for part, old in zip(made, z, strict=False))

        start, length = self.cut.time[j], self.cut.length[j]
        units = self.units, self.machine.units_of_sensitivities(self.p)
        return refine(trial, start, length, z, self.control, units, self.left)

    @property
    def _dead(self):
        return [j for j, _ in self.machine.to.dead]


def _smooth(step: ca.Function) -> ca.Function:
    """An implicit substep with the result that tells an explicit one rough: it controls itself."""
    arguments = step.mx_in()
    return ca.Function("substep", arguments, [*step.call(arguments), ca.MX(arguments[1].size1(), 1)])


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
