"""Whether a model of a comparison is good enough: criteria judged, and changes against an earlier comparison."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.provenance import made_from_rows
from hydrotwin.records.sizes import made_by_few

from .asked import SUFFIX, Asked, check_criterion, criteria_about, judged_model, left_out
from .band import Band
from .changes import Change
from .comparison import FREE_RUN, Comparison, Score
from .criteria import Criterion, Judged, judge, over_recordings, some_of, worst
from .earlier import earlier
from .elsewhere import holes_of, slower, unknown_of
from .metric import AGAIN, METRICS, OF_OUTPUT, SCORED
from .rating import INNER
from .sentence import other_of
from .tags import of_group
from .uneven import uneven
from .variants import Variant

FLAT = 2 * INNER  # of the largest measurement: what moves less lies in the inner corridor of a constant, all of it


@dataclass(frozen=True)
class Acceptance:
    """What was judged: the model, its mode, every criterion, and changes against an earlier comparison.

    new, gone : models that only one of the two comparisons has. otherwise : what else is not as it was, in sentences.
    """

    model: str
    mode: str
    judged: tuple[Judged, ...]
    changes: tuple[Change, ...] = ()
    new: tuple[str, ...] = field(default=())
    gone: tuple[str, ...] = field(default=())
    otherwise: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every criterion holds."""
        return all(one.passed for one in self.judged)


@dataclass(frozen=True)
class Wanted:
    """What is asked of a comparison.

    accept : criteria, as written. model : whose; "" for the first that is no yardstick. against : an earlier
    compare.json. base : the folder that files in criteria start from; own : that of single criteria, by their words.
    Raises DeclarationError for criteria that are no list of texts.
    """

    accept: tuple[str, ...] = ()
    model: str = ""
    against: Path | None = None
    base: Path = Path(".")
    own: Mapping[str, Path] = field(default_factory=dict)

    def __post_init__(self):
        if isinstance(self.accept, str) or not all(isinstance(text, str) for text in self.accept):
            raise DeclarationError(
                f"accept takes a list of criteria, each a text (got {self.accept!r}). Write ['...']."
            )

    def over(self, other: Wanted) -> Wanted:
        """This, and what it does not say as ``other`` does; the criteria of both, each with its folder."""
        accept = tuple(dict.fromkeys((*other.accept, *self.accept)))
        own = {text: self.folder(text) for text in self.accept if text not in other.accept}
        model, against = self.model or other.model, self.against or other.against
        return Wanted(accept, model, against, other.base, {**other.own, **own})

    @property
    def earlier(self) -> tuple[Path, ...]:
        """The files of earlier comparisons that are held against."""
        named = [self.folder(text) / other_of(text) for text in self.accept if other_of(text).endswith(SUFFIX)]
        return (*([self.against] if self.against else []), *named)

    def folder(self, text: str) -> Path:
        """Where files that a criterion names start from."""
        return self.own.get(text, self.base)


def acceptance(comparison: Comparison, wanted: Wanted, variant: str = "") -> Acceptance | None:
    """Judge the criteria on the first mode; None where nothing is asked.

    variant : of a scenario; "" for the scenario as it stands. It is held against the same variant of an earlier
    comparison.

    Raises DeclarationError for a criterion that says nothing about this comparison, DataError for an earlier comparison
    that cannot be read.
    """
    if not wanted.accept and wanted.against is None:
        return None
    asked = Asked.of(comparison)
    model = judged_model(asked, wanted.model)
    judged = []
    for text in wanted.accept:
        about = criteria_about(text, asked, model)
        values = [_Values(comparison, model, one, wanted.folder(text), variant) for one in about]
        each = [_told(judge(v.criterion, v), comparison, model) for v in values]
        judged.append(worst([dataclasses.replace(one, left_out=left_out(about, asked, model)) for one in each]))
    if not variant:  # a variant is held against its own, and what is otherwise is told of the scenario as it stands
        judged = [_held_against(one, comparison, wanted) for one in judged]
    if not wanted.against:
        return Acceptance(model, comparison.modes[0], tuple(judged))
    before = _earlier(wanted.against, variant)
    changes = before.against(comparison)
    otherwise = () if variant else (*before.scored_otherwise(comparison), *before.otherwise(comparison))
    return Acceptance(model, comparison.modes[0], tuple(judged), *changes, otherwise)


