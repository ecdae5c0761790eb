"""The answer of `discover`: where the model disagrees, what is missing, how sure that is, and what it explains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.language.model import Model
from hydrotwin.models.language.summary_html import SmallTable, summary_html
from hydrotwin.records.between import sentences

from .going_on import experiment_sentence, untried_sentences
from .words import capitalised, said, sentence

VERDICTS = ("named", "class", "none", "unknown")
FATES = ("named", "in class", "rejected", "not fitted", "not testable", "cannot be added")


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an added effect, SI; ``typical``: the catalogue's range.

    sigma : of the fit, as if the law were exact. low, high : 95 % interval, which also allows for a law that the
    machine keeps to within 2 % (one sigma): stick-slip, knees and ripples are never quite the catalogue's. Both are nan
    where it was fitted for the search alone, and where it rests ``at_bound``, with the cost still falling beyond.
    """

    name: str
    value: float
    unit: str
    sigma: float
    low: float
    high: float
    description: str = ""
    typical: tuple[float, float] | None = None
    at_bound: bool = False


@dataclass(frozen=True)
class Ranked:
    """One effect at one site beside those named before it, with what speaks for and against it.

    share : part of the gap that a look promises it would close, 0..1; nan where nobody looked.
    left : nats S that it leaves of whole recordings (nan when not fitted): none is a right structure's.
    gap_closed : 1 - (MSE_after - noise^2)/(MSE_before - noise^2), pooled over outputs; nan when not fitted.
    probability : that it is missing. fate : one of FATES; ``reason`` says in a sentence why.
    """

    effect: str
    site: str
    title: str
    equation: str
    share: float
    left: float
    gap_closed: float
    probability: float
    fate: str
    reason: str = ""
    parameters: tuple[EffectParameter, ...] = ()

    @property
    def label(self) -> str:
        """``effect at site``."""
        return f"{self.effect} at {self.site}" if self.site else self.effect


@dataclass(frozen=True)
class Step:
    """One effect that was named and added, the first of ``ranked`` that was; its class in order of probability.

    together : other (effect, site) of the same step when only the pair explains anything.
    beside : the other (effect, site) that were in place when it was looked for, which ``ranked`` shows.
    """

    effect: str
    site: str
    title: str
    equation: str
    source: str
    members: tuple[tuple[str, str], ...]
    probability: float
    parameters: tuple[EffectParameter, ...]
    gap_closed: float
    ranked: tuple[Ranked, ...]
    together: tuple[tuple[str, str], ...] = ()
    sentence: str = ""
    beside: tuple[tuple[str, str], ...] = ()

    @property
    def is_class(self) -> bool:
        """More than one effect explains the recordings as well."""
        return len({effect for effect, _ in self.members}) > 1


@dataclass(frozen=True)
class OutputGap:
    """RMSE of one output before and after, SI, over some recordings; ``noise`` is the sensor's standard deviation.

    gap_closed is nan when there was no measurable gap (MSE_before < 1.02 noise^2).
    """

    output: str
    unit: str
    noise: float
    rmse_before: float
    rmse_after: float
    gap_closed: float


@dataclass(frozen=True)
class RecordingGap:
    """The same for one recording in one role: "fit", "select" or "report"."""

    record: str
    role: str
    outputs: tuple[OutputGap, ...]


@dataclass(frozen=True, eq=False)
class Region:
    """Mean residual of one output over bins of one quantity, SI, before and after, on the same bins.

    edges (n+1,), mean_* and error_* (n,) (standard error, autocorrelation counted), significant_* (n,) after Holm.
    """

    output: str
    unit: str
    over: str
    over_unit: str
    edges: np.ndarray
    mean_before: np.ndarray
    error_before: np.ndarray
    significant_before: np.ndarray
    mean_after: np.ndarray
    error_after: np.ndarray
    significant_after: np.ndarray


