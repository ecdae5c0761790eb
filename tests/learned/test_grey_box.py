"""The latent-spool grey box: what is hidden between command and position is found from both alone."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import domain_share, read_block, write_block
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.grey_box.block import CONSTANTS, GREY_BOX, Dynamics, grey_box_states
from hydrotwin.learned.grey_box.data import Run, Whitening, best_ratio, block_period, coarser, run_of
from hydrotwin.learned.grey_box.fit import bent_knots, follow, monotone, opening, responses, shares
from hydrotwin.learned.grey_box.learn import learn_grey_box
from hydrotwin.learned.piecewise.learn import learn_piecewise
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests import rig
from tests.learned.hidden_valve import DEAD_TIME, PLAY, SPOOL_DELAY, ramps_record, steps_record, valve_record

CURRENT, POSITION = Signal("current", "1"), Signal("position", "m")
BRIEF = {"period": 0.05, "knots": 7, "starts": 1, "effort": 0.2}


@pytest.fixture(scope="module")
def training():
    return steps_record()


@pytest.fixture(scope="module")
def learned(training):
    return learn_grey_box([training], ["current"], ["position"], starts=2, knots=21, effort=0.6)


@pytest.fixture(scope="module")
def short():
    return steps_record(1, duration=40.0)


def written_block(dead_time=0.035, play=0.1, lag=0.02, period=0.01, integrating=1, play_first=1):
    """A block whose constants are written down: rates -1, 0, 0, 2 at -1, -0.1, 0.1, 1."""
    dynamics = Dynamics(dead_time, 60.0, 0.8, play, lag)
    structure = {"knots": 4, "delay": dynamics.late(period)[0] + 1, "integrating": integrating}
    structure["play_first"] = play_first
    constants = {name: getattr(dynamics, name) for name in CONSTANTS[:-1]} | {"period": period}
    knots, rates = [-1.0, -0.1, 0.1, 1.0], [-1.0, 0.0, 0.0, 2.0]
    return assemble(
        GREY_BOX, {k: [v] for k, v in constants.items()} | {"knots": knots, "rates": rates}, structure,
        name="written", inputs=(CURRENT,), outputs=(POSITION,), parameters=(), period=period,
        states=grey_box_states(structure, CURRENT, POSITION),
    )  # fmt: skip


def driven(command, period=0.01):
    time = period * np.arange(len(command))
    return Record(time, {"current": command, "position": np.zeros(len(time))}, {"current": "1", "position": "m"})


def rate(block, record):
    """Rate of the free run at the block's own samples: times of the middles, rates."""
    run = simulate(block, record.resample(block.period, hold=["current"]))
    return (run.time[1:] + run.time[:-1]) / 2, np.diff(run["position"]) / np.diff(run.time)


def rate_error(block, record):
    time, found = rate(block, record)
    return np.sqrt(np.mean((found - np.interp(time, record.time, record["velocity"])) ** 2))


def test_a_held_command_settles_at_the_rate_of_the_map_and_nothing_moves_before_the_dead_time():
    command = np.where(np.arange(300) < 10, 0.0, 0.55)
    position = simulate(written_block(play=0.0), driven(command))["position"]
    assert np.abs(position[: 10 + 4]).max() < 1e-15 and position[25] > 1e-3
    assert (position[-1] - position[-2]) / 0.01 == pytest.approx(2.0 * (0.55 - 0.1) / 0.9, rel=1e-6)


def test_beyond_its_last_knot_the_map_stays_at_its_end():
    position = simulate(written_block(), driven(np.full(400, -50.0)))["position"]
    assert (position[-1] - position[-2]) / 0.01 == pytest.approx(-1.0, rel=1e-9)


def test_the_total_delay_of_a_step_is_dead_time_spool_and_lag():
    command = np.where(np.arange(400) < 10, 0.1, 0.9)
    for period, tolerance in ((0.01, 2e-3), (0.002, 2e-4)):
        run = simulate(written_block(play=0.0, period=period), driven(np.repeat(command, round(0.01 / period)), period))
        late = run.time[-1] - 0.1 - run["position"][-1] / (2.0 * 0.8 / 0.9)
        assert late == pytest.approx(0.035 + 2 * 0.8 / 60 + 0.02, abs=tolerance)


