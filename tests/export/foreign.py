"""FMUs as others might have made them: ours with a piece replaced."""

from __future__ import annotations

import zipfile
from pathlib import Path

from hydrotwin.export.archive import write_archive
from hydrotwin.export.build import compile_for, native_platform


def rewritten(fmu: Path, path: Path, *, xml: dict[str, str] | None = None, c: dict[str, str] | None = None) -> Path:
    """The FMU with texts replaced in modelDescription.xml, or in fmi2.c, which is then compiled anew."""
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
            assert old in sources["fmi2.c"], old
            sources["fmi2.c"] = sources["fmi2.c"].replace(old, new)
        [binary] = [n for n in files if n.startswith("binaries/")]
        identifier = Path(binary).stem
        files[binary] = compile_for(native_platform(), identifier, sources)[1]
    return write_archive(path, files)


DO_STEP = "    (void)no_return;\n"
CRASHES = {DO_STEP: DO_STEP + "    abort();\n"}
HANGS = {DO_STEP: DO_STEP + "    while (!*(volatile int *)&no_return == 0) {}\n"}
