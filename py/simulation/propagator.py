"""`prepare`: a model lowered to C, compiled and ready to run; `Propagator`: its runs and sensitivities."""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, SolveError, nearest
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import steps_over

from . import equations, stiffness
from .control import EXACT, TOLERANCE, Accuracy, Choice, Control, compared, moved_far
from .engines import engine_of
from .library import Library
from .machine import DEAR, DONE
from .recent import Recent
from .stops import raise_stop

OWN_METHOD = "auto"  # of a run that is asked for no other
METHODS = (OWN_METHOD, "explicit", "implicit", "vm")
FINEST = 8  # by how much "auto" may divide the step of a model of few states before it turns to the implicit method
TRIALS = 4  # by how much more it may divide the steps around kinks, on the average of a run


def prepare(
    model,
    *,
    free_parameters: Sequence[str] = (),
    free_states: Sequence[str] = (),
    step: float | None = None,
    method: str = "auto",
    zero: Sequence[str] = (),
    tolerance: float = TOLERANCE,
) -> Propagator:
    """Lower a model to C, compile it (or find it in the cache) and hand back what runs it.

    step : longest substep [s]; the model's own by default.
    method : "explicit" (RK4 at the step), "implicit" (L-stable, adaptive, see ``implicit.c``), "vm" (RK4 without a
        compiler), or "auto": explicit, with every step refined in which a contact or another kink asks for it, and all
        of them halved if the eigenvalues along the first run do, down to an eighth, of a model of more than eight
        states to one part in so many; else, and where refined steps become dearer, implicit.
    tolerance : error of a step that "auto" refines, in units of nominal + |x|; infinite: none is.
    zero : parameters that are 0 wherever sensitivities are asked for, free ones among them: states that reach no output
        while they are have none, which makes a model of many parts at rest several times faster.

    Raises DeclarationError for an unknown parameter, state or method; SolveError when the compiler fails.
    """
    flat = getattr(model, "flat", model)
    if method not in METHODS:
        raise DeclarationError(f"{flat.name}: no simulation method '{method}'. {nearest(method, METHODS)}")
    longest = float(flat.step if step is None else step)
    if not longest > 0:
        raise DeclarationError(f"{flat.name}: the step must be positive (got {longest} s). Give seconds, such as 1e-3.")
    if flat.black_box:
        return flat.prepared(tuple(free_parameters), tuple(free_states), longest, method, tuple(zero))
    to = tuple(free_parameters), tuple(free_states), tuple(zero)
    return Propagator(flat, to, longest, method, tolerance)