@pytest.mark.parametrize("play_first", [0, 1])
def test_the_play_makes_the_rate_of_a_falling_command_higher_than_that_of_a_rising_one(play_first):
    slow = np.concatenate([np.linspace(0, 0.9, 2000), np.linspace(0.9, 0, 2000)])
    v = np.diff(simulate(written_block(dead_time=0.0, lag=0.0, play_first=play_first), driven(slow))["position"]) / 0.01
    up, down = v[:2000][np.searchsorted(slow[:2000], 0.5)], v[2000:][np.searchsorted(-slow[2000:], -0.5)]
    assert down - up == pytest.approx(2.0 / 0.9 * 0.1, rel=0.02)


@pytest.mark.parametrize("play_first", [0, 1])
@pytest.mark.parametrize("integrating", [0, 1])
@pytest.mark.parametrize(("dead_time", "play", "lag"), [(0.035, 0.1, 0.02), (0.0, 0.0, 0.0), (0.05, 0.3, 0.001)])
def test_the_block_is_what_the_fit_runs(play_first, integrating, dead_time, play, lag):
    command = np.repeat(np.random.default_rng(3).uniform(-1.2, 1.2, 40), 12)
    record = driven(command)
    run = run_of(record, 0.01, CURRENT, POSITION)
    dynamics = Dynamics(dead_time, 60.0, 0.8, play, lag, bool(play_first))
    block = written_block(dead_time, play, lag, integrating=integrating, play_first=play_first)
    knots, rates = block.arrays["knots"], block.arrays["rates"]
    fitted = responses(opening(run, dynamics, 0.01), knots, lag, 0.01, bool(integrating)) @ rates
    found = simulate(block, record.with_signals({"position": np.full(len(command), fitted[0])}))["position"]
    assert np.ptp(fitted) > 0.1 and np.abs(found - fitted).max() < 1e-12


def test_from_a_dense_even_recording_play_and_dead_time_come_out_as_they_are():
    time = np.arange(6001) / 200
    command = rig.commands.steps(time, 1.0, 3, hold=(0.2, 1.0), speed=(0.104, 0.099), room=(-0.2, 0.2))
    record = valve_record(command, time, step=0.0, noise=1e-4)
    assert coarser([record], 0.0005) == 0.0005 and coarser([record], 0.005) == 0.005
    assert coarser([record] * 4, 0.005) == pytest.approx(0.01)
    block = learn_grey_box([record], ["current"], ["position"], period=0.005, starts=2, knots=15, effort=0.6)
    found = {name: value for name, (value, *_) in block.provenance["identified"].items()}
    assert found["play"] == pytest.approx(PLAY, abs=0.006)
    assert found["dead_time"] == pytest.approx(DEAD_TIME, abs=0.01)


def test_an_output_that_does_not_integrate_is_the_map_itself_after_the_lag():
    run = simulate(written_block(integrating=0), driven(np.full(300, 0.55)))
    assert run["position"][-1] == pytest.approx(2.0 * 0.45 / 0.9, rel=1e-9)


def test_the_hidden_dead_time_and_play_are_found_from_quantised_uneven_positions(learned):
    found = {name: value for name, (value, *_) in learned.provenance["identified"].items()}
    delay = found["dead_time"] + 2 * found["damping"] / found["natural_frequency"] + found["lag"]
    assert delay == pytest.approx(DEAD_TIME + SPOOL_DELAY, abs=0.012)
    assert found["dead_time"] == pytest.approx(DEAD_TIME, abs=0.02)
    assert found["play"] == pytest.approx(PLAY, abs=0.01)
    for value, low, high in learned.provenance["identified"].values():
        assert low <= value <= high


def test_the_map_is_monotone_and_flat_in_the_overlap(learned):
    knots, rates = learned.arrays["knots"], learned.arrays["rates"]
    assert np.all(np.diff(rates) >= 0)
    assert np.abs(np.interp([-0.02, 0.0, 0.02], knots, rates)).max() < 0.015 * np.ptp(rates)


def test_on_ramps_up_and_down_its_rate_is_at_least_twice_as_good_as_the_static_characteristics(learned, training):
    ramps = ramps_record()
    static = learn_piecewise([training], ["current"], ["position"])
    assert rate_error(learned, ramps) < 0.5 * rate_error(static, ramps)
    time, v = rate(learned, ramps)
    command = np.interp(time, ramps.time, ramps["current"])
    rising = np.gradient(command, time) > 0
    apart = [np.mean(side[~rising & near]) - np.mean(side[rising & near]) for side in (
        v, np.interp(time, ramps.time, ramps["velocity"])) for near in [np.abs(command - 0.25) < 0.03]]  # fmt: skip
    assert apart[0] == pytest.approx(apart[1], rel=0.25) and apart[1] > 0.003


