"""What a model, a block or a recording knows of itself, through every change that it can go through.

A row is something that it knows, a column a change. Every cell is one of three: kept exactly; dropped, and said; or
refused with a sentence. What a column does not name as dropped must be kept, so that a new row is asked of all columns.
A new change is a line more.
"""

from __future__ import annotations

import contextlib
import dataclasses
import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.commands.fitting import fit_provenance
from hydrotwin.comparison import PhysicalContender, as_contender, compare
from hydrotwin.comparison.band import bands_of
from hydrotwin.comparison.loop import Loop, in_loop
from hydrotwin.comparison.notices import notices, remarks
from hydrotwin.comparison.travel import Carried
from hydrotwin.comparison.variants import Variant
from hydrotwin.comparison.varied import Thing, run_as, varied, with_values
from hydrotwin.discovery.around.surroundings import surrounded
from hydrotwin.export.writer import LeftOutWarning
from hydrotwin.identification.evidence import provenance_of_fit
from hydrotwin.learned import read_block
from hydrotwin.learned.block_file import write_block
from hydrotwin.learned.hybrid.block import alone
from hydrotwin.learned.hybrid.files import read_hybrid, write_hybrid
from hydrotwin.loading import load
from hydrotwin.models.language import Model
from hydrotwin.models.language.credibility import StaleEvidenceWarning
from hydrotwin.models.language.provenance import (
    OF_FIT,
    OF_VALUES,
    SPREAD,
    made_from,
    told_since,
)
from hydrotwin.records.between import sentences
from hydrotwin.simulation import lower, simulate
from tests.discovery.slides import Slide
from tests.learned.toy_machine import ANGLE, COMMAND, toy_record

TRAINED = "a" * 64  # SHA-256 of the recording of the fit
CODE = "from tests.discovery.slides import Slide\nfrom hydrotwin.models.language import Model\n\n\n"
CODE += "def slide():\n    return Model(Slide(), 'slide')\n"
FRICTION = "coulomb_friction at mass.flange"
BAND, RUN = {"band", "spread"}, {"step", "method"}


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("carried")
    with contextlib.chdir(path):
        Path("slide.py").write_text(CODE)
        yield path


@pytest.fixture(autouse=True)
def there(folder, monkeypatch):
    monkeypatch.chdir(folder)


def recording(seed: int = 1, name: str = "run") -> ht.Record:
    time = np.arange(0, 4, 0.02)
    force = np.repeat(np.random.default_rng(seed).normal(0, 100, 20), 10)
    signals = {"force": force, "speed": np.zeros_like(time)}
    return ht.Record(time, signals, {"force": "N", "speed": "m/s"}, name, digest=f"{seed:064x}")


def slide() -> Model:
    """A model as a fit leaves it: its values, how sure they are, its recordings, and a recorded input found late."""
    source, noise = "identified from train", {"speed": 1e-3}
    spread = {"names": ["mass.mass", "mass.damping"], "covariance": [[1.0, 0.2], [0.2, 4.0]], "noise": noise}
    told = {
        "recordings": [{"name": "train", "role": "train", "sha256": TRAINED}],
        "noise": noise,
        SPREAD: spread | {"left": noise, "explained": ["speed"]},
    }
    settings = {
        "mass.mass": {"value": 60.0, "unit": "kg", "sigma": 1.0, "source": source, "bounds": (10.0, 90.0)},
        "mass.damping": {"value": 190.0, "unit": "N.s/m", "sigma": 2.0, "source": source},
    }
    model = Model(Slide(), "slide").with_settings(settings, told)
    said = {"interpolation": "linear", "chosen_by": "recording", "why": "it moves", "shift": 0.005}
    return model.with_inputs({"force": said})


