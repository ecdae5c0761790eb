"""The hybrid: an identified actuator with a hidden effect, and the residual that is learned beside it."""

from __future__ import annotations

import hashlib
import io
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from typer.testing import CliRunner

import hydrotwin
from hydrotwin.cli import app
from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.identification import identify
from hydrotwin.learned import domain_share
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.hybrid import learn as learning_hybrid
from hydrotwin.learned.hybrid.block import join, residual_signal, simulated_signal
from hydrotwin.learned.hybrid.files import read_hybrid, write_hybrid
from hydrotwin.learned.hybrid.learn import learn_hybrid
from hydrotwin.learned.network.learn import train_network
from hydrotwin.learned.network.narx import NETWORK, NarxShape, array_shapes, network_states
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record, write_record
from hydrotwin.simulation import lower, predict_one_step, simulate
from tests import rig
from tests.learned.test_bad_input import MODEL, PERIOD, recording
from tests.learned.toy_machine import toy_record

UNITS = {"command": "V", "arm_angle": "rad", "piston_force": "N"}
QUICK = {"starts": 1, "hidden": 6, "effort": 0.25, "period": 0.01, "budget": 3600.0}
BRIEF = QUICK | {"hidden": 0, "effort": 0.1}


def recordings(kind: str, count: int, effects, seconds: float = 10.0) -> list[Record]:
    made = rig.clean_recordings("cehA", kind, count, duration=seconds, effects=effects)
    return [Record(c["time"], {n: c[n] for n in UNITS}, UNITS, f"{kind}_{i}") for i, c in enumerate(made)]


def rmse(system, record, name):
    return float(np.sqrt(np.mean((simulate(system, record)[name] - record[name]) ** 2)))


def random_residual(model, outputs=("piston_force",), seed=0, size=1.0):
    """A residual block with random weights, of ``size`` newtons."""
    flat, shape = model.flat, NarxShape(2, len(outputs), 1, 2, 3)
    chosen = [s for s in flat.outputs if s.name in outputs]
    inputs = (flat.inputs[0], simulated_signal(flat.outputs[1]))
    rng = np.random.default_rng(seed)
    arrays = {k: rng.normal(size=s) for k, s in array_shapes(shape.structure(), 2, len(outputs)).items()}
    arrays |= {"input_scale": np.array([2.0, 200.0]), "input_centre": np.zeros(2)}
    arrays |= {f"{k}_scale": np.full(len(outputs), size) for k in ("output", "increment")}
    arrays |= {"increment_limit": np.full(len(outputs), 2.0), "output_centre": np.zeros(len(outputs))}
    arrays |= {f"output_{k}": np.full(len(outputs), s * 5 * size) for k, s in (("lower", -1), ("upper", 1))}
    arrays |= {f"feature_{k}": np.full(shape.features, s * 2.0) for k, s in (("lower", -1), ("upper", 1))}
    signals = tuple(residual_signal(s) for s in chosen)
    states = network_states(shape, inputs, signals)
    return assemble(NETWORK, arrays, shape.structure(), name="random", inputs=inputs, outputs=signals, states=states,
                    parameters=(), period=0.01)  # fmt: skip


@pytest.fixture(scope="module")
def actuator():
    return hydrotwin.load("cehA")


@pytest.fixture(scope="module")
def lopsided():
    """Recordings of a motor that turns weaker one way, which no model here knows: two to learn from, one to judge."""
    hidden = [("direction_asymmetry", {})]
    return recordings("train", 2, hidden), recordings("validate", 1, hidden)[0]


@pytest.fixture(scope="module")
def identified(actuator, lopsided):
    return identify(actuator, lopsided[0], free=["motor.gain"], starts=1, windows=(), threads=1).flat


@pytest.fixture(scope="module")
def hybrid(identified, lopsided):
    return learn_hybrid(identified, lopsided[0], ["arm_angle"], **QUICK)


