"""Small experiments on a Model Exchange FMU, as in `probes`: each returns ``(passed, detail)``."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from ctypes import c_double

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription

from .exchange import Exchange
from .master import FLOATS, abilities_of, inputs_of, is_scalar, outputs_of

LATER, SHARE = 0.37, 0.1  # s, and of nominal: from the start to the other point
SEED, POINTS, CALLS = 35, 25, 12  # of calls in any order: where answers are compared, and calls before each
REPEATS = 1e-6  # of the size of an answer: iterations inside an FMU may end a little elsewhere


class Exchanger(Exchange):
    """One Model Exchange instance that is asked at points away from its run, from t = 0 in continuous-time mode."""

    def __init__(self, description: ModelDescription, unzipped: str, inputs: Mapping[str, float] | None = None):
        """``inputs`` are set before the end of initialization."""
        super().__init__(description, unzipped)
        self.inputs = [v for v in inputs_of(description) if v.type in FLOATS and is_scalar(v)]
        self.outputs = [v.name for v in outputs_of(description) if v.type in FLOATS]
        self.initialise(0.0, None, {}, inputs or {})

    def answers(self) -> np.ndarray:
        """Derivatives, then outputs, at the present point."""
        return np.r_[self.rates(), self.read(self.outputs)]

    def set(self, what: str, time: float, x: np.ndarray, u: np.ndarray):
        """One of "time", "states", "inputs" of the point (time, x, u)."""
        if what == "time":
            self.fmu.setTime(time)
        elif what == "states":
            self.fmu.setContinuousStates((c_double * self.count)(*x), self.count)
        elif self.inputs:
            self.write({v.name: value for v, value in zip(self.inputs, u, strict=True)})

    def move(self, time: float, x: np.ndarray, u: np.ndarray):
        """To a point."""
        for what in ("time", "states", "inputs"):
            self.set(what, time, x, u)

    def points(self) -> tuple[tuple, tuple]:
        """The start, and a point away from it in time, states and inputs."""
        x, u = self.states(), np.array([float(v.start or 0.0) for v in self.inputs])
        scale = np.maximum(self.vector(self.fmu.getNominalsOfContinuousStates), 1e-12)
        step = np.array([SHARE * float(v.nominal or 1.0) for v in self.inputs])
        return (0.0, x, u), (LATER, x + SHARE * scale, u + step)


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


def _any_calls(description: ModelDescription, unzipped: str):
    """After hundreds of calls in any order, time going back too, the answers are those of a fresh instance.

    Solvers evaluate ahead of a step and come back, and move inputs within it: derivatives and outputs must follow from
    time, states and inputs alone. A fresh instance gets its inputs before the end of initialization, so that an FMU
    that takes inputs at events only is found; not where there are event indicators, whose branches are then others.
    """
    random, worn = np.random.default_rng(SEED), Exchanger(description, unzipped)
    smooth = not description.numberOfEventIndicators
    (_, x, u), (_, far_x, far_u) = worn.points()
    middle = {"time": np.array(LATER), "states": x, "inputs": u}
    size = {"time": LATER, "states": far_x - x, "inputs": far_u - u}
    found, expected, times, point = [], [], [], dict(middle)
    for _ in range(POINTS):
        for what in random.choice(("time", "states", "inputs", "ask"), CALLS):
            if what == "ask":
                worn.answers()
                continue
            point[what] = middle[what] + random.uniform(-1.0, 1.0, middle[what].shape) * size[what]
            worn.set(what, float(point["time"]), point["states"], point["inputs"])
        found.append(worn.answers())
        early = {v.name: value for v, value in zip(worn.inputs, point["inputs"], strict=True)} if smooth else {}
        fresh = Exchanger(description, unzipped, early)
        fresh.move(float(point["time"]), point["states"], point["inputs"])
        expected.append(fresh.answers())
        fresh.close()
        times.append(float(point["time"]))
    worn.close()
    return _compared(np.array(found), np.array(expected), times)


def _compared(found: np.ndarray, expected: np.ndarray, times: list[float]):
    """Each answer by its largest size among the points."""
    scale = np.maximum(np.abs(expected).max(axis=0, initial=0.0), 1e-300)
    errors = np.abs(found - expected) / scale
    if not np.isfinite(errors).all():
        return False, "not finite somewhere within a tenth of nominal around the start"
    worst = float(errors.max(initial=0.0))
    if worst > REPEATS:
        at = int(errors.max(axis=1).argmax())
        return False, (
            f"the answer depends on the calls before: at t = {times[at]:.3g} s it is off by {worst:.2g} of its size "
            "from that of a fresh instance with the same time, states and inputs"
        )
    return True, f"{POINTS} points, reached by {POINTS * CALLS} calls in any order, answer as a fresh instance"


def _reset(description: ModelDescription, unzipped: str):
    exchanger = Exchanger(description, unzipped)
    _, other = exchanger.points()
    first = np.r_[exchanger.states(), exchanger.answers()]
    exchanger.move(*other)
    exchanger.answers()
    exchanger.fmu.reset()
    exchanger.initialise(0.0, None, {}, {})
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
    unknowns = [*(v.valueReference for v in rates), *(exchanger.variables[n].valueReference for n in exchanger.outputs)]
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
    "any order of calls": _any_calls,
    "reset": _reset,
    "state": _state,
    "directional derivatives": _directional,
    "NaN input": _nan_input,
}
