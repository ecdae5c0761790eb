"""A binary must give what its description declares: every variable can be read, every state is listed, starts are
those declared."""

from __future__ import annotations

import re

import pytest

from hydrotwin.export import check_fmu
from tests.export.foreign import rewritten
from tests.export.test_description import read

END = "</ModelVariables>"
GHOSTS = {
    2: '<ScalarVariable name="ghost" valueReference="9001" causality="local" variability="{}"><{}/></ScalarVariable>',
    3: '<{1} name="ghost" valueReference="9001" causality="local" variability="{0}"/>',
}


@pytest.mark.parametrize(
    ("fmi", "variability", "kind"),
    [(2, "continuous", "Real"), (2, "discrete", "Boolean"), (3, "continuous", "Float64"), (3, "discrete", "String")],
)
def test_a_variable_that_the_binary_refuses_fails_by_name(variants, tmp_path, fmi, variability, kind):
    ghost = GHOSTS[fmi].format(variability, kind)
    check = check_fmu(rewritten(variants["lag", ("fmi", fmi)], tmp_path / "x.fmu", xml={END: ghost + END}))
    assert [row.name for row in check.failures] == ["reading"], str(check)
    assert "'ghost' (valueReference 9001)" in check["reading"].detail
    assert (
        check["reading"].rule
        == {
            2: "FMI 2.0.5, 2.1.7 Getting and Setting Variable Values",
            3: "FMI 3.0.2, 2.2.7.2 Getting and Setting Variable Values",
        }[fmi]
    )


@pytest.mark.parametrize("kind", ["cs", "me"])
def test_an_output_that_the_binary_refuses_fails_by_name(variants, tmp_path, kind):
    good = variants["clocked mass", ("kind", kind)]
    [found] = re.findall(r'name="place" valueReference="\d+"', read(good))
    check = check_fmu(rewritten(good, tmp_path / "x.fmu", xml={found: 'name="place" valueReference="9001"'}))
    assert "reading" in [row.name for row in check.failures], str(check)
    assert "'place' (valueReference 9001)" in check["reading"].detail


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_state_whose_derivative_is_not_listed_anywhere_is_found_in_the_binary(variants, tmp_path, fmi):
    good = variants["clocked mass", ("kind", "me"), ("fmi", fmi)]
    text = read(good)
    [(name, state)] = re.findall(r'name="(der\((.*?)\))"', text)[:1]
    row = {2: '<Unknown index="{}" [^>]*/>', 3: '<ContinuousStateDerivative valueReference="{}" [^>]*/>'}[fmi]
    places = re.findall(r'<(?:ScalarVariable|Float64|Int32|Boolean) name="([^"]*)" valueReference="(\d+)"', text)
    key = {n: str(k) if fmi == 2 else r for k, (n, r) in enumerate(places, 1)}
    unknown = row.replace("ContinuousStateDerivative", "InitialUnknown")
    gone = [
        m
        for p in (row.format(key[name]), *(unknown.format(key[n]) for n in (name, state)))
        for m in re.findall(p, text)
    ]
    assert gone
    check = check_fmu(rewritten(good, tmp_path / "x.fmu", xml=dict.fromkeys(gone, "")))
    assert "number of states" in [row.name for row in check.failures], str(check)
    assert f"not listed: {name}" in check["number of states"].detail


@pytest.mark.parametrize(("fmi", "kind"), [(2, "cs"), (2, "me"), (3, "cs"), (3, "me")])
def test_a_start_value_that_was_edited_in_the_description_alone_is_found(variants, tmp_path, fmi, kind):
    good = variants["clocked mass", ("kind", kind), ("fmi", fmi)]
    assert check_fmu(good)["start values"].verdict == "pass"
    [row] = re.findall(r'(?s)name="mass.m".*?start="[^"]*"', read(good))
    edited = row[: row.rindex("start=")] + 'start="2.5"'
    check = check_fmu(rewritten(good, tmp_path / "x.fmu", xml={row: edited}))
    assert [one.name for one in check.failures] == ["start values"], str(check)
    assert "declared 2.5" in check["start values"].detail