def test_what_the_model_does_not_know_costs_the_hybrid_a_third_of_what_it_costs_the_model(hybrid, identified, lopsided):
    _, validation = lopsided
    model = rmse(identified, validation, "arm_angle")
    assert model > 50 * rig.sensor_noise("cehA")["arm_angle"]
    assert rmse(hybrid, validation, "arm_angle") < 0.33 * model


@pytest.mark.proof
def test_hidden_friction_is_learned_from_the_force_it_leaves(actuator):
    hidden = [("coulomb_friction", {})]
    train, (validation,) = recordings("train", 2, hidden), recordings("validate", 1, hidden)
    hybrid = learn_hybrid(actuator, train, ["piston_force"], **QUICK)
    assert rmse(hybrid, validation, "piston_force") < 0.67 * rmse(actuator, validation, "piston_force")


def test_the_errors_in_the_provenance_are_those_of_the_free_runs(hybrid, identified, lopsided):
    train, _ = lopsided
    told = hybrid.provenance["errors"]["arm_angle"]
    for name, system in (("model", identified), ("hybrid", hybrid)):
        errors = [rmse(system, r, "arm_angle") for r in train]
        assert told[name] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-9)
    assert told["hybrid"] < told["model"]


def test_an_output_that_is_not_corrected_stays_that_of_the_model(hybrid, identified, lopsided):
    assert hybrid.corrected == ("arm_angle",)
    run, plain = (simulate(system, lopsided[1]) for system in (hybrid, identified))
    assert np.abs(run["piston_force"] - plain["piston_force"]).max() < 1e-6
    assert np.abs(run["arm_angle"] - plain["arm_angle"]).max() > 1e-3


@pytest.mark.parametrize("method", ["explicit", "implicit"])
def test_a_corrected_output_is_the_model_s_and_what_the_residual_says_of_it(actuator, lopsided, method):
    residual = random_residual(actuator, size=100.0)
    block, record = join(actuator, residual, method=method), lopsided[1].window(0.0, 1.0)
    model = simulate(lower(actuator, 0.01, method), record)
    seen = Record(record.time, {"command": record["command"], "simulated.motor_speed": model["motor_speed"],
                                "residual.piston_force": record["piston_force"] - model["piston_force"]},
                  {"command": "V", "simulated.motor_speed": "rad/s", "residual.piston_force": "N"})  # fmt: skip
    expected = model["piston_force"] + simulate(residual, seen)["residual.piston_force"]
    found = simulate(block, record)
    assert np.allclose(found["piston_force"], expected, rtol=1e-12, atol=1e-9)
    assert np.array_equal(found["arm_angle"], model["arm_angle"])


def test_the_run_starts_at_what_was_measured_and_at_the_model_where_nothing_was(hybrid, lopsided):
    _, record = lopsided
    assert simulate(hybrid, record)["arm_angle"][0] == pytest.approx(record["arm_angle"][0], abs=1e-9)
    blind = simulate(hybrid, record.select(["command"]))
    start = hybrid.start(record["command"][0], np.full(len(hybrid.outputs), np.nan), hybrid.parameter_vector())
    states = [s.name for s in hybrid.states]
    assert float(start[states.index("residual.arm_angle")]) == 0.0 and np.isfinite(blind["arm_angle"]).all()


def test_a_corrected_output_has_no_state_of_its_own_and_one_step_ahead_is_the_free_run(hybrid, lopsided):
    measured = {s.measured_by for s in hybrid.states}
    assert "arm_angle" not in measured and "motor_speed" in measured
    record = lopsided[1].window(0.0, 2.0).select(["command", "arm_angle"])
    assert np.allclose(predict_one_step(hybrid, record)["arm_angle"], simulate(hybrid, record)["arm_angle"])


