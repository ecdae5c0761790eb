"""What a fit leaves with its model: where it comes from, and the block [credibility] of its file."""

from __future__ import annotations

from collections.abc import Sequence

from hydrotwin.models.language.credibility import FIT, IDENTIFY, JUDGE, Evidence, now, recording_rows, versions
from hydrotwin.models.language.provenance import ASKED, RECORDINGS, SPREAD
from hydrotwin.records import Record

from .bands import Spread
from .fit import Fit

MODE = "free run"
ROLES = {"train": FIT, "validate": JUDGE}


def provenance_of_fit(fit: Fit) -> dict:
    """What the fitted model says of its making: recordings, noise, errors, and how sure the fit is (`Spread`)."""
    return made_by_fit(fit) | {
        "chi2_per_sample": float(fit.chi2_per_dof),
        "noise": dict(fit.noise),
        "rmse": fit.rmse,
        "accuracy": fit.accuracy.as_data() if fit.accuracy else {},
        "findings": [str(f) for f in fit.findings],
        ASKED: {key: value for key, value in fit.settings.items() if value is not None},
    }


def made_by_fit(fit: Fit) -> dict:
    """Which recordings a fitted model follows, and how sure the fit is, where it tells that."""
    sure = {SPREAD: Spread.of(fit).told()} if getattr(fit, "covariance", None) is not None else {}
    return {RECORDINGS: recordings_of(fit)} | sure


def recordings_of(fit: Fit) -> list[dict[str, str]]:
    """Name, role and SHA-256 of the recordings of a fit."""
    return [{"name": r.name, "role": r.role, "sha256": r.digest or ""} for r in fit.records]


def evidence_of_fit(fit: Fit, train: Sequence[Record], judged: Sequence[Record]) -> Evidence:
    """Recordings, errors by output in both roles (SI), accuracy of the runs; ``contents`` is set by who writes it."""
    units = {r.output: r.unit for r in fit.residuals}
    metrics = [
        {"output": name, "unit": units[name], "role": ROLES[role], "mode": MODE, "rmse": rmse, "noise": fit.noise[name]}
        for role, by_output in fit.rmse.items()
        for name, rmse in by_output.items()
    ]
    unexplained = dict.fromkeys(r.output for r in fit.residuals if r.role == "train" and not r.explained)
    return Evidence(
        IDENTIFY, now(), "", versions(),
        (*recording_rows(train, FIT), *recording_rows(judged, JUDGE)),
        tuple(metrics),
        accuracy=fit.accuracy.as_data() if fit.accuracy else {},
        facts={"chi2_per_sample": float(fit.chi2_per_dof), "unexplained": list(unexplained)},
    )  # fmt: skip
