"""A machine that rests at a command stays there in a block too, and what a free run drifts by is taken out."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import read_block, write_block
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.network.narx import NETWORK, NarxShape, network_states
from hydrotwin.learned.network.rate_block import RATE_NETWORK, array_shapes, rate_frame
from hydrotwin.learned.resting import rests
from hydrotwin.learned.steady import Steady, steady_block
from hydrotwin.learned.steady_step import INCREMENT, LEVELS
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import TrainingDomain

PERIOD, GAIN, BIAS = 0.02, 0.1, 1e-3  # s, m/s per unit of command, m/s that a block drifts by
CURRENT, POSITION = Signal("current", "1"), Signal("position", "m")
UNITS = {"current": "1", "position": "m"}


def dwells(seed: int, rest: float = 0.0, seconds: float = 40.0, creep: float = 0.0, noise: float = 1e-4) -> Record:
    """Levels held for 0.5 to 1.5 s, every other one the command of rest, at which the rod creeps or stands."""
    rng, n = np.random.default_rng(seed), round(seconds / PERIOD)
    levels = np.where(np.arange(n) % 2, rng.uniform(-1, 1, n), 0.0)
    u = np.repeat(levels, rng.integers(25, 75, n))[:n]
    position = np.concatenate([[0.3], 0.3 + np.cumsum(GAIN * u + creep)[:-1] * PERIOD])
    columns = {"current": u + rest, "position": position + noise * rng.normal(size=n)}
    return Record(PERIOD * np.arange(n), columns, UNITS, f"dwells_{seed}")


def narx(rest: float = 0.0, gain: float = GAIN, lag: float = 0.0, bias: float = BIAS):
    """A linear network whose rate is ``gain`` (u - rest) and a ``bias``, after a lag that its increments remember."""
    shape = NarxShape(1, 1, 1, 3, 0)
    one, wide = np.ones(1), np.full(1, 1e3)
    kept = np.array([[0.0, lag, (1 - lag) * gain * PERIOD, 0.0, 0.0]])
    arrays = {
        "input_centre": np.array([rest]), "input_scale": one, "output_centre": 0 * one, "output_scale": one,
        "increment_scale": one, "increment_limit": wide, "output_lower": -wide, "output_upper": wide,
        "feature_lower": np.full(5, -1e3), "feature_upper": np.full(5, 1e3),
        "hidden_weights": np.zeros((0, 5)), "hidden_bias": np.zeros(0), "output_weights": np.zeros((1, 0)),
        "linear_weights": kept, "output_bias": (1 - lag) * bias * PERIOD * one,
    }  # fmt: skip
    return assemble(
        NETWORK, arrays, shape.structure(), name="biased", inputs=(CURRENT,), outputs=(POSITION,),
        states=network_states(shape, (CURRENT,), (POSITION,)), parameters=(), period=PERIOD,
        domain=TrainingDomain(("current", "position"), (rest - 1, -0.5), (rest + 1, 1.0)),
    )  # fmt: skip


def kept(block, records, curve: bool = False):
    return steady_block(block, records, Steady((POSITION,), curve=curve))


def still(block, command: float, seconds: float = 60.0) -> float:
    """How far the position moves under a held command [m]."""
    time = np.arange(0, seconds, PERIOD)
    run = simulate(block, Record(time, {"current": 0 * time + command, "position": 0 * time + 0.3}, UNITS, "held"))
    return float(np.ptp(run["position"]))


def test_a_rod_at_rest_stays_at_rest_for_a_minute():
    block = narx()
    mended = kept(block, [dwells(1), dwells(2)])
    assert still(block, 0.0) > 0.9 * 60 * BIAS
    assert still(mended, 0.0) == 0.0
    assert mended.provenance["rest"]["held"] == ["position"]
    assert mended.provenance["rest"]["drift"]["position"] == pytest.approx(BIAS, rel=1e-6)


@pytest.mark.parametrize("command", [0.05, -0.3, 1.0])
def test_a_commanded_rod_moves_as_before(command):
    block, mended = narx(), kept(narx(), [dwells(1)])
    assert still(mended, command) == pytest.approx(still(block, command), rel=1e-12)


def test_the_command_of_rest_is_that_of_the_recordings_not_zero():
    mended = kept(narx(rest=2.5), [dwells(1, rest=2.5)])
    assert still(mended, 2.5) == 0.0 and still(mended, 2.4) > 0.5


def test_a_rod_that_creeps_in_the_recordings_creeps_in_the_block():
    mended = kept(narx(), [dwells(1, creep=BIAS), dwells(2, creep=BIAS)])
    assert "rest" not in mended.provenance and still(mended, 0.0) > 0.9 * 60 * BIAS


def test_rest_that_the_noise_hides_is_not_claimed():
    found = rests([dwells(1, noise=3e-2)], [CURRENT], [POSITION])
    assert len(found.levels) == 0


def test_a_rod_that_has_not_stopped_yet_runs_out():
    """After a stroke the lag of 0.3 s carries the rod on; what is held is less than a twentieth of that way."""
    time = np.arange(0, 6, PERIOD)
    record = Record(time, {"current": np.where(time < 2, 1.0, 0.0), "position": 0 * time + 0.3}, UNITS, "stroke")
    lag = np.exp(-PERIOD / 0.3)
    runs = [simulate(b, record)["position"] for b in (narx(lag=lag), kept(narx(lag=lag), [dwells(1), dwells(2)]))]
    at = round(2 / PERIOD)
    beyond = [run[-1] - run[at] for run in runs]
    assert beyond[0] - 4 * BIAS == pytest.approx(0.3 * GAIN, rel=0.05)
    assert beyond[1] == pytest.approx(0.3 * GAIN, rel=0.05) and np.ptp(runs[1][-50:]) == 0.0


def test_a_block_that_drifts_like_a_motion_is_not_held_but_said():
    fast = narx()
    arrays = fast.arrays | {"output_bias": np.full(1, 0.5 * GAIN * PERIOD)}
    fast = assemble(NETWORK, arrays, fast.structure, name="bad", inputs=fast.inputs, outputs=fast.outputs,
                    states=fast.states, parameters=(), period=PERIOD, domain=fast.domain)  # fmt: skip
    mended = kept(fast, [dwells(1)])
    assert mended.provenance["rest"]["held"] == [] and LEVELS not in mended.arrays


def test_a_wrong_gain_is_taken_out_as_a_curve_and_kept_where_it_helps():
    records = [dwells(1), dwells(2), dwells(3)]
    off, right = narx(gain=0.8 * GAIN), narx(bias=0.0)
    mended = kept(off, records, curve=True)
    errors = [np.ptp(simulate(b, dwells(7))["position"] - dwells(7)["position"]) for b in (off, mended)]
    assert errors[1] < 0.1 * errors[0]
    assert kept(right, records, curve=True).provenance.keys() == {"rest"}  # nothing is left to take out
    assert still(mended, 0.0) == 0.0


def test_what_keeps_it_steady_comes_back_from_the_file_and_runs_in_the_fmu(tmp_path):
    mended = kept(narx(gain=0.8 * GAIN), [dwells(1), dwells(2)], curve=True)
    again, record = read_block(write_block(mended, tmp_path / "steady.toml")[0]), dwells(5, seconds=10.0)
    expected = simulate(mended, record)["position"]
    assert np.array_equal(simulate(again, record)["position"], expected)
    found = read_fmu(export_fmu(mended, tmp_path / "steady.fmu")).free_run(record)["position"]
    assert np.abs(found - expected).max() < 1e-9


def test_arrays_of_rest_that_do_not_fit_are_refused(tmp_path):
    mended = kept(narx(), [dwells(1)])
    frame = {k: getattr(mended, k) for k in ("name", "inputs", "outputs", "states", "parameters", "period")}
    for wrong in (np.ones(2), np.full(1, np.nan)):
        with pytest.raises(DataError, match=rf"array '{INCREMENT}'"):
            assemble(NETWORK, mended.arrays | {INCREMENT: wrong}, mended.structure, **frame)


def test_the_reported_rate_rests_with_the_output():
    rng, structure = np.random.default_rng(0), {"lags": 2, "hidden": 2}
    arrays = {k: 0.01 * rng.normal(size=s) for k, s in array_shapes(structure, 1, 2).items()}
    arrays |= {"input_scale": np.ones(1), "rate_scale": np.full(1, 0.01), "period": np.array([PERIOD])}
    block = assemble(RATE_NETWORK, arrays, structure, name="rate", **rate_frame((CURRENT,), POSITION, 2),
                     period=PERIOD, domain=TrainingDomain(("current", "position"), (-1, -0.5), (1, 1.0)))  # fmt: skip
    time = np.arange(0, 1, PERIOD)
    held = Record(time, {"current": 0 * time, "position": 0 * time + 0.3}, UNITS, "held")
    assert np.abs(simulate(block, held)["position.slope"]).min() > 0
    assert np.abs(simulate(kept(block, [dwells(1)]), held)["position.slope"]).max() == 0