def test_the_model_s_parameters_still_act(hybrid, lopsided):
    record = lopsided[1].window(0.0, 2.0)
    weak = simulate(hybrid, record, parameters={"motor.gain": 60.0})
    assert np.ptp(weak["arm_angle"]) < 0.8 * np.ptp(simulate(hybrid, record)["arm_angle"])


def test_the_fmu_of_a_hybrid_runs_as_the_block_does(hybrid, lopsided, tmp_path):
    record = lopsided[1].window(0.0, 3.0)
    found, own = read_fmu(export_fmu(hybrid, tmp_path / "hybrid.fmu")).free_run(record), simulate(hybrid, record)
    for name in ("arm_angle", "piston_force"):
        assert np.abs(found[name] - own[name]).max() < 1e-6 * np.ptp(own[name])


@pytest.fixture(scope="module")
def knows_all(actuator):
    """A recording that the model explains up to noise, and the hybrid that is learned from it."""
    (record,) = recordings("train", 1, ())
    run = simulate(actuator, record)
    rng = np.random.default_rng(0)
    clean = {n: run[n] + 1e-3 * np.ptp(run[n]) * rng.normal(size=len(record)) for n in ("arm_angle",)}
    record = record.with_signals(clean)
    return record, learn_hybrid(actuator, [record], ["arm_angle"], **QUICK | {"effort": 0.2})


def test_a_residual_that_does_not_help_is_not_added_and_that_is_said_first(knows_all, actuator):
    record, block = knows_all
    told = block.provenance
    assert block.residual is None and block.corrected == () and told["added"] is False
    errors = told["held_out"]["arm_angle"]
    assert errors["hybrid"] >= 0.9 * errors["model"]
    assert told["says"].startswith("The residual was not added") and "the model alone" in told["says"]
    model = simulate(lower(actuator, block.period), record.select(["command", "arm_angle"]))
    assert np.allclose(simulate(block, record)["arm_angle"], model["arm_angle"], atol=1e-9)


def test_a_model_alone_comes_back_from_its_files_and_runs_as_an_fmu(knows_all, tmp_path):
    record, block = knows_all
    written = write_hybrid(block, tmp_path / "arm.toml", "cehA")
    assert [p.name for p in written] == ["arm.toml", "arm_model.toml"]
    again = hydrotwin.load(str(written[0]))
    runs = [simulate(h, record.window(0, 2.0))["arm_angle"] for h in (block, again)]
    assert np.array_equal(*runs) and again.domain == block.domain and again.provenance["added"] is False
    fmu = read_fmu(export_fmu(again, tmp_path / "alone.fmu")).free_run(record.window(0, 2.0))
    assert np.allclose(fmu["arm_angle"], runs[0], atol=1e-6)


AXIS = """from hydrotwin.models.cehA import model

def axis():
    return model()
"""


@pytest.fixture
def in_python(tmp_path):
    """A hybrid on a model of the user's own file, written; the file is gone afterwards."""
    code = tmp_path / "rig.py"
    code.write_text(AXIS)
    spec = f"{code}:axis"
    machine = hydrotwin.load(spec)
    block = join(machine, random_residual(machine))
    written = write_hybrid(block, tmp_path / "arm.toml", spec)
    code.unlink()
    return block, written


def test_a_hybrid_on_a_model_in_python_runs_by_its_own_name_and_starts_no_code(in_python, lopsided):
    block, written = in_python
    assert [p.name for p in written] == ["arm.toml", "arm_model.toml", "arm_physics.toml", "arm_physics.npz",
                                         "arm_residual.toml", "arm_residual.npz"]  # fmt: skip
    again, record = hydrotwin.load(str(written[0])), lopsided[1].window(0, 2.0)
    for seen in (record, record.select(["command"])):
        for name in ("arm_angle", "piston_force"):
            assert np.allclose(simulate(again, seen)[name], simulate(block, seen)[name], rtol=1e-12)
    assert again.corrected == ("piston_force",)


