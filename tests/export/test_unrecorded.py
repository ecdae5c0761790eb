"""FMUs whose inputs are not all recorded, and values that a user gives them."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest

from hydrotwin.comparison import as_contender, compare, load_contenders, read_scenario
from hydrotwin.comparison.varied import with_values as set_values
from hydrotwin.export import StartValueWarning, check_fmu, read_fmu
from hydrotwin.export.fmu_settings import AT_REST
from hydrotwin.loading import load
from hydrotwin.models.language.errors import DataError, DeclarationError, UnitError
from hydrotwin.records import Record, write_record
from hydrotwin.report.answer import facts
from tests.export.foreign import rewritten
from tests.face.command_line import hydrotwin

TIME = np.linspace(0.0, 1.0, 51)
FORCE = {"force": 3.0 * np.sin(4 * TIME)}


def recorded(**more) -> Record:
    signals = {**FORCE, **{n: np.full(len(TIME), v) for n, v in more.items()}}
    return Record(TIME, signals, dict.fromkeys(signals, "N"), "run")


def test_the_start_value_of_an_input_that_nobody_recorded_serves_and_is_told(fmus):
    block = read_fmu(fmus["delayed mass"])
    fed = block.fed_by([recorded()])
    assert [s.name for s in fed.inputs] == ["force"]
    assert fed.notes == ("input extra is not recorded: its start value 1 N serves",)
    assert fed.provenance[AT_REST] == fed.notes[0]
    whole = block.free_run(recorded(extra=1.0))
    np.testing.assert_array_equal(fed.free_run(recorded())["seen_force"], whole["seen_force"])
    assert not np.array_equal(whole["seen_force"], block.free_run(recorded(extra=2.0))["seen_force"])


def test_who_does_not_ask_is_warned(fmus):
    block = read_fmu(fmus["delayed mass"])
    with pytest.warns(StartValueWarning, match="input extra is not recorded: its start value 1 N serves"):
        block.free_run(recorded())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        block.free_run(recorded(extra=1.0))
        block.fed_by([recorded()]).free_run(recorded())


def test_a_column_of_nearly_that_name_is_pointed_at(fmus):
    fed = read_fmu(fmus["delayed mass"]).fed_by([recorded(extr=1.0)])
    assert fed.notes[0].endswith("Did you mean 'extr'? Rename that column")


def test_an_input_of_some_records_is_needed_in_all(fmus):
    fed = read_fmu(fmus["delayed mass"]).fed_by([recorded(), recorded(extra=1.0)])
    assert [s.name for s in fed.inputs] == ["force", "extra"]


def test_an_input_without_a_start_value_is_still_needed(fmus, tmp_path):
    fmu = rewritten(fmus["delayed mass"], tmp_path / "bare.fmu", xml={'nominal="10.0" start="1.0"': 'nominal="10.0"'})
    block = read_fmu(fmu)
    assert block.fed_by([recorded()]) is block
    with pytest.raises(DataError, match="no column 'extra'"):
        block.free_run(recorded())


def test_parameters_start_values_and_inputs_can_be_set_with_their_units(fmus):
    block = read_fmu(fmus["delayed mass"])
    other = block.with_values({"mass.m": "2000 g", "mass.s.start": "5 mm", "extra": 3.0})
    assert {p.name: p.value for p in other.parameters}["mass.m"] == 2.0
    run = other.free_run(recorded())
    assert run["place"][0] == pytest.approx(0.005)
    same = read_fmu(fmus["delayed mass"], values={"mass.m": 2.0, "mass.s.start": 0.005}).free_run(recorded(extra=3.0))
    for name in same.signals:
        np.testing.assert_array_equal(run[name], same[name])
    assert other.notes == ("input extra is 3 N throughout, as you set it",)
    given = other.free_run(recorded(extra=1.0))
    np.testing.assert_array_equal(given["seen_force"], run["seen_force"])


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"mas.m": 1.0}, DeclarationError, "no variable 'mas.m'. Did you mean 'mass.m'?"),
        ({"place": 1.0}, DeclarationError, "'place' cannot be set, the FMU calculates it"),
        ({"mass.m": "2 bar"}, UnitError, "'bar': cannot become 'kg'"),
        ({"mass.m": "heavy"}, DeclarationError, "mass.m: 'heavy' is no number. Write mass.m=35kg"),
    ],
)
def test_what_cannot_be_set_is_named(fmus, given, error, words):
    with pytest.raises(error) as failure:
        read_fmu(fmus["delayed mass"]).with_values(given)
    assert words in str(failure.value)


def test_a_number_alone_says_nothing_of_what_the_fmu_has_in_another_unit(fmus, tmp_path):
    grams = {'<Unit name="kg">': '<Unit name="g"><BaseUnit kg="1" factor="0.001" /></Unit><Unit name="kg">'}
    grams |= {'unit="kg"': 'unit="g"'}
    block = read_fmu(rewritten(fmus["delayed mass"], tmp_path / "grams.fmu", xml=grams))
    with pytest.raises(DeclarationError, match=r"declared in g, so 2 alone may mean g or kg. Give the unit: mass.m=2g"):
        block.with_values({"mass.m": "2"})
    with pytest.raises(DeclarationError, match="may mean g or kg"):
        set_values(block, {"mass.m": 2.0})  # of a scenario
    assert block.with_values({"mass.m": 0.002}).values == block.with_values({"mass.m": "2 g"}).values  # SI in Python


def test_simulate_tells_and_takes_settings(fmus, tmp_path):
    write_record(recorded(), tmp_path / "run.csv")
    words = ("simulate", fmus["delayed mass"], "--input", tmp_path / "run.csv", "--set", "mass.m=2000g")
    answer = hydrotwin(*words)
    assert answer.code == 0, answer.said
    assert "note delayed mass: input extra is not recorded: its start value 1 N serves" in answer.err
    answer = hydrotwin(*words, "--set", "extra=2kN", "--json")
    assert json.loads(answer.out)["notes"] == ["input extra is 2000 N throughout, as you set it"]
    assert set(json.loads(answer.out)["inputs"]) == {"force"}


def test_a_comparison_takes_settings_from_its_scenario_and_its_report_says_what_serves(fmus, tmp_path):
    fmu = fmus["delayed mass"]
    truth = read_fmu(fmu).with_values({"mass.m": 4.0}).fed_by([recorded()]).free_run(recorded())
    write_record(recorded().with_signals({"place": truth["place"]}, {"place": "m"}), tmp_path / "run.csv")
    (tmp_path / "s.toml").write_text(
        f'validate = ["run.csv"]\nmodels = ["{fmu}", {{model = "{fmu}", set = {{"mass.m" = "4000 g"}}}}]\n'
    )
    scenario = read_scenario(tmp_path / "s.toml")
    contenders = [as_contender(c, f"{k}") for k, c in enumerate(load_contenders(scenario, load))]
    record = recorded().with_signals({"place": truth["place"]}, {"place": "m"})
    comparison = compare(contenders, [record], modes=["free run"], outputs=["place"])
    errors = {s.model: s.rmse for s in comparison.scores}
    assert errors["1"] < 1e-12 < errors["0"]
    said = facts(comparison, {"place": "m"})
    assert "Of 1, input extra is not recorded: its start value 1 N serves." in said


ARRAY = '<Float64 name="grid" valueReference="9001" causality="input" start="1 2 3"><Dimension start="3"/></Float64>'
TEXT = '<String name="file" valueReference="9002" causality="input"><Start value="a.txt"/></String>'
CLOCK = '<Clock name="tick" valueReference="9003" causality="input" intervalVariability="triggered"/>'
OUT = '<Float64 name="field" valueReference="9004" causality="output"><Dimension start="2"/></Float64>'
END = "</ModelVariables>"


def with_variables(variants, tmp_path, *texts: str):
    """An FMU of FMI 3 that has these variables too; nothing asks its binary for them."""
    good = variants["delayed mass", ("fmi", 3)]
    return rewritten(good, tmp_path / "more.fmu", xml={END: "".join(texts) + END})


def test_arrays_and_texts_keep_their_start_values_and_are_told(variants, tmp_path):
    block = read_fmu(with_variables(variants, tmp_path, ARRAY, TEXT, OUT))
    assert [s.name for s in block.inputs] == ["force", "extra"]
    assert block.notes == (
        "no column can feed input grid (an array of Float64, '1 2 3'): its start value serves",
        "no column can feed input file (String, 'a.txt'): its start value serves",
        "outputs that hold no single number are left out: field (an array of Float64)",
    )
    plain = read_fmu(variants["delayed mass", ("fmi", 3)]).free_run(recorded(extra=1.0))
    np.testing.assert_array_equal(block.free_run(recorded(extra=1.0))["place"], plain["place"])
    with pytest.raises(DeclarationError, match=r"'field' holds no single number \(it is an array of Float64\)"):
        load(f"{block.path}:field")
    with pytest.raises(DeclarationError, match="grid: it is an array of Float64"):
        block.with_values({"grid": 1.0})


def test_clocks_are_refused_by_name_before_anything_runs(variants, tmp_path):
    block = read_fmu(with_variables(variants, tmp_path, CLOCK))
    with pytest.raises(DeclarationError, match=r"input clocks \(tick\), and hydrotwin ticks none"):
        block.free_run(recorded(extra=1.0))


def test_a_check_with_an_input_that_the_reference_lacks_is_not_tried(fmus):
    row = check_fmu(fmus["delayed mass"], reference=recorded())["reference"]
    assert (row.verdict, row.detail) == ("not tried", "the reference lacks inputs (extra)")


def test_a_check_sets_inputs_of_the_reference_and_nothing_else(fmus, tmp_path):
    run = read_fmu(fmus["delayed mass"]).free_run(recorded(force=3.0, extra=2.0))
    write_record(run.with_signals({"force": np.full(len(TIME), 3.0)}, {"force": "N"}), tmp_path / "run.csv")
    words = ("check", str(fmus["delayed mass"]), "--reference", str(tmp_path / "run.csv"), "--set")
    assert hydrotwin(*words, "extra=2 N").code == 0
    wrong = hydrotwin(*words, "mass.mass=2")
    assert wrong.code == 2 and "--set mass.mass is no input of" in wrong.said