# -- what a model knows ------------------------------------------------------------------------------------------------
def known(thing) -> dict[str, object]:
    """Row -> what a contender of it says; None where it says nothing."""
    one = as_contender(thing)
    value = {p.name: p for p in one.parameters}
    mass, damping = value.get("mass.mass"), value.get("mass.damping")
    told, (force,) = one.provenance, [s for s in one.inputs if s.name in ("force", "command", "r")]
    flat = getattr(one, "flat", None)
    return {
        "recordings": made_from(told) or None,
        "spread": told.get(SPREAD),
        "band": bands_of(one) or None,
        "value": mass and mass.value,
        "deviation": mass and mass.sigma,
        "source": (mass and mass.source) or None,
        "bounds": mass and mass.bounds,
        "another deviation": damping and damping.sigma,
        "another source": (damping and damping.source) or None,
        "free": mass and mass.free,
        "between": (force.interpolation, force.chosen_by, force.why) if force.chosen_by else None,
        "shift": force.shift or None,
        "step": getattr(one, "how", {}).get("step") or getattr(flat, "step", None),
        "method": getattr(one, "how", {}).get("method", "auto") if flat is not None else None,
    }


def told(thing) -> str:
    """What a reader of a comparison with it is told, on the page and on the screen."""
    one = as_contender(thing)
    record = recording().with_signals({"r": recording()["speed"]}, {"r": "m/s"})
    found = compare([one], [record], modes=["free run"], repeats=0)
    (entrant,) = found.entrants
    said = [*notices(found), *remarks(found), *sentences(entrant.inputs)]
    assert not told_since(one.provenance) or any(told_since(one.provenance) in text for text in remarks(found))
    return " ".join(said)


def model_file(model: Model, edit=None):
    """Written and read back; ``edit`` : of its text."""
    ht.write_model_file("m.toml", "slide.py:slide", model)
    text = Path("m.toml").read_text()
    Path("m.toml").write_text(edit(text) if edit else text)
    return load("slide.py:slide@m.toml")


def fmu(model, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LeftOutWarning)
        return ht.read_fmu(ht.export_fmu(model, "m.fmu", **more))


def friction(model: Model) -> Model:
    return varied(Thing("m", model), Variant("v", {"coulomb_friction.friction": 5.0}, effects_on=(FRICTION,)))


def effect_added(model: Model) -> Model:
    name = next(c for c in ht.candidates(model, [FRICTION], merged=False))
    return ht.add_effect(model, name.id, name.site.name, {name.free[0]: 5.0})


def taken_out(model: Model) -> Model:
    found = effect_added(model).with_settings({}, model.provenance)
    return found.without(found.additions)


def looped(thing):
    return in_loop(thing, Loop("r", "speed", "force", 0.01, (5.0,), (1.0,)))


def travelled(thing):
    """In another process runs are made, and nothing is told: what tells stays here."""
    arrived = pickle.loads(pickle.dumps(Carried(as_contender(thing)))).contender
    provenance = {**as_contender(thing).provenance, **arrived.provenance}
    return dataclasses.replace(arrived.flat, provenance=provenance)


def hybrid_file(model: Model):
    write_hybrid(alone(model, 0.02), Path("h.toml"), "slide.py:slide")
    return read_hybrid(Path("h.toml"), load)


