"""A comparison as an SSP archive: valid, wired, and with the same outputs as its FMUs have alone."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd, read_ssv

from hydrotwin.export import SystemPart, export_fmu, export_ssp, read_fmu
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.records import Record, read_record
from hydrotwin.simulation import simulate
from tests.export.foreign import rewritten
from tests.export.systems import arm_record, delayed_mass

STEP = 2.0**-7  # s, so that FMPy's sums of steps are exact
SIMULATE = """
import sys
import numpy as np
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssv
out, archive, stop, step, *sets = sys.argv[1:]
values = read_ssv(archive, resource=sets[0])
for name in sets[1:]:
    values.parameters += read_ssv(archive, resource=name).parameters
drive = {"command": lambda t: 2.0 * np.sin(3.0 * t) + 0.5}
found = simulate_ssp(archive, stop_time=float(stop), step_size=float(step), parameter_set=values, input=drive)
np.savez(out, **{name: found[name] for name in found.dtype.names})
"""
ALONE = """
import json, sys
import numpy as np
from fmpy import extract, read_model_description
from hydrotwin.export.fmu_process.master import Slave, outputs_of
out, path, job = sys.argv[1:]
job = json.loads(job)
description = read_model_description(path, validate=False)
slave, names, found = Slave(description, extract(path)), [v.name for v in outputs_of(description)], []
slave.initialise(0.0, None, job["starts"], {})
for k, command in enumerate(job["command"]):
    slave.write({"command": command})
    slave.step(k * job["step"], job["step"])
    found.append(slave.read(names))
