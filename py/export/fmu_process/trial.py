"""What the probes of an FMU share: how its inputs move, and whether it bears that and repeats itself."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ScalarVariable

from .master import FLOATS, Slave, inputs_of, outputs_of
from .verdicts import FAIL, PASS, NotTried

STEPS = 20
SHARE = 0.1  # of nominal: how far inputs are moved, within their min and max
REPEATS = 1e-6  # of the size of an output: solvers and iterations inside an FMU may end a little elsewhere
STEP = 0.01  # s, where the FMU names no step
ENOUGH = 15.0  # s for moving inputs one by one
TINY = 1e-9  # the least size of an output: below it, differences are rounding


@dataclass
class Trial:
    """One FMU of which Co-Simulation is tried."""

    description: ModelDescription
    unzipped: str

    def instance(self, **options) -> Slave:
        """A new instance."""
        return Slave(self.description, self.unzipped, **options)

    @property
    def step(self) -> float:
        """Communication step [s]: the one that the FMU names."""
        return step_of(self.description)

    @cached_property
    def inputs(self) -> list[ScalarVariable]:
        """Inputs that hold one real number each."""
        return real_inputs(self.description)

    @cached_property
    def outputs(self) -> list[ScalarVariable]:
        """Outputs that hold one number each."""
        return outputs_of(self.description)

    @cached_property
    def names(self) -> list[str]:
        """Of the outputs."""
        return [v.name for v in self.outputs]

    @cached_property
    def share(self) -> float:
        """How far inputs move, in their nominal values: 0 where the FMU does not go on with inputs that move."""
        return SHARE if self.refusal is None else 0.0

    @cached_property
    def refusal(self) -> str | None:
        """What it said when its inputs moved, None when it went on."""
        return refused(lambda: self.run(SHARE))

    def run(self, share: float | None = None) -> np.ndarray:
        """Outputs of the first steps of a new instance."""
        slave = self.instance()
        try:
            return self.advance(slave, share)
        finally:
            slave.close()

    def advance(self, slave: Slave, share: float | None = None) -> np.ndarray:
        """Outputs of the first steps, from instantiated on."""
        slave.initialise(0.0, None, {}, {})
        return np.array([self.one_step(slave, k, share) for k in range(STEPS)])

    def go_on(self, slave: Slave, done: int = STEPS) -> np.ndarray:
        """Outputs of as many steps after those that were done."""
        return np.array([self.one_step(slave, k) for k in range(done, done + STEPS)])

    def one_step(self, slave: Slave, k: int, share: float | None = None) -> list[float]:
        """Inputs are set, a step is made, outputs are read."""
        share = self.share if share is None else share
        wave = share * math.sin(0.3 * (k + 1))
        slave.write({v.name: within(v, start_of(v) + wave * size_of(v)) for v in self.inputs})
        slave.step(k * self.step, self.step)
        return slave.read(self.names)

    def require_repeats(self) -> np.ndarray:
        """The run of a fresh instance. NotTried where another fresh one does otherwise: nothing can be compared."""
        if not self.outputs:
            raise NotTried("the FMU has no output that holds a number, so runs cannot be compared")
        first, again = self.run(), self.run()
        if off(first, again) > REPEATS:
            raise NotTried("two fresh instances do not repeat each other, so there is nothing to compare with")
        return first


def in_time(items: Sequence) -> Iterator:
    """As many of them as there is time for; the first always."""
    began = time.monotonic()
    for k, item in enumerate(items):
        if k and time.monotonic() - began > ENOUGH:
            return
        yield item


def refused(work: Callable[[], object]) -> str | None:
    """What an FMU answers to ``work`` where it does not go on."""
    try:
        work()
    except (FMICallException, RuntimeError) as failure:
        return str(failure)
    return None


def step_of(description: ModelDescription) -> float:
    """The step [s] that the default experiment names."""
    experiment = description.defaultExperiment
    return float(experiment.stepSize) if experiment is not None and experiment.stepSize else STEP


def real_inputs(description: ModelDescription) -> list[ScalarVariable]:
    """Inputs that hold one real number each."""
    return [v for v in inputs_of(description) if v.type in FLOATS and not v.clocks]


def start_of(variable: ScalarVariable) -> float:
    """Its start value as a number."""
    text = str(variable.start or 0.0)
    return float(text == "true") if text in ("true", "false") else float(text)


def size_of(variable: ScalarVariable) -> float:
    """Its nominal value, its type's or 1."""
    declared = getattr(variable, "declaredType", None)
    return abs(float(variable.nominal or getattr(declared, "nominal", None) or 1.0)) or 1.0


def within(variable: ScalarVariable, value: float) -> float:
    """The nearest value that its min and max, or its type's, allow."""
    declared = getattr(variable, "declaredType", None)
    low, high = (getattr(variable, b) or getattr(declared, b, None) for b in ("min", "max"))
    value = max(value, float(low)) if low not in (None, "") else value
    return min(value, float(high)) if high not in (None, "") else value


def off(first: np.ndarray, again: np.ndarray) -> float:
    """Largest difference of any column, in its largest size in either; infinite where one alone is not finite."""
    if not first.size:
        return 0.0
    if not np.array_equal(np.isfinite(first), np.isfinite(again)):
        return math.inf
    first, again = (np.atleast_2d(np.nan_to_num(a, posinf=0.0, neginf=0.0)) for a in (first, again))
    scale = np.maximum(np.abs(first).max(axis=0), np.abs(again).max(axis=0))
    return float((np.abs(first - again).max(axis=0) / np.maximum(scale, TINY)).max())


def same(first: np.ndarray, again: np.ndarray, what: str) -> tuple[str, str]:
    """Whether two runs are one, bit by bit or as near as solvers inside come."""
    if np.array_equal(first, again, equal_nan=True):
        return PASS, f"{what}, bit by bit"
    difference = off(first, again)
    if difference <= REPEATS:
        return PASS, f"{what}, to {difference:.1g} of an output's size"
    return FAIL, f"not so: {what} (largest difference {difference:.3g} of an output's size)"
