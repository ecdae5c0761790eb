"""Every door by which a number comes in or goes out, with every kind of unit: the same number each time, or a sentence.

One bench has a parameter, an input, a state and an output of each kind. A door in takes a number for each in one
spelling of its unit and tells what the machine runs with, in SI; what may mean two, or is of another quantity, it
refuses with what to write. A new door is a function more, a new kind of unit a row more.
"""

from __future__ import annotations

import contextlib
import json
import re
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.commands.shared import bounds_from, settings_from, step_in_seconds
from hydrotwin.comparison.loop import Loop, limits_of
from hydrotwin.comparison.meaning import criterion
from hydrotwin.comparison.running import things_of
from hydrotwin.comparison.varied import varied
from hydrotwin.export.parameter_sets import parameters_of
from hydrotwin.loading import load
from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.models.language.model_file import write_model_file
from hydrotwin.models.language.quantities import wanted
from hydrotwin.models.language.units import convert_difference, si_unit
from hydrotwin.records import require, write_record
from hydrotwin.simulation import lower
from tests.face.command_line import hydrotwin
from tests.face.unit_bench import ALONE, EXPECTED, KINDS, START, VENDOR, bench, recording, vendors


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    """A folder with the bench, its FMU, that of another maker, and recordings."""
    path = tmp_path_factory.mktemp("doors")
    with contextlib.chdir(path):
        Path("bench.py").write_text(bench())
        Path("run.csv").write_text(recording())
        Path("off.csv").write_text(recording(-2.0))
        ht.export_fmu(load("bench.py:bench"), path / "bench.fmu")
        write_model_file("bench.toml", "bench.py:bench", load("bench.py:bench").flat, {}, ())
        vendors(Path("bench.fmu"), Path("vendor.fmu"))
        yield path


@pytest.fixture(autouse=True)
def there(folder, monkeypatch):
    monkeypatch.chdir(folder)


def model():
    return load("bench.py:bench")


# -- doors in: {kind: text} -> {kind: number in SI} --------------------------------------------------------------------
def command(*words) -> str:
    """What a command prints; a refusal rises as that of a function would."""
    answer = hydrotwin(*words)
    if answer.code == 2:
        raise HydrotwinError(" ".join(answer.err.split()))
    assert answer.code == 0, answer.said
    return answer.out


def simulated(name: str, what: str, texts):
    words = [word for k, text in texts.items() for word in ("--set", f"{what}_{k}={text}")]
    command("simulate", name, "--input", "run.csv", "--out", "out.csv", *words)
    last = ht.read_record("out.csv")
    return {k: 2 * last[f"seen_{k}"][-1] - START[k] for k in texts}


def levels(thing, texts):
    if hasattr(thing, "description"):
        scales = thing.description.scales
        return {k: scales[f"level_{k}"][0] * thing.values[f"level_{k}"] + scales[f"level_{k}"][1] for k in texts}
    values = {p.name: p.value for p in thing.flat.parameters}
    return {k: values[f"level_{k}"] for k in texts}


def in_toml(text: str) -> str:
    return text if re.fullmatch(r"[-+.e\d]+", text) else f"'{text}'"


def in_scenario(name: str, form: str, texts, read=None):
    table = ", ".join(f"level_{k} = {in_toml(text)}" for k, text in texts.items())
    several = ", ".join(f"level_{k} = [{in_toml(text)}]" for k, text in texts.items())
    models = f"{{model = '{name}', set = {{{table}}}}}" if form == "set" else f"'{name}'"
    more = {
        "set": "",
        "variant": f"[variants.a]\nparameters = {{{table}}}",
        "matrix": f"[matrix]\nparameters = {{{several}}}",
    }
    Path("scenario.toml").write_text(f"models = [{models}]\nvalidate = ['run.csv']\n{more[form]}\n")
    scenario = ht.read_scenario("scenario.toml")
    (thing,) = things_of(scenario, load)
    return (read or levels)(thing.thing if form == "set" else varied(thing, scenario.variants[1]), texts)


def number_and_unit(text: str) -> tuple[str, str]:
    number, unit = re.fullmatch(r"([-+.e\d]+)\s*(.*)", text).groups()
    return number, unit


def in_model_file(texts):
    said = Path("bench.toml").read_text()
    for k, text in texts.items():
        number, unit = number_and_unit(text)
        given = f", unit = '{unit}'" if unit else ""
        said, found = re.subn(
            rf"(?m)^level_{k} = .*$", f"level_{k} = {{ value = {number}{given}, source = 'x' }}", said
        )
        assert found == 1
    Path("other.toml").write_text(said)
    return levels(load("bench.py:bench@other.toml"), texts)


