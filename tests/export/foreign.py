"""FMUs as others might have made them: ours with a piece replaced."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import zipfile
from pathlib import Path

import casadi as ca

from hydrotwin.export.archive import write_archive
from hydrotwin.export.build import compile_for, native_platform


def rewritten(fmu: Path, path: Path, *, xml: dict[str, str] | None = None, c: dict[str, str] | None = None) -> Path:
    """The FMU with texts replaced in modelDescription.xml, or in the C of a face, then compiled anew."""
    with zipfile.ZipFile(fmu) as archive:
        files: dict[str, str | bytes] = {n: archive.read(n) for n in archive.namelist()}
    description = files["modelDescription.xml"].decode()
    for old, new in (xml or {}).items():
        assert old in description, old
        description = description.replace(old, new)
    files["modelDescription.xml"] = description
    if c:
        sources = {n.removeprefix("sources/"): t.decode() for n, t in files.items() if n.startswith("sources/")}
        for old, new in c.items():
            [file] = [
                n
                for n, text in sources.items()
                if n.startswith(("fmi", "adjoint", "exchange", "sensitivity")) and old in text
            ]
            sources[file] = sources[file].replace(old, new)
        [binary] = [n for n in files if n.startswith("binaries/")]
        identifier = Path(binary).stem
        files[binary] = compile_for(native_platform(), identifier, sources)[1]
    return write_archive(path, files)


DO_STEP = "    (void)no_return;\n"
CRASHES = {DO_STEP: DO_STEP + "    {\n        extern void abort(void);\n        abort();\n    }\n"}
SWALLOWS_NAN = {
    "/* ---- variables: all are Real ---- */": "#include <math.h>\nstatic int poisoned = 0;\n",
    "return ht2_answer(c, ht_set(&((component *)c)->core, vr, n, value));": (
        "if (n > 0 && value[0] != value[0]) {\n        poisoned = 1;\n        return fmi2OK;\n    }\n"
        "    return ht2_answer(c, ht_set(&((component *)c)->core, vr, n, value));"
    ),
    "return ht2_answer(c, ht_get(&((component *)c)->core, vr, n, value));": (
        "if (poisoned) {\n        size_t k;\n        for (k = 0; k < n; k++) value[k] = sqrt(-1.0);\n"
        "        return fmi2OK;\n    }\n    return ht2_answer(c, ht_get(&((component *)c)->core, vr, n, value));"
    ),
}
ANSWER = 'present mode", known[k]);\n        sensitivity[k] = from[kind][i];'
WRONG_ADJOINT = {ANSWER: ANSWER.replace("from[kind][i]", "1.5 * from[kind][i] + 0.1")}
SPREAD = "    memset(dx, 0, ht_scratch_doubles(m) * sizeof(double));\n"
WRONG_DIRECTION = {SPREAD: SPREAD + "    dx[0] = 0.1;\n"}
SET_TIME = "    ht_values(s, HT_TIME)[0] = time;\n"
STALE_AFTER_TIME = {SET_TIME + "    ht_book(s)[STALE] = 1.0;\n": SET_TIME}
LOAD = "ht_load(&((component *)c)->core, state)) : fmi2Error;"
KEEPS_NO_STATE = {LOAD: "HT_OK) : fmi2Error;"}
# after a reset the states are not those of the start but those of the run before
RESET = "    ht_reset(&((component *)c)->core);\n    return fmi2OK;\n"
LEAVE = "    fmi2Status status = c ? ht2_answer(c, ht_exit_initialisation(&((component *)c)->core)) : fmi2Error;\n"
STATES = (
    "((component *)c)->core.data + ht_variables(&ht_the_model) - 1 - ht_the_model.derivatives - ht_the_model.states"
)
RESET_KEEPS_STATE = {
    RESET: f"    memcpy(kept, {STATES}, ht_the_model.states * sizeof(double));\n    again = 1;\n{RESET}",
    LEAVE: f"{LEAVE}    if (again) memcpy({STATES}, kept, ht_the_model.states * sizeof(double)), again = 0;\n",
    "/* ---- life ---- */": "static double kept[64];\nstatic int again = 0;\n",
}
HANGS = {DO_STEP: DO_STEP + "    while (!*(volatile int *)&no_return == 0) {}\n"}


def fmi3_model_exchange(folder: Path) -> Path:
    """``x' = u - 2 x, y = x`` as CasADi exports it: FMI 3.0, Model Exchange."""
    dae = ca.DaeBuilder("lag3")
    u, x = dae.add("u", "input", {"start": 0.0}), dae.add("x", "local", {"start": 1.0})
    y = dae.add("y", "output")
    dae.eq(dae.der(x), u - 2.0 * x)
    dae.eq(y, x)
    here = Path.cwd()
    os.chdir(folder)
    try:
        files = {stored.removeprefix("./"): (folder / local).read_bytes() for local, stored in dae.export_fmu().items()}
    finally:
        os.chdir(here)
    headers = Path(importlib.util.find_spec("fmpy").submodule_search_locations[0]) / "c-code"
    library = folder / "lag3.so"
    line = ["cc", "-shared", "-fPIC", "-w", f"-I{headers}", "lag3.c", "lag3_wrap.c", "-o", str(library), "-lm"]
    subprocess.run(line, cwd=folder, check=True)
    return write_archive(folder / "lag3.fmu", files | {"binaries/x86_64-linux/lag3.so": library.read_bytes()})
