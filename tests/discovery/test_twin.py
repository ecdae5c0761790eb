"""What smoothed signs leave by themselves is not taken for an effect."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.forward import reconsidered
from hydrotwin.discovery.structure import Structure
from hydrotwin.discovery.twin import TwinJob, floor_of, smoothed_signs, with_floor

from .slides import NOISE, question, records, searching


@pytest.fixture(scope="module")
def rubbing():
    """The slide with 30 N of dry friction, named."""
    search, fitted = searching(question(records(3, dry=30.0)), ("coulomb_friction", "null_bias"))
    coulomb = next(c for c in search.candidates if c.id == "coulomb_friction")
    tried = search.refitted(Structure((), fitted), [([coulomb], [{"coulomb_friction.force": 20.0}])])[0]
    return search, tried.structure


def with_smoothing(search, now, width):
    """The same structure with bristles that give ``width`` [m]."""
    soft = {"coulomb_friction.give": width, "coulomb_friction.stiffness": 1e3}
    values = {**now.fitted.values, **soft}
    flat = search.model(now.members).with_settings({k: {"value": v} for k, v in values.items()}, {}).flat
    smoothing = smoothed_signs(flat, now.members)
    return TwinJob(flat, search.names(now.members), search.question, now.fitted, smoothing)


def test_only_the_signs_of_added_effects_are_smoothed_ones(rubbing):
    search, now = rubbing
    flat = search.model(now.members).flat
    assert smoothed_signs(flat, now.members) == ("coulomb_friction.give", "coulomb_friction.resolution")
    assert smoothed_signs(flat, ()) == ()


def test_the_softer_a_sign_is_the_more_it_leaves_of_a_machine_that_sticks(rubbing):
    search, now = rubbing
    sharp, wide, wider = (floor_of(with_smoothing(search, now, v))[0] for v in (1e-6, 1e-3, 1e-2))
    assert sharp < 0.25 * NOISE < wide < wider


def test_a_floor_adds_to_the_noise_where_it_matters():
    noise = np.array([1.0, 2.0, np.nan])
    assert with_floor(noise, np.array([0.05, 1.5, np.nan])) == pytest.approx([1.0, 2.5, np.nan], nan_ok=True)


def test_an_effect_is_not_looked_for_below_what_smoothing_leaves(rubbing):
    search, now = rubbing
    noise = np.array([NOISE])
    own = dataclasses.replace(search, question=dataclasses.replace(search.question, noise=noise), sensors=noise)
    assert reconsidered(own, now) is now, "it fits to the noise: nothing to ask"
    clean = dataclasses.replace(own, told=(True,), sensors=noise / 50)
    reconsidered(clean, now)
    assert clean.sensors == pytest.approx(noise / 50), "a noise that the user gave is believed"
    assert clean.question.noise >= clean.sensors


def test_a_noise_that_was_motion_is_estimated_again_from_what_is_left(rubbing):
    search, now = rubbing
    loud = dataclasses.replace(search, question=dataclasses.replace(search.question, noise=np.array([10 * NOISE])))
    loud.sensors = loud.question.noise
    reconsidered(loud, now)
    assert loud.sensors == pytest.approx([NOISE], rel=0.1)
