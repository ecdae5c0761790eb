"""Variants in a scenario file: what they may say, what is refused and with which next step."""

from __future__ import annotations

import tomllib

import pytest

from hydrotwin.comparison.variants import BASE, MOST_RUNS, MOST_VARIANTS, Variant, check_many, read_variants
from hydrotwin.comparison.varied import with_values
from hydrotwin.models import cehA
from hydrotwin.models.language.errors import DeclarationError


def variants(text: str) -> tuple[Variant, ...]:
    table = tomllib.loads(text)
    return read_variants(table.get("variants"), table.get("matrix"), "scenario.toml")


def test_a_value_that_is_set_has_no_deviation_of_a_fit():
    """An archive would tell its interval around the value that somebody chose."""
    fitted = cehA.model().with_settings({"motor.gain": {"sigma": 2.0, "source": "identified"}})
    by_name = {p.name: p for p in with_values(fitted, {"motor.gain": "110 rad/(s.V)"}).flat.parameters}
    assert (by_name["motor.gain"].value, by_name["motor.gain"].sigma) == (110.0, None)
    assert "identified" not in by_name["motor.gain"].source
    assert {p.name: p.sigma for p in fitted.flat.parameters}["motor.gain"] == 2.0


def test_a_scenario_without_variants_has_none():
    assert variants("") == ()


def test_variants_are_read_behind_the_scenario_as_it_stands():
    base, cold, coarse = variants(
        """
        [variants.cold]
        parameters = {"cylinder.oil.bulk_modulus" = "900 MPa"}
        effects_off = ["internal_leakage"]
        models = ["fitted"]

        [variants.coarse]
        parameters.cylinder.oil.bulk_modulus = 9e8
        step = 0.002
        method = "explicit"
        period = 0.02
        initial_states = "auto"
        """
    )
    assert (base, base.name, base.changes) == (Variant(), BASE, {})
    assert cold.changes == {
        "parameters": {"cylinder.oil.bulk_modulus": "900 MPa"},
        "effects_off": ("internal_leakage",),
        "models": ("fitted",),
    }
    assert coarse == Variant(
        "coarse", {"cylinder.oil.bulk_modulus": 9e8}, (), (), 0.002, "explicit", 0.02, initial_states="auto"
    )  # fmt: skip


def test_every_combination_of_a_matrix_is_a_variant_named_by_its_values():
    found = variants(
        """
        [matrix]
        parameters."pump.displacement" = [1e-6, 2e-6]
        parameters."motor.displacement" = [3.0]
        effects_off = [[], ["leak", "play"]]
        step = [0.001]
        """
    )
    assert [v.name for v in found[1:]] == [
        f"pump.displacement={pump}, motor.displacement=3, effects_off={off}, step=0.001"
        for pump in ("1e-06", "2e-06")
        for off in ("none", "leak+play")
    ]
    assert found[2].parameters == {"pump.displacement": 1e-6, "motor.displacement": 3.0}
    assert found[2].effects_off == ("leak", "play") and found[1].effects_off == ()
    assert len({v.folder for v in found}) == len(found)
    assert all(set(v.folder) <= set("abcdefghijklmnopqrstuvwxyz0123456789._=+-") for v in found)


def test_values_that_differ_late_are_two_variants():
    """Cut to six digits they had one name, which nobody can give anew, and a changed value was told as the same."""
    assert [v.name for v in variants("[matrix]\nstep = [100.00001, 100.00002]")[1:]] == [
        "step=100.00001",
        "step=100.00002",
    ]
    one, other = (Variant("heavy", {"mass": value}) for value in (130.0, 130.0001))
    assert str(one) != str(other)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[variants.cold]\nparameter = {a = 1}",
            r"\[variants.cold\] has an unknown key 'parameter'. Did you mean 'para",
        ),
        ("[variants.cold]\nparameters = 3", "parameters is no table"),
        ("[variants.cold]\nparameters = {a = [1]}", r"a is no number \(got \[1\]\)"),
        ("[variants.cold]\nparameters = {a = true}", "a is no number"),
        ("[variants.cold]\nstep = 0", "step is no time above zero"),
        ("[variants.cold]\nperiod = 'slow'", "period: 'slow' is no number"),
        ("[variants.cold]\nmethod = 'implict'", "no method 'implict'. Did you mean 'implicit'"),
        ("[variants.cold]\nmethod = 3", "method is no text"),
        ("[variants.cold]\ninitial_states = 'fre'", "no initial_states 'fre'. Did you mean 'free'"),
        ("[variants.cold]\neffects_off = 'leak'", "effects_off is no list of texts"),
        ("[variants.cold]", "changes nothing"),
        ("[variants.cold]\nmodels = ['a']", "changes nothing"),
        ("[variants.base]\nstep = 0.1", "'base' is the scenario as it stands"),
        ("[variants.'a:b']\nstep = 0.1", "a name of a variant is a word or two"),
        ("[variants.'a b']\nstep = 0.1\n[variants.a_b]\nstep = 0.2", "two variants are called 'a_b'"),
        ("[variants.Base]\nstep = 0.1", "two variants are called 'base'"),  # one folder, on many machines
        ("[variants]", r"\[variants\] is empty"),
        ("variants = 3", "'variants' is no table"),
        ("[variants]\ncold = 3", r"\[variants.cold\] is no table"),
        ("[matrix]", r"\[matrix\] is empty"),
        ("[matrix]\nstep = []", "step is no list of values"),
        ("[matrix]\nstep = 0.1", "step is no list of values"),
        ("[matrix]\nsteps = [0.1]", "unknown key 'steps'. Did you mean 'step'"),
        ("[matrix]\nstep = [0.1, -1]", "step is no time above zero"),
        ("[matrix]\nstep = [0.1, 0.1]", "two variants are called 'step=0.1'"),
        ("[matrix]\nparameters = [1]", "parameters is no table"),
    ],
)
def test_what_a_variant_cannot_say_is_refused_with_the_next_step(text, message):
    with pytest.raises(DeclarationError, match=message):
        variants(text)


def test_more_than_can_be_meant_is_refused_with_how_many_before_any_is_made():
    many = ", ".join(str(k) for k in range(1, 1001))
    with pytest.raises(DeclarationError, match=f"1000000000 variants, more than {MOST_VARIANTS}"):
        variants(f"[matrix]\nparameters = {{a = [{many}], b = [{many}], c = [{many}]}}")
    with pytest.raises(DeclarationError, match=f"5 models x 101 variants x 100 .* 50500 runs, more than {MOST_RUNS}"):
        check_many(101, 5, 100, "scenario.toml")
    check_many(40, 5, 100, "scenario.toml")


@pytest.mark.parametrize("name", ["..", ".", ".runs", ".written.json", "report.html", "Compare.JSON", "../a", "/a"])
def test_no_name_of_a_variant_leads_out_of_the_folder_or_onto_a_file_of_the_overview(name, tmp_path):
    folder = Variant(name).folder
    inside = (tmp_path / folder).resolve()
    assert inside.parent == tmp_path.resolve() and not folder.startswith(".")
    assert folder.lower() not in ("report.html", "report.md", "compare.json")
