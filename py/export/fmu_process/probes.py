"""Small experiments on a Co-Simulation FMU, each a function of a `Trial` that returns verdict and detail."""

from __future__ import annotations

import itertools
import math
import re
from functools import partial

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ScalarVariable

from .master import Slave, abilities_of, look_size
from .reading import Reader, every_variable
from .start_values import start_values
from .trial import REPEATS, STEPS, Trial, in_time, off, same, size_of
from .verdicts import FAIL, PASS, REMARK, NotTried

MOVED, SMALL = 1e-3, 1e-5  # of an input's size: how far it is moved, and for differences
AT_ONCE = 1e-3  # of what a step brings: what comes without one follows at once
SLOPE = 1e-4  # of nominal: largest difference of a directional derivative to finite differences
CLOCK = 1e-6  # of a step: what adding up internal steps may lose
SETS = re.compile(r"fmi\d(Set|Setup)")  # functions that compute nothing
SOLVER = 1e-2  # of an output's size or nominal value: what another beginning of the solver inside may change
MOST_INPUTS = 20  # moved one by one


def _runs(trial: Trial):
    """At its start values first, as any importer may; then with inputs that move."""
    trial.instance().close()  # one that gives no instance at all fails
    try:
        still = trial.run(share=0.0)
    except (FMICallException, RuntimeError) as failure:
        return gives_up(failure, trial.inputs)
    if not np.isfinite(still).all():
        return not_finite(trial.names, still, trial.inputs)
    done = f"{STEPS} steps of {trial.step:g} s, {still.shape[1]} outputs finite"
    if trial.refusal is not None:
        return REMARK, f"{done} at the start values of its inputs; moved by a tenth of nominal: {trial.refusal}"
    return PASS, done


def _reading(trial: Trial):
    return every_variable(trial.description.modelVariables, _reader(trial))


def _start_values(trial: Trial):
    return start_values(trial.description.modelVariables, _reader(trial))


def _reader(trial: Trial) -> Reader:
    return Reader(trial.instance, partial(Slave.step, time=0.0, size=trial.step))


def gives_up(failure: Exception, inputs):
    """What to say of an FMU that does not go on at its start values: of a call that computes, inputs may be why."""
    if inputs and not SETS.match(getattr(failure, "function", "")):
        names = ", ".join(v.name for v in inputs[:3])
        raise NotTried(
            f"at the start values of its inputs it gives up ({failure}), so it may need values for {names}. Check it "
            "with a recording: --reference"
        )
    return FAIL, f"at its start values it gives up: {failure}"


def not_finite(names: list[str], rows: np.ndarray, inputs):
    """What to say of an FMU that is content with outputs that are no numbers."""
    name = names[int(np.argmin(np.isfinite(rows).all(axis=0)))]
    why = ", where its inputs stay at their start values" if inputs else ""
    return REMARK, f"output '{name}' is not finite within the first steps{why}, and no call says so"


def _reset(trial: Trial):
    first, slave = trial.require_repeats(), trial.instance()
    trial.advance(slave)
    slave.fmu.reset()
    again = trial.advance(slave)
    slave.close()
    return same(first, again, "after reset the run repeats itself")


def _second_instance(trial: Trial):
    if trial.description.coSimulation.canBeInstantiatedOnlyOncePerProcess in (True, "true", "1"):
        raise NotTried("the FMU says that it can be instantiated only once per process")
    alone = trial.require_repeats()
    one, other = trial.instance(), trial.instance()
    for slave in (one, other):
        slave.initialise(0.0, None, {}, {})
    rows = [(trial.one_step(one, k), trial.one_step(other, k)) for k in range(STEPS)]
    one.close()
    other.close()
    rows_one, rows_other = (np.array(column) for column in zip(*rows, strict=True))
    if off(alone, rows_one) > REPEATS:
        return FAIL, f"beside another instance the run differs by {off(alone, rows_one):.3g} of an output's size"
    return same(rows_one, rows_other, "two interleaved instances equal a run alone")


