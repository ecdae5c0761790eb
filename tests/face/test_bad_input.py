"""Bad input of every kind: an exit code, a sentence with what, where and the next step, and nothing else touched."""

from __future__ import annotations

import errno
import functools
import os
import shlex
import sys
from collections import OrderedDict
from pathlib import Path

import pytest

import hydrotwin as ht
from hydrotwin.comparison import ASIDE
from hydrotwin.learned import train_network
from hydrotwin.report.written import MANIFEST
from tests.face.bad_files import make
from tests.face.command_line import contents, hydrotwin

SIMULATE = "simulate cehA --out out.csv --input"
RUN = "--input good.csv --out out.csv"
FIT = "--out old.toml --starts 1"
KNOWN_COLUMNS = ("command", "arm_angle", "motor_speed")

RECORDINGS = {
    "bar.csv": ["bar.csv: column 'command' is in bar, the model needs V", "--scale 'command="],
    "percent.csv": ["percent.csv: column 'command' is in %, the model needs V", "--scale 'command=FACTOR V/%'"],
    "no_command.csv": ["no_command.csv: no column 'command'", "cehA needs 'command [V]'", "Did you mean 'comand'?"],
    "no_unit.csv": ["no_unit.csv: row 1, column 'command' has no unit", "Write 'command [unit]'"],
    "odd_unit.csv": ["odd_unit.csv: row 1, column 'command': unit 'vlots'"],
    "no_time.csv": ["no_time.csv: row 1: no column is called a time (got clock", "--time 'clock'"],
    "time_in_volts.csv": ["time_in_volts.csv: row 1, column 'time' is in V", "Time is in s"],
    "twice.csv": ["twice.csv: row 1, columns 2 and 3 are both named 'command'", "rename one"],
    "no_header.csv": ["no_header.csv: row 1: no column is called a time (got 1, 2", "--rate 1000"],
    "text.csv": ["text.csv: row 4, column 'command': not a number (got 'abc')", "Write a decimal point"],
    "nan.csv": ["nan.csv: row 4, column 'command': no value", "Repair the file"],
    "gap.csv": ["gap.csv: row 4, column 'command': no value", "Repair the file"],
    "infinite.csv": ["infinite.csv: row 4, column 'command': not finite (got inf", "Remove the row"],
    "backward.csv": [
        "backward.csv: row 4, column 'time': time runs backward (got 0.005 s after 0.01 s",
        "sort the rows",
    ],
    "same_time.csv": ["same_time.csv: row 4, column 'time': the same time as in row 3", "remove one of the two"],
    "ragged.csv": ["ragged.csv: row 4, column 'piston_force': the row is too short (got 7", "Repair or delete"],
    "cut_off.csv": ["cut_off.csv: row 302, column", "the file ends in the middle", "copy it again"],
    "empty.csv": ["empty.csv: row 1: the file is empty", "It needs a header 'time [s]"],
    "header_only.csv": ["header_only.csv: no row of numbers", "Record longer"],
    "one_row.csv": ["one_row.csv: only one row of values (row 2)", "Record longer"],
    "noise.csv": ["noise.csv: row 1: not a text file", "--encoding"],
    "noise.parquet": ["noise.parquet: not a whole Parquet file", "export it again"],
    "noise.mat": ["noise.mat: not a whole MAT file", "export it again"],
    "good.cvs": ["good.cvs: not a recording format (got '.cvs')", "Did you mean '.csv'?"],
    "god.csv": ["god.csv: no such file", "Did you mean 'good.csv'?"],
    "nowhere/good.csv": ["nowhere/good.csv: no such file", "the folder 'nowhere' does not exist"],
}

