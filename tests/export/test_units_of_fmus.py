"""What the numbers of an FMU stand for: its own definitions of units count, as FMI has it, and not their names."""

from __future__ import annotations

import re
import zipfile
from types import SimpleNamespace

import pytest
from fmpy.model_description import BaseUnit, ModelDescription, ScalarVariable, SimpleType, Unit

from hydrotwin.comparison.varied import with_values
from hydrotwin.export import check_fmu, export_fmu, read_fmu
from hydrotwin.export.fmu_settings import own_value
from hydrotwin.export.parameter_sets import parameters_of
from hydrotwin.export.unit_meanings import is_difference, meaning_of, redefined
from hydrotwin.models.language import Component, Model, Output, Parameter
from hydrotwin.models.language.errors import UnitError
from tests.export.foreign import rewritten


def meaning(name: str, base: BaseUnit | None, relative: bool = False, chosen: str | None = None):
    described = ModelDescription(unitDefinitions=[Unit(name, base)])
    return meaning_of(ScalarVariable("x", 0, unit=name, relativeQuantity=relative), described, chosen)


@pytest.mark.parametrize(
    ("name", "base", "expected"),
    [
        ("C", BaseUnit(K=1, offset=273.15), ("K", 1.0, 273.15)),  # no coulomb
        ("bar", BaseUnit(kg=1, m=-1, s=-2, factor=1e5, offset=101325.0), ("Pa", 1e5, 101325.0)),  # over the ambient
        ("g", BaseUnit(m=1, s=-2, factor=9.80665), ("m/s2", 9.80665, 0.0)),
    ],
)
def test_a_definition_counts_where_the_name_says_another(name, base, expected):
    found = meaning(name, base)
    assert (found.si, found.factor, found.offset) == pytest.approx(expected)
    (told,) = redefined({"x": found})
    assert told.startswith(f"unit '{name}' (x) is ") and told.endswith("by its name: the definition counts")


@pytest.mark.parametrize(
    ("name", "base", "expected"),
    [
        ("psi", BaseUnit(kg=1, m=-1, s=-2, factor=6894.8), ("Pa", 6894.757293168361, 0.0)),  # few digits
        ("degC", BaseUnit(K=1, offset=273.15), ("K", 1.0, 273.15)),
        ("1/min", BaseUnit(rad=1, s=-1, factor=0.10471975511965977), ("rad/s", 0.10471975511965977, 0.0)),
        ("bar", BaseUnit(), ("Pa", 1e5, 0.0)),  # defines nothing
        ("bar", None, ("Pa", 1e5, 0.0)),
        ("rad/s", BaseUnit(s=-1), ("rad/s", 1.0, 0.0)),
        ("rpm", BaseUnit(s=-1, factor=1 / 60), ("rad/s", 0.10471975511965977, 0.0)),  # a revolution counts as one
    ],
)
def test_a_definition_that_agrees_or_says_nothing_leaves_it_to_the_name(name, base, expected):
    found = meaning(name, base)
    assert (found.si, found.factor, found.offset) == pytest.approx(expected)
    assert not found.said and not redefined({"x": found})


@pytest.mark.parametrize(
    ("name", "base", "factor", "offset"),
    [
        ("mV", BaseUnit(kg=1, m=2, s=-3, A=-1), 1e-3, 0.0),
        ("bar", BaseUnit(kg=1, m=-1, s=-2), 1e5, 0.0),
        ("degC", BaseUnit(K=1), 1.0, 273.15),
    ],
)
def test_exponents_alone_say_what_is_measured_and_not_in_what(name, base, factor, offset):
    """By the letter a mV would be a volt there; it is told."""
    found = meaning(name, base)
    assert (found.factor, found.offset) == pytest.approx((factor, offset))
    assert redefined({"x": found})[0].endswith("by its definition: the name counts")


def test_a_difference_has_no_zero_and_a_user_is_believed():
    celsius = BaseUnit(K=1, offset=273.15)
    assert meaning("degC", celsius, relative=True).offset == 0.0
    typed = ScalarVariable("x", 0, unit="degC", declaredType=SimpleType("Rise", relativeQuantity=True))
    assert meaning_of(typed, ModelDescription(), None).offset == 0.0
    assert meaning("C", celsius, chosen="degF").said == "" and meaning("C", celsius, chosen="degF").si == "K"


def test_an_fmu_tells_that_its_units_are_others(fmus, tmp_path):
    other = {
        '<Unit name="rad">\n      <BaseUnit rad="1" />': '<Unit name="rad">\n      <BaseUnit rad="1" factor="2" />'
    }
    fmu = rewritten(fmus["lag"], tmp_path / "turned.fmu", xml=other)
    block = read_fmu(fmu)
    assert block.description.scales["angle"] == (2.0, 0.0)
    assert any("is 2 rad by its definition, and 1 rad by its name" in note for note in block.notes)
    row = next(row for row in check_fmu(fmu).rows if row.name == "units")
    assert row.verdict == "remark" and "2 rad" in row.detail


