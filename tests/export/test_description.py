"""modelDescription.xml, documentation and the archive."""

from __future__ import annotations

import ctypes
import dataclasses
import itertools
import os
import shutil
import subprocess
import xml.etree.ElementTree as ET
import zipfile

import pytest
from fmpy.validation import validate_fmu

from hydrotwin.export import build, export_fmu
from hydrotwin.export.build import compile_for, native_platform
from hydrotwin.export.unit_definitions import base_exponents, display_factor
from hydrotwin.models.language.errors import DeclarationError, SolveError
from hydrotwin.models.language.flat import Signal
from hydrotwin.simulation.compiler import cache_folder
from tests.export.systems import arm_record, delayed_mass, lag_block


def read(fmu, name="modelDescription.xml") -> str:
    with zipfile.ZipFile(fmu) as archive:
        return archive.read(name).decode()


def variables(fmu) -> list[ET.Element]:
    return list(ET.fromstring(read(fmu)).find("ModelVariables"))


def dependencies(fmu, tag) -> dict[str, set[str]]:
    names = [v.get("name") for v in variables(fmu)]
    structure = ET.fromstring(read(fmu)).find(f"ModelStructure/{tag}")
    return {
        names[int(u.get("index")) - 1]: {names[int(k) - 1] for k in u.get("dependencies").split()} for u in structure
    }


@pytest.mark.parametrize("name", ["cehA", "delayed mass", "stiff", "lag", "lag in MX", "network", "lag with domain"])
def test_fmpy_finds_no_problem(fmus, name):
    assert validate_fmu(str(fmus[name])) == []


def test_the_same_model_gives_the_same_bytes(fmus, systems, tmp_path):
    again = export_fmu(systems["cehA"], tmp_path / "again.fmu")
    assert again.read_bytes() == fmus["cehA"].read_bytes()


def test_another_parameter_value_gives_another_guid(fmus, systems, tmp_path):
    other = export_fmu(systems["cehA"].with_parameters({"motor.gain": 119.0}), tmp_path / "other.fmu")
    guids = {ET.fromstring(read(f)).get("guid") for f in (fmus["cehA"], other)}
    assert len(guids) == 2


def test_no_path_or_date_of_the_makers_machine_is_inside(fmus):
    with zipfile.ZipFile(fmus["cehA"]) as archive:
        assert {i.date_time[0] for i in archive.infolist()} == {1980}
        content = b"".join(archive.read(n) for n in archive.namelist())
    assert b"/tmp" not in content
    assert b"site-packages" not in content
    assert b"generationDateAndTime" not in content


def test_every_unit_is_defined_with_its_exponents(fmus):
    root = ET.fromstring(read(fmus["cehA"]))
    defined = {u.get("name"): u for u in root.find("UnitDefinitions")}
    used = {v.find("Real").get("unit") for v in root.find("ModelVariables")}
    assert used == set(defined)
    assert defined["Pa"].find("BaseUnit").attrib == {"kg": "1", "m": "-1", "s": "-2"}
    assert defined["rad/(s.V)"].find("BaseUnit").attrib == {"kg": "-1", "m": "-2", "s": "2", "A": "1", "rad": "1"}
    for variable in root.find("ModelVariables"):
        shown = variable.find("Real").get("displayUnit")
        if shown:
            assert shown in {d.get("name") for d in defined[variable.find("Real").get("unit")].findall("DisplayUnit")}


def test_a_unit_with_a_root_has_no_exponents():
    assert base_exponents("m3/(s.sqrt(Pa))") is None
    assert base_exponents("rad2/s")["rad"] == 2


def test_display_units_have_factor_and_offset():
    assert display_factor("rad", "deg")[0] == pytest.approx(57.29577951308232)
    factor, offset = display_factor("K", "degC")
    assert factor * 293.15 + offset == pytest.approx(20.0)


def test_only_what_acts_at_once_is_a_dependency_of_an_output(fmus):
    found = dependencies(fmus["delayed mass"], "Outputs")
    assert found == {
        "place": {"mass.s"},
        "seen_force": {"force", "extra"},
        "clock": {"mass.v", "time"},
    }


def test_an_input_that_is_always_late_is_no_dependency(tmp_path):
    flat = delayed_mass()
    late = [dataclasses.replace(p, bounds=(0.01, 1.0)) if p.name == "force_delay" else p for p in flat.parameters]
    fmu = export_fmu(dataclasses.replace(flat, parameters=tuple(late)), tmp_path / "late.fmu")
    assert dependencies(fmu, "Outputs")["seen_force"] == {"extra"}


def test_initial_values_depend_on_parameters_and_starts(fmus):
    found = dependencies(fmus["cehA"], "InitialUnknowns")
    assert found["arm_angle"] == {"arm.angle.start"}
    assert "precharge" in found["pressure_cap"]
    assert "motor.gain" not in found["pressure_cap"]
    assert set(dependencies(fmus["cehA"], "Derivatives")) == {n for n in found if n.startswith("der(")}


