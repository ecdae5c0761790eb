"""Steps of a minimisation: which trial is taken, and what is asked for it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hydrotwin.identification.least_squares import minimise
from hydrotwin.identification.shooting import Linearisation

EXPLODED = 1e12  # the cost of a run that diverged, which has no derivative


class Bowl:
    """``8 q^2`` by an expansion with less than half of its curvature, so that full steps overshoot.

    Derivatives explode beyond ``edge``, where the cost alone is as it was. asked : what was asked for, in order.
    """

    locals, count, until = 0, 1, np.inf
    free = SimpleNamespace(lower=-1e3, upper=1e3, logarithmic=np.array([False]), scaled=lambda v: np.array([v]))

    def __init__(self, edge: float = -np.inf):
        self.edge, self.asked = edge, []

    def cost(self, q, z, above=np.inf):
        self.asked.append("cost")
        return 8.0 * float(q[0]) ** 2

    def linearise(self, q, z, above=np.inf):
        self.asked.append("derivatives")
        if q[0] < self.edge:
            none = np.zeros((1, 1))
            return Linearisation(EXPLODED, np.array([EXPLODED]), np.array([True]), none, none[None])
        cost = 8.0 * float(q[0]) ** 2
        return Linearisation(
            cost, np.array([cost]), np.array([False]), 16.0 * q[None], np.full((1, 1, 1), 7.0)
        )  # fmt: skip


def ended(bowl: Bowl, begin: float = 1.0):
    return minimise(bowl, np.array([begin]), np.zeros((1, 0)), absolute=1e-9, stalled=1e-12)


def test_a_point_from_which_derivatives_explode_is_not_taken_though_its_cost_is_less():
    found = ended(Bowl(edge=0.05))
    assert found.cost < 8.0 and not found.at.diverged.any() and found.q[0] >= 0.05


def test_after_a_step_that_had_to_be_shortened_the_cost_alone_is_asked_first():
    bowl = Bowl()
    found = ended(bowl, begin=0.1)
    assert found.cost == pytest.approx(0.0, abs=1e-6)
    assert bowl.asked[:3] == ["derivatives", "derivatives", "cost"], "the first trial overshoots"
    taken = [i for i, what in enumerate(bowl.asked) if what == "derivatives" and bowl.asked[i - 1] == "cost"]
    assert taken and bowl.asked[taken[0] + 1] == "cost", "also of the trial after the one that was taken"