MODELS = {
    "cehB": ["MODEL: 'cehB' is no model", "Did you mean 'cehA'?"],
    "cehA:third": ["'cehA:third' is no model", "Did you mean 'cehA:third_order'?"],
    "old.tmol": ["'old.tmol' is no model", "a .toml or .fmu file, or file.py:factory"],
    "odl.toml": ["odl.toml: no such file", "Did you mean 'old.toml'?"],
    "odl.fmu": ["odl.fmu: no such file"],
    "cehA@": ["no file after '@'", "Write cehA@model.toml"],
    "eq17@old.toml": ["old.toml: only a physical model takes the values of a model file"],
    "starts_code.toml": ["starts_code.toml: its model is Python code ('rig.py:f')", "rig.py:f@starts_code.toml"],
    "fmu_gone.toml": ["fmu_gone.toml: its FMU is not there (got 'absent.fmu')", "Put it where the file says"],
    "unknown_model.toml": ["unknown_model.toml: its model is none of", "Did you mean 'cehA'?"],
    "unknown_key.toml": ["unknown_key.toml: unknown key 'run'", "A model file holds data only"],
    "yaml.toml": ["yaml.toml: this is not TOML", "line 1", "Correct that place"],
    "cut.toml": ["cut.toml: this is not TOML", "Correct that place"],
    "cut_at_line.toml": ["cut_at_line.toml: it ends too early", "copy it again"],
    "unknown_parameter.toml": ["unknown_parameter.toml: cehA.motor: no parameter 'gian'", "Did you mean 'motor.gain'?"],
    "out_of_bounds.toml": ["out_of_bounds.toml: cehA.motor.gain: value outside its bounds (got 10", "[20, 600]"],
    "other_dimension.toml": ["other_dimension.toml: cehA.motor.gain: unit 'm': cannot become 'rad/(s.V)'"],
    "no_unit.toml": ["no_unit.toml: motor.gain: no unit", 'Add unit = ".."'],
    "text_value.toml": ["text_value.toml: motor.gain: value is no number (got '120')", "Give a number"],
    "nan_value.toml": ["nan_value.toml: motor.gain: value and sigma must be finite"],
    "no_table.toml": ["no_table.toml: 'parameters' is no table (got 3)", "Correct it"],
    "newer.toml": ["newer.toml: written by a newer version (format 99)", "Update hydrotwin"],
    "effects.toml": ["effects.toml: effect 1 has no 'site'", "'hydrotwin effects MODEL' lists both"],
    "nothing.toml": ["nothing.toml: no model file (no line model", "hydrotwin identify"],
    "noise.toml": ["noise.toml: this is not TOML"],
    "scenario.toml": ["scenario.toml: a scenario, not a model", "hydrotwin compare scenario.toml"],
    "odd_block.toml": ["odd_block.toml: unknown kind of learned block (got 'perceptron')", "Known:"],
    "cut_header.toml": ["cut_header.toml: this is not TOML"],
    "cut_header_at_line.toml": ["the header lacks or garbles 'outputs'", "copy both files again"],
    "cut_arrays.toml": ["cut_arrays.npz: not the arrays this header was written with", "Copy both files again"],
    "other_arrays.toml": ["other_arrays.npz: not the arrays this header was written with"],
    "lost_arrays.toml": ["lost_arrays.toml: its arrays are missing (looked for lost.npz)", "beside the .toml"],
    "cut.fmu": ["cut.fmu: not an FMU", "Check the download"],
    "text.fmu": ["text.fmu: not an FMU", "must be a zip archive with a modelDescription.xml"],
    "other.fmu": ["other.fmu: not an FMU", "modelDescription.xml"],
    "rg.py:f": ["rg.py: no such file", "Did you mean 'rig.py'?"],
    "rig.py:bom": ["rig.py: no function 'bom'", "Did you mean 'boom'?"],
    "rig.py:f": ["rig.py:f: returns no Model (got int)", "Return Model(component, 'name')"],
    "rig.py:boom": ["rig.py: line 6: does not run (ValueError: no rig today)", "Correct the file"],
    "rig.py:needs": ["rig.py: line 9: needs needs arguments (rig)", "Give each a default value"],
    "syntax.py:f": ["syntax.py: line 2: does not run (SyntaxError", "Correct that line"],
    "imports.py:f": ["imports.py: line 1: does not run (ModuleNotFoundError", "no_such_package_of_anybody"],
    "leaves.py:f": ["leaves.py: line 3: does not run (SystemExit: 0)", "Correct the file"],
}

