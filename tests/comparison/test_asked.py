"""What criteria are held against: refused before a run where nothing can test them, and no way to pass by failing."""

from __future__ import annotations

import dataclasses
import json
from xml.etree import ElementTree

import numpy as np
import pytest

from hydrotwin.comparison import ModelEntry, Scenario, Wanted, acceptance, compare, junit, run_scenario
from hydrotwin.models.language.errors import DeclarationError, UnitError, nearest
from hydrotwin.records import Record, write_record
from hydrotwin.report import write_report
from hydrotwin.report.acceptance import acceptance_lines
from tests.comparison.toys import ANGLE, SPEED, Toy, recording

FREE = ("free run",)
FIRST, SECOND = (dataclasses.replace(recording(k), tags={"load": str(k)}) for k in (1, 2))


class Shifted(Toy):
    """The toy with its arm angle off by so many rad on each recording."""

    def free_run(self, record):
        found = super().free_run(record)
        moved = record["arm_angle"] + {FIRST.name: 0.01, SECOND.name: -0.01}[record.name]
        return Record(record.time, {**found.signals, "arm_angle": moved}, found.units, self.name)


def judged(models, records, *texts, model="", **more):
    found = compare(models, records, modes=FREE, repeats=0)
    return acceptance(found, Wanted(texts, model, **more)).judged


def test_errors_of_either_sign_do_not_make_up_for_each_other():
    (bias,) = judged([Shifted("shifted")], [FIRST, SECOND], "arm_angle.bias < 0.001 rad")
    assert not bias.passed and bias.value == pytest.approx(0.01)


@pytest.mark.parametrize("metric", ["bias", "lag", "steady", "rmse", "mae", "max", "theil"])
def test_a_model_is_not_worse_than_itself_before(tmp_path, metric):
    """Whatever is judged by its size is so of the earlier comparison, too, and of a part of its recordings."""
    before = compare([Shifted("shifted"), Toy("late", lag=0.05)], [FIRST, SECOND], modes=FREE, repeats=0)
    write_report(before, tmp_path)
    for model in ("shifted", "late"):
        found = acceptance(
            before,
            Wanted(
                tuple(f"{group}arm_angle.{metric} not worse than compare.json" for group in ("", "load=2: ")),
                model,
                base=tmp_path,
            ),
        )
        rows = [s for s in before.scores if (s.model, s.output) == (model, "arm_angle")]
        defined = metric != "steady" or not np.isnan([r.steady for r in rows]).any()
        assert [one.passed for one in found.judged] == [defined, defined]
        assert [one.value for one in found.judged] == pytest.approx(
            [one.high for one in found.judged], rel=1.1e-4, abs=1.1e-4 * max(r.rmse for r in rows), nan_ok=True
        )


def test_nobody_is_as_good_as_a_model_that_failed():
    models = [Toy("good"), Toy("broken", fails_on=SECOND.name)]
    whole, first = judged(
        models, [FIRST, SECOND], "arm_angle not worse than broken", "load=1: arm_angle not worse than broken by 1 %"
    )
    assert not whole.passed and "validation_2: broken: the run left" in whole.undefined
    assert first.passed


@pytest.mark.parametrize("metric", ["nrmse < 10 %", "rmse < 1 rad", "fit > 1 %", "r2 > 0", "lag < 1 s", "max < 9 deg"])
def test_every_metric_of_a_run_that_failed_is_missed_with_its_reason(metric):
    (one,) = judged([Toy("broken", fails_on=SECOND.name)], [FIRST, SECOND], f"arm_angle.{metric}")
    assert not one.passed and one.undefined.startswith("validation_2: broken: the run left")


def test_a_recording_without_the_output_is_left_out_and_named():
    (one,) = judged([Toy("good")], [FIRST, without(SECOND, "arm_angle")], "arm_angle.rmse < 5 deg")
    assert one.passed and one.samples == len(FIRST)
    assert one.caution == "not judged on validation_2, which holds no arm_angle"


def without(record, *names):
    kept = {n: v for n, v in record.signals.items() if n not in names}
    return Record(record.time, kept, {n: record.units[n] for n in kept}, record.name, tags=record.tags)


MODELS = {"good": Toy("good"), "speed": Toy("speed", outputs=(SPEED,)), "angle": Toy("angle", outputs=(ANGLE,))}


