"""The metrics against figures worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.comparison import errors_of
from hydrotwin.models.language.errors import DataError

MEASURED = np.array([0.0, 2.0, 4.0, 6.0])
PREDICTED = np.array([1.0, 2.0, 1.0, 6.0])  # errors 1, 0, -3, 0


def test_metrics_are_those_worked_out_by_hand():
    e = errors_of(MEASURED, PREDICTED)
    assert e.rmse == pytest.approx(np.sqrt(10 / 4))
    assert e.mae == pytest.approx(1.0)
    assert e.maximum == pytest.approx(3.0)
    assert e.fit_percent == pytest.approx(100 * (1 - np.sqrt(10) / np.sqrt(20)))
    assert (e.bias, e.lowest, e.highest) == pytest.approx((-0.5, -3.0, 1.0))
    assert e.deviation == pytest.approx(np.sqrt(10 / 4 - 0.25))
    assert e.samples == 4


def test_the_papers_equation_18_is_the_mean_absolute_error():
    e = PREDICTED - MEASURED
    assert errors_of(MEASURED, PREDICTED).mae == pytest.approx(np.sum(np.sqrt(e**2)) / len(e))


def test_samples_that_were_not_measured_are_left_out():
    measured = np.array([0.0, np.nan, 4.0, 6.0])
    predicted = np.array([1.0, np.nan, 1.0, 6.0])
    e = errors_of(measured, predicted)
    assert e.samples == 3
    assert e.mae == pytest.approx(4 / 3)


def test_a_signal_that_rests_has_no_fit():
    assert np.isnan(errors_of(np.full(600, np.radians(7.0)), np.linspace(0, 1, 600)).fit_percent)  # its mean is rounded
    assert np.isnan(errors_of(np.ones(4), PREDICTED).fit_percent)


def test_the_mean_of_the_measurement_as_prediction_fits_zero_percent():
    assert errors_of(MEASURED, np.full(4, MEASURED.mean())).fit_percent == pytest.approx(0.0)


def test_a_prediction_that_is_not_finite_names_the_sample():
    with pytest.raises(DataError, match="sample 2 of 4"):
        errors_of(MEASURED, np.array([0.0, 0.0, np.nan, 0.0]))


def test_nothing_measured_is_refused():
    with pytest.raises(DataError, match="no finite sample"):
        errors_of(np.full(4, np.nan), PREDICTED)


def test_errors_whose_squares_no_number_holds_are_refused():
    """They had been infinite, and the page of a comparison ended in a traceback."""
    with pytest.raises(DataError, match=r"beyond numbers \(got up to 1e\+300"):
        errors_of(np.array([0.0, 1.0]), np.array([1e300, 1.0]))
