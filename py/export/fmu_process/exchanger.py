"""One Model Exchange instance asked at points away from its run, and what the probes of such an FMU share."""

from __future__ import annotations

from collections.abc import Mapping
from ctypes import c_double
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from fmpy.model_description import ModelDescription

from .exchange import Exchange, run_exchange
from .master import FLOATS, is_scalar, outputs_of
from .trial import SHARE, real_inputs, refused, size_of, start_of, within
from .verdicts import NotTried

LATER = 0.37  # s, from the start to the other point
SECONDS, SAMPLES = 1.0, 51  # of the run


class Exchanger(Exchange):
    """One Model Exchange instance, from t = 0 in continuous-time mode."""

    def __init__(self, description: ModelDescription, unzipped: str, inputs: Mapping[str, float] | None = None):
        """``inputs`` are set before the end of initialization."""
        super().__init__(description, unzipped)
        self.inputs = moving_inputs(description)
        self.outputs = [v.name for v in continuous_outputs(description)]
        self.initialise(0.0, None, {}, inputs or {})

    def answers(self) -> np.ndarray:
        """Derivatives, then outputs, at the present point."""
        return np.r_[self.rates(), self.read(self.outputs)]

    def set(self, what: str, time: float, x: np.ndarray, u: np.ndarray):
        """One of "time", "states", "inputs" of the point (time, x, u)."""
        if what == "time":
            self.fmu.setTime(time)
        elif what == "states" and self.count:
            self.fmu.setContinuousStates((c_double * self.count)(*x), self.count)
        elif what == "inputs" and self.inputs:
            self.write({v.name: value for v, value in zip(self.inputs, u, strict=True)})

    def move(self, time: float, x: np.ndarray, u: np.ndarray):
        """To a point."""
        for what in ("time", "states", "inputs"):
            self.set(what, time, x, u)

    def nominals(self) -> np.ndarray:
        """Nominal values of the continuous states."""
        return self.vector(self.fmu.getNominalsOfContinuousStates)

    def points(self, share: float) -> tuple[tuple, tuple]:
        """The start, and a point away from it: by ``share`` of the nominal values, in time if that is not zero."""
        x, u = self.states(), np.array([start_of(v) for v in self.inputs])
        scale = np.maximum(np.abs(self.nominals()), 1e-12)
        moved = np.array([within(v, start_of(v) + share * size_of(v)) for v in self.inputs])
        return (0.0, x, u), (LATER, x + share * scale, moved)


def moving_inputs(description: ModelDescription):
    """Inputs that may be set in continuous-time mode: real and continuous."""
    return [v for v in real_inputs(description) if v.variability == "continuous"]


def continuous_outputs(description: ModelDescription):
    """Outputs of one real number each that may change in continuous-time mode."""
    return [v for v in outputs_of(description) if v.type in FLOATS and v.variability == "continuous"]


@dataclass
class ExchangeTrial:
    """One FMU of which Model Exchange is tried."""

    description: ModelDescription
    unzipped: str

    def exchange(self) -> Exchange:
        """A new instance, as it is before initialization."""
        return Exchange(self.description, self.unzipped)

    def exchanger(self, inputs: Mapping[str, float] | None = None) -> Exchanger:
        """A new instance in continuous-time mode."""
        return Exchanger(self.description, self.unzipped, inputs)

    def asked(self) -> Exchanger:
        """A new instance. NotTried where no answer could be compared."""
        exchanger = self.exchanger()
        if not exchanger.count and not exchanger.outputs:
            raise NotTried("no continuous state and no continuous output, so there is no answer to compare")
        return exchanger

    def points(self, exchanger: Exchanger) -> tuple[tuple, tuple]:
        """The start and the other point. NotTried where the FMU does not answer away from its start."""
        if self.refusal is not None:
            raise NotTried(f"a tenth of nominal away from its start it does not answer ({self.refusal})")
        return exchanger.points(SHARE)

    @cached_property
    def refusal(self) -> str | None:
        """What it says a tenth of nominal away from its start, None where it answers."""

        def ask():
            exchanger = self.exchanger()
            exchanger.move(*exchanger.points(SHARE)[1])
            if not np.isfinite(exchanger.answers()).all():
                raise RuntimeError("an answer is not finite")

        return refused(ask)

    @property
    def names(self) -> list[str]:
        """What is read of a run: outputs, or derivatives where there are none."""
        rates = [row.variable.name for row in self.description.derivatives if is_scalar(row.variable)]
        return [v.name for v in outputs_of(self.description)] or rates

    def run(self, share: float, wanted: list[str] | None = None) -> np.ndarray:
        """A second of simulation with CVODES: the variables ``wanted``, else outputs, else derivatives."""
        inputs, time = moving_inputs(self.description), np.linspace(0.0, SECONDS, SAMPLES)
        wave = share * np.sin(4 * np.pi * time)
        u = np.array([[within(v, start_of(v) + w * size_of(v)) for v in inputs] for w in wave]).reshape(SAMPLES, -1)
        names = [v.name for v in inputs]
        instance = self.exchange()
        try:
            instance.initialise(0.0, None, {}, dict(zip(names, u[0], strict=True)))
            return run_exchange(instance, time, u, names, self.names if wanted is None else wanted, names)
        finally:
            instance.close()