@pytest.mark.parametrize(
    ("text", "says", "more"),
    [
        ("motor_speed.rmse < 3 rad/s", "angle gives no motor_speed. It gives arm_angle", {}),
        ("arm_angle not worse than speed", "speed gives no arm_angle", {}),
        ("arm_angle.coverage in [0.9, 0.99]", "angle has no band of arm_angle in free run.*identify", {}),
        ("arm_angle.vv20 < 2", "has no band", {}),
        ("arm_angle.rate.vv20 < 2", "is a slope.* Judge arm_angle.vv20", {"rates": ("arm_angle",)}),
        ("arm_angle.rmse < 1 deg", "no output 'arm_angle'. Known: motor_speed", {"outputs": ("motor_speed",)}),
        ("arm_angle.iso18571 > 0.8", "free run only.*one step", {"modes": ("one step", "free run")}),
        ("arm_angle.rate.rmse < 1 deg/s", "free run only", {"modes": ("one step",), "rates": ("arm_angle",)}),
        ("bare: arm_angle.rmse < 1 deg", "none of the recordings it is about holds arm_angle", {}),
        ("arm_angle.rmse < 1 dge", "arm_angle.rmse < 1 dge.*Did you mean 'deg'", {}),
        (
            "arm_angle.nrmse not worse than compare.json",
            "hold nrmse. Compare one of rmse, mae, max, bias, theil, lag",
            {},
        ),
        ("arm_angle.rmse < 1 deg", "no mode 'one_step'. Did you mean 'one step'", {"modes": ("one_step",)}),
        ("arm_angle.coverage > 0.9", "no mode 'one_step'. Did you mean 'one step'", {"modes": ("one_step",)}),
        ("arm_angle not worse than compare.json", "no arm_angle of 'angle' in free run", {}),
    ],
)
def test_what_nothing_can_test_is_refused_before_anything_runs(tmp_path, text, says, more):
    write_record(FIRST, tmp_path / "first.csv")
    write_record(without(SECOND, "arm_angle"), tmp_path / "bare.csv")
    (tmp_path / "compare.json").write_text(json.dumps({"means": []}))
    files = (tmp_path / "first.csv", tmp_path / "bare.csv")
    entries = tuple(ModelEntry(name) for name in ("angle", "speed", "good"))
    asked = Scenario("Toys", entries, files, wanted=Wanted((text,), base=tmp_path), **more)
    ran = []
    models = {name: Watched(toy, ran) for name, toy in MODELS.items()}
    with pytest.raises((DeclarationError, UnitError), match=says):
        run_scenario(asked, models.__getitem__, repeats=0)
    assert not ran


class Watched:
    """A toy that tells when it runs."""

    def __init__(self, toy, ran):
        self._toy, self._ran = toy, ran

    def free_run(self, record):
        self._ran.append(record.name)
        return self._toy.free_run(record)

    one_step = free_run

    def __getattr__(self, name):
        return getattr(self._toy, name)


def test_servers_read_values_in_the_unit_of_the_criterion():
    texts = ("arm_angle.rmse < 0.001 deg", "arm_angle.fit > 99.9999 %", "motor_speed.max in [1, 2] 1/min",
             "arm_angle.lag < 0.001 ms", "arm_angle not worse than exact")  # fmt: skip
    models = [Toy("late", lag=0.05), Toy("exact")]
    found = acceptance(compare(models, [FIRST], modes=FREE, repeats=0), Wanted(texts))
    suite = ElementTree.fromstring(junit(found, "Toys").encode())[0]
    told = [case.find("failure").text for case in suite]
    (score,) = (s for s in compare(models[:1], [FIRST], modes=FREE, repeats=0).scores if s.output == "arm_angle")
    assert told[0] == f"found {np.degrees(score.rmse):.6g} deg, allowed at most 0.001 deg"
    assert told[1] == f"found {score.fit_percent:.6g} %, allowed at least 99.9999 %"
    assert told[2].endswith("1/min, allowed 1 to 2 1/min")
    assert told[3] == f"found {1000 * abs(score.lag):.6g} ms, allowed at most 0.001 ms"
    assert told[4].startswith(f"found {np.degrees(score.rmse):.6g} deg, allowed at most ")


def test_a_bound_of_zero_leaves_no_share_to_tell():
    texts = ("arm_angle.rmse <= 0 deg", "arm_angle.r2 in [0, 1]", "arm_angle.mae in [0, 90] deg", "arm_angle.r2 < 0.1")
    zero, share, within, above = judged([Toy("good")], [FIRST], *texts)
    assert not zero.passed and zero.margin == -np.inf
    assert share.margin == pytest.approx(share.value) and within.margin == pytest.approx(1 - within.value / within.high)
    found = acceptance(compare([Toy("good")], [FIRST], modes=FREE, repeats=0), Wanted((texts[0], "arm_angle.r2 > 5 %")))
    assert "not allowed at all" in acceptance_lines(found, {"arm_angle": "deg"})[1][1]
    assert above.margin < 0


def test_files_of_the_command_line_start_from_its_folder_and_not_from_that_of_the_scenario(tmp_path):
    said = Wanted(("y not worse than a.json",), base=tmp_path / "scenario")
    both = Wanted(("y not worse than b.json",), base=tmp_path).over(said)
    assert [both.folder(text) for text in both.accept] == [tmp_path / "scenario", tmp_path]


