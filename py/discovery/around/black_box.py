"""BlackBox: an FMU with real equations before its inputs and after its outputs, as a FlatModel that methods can run.

    u --front--> shaped inputs --FMU--> raw outputs --back--> y

The FMU gives no derivatives: what reaches it is differentiated by differences of runs, what stands behind it exactly.
Runs are remembered by their inputs and parameters, so whatever acts behind the FMU alone never runs it again. An input
that is shaped reaches the FMU as its mean over each step, which makes a dead time a smooth parameter.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import casadi as ca
import numpy as np

from hydrotwin.export.repeated import RepeatedFmu
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel, Signal, StateVariable, changed
from hydrotwin.records import Record
from hydrotwin.simulation import prepare
from hydrotwin.work.executor import Starts

DIFFERENCE = 3e-3  # of a parameter's size: the step of a difference
_SUM = StateVariable("", "1")
SAME = 1e-9  # of an input's size: a difference from rounding, not from shaping


@dataclass(frozen=True, eq=False, repr=False)
class BlackBox(FlatModel):
    """The FMU ``fmu`` with its surroundings.

    front : u -> shaped inputs, with the integral of each as a last state; None where nothing shapes them.
    back : (u, raw outputs) -> y, with the states of both sides.
    begin : (u, raw, p) -> x at the start; ``from_raw`` are the states that begin by what the FMU puts out.
    starts : state -> (start parameter of the FMU); values : parameter -> variable of the FMU.
    """

    black_box: ClassVar[bool] = True

    fmu: RepeatedFmu = None
    front: FlatModel | None = None
    back: FlatModel = None
    begin: ca.Function = None
    from_raw: tuple[int, ...] = ()
    starts: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, str] = field(default_factory=dict)

    def with_inputs(self, changes: Mapping[str, Mapping]) -> BlackBox:
        """The same whose inputs do something else between samples, on their way to the FMU and inside it."""
        parts = {name: getattr(self, name) for name in ("fmu", "front", "back")}
        changed_parts = {name: part.with_inputs(changes) for name, part in parts.items() if part is not None}
        return dataclasses.replace(self, inputs=changed(self.inputs, changes, self.name), **changed_parts)

    def prepared(self, free_parameters, free_states, step: float, method: str, zero=()) -> Chain:
        """What runs it; see `hydrotwin.simulation.prepare`.

        An FMU does not tell its accuracy, and sensor noise shakes what follows it at every sample: steps around it are
        as long as their eigenvalues allow, and none is refined.
        """
        return Chain(self, free_parameters, free_states, step, method, zero)


class Chain:
    """Front, FMU and back, one after the other; runs and sensitivities as those of a `Propagator`."""

    def __init__(self, flat: BlackBox, free_parameters, free_states, step: float, method: str, zero):
        self.flat, self.step = flat, step
        self.method = "explicit" if method == "auto" else method
        self.free_parameters, self.free_states = tuple(free_parameters), tuple(free_states)
        options = {"step": step, "method": method, "tolerance": np.inf}
        self._front = prepare(flat.front, **options) if flat.front else None
        options |= {"free_parameters": free_parameters, "free_states": free_states, "zero": zero}
        self._back = prepare(flat.back, **options)
        self._index = [flat.index_of(n) for n in self.free_parameters]
        self._begin_by_p = _derivative(flat.begin, self._index)

    def run(self, time, u, p, x0, restart=None) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (n, ny) and states (n, nx) of the surroundings. Raises SolveError when the FMU fails."""
        if restart is not None:
            raise SolveError(f"{self.flat.name}: an FMU cannot be restarted at every sample. Compare it in free run.")
        raw = self.raw(time, u, p, x0)
        return self._back.run(time, np.hstack([u, raw]), p, self._started(u, raw, p, x0))

    def raw(self, time, u, p, x0) -> np.ndarray:
        """Outputs (n, ny) of the FMU itself, SI."""
        flat, shaped = self.flat, self._shaped(time, u, p, x0)
        of = dict(zip((s.name for s in flat.states), x0, strict=True))
        known = dict(zip((q.name for q in flat.parameters), p, strict=True))
        default = {q.name: q.value for q in flat.fmu.parameters}
        values = {variable: of[state] for state, variable in flat.starts.items()}
        values |= {v: known[name] for name, v in flat.values.items() if known[name] != default[v]}
        fmu = dataclasses.replace(flat.fmu, starts={}, values={n: _unscaled(flat.fmu, n, v) for n, v in values.items()})
        here = {"shift": 0.0} if self._front is None else {"shift": 0.0, "interpolation": "hold"}  # shaped: means
        fmu = fmu.with_inputs({s.name: here for s in fmu.inputs})
        signals = {s.name: shaped[:, j] for j, s in enumerate(fmu.inputs)}
        run = fmu.free_run(Record(time, signals, {s.name: s.unit for s in fmu.inputs}, flat.name))
        return np.column_stack([run[s.name] for s in fmu.outputs])

    def sensitivity(self, time, u, p, x0, x0_jacobian, with_states: bool = True):
        """``(y, dy, x, dx)`` with derivatives to free parameters and free states, as `Propagator.sensitivity`."""
        flat, shared = self.flat, len(self._index)
        seeds = np.array(x0_jacobian, dtype=float)
        raw = self.raw(time, u, p, x0)
        begun, inputs = self._started(u, raw, p, x0), np.hstack([u, raw])
        if not seeds.shape[1]:
            y, x = self._back.run(time, inputs, p, begun)
            return y, np.empty((*y.shape, 0)), x, np.empty((*x.shape, 0)) if with_states else None
        behind, rows = seeds.copy(), list(flat.from_raw)
        if rows:
            behind[rows] = 0.0
            behind[np.ix_(rows, range(shared))] = np.array(self._begin_by_p(u[0], raw[0], p))[rows]
        y, dy, x, dx = self._back.sensitivity(time, inputs, p, begun, behind, with_states=with_states)
        before = [j for j in range(seeds.shape[1]) if self._reaches(j, seeds)]
        for j in before:
            step, moved_p, moved_x = self._moved(j, p, x0, seeds)
            if not (np.any(moved_p != p) or np.any(moved_x != x0)):
                continue
            other = self.raw(time, u, moved_p, moved_x)
            if np.array_equal(other, raw):
                continue  # it does not reach the FMU: known exactly already
            ran, ways = self._back.run(time, np.hstack([u, other]), p, self._started(u, other, p, x0))
            dy[:, :, j] += (ran - y) / step  # what arrives otherwise, beside what acts behind
            if with_states:
                dx[:, :, j] += (ways - x) / step
        return y, dy, x, dx

    def _reaches(self, j: int, seeds: np.ndarray) -> bool:
        """Whether a direction may change what the FMU gets."""
        if j < len(self._index) and self.free_parameters[j] in self.flat.values:
            return True
        begins = [k for k, s in enumerate(self.flat.states) if s.name in self.flat.starts]
        return self._front is not None or bool(np.any(seeds[begins, j]))

    def _moved(self, j: int, p: np.ndarray, x0: np.ndarray, seeds: np.ndarray):
        """Step, parameters and start states a little along a direction, inside the bounds."""
        p, shared = p.copy(), len(self._index)
        if j >= shared:
            step = DIFFERENCE * self.flat.states[int(np.argmax(np.abs(seeds[:, j])))].nominal
            return step, p, x0 + step * seeds[:, j]
        k = self._index[j]
        given = self.flat.parameters[k]
        step = DIFFERENCE * max(abs(p[k]), abs(given.nominal))
        step = -step if p[k] + step > given.bounds[1] else step
        p[k] += step
        return step, p, x0 + step * seeds[:, j]

    def _shaped(self, time, u, p, x0) -> np.ndarray:
        """What the FMU gets, (n, nu): the mean of each input over the step that follows a sample."""
        if self._front is None:
            return u
        count = u.shape[1]
        _, x = self._front.run(time, u, p, np.concatenate([x0, np.zeros(count)]))
        means = np.diff(x[:, -count:], axis=0) / np.diff(time)[:, None]
        means = np.vstack([means, means[-1:]])
        size = np.maximum(np.abs(u).max(axis=0), 1e-300)
        return np.where(np.abs(means - u) <= SAME * size, u, means)

    def _started(self, u, raw, p, x0) -> np.ndarray:
        rows = list(self.flat.from_raw)
        if not rows:
            return x0
        x = np.array(x0, dtype=float)
        x[rows] = np.array(self.flat.begin(u[0], raw[0], p)).ravel()[rows]
        return x


