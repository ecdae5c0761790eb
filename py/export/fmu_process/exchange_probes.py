"""Small experiments on a Model Exchange FMU, as in `probes`: each returns ``(passed, detail)``."""

from __future__ import annotations

import itertools
from ctypes import c_double

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription
from fmpy.simulation import instantiate_fmu

from .master import FLOATS, abilities_of, inputs_of, outputs_of

LATER, SHARE = 0.37, 0.1  # s, and of nominal: from the start to the other point


class Exchanger:
    """One Model Exchange instance in continuous-time mode: FMI 2 and 3 seen through the same few calls."""

    def __init__(self, description: ModelDescription, unzipped: str):
        self.fmi3 = description.fmiVersion.startswith("3")
        self.fmu = instantiate_fmu(unzipped, description, fmi_type="ModelExchange")
        self.inputs = [v for v in inputs_of(description) if v.type in FLOATS and not getattr(v, "dimensions", None)]
        self.outputs = [v.valueReference for v in outputs_of(description)]
        self.count = int(description.numberOfContinuousStates)
        self.initialise()

    def initialise(self):
        """From instantiated to continuous-time mode at t = 0."""
        if not self.fmi3:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        update = self.fmu.updateDiscreteStates if self.fmi3 else self.fmu.newDiscreteStates
        while update()[0]:
            pass
        self.fmu.enterContinuousTimeMode()

    def states(self) -> np.ndarray:
        """Continuous states."""
        return self._vector(self.fmu.getContinuousStates)

    def answers(self) -> np.ndarray:
        """Derivatives, then outputs, at the present point."""
        fmu = self.fmu
        rates = self._vector(fmu.getContinuousStateDerivatives if self.fmi3 else fmu.getDerivatives)
        return np.r_[rates, (fmu.getFloat64 if self.fmi3 else fmu.getReal)(self.outputs) if self.outputs else []]

    def set(self, what: str, time: float, x: np.ndarray, u: np.ndarray):
        """One of "time", "states", "inputs" of the point (time, x, u)."""
        if what == "time":
            self.fmu.setTime(time)
        elif what == "states":
            self.fmu.setContinuousStates((c_double * self.count)(*x), self.count)
        elif self.inputs:
            references = [v.valueReference for v in self.inputs]
            (self.fmu.setFloat64 if self.fmi3 else self.fmu.setReal)(references, list(u))

    def move(self, time: float, x: np.ndarray, u: np.ndarray):
        """To a point."""
        for what in ("time", "states", "inputs"):
            self.set(what, time, x, u)

    def points(self) -> tuple[tuple, tuple]:
        """The start, and a point away from it in time, states and inputs."""
        x, u = self.states(), np.array([float(v.start or 0.0) for v in self.inputs])
        scale = np.maximum(self._vector(self.fmu.getNominalsOfContinuousStates), 1e-12)
        step = np.array([SHARE * float(v.nominal or 1.0) for v in self.inputs])
        return (0.0, x, u), (LATER, x + SHARE * scale, u + step)

    def close(self):
        """Terminate and free."""
        self.fmu.terminate()
        self.fmu.freeInstance()

    def _vector(self, read) -> np.ndarray:
        values = (c_double * self.count)()
        read(values, self.count)
        return np.array(values)


def _order_of_setting(description: ModelDescription, unzipped: str):
    """The answer at a point must not depend on how one came to it, nor on what was asked on the way."""
    exchanger = Exchanger(description, unzipped)
    start, other = exchanger.points()
    expected = _reached(exchanger, start, other, ("time", "states", "inputs"), ask=False)
    orders = list(itertools.permutations(("time", "states", "inputs")))
    worst, where = 0.0, None
    for order in orders:
        found = _reached(exchanger, start, other, order, ask=True)
        difference = float(np.abs(found - expected).max(initial=0.0))
        if not difference <= worst:
            worst, where = difference, order
    exchanger.close()
    if where:
        return (
            False,
            f"stale: setting {', '.join(where)} with questions between gives another answer (off by {worst:.3g})",
        )
    if not np.isfinite(expected).all():
        return False, f"not finite at t = {LATER:g} s, a tenth of nominal away from the start"
    return True, f"{len(orders)} orders of setting time, states and inputs give one answer, bit by bit"