@pytest.mark.usefixtures("in_python")
def test_the_commands_take_such_a_hybrid_by_that_name(lopsided, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_record(lopsided[1].window(0, 1.0), tmp_path / "run.csv")
    (tmp_path / "scenario.toml").write_text('models = ["arm.toml", "cehA"]\nvalidate = ["run.csv"]\n')
    for line in ("simulate arm.toml --input run.csv", "export arm.toml --out arm.fmu", "check arm.fmu",
                 "compare scenario.toml --out compared"):  # fmt: skip
        found = CliRunner().invoke(app, line.split())
        assert found.exit_code == 0, found.output


@pytest.mark.parametrize("damage", ["cut off", "missing", "another operation"])
def test_damaged_equations_are_refused(in_python, damage):
    path, _, physics, arrays, *_ = in_python[1]
    content = arrays.read_bytes()
    if damage == "missing":
        arrays.unlink()
    else:
        arrays.write_bytes(content[:-20])
    if damage == "another operation":
        with np.load(io.BytesIO(content)) as archive:
            tape = dict(archive)
        tape["ode.rows"][:, 0] = 9999
        np.savez(arrays, **tape)
        digests = [hashlib.sha256(c).hexdigest() for c in (content, arrays.read_bytes())]
        before = hashlib.sha256(physics.read_bytes()).hexdigest()
        physics.write_text(physics.read_text().replace(*digests))
        path.write_text(path.read_text().replace(before, hashlib.sha256(physics.read_bytes()).hexdigest()))
    with pytest.raises(DataError, match="arm_physics"):
        hydrotwin.load(str(path))


def test_a_hybrid_is_no_set_of_values_and_its_equations_no_model(in_python):
    path, _, physics, *_ = in_python[1]
    with pytest.raises(DeclarationError, match=r"a hybrid, not the values .*name .*arm\.toml alone"):
        hydrotwin.load(f"cehA@{path}")
    with pytest.raises(DeclarationError, match="Name the hybrid"):
        hydrotwin.load(str(physics))


def test_a_hybrid_comes_back_from_its_files(hybrid, lopsided, tmp_path):
    written = write_hybrid(hybrid, tmp_path / "arm.toml", "cehA")
    assert [p.name for p in written] == ["arm.toml", "arm_model.toml", "arm_residual.toml", "arm_residual.npz"]
    again = read_hybrid(written[0], hydrotwin.load)
    assert again.corrected == hybrid.corrected and again.provenance["errors"] == hybrid.provenance["errors"]
    runs = [simulate(h, lopsided[1])["arm_angle"] for h in (hybrid, again)]
    assert np.allclose(*runs, rtol=1e-12)


def test_a_hybrid_with_a_changed_or_missing_part_is_refused(actuator, tmp_path):
    block = join(actuator, random_residual(actuator))
    path, model, residual, _ = write_hybrid(block, tmp_path / "arm.toml", "cehA")
    kept = model.read_text()
    model.write_text(kept.replace("value = 120.0", "value = 121.0"))
    with pytest.raises(DataError, match=r"not the file that arm\.toml was written with"):
        read_hybrid(path, hydrotwin.load)
    model.write_text(kept)
    residual.rename(tmp_path / "away.toml")
    with pytest.raises(DataError, match="is missing"):
        read_hybrid(path, hydrotwin.load)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ('kind = "network"', "not a hybrid"),
        ("version = 2", "version 2 of 'hybrid', this hydrotwin reads version 1"),
        ('method = "euler"', "no block method 'euler'"),
        ("name = 1\nmodel = 3", "lacks or garbles"),
    ],
)
def test_a_garbled_hybrid_file_is_refused(actuator, tmp_path, line, sentence):
    path = write_hybrid(join(actuator, random_residual(actuator)), tmp_path / "arm.toml", "cehA")[0]
    key = line.split(" ")[0]
    lines = [text for text in path.read_text().splitlines() if not text.startswith(key + " ")]
    if "model" in line:
        lines = [t for t in "\n".join(lines).split("\n\n") if not t.startswith("[model]")]
    path.write_text("\n".join([line, *lines]))
    with pytest.raises(DataError, match=sentence):
        read_hybrid(path, hydrotwin.load)


