"""Scenario files: read, refused with the nearest name, run."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from hydrotwin.comparison import HoldLast, ModelEntry, Scenario, Wanted, load_contenders, read_scenario, run_scenario
from hydrotwin.models.language.errors import DataError, DeclarationError, UnitError
from hydrotwin.records import write_record
from tests.comparison.toys import Toy, recording

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def folder(tmp_path):
    for k in (1, 2):
        write_record(recording(k), tmp_path / f"validation_{k}.csv")
    write_record(recording(9), tmp_path / "training_1.csv")
    (tmp_path / "fitted.toml").write_text('model = "cehA"\n')
    return tmp_path


def scenario(folder, text):
    path = folder / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_scenario_reads_with_paths_beside_its_file(folder):
    found = read_scenario(
        scenario(
            folder,
            """
            title = "Two toys"
            models = ["good", "fitted.toml", {model = "bad", name = "spoilt"}, "mine.py:make"]
            validate = ["validation_*.csv"]
            train = ["training_1.csv"]
            modes = ["free run"]
            outputs = ["arm_angle"]
            scale = {command = "0.05 V/%"}
            """,
        )
    )
    assert found.title == "Two toys"
    assert found.models == (
        ModelEntry("good"),
        ModelEntry(str(folder / "fitted.toml")),
        ModelEntry("bad", "spoilt"),
        ModelEntry(f"{folder / 'mine'}.py:make"),
    )
    assert found.validate == (folder / "validation_1.csv", folder / "validation_2.csv")
    assert found.train == (folder / "training_1.csv",)
    assert (found.modes, found.outputs, found.base) == (("free run",), ("arm_angle",), folder)
    assert found.reading.scale["command"].unit == "V/%" and found.reading.scale["command"].factor == 0.05


def test_recordings_may_lie_in_a_folder_that_a_variable_names(folder, tmp_path_factory, monkeypatch):
    monkeypatch.setenv("HYDROTWIN_TEST_DATA", str(folder))
    (elsewhere := tmp_path_factory.mktemp("elsewhere") / "values").mkdir()
    (elsewhere / "a$b.csv").write_bytes((folder / "validation_1.csv").read_bytes())
    (elsewhere / "mine.toml").write_text('model = "mine.py:make"\n')
    text = """
        models = ["good", "mine.py:make@mine.toml"]
        validate = [
            {file = "${HYDROTWIN_TEST_DATA}/validation_1.csv", tags = {run = 1}},
            "$HYDROTWIN_TEST_DATA/val*_2.csv", "a$b.csv",
        ]
        train = ["$HYDROTWIN_TEST_DATA/training_1.csv"]
    """
    found = read_scenario(scenario(elsewhere, text))
    assert found.validate == (folder / "validation_1.csv", folder / "validation_2.csv", elsewhere / "a$b.csv")
    assert found.train == (folder / "training_1.csv",)
    assert found.tags.by_file == {folder / "validation_1.csv": {"run": 1}}
    assert found.models[1].model == f"{elsewhere / 'mine'}.py:make@{elsewhere / 'mine.toml'}"
    with pytest.raises(DataError, match=r"no model file 'other\.toml'"):
        read_scenario(scenario(elsewhere, text.replace("@mine", "@other")))


@pytest.mark.parametrize("said", [None, ""])
def test_a_variable_that_is_not_set_is_named(folder, monkeypatch, said):
    monkeypatch.delenv("HYDROTWIN_TEST_DATA", raising=False)
    if said is not None:
        monkeypatch.setenv("HYDROTWIN_TEST_DATA", said)
    path = scenario(folder, 'models = ["good"]\nvalidate = ["$HYDROTWIN_TEST_DATA/a.csv"]\n')
    with pytest.raises(DataError, match=r"environment variable HYDROTWIN_TEST_DATA, which is not set\. Set it"):
        read_scenario(path)


def test_a_file_is_found_whatever_stands_in_its_name_and_counts_once(folder):
    for name in ("run*[1].csv", "what?.csv"):
        (folder / "validation_1.csv").replace(folder / name)
        told = f'models = ["good"]\nvalidate = ["{name}", "validation_2.csv", "validation_*.csv"]'
        assert read_scenario(scenario(folder, told)).validate == (folder / name, folder / "validation_2.csv")
        (folder / name).replace(folder / "validation_1.csv")


def test_a_copy_of_a_recording_is_refused_for_it_would_count_twice(folder):
    (folder / "again.csv").write_bytes((folder / "validation_1.csv").read_bytes())
    path = scenario(folder, 'models = ["good"]\nvalidate = ["validation_1.csv", "again.csv"]')
    with pytest.raises(DataError, match=r"again.csv: the same recording as .*validation_1.csv"):
        run_scenario(read_scenario(path), lambda name: Toy(name), repeats=1)


def test_a_scenario_runs(folder):
    path = scenario(
        folder, 'models = ["good", "hold_last"]\nvalidate = ["validation_1.csv"]\ntrain = ["training_1.csv"]'
    )
    comparison = run_scenario(read_scenario(path), lambda name: Toy(name), repeats=1)
    assert comparison.title == "scenario"
    assert comparison.models == ("good", "hold last sample")
    assert comparison.records[0].digest
    assert comparison.ranking("arm_angle")[0].model == "good"


def test_the_yardstick_takes_its_place_and_the_outputs_of_the_others(folder):
    path = scenario(folder, 'models = ["hold_last", "good"]\nvalidate = ["validation_1.csv"]')
    first, second = load_contenders(read_scenario(path), lambda name: Toy(name))
    assert isinstance(first, HoldLast)
    assert first.outputs == second.outputs


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('model = ["good"]\nvalidate = ["validation_1.csv"]', "unknown key 'model'. Did you mean 'models'"),
        ('models = ["good"]\nvalidte = ["validation_1.csv"]', "unknown key 'validte'. Did you mean 'validate'"),
        ('models = ["good"]', "no 'validate'"),
        ('models = []\nvalidate = ["validation_1.csv"]', "no 'models'"),
        ('models = "good"\nvalidate = ["validation_1.csv"]', "'models' is not a list"),
        ('models = [3]\nvalidate = ["validation_1.csv"]', "a model is a text or a table"),
        ('models = [{name = "x"}]\nvalidate = ["validation_1.csv"]', "a model has no 'model'"),
        ('models = [{model = "x", nme = "y"}]\nvalidate = ["validation_1.csv"]', "Did you mean 'name'"),
        ('models = ["good"]\nvalidate = [1]', "'validate' holds no text"),
        (
            'models = ["good"]\nvalidate = ["validation_1.csv"]\nmodes = ["free"]',
            "no mode 'free'. Did you mean 'free run'",
        ),
        ('models = ["good"]\nvalidate = ["validation_1.csv"]\nscale = ["V"]', "'scale' is no table"),
    ],
)
def test_what_a_scenario_cannot_say_is_refused_with_the_next_step(folder, text, message):
    with pytest.raises(DeclarationError, match=message):
        read_scenario(scenario(folder, text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('models = ["good"]\nvalidate = ["validatoin_1.csv"]', "Did you mean 'validation_1.csv'"),
        ('models = ["fited.toml"]\nvalidate = ["validation_1.csv"]', "Did you mean 'fitted.toml'"),
        ('models = ["good"]\nvalidate = ["none_*.csv"]', "no recording"),
        ("models = [", "not a TOML file"),
    ],
)
def test_files_that_are_not_there_are_refused(folder, text, message):
    with pytest.raises(DataError, match=message):
        read_scenario(scenario(folder, text))


def test_a_scenario_that_does_not_exist_names_the_nearest_file(folder):
    scenario(folder, "")
    with pytest.raises(DataError, match=r"Did you mean 'scenario\.toml'"):
        read_scenario(folder / "scenaro.toml")


def test_the_shipped_scenario_runs_and_its_full_model_beats_the_published_formula():
    import hydrotwin

    path = Path(__file__).resolve().parents[2] / "examples" / "cehA" / "scenario.toml"
    comparison = run_scenario(read_scenario(path), hydrotwin.load, repeats=1)
    assert not comparison.failures
    ranked = comparison.ranking("arm_angle")
    names = [score.model for score in ranked]
    assert names.index("cehA") < names.index("Eq. 17")


@pytest.mark.parametrize(
    ("model", "label"),
    [
        ("eq17", "eq17"),
        ("cehA:third_order", "cehA:third_order"),
        ("models/fitted.toml", "fitted.toml"),
        ("bought/pump.fmu:p,q", "pump.fmu:p,q"),
        ("rig.py:axis", None),
        ("cehA@found/model.toml", "cehA@model.toml"),
    ],
)
def test_a_model_without_a_name_goes_by_how_it_is_written(model, label):
    assert ModelEntry(model).label == label and ModelEntry(model, "mine").label == "mine"


def test_a_built_in_model_has_one_name_in_scenario_criteria_and_tables():
    import hydrotwin

    path = Path(__file__).resolve().parents[2] / "examples" / "cehA" / "recordings" / "validate_1.csv"
    accept = ("arm_angle not worse than eq17 by 900 %", "arm_angle not worse than cehA:third_order by 900 %")
    models = tuple(map(ModelEntry, ("cehA", "eq17", "cehA:third_order")))
    described = Scenario("one name", models, (path,), modes=("free run",), wanted=Wanted(accept))
    comparison = run_scenario(described, hydrotwin.load, repeats=0)
    assert comparison.models == ("cehA", "eq17", "cehA:third_order")
    assert {s.model for s in comparison.scores} == set(comparison.models)
    wrong = dataclasses.replace(described, wanted=Wanted(("arm_angle not worse than hold_last",)))
    held = dataclasses.replace(wrong, models=(*models, ModelEntry("hold_last")))
    with pytest.raises(DeclarationError, match="Did you mean 'hold last sample'"):
        run_scenario(held, hydrotwin.load, repeats=0)


@pytest.mark.parametrize("value", [130.0, "130", "130 rad/(s.V)", "0.13 rad/(s.mV)"])
def test_an_entry_sets_values_of_a_physical_model_in_si_or_with_their_unit(value):
    import hydrotwin

    entry = ModelEntry("cehA", "set", {"motor.gain": value})
    (contender,) = load_contenders(Scenario("", (entry,), (Path("none.csv"),)), hydrotwin.load)
    assert {p.name: p.value for p in contender.flat.parameters}["motor.gain"] == pytest.approx(130.0, rel=1e-12)


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("motor.gain", "130 bar", r"'bar': cannot become"),
        ("motor.gain", "much", "no number"),
        ("motor.gian", "130", "Did you mean 'motor.gain'"),
    ],
)
def test_an_entry_that_sets_what_does_not_fit_is_refused(path, value, says):
    import hydrotwin

    entry = ModelEntry("cehA", "set", {path: value})
    with pytest.raises((DeclarationError, UnitError), match=says):
        load_contenders(Scenario("", (entry,), (Path("none.csv"),)), hydrotwin.load)


@pytest.mark.parametrize(
    ("models", "validate", "missing", "command"),
    [
        ('["out/a.toml"]', '["good.csv"]', "no model file 'out/a.toml'", "hydrotwin learn arx"),
        ('["m.py:axis@out/b.toml"]', '["good.csv"]', "no model file 'out/b.toml'", "python make.py"),
        ('["cehA"]', '["out/run_*.csv"]', r"no recording 'out/run_\*.csv'", "python make.py"),
    ],
)
def test_a_missing_file_is_told_with_the_command_that_makes_it(tmp_path, models, validate, missing, command):
    (tmp_path / "good.csv").write_text("time [s],u [V]\n0,1\n0.1,2\n")
    made = 'made_by = {"out/a.toml" = "hydrotwin learn arx", "out/*" = "python make.py"}\n'
    file = tmp_path / "s.toml"
    file.write_text(f"models = {models}\nvalidate = {validate}\n{made}")
    with pytest.raises(DataError, match=rf"{missing}\. This makes it: {command}"):
        read_scenario(file)
    file.write_text(f"models = {models}\nvalidate = {validate}\nmade_by = 3\n")
    with pytest.raises(DeclarationError, match="'made_by' is no table of texts"):
        read_scenario(file)


@pytest.mark.parametrize("name", ["cascaded_tanks", "eha_bench", "emps", "table_1", "table_2"])
def test_shipped_scenarios_say_what_makes_their_files_as_their_readme_does(name, tmp_path, monkeypatch):
    """Copied to where nothing was made: every file that the copy lacks is one that a command of the README makes."""
    shipped = EXAMPLES / name
    for own in ("cascaded_tanks/train", "cascaded_tanks/validate", "emps/train", "emps/test_pulses"):
        (tmp_path / own).parent.mkdir(exist_ok=True)
        (tmp_path / f"{own}.csv").touch()
    (tmp_path / "eha_bench").mkdir()
    for load in (1, 2, 3):
        (tmp_path / "eha_bench" / f"load{load}_stroke1.csv").touch()
    monkeypatch.setenv("HYDROTWIN_MEASURED_DATA", str(tmp_path))
    there = tmp_path / "examples" / name
    there.mkdir(parents=True)
    (there / "scenario.toml").write_bytes((shipped / "scenario.toml").read_bytes())
    readme = re.sub(r"[\\\s]+", " ", (shipped / "README.md").read_text(encoding="utf-8"))
    while True:
        try:
            found = read_scenario(there / "scenario.toml")
            break
        except DataError as missing:
            said = re.search(r"no \w+(?: file)? '(.+?)'\. This makes it: (.+)", str(missing))
            assert said and said[2] in readme, str(missing)
            file = there / said[1].replace("*", "1")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.touch()
    assert found.models and found.validate