class Propagator:
    """Runs one model over recordings. Arrays are SI; safe to call from several threads.

    ``method`` is "auto" until the first run decided it and the ``step`` [s], again when parameters have moved far;
    ``engine`` is "c" or "vm" (CasADi's interpreter).
    """

    def __init__(self, flat: FlatModel, to, step: float, method: str, tolerance: float):
        """``to`` : free parameters, free states, parameters at zero; the rest as in `prepare`."""
        free_parameters, free_states, zero = to
        self.flat, self._asked = flat, (step, "explicit" if method == "vm" else method)
        self.free_parameters, self.free_states = free_parameters, free_states
        self._interpreted = method == "vm"
        self._to = equations.directions(flat, free_parameters, free_states, zero)
        self._nominal = np.array([q.nominal for q in flat.parameters])
        self._tolerance = tolerance
        self._engines, self._recents = {}, {"explicit": Recent(), "implicit": Recent()}
        self._begin(self._asked[1])
        if self.method != "implicit":
            self._engine(implicit=False)

    def _begin(self, method: str) -> None:
        exact = EXACT * TOLERANCE if method == "implicit" else np.inf
        self._choice = Choice(method, Control(self._asked[0], exact))
        self._deciding, self._building = threading.Lock(), threading.Lock()

    @property
    def asked(self) -> tuple[float, str]:
        """Step [s] and method as they were asked for."""
        return self._asked

    def undecided(self, method: str | None = None) -> Propagator:
        """The same with step and method as they were asked for: "auto" is decided again, at other parameters.

        method : another one, instead.
        """
        other = copy.copy(self)
        other._engines = dict(self._engines)
        other._asked = self._asked[0], method or self._asked[1]
        other._begin(other._asked[1])
        return other

    @property
    def method(self) -> str:
        """The method of the next run: "auto" before the first."""
        return self._choice.method

    @property
    def step(self) -> float:
        """Longest step [s] of the next run where nothing is refined."""
        return self._choice.control.step

    @property
    def engine(self) -> str:
        """What runs the model: "c" or "vm"."""
        return "c" if isinstance(self._engine(self.method == "implicit"), Library) else "vm"

    def run(self, time, u, p, x0, restart=None) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (n, ny) and states (n, nx) at ``time`` (n,) from inputs (n, nu), parameters (np,), start (nx,).

        restart : states (n, nx) from which each interval starts instead of the end of the one before.

        Raises Diverged with the time and the state that left the finite numbers; SolveError for unusable arrays.
        """
        time, u, p, x0 = self.checked(time, u, p, x0)
        restart = None if restart is None else _shaped("restart", restart, (len(time), len(x0)), self.flat.name)
        answer = self._decide(time, u, p, x0)
        if answer is None or restart is not None:
            answer = self._stepped("propagate", time, u, p, x0, restart)
        status, where, y, x = answer
        raise_stop(self.flat, status, where, time, u, p)
        return y, x

    def sensitivity(self, time, u, p, x0, x0_jacobian, with_states: bool = True):
        """``(y, dy, x, dx)``: as `run`, and derivatives (n, ny, n_theta), (n, nx, n_theta) to theta.

        theta : the free parameters, then the free states; x0_jacobian (nx, n_theta) = d x0 / d theta, to be given
            by the caller (unit columns for free states).
        with_states : False leaves dx out (None), which saves memory.
        """
        time, u, p, x0 = self.checked(time, u, p, x0)
        dx0 = _shaped("x0_jacobian", x0_jacobian, (len(x0), self._to.count), self.flat.name)
        self._at_zero(p, with_states)
        self._decide(time, u, p, x0)
        if self._to.count == 0:
            y, x = self.run(time, u, p, x0)
            return y, np.empty((*y.shape, 0)), x, np.empty((*x.shape, 0)) if with_states else None
        status, where, y, dy, x, dx = self._stepped("propagate_tangent", time, u, p, x0, dx0, with_states)
        raise_stop(self.flat, status, where, time, u, p)
        return y, dy, x, dx

    def costs(self, time, u, p, cuts, x0, measured, weights, limits=None) -> np.ndarray:
        """``1/2 sum (w (y - measured))^2`` of many runs over one recording in one call, (segments,); engine "c" alone.

        cuts : (segments, 3) whole numbers, the samples at which each run begins, counts from, and ends before.
        x0 : (segments, nx); measured : (n, ny), nan where nothing was; weights : (ny,), 0 for an output not used.
        limits : (segments,), costs at which a run is given up; None for none.

        Nan where a run left the finite numbers or passed its limit.
        """
        cuts, time, u, p, x0, measured = self._segments(time, u, p, cuts, x0, measured)
        weights = _shaped("weights", weights, (len(self.flat.outputs),), self.flat.name)
        limits = None if limits is None else _shaped("limits", limits, (len(cuts),), self.flat.name)
        choice = self._choice
        cost = self._engine(choice.implicit).costs(cuts, time, u, p, choice.control, x0, measured, weights, limits)
        dear = np.isinf(cost)
        if dear.any():
            engine = self._engine(implicit=True)
            limits = None if limits is None else limits[dear]
            cost[dear] = engine.costs(cuts[dear], time, u, p, choice.control, x0[dear], measured, weights, limits)
        return cost

    def expansions(self, time, u, p, cuts, x0, x0_jacobian, measured, limits=None):
        """``sum (y - measured)^2`` of many runs as in `costs`, half its gradient and half its Gauss-Newton Hessian.

        By output: (segments, ny), (segments, ny, n_theta), (segments, ny, n_theta, n_theta), so that other weights need
        no other run. The last few are remembered: a fit that goes on under other weights begins where it stands.

        x0_jacobian : (segments, nx, n_theta), as in `sensitivity`.
        limits : (segments, ny), sums of squares at which a run is given up; None for none. Nan where one was.
        """
        cuts, time, u, p, x0, measured = self._segments(time, u, p, cuts, x0, measured)
        dx0 = _shaped("x0_jacobian", x0_jacobian, (*x0.shape, self._to.count), self.flat.name)
        self._at_zero(p)
        if self._to.count == 0:
            ny = len(self.flat.outputs)
            alone = [self.costs(time, u, p, cuts, x0, measured, unit) for unit in np.eye(ny)]
            return 2 * np.stack(alone, axis=1), np.zeros((len(x0), ny, 0)), np.zeros((len(x0), ny, 0, 0))
        limits = None if limits is None else _shaped("limits", limits, (len(cuts), measured.shape[1]), self.flat.name)
        choice = self._choice

        def expand(*asked):
            return self._expanded(choice.implicit, limits, *asked)

        recent = self._recents[choice.method]
        return recent.answer(expand, cuts, time, u, p, choice.control, x0, dx0, measured)

    def _expanded(self, implicit: bool, limits, cuts, time, u, p, control, x0, dx0, measured):
        found = self._engine(implicit).expansions(cuts, time, u, p, control, x0, dx0, measured, limits)
        dear = np.isinf(found[0]).any(axis=1)
        if dear.any():
            engine = self._engine(implicit=True)
            limits = None if limits is None else limits[dear]
            again = engine.expansions(cuts[dear], time, u, p, control, x0[dear], dx0[dear], measured, limits)
            for part, other in zip(found, again, strict=True):
                part[dear] = other
        return found

    def accuracy(self, time, u, p, x0) -> Accuracy:
        """How far the outputs of `run` are from those with half the step and an eighth of the error in each."""
        time, u, p, x0 = self.checked(time, u, p, x0)
        y, _ = self.run(time, u, p, x0)
        return self._accuracy(self._choice, time, u, p, x0, y)

    def controlled_run(self, time, u, p, x0) -> tuple[np.ndarray, np.ndarray, Accuracy]:
        """As `run`, and its `accuracy`.

        Where "auto" misses it, finer steps are tried and then the implicit method; the best stays.
        """
        time, u, p, x0 = self.checked(time, u, p, x0)
        y, x = self.run(time, u, p, x0)
        choice = self._choice
        best = y, x, self._accuracy(choice, time, u, p, x0, y)
        for finer in self._finer(choice):
            if best[2].reached:
                break
            status, _, y, x = self._stepped("propagate", time, u, p, x0, None, choice=finer)
            reached = self._accuracy(finer, time, u, p, x0, y) if status == DONE else None
            if reached and reached.error < best[2].error:
                best, self._choice = (y, x, reached), finer
        return best

    def _accuracy(self, choice: Choice, time, u, p, x0, y) -> Accuracy:
        status, _, other, _ = self._stepped("propagate", time, u, p, x0, None, choice=choice.finer())
        other = other if status == DONE else np.full_like(y, np.inf)
        return compared(self.flat, time, y, other, choice.method, choice.control.step)

    def decided(self, time, u, p, x0) -> Choice:
        """How it runs at these parameters: settles "auto"."""
        self._decide(*self.checked(time, u, p, x0))
        return self._choice

    def chosen_run(self, choice: Choice, time, u, p, x0):
        """``(status, where, y, x)`` of a run as ``choice`` says, status and where as in ``driver.c``."""
        return self._stepped("propagate", time, u, p, x0, None, choice=choice)

    def _finer(self, choice: Choice) -> list[Choice]:
        """What "auto" tries when a choice misses the accuracy."""
        if self._asked[1] != "auto":
            return []
        control = choice.control
        halved = [control._replace(step=control.step / 2.0**k) for k in range(1, int(np.log2(FINEST)) + 1)]
        finer = [choice._replace(control=c) for c in halved]
        return finer if choice.implicit else [*finer, choice._replace(method="implicit", control=control)]

    def _at_zero(self, p, with_states: bool = False) -> None:
        """Refuse sensitivities that were left out."""
        if self._to.zero and (with_states or p[list(self._to.zero)].any()):
            raise SolveError(
                f"{self.flat.name}: prepared with parameters at zero, it has the sensitivities of its outputs there "
                "alone. Leave them at 0 and with_states False, or prepare without zero."
            )

    def _segments(self, time, u, p, cuts, x0, measured):
        """The arrays of many runs; the first of them settles "auto"."""
        if self.engine != "c":
            raise SolveError(f"{self.flat.name}: only compiled runs sum what they leave. Use run and sensitivity.")
        cuts = np.ascontiguousarray(cuts, dtype=np.int64)
        begin, first, last = cuts.reshape(-1, 3).T
        if not len(cuts) or not ((begin >= 0) & (begin <= first) & (first < last) & (last <= len(time))).all():
            raise SolveError(f"{self.flat.name}: cuts must be rows 0 <= begin <= first < last <= {len(time)}.")
        x0 = _shaped("x0", x0, (len(cuts), len(self.flat.states)), self.flat.name)
        measured = _shaped("measured", measured, (len(time), len(self.flat.outputs)), self.flat.name)
        time, u, p, _ = self.checked(time, u, p, x0[0])
        here = slice(begin[0], last[0])
        self._decide(time[here], u[here], p, x0[0])
        return cuts, time, u, p, x0, measured

    def checked(self, time, u, p, x0):
        """The arrays of a run as an engine takes them. Raises SolveError for those that it cannot."""
        flat, time = self.flat, np.ascontiguousarray(time, dtype=float)
        name = flat.name
        if time.ndim != 1 or len(time) == 0 or not (np.isfinite(time[[0, -1]]).all() and (time[1:] > time[:-1]).all()):
            raise SolveError(f"{name}: the time must be finite and rising (n,). Sort it and drop repeated samples.")
        steps_over(time[-1] - time[0], self.step, name)
        u = _shaped("u", np.reshape(u, (len(time), -1)) if np.ndim(u) < 2 else u, (len(time), len(flat.inputs)), name)
        if not np.isfinite(u).all():
            k, j = np.argwhere(~np.isfinite(u))[0]
            raise SolveError(
                f"{name}.{flat.inputs[j].name}: an input must be finite (got {u[k, j]} at t = {time[k]:g} s). "
                "Fill the gap or cut the recording there."
            )
        return time, u, _shaped("p", p, (len(flat.parameters),), name), _shaped("x0", x0, (len(flat.states),), name)

    def _decide(self, time, u, p, x0):
        """Settle "auto" by a first explicit run, whose steps must do for the eigenvalues met along it.

        Finer steps are tried while they cost less than the implicit method: one of its steps takes a system of as
        many equations as there are states, with a derivative to every parameter. Returns the run, as an engine does,
        when explicit steps will do, else None.
        """
        if not self._open(p) or not np.isfinite(x0).all():
            return None
        with self._deciding:
            if not self._open(p):
                return None
            for choice in self.explicit_choices():
                answer = self._engine(implicit=False).propagate(time, u, p, choice.control, x0)
                if answer[0] == DEAR:
                    break
                if stiffness.explicit_will_do(self.flat, choice.control.step, time, u, p, x0, answer[-1]):
                    self._choice = choice._replace(at=p)
                    return answer
            self._engine(implicit=True)
            self._choice = Choice("implicit", Control(self._asked[0], TOLERANCE), p)
            return None

    def explicit_choices(self) -> list[Choice]:
        """Explicit ways to run, in the order in which "auto" tries them; none for "implicit"."""
        step, method = self._asked
        if method != "auto":
            return [] if method == "implicit" else [self._choice]
        most = max(FINEST, len(self.flat.states))
        steps = step / 2.0 ** np.arange(int(np.log2(most)) + 1)
        return [Choice("explicit", Control(float(h), self._tolerance, TRIALS * most)) for h in steps]

    def _open(self, p) -> bool:
        """Whether "auto" is to be decided: for the first time, or because parameters have moved far."""
        if self._asked[1] != "auto":
            return False
        at = self._choice.at
        return at is None or moved_far(p, at, self._nominal)

    def _stepped(self, what: str, time, u, p, *rest, choice: Choice | None = None):
        """What the chosen engine answers, or the implicit one where explicit steps become dearer."""
        choice = choice or self._choice
        control = choice.control
        answer = getattr(self._engine(choice.implicit), what)(time, u, p, control, *rest)
        if answer[0] == DEAR:
            answer = getattr(self._engine(implicit=True), what)(time, u, p, control, *rest)
        return answer

    def _engine(self, implicit: bool):
        found = self._engines.get(implicit)
        if found is None:
            with self._building:
                found = engine_of(self.flat, self._to, implicit, self._interpreted)
                self._engines[implicit] = found
        return found


def _shaped(label: str, values, shape: tuple[int, ...], name: str) -> np.ndarray:
    array = np.ascontiguousarray(values, dtype=float)
    if array.shape != shape:
        raise SolveError(f"{name}: {label} must have shape {shape} (got {array.shape}). Check the order of axes.")
    return array