def in_settings(texts):
    parts = {k: number_and_unit(text) for k, text in texts.items()}
    given = {f"level_{k}": {"value": float(n)} | ({"unit": u} if u else {}) for k, (n, u) in parts.items()}
    return levels(model().with_settings(given), texts)


def in_python(texts):
    run = ht.simulate(model(), ht.read_record("run.csv"), parameters={f"level_{k}": t for k, t in texts.items()})
    return {k: 2 * run[f"seen_{k}"][-1] - START[k] for k in texts}


def in_ssv(texts, name: str = "bench.fmu"):
    rows = ""
    for k, (number, unit) in {k: number_and_unit(text) for k, text in texts.items()}.items():
        rows += f'<Parameter name="level_{k}"><Real value="{number}"{f" unit={unit!r}" if unit else ""}/></Parameter>'
    text = f"<ParameterSet><Parameters>{rows}</Parameters></ParameterSet>"
    found = parameters_of(text.encode(), "x.ssv", load(name).description)
    return {k: found[f"level_{k}"] for k in texts}


def columns(texts, suffix: str = ".csv"):
    """Inputs as a model takes them from a file with units in its heads."""
    parts = {f"drive_{k}": number_and_unit(text) for k, text in texts.items()}
    head = ["time [s]", *(f"{name} [{unit}]" if unit else name for name, (_, unit) in parts.items())]
    rows = [[str(t), *(number for number, _ in parts.values())] for t in range(4)]
    Path("columns.csv").write_text("\n".join(",".join(row) for row in (head, *rows)))
    read = ht.read_record("columns.csv")
    if suffix != ".csv":
        for name in parts:  # what cannot be used is told here
            read[name]
        write_record(read, f"columns{suffix}")
        read = ht.read_record(f"columns{suffix}")
    return driven(read, texts)


def constants(texts):
    Path("columns.csv").write_text("time [s],x [1]\n0,0\n1,0\n2,0\n")
    return driven(ht.read_record("columns.csv", constants={f"drive_{k}": text for k, text in texts.items()}), texts)


def driven(record, texts):
    inputs = [s for s in model().flat.inputs if s.name.removeprefix("drive_") in texts]
    return {k: require(record, inputs, "bench")[f"drive_{k}"][0] for k in texts}


def option(what: str, signals: str):
    def door(texts):
        asked = [wanted(s) for s in getattr(model().flat, signals)]
        found = settings_from([f"{what}_{k}={text}" for k, text in texts.items()], "--at", asked)
        return {k: found[f"{what}_{k}"] for k in texts}

    return door


def interval(texts):
    given = [f"level_{k}=0:{text}" for k, text in texts.items()]
    if len(texts) > 1:
        found = bounds_from(given, [wanted(p) for p in model().flat.parameters])
        return {k: found[f"level_{k}"][1] for k in texts}
    (k,) = texts
    words = ["--parameters", f"level_{k}", "--interval", given[0], "--samples", "0", "--json"]
    return {k: json.loads(command("sensitivity", "bench.py:bench", "off.csv", *words))["parameters"][0]["high"]}


def limits(texts):
    plant = lower(model(), 0.01)
    number = {k: float(text) if in_toml(text) == text else text for k, text in texts.items()}
    found = {k: Loop("r", f"seen_{k}", f"drive_{k}", 0.01, (1.0,), (1.0,), (-np.inf, n)) for k, n in number.items()}
    return {k: limits_of(loop, plant)[1] for k, loop in found.items()}


VALUES = {
    "simulate --set": lambda texts: simulated("bench.py:bench", "level", texts),
    "simulate --set of a model file": lambda texts: simulated("bench.py:bench@bench.toml", "level", texts),
    "simulate --set of an FMU": lambda texts: simulated("bench.fmu", "level", texts),
    **{
        f"{form} of a scenario, {name}": lambda texts, n=name, f=form: in_scenario(n, f, texts)
        for form in ("set", "variant", "matrix")
        for name in ("bench.py:bench", "bench.py:bench@bench.toml", "bench.fmu")
    },
    "model file": in_model_file,
    "with_settings": in_settings,
    "with_values of an FMU": lambda texts: levels(
        load("bench.fmu").with_values({f"level_{k}": text for k, text in texts.items()}), texts
    ),
    "ht.simulate": in_python,
    "SSV": in_ssv,
    "linearize --at": option("drive", "inputs"),
    "identify --bounds, sensitivity --interval": interval,
    "limits of a loop": limits,
    "column of a CSV": columns,
    "column of a Parquet": lambda texts: columns(texts, ".parquet"),
    "simulate --set of an input of the model": lambda texts: simulated("bench.py:bench", "drive", texts),
    "simulate --set of an input of an FMU": lambda texts: simulated("bench.fmu", "drive", texts),
    "import.toml [set]": constants,
}