def test_the_free_run_over_unseen_steps_stays_within_a_centimetre(learned):
    unseen = steps_record(3, duration=60.0)
    drift = simulate(learned, unseen)["position"] - unseen["position"]
    assert np.sqrt(np.mean(drift**2)) < 0.01 and np.std(unseen["position"]) > 0.05


def test_the_block_is_the_fit_and_knows_its_training_range(learned, training):
    assert learned.certificate.holds and learned.certificate.points > 1000
    assert domain_share(learned, training).inside == 1.0
    assert learned.provenance["trained_on"][0]["sha256"] == training.digest


def test_it_comes_back_from_its_file_where_no_training_library_is(learned, training, tmp_path):
    path, _ = write_block(learned, tmp_path / "valve.toml")
    program = f"""
        import sys
        for heavy in ("torch", "gpytorch", "pyoperon"):
            sys.modules[heavy] = None
        import numpy as np
        import hydrotwin.learned.grey_box.block
        from hydrotwin.learned import read_block
        block = read_block({str(path)!r})
        x = block.start(0.0, 0.2, [])
        for k in range(60):
            x, y = block.step(x, np.sin(0.2 * k), [])
        print(repr(float(y)))
    """
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True)
    x = learned.start(0.0, 0.2, [])
    for k in range(60):
        x, y = learned.step(x, np.sin(0.2 * k), [])
    assert float(run.stdout) == float(y) != 0.2
    again = read_block(path)
    assert again.states == learned.states and again.provenance == learned.provenance


def test_its_fmu_runs_to_the_same_numbers(learned, tmp_path):
    record = steps_record(4, duration=10.0).resample(learned.period, hold=["current"])
    found = read_fmu(export_fmu(learned, tmp_path / "valve.fmu")).free_run(record)["position"]
    expected = simulate(learned, record)["position"]
    assert np.abs(found - expected).max() < 1e-9 * np.ptp(expected)


def test_a_machine_that_moves_the_other_way_gets_a_falling_map(short):
    turned = short.with_signals({"position": -short["position"]})
    one, other = (learn_grey_box([r], ["current"], ["position"], **BRIEF) for r in (short, turned))
    assert other.arrays["rates"] == pytest.approx(-one.arrays["rates"], abs=1e-12)
    assert np.ptp(one.arrays["rates"]) > 0.05 and other.certificate.holds


def test_a_recorded_speed_is_learnt_as_an_output_that_does_not_integrate(short):
    block = learn_grey_box([short], ["current"], ["velocity"], integrating=False, **BRIEF | {"period": 0.02})
    miss = simulate(block, short)["velocity"] - short["velocity"]
    assert np.std(miss) < 0.25 * np.std(short["velocity"]) and block.certificate.holds


def test_the_same_data_give_the_same_block_and_other_recordings_may_choose_among_the_starts(short):
    one, two = (learn_grey_box([short], ["current"], ["position"], **BRIEF) for _ in range(2))
    assert all(np.array_equal(one.arrays[k], two.arrays[k]) for k in one.arrays)
    block = learn_grey_box([short], ["current"], ["position"], select=[steps_record(2, 20.0)], **BRIEF)
    assert block.provenance["selected_on"][0]["name"] == "steps_2"


def test_interrupting_keeps_the_best_so_far(short):
    seen = []

    def interrupt(step):
        seen.append(step)
        if len(seen) == 12:
            raise KeyboardInterrupt

    block = learn_grey_box([short], ["current"], ["position"], progress=interrupt, **BRIEF)
    assert block.provenance["stopped"] == "interrupted" and block.provenance["evaluations"] == 12
    assert seen[-1].best <= min(s.loss for s in seen[1:]) and block.certificate.holds


def test_a_fit_interrupted_at_its_first_evaluation_still_answers(short):
    def at_once(step):
        raise KeyboardInterrupt

    block = learn_grey_box([short], ["current"], ["position"], progress=at_once, **BRIEF)
    assert block.provenance["evaluations"] == 1 and block.certificate.holds


