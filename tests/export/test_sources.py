"""An FMU made of its own sources/ folder, by what its description lists, runs as the one that was shipped."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.build import build_platform_binary
from fmpy.validation import validate_fmu
from lxml import etree

from hydrotwin.export import read_fmu
from hydrotwin.export.build import TARGETS, native_platform
from hydrotwin.simulation.compiler import cache_folder
from tests.export.systems import arm_record, command_record
from tests.export.test_agreement import names_of
from tests.export.test_description import read
from tests.export.test_inside import SCHEMAS

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Werror")
ZIG = [sys.executable, "-m", "ziglang", "cc", "-target", TARGETS[native_platform()][0], "-O2"]
COMPILERS = {"cc": ["cc"], "zig": ZIG}
KEPT = {**os.environ, "ZIG_GLOBAL_CACHE_DIR": str(cache_folder() / "zig")}  # zig makes its C library once for all tests
RECORDS = {"cehA": arm_record(0.5), "lag": command_record()}
BOTH = ("kind", "both")
KEYS = [
    ("cehA", ("fmi", 2), BOTH), ("cehA", ("fmi", 3)), ("cehA", ("fmi", 3), ("method", "implicit")), ("lag", ("fmi", 2)),
    ("lag", ("fmi", 3)),
]  # fmt: skip


def label(key) -> str:
    return " ".join([key[0], *(str(value) for _, value in key[1:])])


def in_words(value) -> str:
    return value if isinstance(value, str) else label(value)


def listed(fmu) -> list[str]:
    """The source files of the build description."""
    root = ET.fromstring(read(fmu, "sources/buildDescription.xml"))
    [configuration] = root.findall("BuildConfiguration")
    [files] = configuration.findall("SourceFileSet")
    assert files.get("language") == "C99"
    assert configuration.get("modelIdentifier") == read_identifier(fmu)
    return [f.get("name") for f in files.findall("SourceFile")]


def read_identifier(fmu) -> str:
    root = ET.fromstring(read(fmu))
    [name] = {e.get("modelIdentifier") for e in root if e.tag in ("CoSimulation", "ModelExchange")}
    return name


def unpacked_without_binaries(fmu, folder: Path) -> tuple[Path, Path]:
    """Where it was unpacked, and the place of the binary that is missing now."""
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    [binary] = [p for p in (folder / "binaries").rglob("*") if p.is_file()]
    binary.unlink()
    return folder, binary


def same_outputs(system, fmu, folder, record):
    """The FMU and what lies in the folder give the same outputs."""
    one, other = fmu, Path(shutil.make_archive(str(folder), "zip", folder)).rename(folder.with_suffix(".fmu"))
    first, second = read_fmu(one).free_run(record), read_fmu(other).free_run(record)
    for name in names_of(system):
        assert np.ptp(first[name]) > 0
        np.testing.assert_allclose(second[name], first[name], rtol=1e-9, atol=1e-9 * np.abs(first[name]).max())


@pytest.mark.parametrize(("compiler", "key"), [*(("cc", key) for key in KEYS), ("zig", KEYS[1])], ids=in_words)
def test_its_sources_compile_strictly_and_run(variants, systems, tmp_path, compiler, key):
    """With zig, which made the FMU itself, one is enough."""
    if not (shutil.which("cc") if compiler == "cc" else importlib.util.find_spec("ziglang")):
        pytest.skip(f"no {compiler}")
    fmu = variants[key]
    folder, binary = unpacked_without_binaries(fmu, tmp_path / "fmu")
    line = [*COMPILERS[compiler], *STRICT, "-shared", "-fPIC", *listed(fmu), "-o", str(binary), "-lm", "-Wl,-z,defs"]
    done = subprocess.run(line, cwd=folder / "sources", capture_output=True, text=True, check=False, env=KEPT)
    assert done.returncode == 0, done.stderr
    same_outputs(systems[key[0]], fmu, folder, RECORDS[key[0]])


@pytest.mark.parametrize("key", [("cehA", ("fmi", 2), BOTH), ("cehA", ("fmi", 3))], ids=label)
def test_fmpy_builds_it_by_its_description(variants, systems, tmp_path, key):
    """FMPy's own way from sources to a binary, with CMake."""
    if not shutil.which("cmake"):
        pytest.skip("no cmake")
    folder, binary = unpacked_without_binaries(variants[key], tmp_path / "fmu")
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build")
    assert binary.exists()
    same_outputs(systems[key[0]], variants[key], folder, RECORDS[key[0]])


@pytest.mark.parametrize("key", KEYS, ids=label)
def test_the_lists_of_sources_are_complete_and_agree(variants, key):
    fmu = variants[key]
    with zipfile.ZipFile(fmu) as archive:
        files = {n.removeprefix("sources/") for n in archive.namelist() if n.startswith("sources/") and n[-2:] == ".c"}
    assert set(listed(fmu)) == files
    root = ET.fromstring(read(fmu))
    lists = [[f.get("name") for f in e.findall("File")] for e in root.iter("SourceFiles")]
    interfaces = [e for e in root if e.tag in ("CoSimulation", "ModelExchange")]
    assert lists == ([listed(fmu)] * len(interfaces) if key[1] == ("fmi", 2) else [])
    assert all(e.get("needsExecutionTool", "false") == "false" for e in interfaces)
    schema = etree.XMLSchema(etree.parse(str(SCHEMAS / "fmi3/fmi3BuildDescription.xsd")))
    assert schema.validate(etree.fromstring(read(fmu, "sources/buildDescription.xml").encode())), schema.error_log
    assert validate_fmu(str(fmu)) == []
    [one] = {c.modelIdentifier for c in read_model_description(str(fmu)).buildConfigurations}
    assert one == read_identifier(fmu)


def test_a_static_library_of_fmi3_gets_its_prefix_by_a_definition(variants, tmp_path):
    if not shutil.which("cc"):
        pytest.skip("no system compiler")
    fmu = variants["lag", ("fmi", 3)]
    folder, _ = unpacked_without_binaries(fmu, tmp_path / "fmu")
    faces = [name for name in listed(fmu) if name.startswith("fmi")]
    subprocess.run(["cc", *STRICT, "-DFMI3_FUNCTION_PREFIX=lag_", "-c", *faces], cwd=folder / "sources", check=True)
    objects = sorted(str(p) for p in (folder / "sources").glob("*.o"))
    told = subprocess.run(["nm", "-g", "--defined-only", *objects], capture_output=True, text=True, check=True).stdout
    names = {line.split()[-1] for line in told.splitlines() if " T " in line}
    assert "lag_fmi3DoStep" in names
    assert not any(name.startswith("fmi") for name in names)
