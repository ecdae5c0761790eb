"""Evidence of a model file made again: its recordings found, its models run, its numbers and criteria compared."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hydrotwin.identification.beginning import MEASURED
from hydrotwin.models.language.credibility import COMPARE, Evidence
from hydrotwin.models.language.errors import DataError, HydrotwinError
from hydrotwin.models.language.model_file import ModelFile, read_model_file
from hydrotwin.records import SUFFIXES, Reading, Record, import_from
from hydrotwin.records.files import read_by

from .acceptance import Wanted, acceptance, judged_so
from .comparison import Comparison
from .contender import as_contender
from .criteria import Criterion
from .meaning import criteria_of
from .metric import AGAIN, METRICS, OF_OUTPUT
from .run import compare

NUMBERS = ("rmse", "mae", "maximum", "bias", "fit_percent", "r2", "coverage")  # of an evidence's metrics


@dataclass(frozen=True)
class Again:
    """One number of an evidence: as it was written, as it is now, and whether it is the same.

    what : a metric of an output, or a criterion. passed : None where it was not tried; ``why`` says the reason, and
    what set the bound of a criterion beside another model or file.
    before, now : SI, or a share of 1. unit : that a criterion is written in; scale : one of it, in SI.
    """

    date: str
    what: str
    before: float
    now: float
    passed: bool | None
    why: str = ""
    unit: str = ""
    scale: float = 1.0


def replay(path: str | Path, model, folders: Sequence[Path] = ()) -> tuple[Again, ...]:
    """Make again what `record_comparison` has written into a model file.

    model : of the file, as `hydrotwin.load` gives it. folders : where recordings are looked for by their SHA-256, with
    all folders below; first each is looked for where it was, from the folder of the file.

    Evidence of other values is not tried. Raises DataError for a file that cannot be read, or without such evidence.
    """
    file, search = read_model_file(path), _Search(Path(path).parent, tuple(map(Path, folders)))
    judged = [one for one in file.credibility.evidence if one.by == COMPARE]
    if not judged:
        raise DataError(
            f"{path}: no comparison is in its record, so there is nothing to run again. Write one: hydrotwin compare "
            f"--model {path} --validate REC --record {path}."
        )
    return tuple(row for one in judged for row in _rows(one, file, model, search))


def _rows(one: Evidence, file: ModelFile, model, search: _Search) -> Iterator[Again]:
    nothing = Again(one.date, "", math.nan, math.nan, None)
    if one.contents != file.contents:
        yield replace(nothing, what="all", why="it is of other values than the file holds now")
        return
    try:
        found = _compared(one, model, search)
    except HydrotwinError as error:
        yield replace(nothing, what="all", why=str(error))
        return
    scores = {(s.output, s.mode): s for s in found.means}
    for row in one.metrics:
        score = scores.get((row["output"], row["mode"]))
        for key in (k for k in NUMBERS if k in row):
            now = math.nan if score is None else float(getattr(score, key))
            what = f"{row['output']}, {row['mode']}: {key}"
            same = _same(row[key], now, row.get("rmse", 0.0) if key == "bias" else 0.0)
            yield replace(nothing, what=what, before=row[key], now=now, passed=same)
    for row in one.criteria:
        yield _judged(row, found, nothing)


def _judged(row: Mapping, found: Comparison, nothing: Again) -> Again:
    """A criterion again; one beside another model or file, which the record does not hold, by the bound of then."""
    nothing = replace(nothing, what=row["text"], before=row["value"])
    try:
        each = criteria_of(row["text"], found.outputs)
        one = next((c for c in each if c.output == row.get("worst")), each[0])
        nothing = replace(nothing, unit=one.unit, scale=one.scale)
        if one.than:
            nothing = replace(nothing, why=f"held against the bound that {one.than} set then")
            now = judged_so(replace(one, than="", high=row["high"]), found)
        else:
            (now,) = acceptance(found, Wanted((row["text"],))).judged
    except HydrotwinError as error:
        return replace(nothing, passed=False, why=str(error))
    level = now.passed == row["passed"] or abs(now.margin) <= AGAIN  # elsewhere a number on its bound may be beside it
    return replace(nothing, now=now.value, passed=level and _same(row["value"], now.value, _size(now.criterion, found)))


def _compared(one: Evidence, model, search: _Search) -> Comparison:
    asked = one.facts.get("asked")
    if not isinstance(asked, Mapping):
        raise DataError("it does not say how it was asked. Record it again with this version")
    reading = import_from(asked.get("import", {}), "record")
    contender = as_contender(model, str(one.facts["model"]))
    outputs, inputs = ({s.name for s in side} for side in (contender.outputs, contender.inputs))
    return compare(
        [contender],
        [search.record(row, reading) for row in one.recordings],
        modes=list(asked["modes"]),  # of what was asked that which is not of the models beside it
        outputs=[name for name in asked["outputs"] if name in outputs],
        rates=[name for name in asked.get("rates", ()) if name in outputs],
        interpolation={name: how for name, how in asked.get("interpolation", {}).items() if name in inputs},
        initial_states=str(asked.get("initial_states", MEASURED)),
        known=list(asked.get("known", ())),
        repeats=0,
    )


def _size(one: Criterion, found: Comparison) -> float:
    """The RMSE, of a metric in which errors of either sign make up for each other; else 0."""
    metric, mode = METRICS[one.metric], found.modes[0]
    rows = [s.rmse for s in found.means if (s.output, s.mode) == (one.output, mode)]
    return rows[0] if rows and metric.sized and metric.of == OF_OUTPUT else 0.0


def _same(before: float, now: float, size: float = 0.0) -> bool:
    """Whether two runs may have given both. size : what counts where errors of either sign leave next to nothing."""
    close = math.isclose(before, now, rel_tol=AGAIN, abs_tol=AGAIN * size)
    return before == now or close or (math.isnan(before) and math.isnan(now))


@dataclass(frozen=True)
class _Search:
    """Finds recordings by their hash: where they were from ``base``, and anywhere below ``folders``."""

    base: Path
    folders: tuple[Path, ...]

    def record(self, row: Mapping, reading: Reading) -> Record:
        """The recording of a row, with its name and tags. Raises DataError where it is not found."""
        path = next((p for p in self._likely(row) if _digest(p) == row["sha256"]), None)
        if not row["sha256"] or path is None:
            where = f"not where it was ({row['file']})" if row.get("file") else "it does not say where it was"
            looked = ", ".join(map(str, self.folders))
            below = f", nor below {looked}" if looked else ". Say where recordings are: --recordings FOLDER"
            raise DataError(f"no file has the SHA-256 of {row['name']}: {where}{below}")
        reading = reading.over(import_from(row.get("import", {}), "record"))  # what stood beside it then, and not now
        return replace(read_by(path, reading), name=row["name"], tags=dict(row.get("tags", {})))

    def _likely(self, row: Mapping) -> Iterator[Path]:
        """Where it was; then files of its name; then all others."""
        named = Path(row.get("file", "")).name
        if named:
            yield self.base / row["file"]
        below = [p for folder in self.folders for p in sorted(folder.rglob("*")) if p.name.lower().endswith(SUFFIXES)]
        yield from sorted(below, key=lambda p: p.name != named)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