def test_a_residual_of_another_machine_is_refused(actuator):
    with pytest.raises(DataError, match="which spool_valve lacks"):
        join(hydrotwin.load("spool_valve"), random_residual(actuator))


def test_the_residual_s_box_is_that_of_the_hybrid(hybrid, lopsided):
    assert "command" in hybrid.domain.names
    assert domain_share(hybrid, simulate(hybrid, lopsided[0][0])).inside == 1.0


def test_names_of_recordings_and_residual_are_kept(hybrid, lopsided):
    assert [r["name"] for r in hybrid.provenance["trained_on"]] == [r.name for r in lopsided[0]]
    assert "with a learned residual" in hybrid.description


@pytest.mark.parametrize(
    ("change", "error", "sentence"),
    [
        ({"outputs": ["piston_farce"]}, DeclarationError, "Did you mean 'piston_force'"),
        ({"features": ["speed"]}, DeclarationError, "no output 'speed'"),
        ({"records": []}, DataError, "no recordings"),
        ({"records": [toy_record(1).select(["command"])], "outputs": None}, DataError, "none of the outputs"),
        ({"hidden": -1}, DeclarationError, "hidden"),
    ],
)
def test_what_no_hybrid_can_be_learned_from_is_refused(actuator, lopsided, change, error, sentence):
    asked = {"records": lopsided[0][:1], "outputs": ["piston_force"], **BRIEF} | change
    with pytest.raises(error, match=sentence):
        learn_hybrid(actuator, asked.pop("records"), asked.pop("outputs"), **asked)


def test_a_model_that_leaves_nothing_is_refused(actuator, lopsided):
    record = lopsided[0][0]
    perfect = record.with_signals({"arm_angle": simulate(lower(actuator, 0.01), record)["arm_angle"]})
    with pytest.raises(DataError, match="leaves nothing of 'arm_angle'"):
        learn_hybrid(actuator, [perfect], ["arm_angle"], **BRIEF | {"method": "explicit"})


def test_held_inputs_keep_the_period_short_enough_for_the_model(actuator, lopsided):
    from hydrotwin.learned.hybrid.learn import _period

    outputs = [s for s in actuator.flat.outputs if s.name == "arm_angle"]
    period = _period(actuator, lopsided[0], outputs)
    whole, held = (simulate(lower(actuator, p), lopsided[0][0])["arm_angle"] for p in (0.01, period))
    assert np.sqrt(np.mean((whole - held) ** 2)) < 3e-3 * np.ptp(whole)


def test_the_joined_step_is_one_casadi_function_without_free_symbols(hybrid):
    assert isinstance(hybrid.step, ca.Function) and not hybrid.step.has_free()
    assert hybrid.step.size1_in(0) == len(hybrid.states)


def test_both_trainings_of_a_residual_share_the_budget_and_the_last_says_what_cut_it(monkeypatch):
    """The second is on all recordings, and is the one that is written."""
    given = []

    def training(*recordings, **options):
        block = train_network(*recordings, **{**options, "budget": None})
        given.append(options["budget"])
        cut = {"stopped": "time budget of 5 s"} if len(given) > 1 else {}
        return replace(block, provenance={**block.provenance, **cut})

    monkeypatch.setattr(learning_hybrid, "train_network", training)
    short = {"starts": 1, "hidden": 0, "effort": 0.1, "period": PERIOD, "features": ["velocity"]}
    block = learn_hybrid(hydrotwin.load(MODEL), [recording()], ["position"], budget=100.0, **short)
    assert block.provenance["added"] and len(given) == 2
    assert given[0] == 100.0 > given[1] > 0, "what the first has left"
    assert block.provenance["stopped"] == "time budget of 5 s"
