"""Small experiments on a Co-Simulation FMU. Each returns ``(passed, detail)``; passed None: not applicable."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ScalarVariable

from .master import FLOATS, Slave, abilities_of, inputs_of, is_scalar, look_size, outputs_of

STEPS = 20
MOVED, SMALL = 1e-3, 1e-5  # of an input's size: how far it is moved, and for differences
AT_ONCE = 1e-3  # of what a step brings: what comes without one follows at once


def run_probes(
    names: Sequence[str], description: ModelDescription, unzipped: str, rows: Path, probes: Mapping[str, Callable]
):
    """Append one line when a probe begins and one when it ends, so that a crash shows where it happened."""
    with rows.open("a", encoding="utf-8") as stream:
        for name in names:
            stream.write(json.dumps({"begin": name}) + "\n")
            stream.flush()
            try:
                passed, detail = probes[name](description, unzipped)
            except Exception as failure:
                passed, detail = False, f"{type(failure).__name__}: {failure}"
            stream.write(json.dumps({"name": name, "passed": passed, "detail": detail}) + "\n")
            stream.flush()


def _runs(description: ModelDescription, unzipped: str):
    slave, y = _short_run(description, unzipped)
    slave.close()
    if not np.isfinite(y).all():
        return False, "an output is not finite within the first steps"
    return True, f"{STEPS} steps of {_step_size(description):g} s, {y.shape[1]} outputs finite"


def _reset(description: ModelDescription, unzipped: str):
    slave, first = _short_run(description, unzipped)
    slave.fmu.reset()
    again = _advance(slave, description)
    slave.close()
    return _same(first, again, "after reset the run repeats itself")


def _second_instance(description: ModelDescription, unzipped: str):
    if getattr(description.coSimulation, "canBeInstantiatedOnlyOncePerProcess", False):
        return None, "the FMU says that it can be instantiated only once per process"
    alone_slave, alone = _short_run(description, unzipped)
    alone_slave.close()
    one, other = Slave(description, unzipped), Slave(description, unzipped)
    for slave in (one, other):
        slave.initialise(0.0, None, {}, {})
    rows_one, rows_other = _interleaved(one, other, description)
    one.close()
    other.close()
    if not np.array_equal(alone, rows_one):
        return False, f"beside another instance the run differs by {np.abs(alone - rows_one).max():.3g}"
    return _same(rows_one, rows_other, "two interleaved instances equal a run alone")


def _nan_input(description: ModelDescription, unzipped: str):
    inputs = [v for v in inputs_of(description) if v.type in FLOATS]
    if not inputs:
        return None, "no real input"
    slave, _ = _short_run(description, unzipped)
    outputs = [v.name for v in outputs_of(description)]
    try:
        slave.write({inputs[0].name: math.nan})
        for k in range(STEPS, 2 * STEPS):
            slave.step(k * _step_size(description), _step_size(description))
    except FMICallException as refused:
        return True, f"NaN at '{inputs[0].name}' is refused (status {refused.status})"
    values = slave.read(outputs)
    if np.isfinite(values).all():
        return None, f"NaN at '{inputs[0].name}' is taken without a word, the outputs stay finite"
    return False, f"NaN at '{inputs[0].name}' is taken as a value and reaches the outputs"


def _step_before_init(description: ModelDescription, unzipped: str):
    slave = Slave(description, unzipped)
    try:
        slave.step(0.0, _step_size(description))
    except FMICallException as refused:
        return True, f"a step before initialization is refused (status {refused.status})"
    return False, "a step before initialization is accepted"


def _unknown_reference(description: ModelDescription, unzipped: str):
    slave, _ = _short_run(description, unzipped)
    unused = max(v.valueReference for v in description.modelVariables) + 12345
    try:
        (slave.fmu.getFloat64 if slave.fmi3 else slave.fmu.getReal)([unused])
    except FMICallException as refused:
        return True, f"value reference {unused} is refused (status {refused.status})"
    return False, f"value reference {unused}, which no variable has, is answered"


def _state(description: ModelDescription, unzipped: str):
    if not description.coSimulation.canGetAndSetFMUstate:
        return None, "the FMU says that it cannot save its state"
    slave, _ = _short_run(description, unzipped)
    state = slave.fmu.getFMUState()
    first = _continue(slave, description)
    slave.fmu.setFMUState(state)
    again = _continue(slave, description)
    return _same(first, again, "from a saved state the run goes on as it did")


def _dependencies(description: ModelDescription, unzipped: str):
    """An output that does not list an input must not answer to it at once; one that lists none to nothing."""
    declared = {u.variable.name: u.dependencies for u in description.outputs}
    inputs, names = _real(inputs_of(description)), [v.name for v in outputs_of(description) if v.name in declared]
    if not inputs or not declared:
        return None, "no real input or no output listed"
    if all(d is None for d in declared.values()):
        return None, "no dependencies are declared, a master must assume all"
    if not description.coSimulation.canHandleVariableCommunicationStepSize:
        return None, "it takes one step size only, what follows at once cannot be told from what follows in a step"
    wrong, active = [], 0
    for variable in inputs:
        values = [_moved(description, unzipped, names, variable, share) for share in (0.0, MOVED)]
        at_once, in_a_step = (np.abs(values[1][k] - values[0][k]) for k in (0, 1))
        changed = (at_once > AT_ONCE * in_a_step) & (at_once > 0.0)
        active += int(changed.any())
        listed = [d is None or variable in d for d in (declared[n] for n in names)]
        wrong += [f"{n} on {variable.name}" for n, c, d in zip(names, changed, listed, strict=True) if c and not d]
    if wrong:
        return False, f"not declared, yet seen: {', '.join(wrong)}"
    return True, f"{len(inputs)} inputs moved, {active} reach an output at once, all of that is declared"


def _moved(description: ModelDescription, unzipped: str, names: Sequence[str], variable, share: float):
    """Outputs a step as good as none after an input was moved by ``share`` of its size, and a whole step after.

    Set, step, read: a slave of its own each time, for nothing may be read between setting and stepping.
    """
    slave, _ = _short_run(description, unzipped)
    size, (value,) = _step_size(description), slave.read([variable.name])
    scale = max(float(variable.nominal or 1.0), abs(value))
    try:
        slave.write({variable.name: value + share * scale})
        short = look_size(STEPS * size, size)
        slave.step(STEPS * size, short)
        first = np.array(slave.read(names))
        slave.step(STEPS * size + short, size - short)
        return first, np.array(slave.read(names))
    finally:
        slave.close()


def _directional(description: ModelDescription, unzipped: str):
    """d output / d input against finite differences, where the FMU offers it."""
    declared = abilities_of(unzipped, "CoSimulation")
    offered = declared & {"providesDirectionalDerivative", "providesDirectionalDerivatives"}
    inputs, outputs = _real(inputs_of(description)), _real(outputs_of(description))
    if not offered or not inputs:
        return None, "not offered"
    if not description.coSimulation.canHandleVariableCommunicationStepSize:
        return None, "it takes one step size only, there is nothing to compare with"
    slave, _ = _short_run(description, unzipped)
    names, references, worst = [v.name for v in outputs], [v.valueReference for v in outputs], 0.0
    for variable in inputs:
        [value] = slave.read([variable.name])
        exact = slave.fmu.getDirectionalDerivative(references, [variable.valueReference], [1.0])
        h = SMALL * max(float(variable.nominal or 1.0), abs(value))
        below, above = (_moved(description, unzipped, names, variable, sign * SMALL)[0] for sign in (-1, 1))
        scale = np.array([float(v.nominal or 1.0) for v in outputs]) / float(variable.nominal or 1.0)
        worst = max(worst, float((np.abs((above - below) / (2 * h) - exact) / scale).max()))
        if "providesAdjointDerivatives" in declared:
            adjoint = [slave.fmu.getAdjointDerivative([r], [variable.valueReference], [1.0])[0] for r in references]
            if not np.allclose(adjoint, exact, rtol=1e-9, atol=1e-12 * float(np.abs(scale).max())):
                return False, f"the adjoint derivatives to '{variable.name}' are not the directional ones"
    return worst < 1e-4, f"largest difference to finite differences {worst:.2g} of nominal"


def _real(variables: Sequence[ScalarVariable]) -> list[ScalarVariable]:
    return [v for v in variables if v.type in ("Real", "Float64") and is_scalar(v)]


def _intermediate_update(description: ModelDescription, unzipped: str):
    """Where it is declared, a step calls back at rising times inside it, and returns at the time that is asked for."""
    declared = abilities_of(unzipped, "CoSimulation")
    if "providesIntermediateUpdate" not in declared:
        return None, "not offered"
    times, asked = [], []

    def update(owner, time, may_set, may_get, finished, can_return, requested, when):
        times.append(time)
        if can_return and not asked and time > 0.0:
            asked.append(time)
            requested[0], when[0] = True, time

    slave = Slave(description, unzipped, intermediate_update=update, early_return_allowed=True)
    size = STEPS * _step_size(description)
    slave.initialise(0.0, None, {}, {})
    _, _, early, reached = slave.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=size)
    slave.close()
    if not times:
        return False, f"it is declared, but a step of {size:g} s calls nobody"
    if any(b < a for a, b in itertools.pairwise([0.0, *times, size * (1.0 + 1e-9)])):
        return False, f"the times of the calls do not rise within the step of {size:g} s: {times[:5]}"
    if asked and not (early and math.isclose(reached, asked[0], rel_tol=1e-9)):
        return False, f"asked to return at {asked[0]:g} s, the step went on to {reached:g} s"
    if "canReturnEarlyAfterIntermediateUpdate" in declared and not asked:
        return False, "early return is declared, but no call offers it"
    return (
        True,
        f"{len(times)} calls in a step of {size:g} s, {'which returned when asked' if asked else 'no early return'}",
    )


def _step_size(description: ModelDescription) -> float:
    experiment = description.defaultExperiment
    return float(experiment.stepSize) if experiment is not None and experiment.stepSize else 0.01


def _short_run(description: ModelDescription, unzipped: str) -> tuple[Slave, np.ndarray]:
    slave = Slave(description, unzipped)
    return slave, _advance(slave, description)


def _advance(slave: Slave, description: ModelDescription) -> np.ndarray:
    """Outputs of the first steps under a gentle input; from instantiated on."""
    slave.initialise(0.0, None, {}, {})
    return np.array([_one_step(slave, description, k) for k in range(STEPS)])


def _continue(slave: Slave, description: ModelDescription) -> np.ndarray:
    return np.array([_one_step(slave, description, k) for k in range(STEPS, 2 * STEPS)])


def _interleaved(one: Slave, other: Slave, description: ModelDescription) -> tuple[np.ndarray, np.ndarray]:
    rows = [(_one_step(one, description, k), _one_step(other, description, k)) for k in range(STEPS)]
    return np.array([a for a, _ in rows]), np.array([b for _, b in rows])


def _one_step(slave: Slave, description: ModelDescription, k: int) -> list[float]:
    size = _step_size(description)
    for v in inputs_of(description):
        if v.type in FLOATS:
            slave.write({v.name: float(v.start or 0.0) + 0.1 * float(v.nominal or 1.0) * math.sin(0.3 * (k + 1))})
    slave.step(k * size, size)
    return slave.read([v.name for v in outputs_of(description)])


def _same(first: np.ndarray, again: np.ndarray, what: str) -> tuple[bool, str]:
    if np.array_equal(first, again):
        return True, f"{what}, bit by bit"
    return False, f"not so: {what} (largest difference {np.abs(first - again).max():.3g})"


PROBES = {
    "runs": _runs,
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
