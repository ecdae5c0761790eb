"""Somebody else's FMU, whose outputs follow inputs at once and which may be read after a step only, in all masters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.comparison import compare
from hydrotwin.export import check_fmu, read_fmu
from hydrotwin.export.reader import LATE
from hydrotwin.loading import load
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record
from hydrotwin.report.answer import facts
from tests.export.follower import follower
from tests.export.foreign import rewritten

T, PERIOD, COUNT = 0.1, 0.01, 150  # s, s, samples
EQUAL = 1e-9  # of the range
UNITS = {"u": "N", "gain": "1", "on": "1"}


@pytest.fixture(scope="module")
def plants(tmp_path_factory):
    """(version of FMI, options as pairs) -> the FMU, made when first asked for."""
    folder = tmp_path_factory.mktemp("plants")

    class Made(dict):
        def __missing__(self, key):
            fmi, *options = key
            self[key] = follower(folder / f"{len(self)}.fmu", fmi, **dict(options))
            return self[key]

    return Made()


def stepped() -> Record:
    """Inputs that jump, every 0.2 s one of them."""
    time = np.arange(COUNT) * PERIOD
    k = np.arange(COUNT) // 20
    u = np.array([1.0, -2.0, -2.0, 3.5, 3.5, 0.5, -1.0, 2.0])[k]
    gain, on = np.array([1, 1, 3, 3, 3, 2, 2, 1])[k], np.array([1, 1, 1, 1, 0, 0, 1, 1])[k]
    return Record(time, {"u": u, "gain": gain.astype(float), "on": on.astype(float)}, UNITS, "steps")


def exact(record: Record, held: np.ndarray) -> np.ndarray:
    """The state under ``held`` (n - 1,) inputs."""
    x = np.zeros(COUNT)
    for k in range(COUNT - 1):
        target = record["gain"][k] * held[k] * record["on"][k]
        x[k + 1] = target + (x[k] - target) * np.exp(-PERIOD / T)
    return x


def same(found, expected, within=EQUAL):
    assert np.abs(np.asarray(found) - expected).max() <= within * np.ptp(expected)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_step_of_an_input_leaves_the_state_undisturbed_and_outputs_belong_to_the_inputs_of_their_row(plants, fmi):
    record = stepped()
    found, x = read_fmu(plants[fmi,]).free_run(record), exact(record, record["u"])
    same(found["state"], x)
    same(found["force"], x + record["u"])
    same(found["gain_seen"], record["gain"])
    same(found["on_seen"], record["on"])


def after_the_steps(record: Record) -> np.ndarray:
    """State and force as a master has them that reads after each step: the force of the inputs before."""
    x = exact(record, record["u"])[1:]
    return np.column_stack([x, x + record["u"][:-1]])


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpys_master_has_the_same_state_and_the_force_of_the_inputs_before(plants, fmi):
    from fmpy import simulate_fmu

    record = stepped()
    rows = [(record.time[j], *(record[n][k] for n in UNITS)) for k in range(COUNT - 1) for j in (k, k + 1)]
    kinds = [("time", np.float64), ("u", np.float64), ("gain", np.int32), ("on", np.bool_)]
    result = simulate_fmu(
        str(plants[fmi,]), fmi_type="CoSimulation", input=np.array(rows, dtype=kinds), output=["state", "force"],
        output_interval=PERIOD, stop_time=record.time[-1], start_values={"u": record["u"][0]},
    )  # fmt: skip
    theirs = np.column_stack([result["state"], result["force"]])[1:]
    same(theirs, after_the_steps(record))
    ours = read_fmu(plants[fmi,]).free_run(record)
    same(theirs[:, 0], ours["state"][1:])
    quiet = np.diff(record["u"]) == 0
    same(theirs[quiet, 1], ours["force"][1:][quiet])


def test_libcosim_has_the_same_state_and_the_force_of_the_inputs_before(plants):
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    record = stepped()
    execution = CosimExecution.from_step_size(step_size=round(PERIOD * 1e9))
    slave = execution.add_local_slave(CosimLocalSlave(fmu_path=str(plants[2,]), instance_name="plant"))
    override, observer = CosimManipulator.create_override(), CosimObserver.create_last_value()
    execution.add_manipulator(override)
    execution.add_observer(observer)
    theirs = []
    for k in range(COUNT - 1):
        override.slave_real_values(slave, [0], [record["u"][k]])
        override.slave_integer_values(slave, [10], [int(record["gain"][k])])
        override.slave_boolean_values(slave, [20], [bool(record["on"][k])])
        assert execution.step()
        theirs.append(observer.last_real_values(slave, [2, 3]))
    same(theirs, after_the_steps(record))
    same(np.array(theirs)[:, 0], read_fmu(plants[2,]).free_run(record)["state"][1:])


def exchanging(path, **options):
    block = read_fmu(path, **options)
    return dataclasses.replace(block, description=dataclasses.replace(block.description, interface="ModelExchange"))


@pytest.mark.parametrize("fmi", [2, 3])
def test_model_exchange_agrees_within_the_tolerance_of_its_solver(plants, fmi):
    record = stepped()
    found, x = exchanging(plants[fmi,]).free_run(record), exact(record, record["u"])
    same(found["state"], x, 1e-8)
    same(found["force"], x + record["u"], 1e-8)
    same(found["gain_seen"], record["gain"])


def ramps() -> Record:
    """A force that moves all the time."""
    time = np.arange(COUNT) * PERIOD
    whole = {"gain": np.full(COUNT, 2.0), "on": np.ones(COUNT)}
    return Record(time, {"u": np.sin(5 * time), **whole}, UNITS, "ramps")


def under_lines(record: Record) -> np.ndarray:
    """The exact state where the force lies on the line from sample to sample."""
    x, u = np.zeros(COUNT), record["u"]
    for k in range(COUNT - 1):
        slope, e = 2.0 * (u[k + 1] - u[k]) / PERIOD, np.exp(-PERIOD / T)
        x[k + 1] = 2.0 * u[k] + slope * (PERIOD - T) + (x[k] - 2.0 * u[k] + slope * T) * e
    return x


def test_a_linear_input_is_told_by_its_slope_or_held_at_its_mean_and_the_state_stays_undisturbed(plants):
    record, u = ramps(), ramps()["u"]
    states = {2: under_lines(record), 3: exact(record, 0.5 * (u[1:] + u[:-1]))}
    for fmi, x in states.items():
        found = read_fmu(plants[fmi,], interpolation="linear").free_run(record)
        same(found["state"], x, 1e-8)
        same(found["force"], x + u, 1e-8)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_linear_input_moves_within_the_steps_of_model_exchange(plants, fmi):
    record = ramps()
    found, x = exchanging(plants[fmi,], interpolation="linear").free_run(record), under_lines(record)
    same(found["state"], x, 1e-8)
    same(found["force"], x + record["u"], 1e-8)


def test_an_fmu_of_one_step_size_shows_what_follows_at_once_a_sample_late_and_says_so(plants):
    record, block = stepped(), read_fmu(plants[2, ("one_size", True)])
    found, x = block.free_run(record), exact(record, record["u"])
    same(found["state"], x)
    same(found["force"][1:], x[1:] + record["u"][:-1])
    assert block.provenance[LATE] == "force, gain_seen, on_seen"
    assert LATE not in read_fmu(plants[2,]).provenance
    measured = Record(record.time, {**record.signals, "force": x + record["u"]}, {**UNITS, "force": "N"}, "rig")
    told = facts(compare([block, read_fmu(plants[2,], name="any step")], [measured], repeats=1), {"force": "N"})
    assert any("Of follower, force, gain_seen, on_seen is shown one sample late" in sentence for sentence in told), told


def test_into_an_fmu_whose_discrete_outputs_may_count_steps_nobody_looks(plants, tmp_path):
    """It cannot be brought back, and does not say that what is discrete follows its inputs alone."""
    unsaid = {'<Unknown index="7" dependencies="6"/>': '<Unknown index="7"/>'}
    record, block = stepped(), read_fmu(rewritten(plants[2,], tmp_path / "counts.fmu", xml=unsaid))
    found, x = block.free_run(record), exact(record, record["u"])
    assert block.provenance[LATE] == "force, gain_seen, on_seen"
    same(found["state"], x)
    same(found["force"][1:], x[1:] + record["u"][:-1])


def with_value(name: str, row: int, value: float) -> Record:
    record = stepped()
    values = record[name].copy()
    values[row] = value
    return record.with_signals({name: values})


@pytest.mark.parametrize("fmi", [2, 3])
def test_whole_inputs_are_rounded_to_the_nearest(plants, fmi):
    block, expected = read_fmu(plants[fmi,]), read_fmu(plants[fmi,]).free_run(stepped())
    for name, row, value in (("gain", 45, 2.9999999999), ("gain", 50, 3.0000002), ("on", 30, 0.9999999999)):
        found = block.free_run(with_value(name, row, value))
        assert all(np.array_equal(found[n], expected[n]) for n in found.signals), name


@pytest.mark.parametrize(("name", "row", "value", "said"), [
    ("gain", 45, 0.4, r"row 46 \(t = 0\.45 s\) of 'gain' is no Int.*got 0\.4.*whole number"),
    ("gain", 7, np.nan, r"'gain' has gaps.*the first at t = 0\.07 s.*Fill them"),
    ("gain", 7, 3e9, "row 8 .*got 3000000000.*-2147483648 to 2147483647"),
    ("on", 30, 0.5, "row 31 .*'on' is no Boolean.*Write 0 or 1"),
    ("on", 30, 2.0, "Write 0 or 1"),
])  # fmt: skip
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_input_that_is_not_whole_is_refused_with_its_row(plants, fmi, name, row, value, said):
    with pytest.raises(DataError, match=said):
        read_fmu(plants[fmi,]).free_run(with_value(name, row, value))


def test_a_value_that_is_not_whole_is_refused_where_it_is_given(plants):
    with pytest.raises(DataError, match="values: 'gain' is no Integer"):
        read_fmu(plants[2,], values={"gain": 1.5})


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_without_outputs_says_what_to_name_and_local_variables_can_be_named(plants, fmi):
    path, record = plants[fmi, ("outputs", False)], stepped()
    with pytest.raises(DeclarationError, match=r"no outputs.*\.fmu:state on the command line.*It has: state, "):
        read_fmu(path).free_run(record)
    named, x = load(f"{path}:state,der(state),gain_seen"), exact(record, record["u"])
    found = named.free_run(record)
    assert list(found.signals) == ["state", "der(state)", "gain_seen"]
    same(found["state"], x)
    same(found["der(state)"], (record["gain"] * record["u"] * record["on"] - x) / T)
    with pytest.raises(DeclarationError, match="no variable 'stat'"):
        load(f"{path}:stat")


@pytest.mark.parametrize("fault", ["OLD_INPUTS", "TIME_RISES", "INPUTS_AT_EVENTS", "KEPT_RATE"])
def test_check_finds_an_answer_that_depends_on_the_calls_before(plants, fault):
    check = check_fmu(plants[2, ("fault", fault)])
    rows = [f"{row.name}: {row.detail}" for row in check.failures]
    assert any("any order of calls" in row and "depends on the calls before" in row for row in rows), str(check)


def test_check_finds_nothing_of_the_kind_in_a_pure_one(plants):
    assert check_fmu(plants[3,])["any order of calls (Model Exchange)"].passed


def test_what_an_fmu_sees_of_an_input_that_moves_is_said(plants):
    def said(block) -> bool:
        (force,) = [s for s in block.inputs if s.name == "u"]
        return "each of its steps sees the mean" in force.why

    assert said(read_fmu(plants[2,], interpolation="linear")) is False  # it takes slopes
    assert said(read_fmu(plants[3,], interpolation="linear")) is True
    assert said(read_fmu(plants[3,], interpolation="hold")) is False