def _unscaled(fmu: RepeatedFmu, variable: str, value: float) -> float:
    """SI -> the FMU's own unit."""
    factor, offset = fmu.description.scales[variable]
    return float((value - offset) / factor)


def _derivative(begin: ca.Function, index) -> ca.Function:
    arguments = [ca.SX.sym(n, begin.size1_in(i)) for i, n in enumerate(("u", "raw", "p"))]
    x = begin(*arguments)
    by_p = ca.jacobian(x, arguments[2])[:, index] if len(index) else ca.SX(x.shape[0], 0)
    return ca.Function("begin_by_p", arguments, [ca.densify(by_p)])


def black_box(around: FlatModel, shaped: ca.Function, raw: list[int], fmu: RepeatedFmu, **names) -> BlackBox:
    """The FlatModel of surroundings whose parameters at the positions ``raw`` stand for the outputs of an FMU.

    shaped : (t, x, u, p) -> what goes into the FMU. names : ``starts`` and ``values`` of `BlackBox`.
    """
    kept = [k for k in range(len(around.parameters)) if k not in raw]
    parameters = tuple(around.parameters[k] for k in kept)
    sizes = (1, len(around.states), len(around.inputs), len(kept))
    t, x, u, p = (ca.SX.sym(n, size) for n, size in zip("txup", sizes, strict=True))
    r = ca.SX.sym("raw", len(raw))
    whole = ca.SX(len(around.parameters), 1)
    for positions, symbols in ((kept, p), (raw, r)):
        for k, position in enumerate(positions):
            whole[position] = symbols[k]
    rates, y = around.ode(t, x, u, whole)
    silent = ca.SX.zeros(len(raw))
    labels = (["t", "x", "u", "p"], ["xdot", "y"])
    inputs = tuple(
        dataclasses.replace(f, dead_time=s.dead_time, default=s.default)
        for s, f in zip(around.inputs, fmu.inputs, strict=True)
    )
    outputs = tuple(dataclasses.replace(s, name=f.name) for s, f in zip(around.outputs, fmu.outputs, strict=True))
    measured = tuple(Signal(f"{s.name} of the FMU", s.unit, "", s.nominal, "linear") for s in outputs)
    common = {"parameters": parameters, "step": around.step, "initialisation": Starts({})}
    back = FlatModel(
        f"{around.name}_back", (*inputs, *measured), outputs, around.states,
        ode=ca.Function("ode", [t, x, ca.vertcat(u, r), p], [rates, y], *labels, {"cse": True}), **common,
    )  # fmt: skip
    given = ca.substitute(ca.vertcat(shaped(t, x, u, whole)), r, silent)
    start = around.start_given(())(u, whole, [])
    rows = sorted(set(ca.jacobian(start, r).sparsity().row())) if len(raw) and start.shape[0] else []
    public = ca.Function("ode", [t, x, u, p], ca.substitute([rates, y], [r], [silent]), *labels)
    return BlackBox(
        name=around.name, description=around.description, inputs=inputs, outputs=outputs,
        states=_measured(around, fmu, names["starts"]), parameters=parameters, ode=public,
        initialisation=_Beginning(around, tuple(kept)), step=around.step, fmu=fmu,
        front=_front(around, inputs, given, public, (t, x, u, p), common), back=back,
        begin=ca.Function("begin", [u, r, p], [ca.densify(start)]), from_raw=tuple(rows),
        provenance=around.provenance, **names,
    )  # fmt: skip


