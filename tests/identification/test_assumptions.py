"""What is assumed about recordings is doubted before anything is missing: inputs between samples, starts."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hydrotwin.identification import identify
from hydrotwin.models.language.errors import DeclarationError

from .sliding import FREE, MASS, PERIOD, VISCOUS, held, moved, slide, steps, wave

MANY = 4.0  # sigmas


def fitted(records, model=None, **more):
    return identify(model or slide(), records, free=FREE, **more)


def right(fit, times=MANY):
    """Whether both parameters are the machine's within some sigmas, and half a percent."""
    for name, true in zip(FREE, (MASS, VISCOUS), strict=True):
        p = fit.parameter(name)
        if not (abs(p.value - true) < times * p.sigma + 1e-3 * true and p.sigma < 0.005 * true):
            return False
    return True


def said(fit) -> list[str]:
    return [f.sentence for f in fit.findings if f.kind == "assumption"]


def force(fit):
    return fit.flat.inputs[0]


# -- inputs between samples -------------------------------------------------------------------------------------------
def test_a_measured_force_is_linear_between_its_samples_and_the_fit_says_who_chose_so():
    fit = fitted([moved(s, wave(s)) for s in range(2)])
    assert (force(fit).interpolation, force(fit).chosen_by) == ("linear", "recording")
    assert right(fit) and not said(fit)


@pytest.mark.parametrize(
    ("declared", "true"), [("hold", "linear"), ("linear", "hold"), (None, "hold")], ids=["held", "linear", "measured"]
)
def test_an_input_that_does_something_else_than_assumed_is_found_by_what_it_explains(declared, true):
    runs = [moved(s, held(wave(s)) if true == "hold" else wave(s), wave(s)) for s in range(2)]
    fit = fitted(runs, slide(declared))
    assert (force(fit).interpolation, force(fit).chosen_by, force(fit).shift) == (true, "fit", 0.0)
    assert right(fit)
    (sentence,) = said(fit)
    assert "input force is" in sentence and "times the noise" in sentence


@pytest.mark.parametrize(("late", "samples"), [(0.5, -0.5), (-0.5, 0.5), (1.0, -1.0)])
def test_a_column_half_a_sample_or_one_beside_its_stamps_is_found(late, samples):
    runs = [moved(s, wave(s), lambda t, s=s: wave(s)(t - late * PERIOD)) for s in range(2)]
    fit = fitted(runs)
    shifted = force(fit).shift / PERIOD - 0.5 * (force(fit).interpolation == "linear") + 0.5
    assert shifted == pytest.approx(samples, abs=1e-9)  # held is half a sample later than linear
    assert right(fit) and len(said(fit)) == 1


def test_a_dead_time_is_told_with_its_size_and_not_taken_for_a_shift_of_the_samples():
    runs = [moved(s, lambda t, s=s: held(steps(s))(np.maximum(t - 0.06, 0)), steps(s)) for s in range(2)]
    fit = fitted(runs)
    assert force(fit).chosen_by == "recording" and force(fit).shift == 0
    (sentence,) = said(fit)
    assert float(re.search(r"about ([\d.]+) s later", sentence)[1]) == pytest.approx(0.06, abs=0.005)
    assert "dead_time" in sentence


def test_what_the_user_says_stands_and_what_speaks_against_it_is_told():
    fit = fitted([moved(s, wave(s)) for s in range(2)], interpolation={"force": "hold"})
    assert (force(fit).interpolation, force(fit).chosen_by) == ("hold", "user")
    assert any("0.01 s earlier" in sentence for sentence in said(fit))


def test_uneven_samples_and_a_lone_recording_are_no_obstacle():
    random = np.random.default_rng(3)
    time = np.cumsum(np.r_[0.0, random.uniform(0.01, 0.03, 400)])
    fit = fitted([moved(0, wave(0), time=time)], slide("hold"))
    assert (force(fit).interpolation, force(fit).chosen_by) == ("linear", "fit")
    assert right(fit)


def test_nothing_is_tried_where_only_noise_is_left():
    fit = fitted([moved(s, held(steps(s))) for s in range(2)], slide("hold"))
    assert not said(fit) and force(fit).chosen_by == "model" and right(fit)


def test_an_interpolation_that_does_not_exist_and_an_input_that_does_not_are_refused():
    run = moved(0, wave(0))
    with pytest.raises(DeclarationError, match=r"force=cubic.*force=linear"):
        fitted([run], interpolation={"force": "cubic"})
    with pytest.raises(DeclarationError, match=r"no input 'forse'.*force"):
        fitted([run], interpolation={"forse": "linear"})


# -- starts ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("speed", [0.2, -0.02, 0.003])
def test_a_start_in_motion_that_no_output_measures_is_estimated_and_told(speed):
    run = moved(0, held(steps(0)), start=(0.0, speed), outputs=("position",))
    fit = fitted([run])
    assert fit.settings["initial_states"] == "free"
    assert fit.records[0].start["load.velocity"] == pytest.approx(speed, abs=1e-3)
    assert right(fit)
    (sentence,) = said(fit)
    assert "start of load.velocity" in sentence


@pytest.mark.parametrize("seed", range(4))
def test_a_start_at_rest_is_not_taken_for_one_in_motion(seed):
    fit = fitted([moved(seed, held(steps(seed)), outputs=("position",))])
    assert fit.settings["initial_states"] == "auto" and not said(fit) and right(fit)


def test_a_start_that_the_user_fixes_stays():
    run = moved(0, held(steps(0)), start=(0.0, 0.2), outputs=("position",))
    assert fitted([run], initial_states="fixed").settings["initial_states"] == "fixed"


def test_a_start_in_motion_and_a_wrong_input_are_both_found():
    fit = fitted([moved(s, wave(s), start=(0.0, 0.2), outputs=("position",)) for s in range(2)], slide("hold"))
    assert fit.settings["initial_states"] == "free" and force(fit).interpolation == "linear"
    assert right(fit) and len(said(fit)) == 2


# -- loads ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("load", [8.0, -0.5])
def test_a_constant_load_that_nobody_freed_is_estimated_and_told(load):
    fit = fitted([moved(s, lambda t, s=s: held(steps(s))(t) - load, steps(s)) for s in range(2)])
    assert fit.values["load.load_force"] == pytest.approx(load, abs=0.02)
    assert right(fit)
    (sentence,) = said(fit)
    assert "load.load_force is not 0 N as assumed" in sentence


def test_a_load_that_is_not_there_stays_held():
    fit = fitted([moved(s, held(steps(s))) for s in range(2)])
    assert set(fit.values) == set(FREE) and not said(fit)
