"""check_fmu by the standard: a required rule broken is FAIL, advice a remark, and what cannot be tried says why."""

from __future__ import annotations

import re
import time
import zipfile
from pathlib import Path

import pytest

from hydrotwin.export import check_fmu, read_fmu
from hydrotwin.export.archive import write_archive
from hydrotwin.export.check_plan import BRIEF, _fair, _OfEach
from hydrotwin.export.fmu_process import gates, probing
from hydrotwin.export.fmu_process.verdicts import NotTried
from hydrotwin.export.rules.name_rules import STRUCTURED
from hydrotwin.export.standard import NOT_ALLOWED, SECTIONS, paragraph
from hydrotwin.models.language.errors import DeclarationError
from tests.export.foreign import CRASHES, DO_STEP, rewritten
from tests.export.systems import command_record
from tests.export.test_description import read

EXTRA = (
    '<ScalarVariable name="{name}" valueReference="9001" causality="{causality}" variability="{variability}">'
    "<{kind} {more}/></ScalarVariable>"
)
USUAL = {"name": "more", "causality": "local", "variability": "continuous", "kind": "Real", "more": ""}
END = "</ModelVariables>"


def with_variable(fmu, path, **variable: str):
    """An FMU of FMI 2 with one variable more, which its binary does not know."""
    return rewritten(fmu, path, xml={END: EXTRA.format(**{**USUAL, **variable}) + END})


@pytest.mark.parametrize(
    ("variable", "row", "words"),
    [
        ({"kind": "Integer"}, "variables", "only real variables may be continuous: more"),
        ({"causality": "parameter"}, "variables", "do not go together: more (line"),
        ({"causality": "input"}, "variables", "a start value is required: more"),
        ({"more": 'start="1"'}, "variables", "a start value is forbidden for what is calculated or independent: more"),
        ({"more": 'unit="furlong"'}, "variables", "unit 'furlong' is not defined: more (line"),
        ({"more": 'displayUnit="deg"'}, "variables", "display unit 'deg' without a unit: more (line"),
        ({"name": "angle"}, "names", "names that are not unique: angle"),
        ({"name": "a..b"}, "names", "no names of the convention 'structured' that is declared: a..b"),
        ({"causality": "output"}, "model structure", "outputs that are not listed: more"),
        ({"more": 'colour="red"'}, "schema", "colour"),
    ],
)
def test_a_required_rule_of_the_description_that_is_broken_fails_and_names_its_section(
    fmus, tmp_path, variable, row, words
):
    check = check_fmu(with_variable(fmus["lag"], tmp_path / "x.fmu", **variable))
    assert check.failures[0].name == row, str(check)
    assert words in check[row].detail
    assert check[row].rule.startswith("FMI 2.0.5, 2.2")


def test_what_fmpy_cannot_read_is_judged_by_the_rule_that_it_breaks(fmus, tmp_path):
    bad = with_variable(fmus["lag"], tmp_path / "x.fmu", causality="parameter", variability="constant")
    check = check_fmu(bad)
    [row] = check.failures
    assert (row.name, row.rule) == ("variables", "FMI 2.0.5, 2.2.7 ModelVariables")
    assert "do not go together: more (line" in row.detail
    assert (check["readable"].verdict, check["readable"].detail) == (
        "not tried", "it is not run: what is FAIL below stands in the way",
    )  # fmt: skip


def test_a_list_of_initial_unknowns_that_is_left_out_is_told(fmus, tmp_path):
    """Good exporters write none, and importers do without; a list that is there must be whole."""
    text = read(fmus["lag"])
    start, end = text.index("<InitialUnknowns>"), text.index("</InitialUnknowns>") + len("</InitialUnknowns>")
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "x.fmu", xml={text[start:end]: ""}))
    assert check.passed and check["model structure"].verdict == "remark"
    assert "not among the InitialUnknowns: " in check["model structure"].detail


def test_a_display_unit_that_is_not_defined_is_ignored_in_fmi_2(fmus, tmp_path):
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "x.fmu", xml={'displayUnit="deg"': 'displayUnit="grad"'}))
    assert "display units that are not defined: 'grad' of angle" in check["variables"].detail
    assert check["variables"].verdict == "remark"


@pytest.mark.parametrize(
    ("name", "good"),
    [
        ("vehicle.engine.speed", True), ("der(pipe[3,4].T[14],2)", True), ("robot.axis.'motor #234'", True),
        ("_a", True), ("der(x)", True), ("2x", False), ("a..b", False), ("$cse1", False), ("der(der(x))", False),
        ("a[b]", False), ("", False), ("a.b.", False),
    ],
)  # fmt: skip
def test_structured_names_are_those_of_the_grammar(name, good):
    assert bool(STRUCTURED.fullmatch(name)) is good