def _reached(exchanger: Exchanger, start: tuple, other: tuple, order: tuple[str, ...], ask: bool) -> np.ndarray:
    exchanger.move(*start)
    exchanger.answers()
    for what in order:
        exchanger.set(what, *other)
        if ask:
            exchanger.answers()
    return exchanger.answers()


def _reset(description: ModelDescription, unzipped: str):
    exchanger = Exchanger(description, unzipped)
    _, other = exchanger.points()
    first = np.r_[exchanger.states(), exchanger.answers()]
    exchanger.move(*other)
    exchanger.answers()
    exchanger.fmu.reset()
    exchanger.initialise()
    again = np.r_[exchanger.states(), exchanger.answers()]
    exchanger.close()
    if np.array_equal(first, again):
        return True, "after reset states, derivatives and outputs are those of the start, bit by bit"
    return False, f"after reset the start differs by {np.abs(first - again).max():.3g}"


def _directional(description: ModelDescription, unzipped: str):
    """Derivatives and outputs by states and inputs against central differences, away from the start."""
    declared = abilities_of(unzipped, "ModelExchange")
    if not declared & {"providesDirectionalDerivative", "providesDirectionalDerivatives"}:
        return None, "not offered"
    exchanger = Exchanger(description, unzipped)
    time, x, u = exchanger.points()[1]
    rates = [row.variable for row in description.derivatives]
    unknowns = [*(v.valueReference for v in rates), *exchanger.outputs]
    knowns = [*(v.derivative for v in rates), *exchanger.inputs]
    worst, where = 0.0, ""
    for column, known in enumerate(knowns):
        h, sides = 1e-6 * abs(float(known.nominal or 1.0)), []
        for sign in (1.0, -1.0):
            moved = np.r_[x, u]
            moved[column] += sign * h
            exchanger.move(time, moved[: len(x)], moved[len(x) :])
            sides.append(exchanger.answers())
        exchanger.move(time, x, u)
        exact = np.array(exchanger.fmu.getDirectionalDerivative(unknowns, [known.valueReference], [1.0]))
        rounding = 1e-10 * np.abs(sides[0]) / h
        scale = np.maximum(np.abs(exact), 1e-3 * np.abs(exact).max(initial=0.0)) + rounding + 1e-300
        error = float((np.abs((sides[0] - sides[1]) / (2 * h) - exact) / scale).max(initial=0.0))
        if not error <= worst:
            worst, where = error, f" (to {known.name})"
    exchanger.close()
    return worst < 1e-3, f"largest difference to finite differences {worst:.2g}{where}, at t = {time:g} s"


def _state(description: ModelDescription, unzipped: str):
    """A saved state brings back time, states, inputs and what follows from them, after answers elsewhere."""
    if not description.modelExchange.canGetAndSetFMUstate:
        return None, "the FMU says that it cannot save its state"
    exchanger = Exchanger(description, unzipped)
    start, other = exchanger.points()
    exchanger.move(*other)
    first = np.r_[exchanger.states(), exchanger.answers()]
    state = exchanger.fmu.getFMUState()
    exchanger.move(*start)
    exchanger.answers()
    exchanger.fmu.setFMUState(state)
    again = np.r_[exchanger.states(), exchanger.answers()]
    exchanger.close()
    if np.array_equal(first, again):
        return True, f"a state saved at t = {LATER:g} s comes back with derivatives and outputs, bit by bit"
    return False, f"a state saved at t = {LATER:g} s comes back different (by {np.abs(first - again).max():.3g})"


def _nan_input(description: ModelDescription, unzipped: str):
    """NaN at an input, or at a state where there is no input."""
    exchanger = Exchanger(description, unzipped)
    time, x, u = exchanger.points()[0]
    what, name = ("inputs", exchanger.inputs[0].name) if exchanger.inputs else ("states", "the first state")
    if not len(u) and not len(x):
        return None, "no real input and no state"
    (u if len(u) else x)[0] = np.nan
    try:
        exchanger.set(what, time, x, u)
        found = exchanger.answers()
    except FMICallException as refused:
        return True, f"NaN at '{name}' is refused (status {refused.status})"
    exchanger.close()
    if np.isfinite(found).all():
        return None, f"NaN at '{name}' is taken without a word, derivatives and outputs stay finite"
    return False, f"NaN at '{name}' is taken as a value and reaches derivatives or outputs"


EXCHANGE_PROBES = {
    "order of setting": _order_of_setting,
    "reset": _reset,
    "state": _state,
    "directional derivatives": _directional,
    "NaN input": _nan_input,
}
