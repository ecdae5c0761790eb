"""What a comparison leaves in the block [credibility] of a model file: `record_comparison`."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from hydrotwin.models.language.credibility import COMPARE, FIT, JUDGE, UNKNOWN, Credibility, Evidence, now, versions
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.model_file import ModelFile, add_evidence, read_model_file
from hydrotwin.models.language.provenance import OTHERS, SINCE, made_from_rows
from hydrotwin.models.language.writing import printable
from hydrotwin.records import Record
from hydrotwin.records.reading import beside, reading_told

from .acceptance import Acceptance
from .comparison import Comparison, Entrant, Score
from .elsewhere import unknown_of

KEPT = ("rmse", "mae", "maximum", "fit_percent", "bias", "r2", "coverage")  # metrics that stay in a model file
CLOSE = 1e-9  # relative: values are the same number, read in one unit or another


def record_comparison(
    path: str | os.PathLike,
    comparison: Comparison,
    accepted: Acceptance | None = None,
    model: str = "",
    *,
    asked: Mapping | None = None,
) -> Credibility:
    """Write into a model file what a comparison found of its model.

    Recordings by hash, with the role "fit" for those that the file's values follow; mean metrics by output and mode,
    SI; criteria with their results and margins; whether the runs were accurate; versions and date. The same question on
    the same recordings, asked in the same way, replaces the earlier answer. Evidence of other values is dropped.

    accepted : the judged criteria, as `acceptance` gives them. model : the name of the file's model in the comparison;
    by default the judged one, else the only one with the file's values. asked : how recordings were read, as `asked_by`
    tells it of a scenario; `replay` needs it where it was not the default.

    Returns all that the file holds now. Raises DeclarationError where the comparison is of another model or other
    values, or the criteria are about another model; DataError for a file that cannot be read or written.
    """
    file = read_model_file(path)
    name = model or (accepted.model if accepted else "") or _only(file, comparison.entrants)
    check_same(file, next((e for e in comparison.entrants if e.name == name), None), name)
    if accepted and accepted.judged and accepted.model != name:
        raise DeclarationError(
            f"{path}: the criteria are about '{accepted.model}', the file holds '{name}'. Judge that one: "
            f"--judge {name}."
        )
    return add_evidence(path, _evidence(file, comparison, accepted, name, asked or {}))


def asked_by(scenario) -> dict:
    """How the recordings of a scenario are read, as data."""
    told = reading_told(scenario.reading)
    return {"import": told} if told else {}


def check_same(file: ModelFile, entrant: Entrant | None, name: str) -> None:
    """Raises DeclarationError where a model that was compared does not have the values of a file."""
    if entrant and OTHERS in entrant.provenance.get(SINCE, ()):
        raise DeclarationError(
            f"{file.path}: {OTHERS}, so what was found of '{name}' says nothing of them. Identify the model again, and "
            "record that."
        )
    here = {p.name: p.value for p in entrant.parameters} if entrant else {}
    said = {n: s["value"] for n, s in file.settings.items()}
    apart = [n for n in said if n not in here or not np.isclose(said[n], here[n], rtol=CLOSE, atol=0.0)]
    if not said or apart or not here:
        what = f"'{apart[0]}' differs" if here and apart else "it has no parameters, or there is no such model"
        raise DeclarationError(
            f"{file.path}: the comparison's '{name}' is not the model of this file ({what}), so what was found of it "
            "says nothing of the file. Compare the file itself, without set = {..}: --model FILE --record FILE."
        )


def _only(file: ModelFile, entrants: Iterable[Entrant]) -> str:
    """The one model that has the values of the file; "" where none or several have."""
    found = []
    for one in entrants:
        try:
            check_same(file, one, one.name)
        except DeclarationError:
            continue
        found.append(one.name)
    return found[0] if len(found) == 1 else ""


def _evidence(
    file: ModelFile, comparison: Comparison, accepted: Acceptance | None, name: str, asked: Mapping
) -> Evidence:
    fitted_on = fitted_recordings(file)
    rows = [_recording(r, FIT if comparison.follows(r, fitted_on) else JUDGE, file) for r in comparison.records]
    seen = {row["role"] for row in rows}
    role = seen.pop() if len(seen) == 1 else f"{FIT} and {JUDGE}"
    inaccurate = [f"{w.record}: {w.sentence}" for w in comparison.inaccurate if w.model == name]
    facts = {
        "model": name,
        "title": comparison.title,
        "initial_states": "estimated"
        if any(s.model == name and s.estimate.states for s in comparison.starts)
        else "measured",
        "asked": {**comparison.asked, **asked},
        "untrusted_bands": _untrusted(comparison, name),
        UNKNOWN: _unknown(comparison),
        "failures": [f"{f.record}, {f.mode}: {f.sentence}" for f in comparison.failures if f.model == name],
    }
    return Evidence(
        COMPARE, now(), "", versions(), tuple(rows),
        tuple(_metrics(s, role) for s in comparison.means if s.model == name),
        tuple(_criterion(one) for one in accepted.judged) if accepted else (),
        {"reached": not inaccurate, "told": inaccurate}, facts,
    )  # fmt: skip


def _recording(record: Record, role: str, file: ModelFile) -> dict:
    """A row of ``recordings``, with where the file was, from the folder of the model file, and what ``import.toml``
    beside it said of how it is read."""
    row = {"name": record.name, "sha256": record.digest or "", "role": role}
    if record.source and Path(record.source).is_file():
        row["file"] = printable(_way(Path(record.source).resolve(), Path(file.path).resolve().parent))
        if near := reading_told(beside(Path(record.source))[0]):
            row["import"] = near
    return row | ({"tags": dict(record.tags)} if record.tags else {})


def _way(path: Path, folder: Path) -> str:
    """From a folder to a file; on another drive there is none, and its name is told."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.name


def fitted_recordings(file: ModelFile) -> list[dict]:
    """By what the recordings are known that the values of a file follow, as far as it says."""
    return [*file.credibility.fitted_on, *made_from_rows(file.provenance)]


def _unknown(comparison: Comparison) -> list[str]:
    """Scored outputs of which samples are not known, and how many."""
    lost = {s.name: unknown_of([r for r in comparison.records if s.name in r], s.name) for s in comparison.outputs}
    return [f"{name} on {words}" for name, words in lost.items() if words]


def _untrusted(comparison: Comparison, name: str) -> list[str]:
    """Scored outputs whose band is not to be believed."""
    scored = {s.name for s in comparison.outputs}
    bands = [band for e in comparison.entrants if e.name == name for band in e.bands]
    return [band.output for band in bands if band.trusted is False and band.output in scored]


def _metrics(score: Score, role: str) -> dict:
    found = {key: float(getattr(score, key)) for key in KEPT}
    numbers = {key: value for key, value in found.items() if np.isfinite(value)}
    row = {"output": score.output, "unit": score.unit, "role": role, "mode": score.mode}
    return row | {"recordings": score.recordings, **numbers}


def _criterion(one) -> dict:
    numbers = {key: float(getattr(one, key)) for key in ("value", "low", "high", "margin")}
    worst = {"worst": one.criterion.output} if one.criterion.overall else {}
    caution = {"caution": one.caution} if one.caution else {}
    return {"text": one.criterion.text, "passed": one.passed, **numbers, **worst, **caution}
