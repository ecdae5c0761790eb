"""The screen puts the true effect first, says what recordings cannot show, and finds limits by trying amplitudes."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.discovery.screen import TESTABLE, Screen
from hydrotwin.discovery.structure import Structure
from hydrotwin.models.language import Model
from tests.discovery.slides import NOISE, Drive, drive_records, question, records, searching, slide

SMOOTH = ("coulomb_friction", "viscous_friction", "null_bias", "drift", "direction_asymmetry", "constant_load")


def screened(runs, effects):
    """Search, screen of the identified base, and what it says by effect."""
    search, base = searching(question(runs), effects)
    screen, ranked = search.screened(Structure((), base))
    return search, screen, {s.candidate.id: s for s in ranked}


@pytest.fixture(scope="module")
def rubbing():
    """The slide with 30 N of dry friction."""
    return screened(records(3, dry=30.0), SMOOTH)


def test_dry_friction_ranks_first_where_there_is_dry_friction(rubbing):
    _, _, ranked = rubbing
    assert next(iter(ranked)) == "coulomb_friction"
    assert ranked["coulomb_friction"].share > 0.8
    assert ranked["coulomb_friction"].evidence > 2 * ranked["drift"].evidence


def test_its_size_is_predicted_from_the_derivative_alone(rubbing):
    start = rubbing[2]["coulomb_friction"].start
    assert start["coulomb_friction.force"] == pytest.approx(30.0, rel=0.5)


def test_the_trace_of_what_the_base_absorbs_is_projected_away(rubbing):
    _, screen, _ = rubbing
    column = screen.jacobian[:, [screen.free.names.index("viscous_friction.viscous")]]
    assert np.linalg.norm(screen.project(column)) < 1e-9 * np.linalg.norm(column)


def test_what_the_base_absorbs_gains_nothing_and_is_untestable(rubbing):
    assert abs(rubbing[2]["viscous_friction"].share) < 0.02
    assert not rubbing[2]["viscous_friction"].testable


def test_a_load_and_a_bias_of_the_force_leave_the_same_trace(rubbing):
    one, other = (rubbing[2][name].column for name in ("null_bias", "constant_load"))
    assert abs(one @ other) == pytest.approx(1.0, abs=1e-3)


def test_a_pair_that_is_one_and_the_same_gains_nothing_together(rubbing):
    _, screen, ranked = rubbing
    assert screen.joint_gain(ranked["null_bias"], ranked["constant_load"]) < 0.5
    assert screen.joint_gain(ranked["coulomb_friction"], ranked["null_bias"]) > -1e-6


def test_the_screened_residual_is_what_the_fit_left(rubbing):
    _, screen, _ = rubbing
    assert screen.rmse(screen.residual) == pytest.approx(screen.fitted.rmse, rel=1e-6)
    assert screen.rmse(screen.left)[0] <= screen.fitted.rmse[0] * (1 + 1e-9)
    assert np.abs(screen.basis.T @ screen.left).max() < 1e-6 * np.linalg.norm(screen.residual)


def test_an_effect_at_neutral_changes_nothing_in_the_model_with_all_candidates(rubbing):
    search, screen, _ = rubbing
    alone = np.concatenate(screen.fitted.residuals_fit)[:, 0]
    assert screen.residual * screen.size[0] == pytest.approx(alone, abs=1e-6 * NOISE)
    assert isinstance(screen, Screen) and len(search.candidates) == len(SMOOTH)


def test_a_saturated_command_is_found_by_trying_limits():
    """Its derivative is nil: the neutral limit is far away."""
    runs = records(3, limit=180.0)
    _, screen, ranked = screened(runs, ("command_saturation", "coulomb_friction", "null_bias"))
    best = ranked["command_saturation"]
    assert next(iter(ranked)) == "command_saturation"
    assert best.share > 0.3 and best.testable
    assert 90.0 < best.start["command_saturation.limit"] < 290.0
    column = screen.jacobian[:, screen.free.names.index("command_saturation.limit")]
    assert np.abs(column).max() == 0.0


def test_dry_friction_of_what_never_moves_is_said_to_be_untestable():
    """The mass is pushed so gently that its speed stays in the noise."""
    runs = records(3, highest=0.05)
    search, _, ranked = screened(runs, ("coulomb_friction", "direction_asymmetry"))
    assert ranked["direction_asymmetry"].visible < TESTABLE and not ranked["direction_asymmetry"].testable
    assert "direction_asymmetry at force" in search.not_testable


@pytest.mark.parametrize(
    ("quiet", "looked_for"), [(1.0, ("asymmetry", "gain")), (1e-4, ("asymmetry",))], ids=["moving", "all but still"]
)
def test_a_gain_is_looked_for_beside_what_differs_by_direction_where_it_shows(quiet, looked_for):
    """No free parameter of the drive is its gain; of commands that hardly move it nothing can be learnt."""
    drive = Model(Drive(), settings={"gain": {"free": False}})
    runs = drive_records(command=lambda u: quiet * np.where(u < 0, 0.8, 1.0) * u)
    runs = [r.with_signals({"command": quiet * r["command"]}) for r in runs]
    search, base = searching(question(runs, drive), ("direction_asymmetry",), drive, ("time_constant",))
    search.screened(Structure((), base))
    (candidate,) = search.candidates
    assert candidate.free == tuple(f"direction_asymmetry.{name}" for name in looked_for) == tuple(candidate.neutral)


def test_nothing_is_promised_where_nothing_is_missing():
    _, _, ranked = screened(records(3), SMOOTH)
    assert max(s.evidence for s in ranked.values()) < 5.0


def test_what_a_base_parameter_on_its_bound_cannot_do_any_more_is_seen_and_refitted():
    held = slide().with_settings({"mass.damping": {"bounds": (1.0, 160.0)}})  # 200 in truth
    search, fitted = searching(question(records(3)), ["viscous_friction", "dead_time"], held)
    assert fitted.at_bound == ("mass.damping",)
    _, ranked = search.screened(Structure((), fitted))
    seen = {s.candidate.id: s for s in ranked}
    assert seen["viscous_friction"].beyond and not seen["dead_time"].beyond
    assert seen["viscous_friction"].gain > 100.0 and search.shortlist(ranked)[0] is seen["viscous_friction"]


def test_what_a_base_parameter_can_do_by_itself_is_not_seen():
    search, fitted = searching(question(records(3)), ["viscous_friction", "dead_time"])
    _, ranked = search.screened(Structure((), fitted))
    seen = {s.candidate.id: s for s in ranked}
    assert not seen["viscous_friction"].beyond and not seen["viscous_friction"].gain > 0
