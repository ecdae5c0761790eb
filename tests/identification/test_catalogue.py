"""Every effect of the catalogue can be identified by name in the shipped machines."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import hydrotwin
from hydrotwin import identify, read_record, simulate
from hydrotwin.models.language import TopologyError

ROOT = Path(__file__).parents[2]
QUICK = {"payload_error at arm.extra_mass", "structural_compliance at cylinder.rod"}  # of cehA, not of the proof alone
SECONDS = 3.0
NOISE = 1e-4  # of the range of every output
POSITIONS = {"cehA": "rod_position", "spool_valve": "position"}  # along which loads and brakes engage


@cache
def machine(name):
    return hydrotwin.load(name)


@cache
def first_sites(name):
    """One candidate of every effect that fits into the machine."""
    found = {}
    for candidate in hydrotwin.candidates(machine(name)):
        found.setdefault(candidate.effect.id, candidate)
    return {c.label: c for c in found.values()}


CASES = [
    pytest.param(
        name, label, marks=() if label in QUICK and name == "cehA" else pytest.mark.proof, id=f"{name} {label}"
    )
    for name in ("cehA", "spool_valve")
    for label in first_sites(name)
]


def simulated(model, name, values):
    """The machine with the effect under the commands of its shipped recording, a little noise added."""
    run = read_record(ROOT / "examples" / name / "recordings" / "train_1.csv")
    run = run.window(run.time[0], run.time[0] + SECONDS)
    seen, random = simulate(model, run, parameters=values), np.random.default_rng(0)
    noisy = {n: v + NOISE * np.ptp(v) * random.normal(size=len(v)) for n, v in seen.signals.items()}
    return run.with_signals(noisy, units=seen.units)


@pytest.mark.parametrize(("name", "label"), CASES)
def test_every_effect_is_identified_by_name_or_it_is_said_what_cannot_be_told(name, label):
    candidate = first_sites(name)[label]
    model, probe = machine(name).plus([candidate.addition]), dict(candidate.probes[-1])
    try:
        _ = model.flat
    except TopologyError as refused:  # a pump that gives its flow at any pressure, and nothing that feels the loss
        assert "changes nothing" in str(refused)
        return
    if place := next((n for n in probe if n.endswith(".start")), None):
        seen = simulated(model, name, {}).signals[POSITIONS[name]]
        probe[place] = float(np.mean(seen))  # elsewhere nothing engages in these seconds
    record = simulated(model, name, probe)
    outputs = [o.name for o in model.flat.outputs][:5]
    fit = identify(model, [record], free=list(candidate.free), outputs=outputs, weights="noise", starts=6)
    for p in fit.parameters:
        told = any(p.name in f.parameters or f.kind in ("unexplained", "no_minimum") for f in fit.findings)
        right = abs(p.value - probe.get(p.name, p.value)) < 5 * p.sigma + 1e-3 * abs(p.value)
        assert np.isfinite(p.value) and (right or told), (p, fit.findings)
