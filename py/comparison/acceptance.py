"""Whether a model of a comparison is good enough: criteria judged, and changes against an earlier comparison."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .comparison import MEAN, Comparison, Score, mean_known
from .criteria import Criterion, Judged, criterion, judge
from .tags import groups, of_group

VALIDATE = "validate"  # role of the recordings that are scored, in compare.json
SAME = 0.02  # of an error: a smaller change against an earlier comparison is none
SUFFIX = ".json"  # of an earlier comparison that a criterion names
FORMAT = "hydrotwin-compare/1"  # of compare.json; its number goes up where keys change their meaning or go
COVERAGE = "coverage"
SCORED = {"rmse": "rmse", "mae": "mae", "max": "maximum", "bias": "bias", "fit": "fit_percent"}
SCORED |= {name: name for name in ("r2", "theil", "iso18571", "lag", "steady", "vv20")}
BEST = ("r2", "iso18571")  # the larger the better, as fit is


@dataclass(frozen=True)
class Change:
    """The mean RMSE of a model in one output and mode, SI, before and now."""

    model: str
    output: str
    mode: str
    before: float
    now: float
    unit: str

    @property
    def better(self) -> bool:
        return self.now < (1 - SAME) * self.before

    @property
    def worse(self) -> bool:
        return self.now > (1 + SAME) * self.before


@dataclass(frozen=True)
class Acceptance:
    """What was judged: the model, its mode, every criterion, and changes against an earlier comparison.

    new, gone : models that only one of the two comparisons has.
    """

    model: str
    mode: str
    judged: tuple[Judged, ...]
    changes: tuple[Change, ...] = ()
    new: tuple[str, ...] = field(default=())
    gone: tuple[str, ...] = field(default=())

    @property
    def passed(self) -> bool:
        """Whether every criterion holds."""
        return all(one.passed for one in self.judged)


@dataclass(frozen=True)
class Wanted:
    """What is asked of a comparison.

    accept : criteria, as written. model : whose; "" for the first that is no yardstick. against : an earlier
    compare.json. base : the folder that files in criteria start from.
    """

    accept: tuple[str, ...] = ()
    model: str = ""
    against: Path | None = None
    base: Path = Path(".")

    def over(self, other: Wanted) -> Wanted:
        """This, and what it does not say as ``other`` does; the criteria of both."""
        return Wanted(
            (*other.accept, *self.accept), self.model or other.model, self.against or other.against, other.base
        )


def acceptance(comparison: Comparison, wanted: Wanted, variant: str = "") -> Acceptance | None:
    """Judge the criteria on the first mode; None where nothing is asked.

    variant : of a scenario; "" for the scenario as it stands. It is held against the same variant of an earlier
    comparison.

    Raises DeclarationError for a criterion that says nothing about this comparison, DataError for an earlier comparison
    that cannot be read.
    """
    if not wanted.accept and wanted.against is None:
        return None
    model = _model(comparison, wanted.model)
    found = [criterion(text, comparison.outputs) for text in wanted.accept]
    judged = (judge(one, _Values(comparison, model, one, wanted.base, variant)) for one in found)
    judged = tuple(_with_reason(one, comparison, model) for one in judged)
    changes = earlier(wanted.against, variant).against(comparison) if wanted.against else ((), (), ())
    return Acceptance(model, comparison.modes[0], judged, *changes)


def _with_reason(one: Judged, comparison: Comparison, model: str) -> Judged:
    """The same with the samples that it was judged on, and why there is no number, where a recording failed."""
    one = dataclasses.replace(one, samples=_samples(one, comparison, model))
    if np.isfinite(one.value) or np.isnan(one.value):
        return one
    chosen = of_group(comparison.records, one.criterion.group)
    failed = [f for f in comparison.failures if f.model == model and f.record in chosen]
    return dataclasses.replace(one, reason=f"{failed[0].record}: {failed[0].sentence}" if failed else "")


def _samples(one: Judged, comparison: Comparison, model: str) -> int | None:
    """Of all recordings that a criterion is about; None where nothing was scored."""
    chosen, mode = of_group(comparison.records, one.criterion.group), comparison.modes[0]
    key = (model, one.criterion.output, mode)
    counts = [s.samples for s in comparison.scores if (s.model, s.output, s.mode) == key and s.record in chosen]
    return sum(counts) if counts else None


def check_wanted(wanted: Wanted, models: Sequence[str], outputs: Sequence[Signal], records: Sequence[Record]) -> None:
    """Refuse before a long run what could not be judged after it. Raises as `acceptance` does."""
    if wanted.model:
        _known(wanted.model, models)
    for one in (criterion(text, outputs) for text in wanted.accept):
        if one.group and not of_group(records, one.group):
            raise _no_group(one, records)
        if one.than.endswith(SUFFIX):
            earlier(wanted.base / one.than).check_recordings(records)
        elif one.than:
            _known(one.than, models)
    if wanted.against:
        earlier(wanted.against).check_recordings(records)


@dataclass(frozen=True)
class Earlier:
    """An earlier comparison: mean scores by (model, output, mode); its recordings, names by hash, where told."""

    path: Path
    means: dict[tuple[str, str, str], dict]
    recordings: Mapping[str, str] = field(default_factory=dict)

    def check_recordings(self, records: Sequence[Record]) -> None:
        """Raises DeclarationError where it was made on other recordings: means over those say nothing of these."""
        now = {r.digest: r.name for r in records}
        if not self.recordings or None in now or "" in now or now.keys() == self.recordings.keys():
            return
        apart = [f"{name} is new" for digest, name in now.items() if digest not in self.recordings]
        apart += [f"{name} is gone" for digest, name in self.recordings.items() if digest not in now]
        raise DeclarationError(
            f"accept: {self.path} is of other recordings, or of others of the same name ({', '.join(apart[:4])}): what "
            "became better cannot be told. Compare on the same ones, or make the earlier comparison again on these."
        )

    def against(self, comparison: Comparison) -> tuple[tuple[Change, ...], tuple[str, ...], tuple[str, ...]]:
        """Changes of what both have, models that are new, and models that are gone."""
        before = {model for model, *_ in self.means}
        changes = tuple(
            Change(s.model, s.output, s.mode, self.means[s.model, s.output, s.mode]["rmse"], s.rmse, s.unit)
            for s in comparison.means
            if (s.model, s.output, s.mode) in self.means
        )
        new = tuple(m for m in comparison.models if m not in before)
        return changes, new, tuple(sorted(before - set(comparison.models)))


def earlier(path: Path, variant: str = "") -> Earlier:
    """Read an earlier compare.json, of a variant those means, if it has it.

    Raises DataError for a file that is none or of another format, with what to do.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        _check_format(path, told.get("format", FORMAT))  # a file without one is older, with the same means
        rows = _means(told, variant) if variant else told["means"]
        means = {(s["model"], s["output"], s["mode"]): s for s in rows}
        judged = [r for r in told.get("recordings", ()) if r.get("role", VALIDATE) == VALIDATE]
        recordings = {r["sha256"]: r["name"] for r in judged} if all(r.get("sha256") for r in judged) else {}
        if not all(isinstance(s["rmse"], float | int) for s in means.values()):
            raise ValueError("a mean without rmse")
    except OSError as error:
        raise DataError(
            f"{path}: cannot be read ({error.strerror}). Name the compare.json of an earlier run."
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(
            f"{path}: not the compare.json of a comparison ({error}). Name one that `hydrotwin compare` wrote."
        ) from None
    return Earlier(path, means, recordings)


def _means(told: dict, variant: str) -> list[dict]:
    return next((v["means"] for v in told.get("variants", ()) if v["name"] == variant), [])


def _check_format(path: Path, found: object) -> None:
    if found != FORMAT:
        raise DataError(
            f"{path}: written in another format (got '{found}'), this version of hydrotwin reads '{FORMAT}'. Run the "
            "earlier comparison again with this version, or compare with the version that wrote it."
        )


@dataclass(frozen=True)
class _Values:
    """What a comparison says of a criterion: value(group, output, metric, model)."""

    comparison: Comparison
    model: str
    criterion: Criterion
    base: Path
    variant: str = ""

    def __call__(self, group: str, output: str, metric: str, model: str) -> float:
        if model.endswith(SUFFIX):
            return self._before(group, output, metric, self.base / model)
        name = _model(self.comparison, model) if model else self.model
        rows = self._rows(group, output, name)
        if metric == "nrmse":
            return float(np.mean([s.rmse / self._range(s) for s in rows]))
        if metric == COVERAGE and any(np.isfinite(s.coverage) for s in rows):
            return float(np.mean([s.coverage for s in rows]))
        if metric not in SCORED:
            raise DeclarationError(f"accept: '{self.criterion.text}': {name} has no band to take {metric} of.")
        values = [getattr(s, SCORED[metric]) for s in rows]
        return _over_recordings(metric, values)

    def _rows(self, group: str, output: str, model: str) -> list[Score]:
        """Scores of a model on the recordings of a group; a recording that failed leaves no number to judge by."""
        chosen = of_group(self.comparison.records, group)
        if not chosen:
            raise _no_group(self.criterion, self.comparison.records)
        mode = self.comparison.modes[0]
        rows = {s.record: s for s in self.comparison.scores if (s.model, s.output, s.mode) == (model, output, mode)}
        if not set(chosen) <= set(rows):
            return [_failed(model, output)]
        return [rows[name] for name in chosen]

    def _range(self, score: Score) -> float:
        record = next(r for r in self.comparison.records if r.name == score.record)
        return float(np.ptp(record[score.output][np.isfinite(record[score.output])])) or float("nan")

    def _before(self, group: str, output: str, metric: str, path: Path) -> float:
        if group or metric not in SCORED:
            raise DeclarationError(
                f"accept: '{self.criterion.text}': an earlier comparison is judged over all recordings, by "
                f"{', '.join(SCORED)}."
            )
        means = earlier(path, self.variant).means
        if self.variant and not means:  # a variant that is new has nothing to be held against, and costs only itself
            return float("nan")
        key = (self.model, output, self.comparison.modes[0])
        if key not in means:
            known = sorted({model for model, *_ in means})
            raise DeclarationError(
                f"accept: '{self.criterion.text}': {path.name} has no {output} of '{self.model}'. It has: "
                f"{', '.join(known)}."
            )
        found = means[key].get(SCORED[metric])  # None where it was not defined, or not yet scored
        return float("nan") if found is None else float(found)


def _over_recordings(metric: str, values: Sequence[float]) -> float:
    """The largest maximum, the mean size of lags and of errors at rest (where something rests), else the mean."""
    if metric == "max":
        return float(max(values))
    if metric == "steady":
        return mean_known(np.abs(values))
    value = float(np.mean(np.abs(values) if metric == "lag" else values))
    return value / 100 if metric == "fit" else value


def _failed(model: str, output: str) -> Score:
    inf = float("inf")
    field = {name: -inf if name in BEST else inf for name in ("r2", "theil", "iso18571", "lag", "steady", "vv20")}
    return Score(model, MEAN, output, "", inf, inf, inf, -inf, "1", bias=inf, **field)


def _model(comparison: Comparison, name: str) -> str:
    known = [m for m in comparison.models if m not in comparison.yardsticks]
    if not name:
        return (known or list(comparison.models))[0]
    return _known(name, comparison.models)


def _known(name: str, models: Sequence[str]) -> str:
    if name not in models:
        raise DeclarationError(f"accept: no model '{name}' in this comparison. {nearest(name, models)}")
    return name


def _no_group(one: Criterion, records: Sequence[Record]) -> DeclarationError:
    known = [*(r.name for r in records), *groups(records)]
    return DeclarationError(f"accept: '{one.text}': no recordings '{one.group}'. {nearest(one.group, known)}")


def junit(found: Acceptance, title: str) -> str:
    """The criteria as a JUnit XML document, a test case each, for servers that build and test."""
    failed = [one for one in found.judged if not one.passed]
    suite = ElementTree.Element("testsuite", name=title, tests=str(len(found.judged)), failures=str(len(failed)))
    suite.attrib |= {"errors": "0", "skipped": "0"}
    for one in found.judged:
        case = ElementTree.SubElement(suite, "testcase", classname=found.model, name=one.criterion.text)
        if not one.passed:
            words = one.undefined or f"found {one.value:.6g}, allowed {one.low:.6g} to {one.high:.6g} (SI)"
            ElementTree.SubElement(case, "failure", message=words, type="criterion").text = words
        if one.caution:
            ElementTree.SubElement(case, "system-out").text = one.caution
    root = ElementTree.Element("testsuites", tests=suite.get("tests"), failures=suite.get("failures"))
    root.append(suite)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