def judged_so(one: Criterion, comparison: Comparison) -> Judged:
    """A criterion between bounds of its own on the first model. DeclarationError where nothing tests it."""
    asked = Asked.of(comparison)
    model = judged_model(asked, "")
    check_criterion(one, asked, model)
    return _told(judge(one, _Values(comparison, model, one, Path())), comparison, model)


def _earlier(path: Path, variant: str):
    return earlier(path, variant, Variant(variant).folder if variant else "")


def _told(one: Judged, comparison: Comparison, model: str) -> Judged:
    """The same with what it was judged on, and why there is no number, where a recording failed."""
    about = one.criterion
    holding = _holding(comparison, about)
    without = tuple(n for n in of_group(comparison.records, about.group) if n not in holding)
    values = _Values(comparison, model, about, Path())
    samples = {s.record: s.samples for s in values.rows(model).values() if s.record in holding}
    mixed, judged_on = uneven(samples), [r for r in comparison.records if r.name in holding]
    one = dataclasses.replace(
        one,
        samples=sum(samples.values()) or None,
        without=without,
        lacking=values.lacking(holding, about.than if np.isfinite(one.value) else model),
        doubt=_doubt(comparison, model, about.output, holding),
        uneven=mixed.briefly if mixed and about.metric != "max" else "",
        skipped=values.lacking(holding, model) if METRICS[about.metric].at_times and np.isfinite(one.value) else (),
        seen=_seen(comparison, model, holding),
        trained=_trained(comparison, model, holding),
        mode=comparison.modes[0],
        flat=_flat(comparison, about, holding),
        holes=holes_of(judged_on, comparison.entrants),
        unknown=unknown_of(judged_on, about.output),
        otherwise=(
            *_started_otherwise(comparison, model, about.than, holding),
            *_started_untold(comparison, model, holding),
            *_made_by_few(comparison, model, about, holding),
            *_unjudged(comparison, model, about),
            *_of_run(comparison, model, about, holding),
            *_repeats(values.rows(model).values(), about, holding),
        ),
    )
    if np.isinf(one.value):
        return dataclasses.replace(one, reason=_reason(comparison, model, about, holding))
    doubt = _doubt(comparison, about.than, about.output, holding) if METRICS[about.metric].of_band else ""
    if doubt:  # nothing is shown by being as good as a band that does not hold
        return dataclasses.replace(
            one, high=np.nan, reason=f"{about.than} is no measure, its band cannot be trusted: {doubt}"
        )
    if np.isnan(one.high) and not about.than.endswith(SUFFIX):
        why = _reason(comparison, about.than, about, holding)
        return dataclasses.replace(one, reason=f"{about.than} is no measure, {why}" if why else "")
    return one


def _held_against(one: Judged, comparison: Comparison, wanted: Wanted) -> Judged:
    """The same with what else was otherwise in the earlier comparison that it names."""
    about = one.criterion
    if not about.than.endswith(SUFFIX):
        return one
    before = earlier(wanted.folder(about.text) / about.than)
    return dataclasses.replace(one, otherwise=(*one.otherwise, *before.otherwise(comparison)))


def _reason(comparison: Comparison, model: str, about: Criterion, holding: tuple[str, ...]) -> str:
    """Why a model has no score on one of the recordings."""
    mode = comparison.modes[0]
    failed = [f"{f.record}: {f.sentence}" for f in comparison.failures
              if (f.model, f.mode) == (model, mode) and f.record in holding]  # fmt: skip
    failed += [f"{u.record}: {u.output} is {u.reason}" for u in comparison.unscored
               if (u.model, u.output) == (model, about.output) and u.record in holding]  # fmt: skip
    return failed[0] if failed else ""


def _seen(comparison: Comparison, model: str, holding: tuple[str, ...]) -> tuple[str, ...]:
    """Recordings that a model was fitted to or trained on: that it is good there, it has from them."""
    rows = [row for e in comparison.entrants if e.name == model for row in made_from_rows(e.provenance)]
    return tuple(r.name for r in comparison.records if r.name in holding and comparison.follows(r, rows))