np.savez(out, **dict(zip(names, np.array(found).T)))
"""


def bound_sets(archive) -> list[str]:
    return [binding.source for binding in read_ssd(archive).system.parameterBindings]


@pytest.fixture(scope="module")
def record():
    angle = {"angle": np.full(200, 0.3)}
    arm = arm_record(2.0)
    return Record(arm.time, {**arm.signals, **angle}, {**arm.units, "angle": "rad"}, "run 1 (short)")


@pytest.fixture(scope="module")
def parts(systems, fmus):
    flat = systems["cehA"]
    gain = {p.name: p.value for p in flat.parameters}["motor.gain"]
    return [
        SystemPart("cehA", flat),
        SystemPart("identified", flat.with_parameters({"motor.gain": 1.1 * gain}), nominal={"motor.gain": gain}),
        SystemPart("lag", systems["lag"]),
        SystemPart("vendor.fmu", read_fmu(fmus["lag"], values={"gain": 0.7})),
        SystemPart("hold last sample", SimpleNamespace(inputs=(), outputs=())),
    ]


@pytest.fixture(scope="module")
def packed(parts, record, tmp_path_factory):
    return export_ssp(parts, tmp_path_factory.mktemp("ssp") / "system.ssp", records=[record], title="four models")


@pytest.fixture(scope="module")
def unpacked(packed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("unpacked ssp")
    with zipfile.ZipFile(packed.path) as archive:
        archive.extractall(folder)
    return folder


def test_structure_and_parameter_sets_meet_the_schemas_of_ssp(packed):
    assert read_ssd(packed.path, validate=True).version == "1.0"
    with zipfile.ZipFile(packed.path) as archive:
        sets = [n for n in archive.namelist() if n.endswith(".ssv")]
    assert sets == ["resources/identified.ssv", "resources/nominal.ssv", "resources/start_run_1_short.ssv"]
    assert all(read_ssv(packed.path, resource=name, validate=True).parameters for name in sets)


def test_every_input_of_every_model_is_wired_to_the_one_of_the_system(packed):
    system = read_ssd(packed.path).system
    assert [c.name for c in system.connectors if c.kind == "input"] == ["command"]
    assert [c.name for c in system.elements] == ["cehA", "identified", "lag", "vendor_fmu"]
    wires = {(c.startElement, c.startConnector, c.endElement, c.endConnector) for c in system.connections}
    for element in system.elements:
        assert (None, "command", element.name, "command") in wires
        for connector in element.connectors:
            if connector.kind == "output":
                assert (element.name, connector.name, None, f"{element.name}_{connector.name}") in wires
    outside = {c.name for c in system.connectors}
    assert {"cehA_arm_angle", "identified_pressure_cap", "lag_rate", "vendor_fmu_rate"} <= outside
    assert not [name for name in outside if "." in name]  # would be the path of a component's own connector


def test_units_are_listed_with_their_exponents(packed):
    units = {u.name: u for u in read_ssd(packed.path).units}
    assert (units["Pa"].kg, units["Pa"].m, units["Pa"].s) == (1, -1, -2)
    text = zipfile.ZipFile(packed.path).read("SystemStructure.ssd").decode()
    assert '<ssd:Connector name="command" kind="input">\n        <ssc:Real unit="V" />' in text


def test_an_fmu_keeps_its_own_unit_and_its_bytes(fmus, tmp_path):
    changes = {'unit="V"': 'unit="mV"', 'Unit name="V"': 'Unit name="mV"'}
    vendor = rewritten(fmus["lag"], tmp_path / "vendor.fmu", xml=changes)
    block = read_fmu(vendor)
    assert block.inputs[0].unit == "V" and block.description.scales["command"] == (1e-3, 0.0)
    archive = export_ssp([SystemPart("vendor", block)], tmp_path / "v.ssp").path
    unit = next(u for u in read_ssd(archive).units if u.name == "mV")
    assert (unit.factor, unit.A, unit.kg) == (1e-3, -1, 1)
    assert zipfile.ZipFile(archive).read("resources/vendor.fmu") == vendor.read_bytes()


def test_fmus_of_either_version_and_kind_can_be_components(variants, tmp_path):
    exchange, third = variants["clocked mass", ("kind", "me")], variants["lag", ("fmi", 3)]
    parts = [SystemPart("exchange", read_fmu(exchange)), SystemPart("third", read_fmu(third))]
    archive = export_ssp(parts, tmp_path / "others.ssp").path
    of = {c.name: c for c in read_ssd(archive).system.elements}
    text = zipfile.ZipFile(archive).read("SystemStructure.ssd").decode()
    assert re.findall(r'<ssd:Component name="(\w+)".* implementation="(\w+)"', text) == [
        ("exchange", "ModelExchange"), ("third", "CoSimulation"),
    ]  # fmt: skip
    assert text.count("<ssc:Real") == sum(len(c.connectors) for c in (*of.values(), read_ssd(archive).system))
    assert bound_sets(archive) == []  # their own values hold


def test_nominal_has_the_shipped_values_and_identified_is_bound(packed, parts):
    nominal, found = (
        {p.name: (float(p.value), p.unit) for p in read_ssv(packed.path, resource=f"resources/{n}.ssv").parameters}
        for n in ("nominal", "identified")
    )
    assert set(found) == {f"identified.{p.name}" for p in parts[1].thing.parameters}
    assert set(nominal) == set(found) | {n.replace("identified.", "cehA.") for n in found}
    assert found["identified.motor.gain"][0] == pytest.approx(1.1 * nominal["identified.motor.gain"][0], rel=1e-14)
    assert [n for n in found if found[n] != nominal[n]] == ["identified.motor.gain"]
    assert found["identified.motor.gain"][1] == "rad/(s.V)"
    assert bound_sets(packed.path) == ["resources/identified.ssv", "resources/start_run_1_short.ssv"]


def test_without_an_identified_model_the_nominal_set_is_bound(parts, tmp_path):
    assert bound_sets(export_ssp([parts[0]], tmp_path / "n.ssp").path) == ["resources/nominal.ssv"]


def test_the_system_run_by_fmpy_has_the_outputs_of_its_fmus_alone(packed, unpacked, tmp_path):
    """FMPy hands inputs on after a step: its components see a command one step late, at first zero."""
    steps, sets = 128, bound_sets(packed.path)
    together = in_a_child(SIMULATE, tmp_path / "together.npz", packed.path, steps * STEP, STEP, *sets)
    late = np.r_[0.0, 2.0 * np.sin(3.0 * STEP * np.arange(steps - 1)) + 0.5]
    values = {p.name: float(p.value) for name in sets for p in read_ssv(packed.path, resource=name).parameters}
    for model, element in packed.components.items():
        path = unpacked / f"resources/{element}.fmu"
        own = {n.removeprefix(f"{element}."): v for n, v in values.items() if n.startswith(f"{element}.")}
        job = json.dumps({"starts": own, "step": STEP, "command": list(late)})
        alone = in_a_child(ALONE, tmp_path / "alone.npz", path, job)
        for name, outputs in alone.items():
            assert np.array_equal(together[f"{element}_{name}"], outputs), (model, name)
            assert np.ptp(outputs) > 0, (model, name)
    assert not np.array_equal(together["lag_angle"], together["vendor_fmu_angle"])  # of another gain
    assert not np.array_equal(together["cehA_arm_angle"], together["identified_arm_angle"])


def in_a_child(program: str, out: Path, *words) -> dict[str, np.ndarray]:
    subprocess.run([sys.executable, "-c", program, str(out), *map(str, words)], check=True, timeout=120)
    with np.load(out, allow_pickle=False) as stored:
        return dict(stored)


def test_a_component_computes_what_the_comparison_did(parts, record, packed, unpacked):
    expected = simulate(parts[1].thing, record)
    found = read_fmu(unpacked / "resources/identified.fmu").free_run(record)
    for name in ("arm_angle", "pressure_cap"):
        assert found[name] == pytest.approx(expected[name], abs=1e-6 * np.ptp(expected[name])), name


def test_a_component_starts_where_the_start_was_estimated(systems, record, tmp_path):
    """As the comparison did, states without a sensor too; of a recording without an estimate as measured."""
    later = Record(record.time, dict(record.signals), dict(record.units), "run 2")
    starts = {"arm.angle": 0.2, "motor.speed": 5.0}
    one = SystemPart("cehA", systems["cehA"], starts={record.name: starts})
    export_ssp([one], tmp_path / "both.ssp", records=[record, later])
    export_ssp([one], tmp_path / "first.ssp", records=[record])

    def found(name, plain):
        told = read_ssv(tmp_path / name, resource=f"resources/start_{plain}.ssv")
        return {p.name: float(p.value) for p in told.parameters}

    assert found("both.ssp", "run_2") == {"cehA.arm.angle.start": pytest.approx(record["arm_angle"][0])}
    assert found("first.ssp", "run_1_short") == {f"cehA.{state}.start": value for state, value in starts.items()}


def test_the_recordings_lie_in_the_archive(record, unpacked):
    read = read_record(unpacked / "resources/run_1_short.csv")
    assert list(read) == ["command", "arm_angle", "angle"]
    assert np.array_equal(read["command"], record["command"]) and np.array_equal(read.time, record.time)


def test_the_same_comparison_gives_the_same_bytes(parts, record, packed, tmp_path):
    again = export_ssp(parts, tmp_path / "again.ssp", records=[record], title="four models")
    assert again.path.read_bytes() == Path(packed.path).read_bytes()


def test_what_is_no_system_is_left_out_with_a_sentence(packed, parts, tmp_path):
    (sentence,) = packed.left_out
    assert sentence.startswith("hold last sample: left out, it is no system")
    surrounded = SimpleNamespace(flat=SimpleNamespace(ode=None, black_box=True))
    answer = export_ssp([parts[2], SystemPart("around", surrounded)], tmp_path / "one.ssp")
    assert answer.left_out[0].startswith("around: left out, an FMU with effects around it")
    assert answer.components == {"lag": "lag"}
    with pytest.raises(DeclarationError, match=r"no model of the comparison can be a component.*Add a physical model"):
        export_ssp(parts[-1:], tmp_path / "none.ssp")
    assert not (tmp_path / "none.ssp").exists()


def test_models_that_disagree_on_an_input_are_refused(fmus, tmp_path):
    block, names = read_fmu(fmus["lag"]), {"force": "command"}
    mass = read_fmu(export_fmu(delayed_mass(), tmp_path / "mass.fmu"), names=names)
    with pytest.raises(DeclarationError, match="'command' is in V for lag and in N for mass"):
        export_ssp([SystemPart("lag", block), SystemPart("mass", mass)], tmp_path / "x.ssp")
    with pytest.raises(DeclarationError, match="two are called 'lag'"):
        export_ssp([SystemPart("lag", block), SystemPart("lag", block)], tmp_path / "x.ssp")
