"""The C sources of an FMU: CasADi's functions, the model table, the runtime, the FMI headers."""

from __future__ import annotations

import importlib.util
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

import casadi as ca

from hydrotwin.simulation.block import INSIDE_TRAINING
from hydrotwin.simulation.control import DEEPEST, SMOOTH, TOLERANCE

from .lower import Lowered, with_adjoints
from .variables import Variable

RUNTIME = Path(__file__).parent / "runtime"
FMI_HEADERS = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
INTERFACES = {"cs": ("cs",), "me": ("me",), "both": ("me", "cs")}
_CORE = (
    "categories.c", "categories.h", "core.c", "core.h", "internal.h", "inputs.c", "history.c", "history.h", "solve.c",
    "sensitivity.c", "store.c",
)  # fmt: skip
_FACES_OF_FMI3 = ("fmi3.c", "fmi3_face.h", "fmi3_none.c", "fmi3_me.c", "fmi3_cs.c")
_FLAGS = {"cs": "HT_CO_SIMULATION", "me": "HT_MODEL_EXCHANGE"}
_METHODS = {
    "explicit": "HT_EXPLICIT", "refined": "HT_REFINED", "implicit": "HT_IMPLICIT", "adaptive": "HT_ADAPTIVE",
    "sampled": "HT_SAMPLED",
}  # fmt: skip
_WORK = ("sz_arg", "sz_res", "sz_iw", "sz_w")


def source_files(
    lowered: Lowered, variables: Sequence[Variable], guid: str, history: int, fmi: int, kind: str
) -> dict[str, str]:
    """All sources by file name; those that end in ``.c`` are to be compiled together.

    history : pieces remembered of each delayed input; when they do not reach back over the dead time, neighbouring
        pieces are merged into their mean.
    kind : "cs", "me" or "both": which faces of the runtime are put in.
    """
    lowered = with_adjoints(lowered) if fmi == 3 else lowered
    functions = _functions_c(lowered)
    model = _model_c(lowered, variables, guid, history, _work_sizes(functions), kind)
    files = {"functions.c": functions, "model.c": model}
    for name in _runtime(fmi, kind):
        files[name] = (RUNTIME / name).read_text(encoding="utf-8")
    return files | {name: _fmi_header(name) for name in FMI_HEADERS[fmi]}


def _runtime(fmi: int, kind: str) -> list[str]:
    """The files of the runtime that this FMU needs."""
    if fmi == 3:  # importers ask for every function of the standard, whatever the kind
        return [*_CORE, "exchange.c", "adjoint.c", *_FACES_OF_FMI3]
    faces = ["fmi2.c", "fmi2_face.h", *(f"fmi2_{interface}.c" for interface in INTERFACES[kind])]
    return [*_CORE, *faces, *(["exchange.c"] if kind != "cs" else [])]


def _functions_c(lowered: Lowered) -> str:
    """CasADi's C, its symbols hidden: only the FMI functions may leave the library."""
    generator = ca.CodeGenerator("functions", {"with_header": False, "main": False})
    for _, function in sorted(lowered.functions.items()):
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + "/")
        text = (Path(folder) / "functions.c").read_text(encoding="utf-8")
    return "#define CASADI_SYMBOL_EXPORT\n" + text


def _work_sizes(functions: str) -> dict[str, int]:
    """Largest work sizes over all generated functions."""
    found = {name: [int(n) for n in re.findall(rf"if \({name}\) \*{name} = (\d+)", functions)] for name in _WORK}
    sizes = {name: max(values, default=0) for name, values in found.items()}
    if not sizes["sz_arg"]:
        raise AssertionError("the generated C has no work sizes: CasADi's generator has changed")
    return sizes


def _model_c(
    lowered: Lowered, variables: Sequence[Variable], guid: str, history: int, work: dict[str, int], kind: str
) -> str:
    """Tables of names, defaults and sizes, and the one constant `ht_the_model`."""
    functions = {role: f"ht_{role}" if role in lowered.functions else "NULL" for role in _ROLES}
    declared = "\n".join(
        f"int {f}(const double **arg, double **res, long long *iw, double *w, int mem);"
        for f in functions.values()
        if f != "NULL"
    )
    counts = ", ".join(
        str(sum(v.kind == kind for v in variables))
        for kind in ("input", "parameter", "start", "output", "state", "derivative")
    )
    labels = [v.name for v in variables if v.kind != "time"] + ["time"]
    pieces = history if any(k >= 0 for k in lowered.dead_times) else 0
    nominals = [abs(s.nominal) or 1.0 for s in lowered.states]
    return f"""#include "core.h"

{declared}

static const double defaults[] = {{{_numbers(lowered.defaults)}}};
static const double unset[] = {{{_numbers(lowered.unset)}}};
static const double nominals[] = {{{_numbers(nominals)}}};
static const char *const labels[] = {{{", ".join(_text(name) for name in labels)}}};
static const int dead_time[] = {{{", ".join(map(str, (*lowered.dead_times, -1)))}}};

const ht_model ht_the_model = {{
    {_text(lowered.name)}, {_text(guid)}, {_METHODS[lowered.method]}, {" + ".join(_FLAGS[i] for i in INTERFACES[kind])},
    {counts}, /* inputs, parameters, starts, outputs, states, derivatives */
    defaults, unset, nominals, labels, dead_time,
    {pieces}, {int(any(v.kind == "time" for v in variables))}, /* history, time listed */
    {_inside(lowered)}, {lowered.step!r}, /* inside, step */
    {{{TOLERANCE!r}, {SMOOTH * TOLERANCE!r}, {DEEPEST}}}, /* refinement */
    {", ".join(functions[role] for role in _ROLES)},
    {", ".join(str(work[name] + 1) for name in _WORK)},
}};
"""


def _inside(lowered: Lowered) -> int:
    """Which output says whether a block is inside its training data; -1: none."""
    names = [s.name for s in lowered.outputs]
    return names.index(INSIDE_TRAINING) if lowered.sampled and INSIDE_TRAINING in names else -1


_ROLES = ("start", "start_forward", "output", "present", "forward", "derivative", "advance", "start_reverse", "reverse")


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(repr(float(v)) for v in (*values, 0.0))


def _text(text: str) -> str:
    """A C string literal in ASCII; the bytes of other characters as octal."""
    plain = (chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode())
    return '"' + "".join(plain) + '"'


def _fmi_header(name: str) -> str:
    """The FMI headers come with FMPy (BSD-2-Clause, Modelica Association)."""
    where = importlib.util.find_spec("fmpy").submodule_search_locations[0]
    return (Path(where) / "c-code" / name).read_text(encoding="utf-8")
