"""The C text of one model: sizes, sparse products, CasADi functions, driver, sensitivities, implicit steps."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

import casadi as ca

from hydrotwin.models.language.flat import FlatModel

from . import equations
from .control import BURST, DEEPEST, IMPLICIT_BURST, IMPLICIT_SHARE, IMPLICIT_STEPS, SMOOTH, TOLERANCE
from .equations import Directions
from .vectors import vector_text

DRIVER, SENSITIVITIES, IMPLICIT, VECTORS, WALK_OF_LANES = (
    Path(__file__).with_name(name).read_text(encoding="utf-8")
    for name in ("driver.c", "sensitivities.c", "implicit.c", "vectors.c", "lanes.c")
)

# Friction and every smoothed corner call it: half the time of the library's, within 2 units in the last place of it.
# Near zero the Pade approximant [7/6], elsewhere 1 - 2 / (exp(2 a) + 1).
TANH = """\
#include <math.h>
static inline double hydrotwin_tanh(double x) {
  double a = fabs(x), s = x * x;
  if (a < 0.4)
    return x * (135135 + s * (17325 + s * (378 + s))) / (135135 + s * (62370 + s * (3150 + s * 28)));
  return copysign(a > 20 ? 1.0 : 1 - 2 / (exp(2 * a) + 1), x);
}
#define tanh hydrotwin_tanh
"""


def c_source(flat: FlatModel, to: Directions, implicit: bool) -> str:
    """Everything in one translation unit, so that the compiler can inline the model into the loop."""
    to = dataclasses.replace(to, zero=()) if implicit else to  # runs and sensitivities share its equations
    functions = _functions(flat, to, implicit)
    kept = list(range(len(flat.states))) if implicit else equations.states_with_rows(flat, to)
    lines = [*_sizes(flat, to, kept, implicit), f"#define IMPLICIT {int(implicit)}"]
    for prefix, function in functions.items():
        lines += [f"#define {prefix}_ARG {function.sz_arg()}", f"#define {prefix}_RES {function.sz_res()}"]
    lines.append(f"#define WORK_REALS {max(f.sz_w() for f in functions.values())}")
    lines.append(f"#define WORK_INTEGERS {max(f.sz_iw() for f in functions.values())}")
    row = {i: position for position, i in enumerate(kept)}
    if to.count or implicit:
        lines += _products("F", functions["RATE"], row, row)
    if to.count:
        lines += _products("H", functions["SEEN"], {i: i for i in range(len(flat.outputs))}, row)
    walks = (DRIVER, SENSITIVITIES if to.count else "", IMPLICIT if implicit else "")
    return "\n".join((TANH, _generated(functions), *lines, *walks))


def lanes_source(flat: FlatModel) -> str | None:
    """The explicit runs of many parameter sets side by side; None where the equations have no vector form."""
    to = equations.directions(flat, (), ())
    functions = {"rk4_lanes": equations.rk4_substep(flat), "output_lanes": equations.output(flat)}
    texts = [vector_text(function, name) for name, function in functions.items()]
    return None if None in texts else "\n".join((c_source(flat, to, False), VECTORS, *texts, WALK_OF_LANES))


def _functions(flat: FlatModel, to: Directions, implicit: bool) -> dict[str, ca.Function]:
    chosen = {} if implicit else {"RK4": equations.rk4_substep(flat)}
    chosen["OUTPUT"] = equations.output(flat)
    if to.count or implicit:
        chosen["RATE"] = equations.linear_rate(flat, to)
    if to.count:
        chosen["SEEN"] = equations.linear_output(flat, to)
    return chosen


def _generated(functions: dict[str, ca.Function]) -> str:
    options = {"with_export": False, "prefix": "hydrotwin_"}
    generator = ca.CodeGenerator("model", options)
    for function in functions.values():
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + "/")
        return (Path(folder) / "model.c").read_text(encoding="utf-8")


def _sizes(flat: FlatModel, to: Directions, kept: list[int], implicit: bool) -> list[str]:
    sizes = {
        "NX": len(flat.states),
        "NS": len(kept),
        "NU": len(flat.inputs),
        "NP": len(flat.parameters),
        "NY": len(flat.outputs),
        "NT": to.count,
        "LD": -(-to.count // 2) * 2,
        "ND": len(to.dead),
        "NZ": len(to.zero),
    }
    sizes["CUT"] = int(any(s.dead_time and (s.held or implicit) for s in flat.inputs))
    sizes["MOVING"] = sizes["NX"] + sizes["NS"] * sizes["LD"]
    delay = [-1 if d is None else d for d in equations.delays(flat)]
    return [
        *(f"#define {name} {size}" for name, size in sizes.items()),
        f"#define SMOOTH {SMOOTH!r} /* tolerances */",
        f"#define TOLERANCE {TOLERANCE!r}",
        f"#define IMPLICIT_STEPS {IMPLICIT_STEPS} /* per sample */",
        f"#define IMPLICIT_BURST {IMPLICIT_BURST} /* steps */",
        f"#define IMPLICIT_SHARE {IMPLICIT_SHARE!r} /* of the tolerance */",
        f"#define DEEPEST {DEEPEST} /* halvings */",
        f"#define BURST {BURST} /* steps */",
        _table("NOMINAL", [repr(float(s.nominal)) for s in flat.states], "double"),
        _table("FREE", [*to.parameters, *(-1 for _ in to.states)]),
        _table("NOMINAL_FREE", map(repr, _nominals(flat, to)), "double"),
        _table("DELAY", delay),
        _table("LINEAR", [int(not s.held) for s in flat.inputs]),
        _table("KEPT", kept),
        _table("ZERO", to.zero),
        _table("DEAD_INPUT", [j for j, _ in to.dead]),
        _table("DEAD_COLUMN", [column for _, column in to.dead]),
    ]


def _nominals(flat: FlatModel, to: Directions) -> list[float]:
    free = [flat.parameters[i] for i in to.parameters] + [flat.states[i] for i in to.states]
    return [float(one.nominal) for one in free]


def _products(prefix: str, linear: ca.Function, row: dict[int, int], seed: dict[int, int]) -> list[str]:
    """The sparse products of the sensitivities, unrolled into macros:

    ``FX_ROWS(ROW)`` calls ``ROW(i, sum)`` for each row i of df/dx times the seeds, the sum written with ``ENTRY(e)``
    and ``SEED(j)``; ``FP_EACH(ADD)`` and ``FU_EACH(ADD)`` call ``ADD(e, i, j)`` for each nonzero e at row i, column j.
    ``row`` and ``seed`` are where the rows of the matrix and of the seeds are kept; others are left out.
    """
    sums: dict[int, list[str]] = {i: [] for i in row.values()}
    for e, (i, j) in enumerate(zip(*linear.sparsity_out(1).get_triplet(), strict=True)):
        if i in row:
            sums[row[i]].append(f"ENTRY({e}) * SEED({seed[j]})")
    lines = [f"#define {prefix}X_ROWS(ROW) " + " ".join(f"ROW({i}, {' + '.join(r) or '0.0'})" for i, r in sums.items())]
    for name, which in (("X", 1), ("P", 2), ("U", 3)):
        entries = enumerate(zip(*linear.sparsity_out(which).get_triplet(), strict=True))
        each = " ".join(f"ADD({e}, {row[i]}, {j})" for e, (i, j) in entries if i in row)
        lines += [f"#define {prefix}{name}_NNZ {linear.nnz_out(which)}", f"#define {prefix}{name}_EACH(ADD) {each}"]
    return lines


def _table(name: str, values, kind: str = "int") -> str:
    return f"static const {kind} {name}[] = {{{', '.join(map(str, [*values, 0]))}}};"