@pytest.fixture
def celsius_lag(fmus, tmp_path):
    """An FMU with a parameter in degC that says itself whether it is a difference."""

    def written(attribute: str):
        defined = '<UnitDefinitions>\n    <Unit name="degC"><BaseUnit K="1" offset="273.15" /></Unit>'
        with zipfile.ZipFile(fmus["lag"]) as archive:
            xml = archive.read("modelDescription.xml").decode()
        old = re.search(r'<ScalarVariable name="gain".*?</ScalarVariable>', xml, re.S).group()
        new = re.sub(r"<Real [^>]*/>", f'<Real unit="degC" {attribute} start="20"/>', old)
        return read_fmu(rewritten(fmus["lag"], tmp_path / "rise.fmu", xml={"<UnitDefinitions>": defined, old: new}))

    return written


def test_a_difference_is_known_from_the_file_of_an_fmu(celsius_lag):
    rise = celsius_lag('relativeQuantity="true"')
    assert rise.description.scales["gain"] == (1.0, 0.0)
    assert [rise.with_values({"gain": f"5 {unit}"}).values["gain"] for unit in ("degC", "K")] == [5.0, 5.0]
    assert celsius_lag('relativeQuantity="false"').description.scales["gain"] == (1.0, 273.15)


class Warmed(Component):
    """A rise of the oil over the room."""

    rise = Parameter(5.0, "delta_degC", "rise", bounds=(0.0, 50.0))
    room = Parameter(20.0, "degC", "of the room")
    oil = Output("degC", "of the oil")
    over = Output("delta_degC", "of the oil over the room")

    def equations(self):
        yield self.oil == self.room + self.rise
        yield self.over == self.rise


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_difference_that_a_model_declares_is_one_in_its_fmu(tmp_path, fmi):
    """A rise of 5 K in degC would be shown as -268 degC; 5 degC of it was set as 278 K."""
    model = Model(Warmed(), "warmed")
    assert with_values(model, {"rise": "7 degC", "room": "30 degC"}).flat.parameter_vector().tolist() == [7.0, 303.15]
    path = export_fmu(model, tmp_path / "warmed.fmu", fmi=fmi)
    assert check_fmu(path).passed
    said = {v.name: (v.unit, v.displayUnit, is_difference(v)) for v in read_fmu(path).description.source.modelVariables}
    assert said["rise"] == said["over"] == ("K", "degC", True) and said["room"] == said["oil"] == ("K", "degC", False)
    warm = read_fmu(path).with_values({"rise": "7 degC", "room": "30 degC"})
    assert warm.values == {"rise": 7.0, "room": 303.15}


def test_who_knows_that_a_variable_of_an_fmu_is_a_difference_says_it_by_its_unit(celsius_lag, tmp_path):
    celsius_lag("")
    rise = read_fmu(tmp_path / "rise.fmu", units={"gain": "delta_degC"})
    assert rise.description.scales["gain"] == (1.0, 0.0)


def test_what_an_fmu_calls_its_unit_is_its_unit_where_a_user_sets_it():
    gauge = BaseUnit(kg=1, m=-1, s=-2, factor=1e5, offset=101325.0)
    described = SimpleNamespace(
        source=ModelDescription(modelVariables=[ScalarVariable("p", 0, unit="bar", type="Real")]),
        units={"p": "Pa"}, scales={"p": (1e5, 101325.0)}, whole={},
    )  # fmt: skip
    assert meaning("bar", gauge).offset == 101325.0
    assert own_value("p", "2 bar", described) == 2.0
    assert own_value("p", "301325 Pa", described) == pytest.approx(2.0)


def test_units_that_a_parameter_set_defines_itself_count_there():
    described = SimpleNamespace(
        source=ModelDescription(modelVariables=[ScalarVariable("p", 0, unit="bar", type="Real")]),
        units={"p": "Pa"}, scales={"p": (1e5, 0.0)},
    )  # fmt: skip
    text = (
        '<ParameterSet><Parameters><Parameter name="p"><Real value="2" unit="bar"/></Parameter></Parameters><Units>'
        '<Unit name="bar"><BaseUnit {base} factor="1e5" offset="101325"/></Unit></Units></ParameterSet>'
    )
    pressure = text.format(base='kg="1" m="-1" s="-2"')
    assert parameters_of(pressure.encode(), "x.ssv", described)["p"] == pytest.approx(3.01325)
    with pytest.raises(UnitError, match="length by its definition there"):
        parameters_of(text.format(base='m="1"').encode(), "x.ssv", described)