COMMANDS = {
    # the command line itself
    "simulat cehA": ["No such command 'simulat'", "simulate"],
    "simulate cehA": ["Missing option '--input'"],
    "simulate cehA --inptu good.csv": ["No such option: --inptu", "--input"],
    f"{SIMULATE} good.csv --step soon": ["--step: 'soon' is no number. Write --step 1ms"],
    "learn nn good.csv --out block.toml --input command --output motor_speed --budget 0": ["--budget"],
    # simulate
    f"simulate cehA {RUN} --set motor.gian=3": ["cehA.motor: no parameter 'gian'", "Did you mean 'motor.gain'?"],
    f"simulate cehA {RUN} --set motor.gain": ["--set motor.gain: no 'name=value'", "motor.gain=130"],
    f"simulate cehA {RUN} --set motor.gain=fast": ["--set motor.gain: 'fast' is no number"],
    f"simulate cehA {RUN} --set motor.gain=nan": ["--set motor.gain: 'nan' is no number"],
    f"simulate cehA {RUN} --method euler": ["cehA: no simulation method 'euler'", "Known: auto, explicit"],
    f"simulate cehA {RUN} --step -1": ["cehA: the step must be positive (got -1.0 s)", "Give seconds"],
    f"simulate block.toml {RUN} --set gain=3": ["no parameter 'gain'"],
    f"simulate old.fmu {RUN} --set motor.gain=3": ["old.fmu: no variable 'motor.gain'", "arm_angle.start"],
    f"simulate old.fmu {RUN} --set arm_angle.start=3bar": ["'bar': cannot become 'rad'"],
    f"simulate old.fmu {RUN} --set arm_angle.start": ["--set arm_angle.start: no 'name=value'"],
    f"simulate old.fmu {RUN} --step 0.1": ["'old.fmu' is an FMU, which --step and --method", "Drop them"],
    f"{SIMULATE} percent.csv --scale comand='0.05 V/%'": ["no column 'comand'", "Did you mean 'command'?"],
    f"{SIMULATE} percent.csv --scale command=0.05": ["percent.csv: column 'command' is in 1, the model needs V"],
    f"{SIMULATE} percent.csv --scale twenty": ["scale: not understood (got 'twenty')", "--scale command=0.05 V/%"],
    "simulate cehA --input good.csv --out good.csv": ["good.csv: this command reads it", "Choose another name"],
    "simulate cehA --input good.csv --out out.xyz": ["out.xyz: not a name this command can write to", "out.csv"],
    "simulate cehA --input good.csv --out report": ["report: a folder, not a file", "report/NAME.csv"],
    # where nobody may write
    "simulate cehA --input good.csv --out good.csv/o.csv": ["good.csv/o.csv: cannot be written (Not a directory)"],
    "identify cehA good.csv --out good.csv/m.toml": ["good.csv/m.toml: cannot be written"],
    "identify cehA good.csv --out new.toml --report good.csv": ["good.csv: a file, where a folder is needed"],
    "compare --model cehA --validate good.csv --out good.csv": ["good.csv: a file, where a folder is needed"],
    "export cehA --out good.csv/a.fmu": ["good.csv/a.fmu: cannot be written"],
    "modelica cehA --out good.csv/a.mo": ["good.csv/a.mo: cannot be written"],
    "linearize cehA --out good.csv": ["good.csv: a file, where a folder is needed", "Name a folder"],
    "friction good.csv --out good.csv": ["good.csv: a file, where a folder is needed"],
    "demo --out good.csv": ["good.csv: a file, where a folder is needed"],
    # identify
    f"identify cehA good.csv {FIT} --free motor.gian": ["cehA: no parameter matches 'motor.gian'", "'motor.gain'?"],
    f"identify cehA good.csv {FIT} --free 'wheel*'": ["no parameter matches 'wheel*'", "Known: precharge, motor.gain"],
    f"identify cehA good.csv {FIT} --output arm_angel": ["cehA: no output 'arm_angel'", "Did you mean 'arm_angle'?"],
    f"identify cehA good.csv {FIT} --bounds motor.gain=130": ["--bounds motor.gain=130: no 'path=low:high'", "50:200"],
    f"identify cehA good.csv {FIT} --bounds motor.gain=200:100": ["motor.gain=200:100", "low below high"],
    f"identify cehA good.csv {FIT} --bounds motor.gian=1:200": ["no parameter 'gian'", "'motor.gain'?"],
    f"identify cehA good.csv {FIT} --bounds arm.length=1:2": ["arm.length: bounds were given, but it is not free"],
    f"identify cehA good.csv {FIT} --method euler": ["no simulation method 'euler'", "explicit"],
    f"identify cehA good.csv {FIT} --step 0": ["the step must be positive"],
    f"identify cehA good.csv {FIT} --loss cubic": ["identify: no loss 'cubic'", "Known: linear"],
    f"identify cehA good.csv {FIT} --initial-states some": ["no initial_states 'some'", "Known: auto"],
    f"identify cehA good.csv bar.csv {FIT}": ["bar.csv: column 'command' is in bar", "--scale 'command="],
    f"identify cehA good.csv --validate bar.csv {FIT}": ["bar.csv: column 'command' is in bar", "--scale 'command="],
    f"identify cehA good.csv --validate one_row.csv {FIT}": ["one_row.csv: only one row of values"],
    f"identify cehA no_output.csv {FIT}": ["none of the outputs of cehA is recorded", "At least one of arm_angle"],
    f"identify cehA still.csv {FIT}": ["output 'motor_speed' is constant in every recording"],
    f"identify spool_valve good.csv {FIT}": [
        "good.csv: no column 'current', spool_valve needs 'current [1]'",
        "command",
    ],
    f"identify eq17 good.csv {FIT}": ["identify: 'eq17' is no physical model", "Give cehA"],
    f"identify out_of_bounds.toml good.csv {FIT}": ["motor.gain: value outside its bounds", "widen the bounds"],
    "identify cehA good.csv --out model.txt": ["model.txt: not a name this command can write to", "model.toml"],
    "identify cehA good.csv --out good.csv": ["good.csv: not a name this command can write to", "good.toml"],
    "identify old.toml good.csv --out old.toml": ["old.toml: this command reads it", "Choose another name"],
    # learn
    "learn nnn good.csv --out block.toml": ["learn: no kind 'nnn'", "Did you mean 'nn'?"],
    "learn nn good.csv --out block.toml": ["which columns are inputs", "Give --input and --output", *KNOWN_COLUMNS],
    "learn nn good.csv --input command --output arm_angel --out block.toml": [
        "good.csv: no column 'arm_angel'",
        "angle'?",
    ],
    "learn nn good.csv speed.csv --input command --output arm_angle --out block.toml": [
        "speed.csv: no column 'arm_angle'"
    ],
    "learn nn good.csv --input command --output command --out block.toml": ["named both as input and output"],
    "learn nn still.csv --input command --output motor_speed --out block.toml": [
        "'motor_speed' never changes",
        "moves it",
    ],
    "learn nn no_move.csv --input command --output motor_speed --out block.toml": ["'command' never changes", "moves"],
    "learn nn speed.csv --out block.npz": ["block.npz: not a name this command can write to", "block.toml"],
    # compare
    "compare cehA --validate run.csv --out report": ["no scenario file 'cehA'", "--model cehA"],
    "compare m.py:axis@gap/model.toml --out report": ["no scenario file", "--model m.py:axis@gap/model.toml"],
    "compare run.CSV --model cehA --out report": ["is a recording", "--validate run.CSV"],
    "compare --out report": ["give either a scenario file, or --model and --validate"],
    "compare --model cehA --out report": ["no recording to compare on", "Give --validate REC"],
    "compare scenario.toml --model cehA --out report": ["give either a scenario file, or --model"],
    "compare scenario.toml --validate good.csv --out report": ["scenario.toml says all, --validate would be ignored"],
    "compare --model cehA --model cehA --validate good.csv --out report": [
        "two models are called 'cehA'",
        "another name",
    ],
    "compare --model cehA --validate good.csv --mode 'fre run' --out report": ["no mode 'fre run'", "'free run'?"],
    "compare --model cehA --validate good.csv --output arm_angel --out report": ["no model has an output 'arm_angel'"],
    "compare --model cehA --validate percent.csv --out report": ["percent.csv: column 'command' is in %", "FACTOR V/%"],
    "compare --model spool_valve --validate good.csv --out report": ["no recording holds an output of any model"],
    "compare odd_key.toml --out report": ["odd_key.toml: unknown key 'validat'", "Did you mean 'validate'?"],
    "compare unknown_mode.toml --out report": ["unknown_mode.toml: no mode 'fre run'", "Did you mean 'free run'?"],
    "compare no_recording.toml --out report": [
        "no_recording.toml: no recording 'goood.csv'",
        "Did you mean 'good.csv'?",
    ],
    "compare no_models.toml --out report": ["no_models.toml: no 'models'", "Add models = [...]"],
    "compare not_a_list.toml --out report": ["not_a_list.toml: 'models' is not a list", "Write models = [...]"],
    "compare twins.toml --out report": ["two models are called 'cehA'", "Give one of them another name"],
    "compare broken.toml --out report": ["broken.toml: not a TOML file", "line"],
    "compare scenaro.toml --out report": ["scenaro.toml: no such scenario", "Did you mean 'scenario.toml'?"],
    "compare report --out report": ["report: cannot be read (Is a directory)", "Check the path"],
    # export, check
    "export old.fmu --out old.fmu": ["'old.fmu' is an FMU already", "Give a physical model or a learned block"],
    "export cehA --fmi 9 --out old.fmu": ["FMI 9", "Use fmi=2"],
    "export cehA --kind cosim --out old.fmu": ["cosim", "kind='cs'"],
    "export cehA --start warm --out old.fmu": ["no start 'warm'", "positions"],
    "export cehA --out report": ["report: a folder, not a file"],
    "export cehA --out old.zip": ["old.zip: not a name this command can write to", "Write to old.fmu"],
    "check odl.fmu": ["odl.fmu: no such file"],
    "check old.fmu --reference god.csv": ["god.csv: no such file", "Did you mean 'good.csv'?"],
    "check old.fmu --reference bar.csv": ["bar.csv: column 'command' is in bar", "--scale"],
    # looking at a model
    "linearize cehA --at arm.angel=0.3 --out report": [
        "cehA: no input or state 'arm.angel'",
        "Did you mean 'arm.angle'?",
    ],
    "linearize cehA --at arm.angle --out report": ["--at arm.angle: no 'name=value'"],
    "linearize eq17 --out report": ["linearize: 'eq17' is no physical model", "Give cehA"],
    "modelica old.fmu --out old.mo": ["modelica: 'old.fmu' is no physical model"],
    "modelica cehA --out old.csv": ["old.csv: not a name this command can write to", "old.mo"],
    "friction good.csv --out report": ["good.csv: no column 'velocity'", "--velocity"],
    "friction speed.csv --velocity motor_sped --force command": ["speed.csv: no column 'motor_sped'", "'motor_speed'?"],
    "demo --machine cehB --out report": ["no recordings of 'cehB'", "cehA and spool_valve"],
}

