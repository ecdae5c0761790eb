"""Experiments and results that FMUs of other tools carry along: read, run again, and stepped as they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrotwin.export.experiments import series_text
from hydrotwin.export.foreign import describe_fmu
from hydrotwin.export.replay import carried_rows
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests.export.follower import follower
from tests.export.foreign import DO_STEP, rewritten
from tests.export.systems import clocked_mass
from tests.export.test_replay import INSIDE, MANIFEST, bench, carrying, edited, rows_of, swapped


@pytest.fixture(scope="module")
def fmu(tmp_path_factory) -> Path:
    return carrying(tmp_path_factory.mktemp("carrying") / "mass.fmu")


def foreign(fmu: Path, target: Path, related: str, files: dict) -> Path:
    """The FMU with a manifest as other tools write it."""
    manifest = f'<?xml version="1.0"?><fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest" fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref">{related}</fmiReferences>'  # noqa: E501
    return edited(fmu, target, {MANIFEST: manifest, **{INSIDE + name: text for name, text in files.items()}})


def test_stimuli_in_other_units_and_times_are_read_and_linear_between_samples(fmu, tmp_path):
    """In the newest schema, with parameters in units of their own; the answer is that of `simulate`."""
    model, record = clocked_mass(), bench()
    model = model.with_inputs({"force": {"interpolation": "linear", "chosen_by": "user"}})
    coarse = Record(record.time[::5], {n: record[n][::5] for n in record}, record.units, "coarse")
    answer = simulate(model, coarse)
    time = coarse.time - coarse.time[0]
    files = {
        "a.xml": '<Experiments name="a"><Experiment name="coarse"><TransientSimulation startTime="0" stopTime="1.9"/>'
        '<Parameters source="p.ssv"/><Stimuli source="i%20n.csv"/><References source="R/r.csv"/></Experiment>'
        '<Experiment name="rest"><SteadyState/><References source="R/r.csv"/></Experiment></Experiments>',
        "i n.csv": series_text(time, {"force [kN]": coarse["force"] / 1000}),
        "R/r.csv": series_text(time[1:], {"place [mm]": 1000 * answer["place"][1:]}),
        "p.ssv": '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">'
        '<ssv:Parameters><ssv:Parameter name="mass.s.start"><ssv:Real value="300" unit="mm"/></ssv:Parameter>'
        "</ssv:Parameters></ssv:ParameterSet>",
    }
    related = '<Related type="application/x-ma-ls-experiments" source="a.xml" role="experiment"/>'
    path = foreign(fmu, tmp_path / "m.fmu", related, files)
    found, [one] = carried_rows(path, describe_fmu(path, {}, {}), True, True, 60.0)
    rows = dict(found)
    assert rows["replay coarse"][0] == "pass", rows["replay coarse"]
    assert one.allowed == 1e-2 and one.difference < 2e-3
    assert rows["replay rest"] == ("not tried", "a SteadyState, and only transient simulations are run again here")


def test_results_of_the_default_experiment_are_compared_as_the_reference_fmus_have_them(fmus, tmp_path):
    """Inputs at their start values; texts are not compared, and files elsewhere are left where they are."""
    model = clocked_mass()
    time = np.arange(0.0, 1.0, 0.05)
    rest = Record(time, {"force": 0 * time}, {"force": "N"}, "rest")
    place = simulate(model, rest)["place"]
    related = (
        '<Related type="text/csv" source="m_out.csv" role="result"/>'
        '<Related type="text/csv" source="https://example.org/other.csv" role="result"/>'
        '<Related type="text/csv" source="../../../etc/passwd" role="result"/>'
    )
    path = foreign(
        fmus["clocked mass"], tmp_path / "m.fmu", related, {"m_out.csv": series_text(time, {"place": place})}
    )
    rows = rows_of(path)
    assert rows["related files"] == ("pass", "FMI-LS-REF: 3 result")
    assert rows["replay m_out.csv"][0] == "pass" and len(rows) == 2
    pushed = {INSIDE + "m_out.csv": lambda t: series_text(time, {"place": place + np.linspace(0, 1, len(time))})}
    rows = rows_of(edited(path, tmp_path / "n.fmu", pushed))
    assert rows["replay m_out.csv"] == (
        "not tried",
        "results differ, but the FMU has inputs, and nothing says what they were",
    )


def test_an_experiment_is_stepped_as_it_says_also_where_its_results_are_rare(tmp_path):
    """A plant that sees the mean of a ramp over each step, and results every second; the answer is on paper."""
    time, slope, T = np.array([0.0, 1.0, 2.0]), 0.5, 0.1
    state = slope * (time - T * (1 - np.exp(-time / T)))
    files = {
        "a.exp": '<Experiments name="a"><Experiment name="ramp" stopTime="2" STEP><Stimuli source="u.csv"/>'
        '<References source="x.csv"/></Experiment></Experiments>',
        "u.csv": "time,u\n0,0\n2,1\n",
        "x.csv": series_text(time, {"state": state}),
    }
    related = '<Related type="application/x-ma-hs-experiments" source="a.exp" role="experiment"/>'
    path = foreign(follower(tmp_path / "f.fmu", 3), tmp_path / "m.fmu", related, files)
    for step in ("0.01", "1"):
        named = edited(path, tmp_path / "n.fmu", {f"{INSIDE}a.exp": swapped("STEP", f'stepSize="{step}"')})
        [one] = carried_rows(named, describe_fmu(named, {}, {}), True, True, 60.0)[1]
        assert one.difference < 1e-3 if step == "0.01" else one.difference > 0.05, one


def test_an_fmu_may_ask_to_end_at_the_last_result(fmus, tmp_path):
    """As the Stair of the Reference FMUs does; an end before that fails."""
    ends = DO_STEP + "    if (time + size > 0.985) return fmi2Discard;\n"
    path = rewritten(fmus["clocked mass"], tmp_path / "ends.fmu", c={DO_STEP: ends})
    related = '<Related type="text/csv" source="m_out.csv" role="result"/>'
    for stop, verdict in ((1.0, "pass"), (1.1, "FAIL")):
        time = np.arange(0.0, stop + 0.01, 0.05)
        place = simulate(clocked_mass(), Record(time, {"force": 0 * time}, {"force": "N"}, "rest"))["place"]
        text = series_text(time, {"place": place})
        rows = rows_of(foreign(path, tmp_path / "m.fmu", related, {"m_out.csv": text}))
        assert rows["replay m_out.csv"][0] == verdict, rows
        assert ("not compared: the last result" in rows["replay m_out.csv"][1]) is (verdict == "pass")
