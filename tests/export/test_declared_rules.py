"""What a description says wrongly fails by name: each kind of reference, bound, list and file, in FMI 2 and 3."""

from __future__ import annotations

import re
import zipfile

import pytest

from hydrotwin.export import check_fmu
from hydrotwin.export.archive import write_archive
from hydrotwin.export.rules import read_or_say, rule_rows
from hydrotwin.export.rules.declared import Declared

DESCRIPTION, BUILD = "modelDescription.xml", "sources/buildDescription.xml"
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
BOTH = ("clocked mass", ("kind", "both"))


def edited(fmu, path, pattern: str, text: str, file: str = DESCRIPTION, encoding: str = "utf-8"):
    """The FMU with the first match of a pattern in one of its files replaced."""
    with zipfile.ZipFile(fmu) as archive:
        files = {n: archive.read(n) for n in archive.namelist()}
    changed, count = re.subn(pattern, text, files[file].decode(), count=1, flags=re.DOTALL)
    assert count, pattern
    return write_archive(path, files | {file: changed.encode(encoding)})


def verdicts(fmu) -> dict[str, tuple[str, str]]:
    """Row -> verdict and detail of the rules that are read."""
    declared = read_or_say(fmu)
    assert isinstance(declared, Declared), declared
    return dict(rule_rows(fmu, declared))


END = "</ModelVariables>"


def real(typed: str, causality: str = "local", variability: str = "fixed", reference="901", name: str = "more") -> str:
    """A variable of FMI 2, at the end of the list."""
    head = f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"'
    return f"<ScalarVariable {head}>{typed}</ScalarVariable>{END}"


def float64(rest: str, causality: str = "local", variability: str = "fixed", size: str | None = None) -> str:
    """A variable of FMI 3, at the end of the list; an array where it has a ``size``."""
    head = f'name="more" valueReference="901" causality="{causality}" variability="{variability}" {rest}'
    return f"<Float64 {head}/>{END}" if size is None else f"<Float64 {head}><Dimension {size}/></Float64>{END}"


def clock(rest: str, causality: str = "input") -> str:
    """A clock, at the end of the list."""
    return f'<Clock name="more" valueReference="901" causality="{causality}" {rest}/>{END}'


TIMES = real("<Real/>", "independent", "continuous").replace(END, "")
TIMES += real("<Real/>", "independent", "continuous", "902", "less")

WRONG_2 = [
    ("variables", "declared type 'Forze' is not defined", r'declaredType="\w+"', 'declaredType="Forze"'),
    ("variables", "derivative='380' leads to no variable: der(", r'derivative="\d+"', 'derivative="380"'),
    ("variables", "derivative='0' leads to no variable", r'derivative="\d+"', 'derivative="0"'),
    ("model structure", "index='280' of Output (line", r'<Unknown index="\d+"', '<Unknown index="280"'),
    ("model structure", "dependencies that lead to no variable: ", r'dependencies="\d+', 'dependencies="370'),
    ("model structure", "dependencies must rise", r'dependencies="(\d+) (\d+)', r'dependencies="\2 \1'),
    ("model structure", "differ in number", r'(dependencies="\d+ [^"]*")', r'\1 dependenciesKind="fixed"'),
    ("model structure", "neither dependent nor constant",
     r'(<InitialUnknowns>\s*<Unknown index="\d+")( dependencies="\d+)[^"]*"', r'\1\2" dependenciesKind="fixed"'),
    ("model structure", "state derivatives that are not listed under Derivatives: der(",
     r"(<Derivatives>\s*)<Unknown [^>]*/>", r"\1"),
    ("model structure", "not among the InitialUnknowns", r"(<InitialUnknowns>\s*)<Unknown [^>]*/>", r"\1"),
    ("model structure", "in the order of the variables",
     r"(<InitialUnknowns>\s*)(<Unknown [^>]*/>)(\s*<Unknown [^>]*/>)", r"\1\3\2"),
    ("model structure", "neither output, calculated parameter nor state", "<InitialUnknowns>",
     '<InitialUnknowns><Unknown index="1"/>'),
    ("variables", "min 5 is above max -5: more (line", END, real('<Real min="5" max="-5"/>')),
    ("variables", "nominal -2 is not above zero: more", END, real('<Real nominal="-2"/>')),
    ("variables", "outside of min and max: more", END, real('<Real start="1" max="0"/>', "parameter")),
    ("variables", "outside of min and max: more", END,
     real('<Integer start="1" min="2"/>', "parameter")),
    ("variables", "reinit is for continuous-time states of Model Exchange alone: more", END,
     real('<Real reinit="false"/>', variability="continuous")),
    ("variables", "initial is not allowed", r'causality="input"', 'causality="input" initial="exact"'),
    ("variables", "no more than one independent", END, TIMES),
    ("variables", "the independent variable must be real", END, real("<Integer/>", "independent", "continuous")),
    ("schema", "INF and NAN are no values", END, real('<Real start="INF"/>', "parameter")),
    ("unit definitions", "more than once: '", r"(<Unit .*?</Unit>)", r"\1\1"),
    ("type definitions", "more than once: '", r"(<SimpleType .*?</SimpleType>)", r"\1\1"),
    ("type definitions", "names of variables as well", r'<SimpleType name="\w+"', '<SimpleType name="place"'),
    ("type definitions", "max -1", r"(<SimpleType [^>]*>\s*<Real )", r'\1min="1" max="-1" '),
    ("other definitions", "log categories with the same name", r"(<Category [^>]*/>)", r"\1\1"),
    ("names", "names that are empty", END, real("<Real/>", name="")),
    ("interfaces", "no name in C: 'a-b' of ModelExchange", r'modelIdentifier="\w+"', 'modelIdentifier="a-b"'),
    ("interfaces", "canSerializeFMUstate without", r'canGetAndSetFMUstate="true"', ""),
    ("platforms", "no library is called 'other'", r'modelIdentifier="\w+"', 'modelIdentifier="other"'),
    ("sources", "not there: sources/lost.c", r'<File name="[^"]*"', '<File name="lost.c"'),
]  # fmt: skip


