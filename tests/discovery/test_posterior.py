"""The posterior against numbers worked out by hand."""

import numpy as np
import pytest

from hydrotwin.discovery.evidence.deciding import DECIDING
from hydrotwin.discovery.evidence.posterior import Prices, posterior, temperature

PRICES = Prices(100, 10_000)
NAME, VALUE = np.log(100), 0.5 * np.log(10_000)


def of(rough=None, **scores):
    """Posterior of structures a, b, ab, ... by their scores; ``base`` is the empty one."""
    keys = {name: () if name == "base" else tuple(name) for name in scores}
    said = {keys[n]: s for n, s in scores.items()}
    loose = {keys[n]: (rough or {}).get(n, s) for n, s in scores.items()}
    return posterior(said, loose, {k: len(k) for k in said}, PRICES)


def test_a_base_that_leaves_nothing_lacks_nothing():
    said = of(base=0.0, a=0.0)
    assert said.structures[()] > 0.999
    assert said.best == ()


def test_a_structure_that_leaves_nothing_of_a_large_gap_is_as_sure_as_the_catalogue_is_complete():
    said = of(base=3000.0, a=0.0, b=2000.0)
    assert said.structures[("a",)] == pytest.approx(1 - DECIDING.something_else, abs=1e-3)
    assert said.else_ == pytest.approx(DECIDING.something_else, abs=1e-3)
    assert said.class_() == [("a",)]


def test_what_leaves_a_good_part_is_something_else():
    said = of(base=3000.0, a=500.0, b=2000.0)
    assert said.else_ > 0.999
    assert said.best == ("a",)


def test_two_that_leave_as_little_share_and_are_a_class():
    said = of(base=3000.0, a=0.0, b=1.0)
    ratio = said.structures[("b",)] / said.structures[("a",)]
    assert ratio == pytest.approx(np.exp(-1.0 / temperature(3000.0)), rel=1e-6)
    assert said.class_() == [("a",), ("b",)]


def test_a_second_effect_must_gain_what_its_name_and_value_cost():
    price = NAME + VALUE
    assert of(base=200.0, a=price - 1, ab=0.0).best == ("a",)
    assert of(base=200.0, a=price + 1, ab=0.0).best == ("a", "b")
    large = DECIDING.tempered * 10_000  # of a large gap it must gain more: no law is exact
    assert of(base=10_000.0, a=large * (price - 1), ab=0.0).best == ("a",)


def test_a_pair_is_as_sure_as_a_single_and_a_run_that_diverged_is_never_probable():
    said = of(base=3000.0, a=1000.0, ab=0.0, c=np.inf)
    assert said.structures[("a", "b")] == pytest.approx(1 - DECIDING.something_else, abs=1e-3)
    assert ("c",) not in said.structures


def test_a_law_that_is_only_roughly_the_machines_is_named_but_less_surely():
    said = of(base=3000.0, a=400.0, rough={"a": 0.0})
    r, e = DECIDING.rarely, DECIDING.something_else
    assert said.structures[("a",)] == pytest.approx(r * (1 - e) / (r * (1 - e) + e), abs=1e-3)