def _nan_input(trial: Trial):
    if not trial.inputs or not trial.outputs:
        raise NotTried("no real input, or no output that shows it")
    slave, name = trial.instance(), trial.inputs[0].name
    trial.advance(slave)
    try:
        slave.write({name: math.nan})
        for k in range(STEPS, 2 * STEPS):
            slave.step(k * trial.step, trial.step)
    except FMICallException as refused:
        return PASS, f"NaN at '{name}' is refused (status {refused.status})"
    if np.isfinite(slave.read(trial.names)).all():
        return REMARK, f"NaN at '{name}' is taken without a word, the outputs stay finite"
    return REMARK, f"NaN at '{name}' is taken as a value and reaches the outputs"


def _step_before_init(trial: Trial):
    try:
        trial.instance().step(0.0, trial.step)
    except FMICallException as refused:
        return PASS, f"a step before initialization is refused (status {refused.status})"
    return REMARK, "a step before initialization is accepted"


def _unknown_reference(trial: Trial):
    slave = trial.instance()
    trial.advance(slave)
    unused = max(v.valueReference for v in trial.description.modelVariables) + 12345
    try:
        (slave.fmu.getFloat64 if slave.fmi3 else slave.fmu.getReal)([unused])
    except FMICallException as refused:
        return PASS, f"value reference {unused} is refused (status {refused.status})"
    return REMARK, f"value reference {unused}, which no variable has, is answered"


def _state(trial: Trial):
    if not trial.description.coSimulation.canGetAndSetFMUstate:
        raise NotTried("the FMU says that it cannot save its state")
    trial.require_repeats()
    slave = trial.instance()
    trial.advance(slave)
    state = slave.fmu.getFMUState()
    first = trial.go_on(slave)
    slave.fmu.setFMUState(state)
    again = trial.go_on(slave)
    verdict, detail = same(first, again, "from a saved state the run goes on as it did")
    sizes = np.maximum([size_of(v) for v in trial.outputs], np.abs(first).max(axis=0))
    if verdict == FAIL and (np.abs(first - again) <= SOLVER * sizes).all():
        return REMARK, f"{detail}; that is no more than a solver inside may bring about that starts anew"
    return verdict, detail


def _dependencies(trial: Trial):
    """An output that does not list an input must not answer to it at once; one that lists none to nothing."""
    declared = {u.variable.name: u.dependencies for u in trial.description.outputs}
    inputs, names = _moving(trial), [name for name in trial.names if name in declared]
    if not names:
        raise NotTried("no output is listed")
    if all(d is None for d in declared.values()):
        raise NotTried("no dependencies are declared, an importer must assume all")
    wrong, active, moved = [], 0, 0
    for moved, variable in enumerate(in_time(inputs), 1):  # noqa: B007
        values = [_moved(trial, names, variable, share) for share in (0.0, MOVED)]
        at_once, in_a_step = (np.abs(values[1][k] - values[0][k]) for k in (0, 1))
        changed = (at_once > AT_ONCE * in_a_step) & (at_once > 0.0)
        active += int(changed.any())
        listed = [d is None or variable in d for d in (declared[n] for n in names)]
        wrong += [f"{n} on {variable.name}" for n, c, d in zip(names, changed, listed, strict=True) if c and not d]
    if wrong:
        return FAIL, f"not declared, yet seen: {', '.join(wrong)}"
    return PASS, f"{moved} inputs moved, {active} reach an output at once, all of that is declared"


def _moving(trial: Trial) -> list[ScalarVariable]:
    """The real inputs that are moved one by one. NotTried where that tells nothing."""
    if not trial.description.coSimulation.canHandleVariableCommunicationStepSize:
        raise NotTried("it takes one step size only, what follows at once cannot be told from what follows in a step")
    inputs = trial.inputs[:MOST_INPUTS]
    if not inputs:
        raise NotTried("no real input")
    if trial.share == 0.0:
        raise NotTried(f"it does not go on when its inputs move ({trial.refusal})")
    if not np.isfinite(trial.run()).all():
        raise NotTried("outputs are not finite, so what moves them cannot be told")
    return inputs


