"""Block: a sampled system as one CasADi function, the form every learned or lowered model takes.

x[k+1], y[k] = step(x[k], u[k], p),   t[k+1] = t[k] + period
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import ParameterValue, Signal, StateVariable, changed

TRAINING_DISTANCE, INSIDE_TRAINING = "training_distance", "inside_training_domain"
ON_THE_EDGE = 1e-9  # of the box width: samples on the edge are inside


@dataclass(frozen=True)
class TrainingDomain:
    """The box of block inputs (SI) seen in training; outside it a learned block extrapolates.

    Which quantities are boxed is named in ``names`` (inputs or outputs of the block).
    """

    names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def distance(self, values: np.ndarray) -> np.ndarray:
        """How far ``values`` (n, len(names)) lie outside the box, in box widths; 0 inside. Shape (n,)."""
        low, high = np.array(self.lower), np.array(self.upper)
        width = np.where(high > low, high - low, 1.0)
        outside = np.maximum(np.maximum(low - values, values - high), 0.0) / width
        return outside.max(axis=1)


@dataclass(frozen=True, eq=False)
class Block:
    """A sampled system.

    step : ``(x, u, p) -> (x_next, y)``, CasADi function (SX or MX) with these names; y[k] belongs to u[k].
    start : ``(u, y, p) -> x``, state before the first step from the first input and first measured output.
    period : s between two steps.
    """

    name: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[StateVariable, ...]
    parameters: tuple[ParameterValue, ...]
    step: ca.Function
    start: ca.Function
    period: float
    domain: TrainingDomain | None = None
    description: str = ""
    provenance: dict = field(default_factory=dict)

    def with_inputs(self, changes: Mapping[str, Mapping]) -> Block:
        """The same block whose inputs do something else between samples, see `changed`."""
        return replace(self, inputs=changed(self.inputs, changes, self.name))

    def parameter_vector(self) -> np.ndarray:
        """Values of the block's parameters, shape (np,), SI."""
        return np.array([p.value for p in self.parameters], dtype=float)
