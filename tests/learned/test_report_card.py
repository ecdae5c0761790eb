"""What `learn` says of a block: its free run on what was held out, beside what costs nothing, the bad news first."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.learned import learning, read_block, write_block
from hydrotwin.learned.held_out import Part, split, through
from hydrotwin.learned.report_card import Row, Words, carded, yardsticks
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.report.learned import learned_sections, write_learned
from hydrotwin.simulation import predict_one_step
from tests.learned.test_integrating import PERIOD, integral, recording, settled, steps

SMALL = {"points": 100, "samples": 400, "compress": 30}
HOLD, MEAN, CURVE = "holding the last sample", "the mean", "a piecewise linear curve"


def rod(seed: int = 1) -> Record:
    return recording(lambda u: integral(0.1 * np.tanh(2 * u)), seed)


def card(block) -> dict:
    return block.provenance["free_run"]


@pytest.fixture(scope="module")
def piecewise():
    return ht.learn("piecewise", [rod(1), rod(2)], ["u"], ["y"], starts=1)


def test_the_card_is_the_free_run_over_what_took_no_part(piecewise):
    parts, whole = split([rod(1), rod(2)], ["u"], ["y"]), [rod(1), rod(2)]
    late = [r.time >= p.begin for r, p in zip(whole, parts.parts, strict=True)]
    miss = [(ht.simulate(piecewise, r)["y"] - r["y"])[k] for r, k in zip(whole, late, strict=True)]
    miss = np.concatenate(miss)
    still = np.concatenate([r["y"][k] - r["y"][k][0] for r, k in zip(whole, late, strict=True)])
    told = card(piecewise)["outputs"]["y"]
    assert told["rmse"] == pytest.approx(np.sqrt(np.mean(miss**2)), rel=1e-12)
    assert told["yardsticks"][HOLD] == pytest.approx(np.sqrt(np.mean(still**2)), rel=1e-12)
    assert told["no_better_than"] == [] and not card(piecewise)["bad"]
    assert [p["samples"] for p in card(piecewise)["held_out"]] == [len(r) for r in parts.held_out]
    trained = [t["samples"] for t in piecewise.provenance["trained_on"]]
    assert trained == [len(r) for r in parts.fit] and max(trained) < 0.9 * len(rod())
    assert f"RMS error of y {1e3 * told['rmse']:.3g} mm" in card(piecewise)["says"]


def test_the_page_shows_the_run_of_the_card(piecewise, tmp_path):
    files = write_learned(piecewise, [rod(1), rod(2)], ["u"], ["y"], tmp_path)
    rows = json.loads(files["json"].read_text(encoding="utf-8"))["scores"]
    told = card(piecewise)["outputs"]["y"]
    for model, error in (("piecewise", told["rmse"]), ("hold last sample", told["yardsticks"][HOLD])):
        own = [r["rmse"] for r in rows if r["model"] == model and r["mode"] == "free run"]
        assert len(own) == 2 and np.sqrt(np.mean(np.square(own))) == pytest.approx(error, rel=1e-9)


def test_the_card_is_in_the_file(piecewise, tmp_path):
    again = read_block(write_block(piecewise, tmp_path / "block.toml")[0])
    assert card(again) == card(piecewise)


def test_what_is_held_out_changes_no_trained_number():
    """The end of the recording is replaced: the same block, another card."""
    record = rod()
    early = np.arange(len(record)) < 0.92 * len(record)
    bent = record.with_signals({"y": np.where(early, record["y"], np.median(record["y"]))})
    blocks = [ht.learn("piecewise", [r], ["u"], ["y"], starts=1) for r in (record, bent)]
    assert all(np.array_equal(blocks[0].arrays[k], blocks[1].arrays[k]) for k in blocks[0].arrays)
    assert card(blocks[0])["outputs"] != card(blocks[1])["outputs"]


def test_recordings_to_validate_with_have_no_part_in_the_card(piecewise):
    other = ht.learn("piecewise", [rod(1), rod(2)], ["u"], ["y"], starts=1, validate=[rod(9)])
    assert card(other) == card(piecewise)


def test_a_level_learnt_of_what_integrates_is_told_first():
    pytest.importorskip("gpytorch")
    block = ht.learn("gp", [rod()], ["u"], ["y"], rate=False, **SMALL)
    assert {HOLD, CURVE} & set(card(block)["no_better_than"]) and card(block)["bad"]
    assert card(block)["says"].startswith("Of y the block is no better than ")
    assert "its level is learned, as asked for" in card(block)["says"]


def test_its_rate_is_learnt_by_default_and_said():
    pytest.importorskip("gpytorch")
    says = card(ht.learn("gp", [rod()], ["u"], ["y"], **SMALL))["says"]
    assert "y integrates its inputs" in says and "its rate is learned." in says


@pytest.mark.parametrize(
    "output",
    [
        lambda u, rng: rng.normal(size=len(u)),
        lambda u, rng: np.cumsum(rng.normal(size=len(u))),
        lambda u, rng: np.sin(3.1 * PERIOD * np.arange(len(u))),
    ],
    ids=["noise", "a random walk", "a motion of its own"],
)
def test_an_output_that_the_input_does_not_move_is_said_to_be_learnt_no_better(output):
    u = steps(1)
    y = output(u, np.random.default_rng(3))
    record = Record(PERIOD * np.arange(len(u)), {"u": u, "y": y}, {"u": "V", "y": "1"}, "deaf")
    told = card(ht.learn("piecewise", [record], ["u"], ["y"], starts=1))
    assert {HOLD, MEAN} & set(told["no_better_than"])
    assert told["says"].startswith("Of y the block is no better than ") and "Record more" in told["says"]


def test_a_free_run_that_diverges_is_said_with_where_it_went():
    """Trained on slow strokes between two stops, run where nothing stops it: the end of the recording holds one way."""
    n = 2000
    u = np.where(np.arange(n) < 1600, np.sign(np.sin(2 * np.pi * np.arange(n) / 80)), 1.0)
    y = integral(0.5 * u)
    y[1600:] = y[1600] + 0.02 * np.sin(np.arange(n - 1600) / 60)
    record = Record(PERIOD * np.arange(n), {"u": u, "y": y}, {"u": "V", "y": "m"}, "stops")
    told = card(ht.learn("piecewise", [record], ["u"], ["y"], starts=1, integrating=True))
    assert "diverges in free run: it reaches" in told["says"].split(".")[0] and told["bad"]
    assert told["outputs"]["y"]["diverged"]


def test_too_little_to_hold_anything_out_is_learnt_from_whole_and_said():
    record = rod().window(0, 2.2)  # 111 samples: with nine tenths of them nothing is learnt
    told = card(ht.learn("piecewise", [record], ["u"], ["y"], starts=1))
    assert told["bad"] and told["says"].startswith("Nothing was held out: ") and "too few samples" in told["says"]
    with pytest.raises(DataError, match=r"too few samples to train on \(got 51\)"):
        ht.learn("piecewise", [rod().window(0, 1.0)], ["u"], ["y"])


def test_the_end_of_every_recording_is_held_out():
    parts = split([rod(1), rod(2)], ["u"], ["y"])
    assert [len(r) for r in parts.fit] == [961, 961] and [len(r) for r in parts.held_out] == [240, 240]
    assert [p.begin for p in parts.parts] == [r.time[-1] for r in parts.fit]


def test_a_run_over_a_part_is_one_that_began_with_the_recording():
    record, calls = rod(), []

    def summed(whole: Record) -> Record:
        calls.append(len(whole))
        return whole.with_signals({"y": np.cumsum(whole["u"])})

    parts = [Part(record, 4.0, 6.0), *split([record], ["u"], ["y"]).parts]
    found = through(summed, parts)
    assert calls == [len(record)]
    for run, part in zip(found, parts, strict=True):
        inside = (record.time >= part.begin) & (record.time <= part.end)
        assert np.array_equal(run["y"], np.cumsum(record["u"])[inside])


def test_an_end_at_rest_is_no_test_and_more_is_held_out():
    record = rod()
    y = np.where(np.arange(len(record)) > 0.76 * len(record), record["y"][len(record) * 3 // 4], record["y"])
    parts = split([record.with_signals({"y": y})], ["u"], ["y"])
    assert np.ptp(parts.held_out[0]["y"]) > 0.1 * np.ptp(y)


def test_of_many_recordings_whole_ones_are_held_out():
    parts = split([rod(k) for k in range(16)], ["u"], ["y"])
    assert [r.name for r in parts.held_out] == ["run_13", "run_14", "run_15"] and len(parts.fit) == 13
    assert len(split([rod(k) for k in range(6)], ["u"], ["y"]).parts) == 6, "of a few the end of each"


def test_a_kind_of_rates_only_says_first_that_an_output_does_not_integrate():
    pytest.importorskip("torch")
    record = recording(lambda u: 0.05 * settled(u, 0.05), 1)
    told = card(ht.learn("nn", [record], ["u"], ["y"], fit="paper", iterations=20, starts=1))
    assert told["says"].startswith("y does not integrate its inputs, and this kind learns rates only: take gp")


def test_a_free_run_that_nobody_waits_for_costs_no_trained_block(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(learning, "judged", interrupted)
    block = ht.learn("piecewise", [rod()], ["u"], ["y"], starts=1)
    assert block.certificate.holds and "the free run was interrupted" in card(block)["says"]


def test_words_that_are_not_known_are_refused():
    with pytest.raises(DeclarationError, match=r"no kind 'pieces'.*'piecewise'"):
        ht.learn("pieces", [rod()], ["u"], ["y"])
    with pytest.raises(DeclarationError, match="a model goes with hybrid"):
        ht.learn("hybrid", [rod()])


def test_arx_is_a_yardstick_and_what_is_no_better_says_so_first():
    """A straight line in front of a lag that it does not have: linear least squares is exact, the curve is not."""
    record = recording(lambda u: 0.05 * settled(settled(u, 0.2), 0.2), 1)
    told = card(ht.learn("piecewise", [record], ["u"], ["y"], starts=1))
    yardsticks = told["outputs"]["y"]["yardsticks"]
    assert yardsticks["ARX"] < 0.1 * told["outputs"]["y"]["rmse"] and "ARX" in told["no_better_than"]
    assert told["says"].startswith("Of y the block is no better than ARX") and told["bad"]


def test_arx_is_fitted_without_what_is_held_out():
    record = rod()
    early = np.arange(len(record)) < 0.92 * len(record)
    bent = record.with_signals({"y": np.where(early, record["y"], np.median(record["y"]))})
    parts = [split([r], ["u"], ["y"]) for r in (record, bent)]
    runs = [yardsticks("", p, ["u"], ["y"])["ARX"](rod(3))["y"] for p in parts]
    assert np.array_equal(*runs)


def test_arx_is_fitted_to_what_moves_and_is_no_yardstick_of_itself():
    record = rod()
    still = record.with_signals({"still": np.ones(len(record))}, {"still": "1"})
    parts = split([still], ["u", "still"], ["y"])
    assert "ARX" in yardsticks("", parts, ["u", "still"], ["y"])
    assert set(card(ht.learn("arx", [rod(1)], ["u"], ["y"]))["outputs"]["y"]["yardsticks"]) == {HOLD, MEAN, CURVE}


def test_one_step_is_told_where_the_output_is_a_state(piecewise):
    told = card(piecewise)["outputs"]["y"]
    parts = split([rod(1), rod(2)], ["u"], ["y"]).parts
    miss = [(p.cut(predict_one_step(piecewise, p.whole))["y"] - p.seen["y"])[1:] for p in parts]
    assert told["one_step"]["rmse"] == pytest.approx(np.sqrt(np.mean(np.concatenate(miss) ** 2)), rel=1e-12)
    assert "one step ahead" in card(piecewise)["says"] and 0 <= told["left"]["one_step"]["white"] <= 1
    level = ht.learn("piecewise", [rod(1)], ["u"], ["y"], starts=1, integrating=False)
    assert "one_step" not in card(level)["outputs"]["y"] and "one step" not in card(level)["says"]


def test_an_input_that_is_still_in_what_is_left_is_said_with_its_lag():
    """The machine answers a second time half a second late; the model does not look back as far."""

    def twice(seed: int) -> Record:
        u = np.repeat(np.random.default_rng(seed).uniform(-1, 1, 600), 4)
        y = settled(u, 0.04) + settled(np.r_[np.full(25, u[0]), u[:-25]], 0.04)
        return Record(PERIOD * np.arange(len(u)), {"u": u, "y": y}, {"u": "V", "y": "m"}, f"twice_{seed}")

    told = card(ht.learn("arx", [twice(1), twice(2)], ["u"], ["y"], period=PERIOD, lags=(1, 4), delay=0))
    follows = told["outputs"]["y"]["left"]["free_run"]["follows"]["u"]
    assert 25 <= follows["samples"] <= 28 and follows["correlation"] > follows["bound"]
    assert f"What is left of y follows 'u' {follows['samples']} samples later" in told["says"]


def test_what_a_budget_cut_is_said_first():
    block = ht.learn("nn", [rod()], ["u"], ["y"], budget=0.05)
    assert card(block)["says"].startswith("Training was not done (time limit of 0.05 s after ")
    assert card(block)["bad"]


def test_the_page_shows_shorter_and_longer_formulas(piecewise):
    rows = [
        {"output": "y", "size": 3, "error": 0.002, "equation": "c*u"},
        {"output": "y", "size": 9, "error": 0.001, "equation": "c*u + tanh(u)", "chosen": True},
    ]
    sections = {s.id: s for s in learned_sections(replace(piecewise, provenance={"front": rows}))}
    figure, shown = sections["front"].parts
    assert figure.spec["data"][0]["mode"] == "lines+markers"
    cells = {c.key: [cell.text for cell in c.cells] for c in shown.columns}
    assert cells["size"] == ["3", "9"] and cells["equation"] == [r["equation"] for r in rows]
    assert cells["chosen"] == ["", "chosen"] and cells["error"][1].startswith("1")


def test_the_page_marks_figures_that_are_of_the_first_course_alone(piecewise):
    rows = [
        {"kind": "arx", "seconds": 1.0, "percent_of_range": {"y": 1.0}, "chosen": True, "as_good": True},
        {"kind": "gp", "seconds": 9.0, "percent_of_range": {"y": 5.0}, "dropped": "it could not be as good as arx"},
    ]
    sections = {s.id: s for s in learned_sections(replace(piecewise, provenance={"ranking": rows}))}
    (shown,) = sections["kinds"].parts
    cells = {c.key: [cell.text for cell in c.cells] for c in shown.columns}
    assert cells["choice"] == ["chosen", "first course only"] and "as good as arx" in cells["why"][1]


def test_the_page_shows_the_terms_of_a_polynomial(piecewise):
    told = {
        "terms": [{"term": "y[k]", "factor": -0.5, "err": 0.9}, {"term": "u[k] y[k]", "factor": 0.1, "err": None}],
        "selected": ["y[k]", "u[k]^2"], "err": [0.9, 0.05], "aic": [3.0, 1.0], "bic": [3.0, 2.0],
    }  # fmt: skip
    sections = {s.id: s for s in learned_sections(replace(piecewise, provenance={"narx": {"y": told}}))}
    (shown,) = sections["terms"].parts
    cells = {c.key: [cell.text for cell in c.cells] for c in shown.columns}
    assert cells["term"] == ["y[k]", "u[k]^2", "u[k] y[k]"] and cells["err"][:2] == ["0.900", "0.0500"]
    assert "0.5" in cells["factor"][0] and cells["factor"][1] == cells["err"][2], "nothing where it is not kept"
    assert "terms" not in {s.id for s in learned_sections(piecewise)}


@pytest.mark.parametrize(
    ("errors", "says"),
    [
        ([0.2, 0.1, 0.15], "Of 3 seeds the worst had 2 times the error of the best where they were chosen."),
        ([0.2, np.inf], "Of 2 seeds the worst diverged where they were chosen."),
        ([0.2], ""),
        ([], ""),
    ],
)
def test_the_spread_over_seeds_is_told(piecewise, errors, says):
    seeds = [{"seed": k, "held_out_error": error} for k, error in enumerate(errors)]
    block = replace(piecewise, provenance={**piecewise.provenance, "seeds": seeds})
    assert learning._of_seeds(block) == ([says] if says else [])


def test_a_state_network_tells_what_every_seed_of_its_form_came_to():
    options = {"hidden": 2, "hidden_states": 1, "starts": 2, "effort": 0.05}
    block = learning.learn("state_nn", [recording(lambda u: settled(u, 0.3))], ["u"], ["y"], **options)
    assert [row["seed"] for row in block.provenance["seeds"]] == [0, 1]
    assert "Of 2 seeds the worst " in block.provenance["free_run"]["says"]


@pytest.mark.parametrize("source", ["own", "conformal"])
def test_a_band_that_does_not_hold_is_said_whatever_it_is_made_of(source):
    out = Row(Signal("y", "m"), 0.1, 1.0, {}, band={"source": source, "trustworthy": False, "coverage": 0.877})
    assert out.band_said() == "The 95 % band of y holds 87.7 % of what was held out: do not rely on it."
    assert replace(out, band={**out.band, "trustworthy": True, "coverage": 0.95}).band_said() == ""
    assert replace(out, band={}).band_said() == ""


@pytest.mark.parametrize(("grow", "first"), [(1.0, False), (4.0, True)])
def test_a_run_outside_of_what_was_trained_on_is_said_and_first_where_it_is_most(grow, first):
    """The command of what is held out is larger; the block stands at its limits there."""

    def machine(u):
        return settled(np.where(np.arange(len(u)) > 0.8 * len(u), grow, 1.0) * u, 0.1)

    records = [recording(machine, k, noise=3e-3) for k in (1, 2)]
    records = [r.with_signals({"u": np.where(np.arange(len(r)) > 0.8 * len(r), grow, 1.0) * r["u"]}) for r in records]
    says = card(learning.learn("narx", records, ["u"], ["y"]))["says"]
    assert says.startswith("It extrapolates in") == first
    assert first or "It extrapolates" not in says


def test_alike_is_said_to_be_alike():
    rows = [Row(Signal("y", "m"), error, 1.0, {"ARX": 1.0}) for error in (0.97, 1.2)]
    told = [carded([row], Words(), [], [])["says"] for row in rows]
    assert "less than 5 % apart is alike" in told[0] and "alike" not in told[1]
