"""The block of formulas that a search or a selection found, their equations, and the front of error and size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.flat import Signal

from ..block_file import LearnedBlock, assemble
from ..network.narx import network_states
from ..training_data import training_box
from . import text
from .block import SYMBOLIC, Formula
from .certify import certify
from .data import Prepared
from .static_block import SCALES, STATIC

__all__ = ["certify", "equation", "formula_block", "front"]


def formula_block(
    formula: Formula, data: Prepared, records, inputs: Sequence[Signal], outputs: Sequence[Signal], period: float, name
) -> LearnedBlock:
    """The block of a formula with one expression for each output, over the scales of ``data``."""
    shape = data.shape
    counts = {"tokens": len(formula.tokens), "constants": len(formula.constants)}
    own = {"tokens": np.array(formula.tokens, float), "constants": np.array(formula.constants, float)}
    if data.static:
        kind, states, scales = STATIC, (), {key: data.scales[key] for key in SCALES}
    else:
        kind, states, scales = SYMBOLIC, network_states(shape, inputs, outputs), data.scales
        counts |= {"output_lags": shape.output_lags, "input_lags": shape.input_lags}
    return assemble(
        kind,
        scales | own,
        counts,
        name=name,
        inputs=inputs,
        outputs=outputs,
        states=states,
        parameters=(),
        period=period,
        domain=training_box(records, inputs if data.static else (*inputs, *outputs)),
    )


def equation(formula: Formula, data: Prepared, inputs, outputs, **how) -> tuple[str, str]:
    """The equations as text and as LaTeX, see `text.equation_text`."""
    return text.equation_text(formula, inputs, outputs, data.shape, data.scales, **how)


def front(selection, data: Prepared, inputs, outputs) -> list[dict]:
    """The front of error and size of every output, as the provenance holds it; errors SI."""
    rows = []
    for i, (output, found) in enumerate(zip(outputs, selection.fronts, strict=False)):
        for c in found:
            short = text.simplified(c.formula, data.shape.features)
            row = {"output": output.name, "size": c.size, "chosen": c in selection.chosen}
            row["equation"] = equation(short, data, inputs, outputs, own=[i])[0]
            rows.append(row | {"error": c.rms * float(data.scales["output_scale"][i])})
    return rows