SET = {"spread", "band", "value", "deviation", "source"}
OF_FMU = BAND | {"deviation", "source", "another deviation", "another source", "free", "between", "shift", *RUN}
AROUND = OF_FMU - RUN
OF_BLOCK = BAND | RUN
VALUE = {"mass.mass": 70.0}
MODEL = {  # a change: what makes it, the rows that it drops, and what is said of that
    "flat": (lambda m: m.flat, set(), ""),
    "the same value": (lambda m: m.with_parameters({"mass.mass": 60.0}), set(), ""),
    "the same value, settings": (lambda m: m.with_settings({"mass.mass": {"value": 0.06, "unit": "t"}}), set(), ""),
    "the same value, flat": (lambda m: m.flat.with_parameters({"mass.mass": 60.0}), set(), ""),
    "the same value, scenario": (lambda m: with_values(m, {"mass.mass": "60000 g"}), set(), ""),
    "nothing": (lambda m: m.but().plus([]).without([]).with_settings({}), set(), ""),
    "another name": (lambda m: m.but(name="other"), set(), ""),
    "bounds": (lambda m: m.with_settings({"mass.mass": {"bounds": (1.0, 99.0)}}), {"bounds"}, None),
    "value": (lambda m: m.with_parameters(VALUE), SET, "mass.mass set"),
    "value, settings": (lambda m: m.with_settings(VALUE), SET, "mass.mass set"),
    "value, flat": (lambda m: m.flat.with_parameters(VALUE), SET, "mass.mass set"),
    "value, contender": (lambda m: PhysicalContender(m, parameters=VALUE), SET, "mass.mass set"),
    "value, contender of flat": (lambda m: PhysicalContender(m.flat, parameters=VALUE), SET, "mass.mass set"),
    "set of a scenario": (lambda m: with_values(m, {"mass.mass": "70 kg"}), SET, "mass.mass set"),
    "set of a scenario, flat": (lambda m: with_values(m.flat, {"mass.mass": "70 kg"}), SET, "mass.mass set"),
    "variant": (lambda m: varied(Thing("m", m), Variant("v", {"mass.mass": 70.0})), SET, "mass.mass set"),
    "all values": (
        lambda m: m.with_parameters({**VALUE, "mass.damping": 100.0}),
        SET | {"recordings", "another deviation", "another source"}, "mass.mass, mass.damping set",
    ),
    "one value after the other": (
        lambda m: m.with_parameters(VALUE).with_settings({"mass.damping": 100.0}),
        SET | {"recordings", "another deviation", "another source"}, "mass.mass set; mass.damping set",
    ),
    "effect": (effect_added, BAND, "coulomb_friction at mass.flange added"),
    "effect of a variant": (friction, BAND, "coulomb_friction at mass.flange added"),
    "effect taken out": (taken_out, BAND, "coulomb_friction at mass.flange taken out"),
    "other part": (lambda m: m.but(source=type(m.root.source)()), BAND, "source exchanged"),
    "inputs": (lambda m: m.with_inputs({"force": {"why": "it moves"}}), set(), ""),
    "inputs, contender": (lambda m: PhysicalContender(m).with_inputs({}), set(), ""),
    "another name, contender": (lambda m: as_contender(PhysicalContender(m), "other"), set(), ""),
    "start": (lambda m: PhysicalContender(m, start={"mass.speed": 0.1}).with_starts([]), set(), ""),
    "step": (lambda m: run_as(PhysicalContender(m), Variant("v", step=0.01)), {"step"}, None),
    "step, another name": (
        lambda m: run_as(as_contender(PhysicalContender(m), "other"), Variant("v", step=0.01)), {"step"}, None
    ),
    "travel": (travelled, set(), ""),
    "travel of a changed one": (lambda m: travelled(m.with_parameters(VALUE)), SET, "mass.mass set"),
    "block": (lambda m: lower(m, 0.01), OF_BLOCK, "stepped every 0.01 s as a block"),
    "loop": (looped, OF_BLOCK | {"between", "shift"}, "under controller"),
    "hybrid": (lambda m: alone(m, 0.02), OF_BLOCK, None),
    "file": (model_file, set(), ""),
    "file of a changed one": (lambda m: model_file(m.with_parameters(VALUE)), SET, "mass.mass set"),
    "file of flat": (lambda m: model_file(m.flat), set(), ""),
    "file of a hybrid": (hybrid_file, OF_BLOCK, None),
    "FMU": (fmu, OF_FMU, "an FMU, which holds no covariance"),
    "FMU of a changed one": (lambda m: fmu(m.with_parameters(VALUE)), OF_FMU | SET, "mass.mass set"),
    "FMU, value": (lambda m: fmu(m).with_values({"mass.mass": 70.0}), OF_FMU | SET, "mass.mass set"),
    "FMU, effects around": (lambda m: surrounded(fmu(m)), AROUND, "an FMU, which holds no covariance"),
    "FMU, effects around, value": (
        lambda m: surrounded(fmu(m)).with_parameters(VALUE), AROUND | SET, "mass.mass set",
    ),
}  # fmt: skip
OTHER = {"value", "bounds", "source", "another source", "between", *RUN}  # rows that may say something else then