def test_a_name_that_two_recordings_have_is_no_group(tmp_path):
    """Which of them is meant would depend on the order in which they are given."""
    import hydrotwin as ht
    from hydrotwin.comparison import Wanted, acceptance
    from hydrotwin.models.language.errors import DeclarationError

    record = ht.read_record("examples/cehA/recordings/validate_1.csv").window(0, 1)
    other = ht.read_record("examples/cehA/recordings/validate_2.csv").window(0, 1)
    runs = [ht.Record(r.time, dict(r.signals), r.units, name="run") for r in (record, other)]
    comparison = ht.compare([ht.load("cehA")], runs, modes=["free run"])
    with pytest.raises(DeclarationError, match=r"more than one recording is called run: .*run, run \(2\)"):
        acceptance(comparison, Wanted(("run: arm_angle.rmse < 0.02 deg",)))
    with pytest.raises(DeclarationError, match="more than one recording is called run:"):
        acceptance(comparison, Wanted(("run (2): arm_angle.rmse < 0.02 deg",)))


@pytest.mark.parametrize("name", ["run", "run (2)"])
def test_it_is_refused_before_anything_runs(tmp_path, name):
    """Recordings were told apart only where they ran: all of it, and then nothing was written."""
    for k in (1, 2):
        (tmp_path / str(k)).mkdir()
        write_record(recording(k, duration=1.0), tmp_path / str(k) / "run.csv")
    files = tuple(tmp_path / str(k) / "run.csv" for k in (1, 2))
    wanted = Wanted((f"{name}: arm_angle.rmse < 1 deg",))

    class Never(Toy):
        def free_run(self, record):
            raise AssertionError("it ran")

    scenario = Scenario("twice", (ModelEntry("toy"),), files, modes=FREE, wanted=wanted)
    with pytest.raises(DeclarationError, match=r"more than one recording is called run: .*run, run \(2\)"):
        run_scenario(scenario, lambda name: Never("toy"))


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("arm_angle not worse than good", "everything"),
        ('rmse not worse than "good" by 5 %', "everything"),
        ("load=1: arm_angle.mae not worse than good by -5 %", "nothing"),
    ],
)
def test_a_model_held_against_itself_is_refused(text, holds):
    """It would hold whatever the model does: a scenario whose models changed places would pass for ever."""
    with pytest.raises(DeclarationError, match=f"for {holds}: good is the model that is judged.*against late, or"):
        judged([Toy("good"), Toy("late", lag=0.05)], [FIRST, SECOND], text)
    with pytest.raises(DeclarationError, match="Hold it against a model beside it"):
        judged([Toy("good")], [FIRST], text)
    (turned,) = judged([Toy("good"), Toy("late", lag=0.05)], [FIRST, SECOND], text, model="late")
    assert not turned.passed


@pytest.mark.parametrize("text", ["arm_angle.coverage > 0.9", "arm_angle.rmse < 1 deg"])
def test_two_models_of_one_name_are_told_before_anything_is_asked_of_them(tmp_path, text):
    file = write_record(FIRST, tmp_path / "run.csv")
    asked = Scenario("Toys", (ModelEntry("a", "same"), ModelEntry("b", "same")), (file,), wanted=Wanted((text,)))
    with pytest.raises(DeclarationError, match=r"two models are called 'same'.*NAME=MODEL"):
        run_scenario(asked, lambda _: Toy("same"), repeats=0)


def test_the_nearest_name_is_found_whatever_its_case():
    with pytest.raises(DeclarationError, match="Did you mean 'arm_angle'"):
        judged([Toy("good")], [FIRST], "ARM_ANGLE.rmse < 1 deg")
    with pytest.raises(DeclarationError, match="Did you mean 'vv20'"):
        judged([Toy("good")], [FIRST], "arm_angle.VV20 < 1")
    assert nearest("PRESSURE_A", ["Pressure_b", "pressure_a", "pressure"]) == "Did you mean 'pressure_a'?"
    assert nearest("B1", ["b1.x", "B2", "b", "B1"]) == "Did you mean 'B1'?"
    assert nearest("Q1", ["b", "B"]) == "Known: b, B."


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("variant=cold: arm_angle.rmse < 1 deg", r"the scenario has no variants\. Leave 'variant=cold:' out"),
        ("arm_angle: rmse < 1 deg", r"Write arm_angle\.rmse"),
        (
            "arm_angle: fit > 90 %",
            r"arm_angle is an output, and recordings stand .* Write arm_angle\.fit",
        ),
        ("arm_angle not worse than goood by 5 %", r"accept: 'arm_angle not .* 5 %': no model 'goood'.*'good'"),
    ],
)
def test_what_stands_before_a_colon_is_a_recording_or_a_condition(text, says):
    with pytest.raises(DeclarationError, match=says):
        judged([Toy("good"), Toy("other")], [FIRST], text)
