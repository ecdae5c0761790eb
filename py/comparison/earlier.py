"""An earlier comparison, read from its compare.json: what became better and worse, and what is not to become worse."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record

from .as_read import read_otherwise
from .changes import Before, Change, Key
from .comparison import Comparison
from .criteria import over_recordings, some_of
from .metric import METRICS, SCORED
from .variants import BASE, Variant

VALIDATE = "validate"  # role of the recordings that are scored, in compare.json
ASIDE = "earlier_answer"  # folder of the answer that the run before put aside, and that had none of its own
FORMAT = "hydrotwin-compare/1"  # of compare.json; its number goes up where keys change their meaning or go


@dataclass(frozen=True)
class Earlier:
    """An earlier comparison: mean scores, and those of each recording, by (model, output, mode).

    recordings : their names by hash, where they have one. scores : empty where the file has none of this variant.
    started : models whose start was estimated. read : of each recording by name how many samples it had, and what was
    read of its signals. between : what inputs did between their samples, and how late their columns were taken [s], by
    model and input. variants : what each changed; none for a comparison without. models : all of it, those too that
    failed everywhere.
    """

    path: Path
    means: Mapping[Key, Mapping]
    recordings: Mapping[str, str] = field(default_factory=dict)
    scores: Mapping[Key, Mapping[str, Mapping]] = field(default_factory=dict)
    started: frozenset[str] = frozenset()
    read: Mapping[str, Mapping] = field(default_factory=dict)
    between: Mapping[tuple[str, str], tuple[str, float]] = field(default_factory=dict)
    variants: Mapping[str, Mapping] = field(default_factory=dict)
    models: frozenset[str] = frozenset()

    def otherwise(self, comparison: Comparison) -> tuple[str, ...]:
        """What else than the models is not as it was, in sentences: a change may come from that."""
        found = []
        now = frozenset(s.model for s in comparison.starts if s.estimate.states)
        both = {model for model, *_ in self.means} & set(comparison.models)
        for words, models in (("now, and not then", now - self.started), ("then, and not now", self.started - now)):
            if some := sorted(models & both):
                found.append(f"The start of {', '.join(some)} was estimated {words}: errors may differ by that alone.")
        return (*found, *self._held_otherwise(comparison), *self._read_otherwise(comparison))

    def scored_otherwise(self, comparison: Comparison) -> Iterator[str]:
        """Outputs and modes in which only one of the two scored the models of both: nothing tells how those changed."""
        now = {(s.model, s.output, s.mode) for s in comparison.scores if s.model in {model for model, *_ in self.means}}
        then = {key for key in self.means if key[0] in comparison.models}
        asked = (), [s.name for s in comparison.outputs], comparison.modes  # scored now where no model failed
        for at, what in ((1, "Outputs"), (2, "Modes")):
            before, after = dict.fromkeys(k[at] for k in sorted(then)), dict.fromkeys(k[at] for k in sorted(now))
            if gone := [name for name in before if name not in asked[at]]:
                yield f"{what} no longer compared: {some_of(gone)}."
            if new := [name for name in after if then and name not in before]:
                yield f"{what} new against the earlier comparison: {some_of(new)}."

    def varied_otherwise(self, variants: Sequence[Variant]) -> Iterator[str]:
        """Variants that only one of the two has, and those of one name that changed something else then."""
        now = {v.name: json.loads(json.dumps(v.changes)) for v in variants if v.name != BASE}
        then = {name: changes for name, changes in self.variants.items() if name != BASE}
        if new := [name for name in now if name not in then]:
            yield f"Variants new against the earlier comparison: {some_of(new)}."
        if gone := [name for name in then if name not in now]:
            yield f"Variants no longer compared: {some_of(gone)}."
        if other := [name for name in now if then.get(name, now[name]) != now[name]]:
            yield f"{some_of(other)} changed something else then: errors may differ by that alone."

    def _held_otherwise(self, comparison: Comparison) -> Iterator[str]:
        """Inputs that were taken otherwise between their samples."""
        models: dict[tuple[str, str, str], list[str]] = {}
        for one, s in [(e, s) for e in comparison.entrants for s in e.inputs]:
            now = s.interpolation, s.shift
            then = self.between.get((one.name, s.name), now)
            if then != now:
                models.setdefault((s.name, _taken(*then), _taken(*now)), []).append(one.name)
        for (name, then, now), some in models.items():
            told = f"{name} of {some_of(some)} was taken as {then} then, and as {now} now"
            yield f"Between its samples {told}: errors may differ by that alone."

    def _read_otherwise(self, comparison: Comparison) -> Iterator[str]:
        """Recordings that are the same files, and not the same samples."""
        if not self.recordings:
            yield f"{self.path.name} does not say of which recordings it is: nobody knows whether of these."
        names = dict.fromkeys(s.name for e in comparison.entrants for s in (*e.inputs, *e.outputs))
        fewer, signals = [], {}
        for r in comparison.records:
            then = self.read.get(self.recordings.get(r.digest or "", r.name), {})
            if then.get("samples", len(r)) != len(r):
                fewer.append(r.name)
            elif apart := read_otherwise(r, then.get("signals", {}), names):
                signals[r.name] = apart
        if fewer:
            yield f"{some_of(fewer)} had another number of samples then: it was read otherwise."
        if signals:
            which = some_of(list(dict.fromkeys(n for apart in signals.values() for n in apart)))
            yield (
                f"{which} of {some_of(list(signals))} had other values then: the file was read in another unit, scale, "
                "column or clock, and errors may differ by that alone."
            )

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

    def check_key(self, text: str, key: Key) -> None:
        """Raises DeclarationError where it has nothing of a model in an output and mode."""
        if key not in self.means:
            model, output, mode = key
            known = dict.fromkeys(f"{o} of '{m}' in {how}" for m, o, how in sorted(self.means))
            raise DeclarationError(
                f"accept: '{text}': {self.path.name} has no {output} of '{model}' in {mode}. It has: "
                f"{', '.join(known) or 'nothing'}."
            )

    def value(self, key: Key, metric: str, records: Sequence[Record]) -> float:
        """A metric of a model over ``records``, as a criterion takes it now; NaN where it is not there.

        Of means alone, where the scores of its recordings are not there, only what is no size can be told.
        """
        rows = self.scores.get(key, {})
        names = [self.recordings.get(r.digest or "", r.name) for r in records]
        if rows and set(names) <= set(rows):
            return over_recordings(metric, [_number(rows[name].get(SCORED[metric])) for name in names])
        mean = self.means.get(key, {})
        if len(names) != mean.get("recordings", len(names)) or (METRICS[metric].sized and len(names) > 1):
            return float("nan")
        return over_recordings(metric, [_number(mean.get(SCORED[metric]))])

    def against(self, comparison: Comparison) -> tuple[tuple[Change, ...], tuple[str, ...], tuple[str, ...]]:
        """Changes of what both have, models that are new, and models that are gone."""
        before = self.models | {model for model, *_ in self.means}
        changes = tuple(Before(self.means, self.scores, self.recordings, self.models).changes(comparison))
        new = tuple(m for m in comparison.models if m not in before)
        return changes, new, tuple(sorted(before - set(comparison.models)))


def earlier(path: Path, variant: str = "", folder: str = "") -> Earlier:
    """Read an earlier compare.json, of a variant its means, if it has it.

    folder : of the variant beside the file, which then has the scores of its recordings. A file that was put aside, for
    the last run ended without an answer, is read where it is (`ASIDE`).

    Raises DataError for a file that is none or of another format, with what to do.
    """
    aside = path.parent / ASIDE / path.name
    path = aside if aside.is_file() and not path.exists() else path
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(told, dict):
            raise ValueError("it holds no table of names")
        _check_format(path, told.get("format", FORMAT))  # a file without one is older, with the same means
        rows = _means(told, variant) if variant else told["means"]
        means = {(s["model"], s["output"], s["mode"]): s for s in rows}
        judged = [r for r in told.get("recordings", ()) if r.get("role", VALIDATE) == VALIDATE]
        recordings = {r["sha256"]: r["name"] for r in judged} if all(r.get("sha256") for r in judged) else {}
        if not all(isinstance(s["rmse"], float | int) for s in means.values()):
            raise ValueError("a mean without rmse")
        scores = _scores(told.get("scores", ()) if not variant else ())
        started = frozenset(s["model"] for s in told.get("starts", ()) if s.get("states"))
        read = {r["name"]: dict(r) for r in judged}
        variants = {v["name"]: dict(v["changes"]) for v in told.get("variants", ())}
        models = frozenset(m["name"] for m in told.get("models", ()) if not variant or variant in variants)
        between = {(m["name"], name): (row["interpolation"], row.get("shift", 0.0)) for m in told.get("models", ())
                   for name, row in m.get("between_samples", {}).items() if "interpolation" in row}  # fmt: skip
    except OSError as error:
        raise DataError(
            f"{path}: cannot be read ({error.strerror}). Name the compare.json of an earlier run."
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(
            f"{path}: not the compare.json of a comparison ({error}). Name one that `hydrotwin compare` wrote."
        ) from None
    own = path.parent / (_folder_of(told, variant) or folder) / path.name
    if variant and means and folder and own.is_file():
        scores = _of_the_same(means, earlier(own))
    if variant:  # the file tells these of the base
        started, read, between = frozenset(), {}, {}
    return Earlier(path, means, recordings, scores, started, read, between, variants, models)


def _taken(interpolation: str, shift: float) -> str:
    """What an input does between its samples, in words."""
    late = f" {abs(shift):.3g} s {'later' if shift > 0 else 'earlier'} than stamped" if shift else ""
    return f"{interpolation}{late}"


def _of_the_same(means: Mapping[Key, Mapping], own: Earlier) -> Mapping[Key, Mapping[str, Mapping]]:
    """The scores of a variant's own file, where it is of the same run: it has the means that the overview has."""
    same = means.keys() == own.means.keys() and all(means[k]["rmse"] == own.means[k]["rmse"] for k in means)
    return own.scores if same else {}


def _scores(rows: Sequence[Mapping]) -> dict[Key, dict[str, Mapping]]:
    found: dict[Key, dict[str, Mapping]] = {}
    for row in rows:
        found.setdefault((row["model"], row["output"], row["mode"]), {})[row["record"]] = row
    return found


def _number(value: object) -> float:
    """NaN for what was not defined, or not yet scored."""
    return float("nan") if value is None else float(value)


def _folder_of(told: dict, variant: str) -> str:
    """The folder of the page of a variant, as the overview has it: of the variant that was run for it."""
    page = next((v.get("page") for v in told.get("variants", ()) if v["name"] == variant), None)
    return str(Path(page).parent) if page else ""


def _means(told: dict, variant: str) -> list[dict]:
    return next((v["means"] for v in told.get("variants", ()) if v["name"] == variant), [])


def _check_format(path: Path, found: object) -> None:
    if found != FORMAT:
        raise DataError(
            f"{path}: written in another format (got '{found}'), this version of hydrotwin reads '{FORMAT}'. Run the "
            "earlier comparison again with this version, or compare with the version that wrote it."
        )
