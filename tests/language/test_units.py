"""Unit strings: what they mean, their SI form, conversion, errors."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from hydrotwin.models.language.errors import UnitError
from hydrotwin.models.language.units import (
    compatible,
    convert,
    convert_difference,
    dimension,
    display_units,
    from_si,
    known_symbols,
    modelica_unit,
    parse_unit,
    si_unit,
    to_si,
)

TEXTS = [
    ("bar", "Pa", 1e5),
    ("mm", "m", 1e-3),
    ("deg", "rad", np.pi / 180),
    ("rev", "rad", 2 * np.pi),
    ("rpm", "rad/s", 2 * np.pi / 60),
    ("L/min", "m3/s", 1e-3 / 60),
    ("cm3/rev", "m3/rad", 1e-6 / (2 * np.pi)),
    ("kN", "N", 1e3),
    ("%", "1", 1e-2),
    ("1", "1", 1.0),
    ("A", "A", 1.0),
    ("ohm", "ohm", 1.0),
    ("kΩ", "ohm", 1e3),
    ("V.s/rad", "V.s/rad", 1.0),
    ("m3/(s.Pa)", "m3/(s.Pa)", 1.0),
    ("m3/(s.sqrt(Pa))", "m3/(s.sqrt(Pa))", 1.0),
    ("L/(min.sqrt(bar))", "m3/(s.sqrt(Pa))", 1e-3 / 60 / np.sqrt(1e5)),
    ("rad/(s.V)", "rad/(s.V)", 1.0),
    ("N.s/m", "N.s/m", 1.0),
    ("N.s/mm", "N.s/m", 1e3),
    ("mm²", "m2", 1e-6),
    ("µm", "m", 1e-6),
    ("kN·m", "N.m", 1e3),
    ("N m", "N.m", 1.0),
    ("m*s^-2", "m/s2", 1.0),
    ("N/(m/s)2", "N.s2/m2", 1.0),
    ("m^(1/2)", "sqrt(m)", 1.0),
    ("V/%", "V", 100.0),
    ("h", "s", 3600.0),
    ("psi", "Pa", 6894.757293168361),
    ("cSt", "m2/s", 1e-6),
]


@pytest.mark.parametrize(("text", "si", "factor"), TEXTS, ids=[t for t, _, _ in TEXTS])
def test_a_unit_string_has_its_si_form_and_factor(text, si, factor):
    value, unit = to_si(1.0, text)
    assert unit == si
    assert value == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize("text", [t for t, _, _ in TEXTS])
def test_the_si_form_is_its_own_si_form_with_factor_one(text):
    si = si_unit(text)
    assert si_unit(si) == si
    assert parse_unit(si).factor == 1.0
    assert dimension(si) == dimension(text)


@pytest.mark.parametrize("symbol", known_symbols())
def test_every_symbol_converts_there_and_back(symbol):
    values = np.random.default_rng(7).normal(scale=100.0, size=50)
    si, unit = to_si(values, symbol)
    np.testing.assert_allclose(from_si(si, symbol), values, rtol=1e-12, atol=1e-11)
    assert compatible(symbol, unit)
    assert dimension(unit) == dimension(symbol)


def test_conversion_is_linear_transitive_and_multiplicative_in_its_units():
    rng = np.random.default_rng(3)
    pairs = [("bar", "psi", "MPa"), ("rpm", "deg/s", "rad/s"), ("L/min", "cm3/s", "m3/h"), ("mm", "in", "ft")]
    for a, b, c in pairs:
        x, y = rng.normal(size=2)
        assert convert(x + y, a, b) == pytest.approx(convert(x, a, b) + convert(y, a, b), rel=1e-12)
        assert convert(convert(x, a, b), b, c) == pytest.approx(convert(x, a, c), rel=1e-12)
        assert parse_unit(f"({a}).({b})").factor == pytest.approx(parse_unit(a).factor * parse_unit(b).factor)
        assert parse_unit(f"({a})/({b})").dimension == (Fraction(0),) * 7


def test_dimensions_are_the_seven_base_exponents():
    assert dimension("N.s/m") == (0, 1, -1, 0, 0, 0, 0)
    assert dimension("ohm") == (2, 1, -3, -2, 0, 0, 0)
    assert dimension("m3/(s.sqrt(Pa))") == (Fraction(7, 2), Fraction(-1, 2), 0, 0, 0, 0, 0)
    for text in ("rad", "1", "%", "deg", "rev", "-", "", "mm/m"):
        assert dimension(text) == (0,) * 7


def test_temperatures_have_a_zero_point_and_their_differences_none():
    assert to_si(25.0, "degC") == (298.15, "K")
    assert convert(212.0, "degF", "degC") == pytest.approx(100.0)
    assert to_si(2.0, "W/degC") == (2.0, "W/K")


def test_arrays_stay_arrays_and_integers_become_floats():
    values, _ = to_si([1, 2, 3], "bar")
    assert values.dtype == float
    assert values.tolist() == [1e5, 2e5, 3e5]
    assert isinstance(to_si(1, "bar")[0], float)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("barr", "Did you mean 'bar'?"),
        ("m3/(s.Paa)", "'Paa' in 'm3/(s.Paa)': not known. Did you mean 'Pa'?"),
        ("m3/s.Pa", "ambiguous"),
        ("m3/(s", "ends too early"),
        ("m)", "unexpected"),
        ("m//s", "unexpected '/'"),
        ("2", "unexpected '2'"),
        ("m^(1/0)", "fraction"),
        ("m^x", "not an exponent"),
        ("€", "unexpected"),
        (3.0, "not text"),
    ],
)
def test_a_wrong_unit_string_is_refused_with_a_next_step(text, says):
    with pytest.raises(UnitError) as error:
        parse_unit(text)
    assert says in str(error.value)


def test_units_of_another_dimension_do_not_convert():
    with pytest.raises(UnitError, match=r"'bar': cannot become 'm' .* m, mm, cm"):
        convert(1.0, "bar", "m")
    assert not compatible("bar", "m")


PER_MINUTE = [
    "1/min",
    "min-1",
    "min^-1",
    "min⁻¹",
    "/min",
    "1 / min",
    "U/min",
    "r/min",
    "rev/min",
    "tr/min",
    "RPM",
    "Upm",
]


@pytest.mark.parametrize("text", PER_MINUTE)
def test_revolutions_per_minute_are_known_in_every_spelling(text):
    assert convert(60.0, text, "rad/s") == pytest.approx(2 * np.pi, rel=1e-15)
    assert convert(2 * np.pi, "rad/s", text) == pytest.approx(60.0, rel=1e-15)
    assert convert(1500.0, text, "rpm") == pytest.approx(1500.0, rel=1e-15)
    assert to_si(60.0, text) == (pytest.approx(2 * np.pi), "rad/s")


def test_a_rate_per_minute_is_no_speed_of_rotation():
    assert convert(60.0, "1/min", "1/s") == pytest.approx(1.0)
    assert convert(60.0, "1/min", "Hz") == pytest.approx(1.0)
    for speed in ("rpm", "U/min", "rad/min", "deg/s"):
        assert not compatible(speed, "1/s")
    with pytest.raises(UnitError, match="'1/s' does not say whether it counts radians or turns"):
        convert(1.0, "1/s", "1/min")  # it would be read back as revolutions


@pytest.mark.parametrize(
    ("text", "speed"), [("rev/s", 2 * np.pi), ("U/s", 2 * np.pi), ("°/s", np.pi / 180), ("rad/min", 1 / 60)]
)
def test_other_speeds_of_rotation_have_their_own_factor(text, speed):
    assert convert(1.0, text, "rad/s") == pytest.approx(speed, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "needed"),
    [
        ("1/s", "rad/s"), ("s-1", "rpm"), ("kHz", "rad/s"), ("1/s2", "rad/s2"), ("1/min2", "rad/s2"), ("cm3", "m3/rad"),
        ("mm", "m/rad"), ("1/(s.V)", "rad/(s.V)"), ("1/(min.V)", "rad/(s.V)"), ("V.min", "V.s/rad"), ("%", "rad"),
    ],
)  # fmt: skip
def test_an_angle_left_out_where_turns_may_be_meant_is_refused(text, needed):
    assert not compatible(text, needed)
    with pytest.raises(UnitError, match="write rad"):
        convert(1.0, text, needed)


def test_mechanics_leaves_the_radian_out():
    for one, two in (("N.m", "N.m/rad"), ("N.m.s", "N.m.s/rad"), ("N.m/A", "V.s/rad"), ("m.rad/s", "m/s")):
        assert convert(3.0, one, two) == convert(3.0, two, one) == 3.0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Grad", "Write deg."), ("grad", "Write deg."), ("gon", "Write deg"), ("krad", "'rad'"), ("Mm", "'mm'"),
        ("MPA", "'MPa' or 'mPa'"), ("Bar", "'bar'"), ("KN", "'kN'"), ("1/Min", "'min'"), ("Gs", "not known"),
        ("Nm3/h", "ambiguous"), ("Nl/min", "norm litres"), ("sec", "Write s."), ("pt", "not known"), ("barg", "gauge"),
        ("bar(g)", "gauge"), ("bar rel", "gauge"), ("MPa (g)", "Write MPa, and say"), ("bar abs", "Write bar."),
        ("barü", "gauge"), ("Grad Celsius", "write degC"), ("deg F", "write degF"), ("°K", "Write K."),
    ],
)  # fmt: skip
def test_a_symbol_that_could_change_the_meaning_is_refused_with_the_right_one(text, says):
    with pytest.raises(UnitError) as error:
        parse_unit(text)
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("text", "si", "factor"),
    [
        ("daN", "N", 10.0),
        ("ccm/U", "m3/rad", 1e-6 / (2 * np.pi)),
        ("mPas", "Pa.s", 1e-3),
        ("kNm", "N.m", 1e3),
        ("μm", "m", 1e-6),
        ("hPa", "Pa", 100.0),
    ],
)
def test_what_the_field_writes_is_known(text, si, factor):
    assert to_si(1.0, text) == (pytest.approx(factor, rel=1e-14), si)


def test_a_frequency_is_not_an_angular_speed():
    assert not compatible("Hz", "rad/s")
    assert not compatible("kHz", "rpm")
    assert convert(1.0, "kHz", "1/s") == 1000.0
    with pytest.raises(UnitError, match="rev/s"):
        convert(50.0, "Hz", "rad/s")


def test_display_units_suit_the_quantity():
    assert [display_units(u)[0] for u in ("Pa", "rad", "m", "rad/s", "m3/s", "m3/rad", "m2")] == [
        "bar", "deg", "mm", "rpm", "L/min", "cm3/rev", "mm2",
    ]  # fmt: skip
    assert display_units("V.s/rad") == ("V.s/rad",)
    for unit in ("Pa", "rad", "m", "rad/s", "m3/s", "N", "1", "K", "Pa/s", "W"):
        assert all(compatible(unit, shown) for shown in display_units(unit))


def test_modelica_units_follow_its_grammar():
    assert modelica_unit("bar") == "Pa"
    assert modelica_unit("kohm.m2") == "Ohm.m2"
    assert modelica_unit("m3/(s.Pa)") == "m3/(s.Pa)"
    assert modelica_unit("%") == "1"
    assert modelica_unit("m3/(s.sqrt(Pa))") == ""


@pytest.mark.parametrize("text", ["deg C", "° C", "deg.C", "W/(m2.deg C)", "deg F"])
def test_a_degree_apart_from_its_scale_is_told_the_word_to_write(text):
    with pytest.raises(UnitError, match=rf"write deg{'F' if 'F' in text else 'C'} in one word"):
        parse_unit(text)


def test_a_difference_is_converted_without_the_zero_of_its_unit():
    """0.2 degC had been 0.19999999999998863 K, so that what lay on a bound had missed it."""
    assert convert_difference(0.2, "degC", "K") == 0.2 and convert_difference(0.9, "degF", "K") == 0.5
    assert convert_difference(60.0, "1/min", "rev/s") == convert(60.0, "1/min", "rev/s")
    np.testing.assert_array_equal(convert_difference(np.array([1e-9, 2.0]), "K", "degC"), [1e-9, 2.0])
    with pytest.raises(UnitError, match="cannot become"):
        convert_difference(1.0, "degC", "Pa")
