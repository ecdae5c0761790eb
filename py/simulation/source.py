"""The C text of one model: sizes, sparsity tables, CasADi functions, driver."""

from __future__ import annotations

import tempfile
from pathlib import Path

import casadi as ca

from hydrotwin.models.language.flat import FlatModel

from . import equations
from .equations import Directions

DRIVER = Path(__file__).with_name("driver.c").read_text(encoding="utf-8")


def c_source(flat: FlatModel, to: Directions, implicit: bool) -> str:
    """Everything in one translation unit, so that the compiler can inline the model into the loop."""
    functions = _functions(flat, to, implicit)
    lines = [*_sizes(flat, to), f"#define IMPLICIT {int(implicit)}"]
    for prefix, function in functions.items():
        lines += [f"#define {prefix}_ARG {function.sz_arg()}", f"#define {prefix}_RES {function.sz_res()}"]
    lines.append(f"#define WORK_REALS {max(f.sz_w() for f in functions.values())}")
    lines.append(f"#define WORK_INTEGERS {max(f.sz_iw() for f in functions.values())}")
    if to.count:
        lines += _tables("F", functions["RATE"]) + _tables("H", functions["SEEN"])
    return "\n".join((_generated(functions), *lines, DRIVER))


def _functions(flat: FlatModel, to: Directions, implicit: bool) -> dict[str, ca.Function]:
    chosen = {"IMPLICIT": equations.implicit_substep(flat)} if implicit else {"RK4": equations.rk4_substep(flat)}
    chosen["OUTPUT"] = equations.output(flat)
    if to.count:
        chosen["RATE"] = equations.linear_rate(flat, to)
        chosen["SEEN"] = equations.linear_output(flat, to)
        if implicit:
            chosen["TANGENT"] = equations.implicit_tangent(flat, to)
    return chosen


def _generated(functions: dict[str, ca.Function]) -> str:
    options = {"with_export": False, "prefix": "hydrotwin_"}
    generator = ca.CodeGenerator("model", options)
    for function in functions.values():
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + "/")
        return (Path(folder) / "model.c").read_text(encoding="utf-8")


def _sizes(flat: FlatModel, to: Directions) -> list[str]:
    sizes = {
        "NX": len(flat.states),
        "NU": len(flat.inputs),
        "NP": len(flat.parameters),
        "NY": len(flat.outputs),
        "NT": to.count,
        "LD": -(-to.count // 4) * 4,
        "ND": len(to.dead),
    }
    delay = [-1 if d is None else d for d in equations.delays(flat)]
    return [
        *(f"#define {name} {size}" for name, size in sizes.items()),
        _table("DELAY", delay),
        _table("LINEAR", [int(s.interpolation == "linear") for s in flat.inputs]),
        _table("DEAD_INPUT", [j for j, _ in to.dead]),
        _table("DEAD_COLUMN", [column for _, column in to.dead]),
    ]


def _tables(prefix: str, linear: ca.Function) -> list[str]:
    lines = []
    for name, which in (("X", 1), ("P", 2), ("U", 3)):
        rows, columns = linear.sparsity_out(which).get_triplet()
        lines += [
            f"#define {prefix}{name}_NNZ {len(rows)}",
            _table(f"{prefix}{name}_ROW", rows),
            _table(f"{prefix}{name}_COL", columns),
        ]
    return lines


def _table(name: str, values) -> str:
    return f"static const int {name}[] = {{{', '.join(map(str, [*values, 0]))}}};"