FAILURES = {
    f"simulate cehA {RUN} --set cylinder.oil.bulk_modulus=1e30": ["cehA.cylinder.", "at t = ", "a smaller step"],
    "check cut.fmu": ["cut.fmu: not an FMU", "Check the download"],
    "check text.fmu": ["text.fmu: not an FMU", "Check the download"],
    "check other.fmu": ["other.fmu: not an FMU", "modelDescription.xml"],
    "check good.csv": ["good.csv: not an FMU"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make(tmp_path_factory.mktemp("bad"))


@pytest.fixture
def here(folder, monkeypatch):
    """Run a test in the folder; whatever it does, every file in it stays as it was and none is added: the answer of an
    earlier run, put aside, is whole."""
    monkeypatch.chdir(folder)
    before = whole(folder)
    yield folder
    assert whole(folder) == before


def whole(folder) -> dict:
    """What is in the files, those that were put aside as if they had not been."""
    aside = f"{ASIDE}/"
    found = {str(name).replace(aside, ""): (name, text) for name, text in contents(folder).items()}
    return {name: text for name, (at, text) in found.items() if not (aside in str(at) and name.endswith(MANIFEST))}


def refused(line: str, code: int, says: list[str]) -> None:
    """The command stops with ``code`` and says these things, in sentences, without a traceback."""
    answer = hydrotwin(*shlex.split(line))
    assert answer.code == code, answer.said
    assert "Traceback" not in answer.said
    for words in says:
        assert words in answer.said, answer.said
    if "Usage:" not in answer.err and code == 2:
        assert answer.out.strip() == ""
        assert answer.err.lstrip("\n").startswith(("error ", "ignored columns", "learning ", "read "))
        assert answer.err.rstrip().endswith((".", "?")), "a message ends as a sentence"


@pytest.mark.parametrize("name", RECORDINGS)
def test_an_unusable_recording_is_refused_with_file_row_and_column(here, name):
    refused(f"{SIMULATE} {name}", 2, RECORDINGS[name])


@pytest.mark.parametrize("spec", MODELS)
def test_what_is_no_model_is_refused_by_name(here, spec):
    refused(f"simulate {spec} {RUN}", 2, MODELS[spec])


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_that_cannot_be_done_says_what_to_do_instead(here, line):
    refused(line, 2, COMMANDS[line])


@pytest.mark.parametrize("line", FAILURES)
def test_an_honest_failure_ends_with_exit_code_one(here, line):
    refused(line, 1, FAILURES[line])


def test_a_model_file_runs_no_code(here, monkeypatch):
    monkeypatch.delitem(sys.modules, "hydrotwin_user_rig", raising=False)
    hydrotwin("simulate", "yaml.toml", "--input", "good.csv")
    hydrotwin("simulate", "starts_code.toml", "--input", "good.csv")
    assert not Path("pwned").exists()
    assert "hydrotwin_user_rig" not in sys.modules


def test_a_parameter_without_effect_is_named_in_the_findings(here, tmp_path):
    path = tmp_path / "m.toml"
    answer = hydrotwin(
        "identify", "cehA", "speed.csv", "--free", "motor.gain", "--free", "cylinder.friction.viscous",
        "--starts", "1", "--out", path,
    )  # fmt: skip
    assert answer.code == 0
    assert "cylinder.friction.viscous has no effect on any recorded output" in answer.said
    read = {p.name: p for p in ht.load(path).flat.parameters}
    assert read["cylinder.friction.viscous"].value == 741.36
    assert read["cylinder.friction.viscous"].sigma is None, "what the recordings do not show has no uncertainty"


@pytest.mark.parametrize(
    "line",
    [
        f"simulate cehA {RUN}",
        "identify cehA speed.csv --free motor.gain --starts 1 --out old.toml",
        "learn nn speed.csv --hidden 2 --budget 1 --out block.toml",
        "compare --model eq17 --validate good.csv --mode 'free run' --out report",
        "export eq17 --out old.fmu",
        "modelica cehA --out old.mo",
        "linearize cehA --out report",
    ],
    ids=lambda line: line.split()[0],
)
def test_a_write_that_fails_leaves_the_old_file_whole(here, monkeypatch, line):
    replace = os.replace

    def full(source, target, **options):
        if here in Path(target).absolute().parents:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(source), None, str(target))
        replace(source, target, **options)

    if line.startswith("learn"):
        instant = functools.wraps(train_network)(lambda *_, **__: ht.published_formula())
        monkeypatch.setattr("hydrotwin.learned.train_network", instant)
    monkeypatch.setattr(os, "replace", full)
    answer = hydrotwin(*shlex.split(line))
    assert answer.code == 2, answer.said
    assert "No space left on device" in answer.err
    assert any(name in answer.err for name in contents(here)), "the message names the file"


def test_a_comparison_that_scores_nothing_leaves_the_old_report_whole(here):
    changed = "compare --model diverging=wild.toml --validate good.csv --mode 'free run' --out report"
    Path("wild.toml").write_text(
        'model = "cehA"\n[parameters]\ncylinder.oil.bulk_modulus = {value = 1e30, unit = "Pa", bounds = [1, 1e31]}\n'
    )
    try:
        refused(changed, 1, ["no model could be scored", "cylinder.", "at t = "])
    finally:
        Path("wild.toml").unlink()


def test_without_a_compiler_simulation_goes_on_and_export_says_what_to_install(here, tmp_path, monkeypatch):
    monkeypatch.setattr("hydrotwin.simulation.engines._kept", OrderedDict())  # nobody has run the machine before
    monkeypatch.setattr("hydrotwin.simulation.compiler.compilers", lambda: [])
    monkeypatch.setattr("hydrotwin.export.build._compilers", lambda *_: [])
    for name in ("compiled", "interpreted"):
        method = ["--method", "vm"] if name == "interpreted" else []
        words = ["simulate", "cehA", "--input", "good.csv", "--out", tmp_path / f"{name}.csv"]
        answer = hydrotwin(*words, *method)
        assert answer.code == 0
        assert ("note cehA: no C compiler found" in answer.said) == (name == "compiled")
    assert (tmp_path / "compiled.csv").read_text() == (tmp_path / "interpreted.csv").read_text()
    refused("export cehA --out old.fmu", 1, ["no compiler found", "pip install ziglang"])
