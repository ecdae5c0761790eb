"""Whether a Model Exchange FMU has as many continuous states as it lists derivatives."""

from __future__ import annotations

from ctypes import c_double

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ScalarVariable

from .exchanger import ExchangeTrial
from .master import FLOATS, is_scalar
from .trial import in_time, refused, size_of
from .verdicts import FAIL, PASS, REMARK

STATES, EVENTS = "getContinuousStates", "getEventIndicators"
ROOM = 64  # numbers beyond those that are asked for, to see whether more are written
UNTOUCHED = -1.2345678987654321e-300  # what no state is
STILL = 1e-6  # of its size: what a derivative must bring a state in a run to be missed


def number_of_states(trial: ExchangeTrial):
    """Asked of FMI 3; of FMI 2 seen by what it accepts and writes, then by states that stay where they are."""
    exchanger, hidden = trial.exchanger(), _unlisted(trial)
    listed, events = exchanger.count, int(trial.description.numberOfEventIndicators)
    names = f", not listed: {', '.join(v.name for v in hidden[:3])}" if hidden else ""
    if exchanger.fmi3:
        found, seen = exchanger.fmu.getNumberOfContinuousStates(), exchanger.fmu.getNumberOfEventIndicators()
        exchanger.close()
    else:
        exchanger.close()
        found, seen = _accepted(trial, STATES, listed, len(hidden)), _accepted(trial, EVENTS, events, 0)
    if found is None:
        return REMARK, f"asked for {listed} states, as many as derivatives are listed, it refuses, and for others too"
    if found != listed:
        return FAIL, f"it has {found} continuous states, and {listed} derivatives are listed{names}"
    if seen is not None and seen != events:
        return FAIL, f"it has {seen} event indicators, and {events} are declared"
    if still := _still(trial, hidden):
        state, rate = still.derivative.name, still.name
        return FAIL, f"'{state}' stays where it is, though its derivative '{rate}', which is not listed, is not zero"
    return PASS, f"{listed} states, as many as derivatives are listed, and {events} event indicators"


def _unlisted(trial: ExchangeTrial) -> list[ScalarVariable]:
    """Derivatives that are not listed, by themselves or by an alias, of what is neither an input nor a listed state."""
    md = trial.description
    rates = {u.variable.valueReference for u in md.derivatives}
    states = {u.variable.derivative.valueReference for u in md.derivatives if u.variable.derivative is not None}
    return [
        v for v in md.modelVariables
        if v.derivative is not None and v.valueReference not in rates and v.causality != "input"
        and v.derivative.valueReference not in states and v.derivative.causality != "input"
    ]  # fmt: skip


def _accepted(trial: ExchangeTrial, asked: str, declared: int, hidden: int) -> int | None:
    """The number that FMI 2 shows: what it writes where it accepts what is declared, else another that it accepts."""
    if (written := _written(trial, asked, declared)) is not None:
        return written
    others = dict.fromkeys([declared + hidden, *range(declared + ROOM)])
    for count in in_time([n for n in others if n != declared and (n or declared)]):
        if _written(trial, asked, count) is not None:
            return count
    return declared if not declared else None  # some refuse to be asked for none


def _written(trial: ExchangeTrial, asked: str, count: int) -> int | None:
    """How many numbers are written when ``count`` are asked for, None where that is refused."""
    exchanger = trial.exchanger()
    values = (c_double * (count + ROOM))(*[UNTOUCHED] * (count + ROOM))
    try:
        getattr(exchanger.fmu, asked)(values, count)
    except FMICallException:
        exchanger.close()
        return None
    exchanger.close()
    beyond = np.flatnonzero(np.array(values)[count:] != UNTOUCHED)
    return count + (int(beyond[-1]) + 1 if len(beyond) else 0)


def _still(trial: ExchangeTrial, hidden: list[ScalarVariable]) -> ScalarVariable | None:
    """The first derivative that does not move what it is the derivative of in a run."""
    pairs = [v for v in hidden if v.type in FLOATS and is_scalar(v) and is_scalar(v.derivative)]
    if not pairs or refused(lambda: trial.run(0.0)) is not None:
        return None
    names = [name for v in pairs for name in (v.derivative.name, v.name)]
    rows = trial.run(0.0, names)
    for k, v in enumerate(pairs):
        state, rate = rows[:, 2 * k], rows[:, 2 * k + 1]
        if np.ptp(state) == 0.0 and abs(rate.mean()) > STILL * max(size_of(v.derivative), abs(state[0])):
            return v
    return None