def repacked(fmu, path, without=None, **more: bytes):
    with zipfile.ZipFile(fmu) as archive:
        files = {n: archive.read(n) for n in archive.namelist() if not (without and re.match(without, n))}
    return write_archive(path, files | more)


def test_an_fmu_for_another_system_says_which_and_fails_nothing(fmus, tmp_path):
    other = repacked(fmus["lag"], tmp_path / "x.fmu", "binaries/|sources/", **{"binaries/win46/lag.dll": b"MZ"})
    check = check_fmu(other)
    assert check.passed
    assert check["platforms"].detail == "win46"
    assert check["runs"].verdict == check["reset"].verdict == check["libcosimpy"].verdict == "not tried"
    assert "no binary for this machine" in check["runs"].detail and "it has win46" in check["runs"].detail
    assert str(check).count("it has win46") == 1
    with pytest.raises(DeclarationError, match="no binary for this machine"):
        read_fmu(other).free_run(command_record())


def test_an_fmu_without_any_implementation_fails(fmus, tmp_path):
    check = check_fmu(repacked(fmus["lag"], tmp_path / "x.fmu", "binaries/|sources/"))
    assert [row.name for row in check.failures] == ["platforms"]
    assert check["platforms"].rule == "FMI 2.0.5, 2.3 FMU Distribution"


@pytest.mark.parametrize("content", [b"nonsense", b"", b"\x7fELF" + bytes(200)])
def test_a_file_that_is_no_library_fails_with_what_the_loader_says(fmus, tmp_path, content):
    with zipfile.ZipFile(fmus["lag"]) as archive:
        [binary] = [n for n in archive.namelist() if n.startswith("binaries/")]
    check = check_fmu(repacked(fmus["lag"], tmp_path / "x.fmu", **{binary: content}))
    assert [row.name for row in check.failures] == ["loads"]
    assert f"{Path(binary).name} is no library that this machine can load: " in check["loads"].detail
    assert check["loads"].rule == "FMI 2.0.5, 2.3 FMU Distribution"
    assert check["runs"].detail == "it does not run here, see 'loads'"


@pytest.mark.parametrize(
    ("said", "verdict"),
    [
        ("libgfortran.so.3: cannot open shared object file: No such file or directory", "not tried"),
        ("/lib/libc.so.6: version `GLIBC_2.99' not found (required by x.so)", "not tried"),
        ("x.so: cannot open shared object file: No such file or directory", "FAIL"),
        ("x.so: undefined symbol: nothing_has_it", "FAIL"),
        ("x.so: wrong ELF class: ELFCLASS32", "FAIL"),
    ],
)
def test_what_the_machine_lacks_is_not_the_fault_of_a_library(said, verdict):
    if verdict == "FAIL":
        assert probing._not_loaded("x.so", said)[0] == verdict
    else:
        with pytest.raises(NotTried, match=r"libgfortran|GLIBC"):
            probing._not_loaded("x.so", said)


@pytest.mark.parametrize("needs", [True, False])
def test_an_fmu_that_gives_no_instance_fails_unless_it_needs_a_tool(fmus, tmp_path, needs):
    text = read(fmus["lag"])
    [guid] = re.findall(r'guid="\{(.*?)\}"', text)
    told = {guid: guid[::-1]} | ({"<CoSimulation ": '<CoSimulation needsExecutionTool="true" '} if needs else {})
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "x.fmu", xml=told))
    assert check["runs"].verdict == ("not tried" if needs else "FAIL")
    assert "gives no instance" in check["runs"].detail
    assert ("it does not run without hydrotwin" in check["runs"].detail) is needs


def test_an_fmu_that_needs_its_tool_is_tried_all_the_same(fmus, tmp_path):
    needs = {"<CoSimulation ": '<CoSimulation needsExecutionTool="true" '}
    assert check_fmu(rewritten(fmus["lag"], tmp_path / "x.fmu", xml=needs))["reset"].passed


def test_a_function_that_is_missing_fails(fmus, tmp_path):
    hidden = {"fmi2Status fmi2CancelStep(": "fmi2Status hidden_CancelStep("}
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "x.fmu", c=hidden))
    assert [row.name for row in check.failures] == ["loads"]
    assert "fmi2CancelStep" in check["loads"].detail


def test_an_unpacked_archive_that_other_systems_cannot_read_fails(fmus, tmp_path):
    check = check_fmu(repacked(fmus["lag"], tmp_path / "x.fmu", **{"resources\\table.txt": b"1"}))
    assert [row.name for row in check.failures] == ["files"]