@pytest.mark.parametrize("change", MODEL)
def test_what_a_fitted_model_knows_is_kept_or_dropped_and_said(change):
    make, dropped, said = MODEL[change]
    before, made = known(slide()), None
    made = make(slide())
    after = known(made)
    assert before.keys() == after.keys() and not [row for row, value in before.items() if value is None]
    kept = {row for row in before if row not in dropped}
    assert {row: after[row] for row in kept} == {row: before[row] for row in kept}
    for row in dropped:
        assert after[row] != before[row] and (row in OTHER or not after[row]) and "identified" not in f"{after[row]}", (
            row
        )
    if said is not None:
        text = told(made)
        assert said in text if said else not told_since(as_contender(made).provenance)
    elif dropped & BAND:
        assert not bands_of(as_contender(made))


def test_every_change_asks_the_same_rows_and_no_column_drops_what_there_is_not():
    rows = set(known(slide()))
    assert all(dropped <= rows for _, dropped, _ in MODEL.values())


def test_what_a_fit_or_gap_says_of_a_model_is_of_its_values_or_dropped():
    """A key that is new in a provenance must be sorted, or a copy would say it of another model."""
    train = dataclasses.replace(recording(), digest=TRAINED)
    train = train.with_signals({"speed": simulate(slide(), train)["speed"]})
    fit = ht.identify(slide(), [train], free=["mass.mass"], starts=1, noise={"speed": 1e-3})
    assert provenance_of_fit(fit).keys() <= {*OF_FIT, *OF_VALUES}


# -- a fit after a fit -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("free", "kept"), [(["mass.mass"], True), (["mass.*"], False)])
def test_values_that_a_fit_holds_still_follow_the_recordings_of_the_one_before(free, kept):
    """Fitted again to another recording, a model was said to be made of that alone."""
    train = recording(2)
    train = train.with_signals({"speed": simulate(slide(), train)["speed"]})
    fit = ht.identify(slide(), [train], free=free, starts=1, noise={"speed": 1e-3})
    assert made_from(fit.flat.provenance) == {train.digest, *([TRAINED] if kept else [])}
    assert bands_of(as_contender(fit.flat))
    file = model_file(fit.flat)
    assert made_from(file.provenance) == made_from(fit.flat.provenance)
    assert made_from(fit_provenance(fit, [train], [])) == made_from(fit.flat.provenance), "as the command writes it"


def test_a_file_whose_values_are_edited_says_so_and_has_no_intervals():
    """Loading warns; what is made of it then says so in every comparison."""
    from hydrotwin.models.language.credibility import FIT, IDENTIFY, Evidence, now, recording_rows

    evidence = Evidence(IDENTIFY, now(), "", {}, tuple(recording_rows([recording()], FIT)))
    ht.write_model_file("m.toml", "slide.py:slide", slide(), evidence=evidence)
    Path("m.toml").write_text(Path("m.toml").read_text().replace("value = 60.0", "value = 70.0"))
    with pytest.warns(StaleEvidenceWarning, match="intervals"):
        model = load("slide.py:slide@m.toml")
    after = known(model)
    assert [after[row] for row in ("spread", "band", "deviation", "another deviation")] == [None] * 4
    assert after["recordings"] == {TRAINED} and "edited" in told(model)
    assert known(fmu(model))["recordings"] == {TRAINED}, "its record no longer holds, and its recordings do"


def test_an_fmu_cannot_say_that_a_column_is_late_and_its_export_does():
    with pytest.warns(LeftOutWarning, match=r"force \+0\.005 s.*Feed it inputs that are so"):
        ht.export_fmu(slide(), "late.fmu")


# -- a learned block ---------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def learnt():
    return ht.learn("arx", [toy_record(1), toy_record(2)], [COMMAND], [ANGLE])


def block_known(thing) -> dict[str, object]:
    one = as_contender(thing)
    block = getattr(one, "block", None)
    return {
        "recordings": made_from(one.provenance),
        "band": bands_of(one) or None,
        "card": one.provenance.get("free_run"),
        "kind": one.provenance.get("kind"),
        "period": block.period if block else one.description.period,
        "domain": getattr(one, "domain", None),
        "between": [(s.interpolation, s.chosen_by) for s in one.inputs],
    }


