"""What else an FMU carries: types, icon, terminals, licences, documentation, by the schemas of the standard."""

from __future__ import annotations

import dataclasses
import importlib.util
import struct
import xml.etree.ElementTree as ET
import zipfile
import zlib
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from fmus.shipped import HERE, read_shipped
from hydrotwin.export import export_fmu
from hydrotwin.export.unit_definitions import display_factor
from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable, fixed_start
from tests.export.test_description import read

SCHEMAS = Path(importlib.util.find_spec("fmpy").submodule_search_locations[0]) / "schema"
BOTH, FMI3 = ("kind", "both"), ("fmi", 3)


@pytest.fixture(scope="module")
def leaking(tmp_path_factory):
    """The shipped model with the named effect, FMI 3."""
    shipped = read_shipped(HERE / "cehA_internal_leakage")
    return export_fmu(
        shipped.load(), tmp_path_factory.mktemp("leaking") / "leaking.fmu", fmi=3, kind="both", licence="CC-BY-4.0"
    )


def problems(text: str, schema: str) -> list[str]:
    checker = etree.XMLSchema(etree.parse(str(SCHEMAS / schema)))
    return [] if checker.validate(etree.fromstring(text.encode())) else [str(e) for e in checker.error_log]


@pytest.mark.parametrize("name", ["cehA", "lag", "clocked mass"])
def test_every_description_meets_its_schema(variants, fmus, name):
    assert problems(read(fmus[name]), "fmi2/fmi2ModelDescription.xsd") == []
    fmu = variants[name, FMI3]
    assert problems(read(fmu), "fmi3/fmi3ModelDescription.xsd") == []
    assert problems(read(fmu, "sources/buildDescription.xml"), "fmi3/fmi3BuildDescription.xsd") == []
    terminals = read(fmu, "terminalsAndIcons/terminalsAndIcons.xml")
    assert problems(terminals, "fmi3/fmi3TerminalsAndIcons.xsd") == []
    assert problems(terminals.replace('variableKind="signal"', ""), "fmi3/fmi3TerminalsAndIcons.xsd") != []


def reals(fmu, fmi: int) -> list[tuple[str, ET.Element]]:
    root = ET.fromstring(read(fmu))
    if fmi == 3:
        return [(v.get("name"), v) for v in root.find("ModelVariables")]
    return [(v.get("name"), v.find("Real")) for v in root.find("ModelVariables")]


def types(fmu, fmi: int) -> dict[str, ET.Element]:
    listed = ET.fromstring(read(fmu)).find("TypeDefinitions")
    return {t.get("name"): t if fmi == 3 else t.find("Real") for t in listed}


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_variable_and_its_type_say_the_same(variants, fmi):
    fmu = variants["cehA", ("fmi", fmi)]
    defined, used = types(fmu, fmi), set()
    for name, variable in reals(fmu, fmi):
        if variable.get("declaredType") is None:
            continue
        kind = defined[variable.get("declaredType")]
        used.add(variable.get("declaredType"))
        assert all(kind.get(a) == variable.get(a) for a in ("unit", "displayUnit")), name
        assert float(kind.get("min", "-inf")) <= float(variable.get("min", "-inf")), name
        assert float(kind.get("max", "inf")) >= float(variable.get("max", "inf")), name
    assert used == set(defined)
    assert defined["Pressure"].get("quantity") == "Pressure"
    assert defined["Area"].get("min") is not None
    assert defined["Pressure"].get("min") is None  # the states have no bound, and would inherit it


