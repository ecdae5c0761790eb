"""Several networks as one: their mean moves the outputs, each keeps hidden states of its own.

    y[k+1] = y[k] + r mean_i o_i(y[k], h_i[k], u[k])        h_i[k+1] = h_i[k] + r_i o_i(y[k], h_i[k], u[k])

Networks that are as good where they were chosen err differently elsewhere, and which of them is the best there is
chance: their mean is off by less than the mean of them. It is a network again, with blocks of zeros.
Source: Hansen, Salamon, IEEE Trans. Pattern Analysis and Machine Intelligence 12 (1990) 993-1001.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .sensitivities import Network, joined_weights


def committee(nets: Sequence[Network]) -> Network:
    """The networks, of the same inputs, outputs, rates of the outputs and samples of the encoder, as one."""
    if len(nets) == 1:
        return nets[0]
    first, ny, share = nets[0].shape, nets[0].shape.outputs, 1 / len(nets)
    hidden_states, hidden = (sum(getattr(n.shape, count) for n in nets) for count in ("hidden_states", "hidden"))
    shape = replace(first, hidden_states=hidden_states, hidden=hidden)
    parts = {name: np.zeros(size) for name, size in shape.weights.items()}
    state, unit = ny, 0
    for net in nets:
        rows = np.r_[:ny, state : state + net.shape.hidden_states]
        columns = np.r_[rows, shape.order : shape.features]
        units = np.arange(unit, unit + net.shape.hidden)
        heard, own = np.where(rows < ny, share, 1.0), net.parts
        parts["linear_weights"][np.ix_(rows, columns)] += heard[:, None] * own["linear_weights"]
        parts["output_bias"][rows] += heard * own["output_bias"]
        parts["hidden_weights"][np.ix_(units, columns)] = own["hidden_weights"]
        parts["hidden_bias"][units] = own["hidden_bias"]
        parts["output_weights"][np.ix_(rows, units)] = heard[:, None] * own["output_weights"]
        for name in ("encoder_linear_weights", "encoder_bias"):
            parts[name][rows[ny:] - ny] = own[name]
        state, unit = state + net.shape.hidden_states, unit + net.shape.hidden
    states = {
        name: np.concatenate([getattr(net, name)[ny if k else 0 :] for k, net in enumerate(nets)])
        for name in ("rate", "lower", "upper")
    }
    return Network(shape, **states, flat=joined_weights(parts, shape))
