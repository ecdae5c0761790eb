"""Sensitivity: which parameter drives which output where, what recordings cannot tell, what to measure next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.summary_html import SmallTable, summary_html

from ..fit import Finding
from .information import Known
from .intervals import Interval
from .local import Local
from .measurements import Measurement
from .sobol import Global, Indices

FORMAT = "hydrotwin-sensitivity/1"
DRIVES = 0.1  # share of the variance of an output from which on a parameter drives it
NAMED = 3  # parameters of an output that a sentence names


@dataclass(frozen=True)
class StudiedRecord:
    """One recording: its content hash, samples, and the times [s] between which its stretches lie."""

    name: str
    digest: str | None
    samples: int
    edges: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The answer of `sensitivity`.

    local : exact sensitivities at the values of the model; sobol : indices over the intervals, None without samples.
    known : what the recordings say of the parameters. measurements : what to measure next, the best first.
    findings : in sentences, what they cannot say, and what to mind.
    """

    name: str
    parameters: tuple[Interval, ...]
    outputs: tuple[Signal, ...]
    records: tuple[StudiedRecord, ...]
    local: Local
    sobol: Global | None
    known: Known
    measurements: tuple[Measurement, ...]
    findings: tuple[Finding, ...]
    seconds: float
    settings: Mapping[str, object] = field(default_factory=dict)

    @property
    def shares(self) -> np.ndarray:
        """What each parameter does to each output, (ny, np): total Sobol indices, else shares of the local squares.

        Nan for an output that nothing moves, and where the samples do not tell (`Indices.vague`).
        """
        if self.sobol:
            return np.where(self.sobol.whole.vague[:, None], np.nan, self.sobol.whole.total)
        squares = self.local.moved**2
        whole = squares.sum(axis=1, keepdims=True)
        return np.where(whole > 0, squares / np.where(whole > 0, whole, 1.0), np.nan)

    def drivers(self, output: str) -> list[tuple[str, float]]:
        """Parameters that drive an output, the strongest first, with their share of its variance."""
        row = self.shares[[s.name for s in self.outputs].index(output)]
        ranked = sorted(zip((p.name for p in self.parameters), row, strict=True), key=lambda one: -one[1])
        return [(name, float(share)) for name, share in ranked if share >= DRIVES]

    def sentences(self) -> list[str]:
        """What drives each output, one sentence for those driven alike."""
        alike: dict[str, list[str]] = {}
        unknown = self.sobol.whole.vague if self.sobol else np.zeros(len(self.outputs), dtype=bool)
        for signal in (s for s, vague in zip(self.outputs, unknown, strict=True) if not vague):
            told = [f"{name} ({100 * share:.0f} %)" for name, share in self.drivers(signal.name)[:NAMED]]
            alike.setdefault(_listed(told), []).append(signal.name)
        return [
            f"{_listed(outputs)} {'is' if len(outputs) == 1 else 'are'} driven by {drivers}."
            if drivers
            else f"{_listed(outputs)}: nothing asked about moves {'it' if len(outputs) == 1 else 'them'}."
            for drivers, outputs in alike.items()
        ]

    def as_data(self) -> dict:
        """Everything as plain data, SI; see docs/validation.md for its shape."""
        names, outputs = [p.name for p in self.parameters], [s.name for s in self.outputs]
        return {
            "format": FORMAT,
            "model": self.name,
            "parameters": [
                {"name": p.name, "unit": p.unit, "value": p.value, "low": p.low, "high": p.high, "source": p.source}
                for p in self.parameters
            ],
            "outputs": [
                {"name": s.name, "unit": s.unit, "range": float(r), "noise": float(n)}
                for s, r, n in zip(self.outputs, self.local.range, self.known.noise, strict=True)
            ],
            "recordings": [
                {"name": r.name, "sha256": r.digest or "", "samples": r.samples, "edges": list(r.edges)}
                for r in self.records
            ],
            "local": {
                "moved": _by_name(self.local.moved, outputs, names),
                "share": _by_name(self.local.share, outputs, names),
                "stretches": {
                    r.name: [_by_name(part, outputs, names) for part in parts]
                    for r, parts in zip(self.records, self.local.by_stretch, strict=True)
                },
            },
            "sobol": self._sobol_data(outputs, names),
            "correlation": {"parameters": names, "matrix": self.known.correlation.tolist()},
            "measure_next": [m.as_data() for m in self.measurements],
            "findings": [{"kind": f.kind, "parameters": list(f.parameters), "sentence": str(f)} for f in self.findings],
            "settings": dict(self.settings),
            "seconds": self.seconds,
        }

    def _sobol_data(self, outputs: Sequence[str], names: Sequence[str]) -> dict | None:
        if self.sobol is None:
            return None

        def told(one: Indices) -> dict:
            parts = {"first": one.first, "first_half": one.first_half, "total": one.total, "total_half": one.total_half}
            spread = dict(zip(outputs, one.spread.tolist(), strict=True))
            return {key: _by_name(part, outputs, names) for key, part in parts.items()} | {"spread": spread}

        found = self.sobol
        return {
            "of": found.sampling.of,
            "seed": found.sampling.seed,
            "samples": found.sampling.samples,
            "sets": found.sets,
            "diverged": found.diverged,
            "used": found.used,
            "whole": told(found.whole),
            "stretches": {
                r.name: [told(part) for part in parts] for r, parts in zip(self.records, found.by_stretch, strict=True)
            },
        }

    def summary(self) -> str:
        """The answer as sentences, for a terminal."""
        lines = [
            f"{self.name}: {len(self.parameters)} parameters, {len(self.records)} recordings ({self.seconds:.2f} s)"
        ]
        told = [*self.sentences(), *map(str, self.findings), *(m.sentence for m in self.measurements[:NAMED])]
        return "\n".join([*lines, *(f"  {sentence}" for sentence in told)])

    def _repr_html_(self) -> str:
        headings = ("output", *(p.name for p in self.parameters))
        what = "Total Sobol indices" if self.sobol else "Shares of the local squares"
        rows = [(s.name, *map(float, row)) for s, row in zip(self.outputs, self.shares, strict=True)]
        facts = {"parameters": len(self.parameters), "recordings": len(self.records)}
        facts |= {"sets": self.sobol.sets, "diverged": self.sobol.diverged} if self.sobol else {}
        tables = [SmallTable(what, headings, rows)]
        notes = [*map(str, self.findings), *(m.sentence for m in self.measurements[:1])]
        return summary_html(f"Sensitivity of {self.name}", " ".join(self.sentences()), facts, tables, notes)


def _by_name(values: np.ndarray, outputs: Sequence[str], names: Sequence[str]) -> dict[str, dict[str, float]]:
    return {o: dict(zip(names, map(float, row), strict=True)) for o, row in zip(outputs, values, strict=True)}


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else "".join(words)