def _moved(trial: Trial, names: list[str], variable, share: float):
    """Outputs a step as good as none after an input was moved by ``share`` of its size, and a whole step after.

    Set, step, read: a slave of its own each time, for nothing may be read between setting and stepping.
    """
    slave, size = trial.instance(), trial.step
    trial.advance(slave)
    [value] = slave.read([variable.name])
    try:
        slave.write({variable.name: value + share * max(size_of(variable), abs(value))})
        short = look_size(STEPS * size, size)
        slave.step(STEPS * size, short)
        first = np.array(slave.read(names))
        slave.step(STEPS * size + short, size - short)
        return first, np.array(slave.read(names))
    finally:
        slave.close()


def _directional(trial: Trial):
    """d output / d input against finite differences, where the FMU offers it."""
    declared = abilities_of(trial.unzipped, "CoSimulation")
    if not declared & {"providesDirectionalDerivative", "providesDirectionalDerivatives"}:
        raise NotTried("not offered")
    outputs = [v for v in trial.outputs if v.type in ("Real", "Float64")]
    inputs, worst = [v for v in _moving(trial) if v.type in ("Real", "Float64")], 0.0
    if not outputs or not inputs:
        raise NotTried("no real input or no real output")
    slave, references = trial.instance(), [v.valueReference for v in outputs]
    trial.advance(slave)
    for variable in in_time(inputs):
        [value] = slave.read([variable.name])
        exact = slave.fmu.getDirectionalDerivative(references, [variable.valueReference], [1.0])
        h = SMALL * max(size_of(variable), abs(value))
        sides = [_moved(trial, [v.name for v in outputs], variable, sign * SMALL)[0] for sign in (-1, 1)]
        scale = np.array([size_of(v) for v in outputs]) / size_of(variable)
        scale = np.maximum(scale, np.abs(exact))
        rounding = np.finfo(float).eps * np.abs(sides[0]) / h
        worst = max(worst, float((np.abs((sides[1] - sides[0]) / (2 * h) - exact) / (scale + rounding / SLOPE)).max()))
        if "providesAdjointDerivatives" in declared:
            adjoint = [slave.fmu.getAdjointDerivative([r], [variable.valueReference], [1.0])[0] for r in references]
            if not np.allclose(adjoint, exact, rtol=1e-9, atol=1e-12 * float(np.abs(scale).max())):
                return FAIL, f"the adjoint derivatives to '{variable.name}' are not the directional ones"
    slave.close()
    return PASS if worst < SLOPE else FAIL, f"largest difference to finite differences {worst:.2g} of nominal"


def _intermediate_update(trial: Trial):
    """Where it is declared, a step calls back at rising times inside it, and returns at the time that is asked for."""
    if "providesIntermediateUpdate" not in abilities_of(trial.unzipped, "CoSimulation"):
        raise NotTried("not offered")
    times, asked = [], []

    def update(owner, time, may_set, may_get, finished, can_return, requested, when):
        times.append(time)
        if can_return and not asked and time > 0.0:
            asked.append(time)
            requested[0], when[0] = True, time

    slave = trial.instance(intermediate_update=update, early_return_allowed=True)
    size = STEPS * trial.step
    slave.initialise(0.0, None, {}, {})
    _, _, early, reached = slave.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=size)
    slave.close()
    if any(b < a for a, b in itertools.pairwise([0.0, *times, size * (1.0 + CLOCK)])):
        return FAIL, f"the times of the calls do not rise within the step of {size:g} s: {times[:3]} ... {times[-1]}"
    if asked and not (early and math.isclose(reached, asked[0], rel_tol=CLOCK)):
        return FAIL, f"asked to return at {asked[0]:g} s, the step went on to {reached:g} s"
    if not times:
        return REMARK, f"it is declared, but a step of {size:g} s calls nobody"
    return PASS, f"{len(times)} calls in a step of {size:g} s, {_returned(asked)}"


def _returned(asked: list[float]) -> str:
    return "which returned when asked" if asked else "no call offers to return early"


PROBES = {
    "runs": _runs,
    "reading": _reading,
    "start values": _start_values,
    "reset": _reset,
    "second instance": _second_instance,
    "state": _state,
    "intermediate update": _intermediate_update,
    "dependencies": _dependencies,
    "directional derivatives": _directional,
    "NaN input": _nan_input,
    "unknown value reference": _unknown_reference,
    "step before initialization": _step_before_init,
}
