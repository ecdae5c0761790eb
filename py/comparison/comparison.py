"""The answer of `compare`: scores, trajectories and everything the report needs, all in SI."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hydrotwin.models.language.flat import ParameterValue, Signal
from hydrotwin.models.language.summary_html import SmallTable, summary_html
from hydrotwin.records import Record, copies, follows, row_of

from .band import Band
from .field import FieldMetrics
from .metric import AT_TIMES
from .residual import Residual
from .starts import Started

if TYPE_CHECKING:
    import pyarrow

FREE_RUN, ONE_STEP = "free run", "one step"
MODES = (FREE_RUN, ONE_STEP)
MEAN = "mean"
_SHOWN = ("output", "model", "RMSE", "maximum", "unit", "fit [%]", "recordings")
OUTSIDE = 1.0  # % of the samples outside of what a model was trained on, from which on it is told


@dataclass(frozen=True)
class Score(FieldMetrics):
    """`Errors` and `FieldMetrics` of one model on one output of one recording, see there for the metrics.

    ``record`` is MEAN for the mean over the recordings; ``recordings`` counts those that went in.
    ``noise`` is the white noise of the measurement by itself (see `noise_floor`; nan for means and slopes).
    ``coverage`` is the share of the samples inside the model's 95 % band, ``nlpd`` and ``crps`` score it (see
    `hydrotwin.learned.bands`); nan for a model without a band. ``chance`` : how likely errors are as far off where
    nothing is missing, by what the fit knows of its parameters and the start, see `Moved.chance`; nan for other bands.
    ``relative`` is rmse over the smallest rmse of any model on the same recording, output and mode (1 = best).
    """

    model: str
    record: str
    output: str
    mode: str
    rmse: float
    mae: float
    maximum: float
    fit_percent: float
    unit: str
    relative: float = float("nan")
    bias: float = float("nan")
    deviation: float = float("nan")
    lowest: float = float("nan")
    highest: float = float("nan")
    samples: int = 0
    recordings: int = 1
    noise: float = float("nan")
    coverage: float = float("nan")
    nlpd: float = float("nan")
    crps: float = float("nan")
    chance: float = float("nan")

    @property
    def below_noise(self) -> bool:
        """Closer to the measurement than its noise allows."""
        return self.rmse < 0.7 * self.noise

    @property
    def too_good(self) -> bool:
        """One step ahead, and below the noise: it may have seen what it predicts."""
        return self.mode == ONE_STEP and self.below_noise


@dataclass(frozen=True)
class Trajectory:
    """What one model predicted for one recording; deviation : standard deviation (n,), SI, by output, if it has one."""

    model: str
    record: str
    mode: str
    prediction: Record
    deviation: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Timing:
    """Run time of a model: wall seconds per simulated second, median over ``runs`` timed runs of all recordings."""

    model: str
    mode: str
    seconds_per_simulated_second: float
    fastest: float
    slowest: float
    runs: int


@dataclass(frozen=True)
class Failure:
    """A model that could not be scored on a recording, and why."""

    model: str
    record: str
    mode: str
    sentence: str


@dataclass(frozen=True)
class Inaccurate:
    """A model whose run over a recording missed the accuracy, and by how much, in a sentence."""

    model: str
    record: str
    sentence: str


@dataclass(frozen=True)
class Unscored:
    """An output that could not be scored, and why."""

    model: str
    record: str
    output: str
    reason: str


@dataclass(frozen=True)
class DomainShare:
    """How much of a recording lies where the model was trained.

    inside_percent  share of samples inside the training box
    farthest        largest distance outside, in box widths
    beyond          quantities that leave the box; empty of an FMU, which tells the distance alone
    source          "model" (its own box) or "recordings" (the box of the training recordings; ``model`` is empty)
    """

    model: str
    record: str
    inside_percent: float
    farthest: float
    beyond: tuple[str, ...]
    source: str

    @property
    def extrapolates(self) -> str:
        """In a sentence, where a model runs outside of what it was trained on; empty where it hardly does."""
        outside = 100.0 - self.inside_percent
        if self.source != "model" or outside < OUTSIDE:
            return ""
        leave = f"{' and '.join(self.beyond) or 'it'} leave{'' if len(self.beyond) > 1 else 's'}"
        percent = f"{outside:.2g}" if outside < 99.5 else "100"
        return (
            f"{self.model} extrapolates in {percent} % of {self.record}: {leave} what it was trained on, "
            f"by up to {self.farthest:.2g} of its range."
        )


@dataclass(frozen=True)
class Entrant:
    """A contender as it was listed: what it is, without what it can do. ``bands``: those of its free run."""

    name: str
    kind: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: tuple[ParameterValue, ...] = ()
    provenance: Mapping = field(default_factory=dict)
    bands: tuple[Band, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Models against recordings.

    ``means`` are Scores with record = MEAN. ``records`` are the validation recordings, ``train_records`` those the
    models were made from. ``starts`` says how models start, where that was estimated. ``inaccurate`` are runs whose
    solver missed the accuracy. ``asked`` are the arguments of `compare` by which it can be made again, as data.
    ``whole`` : the recordings, by their names, before they were thinned out; empty where they were not.
    """

    title: str
    entrants: tuple[Entrant, ...]
    records: tuple[Record, ...]
    train_records: tuple[Record, ...]
    modes: tuple[str, ...]
    outputs: tuple[Signal, ...]
    scores: tuple[Score, ...]
    means: tuple[Score, ...]
    trajectories: tuple[Trajectory, ...]
    timings: tuple[Timing, ...]
    failures: tuple[Failure, ...]
    unscored: tuple[Unscored, ...]
    domains: tuple[DomainShare, ...]
    residuals: tuple[Residual, ...]
    starts: tuple[Started, ...] = ()
    inaccurate: tuple[Inaccurate, ...] = ()
    asked: Mapping[str, object] = field(default_factory=dict)
    whole: tuple[Record, ...] = ()

    def __repr__(self) -> str:
        on = ", ".join(r.name for r in self.records)
        return f"Comparison '{self.title}': {', '.join(self.models)} on {on}; {len(self.scores)} scores"

    def _repr_html_(self) -> str:
        from .notices import notices, starts_told

        return summary_html(
            self.title,
            self._best(),
            {"models": len(self.models), "recordings": len(self.records), "failures": len(self.failures)},
            [SmallTable(f"{self.modes[0]}, means over the recordings, SI", _SHOWN, self._shown())],
            [*notices(self), *starts_told(self.starts)],
        )

    def _best(self) -> str:
        """Which model is best on each output in the first mode, in a sentence."""
        rankings = {s.name: self.ranking(s.name, self.modes[0]) for s in self.outputs}
        clauses = [f"{r[0].model} on {n} (RMSE {r[0].rmse:.4g} {r[0].unit})" for n, r in rankings.items() if r]
        return f"Best in {self.modes[0]}: {', '.join(clauses)}." if clauses else "No model could be scored."

    def _shown(self) -> list[tuple]:
        ranked = [score for signal in self.outputs for score in self.ranking(signal.name, self.modes[0])]
        return [(s.output, s.model, s.rmse, s.maximum, s.unit, s.fit_percent, s.recordings) for s in ranked]

    def table(self, what: str = "scores") -> pyarrow.Table:
        """The rows as an Arrow table, SI: ``.to_pandas()``, ``polars.from_arrow(...)``.

        what : "scores" (each recording), "means" (over the recordings), "conditions" (over those that share a tag),
        "timings" or "failures". ``unit`` is that of the metrics of its row; what does not exist is null.
        Each tag of the recordings is a column of "scores" and "failures".

        Raises DeclarationError for another name.
        """
        from .tabular import arrow_table

        return arrow_table(self, what)

    @cached_property
    def copies(self) -> tuple[tuple[Record, Record], ...]:
        """Pairs of recordings, of the training too, that are one in files of other bytes."""
        return tuple(copies([*self.train_records, *self.records], self._measured))

    @cached_property
    def _measured(self) -> frozenset[str]:
        """Columns by which recordings of the same commands are told apart."""
        return frozenset(s.name for e in self.entrants for s in e.outputs)

    @cached_property
    def train_rows(self) -> tuple[dict, ...]:
        """By what the recordings are known again that were named as what the models were made from."""
        names = [s.name for e in self.entrants for s in (*e.inputs, *e.outputs)]
        return tuple(row_of(r, names) for r in self.train_records)

    def follows(self, record: Record, rows: Sequence[Mapping]) -> bool:
        """Whether a recording, in whatever file, is one of the ``rows`` of what something was made from: the one place
        that says so (`records.follows`)."""
        if not rows:
            return False
        key = record, repr(rows)  # every criterion asks again
        if key not in self._followed:
            same = [r for pair in self.copies if any(r is record for r in pair) for r in pair]
            same += [r for r in self.whole if r.name == record.name]
            self._followed[key] = any(follows(rows, r, self._measured) for r in (record, *same))
        return self._followed[key]

    @cached_property
    def _followed(self) -> dict[tuple[Record, str], bool]:
        """What `follows` has answered."""
        return {}

    @property
    def models(self) -> tuple[str, ...]:
        """Names of all models, in the order given."""
        return tuple(e.name for e in self.entrants)

    @property
    def yardsticks(self) -> frozenset[str]:
        """Names of the models that are there only to compare with."""
        return frozenset(e.name for e in self.entrants if e.kind == "yardstick")

    @property
    def seconds_per_simulated_second(self) -> dict[str, float]:
        """Run time of each model in the first mode it ran in."""
        answer: dict[str, float] = {}
        for timing in self.timings:
            answer.setdefault(timing.model, timing.seconds_per_simulated_second)
        return answer

    def ranking(self, output: str, mode: str = FREE_RUN) -> tuple[Score, ...]:
        """Means of one output and mode, best first. Models that missed a recording come last, however good."""
        rows = [s for s in self.means if s.output == output and s.mode == mode]
        most = max((s.recordings for s in rows), default=0)
        return tuple(sorted(rows, key=lambda s: (s.recordings < most, s.rmse)))

    def deviation(self, model: str, record: str, output: str, mode: str = FREE_RUN) -> np.ndarray | None:
        """The standard deviation (n,), SI, that ``model`` gave beside its prediction, or None."""
        for t in self.trajectories:
            if (t.model, t.record, t.mode) == (model, record, mode):
                return t.deviation.get(output)
        return None

    def trajectory(self, model: str, record: str, mode: str = FREE_RUN) -> Record | None:
        """What ``model`` predicted, or None when it failed."""
        for t in self.trajectories:
            if (t.model, t.record, t.mode) == (model, record, mode):
                return t.prediction
        return None


