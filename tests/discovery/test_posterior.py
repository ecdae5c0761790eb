"""The posterior against numbers worked out by hand."""

import numpy as np
import pytest

from hydrotwin.discovery.evidence.deciding import DECIDING
from hydrotwin.discovery.evidence.posterior import Posterior, Prices, posterior, temperature

PRICES = Prices(100, 10_000)
KNOWN, ELSE = 1 - DECIDING.something_else, DECIDING.something_else
NAME, VALUE = np.log(100), 0.5 * np.log(10_000)


def of(rough=None, **scores):
    """Posterior of structures a, b, ab, ... by their scores; ``base`` is the empty one."""
    keys = {name: () if name == "base" else tuple(name) for name in scores}
    said = {keys[n]: s for n, s in scores.items()}
    loose = {keys[n]: (rough or {}).get(n, s) for n, s in scores.items()}
    return posterior(said, loose, said, {k: len(k) for k in said}, PRICES)


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


# -- by hand: a name of a hundred costs ln 100, its value half of ln 10 000, together a factor of 1e-4 -----------------
def test_one_effect_against_nothing():
    said = of(base=10.0, a=0.0)
    nothing, one, other = KNOWN * np.exp(-10.0), KNOWN * 1e-4, ELSE * 1e-4
    whole = nothing + one + other
    assert said.structures == pytest.approx({(): nothing / whole, ("a",): one / whole})
    assert said.else_ == pytest.approx(other / whole)


def test_a_pair_against_one_of_it_and_something_else():
    said = of(base=60.0, a=12.0, ab=0.0)
    one, pair, other = KNOWN * 1e-4 * np.exp(-12.0), KNOWN * 1e-8, ELSE * 1e-8
    whole = one + pair + other + KNOWN * np.exp(-60.0)
    assert said.structures[("a",)] == pytest.approx(one / whole)
    assert said.structures[("a", "b")] == pytest.approx(pair / whole)
    assert said.else_ == pytest.approx(other / whole), "as dear as the best"


def test_a_rough_law_counts_with_its_prior():
    said, r = of(base=60.0, a=30.0, rough={"a": 4.0}), DECIDING.rarely
    one = KNOWN * 1e-4 * ((1 - r) * np.exp(-30.0) + r * np.exp(-4.0))
    assert said.structures[("a",)] == pytest.approx(one / (one + ELSE * 1e-4 + KNOWN * np.exp(-60.0)))


def test_without_any_effect_it_is_nothing_or_something_else():
    said = of(base=8.0)
    nothing, other = KNOWN * np.exp(-8.0), ELSE * 1e-4
    assert said.else_ == pytest.approx(other / (nothing + other))


def test_more_parameters_cost_half_a_logarithm_each():
    assert PRICES.of(1, 3) == pytest.approx(np.log(100) + 1.5 * np.log(10_000))
    assert PRICES.of(2, 2) == pytest.approx(2 * PRICES.of(1, 1))
    assert np.isfinite(Prices(0, 0).of(1, 1)) and Prices(1, 1).of(1, 1) > 0


def test_differences_count_in_units_of_a_five_hundredth_of_the_gap_where_it_is_large():
    assert [temperature(s) for s in (0.0, 500.0, 5000.0)] == [1.0, 1.0, 10.0]
    said = of(base=5000.0, a=0.0, b=20.0)
    assert said.structures[("b",)] / said.structures[("a",)] == pytest.approx(np.exp(-2.0))


def test_probabilities_add_up_to_one():
    said = of(base=300.0, a=20.0, b=25.0, ab=1.0, c=280.0)
    assert sum(said.structures.values()) + said.else_ == pytest.approx(1.0)


def test_a_class_holds_95_percent_of_what_is_known_and_nothing_below_a_hundredth():
    def class_(**p):
        return Posterior({tuple(k): v for k, v in p.items()}, 0.0, {}).class_()

    assert class_(a=0.6, b=0.3, c=0.08, d=0.02) == [("a",), ("b",), ("c",)]
    assert class_(a=0.96, b=0.04) == [("a",)]
    assert class_(a=0.94, **{c: 0.006 for c in "bcdefghijk"}) == [("a",)]
    assert Posterior({("a",): 0.06, ("b",): 0.04}, 0.9, {}).class_() == [("a",), ("b",)], "shares of what is known"


def test_effects_that_nobody_looked_at_keep_their_priors():
    said = {(): 3000.0, ("a",): 0.0}
    half = posterior(said, said, said, {(): 0, ("a",): 1}, PRICES, unseen=1.0)
    assert half.unseen == pytest.approx(half.structures[("a",)], rel=DECIDING.rarely + 1e-6)
    assert half.unseen + half.else_ + sum(half.structures.values()) == pytest.approx(1.0)
    assert half.best == ("a",) and half.class_() == [("a",)]