def _trained(comparison: Comparison, model: str, holding: tuple[str, ...]) -> tuple[str, ...]:
    """Recordings that were named as what the models were made from, beside those of which the model itself says so."""
    own = _seen(comparison, model, holding)
    rest = [r for r in comparison.records if r.name in holding and r.name not in own]
    return tuple(r.name for r in rest if comparison.follows(r, comparison.train_rows))


def _started_otherwise(comparison: Comparison, model: str, than: str, holding: tuple[str, ...]) -> tuple[str, ...]:
    """That of two models only one had its start estimated, in a sentence: errors may differ by that alone."""
    if than not in {e.name for e in comparison.entrants} - comparison.yardsticks:
        return ()
    estimated = {(s.model, s.of) for s in comparison.starts if s.estimate.states}
    differ = [r for r in holding if ((model, r) in estimated) is not ((than, r) in estimated)]
    if not differ:
        return ()
    one, other = (model, than) if (model, differ[0]) in estimated else (than, model)
    return (f"The start of {one} was estimated on {some_of(differ)}, and that of {other} was not.",)


def _started_untold(comparison: Comparison, model: str, holding: tuple[str, ...]) -> tuple[str, ...]:
    """Why the judged model starts as without an estimate, in a sentence for each reason."""
    noted: dict[str, list[str]] = {}
    for s in comparison.starts:
        if s.model == model and s.of in holding and s.estimate.note:
            noted.setdefault(s.estimate.note.partition(". ")[0].rstrip("."), []).append(s.of)
    return tuple(f"On {some_of(of)} {model} starts as without an estimate: {why}." for why, of in noted.items())


def _made_by_few(comparison: Comparison, model: str, about: Criterion, holding: tuple[str, ...]) -> list[str]:
    """That a few samples make the range of its output, or of an input that must rest, of a metric that counts by it."""
    metric, names = METRICS[about.metric], [about.output]
    if metric.at_times:
        names += [s.name for e in comparison.entrants if e.name == model for s in e.inputs]
    found = made_by_few([r for r in comparison.records if r.name in holding], names) if metric.by_range else []
    return [sentence.partition(",")[0] for sentence in found]


def _repeats(rows: Iterable[Score], about: Criterion, holding: tuple[str, ...]) -> tuple[str, ...]:
    """That a lag by whole periods does not show in a motion that repeats, in a sentence."""
    found = {s.record: s.repeats for s in rows if s.record in holding and METRICS[about.metric].of_shift}
    known = {name: value for name, value in found.items() if np.isfinite(value)}
    if not known:
        return ()
    return (f"Nobody can tell it from {min(known.values()):.3g} s more or less on {some_of(tuple(known))}",)


def _flat(comparison: Comparison, about: Criterion, holding: tuple[str, ...]) -> str:
    """That an output hardly moves against its size, of a metric that counts by that, in words; "" of any other."""
    records = [r for r in comparison.records if r.name in holding]
    if not METRICS[about.metric].from_zero or not records:
        return ""
    known = [(r, r[about.output][np.isfinite(r[about.output])]) for r in records]
    shares = {r.name: float(np.ptp(y) / np.abs(y).max()) for r, y in known if len(y) and np.ptp(y)}
    least = min(shares.values(), default=np.inf)
    if least > FLAT:
        return ""
    zero = f"{about.metric} counts from 0 {records[0].units[about.output]}".removesuffix(" 1")
    return f"{zero}: {about.output} moves by only {100 * least:.2g} % of its size, and errors as large hardly count"


def _doubt(comparison: Comparison, model: str, output: str, holding: tuple[str, ...]) -> str:
    """Why the band of an output of a model cannot be trusted on the recordings that count, in free run; "" where it
    can."""
    judged = (b.on(holding) for b in _bands(comparison, model, output))
    return next((b.why for b in judged if b.trusted is False), "")


