"""What a fit leaves with its model: where it comes from, and the block [credibility] of its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hydrotwin.models.language.credibility import FIT, IDENTIFY, JUDGE, Evidence, now, recording_rows, versions
from hydrotwin.models.language.provenance import ASKED, MARKED, RECORDINGS, SAMPLES, SPREAD, TRAIN
from hydrotwin.records import Record, row_of

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
    """Name, role and SHA-256 of the recordings of a fit, of those that values follow with marks."""
    return [
        {"name": r.name, "role": r.role, "sha256": r.digest or ""} | (_marks(r.row) if r.role == TRAIN else {})
        for r in fit.records
    ]


def names_of(flat) -> list[str]:
    """Columns of recordings that a model is about."""
    return [s.name for s in (*flat.inputs, *flat.outputs)]


def _marks(row: Mapping) -> dict:
    return {key: row[key] for key in (SAMPLES, MARKED) if key in row}


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
        (*(row_of(r, names_of(fit.flat), FIT) for r in train), *recording_rows(judged, JUDGE)),
        tuple(metrics),
        accuracy=fit.accuracy.as_data() if fit.accuracy else {},
        facts={"chi2_per_sample": float(fit.chi2_per_dof), "unexplained": list(unexplained)},
    )  # fmt: skip