def block_file(block):
    write_block(block, "b.toml")
    return read_block("b.toml")


def block_loop(block):
    return in_loop(block, Loop("r", "arm_angle", "command", block.period, (5.0,), (1.0,)))


def block_travelled(block):
    """Provenance stays here, where it is told."""
    arrived = pickle.loads(pickle.dumps(Carried(as_contender(block)))).contender
    return dataclasses.replace(arrived.block, provenance=block.provenance)


OF_BLOCKS_FMU = {"band", "card", "kind", "domain", "between"}
UNDECIDED = {"command": {"interpolation": None, "chosen_by": None}}
BLOCK = {
    "inputs": (lambda b: b.with_inputs({}), set(), ""),
    "file": (block_file, set(), ""),
    "file again": (lambda b: block_file(block_file(b)), set(), ""),
    "another name": (lambda b: as_contender(as_contender(b), "other"), set(), ""),
    "travel": (block_travelled, set(), ""),
    "loop": (block_loop, {"band", "card"}, "under controller"),
    "FMU": (lambda b: ht.read_fmu(ht.export_fmu(b, "b.fmu")), OF_BLOCKS_FMU, "an FMU, which holds no covariance"),
    "FMU of a file": (
        lambda b: ht.read_fmu(ht.export_fmu(block_file(b), "b.fmu")), OF_BLOCKS_FMU, "an FMU, which holds no covariance"
    ),
}  # fmt: skip


@pytest.mark.parametrize("change", BLOCK)
def test_what_a_learned_block_knows_is_kept_or_dropped_and_said(learnt, change):
    make, dropped, said = BLOCK[change]
    before, made = block_known(learnt), make(learnt)
    after = block_known(made)
    assert all(before.values()) and dropped <= before.keys()
    assert {r: v for r, v in after.items() if r not in dropped} == {r: before[r] for r in before if r not in dropped}
    assert not any(after[row] for row in dropped - {"kind", "between"})
    assert said in told_since(as_contender(made).provenance) if said else not told_since(as_contender(made).provenance)


def test_a_block_that_leaves_an_input_to_the_recordings_comes_back_so(learnt):
    """From its file it had held what the block itself took as the recordings show."""
    inputs = tuple(dataclasses.replace(s, interpolation=None, chosen_by=None) for s in learnt.inputs)
    assert block_file(dataclasses.replace(learnt, inputs=inputs)).inputs == inputs


def test_a_hybrid_comes_back_with_what_its_inputs_do():
    hybrid = alone(Model(Slide(), "slide"), 0.02).with_inputs({"force": {"interpolation": "linear", "shift": 0.005}})
    write_hybrid(hybrid, Path("h.toml"), "slide.py:slide")
    assert read_hybrid(Path("h.toml"), load).inputs == hybrid.inputs


def test_an_effect_around_an_fmu_keeps_what_is_known_of_the_fmu():
    around = surrounded(fmu(slide()))
    added = around.plus([next(c for c in ht.candidates(around, ["sensor_bias"], merged=False)).addition], sought=True)
    moved = added.with_inputs({"force": {"interpolation": "linear"}})
    for one in (around, added, moved):
        assert made_from(one.provenance) == made_from(one.flat.provenance) == {TRAINED}
        assert one.provenance["guid"] == around.fmu.provenance["guid"]
    assert moved.sought and "sensor_bias" in told_since(added.provenance)


def test_a_file_of_effects_around_an_fmu_leaves_what_is_known_of_the_fmu():
    """Where its values come from is what the file says; what is inside of it stays made from what it was made from."""
    around = surrounded(fmu(slide()))
    bias = next(c for c in ht.candidates(around, ["sensor_bias"], merged=False))
    added = around.plus([bias.addition]).with_parameters({bias.free[0]: 0.1})
    ht.write_model_file("around.toml", "m.fmu", added, {"made_by": "gap", "verdict": "named"})
    told = load("around.toml").provenance
    assert (made_from(told), told["made_by"], told["guid"]) == ({TRAINED}, "gap", around.provenance["guid"])
