"""Recordings with holes give the parameters that they give without: what inputs did there is not carried on."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import estimate_start, identify, profile, sensitivity
from hydrotwin.identification.excitation import excitation
from hydrotwin.models.language.errors import DataError
from hydrotwin.records import Record
from hydrotwin.simulation import prepare
from tests import rig

from .drive import TRUTH, drive, recorded

NOISE = {"position": 0.002, "motor_speed": 0.05}


def without(record: Record, *spans, name: str | None = None) -> Record:
    """The recording without the samples inside of time spans [s]."""
    keep = ~np.any([(record.time > a) & (record.time < b) for a, b in spans], axis=0)
    signals = {n: v[keep] for n, v in record.signals.items()}
    return Record(record.time[keep], signals, record.units, name or record.name, digest=record.digest)


def unknown(record: Record, begin: float, end: float, *names: str) -> Record:
    inside = (record.time > begin) & (record.time < end)
    return record.with_signals({n: np.where(inside, np.nan, record[n]) for n in names or record.names})


def jittered(record: Record) -> Record:
    """The same at uneven times: every sample by up to a third of a step, of a machine that was run so."""
    random = np.random.default_rng(3)
    time = record.time + 0.3 * 0.02 * random.uniform(-1, 1, len(record.time)) * (record.time > 0)
    p, u = drive().parameter_vector(), record["command"]
    y, _ = prepare(drive()).run(time, u[:, None], p, np.zeros(2))
    signals = {"command": u} | {
        n: y[:, j] + NOISE[n] * random.normal(size=len(time)) for j, n in enumerate(("position", "motor_speed"))
    }
    return Record(time, signals, record.units, record.name)


SORTS = {
    "rows": lambda r: without(r, (3, 5)),
    "two": lambda r: without(r, (3, 3.3), (6, 8)),
    "begin": lambda r: without(r, (0.1, 1.5)),
    "end": lambda r: without(r, (8, 9.9)),
    "input": lambda r: unknown(r, 3, 5, "command"),
    "all": lambda r: unknown(r, 3, 5),
    "uneven": lambda r: without(jittered(r), (3, 5)),
    "one sample": lambda r: without(r, *[(t - 0.001, t + 0.001) for t in (1.5, 3.5, 5.5, 7.5)]),
}


@pytest.mark.parametrize("sort", list(SORTS))
def test_a_hole_moves_no_parameter_beyond_its_interval_and_is_told(sort):
    records = [SORTS[sort](recorded(drive(), seed, noise=NOISE)) for seed in (1, 2)]
    fit = identify(drive(), records, starts=1)
    for p in fit.parameters:
        assert abs(p.value - TRUTH[p.name]) < 3 * p.sigma and p.sigma < 2e-3 * p.value
    assert all(r.chi2_per_sample < 1.3 for r in fit.residuals)
    said = [f.sentence for f in fit.findings]
    assert len(said) == 2 and all("nobody knows" in s for s in said)


def test_the_parts_of_a_recording_keep_its_name():
    fit = identify(drive(), [without(recorded(drive(), 1, noise=NOISE), (3, 5), name="run")], starts=1)
    assert [r.name for r in fit.records] == ["run (part 1)", "run (part 2)"]
    (said,) = [f.sentence for f in fit.findings if f.kind == "hole"]
    assert said == (
        "identify: run has a hole (3 s to 5 s), and what its inputs did there nobody knows: it was cut into 2 parts, "
        "with a start of its own where it goes on."
    )


def test_a_recording_that_judges_is_cut_too():
    train = [recorded(drive(), 1, noise=NOISE)]
    fit = identify(drive(), train, validate=[without(recorded(drive(), 2, noise=NOISE), (3, 5))], starts=1)
    judged = [r for r in fit.residuals if r.role == "validate"]
    assert len(judged) == 4 and all(r.chi2_per_sample < 1.3 for r in judged)
    assert [f.kind for f in fit.findings] == ["hole"]


def test_what_a_late_input_did_before_a_part_is_no_error_of_the_model():
    model = drive(dead_time=True)
    runs = [recorded(model, s, noise=NOISE, parameters={"delay": 0.13}, duration=20) for s in (1, 2)]
    fit = identify(model, [without(r, (3, 5), (9, 9.5)) for r in runs], free=["motor.*", "delay"], starts=1)
    for name, true in {**TRUTH, "delay": 0.13}.items():
        if name in fit.values and name in fit.sigma:
            assert abs(fit.values[name] - true) < 3 * fit.sigma[name]
    assert all(r.chi2_per_sample < 1.4 for r in fit.residuals)


def test_a_part_in_which_no_sensor_said_anything_is_left_out():
    silent = unknown(without(recorded(drive(), 1, noise=NOISE), (3, 5)), 4.9, 10.1, "position", "motor_speed")
    fit = identify(drive(), [silent, recorded(drive(), 2, noise=NOISE)], starts=1)
    assert [r.name for r in fit.records] == ["run_1 (part 1)", "run_2"]


def test_what_else_looks_at_recordings_cuts_them_too():
    records = [without(recorded(drive(), seed, noise=NOISE), (3, 5)) for seed in (1, 2)]
    told = "was cut into 2 parts"
    fit = identify(drive(), records, starts=1)
    assert profile(fit, records) is not None
    asked = sensitivity(drive(), records, samples=0)
    assert any(told in f.sentence for f in asked.findings) and len(asked.records) == 4
    assert any(told in sentence for sentence in excitation(drive(), records)[1])


def test_a_start_is_not_estimated_from_behind_a_hole():
    whole = recorded(drive(), 1, noise=NOISE, duration=20)
    with pytest.raises(DataError, match="begins with a hole"):
        estimate_start(drive(), unknown(whole, -1, 0.1, "command"))


@pytest.mark.proof
@pytest.mark.parametrize("machine", ["spool_valve", "cehA"])
def test_holes_move_no_parameter_of_a_shipped_machine(machine):
    import hydrotwin as ht

    one = rig.MACHINES[machine]
    units = {one.input: one.input_unit, **dict(zip(one.outputs, one.units, strict=True))}
    runs = []
    for k, columns in enumerate(rig.clean_recordings(machine, "train", seed=1)):
        signals = {n: v for n, v in columns.items() if n != "time"}
        runs.append(Record(columns["time"], signals, {n: units[n] for n in signals}, f"train_{k}"))
    plain = ht.identify(ht.load(machine), runs, starts=1)
    for cut in (lambda r: without(r, (10, 12), (20, 20.3)), lambda r: unknown(r, 10, 12, one.input)):
        holed = ht.identify(ht.load(machine), [cut(r) for r in runs], starts=1)
        assert all(r.chi2_per_sample < 1.2 for r in holed.residuals)
        for p, q in zip(plain.parameters, holed.parameters, strict=True):
            assert abs(p.value - q.value) < 2 * q.sigma and q.sigma < 3 * p.sigma
