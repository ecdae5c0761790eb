"""What a network looks at: its period, lags and delay, and whether its outputs integrate."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from .free_run import weight_arrays
from .narx import NarxShape


@dataclass(frozen=True)
class Form:
    """The choices behind a network; periods in s, lags and delay in periods.

    integrates : the linear part does not see the outputs, so that it moves alike wherever they are. places : the hidden
    units see them. delay : samples of the inputs, from the newest on, that are not looked at; they are among
    ``input_lags``.
    """

    period: float
    output_lags: int
    input_lags: int
    delay: int = 0
    integrates: bool = False
    places: bool = True
    hidden: int = 0

    def shape(self, inputs: int, outputs: int) -> NarxShape:
        """The counts of its arrays."""
        return NarxShape(inputs, outputs, self.output_lags, self.input_lags, self.hidden)

    def with_hidden(self, hidden: int, places: bool = True) -> Form:
        """The same with hidden units."""
        return replace(self, hidden=hidden, places=places)

    def trained(self, inputs: int, outputs: int) -> np.ndarray:
        """Positions (P,) of the trained weights in the flat vector; all others stay zero."""
        shape = self.shape(inputs, outputs)
        flags = np.ones(shape.size, dtype=bool)
        W1, _, _, W, _ = weight_arrays(flags, shape)
        unseen = slice(shape.fed_back, shape.fed_back + self.delay * inputs)
        W1[:, unseen] = W[:, unseen] = False
        if self.integrates:
            W[:, :outputs] = False
        if not self.places:
            W1[:, :outputs] = False
        return np.flatnonzero(flags)

    def told(self) -> dict:
        """For the provenance."""
        return asdict(self)
