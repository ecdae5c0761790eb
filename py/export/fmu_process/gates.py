"""Other programs that take an FMU: FMPy's own simulation, libcosimpy, CasADi's importer. As in `probes`.

What such a program says is a remark at most: it may be wrong itself. One that is not installed, or is not made for such
an FMU, is not tried.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from fmpy import simulate_fmu
from fmpy.model_description import ModelDescription, ScalarVariable

from .exchanger import Exchanger
from .master import FLOATS, Slave, outputs_of
from .trial import SHARE, STEPS, real_inputs, size_of, start_of, step_of, within
from .verdicts import PASS, REMARK, NotTried

EQUAL = 1e-9  # of the larger of the two values
MOST_VARIABLES = 10_000  # that CasADi's importer reads in seconds


def _fmpy(description: ModelDescription, unzipped: str, path: str, interface: str):
    """FMPy's master with its defaults, under inputs that step as those of `_libcosimpy`."""
    step, names = step_of(description), [v.name for v in outputs_of(description)]
    result = simulate_fmu(
        unzipped, validate=False, fmi_type=interface, model_description=description, start_time=0.0,
        stop_time=STEPS * step, output_interval=step, output=names or None, input=_steps(description, step),
    )  # fmt: skip
    finite = all(np.isfinite(result[n]).all() for n in names)
    return _mark(finite), f"{len(result)} points to {result['time'][-1]:g} s, {len(names)} outputs {_said(finite)}"


def _libcosimpy(description: ModelDescription, unzipped: str, path: str):
    """A second master takes the same steps under the same moving inputs as ours."""
    if not importlib.util.find_spec("libcosimpy"):
        raise NotTried("libcosimpy is not installed")
    if Path(path).is_dir():
        raise NotTried("libcosimpy reads archives only")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    step, names = step_of(description), [v.name for v in outputs_of(description) if v.type in FLOATS]
    execution = CosimExecution.from_step_size(step_size=round(step * 1e9))
    slave = execution.add_local_slave(CosimLocalSlave(fmu_path=path, instance_name="checked"))
    observer, override = CosimObserver.create_last_value(), CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(override)
    references = {v.name.decode(): v.reference for v in execution.slave_variables(slave)}
    moved, found = real_inputs(description), []
    for k in range(STEPS):
        for name, value in _inputs(moved, k).items():
            override.slave_real_values(slave, [references[name]], [value])
        if not execution.step():
            return REMARK, f"libcosim gave up after {len(found)} steps of {step:g} s"
        found.append(observer.last_real_values(slave, [references[n] for n in names]))
    own = Slave(description, unzipped)
    own.initialise(0.0, None, {}, {})
    expected = []
    for k in range(STEPS):
        own.write(_inputs(moved, k))
        own.step(k * step, step)
        expected.append(own.read(names))
    own.close()
    difference = _difference(np.array(found), np.array(expected))
    return _mark(difference <= EQUAL), f"{STEPS} steps of {step:g} s, largest difference to our master {difference:.2g}"


def _steps(description: ModelDescription, step: float) -> np.ndarray | None:
    """Held inputs as FMPy takes them: every sample but the last twice, with the value before and after."""
    moved = real_inputs(description)
    if not moved:
        return None
    rows = [(j * step, *_inputs(moved, k).values()) for k in range(STEPS) for j in (k, k + 1)]
    return np.array(rows, dtype=[("time", np.float64), *((v.name, np.float64) for v in moved)])


def _inputs(moved: Sequence[ScalarVariable], k: int) -> dict[str, float]:
    """A tenth of nominal around the start value, at step k, within min and max."""
    wave = SHARE * math.sin(0.3 * (k + 1))
    return {v.name: within(v, start_of(v) + wave * size_of(v)) for v in moved}


def _casadi(description: ModelDescription, unzipped: str, path: str):
    """CasADi's functions of the FMU at the start and away from it, against the FMU asked directly."""
    if not importlib.util.find_spec("casadi"):
        raise NotTried("CasADi is not installed")
    if len(description.modelVariables) > MOST_VARIABLES:
        raise NotTried(f"CasADi's importer takes minutes for more than {MOST_VARIABLES} variables")
    strange = [v.name for v in description.modelVariables if v.type not in FLOATS or getattr(v, "dimensions", None)]
    if strange or description.numberOfEventIndicators:
        raise NotTried("CasADi reads smooth models of real numbers only")
    import casadi as ca

    dae = ca.DaeBuilder("imported", str(unzipped))
    imported = dae.create("f", ["t", "x", "u"], ["ode", "y"])
    exchanger = Exchanger(description, unzipped)
    states = [row.variable.derivative.name for row in description.derivatives]
    names = (states, [v.name for v in exchanger.inputs], exchanger.outputs)
    places = [[own.index(n) for n in theirs] for own, theirs in zip(names, (dae.x(), dae.u(), dae.y()), strict=True)]
    worst = 0.0
    for time, x, u in exchanger.points(SHARE):
        exchanger.move(time, x, u)
        answers = exchanger.answers()
        expected = np.r_[answers[: len(states)][places[0]], answers[len(states) :][places[2]]]
        found = np.concatenate([np.array(a).ravel() for a in imported(time, x[places[0]], u[places[1]])])
        worst = max(worst, _difference(found, expected))
    exchanger.close()
    told = f"{len(states)} derivatives and {len(names[2])} outputs, largest difference {worst:.2g}"
    return _mark(worst <= EQUAL), told


def applicable(description: ModelDescription) -> list[str]:
    """The gates for this kind of FMU: libcosimpy for FMI 2 Co-Simulation, CasADi for FMI 3 Model Exchange."""
    slave, exchange = description.coSimulation is not None, description.modelExchange is not None
    fmi3 = description.fmiVersion.startswith("3")
    wanted = (slave, exchange, slave and not fmi3, exchange and fmi3)
    return [name for name, applies in zip(GATES, wanted, strict=True) if applies]


def _difference(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference, relative to the larger value; infinite where one is not finite."""
    if not found.size:
        return 0.0
    scale = np.maximum(np.maximum(np.abs(found), np.abs(expected)), 1e-300)
    relative = np.abs(found - expected) / scale
    return float(relative.max()) if np.isfinite(relative).all() else np.inf


def _mark(good: bool) -> str:
    return PASS if good else REMARK


def _said(finite: bool) -> str:
    return "finite" if finite else "not finite"


GATES: Mapping[str, Callable] = {
    "FMPy Co-Simulation": partial(_fmpy, interface="CoSimulation"),
    "FMPy Model Exchange": partial(_fmpy, interface="ModelExchange"),
    "CasADi importer": _casadi,
    "libcosimpy": _libcosimpy,
}
"""Each takes the description, the unpacked folder and the path of the FMU."""
