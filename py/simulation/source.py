"""The C texts of the driver, which is compiled once, and of the functions of each model."""

from __future__ import annotations

import dataclasses
import re
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import casadi as ca

from hydrotwin.models.language.flat import FlatModel

from . import equations
from .control import BURST, DEEPEST, IMPLICIT_BURST, IMPLICIT_SHARE, IMPLICIT_STEPS, SMOOTH, TOLERANCE
from .equations import Directions
from .vectors import vector_text

# Friction and every smoothed corner call it: half the time of the library's, within 2 units in the last place of it.
# Near zero the Pade approximant [7/6], elsewhere 1 - 2 / (exp(2 a) + 1).
TANH = """\
#include <math.h>
static double hydrotwin_tanh(double x) {
  double a = fabs(x), s = x * x;
  if (a < 0.4)
    return x * (135135 + s * (17325 + s * (378 + s))) / (135135 + s * (62370 + s * (3150 + s * 28)));
  return copysign(a > 20 ? 1.0 : 1 - 2 / (exp(2 * a) + 1), x);
}
#define tanh hydrotwin_tanh
"""

# The driver gives every argument and takes every result: a branch for each number would double the compiler's time.
ALL_GIVEN = ((r"arg\[\d+\]\? (arg\[\d+\]\[\d+\]) : 0;", r"\1;"), (r"if \(res\[\d+\]!=0\) ", ""))

# What a library has: where its functions are, in their order.
FUNCTIONS = """
#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
void *const {name}[] = {{{functions}}};
"""


@cache
def driver_source(side_by_side: bool = False) -> str:
    """What runs every model; ``side_by_side``: many parameter sets of one at once, too."""
    texts = (
        "driver.c",
        "explicit.c",
        "sensitivities.c",
        "implicit.c",
        *(("vectors.c", "lanes.c") if side_by_side else ()),
    )
    constants = [
        f"#define SMOOTH {SMOOTH!r} /* tolerances */",
        f"#define TOLERANCE {TOLERANCE!r}",
        f"#define IMPLICIT_STEPS {IMPLICIT_STEPS} /* per sample */",
        f"#define IMPLICIT_BURST {IMPLICIT_BURST} /* steps */",
        f"#define IMPLICIT_SHARE {IMPLICIT_SHARE!r} /* of the tolerance */",
        f"#define DEEPEST {DEEPEST} /* halvings */",
        f"#define BURST {BURST} /* steps */",
    ]
    return "\n".join((*constants, *map(_text, ("model.h", *texts))))


def functions_of(flat: FlatModel, to: Directions, implicit: bool) -> dict[str, ca.Function]:
    """What a model consists of, by the names in `Model` of ``model.h``."""
    to = dataclasses.replace(to, zero=()) if implicit else to  # runs and sensitivities share its equations
    chosen = {} if implicit else {"slopes": equations.slopes(flat)}
    chosen["output"] = equations.output(flat)
    if to.count or implicit:
        chosen["rate"] = equations.linear_rate(flat, to)
    if to.count:
        chosen["seen"] = equations.linear_output(flat, to)
    return chosen


def model_source(functions: Mapping[str, ca.Function]) -> str:
    """A library of a model's functions, and ``hydrotwin_functions``: where they are."""
    names = ", ".join(function.name() for function in functions.values())
    text = _generated(functions)
    for absent, given in ALL_GIVEN:
        text = re.sub(absent, given, text)
    return "\n".join((TANH, text, FUNCTIONS.format(name="hydrotwin_functions", functions=names)))


def lanes_source(flat: FlatModel, functions: Mapping[str, ca.Function]) -> str | None:
    """The same with ``hydrotwin_lanes``, steps side by side; None where the equations have no vector form."""
    chosen = {"rk4_lanes": equations.rk4_substep(flat), "output_lanes": functions["output"]}
    texts = [vector_text(function, name) for name, function in chosen.items()]
    if None in texts:
        return None
    where = FUNCTIONS.format(name="hydrotwin_lanes", functions=", ".join(chosen))
    return "\n".join(("#include <string.h>", model_source(functions), _text("vectors.c"), *texts, where))


@cache
def _text(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def _generated(functions: Mapping[str, ca.Function]) -> str:
    options = {"with_export": False, "prefix": "hydrotwin_"}
    generator = ca.CodeGenerator("model", options)
    for function in functions.values():
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + "/")
        return (Path(folder) / "model.c").read_text(encoding="utf-8")
