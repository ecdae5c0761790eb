"""Styles of command: what they are called after, on every machine, inside its span."""

from __future__ import annotations

import numpy as np
import pytest

from tests import rig
from tests.rig import commands

TIME = np.arange(4001) / 100
ROOM = {"speed": (0.1, 0.1), "room": (-0.2, 0.3)}
NEW = ("strokes", "sines", "chirp")


def test_strokes_are_at_constant_levels_with_dwells_between_them():
    u = commands.strokes(TIME, 0.8, 3, **ROOM)
    flat = np.abs(np.diff(u)) < 1e-12
    assert np.mean((u == 0) | (np.abs(u) < 1e-12)) > 0.15
    assert np.mean(flat & (np.abs(u[1:]) > 0.05)) > 0.3
    assert len(np.unique(np.round(u[1:][flat], 9))) > 4
    assert np.max(np.abs(np.diff(u))) < 0.8 * 2 / 15 + 1e-9  # ramps of 0.15 s
    path = np.cumsum(u) * 0.1 * 0.01
    assert path.min() > -0.21 and path.max() < 0.31


def test_sines_have_several_sizes_and_frequencies_and_come_back():
    u = commands.sines(TIME, 0.8, 3, **ROOM)
    rises = np.flatnonzero((u[:-1] <= 0) & (u[1:] > 0))
    periods = np.diff(rises) / 100
    assert periods.max() > 4 * periods.min()
    sizes = [np.max(np.abs(part)) for part in np.split(u, rises) if len(part) > 10]
    assert max(sizes) > 2 * min(s for s in sizes if s > 0)
    assert abs(np.sum(u)) * 0.01 < 0.05 * np.sum(np.abs(u)) * 0.01


def test_a_chirp_rises_and_falls_linearly_in_frequency():
    u = commands.chirp(TIME, 0.8, 3, **ROOM)
    rises = np.flatnonzero((u[:-1] <= 0) & (u[1:] > 0)) / 100
    middle, frequency = 0.5 * (rises[1:] + rises[:-1]), 1 / np.diff(rises)
    half = middle < 20
    slope, _ = np.polyfit(middle[half], frequency[half], 1)
    falling, _ = np.polyfit(middle[~half], frequency[~half], 1)
    assert slope > 0.1 and falling == pytest.approx(-slope, rel=0.15)
    assert np.all(u[:200] == 0) and np.all(u[-200:] == 0)


@pytest.mark.parametrize("style", NEW)
@pytest.mark.parametrize("machine", [*rig.MACHINES, *rig.FURTHER])
def test_every_machine_moves_inside_its_span_and_seeds_differ(machine, style):
    m = rig.machine_of(machine)
    time, command = rig.drive(machine, 12.0, kind=style, seed=6)
    run, other = rig.record(machine, command, time), rig.drive(machine, 12.0, kind=style, seed=7)[1]
    room = 0.16 * (m.span[1] - m.span[0])
    assert m.span[0] - room < run[m.position].min() and run[m.position].max() < m.span[1] + room
    assert np.ptp(run[m.position]) > 20 * dict(zip(m.outputs, m.noise, strict=True))[m.position]
    assert np.corrcoef(command, other)[0, 1] < 0.9
