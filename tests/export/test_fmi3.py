"""FMI 3.0: what differs from FMI 2.0 in the archive, and CasADi as an independent reader of it."""

from __future__ import annotations

import shutil
import subprocess
import xml.etree.ElementTree as ET
import zipfile

import casadi as ca
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.export.build import native_platform, platforms_named
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.simulation import simulate
from tests.export.systems import command_record, mass_record
from tests.export.test_agreement import WITHIN, largest_difference, names_of, with_linear_inputs
from tests.export.test_description import read

FMI3, ME = ("fmi", 3), ("kind", "me")


@pytest.mark.parametrize("name", ["cehA", "delayed mass", "lag", "lag in MX", "network", "lag with domain"])
def test_fmpy_finds_no_problem(variants, name):
    assert validate_fmu(str(variants[name, FMI3])) == []


@pytest.mark.parametrize("name", ["cehA", "clocked mass", "lag"])
def test_there_is_exactly_one_independent_variable(variants, name):
    root = ET.fromstring(read(variants[name, FMI3]))
    rows = list(root.find("ModelVariables"))
    assert [v.get("causality") for v in rows].count("independent") == 1
    assert {v.tag for v in rows} == {"Float64"}
    assert [int(v.get("valueReference")) for v in rows] == list(range(len(rows)))
    assert {v.get("unit") for v in rows} == {u.get("name") for u in root.find("UnitDefinitions")}


def test_folders_are_tuples_and_the_sources_say_how_to_build(variants, tmp_path):
    fmu = variants["cehA", FMI3]
    with zipfile.ZipFile(fmu) as archive:
        names = archive.namelist()
        archive.extractall(tmp_path)
    [binary] = [n for n in names if n.startswith("binaries/")]
    assert binary.split("/")[1] in (
        "x86_64-linux",
        "aarch64-linux",
        "x86_64-windows",
        "x86_64-darwin",
        "aarch64-darwin",
    )
    listed = {e.get("name") for e in ET.fromstring(read(fmu, "sources/buildDescription.xml")).iter("SourceFile")}
    assert listed == {n.removeprefix("sources/") for n in names if n.endswith(".c")}
    if not shutil.which("cc"):
        pytest.skip("no system compiler")
    files = sorted(str(tmp_path / "sources" / n) for n in listed if n != "functions.c")
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wshadow", "-Werror", "-Wno-unused-parameter"]
    done = subprocess.run(["cc", *flags, "-fsyntax-only", *files], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_same_model_gives_the_same_bytes(variants, systems, tmp_path):
    again = export_fmu(systems["cehA"], tmp_path / "again.fmu", fmi=3)
    assert again.read_bytes() == variants["cehA", FMI3].read_bytes()


def test_delayed_inputs_equal_simulate(variants, systems):
    flat = with_linear_inputs(systems["delayed mass"], [])
    block = with_linear_inputs(read_fmu(variants["delayed mass", FMI3]), [])
    record = mass_record()
    assert largest_difference(block.free_run(record), simulate(flat, record), names_of(flat)) < WITHIN


def test_a_block_starts_where_its_recording_starts_and_equals_simulate(variants, systems):
    record = command_record()
    found, expected = read_fmu(variants["lag", FMI3]).free_run(record), simulate(systems["lag"], record)
    for output in names_of(systems["lag"]):
        np.testing.assert_allclose(found[output], expected[output], rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("name", ["cehA", "clocked mass"])
def test_casadis_importer_reads_model_exchange_and_evaluates_the_same(variants, systems, tmp_path, name):
    """Values, Jacobians (through our directional derivatives) and adjoints of the two functions, at t != 0."""
    flat = systems[name]
    with zipfile.ZipFile(variants[name, ME, FMI3]) as archive:
        archive.extractall(tmp_path)
    dae = ca.DaeBuilder("imported", str(tmp_path))
    assert list(dae.x()) == [s.name for s in flat.states]
    assert list(dae.p())[: len(flat.parameters)] == [p.name for p in flat.parameters]
    imported = dae.create("f", ["t", "x", "u"], ["ode", "y"])
    p, u = flat.parameter_vector(), 0.4
    x = np.array(flat.start_given(())([0.0], p, [])).ravel() + 0.1 * np.array([s.nominal for s in flat.states])
    expected = flat.ode(1.7, x, u, p)
    for found, wanted in zip(imported(1.7, x, u), expected, strict=True):
        np.testing.assert_allclose(found.full(), wanted.full(), rtol=1e-14)
    jacobian, wanted = imported.jacobian(), flat.ode.jacobian()
    entries = dict(zip(jacobian.name_out(), jacobian(1.7, x, u, 0, 0), strict=True))
    exact = dict(zip(wanted.name_out(), wanted(1.7, x, u, p, 0, 0), strict=True))
    for known in "txu":
        for mine, theirs in (("ode", "xdot"), ("y", "y")):
            one, other = entries[f"jac_{mine}_{known}"].full(), exact[f"jac_{theirs}_{known}"].full()
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12 * np.abs(other).max())
    seeds = [np.arange(1.0, len(x) + 1), np.linspace(-1.0, 1.0, len(flat.outputs))]
    found = imported.reverse(1)(1.7, x, u, *imported(1.7, x, u), *seeds)
    wanted = flat.ode.reverse(1)(1.7, x, u, p, *expected, *seeds)
    for one, other in zip(found, wanted[:3], strict=True):
        np.testing.assert_allclose(one.full(), other.full(), rtol=1e-10)


@pytest.mark.parametrize("fmi", [2, 3])
def test_another_machine_gets_its_own_library(systems, tmp_path, fmi):
    """The machine that an ELF file is for stands at byte 18: 0x3e is x86-64, 0xb7 is AArch64."""
    pytest.importorskip("ziglang")
    fmu = export_fmu(systems["clocked mass"], tmp_path / "x.fmu", fmi=fmi, platforms=["linux64", "aarch64-linux"])
    with zipfile.ZipFile(fmu) as archive:
        found = {n.split("/")[1]: archive.read(n)[18] for n in archive.namelist() if n.startswith("binaries/")}
    assert found == {"linux64" if fmi == 2 else "x86_64-linux": 0x3E, "aarch64-linux": 0xB7}
    assert validate_fmu(str(fmu)) == []


def test_platforms_have_names_in_both_versions():
    assert platforms_named(None) == (native_platform(),)
    assert platforms_named(["x86_64-linux", "linux64", "x86_64-windows"]) == ("linux64", "win64")
    assert len(platforms_named(["all"])) == 5
    with pytest.raises(DeclarationError, match="Did you mean 'x86_64-linux'"):
        platforms_named(["x86-64-linux"])
