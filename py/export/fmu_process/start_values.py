"""Whether the binary starts with the values that the description declares: one edited alone tells importers another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from fmpy.model_description import ScalarVariable

from .master import is_scalar
from .reading import Reader
from .trial import start_of
from .verdicts import FAIL, PASS, REMARK, NotTried

ROUNDED = 1e-6  # of a start value: what few digits in the description, or a Float32, may lose
NAMED = 3  # of those that differ, named at most
PARAMETERS = ("parameter", "structuralParameter")


def start_values(variables: Sequence[ScalarVariable], reader: Reader):
    """Verdict on what nobody set: parameters and constants after initialization, inputs, and states that start exactly
    there.

    A state is a remark: an event at the very start may move it; and so is an input, which most importers set.
    """
    asked = [v for v in variables if v.start is not None and is_scalar(v) and _stays(v)]
    if not asked:
        raise NotTried("no parameter, no input and no state declares a start value")
    declared, instance = np.array([start_of(v) for v in asked]), reader.ready()
    found = np.array(instance.read([v.name for v in asked]))
    instance.close()
    near = np.isclose(found, declared, rtol=ROUNDED, atol=0.0, equal_nan=True)
    wrong = sorted(np.flatnonzero(~near), key=lambda k: not _given(asked[k]))
    if not wrong:
        return PASS, f"{len(asked)} parameters, inputs and states start as declared"
    told = ", ".join(f"'{asked[k].name}' {found[k]:.9g}, declared {declared[k]:.9g}" for k in wrong[:NAMED])
    more = f" and {len(wrong) - NAMED} more" if len(wrong) > NAMED else ""
    told = f"another start value in the binary: {told}{more}. The binary is what runs: export the model again with it"
    return FAIL if _given(asked[wrong[0]]) else REMARK, told


def _given(v: ScalarVariable) -> bool:
    return v.causality in PARAMETERS or v.variability == "constant"


def _stays(v: ScalarVariable) -> bool:
    """Whether what nobody sets is as declared after the start: of FMI 2 and 3, inputs too."""
    return _given(v) or v.causality == "input" or (v.initial == "exact" and v.variability == "continuous")