def test_the_weight_between_sensor_noise_and_walk_is_found():
    rng, time = np.random.default_rng(0), np.cumsum(0.1 + 0.05 * np.random.default_rng(1).uniform(size=4000))
    for ratio in (1e-3, 1.0, 30.0):
        walk = np.cumsum(np.sqrt(ratio * np.diff(time, prepend=0) / 0.125) * rng.normal(size=4000))
        run = Run(time, time, walk + rng.normal(size=4000), None, None)
        assert 0.2 * ratio < best_ratio([run], [np.diff(run.output)]) < 5 * ratio
        white = Whitening(time, ratio)(np.diff(run.output))
        assert np.corrcoef(white[1:], white[:-1])[0, 1] == pytest.approx(0.0, abs=0.06)
        assert np.var(white) == pytest.approx(1.0, rel=0.1)


def test_the_monotone_map_is_least_squares_where_that_is_monotone_and_never_falls_where_it_is_not():
    rng, knots = np.random.default_rng(2), np.linspace(-1, 1, 9)
    q = rng.uniform(-1, 1, 500)
    rows, rising = shares(q, knots).T, np.cumsum(rng.uniform(size=9))
    assert monotone(rows, rows @ rising, knots)[0] == pytest.approx(rising, rel=1e-3)
    humped = monotone(rows, rows @ np.sin(3 * knots) + 0.1 * rng.normal(size=500), knots)[0]
    assert np.all(np.diff(humped) >= 0) and np.ptp(humped) > 1.0


def test_knots_gather_where_the_map_bends():
    knots = np.linspace(-1, 1, 21)
    bent = bent_knots(knots, np.maximum(knots - 0.3, 0))
    assert len(bent) == 21 and bent[0] == -1 and bent[-1] == 1
    assert np.sum(np.abs(bent - 0.3) < 0.15) >= 2 * np.sum(np.abs(knots - 0.3) < 0.15)


def test_play_follows_only_when_pushed():
    q = follow(np.array([0.0, 0.4, 0.6, 2.0, 1.5, 1.0, 0.5]), 1.0)
    assert q == pytest.approx([0.0, 0.0, 0.1, 1.5, 1.5, 1.5, 1.0], abs=1e-15)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"outputs": ["positon"]}, "Did you mean 'position'"),
        ({"outputs": ["current"]}, "named both as input and output"),
        ({"inputs": ["current", "velocity"]}, "one input is needed"),
        ({"outputs": "position"}, "learn: outputs must be a list"),
        ({"records": []}, "no recordings"),
        ({"period": 3.0}, "too few samples to train on"),
        ({"records": "still"}, "learn: 'current' never changes"),
        ({"records": "holes"}, "values that are not numbers"),
        ({"records": "gap"}, "no samples from"),
        ({"records": "few"}, "too few samples"),
    ],
)
def test_what_cannot_be_learnt_from_is_refused_in_a_sentence(short, change, sentence):
    made = {
        "still": lambda: short.with_signals({"current": np.zeros(len(short))}),
        "holes": lambda: short.with_signals({"position": np.where(short.time > 5, np.nan, short["position"])}),
        "gap": lambda: Record(np.where(short.time > 5, short.time + 9, short.time), short.signals, short.units),
        "few": lambda: short.window(0.0, 3.0),
    }
    asked = {"records": [short], "inputs": ["current"], "outputs": ["position"], **BRIEF} | change
    if isinstance(asked["records"], str):
        asked["records"] = [made[asked["records"]]()]
        asked.pop("period")
    with pytest.raises(DataError, match=sentence):
        learn_grey_box(asked.pop("records"), asked.pop("inputs"), asked.pop("outputs"), **asked)


@pytest.mark.parametrize("option", [{"knots": 3}, {"starts": 0}, {"effort": 0}, {"period": -0.01}, {"knots": 7.5}])
def test_impossible_options_are_refused(short, option):
    with pytest.raises(DeclarationError, match=next(iter(option))):
        learn_grey_box([short], ["current"], ["position"], **BRIEF | option)


def test_a_part_of_a_recordings_period_is_not_rounded():
    """A third of 10 ms with nine digits is a sample off after a few hundred, and an FMU another one than a run."""
    time = 0.01 * np.arange(600)
    u = np.sign(np.sin(3 * time) + 0.3 * np.sin(17 * time))
    y = np.convolve(u, 0.05 * 0.95 ** np.arange(200))[: len(u)]
    period = block_period("learn", [Record(time, {"u": u, "y": y}, {"u": "1", "y": "m"})], None)
    parts = 0.01 / period
    assert round(parts) == 3 and abs(parts - 3) < 1e-12