def gauges() -> FlatModel:
    """Outputs in all the units that have a word of their own for display; one is named like a type."""
    outputs = {"Pressure": "Pa", "angle": "rad", "stroke": "m", "flow": "m3/s", "speed": "rad/s", "warm": "K"}
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("p")
    return FlatModel(
        name="gauges",
        inputs=(Signal("signals", "1"),),
        outputs=tuple(Signal(name, unit) for name, unit in outputs.items()),
        states=(StateVariable("x", "1"),),
        parameters=(ParameterValue("rate", 1.0, "1/s", (0.0, 10.0)),),
        ode=ca.Function("ode", [t, x, u, p], [p * (u - x), ca.repmat(x, 6, 1)], ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=fixed_start([0.0], ["x"], 1, 1),
    )


@pytest.mark.parametrize("fmi", [2, 3])
def test_everything_is_shown_in_the_units_people_use(tmp_path, fmi):
    fmu = export_fmu(gauges(), tmp_path / "gauges.fmu", fmi=fmi)
    assert validate_fmu(str(fmu)) == []
    shown = {name: variable.get("displayUnit") for name, variable in reals(fmu, fmi)}
    expected = {"Pressure": "bar", "angle": "deg", "stroke": "mm", "flow": "L/min", "speed": "rpm", "warm": None}
    assert shown.items() >= expected.items()
    assert "Pressure" not in types(fmu, fmi)
    assert types(fmu, fmi)["Pressure_"].get("quantity") == "Pressure"
    defined = {d.get("name"): float(d.get("factor")) for d in ET.fromstring(read(fmu)).iter("DisplayUnit")}
    assert {n: defined[n] for n in ("bar", "mm", "L/min")} == {"bar": 1e-5, "mm": 1e3, "L/min": 6e4}
    if fmi == 3:
        terminals = ET.fromstring(read(fmu, "terminalsAndIcons/terminalsAndIcons.xml"))
        assert [t.get("name") for t in terminals.iter("Terminal")] == ["signals_"]


def test_a_factor_is_rounded_only_where_rounding_made_it_long():
    assert display_factor("m3", "L") == (1000.0, 0.0)
    assert display_factor("rad", "deg")[0] == 180.0 / np.pi


@pytest.mark.parametrize("name", ["cehA", "lag"])
def test_the_terminal_has_every_input_and_output_and_nothing_else(variants, name):
    fmu = variants[name, FMI3]
    terminals = ET.fromstring(read(fmu, "terminalsAndIcons/terminalsAndIcons.xml"))
    members = [(m.get("variableName"), m.get("memberName")) for m in terminals.iter("TerminalMemberVariable")]
    outside = [n for n, v in reals(fmu, 3) if v.get("causality") in ("input", "output")]
    assert members == [(n, n) for n in outside]


def pixels(data: bytes) -> np.ndarray:
    """An 8-bit RGB PNG without filters, read by the rules of its specification."""
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    at, found = 8, {}
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        assert struct.unpack(">I", data[at + 8 + size : at + 12 + size])[0] == zlib.crc32(data[at + 4 : at + 8 + size])
        found[kind] = data[at + 8 : at + 8 + size]
        at += 12 + size
    width, height, *rest = struct.unpack(">IIBBBBB", found[b"IHDR"])
    assert rest == [8, 2, 0, 0, 0]
    rows = np.frombuffer(zlib.decompress(found[b"IDAT"]), np.uint8).reshape(height, 1 + 3 * width)
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(height, width, 3)


def test_the_icon_is_where_each_version_looks_for_it(variants, fmus):
    found = {}
    for name in ("cehA", "lag"):
        with zipfile.ZipFile(fmus[name]) as two, zipfile.ZipFile(variants[name, FMI3]) as three:
            found[name] = two.read("model.png")
            assert found[name] == three.read("terminalsAndIcons/icon.png")
            assert "model.png" not in three.namelist()
        drawn = pixels(found[name])
        assert drawn.shape == (128, 128, 3)
        assert 0.02 < (drawn != 255).any(2).mean() < 0.6
    assert found["cehA"] != found["lag"]


@pytest.mark.parametrize("options", [(), (BOTH,), (FMI3, BOTH)])
def test_two_builds_are_the_same_bytes(systems, variants, tmp_path, options):
    again = export_fmu(systems["clocked mass"], tmp_path / "again.fmu", **dict(options))
    assert again.read_bytes() == variants["clocked mass", *options].read_bytes()


def test_the_documentation_has_equations_effect_intervals_hashes_and_licences(leaking):
    page = read(leaking, "documentation/index.html")
    assert "der(cap_pressure) = oil.bulk_modulus/" in page
    assert "<code>q = G (p_a - p_b)</code>" in page
    assert "Merritt" in page
    assert "0.0299987  (0.0299908 … 0.0300066) s" in page
    assert "17450.4  (17380.6 … 17520.1) bar" in page
    assert "22e4b36e9e6da5d23ae38f9cfc559359af73855656536dcae68dd4b83bf966d1" in page
    for text in (page, read(leaking, "documentation/licenses/license.txt")):
        assert "equations and parameter values" in text
        assert "CC-BY-4.0" in text
        assert "BSD-2-Clause" in text
        assert "MIT-0" in text


def test_the_licence_file_has_the_text_of_the_projects_own_licence(leaking):
    own = (HERE.parent / "LICENSE").read_text(encoding="utf-8")
    inside = read(leaking, "documentation/licenses/license.txt")
    assert " ".join(own.split()) in " ".join(inside.split())


def test_what_has_no_equations_to_show_says_so(fmus, systems, tmp_path):
    assert "None were given" in read(fmus["delayed mass"], "documentation/index.html")
    told = export_fmu(systems["lag"], tmp_path / "told.fmu", equations="y[k] < x[k]")
    assert "<pre>y[k] &lt; x[k]</pre>" in read(told, "documentation/index.html")


def test_a_bound_that_every_variable_has_is_one_of_the_type(tmp_path):
    lag = ParameterValue("lag", 2.0, "s", (0.5, 4.0), nominal=2.0)
    time = types(export_fmu(dataclasses.replace(gauges(), parameters=(lag,)), tmp_path / "x.fmu"), 2)["Time"]
    assert time.attrib == {"quantity": "Time", "unit": "s", "min": "0.5", "max": "4.0", "nominal": "2.0"}
