"""The network on recordings of the truth rig: both machines, unseen commands, the whole recording in free run."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned import train_network
from hydrotwin.records import Record
from hydrotwin.simulation import predict_one_step, simulate
from tests import rig


def recordings(machine: str, part: str) -> list[Record]:
    m = rig.MACHINES[machine]
    units = dict(zip((m.input, *m.outputs), (m.input_unit, *m.units), strict=True))
    columns = rig.clean_recordings(machine, part, seed=2, duration=30)
    return [Record(c["time"], {n: c[n] for n in units}, units, f"{part}_{k}") for k, c in enumerate(columns)]


@pytest.mark.proof
@pytest.mark.parametrize(
    ("machine", "command", "output", "bound"),
    [("cehA", "command", "arm_angle", np.radians(0.25)), ("spool_valve", "current", "position", 2e-3)],
)
def test_the_network_runs_free_with_half_the_error_of_the_best_linear_model(machine, command, output, bound):
    pytest.importorskip("torch")
    train, validate = recordings(machine, "train"), recordings(machine, "validate")
    options = {"period": 0.02, "lags": (2, 4), "starts": 1, "effort": 0.5}
    network, linear = (train_network(train, [command], [output], hidden=h, **options) for h in (8, 0))
    runs = [np.concatenate([simulate(b, r)[output] - r[output] for r in validate]) for b in (network, linear)]
    errors = [np.sqrt(np.mean(e**2)) for e in runs]
    assert errors[0] < bound and errors[0] < 0.5 * errors[1]
    ahead = np.concatenate([predict_one_step(network, r)[output] - r[output] for r in validate])
    assert np.sqrt(np.mean(ahead**2)) < 2 * rig.sensor_noise(machine)[output]