def mean_scores(scores: tuple[Score, ...]) -> tuple[Score, ...]:
    """Mean over the recordings of each metric, per model, output and mode; the maximum and the range are the widest.

    ``steady`` and ``settling`` are means over those recordings in which something rests.

    ``relative`` compares only models scored on as many recordings as the most complete one (NaN for the others).
    """
    groups: dict[tuple, list[Score]] = {}
    for s in scores:
        groups.setdefault((s.mode, s.output, s.model), []).append(s)
    means = [_mean(g) for g in groups.values()]
    return tuple(_with_relative(means))


def relative_scores(scores: list[Score]) -> tuple[Score, ...]:
    """The same scores with ``relative`` filled in."""
    return tuple(_with_relative(scores))


def mean_known(values: Sequence[float]) -> float:
    """Mean of those that are numbers; NaN where none is."""
    known = [v for v in values if not np.isnan(v)]
    return float(np.mean(known)) if known else float("nan")


def _mean(group: list[Score]) -> Score:
    def average(metric: str) -> float:
        return float(np.mean([getattr(s, metric) for s in group]))

    first = group[0]
    return Score(
        rmse=average("rmse"),
        mae=average("mae"),
        maximum=max(s.maximum for s in group),
        fit_percent=average("fit_percent"),
        bias=average("bias"),
        deviation=average("deviation"),
        lowest=min(s.lowest for s in group),
        highest=max(s.highest for s in group),
        samples=sum(s.samples for s in group),
        coverage=average("coverage"),
        nlpd=average("nlpd"),
        crps=average("crps"),
        **{f.name: average(f.name) for f in dataclasses.fields(FieldMetrics) if f.name not in AT_TIMES},
        **{name: mean_known([getattr(s, name) for s in group]) for name in AT_TIMES},
        model=first.model,
        record=MEAN,
        output=first.output,
        mode=first.mode,
        unit=first.unit,
        recordings=len(group),
    )


def _with_relative(scores: list[Score]):
    groups: dict[tuple, list[Score]] = {}
    for s in scores:
        groups.setdefault((s.mode, s.output, s.record), []).append(s)
    for s in scores:
        rivals = groups[s.mode, s.output, s.record]
        most = max(r.recordings for r in rivals)
        best = min(r.rmse for r in rivals if r.recordings == most)
        if s.recordings < most:
            ratio = float("nan")
        elif best > 0.0:
            ratio = s.rmse / best
        else:
            ratio = 1.0 if s.rmse == 0.0 else float("inf")
        yield dataclasses.replace(s, relative=ratio)
