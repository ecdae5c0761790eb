"""Fit: what an identification knows when it is done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.summary_html import SmallTable, summary_html
from hydrotwin.records.between import sentences
from hydrotwin.simulation.control import Accuracy

SIZE = 1.1  # of the noise, squared: as much may be noise
LARGE, CHANCE = 1.2, 1e-3  # the same of white residuals: an error of the estimated noise, or of few samples by chance
FAINT = 0.1  # correlation of neighbouring residuals that a test can see and an engineer need not mind


@dataclass(frozen=True)
class FittedParameter:
    """One free parameter: where it started, where it ended, how sure that is.

    ``sigma`` is the standard deviation allowing for coloured residuals (SI); nan when the value rests on a bound or
    the recordings do not determine it. ``bounds`` are those of the fit.
    """

    name: str
    value: float
    start: float
    sigma: float
    unit: str
    bounds: tuple[float, float]
    at_bound: bool
    sigma_white: float = np.nan

    @property
    def shift(self) -> float:
        """Change against the start, as a fraction of the start (of 1 where the start is zero)."""
        return (self.value - self.start) / (abs(self.start) or 1.0)


@dataclass(frozen=True)
class OutputResidual:
    """What is left on one output of one recording, in a free run from its estimated start.

    ``rmse`` and ``noise`` are in ``unit``; ``chi2_per_sample`` is (rmse/noise)^2, 1 when only noise is left.
    ``white`` is the verdict of a Ljung-Box test (``p_value``), ``lag_one`` the correlation of neighbouring residuals.
    ``rounding``: the output, or an input, is so coarsely recorded that what is left may be rounding, which repeats
    itself where a signal rests.
    """

    record: str
    output: str
    role: str
    rmse: float
    noise: float
    unit: str
    samples: int
    chi2_per_sample: float
    lag_one: float
    p_value: float
    white: bool
    rounding: bool = False

    @property
    def explained(self) -> bool:
        """Nothing is left but noise: less than that, or as much and neighbours say nothing of each other, or little."""
        as_noise = self.chi2_per_sample < SIZE and abs(self.lag_one) < FAINT
        as_scatter = self.white and self.chi2_per_sample < max(LARGE, chdtri(self.samples, CHANCE) / self.samples)
        return self.chi2_per_sample < 1.0 or self.rounding or as_noise or as_scatter


@dataclass(frozen=True)
class RecordFit:
    """One recording in the fit: its role ("train" or "validate"), its content hash, its estimated start states, and by
    what it is known again (`records.row_of`)."""

    name: str
    role: str
    digest: str | None
    samples: int
    start: Mapping[str, float]
    row: Mapping = field(default_factory=dict)


@dataclass(frozen=True)
class Finding:
    """One sentence about what the recordings can and cannot say, and the parameters it is about."""

    kind: str
    parameters: tuple[str, ...]
    sentence: str

    def __str__(self) -> str:
        return self.sentence


@dataclass(frozen=True)
class Iteration:
    """One accepted step: which stage, the cost (half the weighted sum of squares) after it, the damping."""

    stage: str
    number: int
    cost: float
    damping: float


@dataclass(frozen=True, eq=False)
class Fit:
    """The fitted model and everything known about the fit.

    cost : half the (robust) sum of squares of the free runs, each output weighed by one over ``allowed`` (its noise,
    or what the model leaves of it); chi2 : the plain sum of squares in units of the noise.
    covariance : of the free parameters in the order of ``parameters``, SI, allowing for coloured residuals
    (the sandwich); ``covariance_white`` is (J^T J)^-1. ``correlation`` belongs to ``covariance_white``: it is a
    property of the experiment. Rows of parameters at a bound or undetermined are nan.
    accuracy : of the training run that is furthest from that with half the step; None where an FMU runs itself.
    """

    name: str
    flat: FlatModel
    parameters: tuple[FittedParameter, ...]
    covariance: np.ndarray
    covariance_white: np.ndarray
    correlation: np.ndarray
    noise: Mapping[str, float]
    cost: float
    chi2: float
    degrees_of_freedom: int
    records: tuple[RecordFit, ...]
    residuals: tuple[OutputResidual, ...]
    findings: tuple[Finding, ...]
    history: tuple[Iteration, ...]
    converged: bool
    message: str
    seconds: float
    settings: Mapping[str, object] = field(default_factory=dict)
    allowed: Mapping[str, float] = field(default_factory=dict)
    accuracy: Accuracy | None = None

    @property
    def values(self) -> dict[str, float]:
        """Fitted values by path, SI."""
        return {p.name: p.value for p in self.parameters}

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviations by path, SI."""
        return {p.name: p.sigma for p in self.parameters}

    @property
    def chi2_per_dof(self) -> float:
        """1 when the model explains the training recordings up to the noise."""
        return self.chi2 / max(self.degrees_of_freedom, 1)

    @property
    def rmse(self) -> dict[str, dict[str, float]]:
        """RMSE by role ("train", "validate") and output, over all recordings of the role, SI."""
        pooled: dict[str, dict[str, float]] = {}
        for role in ("train", "validate"):
            rows = [r for r in self.residuals if r.role == role]
            for output in dict.fromkeys(r.output for r in rows):
                of = [r for r in rows if r.output == output]
                squares = sum(r.samples * r.rmse**2 for r in of)
                pooled.setdefault(role, {})[output] = float(np.sqrt(squares / sum(r.samples for r in of)))
        return pooled

    @property
    def provenance(self) -> dict[str, str | None]:
        """Content hashes of the recordings by name."""
        return {r.name: r.digest for r in self.records}

    def parameter(self, name: str) -> FittedParameter:
        """The row of one free parameter."""
        return next(p for p in self.parameters if p.name == name)

    def summary(self) -> str:
        """The fit as a table and sentences, for a terminal."""
        lines = [f"{self.name}: {self.message} ({self.seconds:.2f} s)"]
        for p in self.parameters:
            mark = "  at bound" if p.at_bound else ""
            sure = f"± {p.sigma:<9.2g}" if np.isfinite(p.sigma) else "± unknown "
            lines.append(f"  {p.name:<36} {p.start:>12.5g} -> {p.value:>12.5g} {sure} {p.unit}{mark}")
        for r in self.residuals:
            left = "noise only" if r.explained else f"{np.sqrt(r.chi2_per_sample):.2f} x noise, unexplained"
            lines.append(f"  {r.record} ({r.role}) {r.output}: RMSE {r.rmse:.4g} {r.unit} ({left})")
        return "\n".join(lines + [f"  {finding}" for finding in self.findings])

    def _repr_html_(self) -> str:
        units = {r.output: r.unit for r in self.residuals}
        errors = [(role, n, rmse, units[n]) for role, by in self.rmse.items() for n, rmse in by.items()]
        values = [(p.name, p.start, p.value, p.sigma, p.unit, "at bound" * p.at_bound) for p in self.parameters]
        tables = [
            SmallTable("Parameters, SI", ("parameter", "start", "value", "sigma", "unit", ""), values),
            SmallTable("Errors, SI", ("recordings", "output", "RMSE", "unit"), errors),
        ]
        facts = {"chi2 per degree of freedom": self.chi2_per_dof, "ended": self.message}
        notes = [f"{said}." for said in sentences(self.flat.inputs)] + [str(f) for f in self.findings]
        notes += [f"The runs are {self.accuracy}."] if self.accuracy else []
        return summary_html(f"Fit of {self.name}", self._verdict(), facts, tables, notes)

    def _verdict(self) -> str:
        """Whether more than noise is left in training, in a sentence."""
        trained = [r for r in self.residuals if r.role == "train"]
        left = dict.fromkeys(r.output for r in trained if not r.explained)
        if left:
            return f"More than noise is left on {', '.join(left)}."
        return "Nothing but noise is left in training." if trained else ""