def threshold(form: str):
    def door(texts):
        outputs = model().flat.outputs
        return {k: criterion(form.format(f"seen_{k}", *number_and_unit(t)), outputs).high for k, t in texts.items()}

    return door


NOISE = "identify --noise, sensitivity --noise"


def noise(texts):
    asked = [wanted(s, difference=True) for s in model().flat.outputs]
    found = settings_from([f"seen_{k}={text}" for k, text in texts.items()], "--noise", asked)
    return {k: found[f"seen_{k}"] for k in texts}


DIFFERENCES = {
    "accept rmse": threshold("{0}.rmse < {1} {2}"),
    "accept a range": threshold("{0}.max in [0, {1}] {2}"),
    "accept bias": threshold("{0}.bias <= {1} {2}"),
    "accept steady": threshold("load=2: {0}.steady < {1} {2}"),
    NOISE: noise,
}
UNIT_ALWAYS = (
    "model file",
    "column",
    "import.toml",
    "simulate --set of an input of the",
    "accept",
)  # a number alone is none


def spelt(door: str, turn: int) -> dict[str, str]:
    texts = {k: spellings[turn] for k, (_, _, spellings) in KINDS.items()}
    return {k: t for k, t in texts.items() if in_toml(t) != t or not door.startswith(UNIT_ALWAYS)}


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("door", VALUES)
def test_a_value_is_the_same_through_every_door_in_every_unit(door, turn):
    texts = spelt(door, turn)
    assert VALUES[door](texts) == pytest.approx({k: EXPECTED[k] for k in texts}, rel=1e-6)


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("door", DIFFERENCES)
def test_a_difference_has_no_zero_of_its_unit_through_any_door(door, turn):
    texts = spelt(door, turn)
    parts = {k: number_and_unit(text) for k, text in texts.items()}
    expected = {
        k: convert_difference(float(n), u or si_unit(KINDS[k][0]), si_unit(KINDS[k][0])) for k, (n, u) in parts.items()
    }
    assert DIFFERENCES[door](texts) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("door", [*VALUES, *DIFFERENCES])
def test_what_is_of_another_quantity_or_may_mean_two_is_refused_by_name(door):
    enter = (VALUES | DIFFERENCES)[door]
    of_file = door.startswith(("column", "import"))  # read before anybody knows what it is for
    for k, text in {"pressure": "30 cd", "temperature": "30 furlong"}.items():
        with pytest.raises(HydrotwinError) as refused:
            enter({k: text})
        said = str(refused.value)
        assert f"_{k}" in said and number_and_unit(text)[1] in said, said
        assert of_file or re.search(rf"\b({KINDS[k][0]}|{si_unit(KINDS[k][0])})\b", said), said
    with pytest.raises(HydrotwinError, match="gauge"):
        enter({"pressure": "30 bar_g"})
    alone = {"SSV": [], NOISE: [k for k in ALONE if k != "temperature"]}  # in the FMU's own unit; degC and K are one
    for k in alone.get(door, ["share"] if "simulate" in door else ALONE):
        with pytest.raises(HydrotwinError, match=f"_{k}"):
            enter({k: "30"})


# -- FMUs of others ----------------------------------------------------------------------------------------------------
def of_vendor(form: str, texts):
    """Numbers as the FMU of another maker gets them, in its own units."""
    if form == "SSV":
        return in_ssv(texts, "vendor.fmu")
    if form == "with_values":
        thing = load("vendor.fmu").with_values({f"level_{k}": text for k, text in texts.items()})
    else:
        thing = in_scenario("vendor.fmu", form, texts, lambda thing, _: thing)
    return {k: thing.values[f"level_{k}"] for k in texts}


@pytest.mark.parametrize("form", ["with_values", "variant", "SSV"])
@pytest.mark.parametrize("kind", VENDOR)
def test_units_of_an_fmu_are_what_it_defines(form, kind):
    _, _, number, texts = VENDOR[kind]
    for text in texts:
        assert of_vendor(form, {kind: text}) == pytest.approx({kind: number}), text
    with pytest.raises(HydrotwinError, match=f"level_{kind}.*: .*"):
        of_vendor(form, {kind: "30 cd"})
    if form != "SSV" and kind != "rise":  # where a parameter set says no unit, it is that of the FMU
        with pytest.raises(HydrotwinError, match="alone may mean"):
            of_vendor(form, {kind: "30"})


