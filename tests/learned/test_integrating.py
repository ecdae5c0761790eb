"""Whether an output integrates is found from recordings, whatever its unit; every kind learns it in the right form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hydrotwin.learned import characteristic, learn_gaussian_process, learn_grey_box, learn_piecewise
from hydrotwin.learned.integrating import integration
from hydrotwin.learned.training_data import as_signals
from hydrotwin.models.language.errors import DataError
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

PERIOD = 0.02


def steps(seed: int, seconds: float = 24.0) -> np.ndarray:
    """Levels between -1 and 1, each held for 0.3 to 1.2 s."""
    rng, n = np.random.default_rng(seed), round(seconds / PERIOD)
    return np.repeat(rng.uniform(-1, 1, n), rng.integers(15, 60, n))[:n]


def integral(rate: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(rate[:-1])]) * PERIOD


def settled(u: np.ndarray, seconds: float) -> np.ndarray:
    """First-order lag of that time constant, exact for a held input."""
    a = np.exp(-PERIOD / seconds)
    return lfilter([0.0, 1 - a], [1.0, -a], u)


def late(u: np.ndarray, samples: int) -> np.ndarray:
    return np.concatenate([np.full(samples, u[0]), u[: len(u) - samples]])


def recording(answer, seed: int = 0, unit: str = "m", noise: float = 1e-3, uneven: bool = False) -> Record:
    """The answer to steps, with noise of a share of its range."""
    u = steps(seed)
    y = answer(u)
    rng = np.random.default_rng(100 + seed)
    record = Record(
        PERIOD * np.arange(len(u)), {"u": u, "y": y + noise * np.ptp(y) * rng.normal(size=len(u))},
        {"u": "V", "y": unit}, f"run_{seed}",
    )  # fmt: skip
    kept = np.sort(rng.permutation(len(u))[: 3 * len(u) // 4]) if uneven else None
    if kept is None:
        return record
    return Record(record.time[kept], {n: v[kept] for n, v in record.signals.items()}, record.units, record.name)


INTEGRATING = {
    "a rod in metres": (lambda u: integral(0.1 * np.tanh(2 * u)), {}),
    "a pressure that a flow builds up": (lambda u: 1e7 + 1e6 * integral(u), {"unit": "Pa"}),
    "a counter without a unit that falls": (lambda u: -3 * integral(u), {"unit": "1"}),
    "one that creeps when nothing is asked": (lambda u: integral(u + 0.3), {}),
    "behind a dead time and a lag": (lambda u: integral(settled(late(u, 4), 0.1)), {"unit": "rad"}),
    "behind a deadband": (lambda u: integral(np.sign(u) * np.maximum(np.abs(u) - 0.3, 0)), {}),
    "at uneven times": (lambda u: integral(u), {"uneven": True}),
    "with noise of a twentieth of its range": (lambda u: integral(u), {"noise": 0.05}),
}
SETTLING = {
    "a speed": (lambda u: settled(u, 0.1), {"unit": "m/s"}),
    "a deflection in metres": (lambda u: 0.05 * np.tanh(2 * settled(u, 0.05)), {"unit": "m"}),
    "an angle against a spring, slowly": (lambda u: settled(u, 0.4), {"unit": "rad"}),
    "at once": (lambda u: u**3, {"unit": "m"}),
    "after a dead time": (lambda u: late(u, 5) + 2.0, {"unit": "m"}),
    "at uneven times": (lambda u: settled(u, 0.1), {"uneven": True}),
    "with noise of a twentieth of its range": (lambda u: settled(u, 0.1), {"noise": 0.05}),
}


def found(records: list[Record], outputs=("y",)):
    inputs, outputs = (as_signals(part, records[0], "signals") for part in (["u"], list(outputs)))
    return integration(records, inputs, outputs)


@pytest.mark.parametrize("seeds", [(1,), (1, 2), (5,)], ids=str)
@pytest.mark.parametrize("case", INTEGRATING)
def test_an_output_that_keeps_moving_at_a_held_command_integrates(case, seeds):
    answer, how = INTEGRATING[case]
    (one,) = found([recording(answer, seed, **how) for seed in seeds])
    assert one.found and one.level > 2 * one.rate


@pytest.mark.parametrize("seeds", [(1,), (1, 2), (5,)], ids=str)
@pytest.mark.parametrize("case", SETTLING)
def test_an_output_that_settles_at_a_held_command_does_not(case, seeds):
    answer, how = SETTLING[case]
    (one,) = found([recording(answer, seed, **how) for seed in seeds])
    assert not one.found


def test_with_two_inputs_it_is_found_for_every_output_apart():
    one, other = steps(1), steps(2)
    rng, n = np.random.default_rng(0), min(len(steps(1)), len(steps(2)))
    rod, speed = integral(one[:n] - 0.2 * other[:n]), settled(other[:n], 0.1)
    signals = {"u": one[:n], "v": other[:n], "rod": rod, "speed": speed}
    signals |= {k: signals[k] + 1e-3 * rng.normal(size=n) for k in ("rod", "speed")}
    record = Record(PERIOD * np.arange(n), signals, {"u": "V", "v": "V", "rod": "m", "speed": "m"}, "two")
    inputs, outputs = (as_signals(part, record, "signals") for part in (["u", "v"], ["rod", "speed"]))
    assert [i.found for i in integration([record], inputs, outputs)] == [True, False]


def rmse(block, record: Record) -> float:
    """Of the free run, over the range."""
    return float(np.sqrt(np.mean((simulate(block, record)["y"] - record["y"]) ** 2)) / np.ptp(record["y"]))


SMALL = {
    "gp": (learn_gaussian_process, {"points": 100, "samples": 400, "compress": 30}, "gpytorch"),
    "piecewise": (learn_piecewise, {"starts": 1}, None),
    "grey_box": (learn_grey_box, {"starts": 1, "effort": 0.3, "knots": 9}, None),
}


@pytest.mark.parametrize("kind", SMALL)
@pytest.mark.parametrize("integrates", [True, False])
def test_a_kind_of_two_forms_learns_the_one_that_runs(kind, integrates):
    learn, options, needs = SMALL[kind]
    if needs:
        pytest.importorskip(needs)
    answer = (INTEGRATING if integrates else SETTLING)["a rod in metres" if integrates else "a deflection in metres"][0]
    block = learn([recording(answer, 1)], ["u"], ["y"], **options)
    assert rmse(block, recording(answer, 3)) < 0.08
    asked = "rate" if kind == "gp" else "integrating"
    assert block.provenance[asked] is integrates
    told = block.provenance["integration"]["y"]
    assert told["integrates"] is integrates and (told["rate_form"] < told["level_form"]) is integrates
    other = learn([recording(answer, 1)], ["u"], ["y"], **options, **{asked: not integrates})
    assert other.provenance[asked] is not integrates and rmse(other, recording(answer, 3)) > 0.1


def test_outputs_of_both_forms_in_one_process_are_told_apart_by_name():
    pytest.importorskip("gpytorch")
    one = recording(INTEGRATING["a rod in metres"][0], 1)
    both = one.with_signals({"speed": settled(one["u"], 0.1)}, {"speed": "m/s"})
    with pytest.raises(DataError, match=r"y integrates its inputs, speed does not.*one block for each"):
        learn_gaussian_process([both], ["u"], ["y", "speed"])


def test_a_characteristic_takes_the_level_of_a_deflection_that_is_in_metres():
    """Held levels of a spring-loaded spool in metres: its unit alone would ask for a rate, which is none."""
    time = PERIOD * np.arange(3000)
    u = np.repeat(np.linspace(-1, 1, 30), 100)
    record = Record(time, {"u": u, "y": 0.05 * settled(u, 0.05)}, {"u": "V", "y": "m"}, "staircase")
    curve = characteristic(record, "u", "y")
    assert curve.rate.name == "wanted_y" and np.allclose(curve.rates, 0.05 * curve.commands, atol=1e-4)
