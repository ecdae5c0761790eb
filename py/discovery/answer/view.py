"""View: residuals before and after, by role and recording, as the answer shows them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.flat import FlatModel

from ..evidence.gaps import output_gap_closed, pooled_rmse
from ..fits.whole import Concluded
from ..recordings import Split
from .discovery import OutputGap, Overlay, RecordingGap


@dataclass(frozen=True, eq=False)
class View:
    """Residuals of two final fits; ``data.noise`` (ny,), SI, is that which all fits show."""

    flat: FlatModel
    data: Split
    before: Concluded
    after: Concluded

    def _pairs(self, role: str):
        d = self.data
        if role == "train":
            return list(zip(d.train, self.before.residuals_fit, self.after.residuals_fit, strict=True))
        return list(zip(d.report, self.before.residuals_report, self.after.residuals_report, strict=True))

    def _gaps(self, before: np.ndarray, after: np.ndarray) -> tuple[OutputGap, ...]:
        rows = zip(self.flat.outputs, self.data.noise, before, after, strict=True)
        return tuple(
            OutputGap(s.name, s.unit, float(n), float(b), float(a), output_gap_closed(b, a, n))
            for s, n, b, a in rows
            if np.isfinite(n) and not np.isnan(b)  # infinite: a run diverged, and that must be seen
        )

    def pooled(self, role: str) -> tuple[OutputGap, ...]:
        """Over all recordings of a role."""
        pairs = self._pairs(role)
        if not pairs:
            return ()
        _, before, after = zip(*pairs, strict=True)
        return self._gaps(pooled_rmse(before), pooled_rmse(after))

    def by_recording(self) -> tuple[RecordingGap, ...]:
        """Each recording, with the role it had."""
        rows = []
        for role, kind in (("train", "fit"), ("report", "report")):
            for recording, before, after in self._pairs(role):
                rows.append(RecordingGap(recording.name, kind, self._gaps(pooled_rmse([before]), pooled_rmse([after]))))
        return tuple(rows)

    def overlays(self) -> tuple[Overlay, ...]:
        """Measured, before and after on every recording, those never used first."""
        rows = []
        for role in ("report", "train"):
            for recording, before, after in self._pairs(role):
                seen = [j for j in range(len(self.flat.outputs)) if np.isfinite(recording.y[:, j]).any()]
                names = [self.flat.outputs[j].name for j in seen]
                columns = (recording.y, recording.y + before, recording.y + after)
                measured, old, new = ({n: c[:, j] for n, j in zip(names, seen, strict=True)} for c in columns)
                inputs = {s.name: recording.u[:, j] for j, s in enumerate(self.flat.inputs)}
                rows.append(Overlay(recording.name, role, recording.time, measured, old, new, inputs))
        return tuple(rows)