def test_a_constant_of_recordings_is_read_as_usual_and_says_what_an_fmu_would_read():
    """All models share the recording: the FMU's own bar, over the ambient pressure, cannot be meant there."""
    words = ("--set", "drive_pressure=2bar", "--set", "drive_force=2kN", "--mode", "free run", "--out", "set")
    answer = hydrotwin("compare", "--model", "vendor.fmu", "--validate", "run.csv", *words)
    told = " ".join(answer.err.split())
    assert (
        "drive_pressure = 2bar is 200000 Pa: it is set for the recordings" in told
        and "drive_force = 2kN is" not in told
    )
    assert "By the bar that the FMU defines it would be 301325 Pa. Write it in Pa." in told


# -- times, options ----------------------------------------------------------------------------------------------------
def test_times_take_their_units():
    assert [step_in_seconds(text) for text in ("2ms", "0.002", "0.002 s")] == [0.002] * 3
    said = "models = ['bench.py:bench']\nvalidate = ['run.csv']\n[variants.a]\nstep = {0}\nperiod = {0}\n"
    for text in ("'20 ms'", "0.02", "'0.02 s'"):
        Path("times.toml").write_text(said.format(text))
        one = ht.read_scenario("times.toml").variants[1]
        assert (one.step, one.period) == (0.02, 0.02)
    assert criterion("seen_share.lag < 20 ms", model().flat.outputs).high == pytest.approx(0.02)


# -- doors out ---------------------------------------------------------------------------------------------------------
def test_what_is_written_is_read_as_the_same():
    run, flat = ht.simulate(model(), ht.read_record("run.csv")), model().flat
    for suffix in (".csv", ".parquet", ".mat"):
        write_record(run, f"written{suffix}")
        read = require(ht.read_record(f"written{suffix}"), flat.outputs, "bench")
        assert all(read[s.name] == pytest.approx(run[s.name], rel=1e-12) for s in flat.outputs), suffix
    again = load("bench.py:bench@bench.toml").flat
    assert [(p.value, p.unit) for p in again.parameters] == [(p.value, p.unit) for p in flat.parameters]
    fmu = {p.name: (p.value, p.unit) for p in load("bench.fmu").parameters}
    assert all(fmu[p.name] == (pytest.approx(p.value), p.unit) for p in flat.parameters)


def test_an_fmu_is_shown_in_the_units_of_its_declarations():
    """A difference in K was shown in degC, by which 5 K is -268."""
    with zipfile.ZipFile("bench.fmu") as archive:
        root = ET.fromstring(archive.read("modelDescription.xml"))
    units = {u.get("name"): {d.get("name"): d for d in u.iter("DisplayUnit")} for u in root.iter("Unit")}
    for k, (unit, start, _) in KINDS.items():
        real = root.find(f".//ScalarVariable[@name='level_{k}']/Real")
        if (shown := real.get("displayUnit")) is None:
            assert real.get("unit") == si_unit(unit) == unit, k
            continue
        how = units[real.get("unit")][shown]
        value = float(how.get("factor", 1)) * float(real.get("start")) + float(how.get("offset", 0))
        assert shown == unit and value == pytest.approx(start), k


def test_errors_are_told_in_the_units_of_the_columns_wherever_they_are_told():
    accept = [word for k, (unit, _, _) in KINDS.items() for word in ("--accept", f"seen_{k}.max < 1.5 {unit}")]
    words = ["--model", "bench.py:bench", "--validate", "off.csv", "--out", "report", "--junit", "junit.xml"]
    answer = hydrotwin("compare", *words, *accept)
    assert answer.code == 1
    told = json.loads(Path("report/compare.json").read_text())
    scores = {s["output"]: s for s in told["scores"] if s["mode"] == "free run"}
    markdown, junit = Path("report/report.md").read_text(), Path("junit.xml").read_text()
    for row, (k, (unit, _, _)) in zip(told["acceptance"]["criteria"], KINDS.items(), strict=True):
        size = convert_difference(2.0, unit, si_unit(unit))
        assert scores[f"seen_{k}"]["maximum"] == pytest.approx(size) and scores[f"seen_{k}"]["unit"] == si_unit(unit)
        assert row["value"] == pytest.approx(size) and row["as_written"]["value"] == pytest.approx(2.0), k
        assert f"found 2 {unit}".removesuffix(" 1") in junit, k
        for text in (markdown, answer.out):
            assert re.search(rf"seen_{k}\.max < 1\.5 {re.escape(unit)}(: | \| FAIL \| )2\.00", text), k
