"""Options that kinds share are refused alike, in one sentence."""

import pytest

from hydrotwin.learned.learning import trainer
from hydrotwin.learned.options import check_counts, check_lags, check_positive, check_tolerance
from hydrotwin.models.language.errors import DeclarationError

NO_NUMBER = [float("nan"), float("inf"), True, "5"]


@pytest.mark.parametrize("value", [*NO_NUMBER, 2.5, 1])
def test_a_count_is_a_whole_number_that_is_not_too_small(value):
    with pytest.raises(DeclarationError, match=r"learn_x: nodes must be a whole number from 2 up \(got "):
        check_counts("learn_x", {"nodes": (value, 2)})


@pytest.mark.parametrize("value", [*NO_NUMBER, 0, -0.1])
def test_an_amount_is_finite_and_above_zero(value):
    with pytest.raises(DeclarationError, match=r"learn_x: period must be positive .* Give seconds"):
        check_positive("learn_x", period=value)


@pytest.mark.parametrize("value", [*NO_NUMBER, -0.1, None])
def test_a_tolerance_is_a_share(value):
    with pytest.raises(DeclarationError, match="tolerance must be 0 or more"):
        check_tolerance("learn_x", value)


@pytest.mark.parametrize(
    ("lags", "words"), [(3, "lags are two: past values"), ((1, 2, 3), "Write 2,6"), ((1, 0), r"lags\[1\] must be")]
)
def test_lags_are_two_counts(lags, words):
    with pytest.raises(DeclarationError, match=words):
        check_lags("learn_x", lags, "past values", "2,6")


def test_what_is_in_order_or_left_to_the_trainer_passes():
    check_counts("learn_x", {"nodes": (2, 2), "terms": (3.0, 1), "delay": (None, 0)})
    check_positive("learn_x", period=0.1, budget=None)
    check_tolerance("learn_x", 0)
    check_lags("learn_x", (0, 1), "past values", "2,6")
    check_lags("learn_x", None, "past values", "2,6")


@pytest.mark.parametrize("kind", ["arx", "linear", "nn", "gp", "grey_box", "symbolic", "narx", "state_nn"])
@pytest.mark.parametrize("period", [0.0, -1.0, float("nan"), float("inf")])
def test_every_kind_refuses_a_period_that_is_none(kind, period, any_record):
    with pytest.raises(DeclarationError, match=r"period must be positive .* Give seconds, such as 0\.01\."):
        trainer(kind)([any_record], ["u"], ["y"], period=period)


@pytest.fixture(scope="module")
def any_record():
    import numpy as np

    from hydrotwin.records import Record

    time = 0.02 * np.arange(400)
    return Record(time, {"u": np.sin(time), "y": np.cos(time)}, {"u": "1", "y": "m"}, "made up")
