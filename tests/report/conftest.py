"""One comparison of toys with everything a report must show, and its written report."""

from __future__ import annotations

from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from hydrotwin.comparison import HoldLast, compare
from hydrotwin.report import write_report
from hydrotwin.simulation.block import TrainingDomain
from tests.comparison.toys import ANGLE, OUTPUTS, SPEED, Toy, recording

DATE = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)


def parameter(name, value, start, sigma, unit, at_bound=False):
    return SimpleNamespace(
        name=name, value=value, start=start, sigma=sigma, unit=unit, at_bound=at_bound, shift=(value - start) / start
    )


def left_over(output, rmse, noise, unit, explained):
    return SimpleNamespace(
        output=output,
        record="training_1",
        role="train",
        rmse=rmse,
        noise=noise,
        unit=unit,
        samples=800,
        chi2_per_sample=(rmse / noise) ** 2,
        lag_one=0.02,
        white=explained,
        explained=explained,
    )


@pytest.fixture(scope="session")
def fit():
    """A fit by the documented attributes alone."""
    return SimpleNamespace(
        name="toy",
        parameters=(
            parameter("motor.gain", 119.7, 100.0, 0.05, "rad/(s.V)"),
            parameter("cylinder.oil.bulk_modulus", 1.62e9, 1.747e9, 4e7, "Pa"),
            parameter("cylinder.cap_dead_volume", 1e-4, 8e-5, float("nan"), "m3", at_bound=True),
        ),
        residuals=(
            left_over("arm_angle", 2e-4, 2e-4, "rad", True),
            left_over("pressure_cap", 2.4e4, 8e3, "Pa", False),
        ),
        findings=("identify: motor.gain and pump.displacement cannot be told apart.",),
        noise={"arm_angle": 2e-4},
        cost=100.0,
        chi2=200.0,
        seconds=1.3,
    )


@pytest.fixture(scope="session")
def comparison():
    """Five models, three recordings, both modes; one failure, one unscored output, one training domain."""
    contenders = [
        Toy("identified physics"),
        Toy("catalogue physics", gain=126.0, stiffness=4.3e6),
        Toy("formula", "formula", drift=2e-3, outputs=(ANGLE,), fails_on="validation_3"),
        Toy(
            "network",
            "network",
            bend=4e-3,
            outputs=(ANGLE, SPEED),
            domain=TrainingDomain(("command", "arm_angle"), (-2.5, 0.2), (2.5, 0.6)),
        ),
        HoldLast(OUTPUTS),
    ]
    records = [recording(k) for k in (1, 2, 3)]
    return compare(contenders, records, train_records=[recording(9, name="training_1")], title="Toys </script> & more")


@pytest.fixture(scope="session")
def report(comparison, fit, tmp_path_factory):
    """Paths of the written report."""
    folder = tmp_path_factory.mktemp("report")
    return write_report(comparison, folder, fits=[fit], command="hydrotwin compare toys.toml", date=DATE)