@pytest.mark.parametrize(("row", "words", "pattern", "text"), WRONG_2)
def test_a_rule_of_fmi_2_that_is_broken_fails(variants, tmp_path, row, words, pattern, text):
    verdict, detail = verdicts(edited(variants[BOTH], tmp_path / "x.fmu", pattern, text))[row]
    assert verdict == "FAIL"
    assert words in detail


WRONG_3 = [
    ("variables", "one value reference for several variables", r'valueReference="2"', 'valueReference="1"'),
    ("variables", "derivative='999' leads to no variable", r'derivative="\d+"', 'derivative="999"'),
    ("model structure", "valueReference='270' of Output", r'(<Output valueReference=)"\d+"', r'\1"270"'),
    ("model structure", "dependencies that lead to no variable", r'dependencies="\d+', 'dependencies="360'),
    ("model structure", "not listed under ContinuousStateDerivative: der(", "<ContinuousStateDerivative [^>]*/>", ""),
    ("model structure", "event indicators that are no", "</ModelStructure>",
     '<EventIndicator valueReference="1"/></ModelStructure>'),
    ("variables", "to place, no constant or structural UInt64", END, float64("", size='valueReference="{place}"')),
    ("variables", "Dimension valueReference='999' leads to no variable", END, float64("", size='valueReference="999"')),
    ("variables", "Dimension of size 0", END, float64("", size='start="0"')),
    ("variables", "either start or valueReference", END, float64("", size='')),
    ("variables", "3 start values for 2", END, float64('start="1 2 3"', "parameter", size='start="2"')),
    ("variables", "a start without a value: more", END, float64('start=""', "parameter")),
    ("variables", "2 start values for one value", END, float64('start="1 2"', "parameter")),
    ("variables", "clocks='{place}' leads to no clock", END, float64('clocks="{place}"', variability="discrete")),
    ("variables", "must be discrete or tunable", END, float64('clocks="999"', variability="continuous")),
    ("variables", "previous='999' leads to no variable", END, float64('previous="999"', variability="discrete")),
    ("variables", "reinit is for continuous-time states of Model Exchange alone", END, float64('reinit="true"')),
    ("variables", "intermediateUpdate is for continuous", END, float64('intermediateUpdate="1"')),
    ("variables", "min 2 is above max 1", END, float64('min="2" max="1"')),
    ("variables", "display unit 'grad' without a unit", END, float64('displayUnit="grad"')),
    ("variables", "exactly one independent", r'causality="independent"', 'causality="local"'),
    ("variables", "no more than one independent", END,
     float64("", "independent", "continuous")),
    ("variables", "a clock that is no input must be triggered", END, clock('intervalVariability="constant"', "local")),
    ("variables", "an interval must be above zero", END, clock('intervalVariability="constant" intervalDecimal="-1"')),
    ("interfaces", "clocks must have hasEventMode: more", END, clock('intervalVariability="triggered"')),
    ("interfaces", "canReturnEarlyAfterIntermediateUpdate without", r'providesIntermediateUpdate="true"', ""),
    ("names", "not unique: place", r'(name="der\([^>]*?) ?/>', r'\1><Alias name="place"/></Float64>'),
    ("unit definitions", "more than once", r"(<Unit .*?</Unit>)", r"\1\1"),
]  # fmt: skip


@pytest.mark.parametrize(("row", "words", "pattern", "text"), WRONG_3)
def test_a_rule_of_fmi_3_that_is_broken_fails(variants, tmp_path, row, words, pattern, text):
    good = variants[(*BOTH, ("fmi", 3))]
    with zipfile.ZipFile(good) as archive:
        [place] = re.findall(r'name="place" valueReference="(\d+)"', archive.read(DESCRIPTION).decode())
    fmu = edited(good, tmp_path / "x.fmu", pattern, text.replace("{place}", place))
    verdict, detail = verdicts(fmu)[row]
    assert verdict == "FAIL"
    assert words.replace("{place}", place) in detail


