"""What the gap workflow leaves in the block [credibility] of its model file."""

from __future__ import annotations

from collections.abc import Sequence

from hydrotwin.identification.evidence import MODE, ROLES, names_of
from hydrotwin.models.language.credibility import FIT, GAP, JUDGE, Evidence, now, recording_rows, versions
from hydrotwin.records import Record, row_of

from .discovery import Discovery


def evidence_of_gap(found: Discovery, train: Sequence[Record], judged: Sequence[Record]) -> Evidence:
    """Recordings, errors by output before and after (SI), the verdict; ``contents`` is set by who writes it."""
    metrics = [
        {
            "output": gap.output, "unit": gap.unit, "role": ROLES[role], "mode": MODE,
            "rmse": gap.rmse_after, "rmse_before": gap.rmse_before, "noise": gap.noise,
        }
        for role, gaps in found.outputs.items()
        for gap in gaps
    ]  # fmt: skip
    accuracy = getattr(found.fit_after, "accuracy", None)
    effects = [{"effect": s.effect, "site": s.site, "probability": float(s.probability)} for s in found.steps]
    return Evidence(
        GAP, now(), "", versions(),
        (*(row_of(r, names_of(found.model.flat), FIT) for r in train), *recording_rows(judged, JUDGE)),
        tuple(metrics),
        accuracy=accuracy.as_data() if accuracy else {},
        facts={"verdict": found.verdict, "effects": effects},
    )  # fmt: skip