def test_time_is_listed_only_where_the_equations_read_it(fmus):
    names = {n: [v.get("causality") for v in variables(fmus[n])].count("independent") for n in ("cehA", "delayed mass")}
    assert names == {"cehA": 0, "delayed mass": 1}


def test_every_parameter_is_tunable_with_start_bounds_and_nominal(fmus, systems):
    listed = {v.get("name"): v for v in variables(fmus["cehA"])}
    for parameter in systems["cehA"].parameters:
        variable, real = listed[parameter.name], listed[parameter.name].find("Real")
        assert variable.get("variability") == "tunable"
        assert float(real.get("start")) == parameter.value
        assert float(real.get("nominal")) == parameter.nominal
        assert float(real.get("min")) == parameter.bounds[0]


def test_the_documentation_shows_sigma_source_and_provenance(systems, tmp_path):
    fmu = export_fmu(systems["delayed mass"], tmp_path / "d.fmu", provenance={"recording": "sha256 12ab"})
    page = read(fmu, "documentation/index.html")
    assert "0.125" in page
    assert "weighed &lt;twice&gt;" in page
    assert "sha256 12ab" in page
    assert "<code>mass.s.start</code>" in page


def test_the_sources_are_clean_for_the_systems_compiler(fmus, tmp_path):
    """Warnings of gcc beyond those that the export itself demands."""
    if not shutil.which("cc"):
        pytest.skip("no system compiler")
    with zipfile.ZipFile(fmus["delayed mass"]) as archive:
        archive.extractall(tmp_path)
    files = sorted(str(p) for p in (tmp_path / "sources").glob("*.c") if p.name != "functions.c")
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wshadow", "-Werror", "-Wno-unused-parameter"]
    done = subprocess.run(["cc", *flags, "-fsyntax-only", *files], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_failed_export_leaves_the_old_file_whole(systems, tmp_path):
    path = tmp_path / "kept.fmu"
    path.write_bytes(b"old")
    with pytest.raises(DeclarationError, match="linux64"):
        export_fmu(systems["lag"], path, platforms=["linux46"])
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_sources_that_do_not_compile_are_reported_with_the_compilers_words():
    with pytest.raises(SolveError, match="error"):
        compile_for("linux64", "broken", {"a.c": "int f(void) { return; "})


def test_runtime_and_equations_are_compiled_once_and_again_when_a_header_changes(monkeypatch, tmp_path):
    """For all values, steps and kinds of a model, which model.c and the faces hold."""
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", os.environ.get("ZIG_GLOBAL_CACHE_DIR", str(cache_folder() / "zig")))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYDROTWIN_CACHE", "kept")  # the compiler works in another folder than this
    call, objects = build._call, []

    def watched(line, folder=None):
        objects.extend(after for word, after in itertools.pairwise(line) if word == "-c")
        return call(line, folder)

    monkeypatch.setattr(build, "_call", watched)
    core = '#include "core.h"\n__attribute__((visibility("default"))) double seen(void) { return S + of_model(); }\n'
    equations = '#include "core.h"\ndouble of_model(void) { return value; }\n'
    for factor, shift, compiled in [(2, 1, 1), (3, 1, 1), (3, 5, 2)]:
        header = f"#define S {shift}\nextern const double value;\ndouble of_model(void);\n"
        values = f'#include "core.h"\nconst double value = {factor};\n'
        sources = {"functions.c": equations, "model.c": values, "core.c": core, "core.h": header}
        name, library = compile_for(native_platform(), f"made_{factor}_{shift}", sources)
        (tmp_path / name).write_bytes(library)
        seen = ctypes.CDLL(str(tmp_path / name)).seen
        seen.restype = ctypes.c_double
        assert seen() == shift + factor
        assert sorted(objects) == sorted(["core.c", "functions.c"] * compiled)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fmi": 4}, "Use fmi=2 or fmi=3"),
        ({"kind": "mee"}, "Did you mean 'me'"),
        ({"given": ["arm.angel"]}, "Did you mean 'arm.angle'"),
        ({"method": "rosenbrok"}, "no method 'rosenbrok'"),
    ],
)
def test_what_cannot_be_exported_is_said(systems, tmp_path, options, words):
    with pytest.raises(DeclarationError, match=words):
        export_fmu(systems["cehA"], tmp_path / "x.fmu", **options)
    assert not (tmp_path / "x.fmu").exists()


def test_two_variables_of_one_name_are_refused(systems, tmp_path):
    block = lag_block()
    twice = dataclasses.replace(block, inputs=(Signal("gain", "V"),))
    with pytest.raises(DeclarationError, match=r"'gain' \(input and parameter\)"):
        export_fmu(twice, tmp_path / "x.fmu")


def test_a_reference_needs_inputs_and_outputs(systems, tmp_path):
    record = arm_record(1.0).select(["arm_angle"])
    with pytest.raises(DeclarationError, match="lacks command"):
        export_fmu(systems["cehA"], tmp_path / "x.fmu", reference=record)