@pytest.mark.parametrize(("fault", "verdict"), [("nan", "remark"), ("gives up", "not tried")])
def test_what_an_fmu_may_lack_is_an_input(fmus, tmp_path, fault, verdict):
    """At its start values it says that all is well with NaN, or gives up: both may be for want of a value."""
    read_all = "return ht2_answer(c, ht_get(&((component *)c)->core, vr, n, value));"
    [angle] = re.findall(r'name="angle" valueReference="(\d+)"', read(fmus["lag"]))
    nothing = (
        "size_t k; int status = ht_get(&((component *)c)->core, vr, n, value);"
        f" for (k = 0; k < n; k++) if (vr[k] == {angle}) value[k] = 0.0 / (vr[k] * 0.0); return ht2_answer(c, status);"
    )
    gives_up = {DO_STEP: DO_STEP + "    if (c) return fmi2Error;\n"}
    code = {"nan": {read_all: nothing}, "gives up": gives_up}[fault]
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "x.fmu", c=code))
    assert check["runs"].verdict == verdict
    assert {"nan": "is not finite", "gives up": "it may need values for command"}[fault] in check["runs"].detail
    assert check.passed, str(check)


def test_model_exchange_without_an_output_is_run_by_its_derivatives(variants, tmp_path):
    good = variants["clocked mass", ("fmi", 3), ("kind", "me")]
    gone = dict.fromkeys(re.findall(r"<Output [^>]*/>", read(good)), "")
    assert gone
    silent = rewritten(good, tmp_path / "x.fmu", xml={'causality="output"': 'causality="local"'} | gone)
    check = check_fmu(silent)
    assert check["runs"].verdict == "pass", str(check)
    assert check["order of setting"].verdict == "pass"


def test_fmi_1_is_not_tried(fmus, tmp_path):
    [row] = check_fmu(rewritten(fmus["lag"], tmp_path / "x.fmu", xml={'fmiVersion="2.0"': 'fmiVersion="1.0"'})).rows
    assert (row.name, row.verdict) == ("readable", "not tried")


def test_a_crash_of_another_program_is_its_own(monkeypatch, fmus):
    """And what stumbles in Python says nothing of the FMU either."""

    def stumbles(description, unzipped, path):
        raise ZeroDivisionError("our fault")

    monkeypatch.setitem(gates.GATES, "libcosimpy", stumbles)
    probe = probing.Probing(None, "", "").probe("gates", "libcosimpy")
    verdict, detail = probing._judged(probe)
    assert verdict == "not tried"
    assert "says nothing of the FMU (ZeroDivisionError: our fault)" in detail
    entry = {"row": "libcosimpy", "probe": "libcosimpy", "group": "gates", "needs": "runs"}
    assert _fair(entry, "FAIL", "libcosimpy ended its process")[0] == "remark"


def test_every_row_that_can_fail_has_a_section(variants):
    both = check_fmu(variants["clocked mass", ("kind", "both"), ("fmi", 3)])
    free = {"readable", "reference", *NOT_ALLOWED, *gates.GATES}
    names = {row.name.removesuffix(" (Model Exchange)") for row in both.rows} - free
    assert names <= set(SECTIONS)
    assert all(paragraph(name, "3.0") for name in names)


def test_what_no_importer_may_do_is_waited_for_briefly(tmp_path):
    lines = tmp_path / "rows.jsonl"
    patience = _OfEach(60.0, lines=lines, usual=60.0)
    lines.write_text('{"begin": "reset"}\n')
    assert not patience.over() and patience.limit == 60.0
    lines.write_text('{"begin": "reset"}\n{"begin": "NaN input (Model Exchange)"}\n{"half')
    assert not patience.over() and patience.limit == BRIEF
    patience.since = time.monotonic() - BRIEF
    assert patience.over()


@pytest.mark.parametrize("count", [10_000, pytest.param(100_000, marks=pytest.mark.proof)])
def test_a_hundred_thousand_variables_are_checked_in_seconds(fmus, tmp_path, count):
    """They are names of one value: local, without a start value, in the unit of the angle."""
    [angle] = re.findall(r'name="angle" valueReference="(\d+)"', read(fmus["lag"]))
    one = f'valueReference="{angle}" causality="local"><Real unit="rad"/></ScalarVariable>'
    many = "".join(f'<ScalarVariable name="part[{k}].turn" {one}' for k in range(count))
    fmu = rewritten(fmus["lag"], tmp_path / "large.fmu", xml={END: many + END})
    began = time.monotonic()
    check = check_fmu(fmu)
    assert check.passed, str(check)
    assert str(count // 1000) in check["variables"].detail
    assert time.monotonic() - began < 60.0  # 100 000 under 20 s on a machine with nothing else to do


def test_a_crash_of_the_fmu_leaves_the_rest_of_the_sentence_to_the_row_that_crashed(fmus, tmp_path):
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "x.fmu", c=CRASHES))
    assert [row.name for row in check.failures] == ["runs"]
    assert check["runs"].rule == "FMI 2.0.5, 2.1.3 Status Returned by Functions"
    assert check.summary.startswith("FAIL: 1 rule broken; ")
