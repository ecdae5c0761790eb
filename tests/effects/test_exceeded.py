"""Where limits begin: some are barely exceeded, whatever the recording looks like."""

import numpy as np
import pytest

from hydrotwin.models.effects.exceeded import exceeded, fallen_below

TIME = np.linspace(0, 10, 2001)
SEEN = {
    "sine": np.sin(TIME),
    "one peak": np.exp(-(((TIME - 5) / 0.02) ** 2)),
    "steps": np.where(TIME % 2 < 1, 1.0, 0.2),
    "two levels": np.where(TIME % 2 < 1, 1.0, -1.0),
    "ramp far from zero": 1e3 + TIME,
}


@pytest.mark.parametrize("name", SEEN)
def test_the_first_level_is_barely_exceeded_and_the_last_one_often(name):
    seen = SEEN[name]
    levels, span = exceeded(seen), np.ptp(seen)
    assert levels == sorted(levels, reverse=True)
    assert 0 < seen.max() - levels[0] <= 0.0101 * span
    assert np.mean(seen > levels[-1]) > 0.24 or seen.max() - levels[-1] >= 0.3 * span * (1 - 1e-6)
    assert all(np.any(seen > level) for level in levels)


@pytest.mark.parametrize("name", SEEN)
def test_what_falls_below_is_the_mirror_image(name):
    assert fallen_below(SEEN[name]) == [-level for level in exceeded(-SEEN[name])]


def test_levels_are_clearly_apart():
    for seen in SEEN.values():
        depths = seen.max() - np.array(exceeded(seen))
        assert np.all(depths[1:] > 1.4 * depths[:-1])


def test_what_stands_still_exceeds_nothing():
    assert exceeded(np.full(9, 2.0)) == [] == fallen_below(np.zeros(3))