@pytest.mark.parametrize(
    ("file", "row", "words", "pattern", "text"),
    [
        (BUILD, "sources", "that no interface has: 'other'", r'modelIdentifier="\w+"', 'modelIdentifier="other"'),
        (BUILD, "sources", "not there: sources/lost.c", r'<SourceFile name="[^"]*"', '<SourceFile name="lost.c"'),
        (BUILD, "schema", "sources/buildDescription.xml: line", "<BuildConfiguration ", '<BuildConfiguration odd="1" '),
        (TERMINALS, "terminals", "no variables: 'lost'", r'variableName="[^"]*"', 'variableName="lost"'),
    ],
)
def test_files_beside_the_description_name_what_is_there(variants, tmp_path, file, row, words, pattern, text):
    fmu = edited(variants[(*BOTH, ("fmi", 3))], tmp_path / "x.fmu", pattern, text, file)
    verdict, detail = verdicts(fmu)[row]
    assert verdict == ("remark" if "modelIdentifier" in text else "FAIL")  # nobody builds where a binary is
    assert words in detail


@pytest.mark.parametrize(
    ("alias", "verdict", "words"),
    [
        (("local", "continuous", 'unit="m"'), "pass", ""),
        (("local", "continuous", 'unit="N"'), "FAIL", "aliases with different units: place (line"),
        (("local", "continuous", ""), "remark", "some have a unit and some have none"),
        (("local", "constant", 'unit="m" start="1"'), "FAIL", "aliases of which some are constant"),
    ],
)
def test_aliases_of_fmi_2_are_one_value(variants, tmp_path, alias, verdict, words):
    good = variants[BOTH]
    with zipfile.ZipFile(good) as archive:
        [place] = re.findall(r'name="place" valueReference="(\d+)"', archive.read(DESCRIPTION).decode())
    causality, variability, unit = alias
    more = real(f"<Real {unit}/>", causality, variability, place)
    found = verdicts(edited(good, tmp_path / "x.fmu", END, more))["variables"]
    assert found[0] == verdict
    assert words in found[1]


def test_of_aliases_one_alone_can_be_set(variants, tmp_path):
    one, other = (real('<Real start="1"/>', "parameter", name=n) for n in ("p1", "p2"))
    two = one.replace(END, other)
    verdict, detail = verdicts(edited(variants[BOTH], tmp_path / "x.fmu", END, two))["variables"]
    assert verdict == "FAIL"
    assert "more than one can be set or has a start value: p1 (line" in detail


@pytest.mark.parametrize(
    ("named", "encoding", "more", "verdict", "words"),
    [
        ("UTF-16", "utf-16", "", "FAIL", "is in UTF-16"),
        ("ISO-8859-1", "latin-1", "<!-- \u00fc -->", "FAIL", "is said to be in ISO-8859-1, where UTF-8 is required"),
        ("ISO-8859-1", "latin-1", "", "remark", "is said to be in ISO-8859-1"),
        ("US-ASCII", "ascii", "", "remark", "is said to be in US-ASCII"),
    ],
)
def test_a_description_must_be_in_utf_8(variants, tmp_path, named, encoding, more, verdict, words):
    """What holds only ASCII is the same in all of them but UTF-16."""
    said = f'encoding="{named}"?>{more}'
    fmu = edited(variants[BOTH], tmp_path / "x.fmu", r'encoding="UTF-8"\?>', said, encoding=encoding)
    found, detail = verdicts(fmu)["schema"]
    assert found == verdict
    assert words in detail


def test_a_description_that_is_no_xml_says_so_with_its_line(variants, tmp_path):
    [row] = check_fmu(edited(variants[BOTH], tmp_path / "x.fmu", "</ModelVariables>", "")).rows
    assert (row.name, row.verdict) == ("readable", "FAIL")
    assert "modelDescription.xml is no XML" in row.detail and "line" in row.detail
    assert row.rule.startswith("FMI 2.0.5, 2.2 FMI Description Schema")


@pytest.mark.parametrize(("fmi", "pattern"), [(2, r'derivative="\d+"'), (3, r'dependencies="\d+')])
def test_what_fmpy_gives_up_on_is_still_judged_whole(variants, tmp_path, fmi, pattern):
    name = pattern.split("=")[0]
    tail = '"' if name == "derivative" else ""
    fmu = edited(variants[(*BOTH, ("fmi", fmi))], tmp_path / "x.fmu", pattern, f'{name}="999{tail}')
    check = check_fmu(fmu)
    assert not check.passed
    assert check["readable"].detail == "it is not run: what is FAIL below stands in the way"
    assert check["files"].passed and check["platforms"].passed
    assert "not an FMU" not in str(check)
