"""The further machines: model and rig are the same machine where nothing is hidden, and what is hidden is seen."""

from __future__ import annotations

import numpy as np
import pytest

import hydrotwin
from benchmarks.gap.cases import MACHINES, Case, Unreachable, facts_of, machines_of, make, single_effects
from benchmarks.gap.severity import bed
from hydrotwin.models.effects import CATALOGUE, candidates
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests import rig

SAME, ELSEWHERE = 1e-3, 1.0  # times the noise: what two simulators of one machine differ by; what a change must show
FURTHER = machines_of("further")
HIDDEN = [(machine, effect) for machine in FURTHER for effect in single_effects(machine)]


def model_of(machine):
    return hydrotwin.load(str(MACHINES / facts_of(machine)["model"]))


def recorded(machine, parameters):
    """Steps of the machine as a Record, without noise."""
    m = rig.machine_of(machine)
    time, command = rig.drive(machine, 8.0, kind="steps", seed=3, parameters=parameters)
    columns = rig.record(machine, command, time, parameters=parameters)
    units = {**dict(zip(m.outputs, m.units, strict=True)), m.input: m.input_unit}
    return Record(time, {name: columns[name] for name in units}, units, machine)


def apart(model, record):
    """Largest root mean square difference over the noise of the sensor."""
    run = simulate(model, record)
    noise = rig.sensor_noise(record.name)
    return max(float(np.sqrt(np.mean((run[n] - record[n]) ** 2))) / sigma for n, sigma in noise.items())


@pytest.mark.parametrize("machine", FURTHER)
def test_with_every_parameter_changed_model_and_rig_are_the_same_machine(machine):
    """A parameter that acts elsewhere, or not at all, would show."""
    usual = {n: v for n, v in rig.machine_of(machine).parameters.items() if n != "drum.radius"}
    draw = np.random.default_rng(1)
    changed = {name: value * draw.uniform(0.93, 1.07) for name, value in usual.items()}
    record, model = recorded(machine, changed), model_of(machine)
    values = {p.name: p.value for p in model.flat.parameters}
    assert {name: values[name] for name in usual} == pytest.approx(usual)
    assert apart(model.with_parameters(changed), record) < SAME
    assert apart(model, record) > ELSEWHERE


@pytest.mark.parametrize(("machine", "effect"), HIDDEN)
def test_every_effect_of_a_further_machine_makes_a_visible_gap_and_is_in_the_catalogue(machine, effect):
    made = make(Case(machine, "single", (effect,), 5.0, "all", "steps", 501, 6.0))
    assert made.gap == pytest.approx(5.0, rel=0.03)
    assert made.visible > 0.5
    assert effect in CATALOGUE and candidates(made.model, [effect])


@pytest.mark.parametrize("machine", FURTHER)
def test_with_nothing_hidden_the_true_parameters_leave_the_noise_and_no_more(machine):
    case = Case(machine, "none", (), 0.0, "all", "drive", 501, 6.0)
    made, alone = make(case), bed(*case.bed_key)
    true = made.model.with_parameters(made.truth)
    for i, record in enumerate((*made.fit, *made.held_out)):
        exact = Record(record.time, {n: alone.run((), i, step=5e-5)[n] for n in record}, record.units, machine)
        assert apart(true, exact) < SAME
        for name, sigma in made.noise.items():
            assert np.std(record[name] - exact[name]) == pytest.approx(sigma, rel=0.12)


def test_a_case_in_a_loop_is_recorded_under_the_controller_that_works_against_the_effect():
    """Replayed without the effect its command leads elsewhere: that is the gap."""
    case = Case("winch", "single", ("external_leakage",), 30.0, "rope_position", "closed_loop", 501, 8.0)
    made = make(case)
    alone = bed(*case.bed_key)
    for i, record in enumerate(made.fit):
        assert np.std(record["command"] - alone.commands[i][1]) > 1e-3
        plain = rig.record("winch", record["command"], record.time, parameters=made.truth)
        hidden = rig.record("winch", record["command"], record.time, parameters=made.truth, effects=list(made.hidden))
        sigma = made.noise["rope_position"]
        assert np.std(record["rope_position"] - hidden["rope_position"]) == pytest.approx(sigma, rel=0.15)
        assert np.max(np.abs(plain["rope_position"] - hidden["rope_position"])) > 10 * sigma


def test_what_a_loop_around_a_machine_of_its_own_controller_would_be_is_no_case():
    with pytest.raises((Unreachable, ValueError)):
        make(Case("test_cylinder", "none", (), 0.0, "all", "closed_loop", 501, 6.0))