def _of_run(comparison: Comparison, model: str, about: Criterion, holding: tuple[str, ...]) -> Iterator[str]:
    """What is to be known of the runs that count, in sentences: how accurate they are, and what they leave."""
    if rough := dict.fromkeys(r.record for r in comparison.inaccurate if r.model == model and r.record in holding):
        yield f"The numbers of {model} on {some_of(tuple(rough))} are not those of its equations"
    far = [d for d in comparison.domains if d.model == model and d.record in holding and d.extrapolates]
    if far:
        yield f"{model} extrapolates on {some_of([d.record for d in far])}, out of what it was trained on"
    slow = [r.name for r in comparison.records if r.name in holding and slower(r, about.output)]
    if comparison.modes[0] != FREE_RUN and slow:
        yield f"{about.output} of {some_of(slow)} has no value in the row before, so that this is its free run"
    judged = {id(r) for r in comparison.records if r.name in holding}
    pairs = [(a.name, b.name) for a, b in comparison.copies if {id(a), id(b)} <= judged]
    if pairs and about.metric != "max":
        yield f"{some_of([f'{b} is {a}' for a, b in pairs])}, and counts twice"


def _unjudged(comparison: Comparison, model: str, about: Criterion) -> list[str]:
    """That a band which counts was never held against anything, in a sentence."""
    bands = _bands(comparison, model, about.output) if METRICS[about.metric].of_band else []
    return [f"Of the band of {b.output}: {b.why}" for b in bands if b.trusted is None]


def _bands(comparison: Comparison, model: str, output: str) -> list[Band]:
    if comparison.modes[0] != FREE_RUN:
        return []
    return [b for e in comparison.entrants if e.name == model for b in e.bands if b.output == output]


def _holding(comparison: Comparison, one: Criterion) -> tuple[str, ...]:
    """Recordings that a criterion is about and that hold its output."""
    by_name = {r.name: r for r in comparison.records}
    return tuple(n for n in of_group(comparison.records, one.group) if one.output in by_name[n].signals)


@dataclass(frozen=True)
class _Values:
    """What a comparison says of a criterion: value(group, output, metric, model).

    Infinite, or minus infinite of what is better the larger it is, where the model has no score on a recording.
    """

    comparison: Comparison
    model: str
    criterion: Criterion
    base: Path
    variant: str = ""

    def __call__(self, group: str, output: str, metric: str, model: str) -> float:
        holding = _holding(self.comparison, self.criterion)
        if model.endswith(SUFFIX):
            return self._before(holding, metric, self.base / model)
        rows = self.rows(model or self.model)
        if not set(holding) <= set(rows):
            return -np.inf if METRICS[metric].best else np.inf
        return over_recordings(metric, [self._value(metric, rows[record]) for record in holding])

    def rows(self, model: str) -> dict[str, Score]:
        """The scores of a model on the output of the criterion, by recording."""
        key = (model, self.criterion.output, self.comparison.modes[0])
        return {s.record: s for s in self.comparison.scores if (s.model, s.output, s.mode) == key}

    def lacking(self, holding: tuple[str, ...], model: str) -> tuple[str, ...]:
        """Recordings on which a model has a score, and no number of the metric."""
        rows, metric = self.rows(model), self.criterion.metric
        return tuple(n for n in holding if n in rows and np.isnan(self._value(metric, rows[n])))

    def _value(self, metric: str, score: Score) -> float:
        return score.rmse / self._range(score) if metric == "nrmse" else getattr(score, SCORED[metric])

    def _range(self, score: Score) -> float:
        record = next(r for r in self.comparison.records if r.name == score.record)
        return float(np.ptp(record[score.output][np.isfinite(record[score.output])])) or float("nan")

    def _before(self, holding: tuple[str, ...], metric: str, path: Path) -> float:
        """What it was then, and as much more as the same run may give elsewhere. NaN for a variant that is new: it has
        nothing to be held against, and costs only itself."""
        found = _earlier(path, self.variant)
        if self.variant and not found.means:
            return float("nan")
        key = (self.model, self.criterion.output, self.comparison.modes[0])
        found.check_key(self.criterion.text, key)
        records = [r for r in self.comparison.records if r.name in holding]
        size = (
            found.value(key, "rmse", records) if METRICS[metric].of == OF_OUTPUT else 0.0
        )  # a bias may be next to none
        before = found.value(key, metric, records)
        return before + AGAIN * max(before, size)