@dataclass(frozen=True)
class Location:
    """Where one output disagrees before anything is added: rmse over noise, whiteness, the readable rule.

    where : sentence such as "arm_angle is 4.1 noise off where velocity < -0.01 m/s".
    drivers : (quantity, correlation, lag [s]) of inputs that the residual follows.
    """

    output: str
    times_noise: float
    white: bool
    where: str
    drivers: tuple[tuple[str, float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Overlay:
    """Measured and simulated, SI, of one recording: {output: (n,)}."""

    record: str
    role: str
    time: np.ndarray
    measured: Mapping[str, np.ndarray]
    before: Mapping[str, np.ndarray]
    after: Mapping[str, np.ndarray]
    inputs: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Shift:
    """How one free parameter of the base model moved when the effects were added, SI."""

    name: str
    unit: str
    before: float
    sigma_before: float
    after: float
    sigma_after: float
    at_bound: bool = False


@dataclass(frozen=True)
class Rung:
    """One bar of the waterfall: root of the pooled (RMSE/noise)^2 that the search left after this effect.

    On the recordings that chose; where none did, on those that were fitted to.
    """

    label: str
    times_noise: float


@dataclass(frozen=True, eq=False)
class Unknown:
    """What is left without a physical name: a regression of the projected residual on what was seen.

    explained : share of the squared residual the description explains on the recordings that chose; where none did, on
    the second half of each.
    """

    output: str
    unit: str
    inputs: tuple[str, ...]
    explained: float
    sentence: str
    formula: str = ""


@dataclass(frozen=True, eq=False)
class Experiment:
    """The input, within its limits, that separates the members of a class best.

    separation : predicted difference of the members over the noise, root mean square; ``now``: on these recordings.
    """

    input: str
    unit: str
    time: np.ndarray
    values: np.ndarray
    kind: str
    separation: float
    now: float
    sentence: str


@dataclass(frozen=True, eq=False)
class Discovery:
    """Everything the gap workflow found.

    base, model : the identified model before, and with the named effects (the same when nothing was named).
    fit_before, fit_after : the `Fit` of each on all fit recordings.
    outputs : per role ("train", "validate") the pooled OutputGap of every output.
    screened : how many candidates were looked at, each an effect at a place; fitted : how many of them were fitted.
    probabilities : of "nothing", of every structure that is likely enough to tell, of effects that were "not looked
    at" before the time limit, and of "something else".
    untried : what a longer search would try next, labels; only of one that its limit ended.
    given : how many recordings were given by role, a lone one counted once though it is cut into parts.
    seconds : of the whole search [s], of all its parts when it was interrupted.
    reason : why there is no name, where more is known than the verdict says.
    assumptions : what had been assumed about the recordings and was given up, a sentence each.
    """

    name: str
    verdict: str
    steps: tuple[Step, ...]
    base: Model
    model: Model
    fit_before: object
    fit_after: object
    noise: Mapping[str, float]
    outputs: Mapping[str, tuple[OutputGap, ...]]
    recordings: tuple[RecordingGap, ...]
    locations: tuple[Location, ...]
    regions: tuple[Region, ...]
    overlays: tuple[Overlay, ...]
    shifts: tuple[Shift, ...]
    waterfall: tuple[Rung, ...]
    last_ranked: tuple[Ranked, ...] = ()
    unknown: tuple[Unknown, ...] = ()
    experiment: Experiment | None = None
    findings: tuple[str, ...] = ()
    not_testable: tuple[Ranked, ...] = ()
    screened: int = 0
    fitted: int = 0
    given: Mapping[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    provenance: Mapping = field(default_factory=dict)
    reason: str = ""
    probabilities: Mapping[str, float] = field(default_factory=dict)
    untried: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    @property
    def answer(self) -> str:
        """The result in a sentence."""
        return " ".join([said(self.verdict, self.steps, self.reason), *map(capitalised, self.assumptions)])

    def _repr_html_(self) -> str:
        found = [row for step in self.steps for row in _rows(step)]
        rows = [(p.name, p.value, p.sigma, p.unit) for s in self.steps for p in s.parameters]
        gaps = [(role, o.output, o.rmse_before, o.rmse_after, o.noise, o.unit) for role, o in self._gaps()]
        tables = [
            SmallTable("Missing effects", ("effect", "at", "probability [%]", "gap closed [%]"), found),
            SmallTable("Their parameters, SI", ("parameter", "value", "sigma", "unit"), rows),
            SmallTable("Errors, SI", ("recordings", "output", "RMSE before", "after", "noise", "unit"), gaps),
        ]
        facts = {"verdict": self.verdict, "looked at": self.screened, "fitted": self.fitted}
        return summary_html(f"Discovery on {self.name}", self.answer, facts, tables, self._notes())

    def _notes(self) -> list[str]:
        """What a reader is told below the tables, as on the screen."""
        reached = getattr(self.fit_after, "accuracy", None)
        told = [*untried_sentences(self), *(f"{said}." for said in sentences(self.model.flat.inputs))]
        told += [experiment_sentence(self)] if any(s.is_class for s in self.steps) else []
        told += [sentence(f"The runs are {reached}")] if reached else []
        return told + [sentence(str(f)) for f in self.findings]

    def _gaps(self) -> list[tuple[str, OutputGap]]:
        return [(role, gap) for role, gaps in self.outputs.items() for gap in gaps]


def _rows(step: Step) -> list[tuple]:
    """One effect, the others of its class below it, and those that belong to it."""
    others = [(f"or {e}", site) for e, site in step.members if (e, site) != (step.effect, step.site)]
    others += [(f"with {e}", site) for e, site in step.together]
    first = (step.title, step.site, 100 * step.probability, 100 * step.gap_closed)
    return [first, *((*other, None, None) for other in others)]
