"""The record of a model file: compare --record, and check MODEL.toml.

Which model of a comparison a file holds is told before anything runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from hydrotwin.models.language.credibility import StaleEvidenceWarning
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.model_file import ModelFile, read_model_file
from hydrotwin.models.language.parameter_file import read_toml
from hydrotwin.models.language.provenance import OTHERS

from ..loading import load, values_file
from .shared import check_writable, out, print_json, table

MODEL = "model"  # kind of a file that is no learned block
QUIET = tuple(f": {name}" for name in ("mae", "maximum", "bias", "fit_percent", "r2", "coverage"))  # told where another
HOLDS, STALE, NOTHING = "holds", "STALE", "not tried"


def recorded_as(path: Path, scenario) -> str:
    """The name under which the model of a model file takes part; "" for its own.

    Raises DeclarationError where it takes no part, not as the file says, or is not the one that criteria are about;
    DataError for a file that is no model file or cannot be written.
    """
    _model_file(path)
    check_writable(path)
    if scenario.variants or scenario.loop:
        what = "variants" if scenario.variants else "a control loop"
        raise DeclarationError(
            f"compare: --record writes what was found of a model as its file holds it, and this scenario has {what}. "
            "Leave one of them out."
        )
    found = [entry for entry in scenario.models if _holds(entry.model, path)]
    if not found:
        raise DeclarationError(
            f"compare: --record {path}: none of the models has its values from this file. Add --model {path}."
        )
    as_it_is = [entry for entry in found if not entry.settings]
    if not as_it_is:
        raise DeclarationError(f"compare: --record {path}: the scenario sets other values (set = {{..}}). Drop them.")
    names = [entry.label or "" for entry in as_it_is]
    judged = scenario.wanted.model
    if not scenario.wanted.accept or "" in names:  # one that goes by its own name is known when it is read
        return names[0]
    first = next((entry.label or entry.model for entry in scenario.models if entry.model != "hold_last"), "")
    if (judged or first) not in names:
        raise DeclarationError(
            f"compare: --record {path}: the criteria are about '{judged or first}', the file is '{names[0]}'. Judge "
            f"that one: --judge {names[0]}."
        )
    return judged or first


def _model_file(path: Path):
    """The content of a model file. DataError for a learned block, which has no such record."""
    kind = read_toml(path).get("kind", MODEL)
    if kind != MODEL:
        raise DataError(
            f"{path}: a learned block ({kind}), and only model files have a block [credibility]. A learned block keeps "
            "its own card of what it does on held-out recordings. Name a model file."
        )
    return read_model_file(path)


def _holds(model: str, path: Path) -> bool:
    file = values_file(model)
    return file is not None and path.exists() and file.samefile(path)


def known_of(model: str):
    """What vouches for the model that ``model`` names, as far as it holds; None where its values are in no file."""
    path = values_file(model)
    if path is None or read_toml(path).get("kind", MODEL) != MODEL:  # a learned block or a hybrid has a card of its own
        return None
    file = read_model_file(path)
    return file.credibility.of(file.contents)


def tell_evidence(model: str, as_json: bool, again: Sequence[Path] | None = None) -> bool:
    """What a model file says of where it was fitted and judged; False where that is of other values, or not passed.

    model : the file, or what else is loaded with its values: ``rig.py:axis@model.toml``, which runs code that a file
    may not start.
    again : folders of recordings, to make its comparisons again; None for not. Then False too where a number is
    another, or a comparison could not be made.
    """
    path = _file_of(model)
    file = _model_file(path)
    made = None if again is None else _made_again(path, model, again)
    evidence = file.credibility.evidence
    others = _other_equations(model, file)
    rows = [
        {"holds": one.contents == file.contents and not others, "passed": one.passed, "told": one.told}
        for one in evidence
    ]
    good = all(row["holds"] and row["passed"] is not False for row in rows)
    if as_json:
        data = [one.as_data() | row for one, row in zip(evidence, rows, strict=True)]
        more = {} if made is None else {"again": [asdict(one) for one in made]}
        good &= _all_same(made)
        told = {"stale": file.stale or others, "unchecked": _unchecked(model, file)}
        print_json({"model": str(path), "passed": good, **told, "evidence": data, **more})
        return good
    none = [[NOTHING, "no record is inside. Write one: hydrotwin compare --model FILE --validate REC --record FILE."]]
    told = [[HOLDS if row["holds"] else STALE, row["told"]] for row in rows]
    table(str(path), ["", "record"], told or none)
    for told in filter(None, (file.stale or others, _unchecked(model, file) if evidence else "")):
        out.print(told)
    if made is not None:
        out.print()
        heads = ["", "recorded", "number", "then", "now", "unit", ""]
        shown = [o for o in made if not o.passed or not o.what.endswith(QUIET)]
        rows = [
            [_word(o.passed), o.date[:10], o.what, o.before / o.scale, o.now / o.scale, o.unit, o.why] for o in shown
        ]
        table("run again, metrics in SI, criteria as they are written", heads, rows)
        same, untried = sum(bool(o.passed) for o in made), sum(o.passed is None for o in made)
        left = f" {untried} could not be tried." if untried else ""
        tried = f"{same} of {len(made) - untried} numbers are the same.{left}"
        out.print(tried if same else f"Nothing could be confirmed.{left}")
    return good and _all_same(made)


def _other_equations(model: str, file: ModelFile) -> str:
    """That the equations are others than the values of a file were fitted to, in a sentence; "" where they are those,
    or nobody can tell (`_unchecked`)."""
    if _unchecked(model, file):
        return ""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StaleEvidenceWarning)
        load(model)
    return next((str(w.message) for w in caught if OTHERS in str(w.message)), "")


def _unchecked(model: str, file: ModelFile) -> str:
    """That nobody looked whether the equations are still those of the fit, and how to, in a sentence; "" else."""
    if ".py:" not in file.model or "@" in model:
        return ""
    return (
        "Whether the equations are still those of its fit was not looked at: a file may not start Python code. Name "
        f"the code: hydrotwin check {file.model}@{model}."
    )


def _file_of(model: str) -> Path:
    """The model file that ``model`` takes its values from, whether it is there or not."""
    values = model.partition("@")[2]
    return Path(values) if values and not Path(model).is_file() else Path(model)


def _made_again(path: Path, model: str, folders: Sequence[Path]):
    from hydrotwin.comparison import replay

    for folder in folders:
        if not folder.is_dir():
            raise DataError(f"check: --recordings {folder}: no such folder. Name one that holds recordings.")
    return replay(path, load(model), folders)


def _all_same(made) -> bool:
    """Nothing is another, and every comparison was made."""
    return made is None or all(one.passed for one in made)


def _word(passed: bool | None) -> str:
    return NOTHING if passed is None else "same" if passed else "OTHER"
