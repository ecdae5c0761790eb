"""The hidden-effect benchmark itself: its cases are what their names say, its gaps are as large as they should be."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmarks.gap.amplitudes import AMPLITUDES
from benchmarks.gap.cases import GRIDS, KINDS, SEEDS, Case, cases, grid, left_out, machines_of, make, single_effects
from benchmarks.gap.severity import Unreachable
from tests import rig

SHORT = 8.0


def short(machine, effects, severity=5.0, sensors="all", excitation="drive", seed=101, kind="single"):
    return Case(machine, kind, tuple(effects), severity, sensors, excitation, seed, SHORT)


@pytest.mark.parametrize("which", SEEDS)
def test_every_case_has_one_name_and_a_name_gives_the_case_back(which):
    found = cases(which)
    names = [case.name for case in found]
    assert len(set(names)) == len(names) > 1000
    assert [Case.from_name(name) for name in names] == found
    odd = dataclasses.replace(found[0], seconds=12.5)
    assert Case.from_name(odd.name) == odd


def test_seeds_that_are_reported_were_never_tuned_on():
    tuned, fresh = ({case.seed for case in cases(which)} for which in SEEDS)
    assert not tuned & fresh
    assert all(100 <= s < 200 for s in tuned) and all(200 <= s < 300 for s in fresh)


def test_any_beginning_of_a_grid_holds_every_kind_and_machine():
    first = cases("fresh")[:60]
    assert {c.kind for c in first} == set(KINDS)
    assert {c.machine for c in first} == set(rig.MACHINES)
    assert {c.sensors for c in first} == set(grid()["sensors"])


def test_every_rig_effect_is_in_the_grid_or_left_out_with_a_reason():
    outside = set(grid()["out_of_library"]["effects"])
    for machine in rig.MACHINES:
        able = {name for name, e in rig.EFFECTS.items() if machine in e.machines}
        assert able == set(single_effects(machine)) | (able & outside) | (able & set(left_out(machine)))
        assert all(len(why) > 5 for why in left_out(machine).values())
    assert set(AMPLITUDES) | set(left_out("cehA")) == set(rig.EFFECTS)


@pytest.mark.parametrize("severity", [1.5, 30.0])
@pytest.mark.parametrize(
    ("machine", "effect"), [("cehA", "motor_droop"), ("cehA", "dead_time"), ("spool_valve", "valve_overlap")]
)
def test_the_gap_over_the_noise_is_the_severity(machine, effect, severity):
    made = make(short(machine, [effect], severity))
    assert made.gap == pytest.approx(severity, rel=0.03)
    parts = []
    for record in made.fit:
        m = rig.MACHINES[machine]
        options = {"parameters": made.truth}
        plain = rig.record(machine, record[m.input], record.time, **options)
        hidden = rig.record(machine, record[m.input], record.time, effects=list(made.hidden), **options)
        parts += [(hidden[n] - plain[n]) / s for n, s in made.noise.items()]
        for n, s in made.noise.items():
            assert np.std(record[n] - hidden[n]) == pytest.approx(s, rel=0.15)
    assert np.sqrt(np.mean(np.concatenate(parts) ** 2)) == pytest.approx(severity, rel=0.05)


def test_the_same_case_is_made_of_the_same_numbers():
    one, two = (make(short("spool_valve", ["dead_time"])) for _ in range(2))
    assert one.hidden == two.hidden
    for a, b in zip(one.fit + one.held_out, two.fit + two.held_out, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)


def test_the_truth_is_off_and_the_model_is_not_told():
    made = make(short("cehA", [], 0.0, kind="none"))
    usual = rig.MACHINES["cehA"].parameters
    off = {name: value / usual[name] - 1 for name, value in made.truth.items()}
    assert set(off) == set(grid()["machines"]["cehA"]["free"])
    assert 0.05 < max(abs(x) for x in off.values()) <= 0.3
    assert made.gap == 0
    model = {p.name: p.value for p in made.model.flat.parameters}
    assert all(model[name] == pytest.approx(usual[name]) for name in made.truth)
    assert {p.name for p in made.model.flat.parameters if p.free} == set(made.truth)
    other = make(short("cehA", [], 0.0, seed=201, kind="none"))
    assert other.truth != made.truth


@pytest.mark.parametrize(("sensors", "count"), [("all", 5), ("position+pressures", 3), ("position", 1)])
def test_only_the_chosen_sensors_are_recorded(sensors, count):
    made = make(short("spool_valve", ["valve_overlap"], sensors=sensors))
    assert len(made.noise) == count
    for record in made.fit + made.held_out:
        assert set(record) == {"current", *made.noise}


def test_what_free_parameters_can_do_is_not_a_visible_gap():
    swallowed = make(short("cehA", ["viscous_friction"], 1.5))
    assert swallowed.visible < 0.05 * swallowed.gap
    kept = make(short("cehA", ["relief_saturation"], 5.0))
    assert kept.visible > 0.15 * kept.gap


def test_a_limit_moves_in_from_where_it_does_nothing():
    weak, strong = (make(short("cehA", ["command_saturation"], s)).hidden[0][1]["limit"] for s in (1.5, 30.0))
    assert strong < weak


@pytest.mark.parametrize("machine", ["cehA", "spool_valve"])
def test_no_machine_begins_pressed_into_its_stop(machine):
    m = rig.MACHINES[machine]
    made = make(dataclasses.replace(short(machine, ["end_stop"], 30.0, sensors="all"), excitation="sweep"))
    first = [rig.record(machine, r[m.input], r.time, effects=list(made.hidden))[m.position][0] for r in made.fit]
    assert made.hidden[0][1]["low"] <= min(first) and max(first) <= made.hidden[0][1]["high"]


def test_what_no_plausible_effect_can_do_is_said():
    with pytest.raises(Unreachable, match="payload_error at its largest plausible size"):
        make(short("spool_valve", ["payload_error"], 30.0, sensors="position"))


@pytest.mark.proof
def test_torn_oil_needs_a_low_precharge_which_the_model_knows():
    case = dataclasses.replace(short("cehA", ["cavitation"], 1.5), seconds=40.0)
    assert case.settings["precharge"] < 5e5
    values = {p.name: p.value for p in make(case).model.flat.parameters}
    assert values["precharge"] == case.settings["precharge"]


@pytest.mark.parametrize("which_grid", ["wide", "further"])
@pytest.mark.parametrize("which", SEEDS)
def test_every_case_of_the_other_grids_has_one_name_that_gives_it_back(which_grid, which):
    found = cases(which, which_grid=which_grid)
    names = [case.name for case in found]
    assert len(set(names)) == len(names) > 90
    assert [Case.from_name(name) for name in names] == found == cases(which, which_grid=which_grid)
    assert {c.machine for c in found[: len(found) // 4]} == set(machines_of(which_grid))


def test_no_two_grids_and_no_tuning_and_fresh_seeds_meet():
    seeds = [{c.seed for c in cases(which, which_grid=g)} for g in GRIDS for which in SEEDS]
    assert all(not a & b for i, a in enumerate(seeds) for b in seeds[:i])


def test_the_wide_grid_draws_from_every_style_length_converter_and_sensor_set():
    found, wide = cases("tuning", which_grid="wide"), grid()["wide"]
    assert {c.excitation for c in found} == set(wide["excitations"])
    assert {c.seconds for c in found} == set(wide["seconds"]) and {c.bits for c in found} == set(wide["bits"])
    for machine in machines_of("wide"):
        own = [c for c in found if c.machine == machine]
        assert {c.sensors for c in own} == set(wide["sensors"][machine])
        assert {len(c.outputs) for c in own} >= {1, len(rig.machine_of(machine).outputs)}
        assert all(set(c.outputs) <= set(rig.machine_of(machine).outputs) for c in own)
    for style, longest in wide["longest"].items():
        assert max(c.seconds for c in found if c.excitation == style) <= longest


def test_stiffness_and_volumes_are_farther_off_in_the_wide_grid():
    usual, off = rig.MACHINES["cehA"].parameters, {}
    for seed in range(301, 341):
        key = Case("cehA", "none", (), 0.0, "all", "sines", seed, 1.0, wide=True).bed_key
        for name, largest in key[3]:
            off[name] = largest
    assert off["cylinder.oil.bulk_modulus"] == 0.45 and off["cylinder.cap_dead_volume"] == 0.35
    assert off["motor.gain"] == 0.3 and set(off) <= set(usual)


def test_a_coarse_converter_rounds_what_is_recorded_and_counts_as_noise():
    case = Case("spool_valve", "none", (), 0.0, "position", "strokes", 301, 8.0, bits=12, wide=True)
    made, fine = make(case), make(dataclasses.replace(case, bits=0))
    step = 0.8 / 2**12
    for record in made.fit:
        assert record["position"] / step == pytest.approx(np.round(record["position"] / step), abs=1e-6)
    sigma = fine.noise["position"]
    assert made.noise["position"] == pytest.approx(np.hypot(sigma, step / np.sqrt(12)))
    error = made.fit[0]["position"] - rig.record("spool_valve", made.fit[0]["current"], made.fit[0].time,
                                                 parameters=made.truth)["position"]  # fmt: skip
    assert np.std(error) == pytest.approx(made.noise["position"], rel=0.1)