class _Beginning:
    """An ``initialisation`` without the outputs of the FMU: what begins by them is set when it has run."""

    def __init__(self, around: FlatModel, kept: tuple[int, ...]):
        self._around, self._kept = around, kept

    def __call__(self, given: tuple[str, ...]) -> ca.Function:
        u, p = ca.SX.sym("u", len(self._around.inputs)), ca.SX.sym("p", len(self._kept))
        z, whole = ca.SX.sym("z", len(given)), ca.SX(len(self._around.parameters), 1)
        for k, position in enumerate(self._kept):
            whole[position] = p[k]
        x = self._around.start_given(given)(u, whole, z)
        return ca.Function("start", [u, p, z], [ca.densify(x)], ["u", "p", "z"], ["x"])


def _measured(around: FlatModel, fmu: RepeatedFmu, starts: Mapping[str, str]):
    """The states; one that is a start of the FMU is measured by the output that the FMU names for it."""
    return tuple(
        dataclasses.replace(s, measured_by=fmu.starts[starts[s.name]] if s.name in starts else None)
        for s in around.states
    )


def _front(around, inputs, given: ca.SX, public: ca.Function, arguments, common) -> FlatModel | None:
    """The equations before the FMU, None where every input goes in as it is."""
    t, x, u, p = arguments
    late = any(s.dead_time for s in inputs)
    if not late and ca.is_equal(given, u, 10):
        return None
    sums = ca.SX.sym("sums", len(inputs))
    states = [*around.states]
    states += [dataclasses.replace(_SUM, name=f"sum({s.name})", nominal=abs(s.nominal)) for s in inputs]
    rates = ca.vertcat(public(t, x, u, p)[0], given)
    labels = (["t", "x", "u", "p"], ["xdot", "y"])
    ode = ca.Function("ode", [t, ca.vertcat(x, sums), u, p], [ca.densify(rates), ca.densify(given)], *labels)
    return FlatModel(f"{around.name}_front", inputs, inputs, tuple(states), ode=ode, **common)
