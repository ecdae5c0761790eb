"""A model file keeps named effects: what was added is there again after reading, wherever a MODEL is taken."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.effects import CATALOGUE, add_effect, candidates
from hydrotwin.models.language import DeclarationError
from hydrotwin.models.language.equations import equations_digest
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.model_file import read_model_file
from tests.face.command_line import hydrotwin

MACHINES = {"cehA": cehA.model(), "spool_valve": spool_valve.model()}
FOUND = {name: candidates(machine) for name, machine in MACHINES.items()}
IDLE = ("cehA", "line_friction")  # a pump at a given speed does not feel it: refused, see tests/effects/test_nested.py
FITS = {  # effect -> a machine that may lack it
    c.id: name for name, found in FOUND.items() for c in found if (name, c.id) != IDLE
}
CODE = """
from hydrotwin.models import cehA
from hydrotwin.models.effects import add_effect


def machine():
    return cehA.model()


def leaking():
    return add_effect(cehA.model(), "internal_leakage", values={"conductance": 2e-14})
"""


def off_neutral(candidate) -> dict[str, float]:
    """Values at which an effect is there: its first probe, bounds respected."""
    return {**candidate.neutral, **(candidate.probes[0] if candidate.probes else {})}


def same_equations(one, other) -> None:
    """Names, values and, at random points, rates and outputs to the last bit."""
    a, b = one.flat, other.flat
    assert [s.name for s in a.states] == [s.name for s in b.states]
    assert {p.name: (p.value, p.unit, p.bounds, p.free) for p in a.parameters} == {
        p.name: (p.value, p.unit, p.bounds, p.free) for p in b.parameters
    }
    assert [i.dead_time for i in a.inputs] == [i.dead_time for i in b.inputs]
    assert equations_digest(a) == equations_digest(b) != ""
    random = np.random.default_rng(7)
    nominal = np.array([s.nominal for s in a.states])
    for _ in range(3):
        x = nominal * random.uniform(0.1, 1.0, len(nominal))
        u = [i.nominal * random.uniform(-1, 1) for i in a.inputs]
        ours, theirs = (flat.ode(0.3, x, u, flat.parameter_vector()) for flat in (a, b))
        for one_s, other_s in zip(ours, theirs, strict=True):
            assert np.array_equal(np.array(one_s), np.array(other_s), equal_nan=True)


@pytest.mark.parametrize(("effect", "name"), FITS.items())
def test_an_effect_comes_back_at_all_of_its_sites(name, effect, tmp_path):
    base = MACHINES[name]
    found = [c for c in FOUND[name] if c.id == effect]
    values = {path: value for c in found for path, value in off_neutral(c).items()}
    model = base.plus([c.addition for c in found]).with_parameters(values)
    ht.write_model_file(tmp_path / "m.toml", name, model)
    again = ht.load(tmp_path / "m.toml")
    assert [(a.name, a.effect, a.site) for a in again.additions] == [(c.name, effect, c.site.name) for c in found]
    same_equations(model, again)


@pytest.mark.parametrize("name", MACHINES)
def test_several_effects_on_one_signal_come_back_in_their_order(name, tmp_path):
    base = MACHINES[name]
    chosen = [c for c in FOUND[name] if c.site.through][::-1]
    values = {path: value for c in chosen for path, value in off_neutral(c).items()}
    model = base.plus([c.addition for c in chosen]).with_parameters(values)
    ht.write_model_file(tmp_path / "m.toml", name, model)
    again = ht.load(tmp_path / "m.toml")
    assert [a.name for a in again.additions] == [c.name for c in chosen]
    same_equations(model, again)


def test_the_catalogue_of_the_contract_is_not_empty():
    assert len(FITS) > 10 and set(FITS) <= set(CATALOGUE)
    assert set(FITS.values()) == set(MACHINES)


def test_an_effect_under_another_name_keeps_it(tmp_path):
    from dataclasses import replace

    candidate = next(c for c in FOUND["cehA"] if c.label == "coulomb_friction at arm.pin")
    model = cehA.model().plus([replace(candidate.addition, name="rod_seal")]).with_parameters({"rod_seal.force": 90.0})
    ht.write_model_file(tmp_path / "m.toml", "cehA", model)
    same_equations(model, ht.load(tmp_path / "m.toml"))


def test_effects_of_a_users_machine_come_back_with_its_code_and_those_of_the_code_stay(tmp_path):
    (tmp_path / "own.py").write_text(CODE)
    for factory in ("machine", "leaking"):
        model = add_effect(ht.load(f"{tmp_path}/own.py:{factory}"), "coulomb_friction", values={"force": 70.0})
        ht.write_model_file(tmp_path / "m.toml", "own.py:machine", model)
        same_equations(model, ht.load(f"{tmp_path}/own.py:{factory}@{tmp_path}/m.toml"))


def test_the_file_says_effect_site_and_name_and_is_checked_before_it_is_used(tmp_path):
    model = add_effect(cehA.model(), "coulomb_friction", values={"force": 70.0})
    ht.write_model_file(tmp_path / "m.toml", "cehA", model)
    content = tomllib.loads((tmp_path / "m.toml").read_text())
    assert content["effects"] == [{"effect": "coulomb_friction", "site": "arm.pin", "name": "coulomb_friction"}]
    assert content["parameters"]["coulomb_friction"]["force"]["value"] == 70.0


ROW = '[[effects]]\neffect = "coulomb_friction"\nsite = "arm.pin"\nname = "coulomb_friction"\n'
FORC = '[parameters.coulomb_friction]\nforc = { value = 1, unit = "N" }\n'
WRONG = [
    ("coulomb_friction", "colomb_friction", DeclarationError, "Did you mean 'coulomb_friction'"),
    ('"arm.pin"', '"arm.pine"', DeclarationError, "Did you mean 'arm.pin'"),
    ('effect = "coulomb_friction"', "", DataError, "effect 1 has no 'effect'"),
    ('site = "arm.pin"', "site = 3", DataError, "'site' is no text"),
    ('site = "arm.pin"', 'place = "arm.pin"', DataError, "unknown key 'place'"),
    ('name = "coulomb_friction"', 'name = "a b"', DataError, "no name of a part"),
    ('name = "coulomb_friction"', 'name = "motor"', DeclarationError, "'motor' is there already"),
    (ROW, ROW + FORC, DeclarationError, "coulomb_friction.force"),
    (ROW, 'effects = ["coulomb_friction"]\n', DataError, "effect 1 is no table"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "kind", "says"), WRONG, ids=[w[3] for w in WRONG])
def test_a_wrong_effect_is_named_with_the_nearest_right_one(old, new, kind, says, tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text('model = "cehA"\n' + ROW.replace(old, new, 1))
    with pytest.raises(kind, match=says) as raised:
        ht.load(path)
    assert "wrong.toml" in str(raised.value)


def test_a_file_that_was_cut_off_after_its_effects_is_refused(tmp_path):
    ht.write_model_file(tmp_path / "m.toml", "cehA", add_effect(cehA.model(), "coulomb_friction"))
    text = (tmp_path / "m.toml").read_text()
    assert text.index("[[effects]]") < text.index("[parameters")
    (tmp_path / "cut.toml").write_text("\n".join(text.splitlines()[:20]) + "\n")
    with pytest.raises(DataError, match="ends too early"):
        read_model_file(tmp_path / "cut.toml")


# -- every command that takes a MODEL ---------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def lagging(recordings):
    """A model file of the C-EHA with a slow drive (one state more) and friction in a folder of recordings."""
    model = add_effect(cehA.model(), "actuator_lag", values={"time_constant": 0.05})
    model = add_effect(model, "coulomb_friction", values={"force": 60.0})
    ht.write_model_file(recordings / "lagging.toml", "cehA", model)
    return recordings


def test_simulate_shows_the_effect(lagging, monkeypatch):
    monkeypatch.chdir(lagging)
    record = ht.read_record("validate_1.csv")
    with_it, without = (ht.simulate(ht.load(m), record)["motor_speed"] for m in ("lagging.toml", "cehA"))
    assert np.abs(with_it - without).max() > 1.0
    answer = hydrotwin("simulate", "lagging.toml", "--input", "validate_1.csv", "--out", "lagging.csv")
    assert answer.code == 0, answer.err
    assert ht.read_record("lagging.csv")["motor_speed"] == pytest.approx(with_it, rel=1e-9, abs=1e-9)


def test_identify_starts_from_the_effect_and_keeps_it(lagging, monkeypatch):
    monkeypatch.chdir(lagging)
    answer = hydrotwin(
        "identify", "lagging.toml", "train_1.csv", "--free", "motor.gain", "--free", "actuator_lag.time_constant",
        "--output", "motor_speed", "--starts", "1", "--out", "again.toml",
    )  # fmt: skip
    assert answer.code == 0, answer.err
    again = ht.load("again.toml")
    assert [(a.effect, a.site) for a in again.additions] == [
        ("actuator_lag", "command"),
        ("coulomb_friction", "arm.pin"),
    ]
    values = {p.name: p.value for p in again.flat.parameters}
    assert values["coulomb_friction.force"] == 60.0
    assert values["actuator_lag.time_constant"] != 0.05


def test_compare_runs_it_beside_the_machine_without(lagging, monkeypatch):
    monkeypatch.chdir(lagging)
    answer = hydrotwin(
        "compare", "--model", "cehA", "--model", "slow=lagging.toml", "--validate", "validate_1.csv", "--out", "both"
    )
    assert answer.code == 0, answer.err
    assert "slow" in (lagging / "both/compare.json").read_text()


def test_linearize_shows_the_state_of_the_added_part(lagging, monkeypatch):
    monkeypatch.chdir(lagging)
    answer = hydrotwin("linearize", "lagging.toml", "--json")
    assert answer.code == 0, answer.err
    assert "actuator_lag.lagging" in json.loads(answer.out)["states"]


def test_an_fmu_names_the_states_and_parameters_of_added_parts(lagging, monkeypatch):
    monkeypatch.chdir(lagging)
    answer = hydrotwin("export", "lagging.toml", "--kind", "both", "--out", "lagging.fmu")
    assert answer.code == 0, answer.err
    import fmpy

    names = {v.name for v in fmpy.read_model_description("lagging.fmu").modelVariables}
    assert {"actuator_lag.lagging", "actuator_lag.time_constant", "coulomb_friction.force"} <= names
    checked = hydrotwin("check", "lagging.fmu")
    assert checked.code == 0, checked.out


def test_its_modelica_text_extends_the_machine(lagging, monkeypatch):
    monkeypatch.chdir(lagging)
    answer = hydrotwin("modelica", "lagging.toml")
    assert answer.code == 0, answer.err
    assert "CoulombFriction coulomb_friction" in answer.out


def test_an_effect_is_put_into_the_machine_as_the_file_says_it_is(tmp_path):
    open_tank = spool_valve.model().with_parameters({"tank.pressure": 1e5})
    leaking = add_effect(open_tank, "external_leakage", "cylinder.cap", {"conductance": 1e-12})
    ht.write_model_file(tmp_path / "m.toml", "spool_valve", leaking)
    same_equations(leaking, ht.load(tmp_path / "m.toml"))


def test_a_freed_parameter_that_is_found_to_be_nil_comes_back(tmp_path):
    wrong = add_effect(cehA.model(), "payload_error", "arm.extra_mass").with_parameters({"arm.extra_mass": 0.0})
    ht.write_model_file(tmp_path / "m.toml", "cehA", wrong)
    same_equations(wrong, ht.load(tmp_path / "m.toml"))
