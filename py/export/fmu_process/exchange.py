"""A Model Exchange run with FMPy's CVODES. Numbers are in the FMU's own units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from ctypes import c_double

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.sundials import CVodeSolver

from .master import Instance

TOLERANCE = 1e-11  # relative, and of the nominal values
MOST_STEPS = 200_000  # of the solver between two samples
MOST_UPDATES = 1000  # of the discrete states at one event
DISCARD = 2  # fmi2Discard, fmi3Discard
SAME = 1e-9  # of a sample's length: two times this close are one


class SolverFailure(RuntimeError):
    """CVODES does not get on, though no call of the FMU fails."""


class Exchange(Instance):
    """One Model Exchange instance, in continuous-time mode once it is initialised."""

    interface = "ModelExchange"

    def initialise(self, start: float, stop: float | None, starts: Mapping[str, float], inputs: Mapping[str, float]):
        """From instantiated to continuous-time mode."""
        super().initialise(start, stop, starts, inputs)
        self.next_event = np.inf
        self._update()
        self.fmu.enterContinuousTimeMode()

    @property
    def count(self) -> int:
        """Continuous states."""
        return int(self.description.numberOfContinuousStates)

    def event(self, values: Mapping[str, float]):
        """Event mode and back, with new inputs."""
        self.fmu.enterEventMode()
        self.write(values)
        self._update()
        self.fmu.enterContinuousTimeMode()

    def completed(self) -> bool:
        """Tell the FMU that a step is complete; whether it asks for event mode."""
        exchange = self.description.modelExchange
        if not exchange.needsCompletedIntegratorStep:
            return False
        event, ends = self.fmu.completedIntegratorStep()
        _or_ended(ends)
        return bool(event)

    def states(self) -> np.ndarray:
        """Continuous states."""
        return self.vector(self.fmu.getContinuousStates)

    def rates(self) -> np.ndarray:
        """Derivatives of the continuous states."""
        return self.vector(self.fmu.getContinuousStateDerivatives if self.fmi3 else self.fmu.getDerivatives)

    def vector(self, read) -> np.ndarray:
        """What one of the functions over all states answers; one without states is not asked."""
        if not self.count:
            return np.empty(0)
        values = (c_double * self.count)()
        read(values, self.count)
        return np.array(values)

    def _update(self):
        update = self.fmu.updateDiscreteStates if self.fmi3 else self.fmu.newDiscreteStates
        for _ in range(MOST_UPDATES):
            again, ends, _, _, planned, when = update()
            _or_ended(ends)
            if not again:
                self.next_event = when if planned else np.inf
                return
        raise RuntimeError(f"the discrete states did not settle after {MOST_UPDATES} updates at an event")


class _Inputs:
    """Inputs between samples: held, or on the line to the next sample."""

    def __init__(self, instance: Exchange, time: np.ndarray, u: np.ndarray, inputs: Sequence[str], straight):
        self.instance, self.time, self.u, self.inputs, self.straight = instance, time, u, inputs, straight
        self.now = 0  # the sample whose values the held inputs have

    def at(self, time: float) -> np.ndarray:
        values = self.u[self.now].copy()
        for j in np.flatnonzero(self.straight):
            values[j] = np.interp(time, self.time, self.u[:, j])
        return values

    def apply(self, time: float):
        """Set those that move."""
        values = self.at(time)
        self.instance.write({self.inputs[j]: values[j] for j in np.flatnonzero(self.straight)})


class _Solver(CVodeSolver):
    """CVODES with the inputs inside its right-hand side: FMPy's holds them until the next output."""

    def __init__(self, instance: Exchange, inputs: _Inputs, start: float):
        fmu, md = instance.fmu, instance.description
        self.ask_nominals = fmu.getNominalsOfContinuousStates
        super().__init__(
            nx=instance.count, nz=int(md.numberOfEventIndicators), get_x=fmu.getContinuousStates,
            set_x=fmu.setContinuousStates,
            get_dx=fmu.getContinuousStateDerivatives if instance.fmi3 else fmu.getDerivatives,
            get_z=fmu.getEventIndicators, get_nominals=self._nominals, set_time=fmu.setTime,
            input=inputs, startTime=start, relativeTolerance=TOLERANCE, maxNumSteps=MOST_STEPS,
        )  # fmt: skip
        self.failure: Exception | None = None

    def f(self, t, y, ydot, user_data):
        """Derivatives at (t, y, u(t)). What the FMU discards is tried again with a smaller step."""
        return self._asked(self._rates, t, y, ydot, user_data)

    def g(self, t, y, gout, user_data):
        """Event indicators."""
        return self._asked(super().g, t, y, gout, user_data)

    def advance(self, time: float, to: float) -> tuple[bool, float]:
        """Whether a root was found, and the time that was reached."""
        self.failure = None
        try:
            root, _, reached = self.step(time, to)
        except RuntimeError as failure:
            raise self.failure or SolverFailure(str(failure)) from None
        return root, reached

    def _nominals(self, values, count: int):
        """Those of the FMU; where one is not above zero, the 1 that the standard asks for where none is known."""
        self.ask_nominals(values, count)
        known = np.ctypeslib.as_array(values, (count,))
        known[~(known > 0.0)] = 1.0

    def _rates(self, t, *rest) -> int:
        self.input.apply(t)
        return super().f(t, *rest)

    def _asked(self, question, *where) -> int:
        try:
            return question(*where)
        except FMICallException as failure:
            self.failure = failure
            return 1 if failure.status == DISCARD else -1


def run_exchange(
    instance: Exchange, time: np.ndarray, u: np.ndarray, inputs: Sequence[str], outputs: Sequence[str], linear
) -> np.ndarray:
    """Outputs (n, k) at ``time`` of an instance that was initialised with the first row of ``u``; row k sees input k.

    Held inputs jump at the samples, in event mode; those named in ``linear`` move within the solver's steps.
    """
    straight = np.array([name in linear for name in inputs], bool)
    moves = _Inputs(instance, time, u, inputs, straight)
    solver = _Solver(instance, moves, float(time[0]))
    found = np.empty((len(time), len(outputs)))
    found[0] = instance.read(outputs)
    for k in range(1, len(time)):
        _integrate(instance, solver, moves, float(time[k - 1]), float(time[k]))
        moves.now = k
        if (u[k] != u[k - 1])[~straight].any():
            instance.event(dict(zip(inputs, u[k], strict=True)))
            solver.reset(float(time[k]))
        found[k] = instance.read(outputs)
    return found


def _integrate(instance: Exchange, solver: _Solver, moves: _Inputs, begin: float, end: float):
    """From sample to sample, through the events between them."""
    near = SAME * (end - begin)
    while begin < end - near:
        root, begin = solver.advance(begin, min(end, max(instance.next_event, begin + near)))
        instance.fmu.setTime(begin)
        moves.apply(begin)
        if instance.completed() or root or begin >= instance.next_event - near:
            instance.event(dict(zip(moves.inputs, moves.at(begin), strict=True)))
            solver.reset(begin)


def _or_ended(ends: bool):
    if ends:
        raise RuntimeError("the FMU ended the simulation")
