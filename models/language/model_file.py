"""model.toml: which model, its named effects, its parameter values with uncertainty, and where they came from.

Data only, never code. An effect is called by its id in the catalogue and its site; what it is, the catalogue says.
The block [credibility], last in the file, says on which recordings the model was fitted and judged (`credibility`).
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tomlkit

from .additions import Addition
from .credibility import KEY, Credibility, Evidence, contents_digest, from_data
from .equations import equations_digest
from .errors import DataError, nearest
from .flat import FlatModel, ParameterValue, Signal
from .parameter_file import parameter_settings, read_toml
from .provenance import EDITED, EQUATIONS, SINCE, lasting
from .writing import toml_values, write_whole

FORMAT = 1
_FORMS = (
    ("format", int, "whole number"),
    ("count", int, "whole number"),
    ("parameters", dict, "table"),
    ("effects", list, "list of tables"),
    ("inputs", dict, "table"),
    ("provenance", dict, "table"),
    (KEY, dict, "table"),
)
_KEYS = ("kind", "model", *(key for key, _, _ in _FORMS))
_INPUT = ("interpolation", "chosen_by", "shift", "why")
_EFFECT = ("effect", "site", "name")
_HEADER = re.compile(r"\s*\[")
_OF_BLOCK = re.compile(rf"\s*\[\[?\s*{KEY}\b")


@dataclass(frozen=True)
class ModelFile:
    """The content of a model file.

    settings : by dotted path, in SI, ready for ``Model.with_settings``.
    effects : rows ``effect``, ``site`` and ``name`` (of the added part), in the order they were added.
    inputs : what inputs do between samples and who chose it, ready for ``Model.with_inputs``.
    credibility : what the file says of where it was fitted and judged; contents : the hash that it must be of.
    """

    path: Path
    model: str
    settings: Mapping[str, dict]
    effects: tuple[dict, ...] = ()
    provenance: Mapping = field(default_factory=dict)
    inputs: Mapping[str, dict] = field(default_factory=dict)
    credibility: Credibility = field(default_factory=Credibility)
    contents: str = ""

    @property
    def stale(self) -> str:
        """What to know where the model is no longer the one that was fitted or judged; empty where it is."""
        if self.credibility.holds_for(self.contents):
            return ""
        lost = [one for one in self.credibility.evidence if one.contents != self.contents]
        made = " and ".join(dict.fromkeys(f"{one.by} ({one.date[:10]})" for one in lost))
        return (
            f"{self.path}: its values, effects or inputs were edited after {made} vouched for them, so its record no "
            "longer holds, nor do the intervals of its fit, which are left out. Record it anew: hydrotwin compare "
            "--model FILE --validate REC --record FILE."
        )


def read_model_file(path: Path | str) -> ModelFile:
    """Read a model file.

    Raises
    ------
    DataError : no TOML, no model file, a key that has no place in it, a number that is none.
    """
    path = Path(path)
    content = read_toml(path)
    for key in content:
        if key not in _KEYS:
            raise DataError(f"{path}: unknown key '{key}'. A model file holds data only. {nearest(key, _KEYS)}")
    if content.get("kind", "model") != "model" or not isinstance(content.get("model"), str):
        raise DataError(f"{path}: no model file (no line model = \"..\"). Write one with 'hydrotwin identify --out'.")
    for key, kind, form in _FORMS:
        if not isinstance(content.get(key, kind()), kind):
            raise DataError(f"{path}: '{key}' is no {form} (got {content[key]!r}). Correct it, or leave it out.")
    if content.get("format", FORMAT) > FORMAT:
        raise DataError(f"{path}: written by a newer version (format {content['format']}). Update hydrotwin.")
    settings = parameter_settings(content.get("parameters", {}), str(path))
    if len(settings) < content.get("count", 0):
        raise DataError(
            f"{path}: it ends too early (got {len(settings)} of {content['count']} parameters). "
            "It was cut off while it was copied: copy it again. Or take out the line 'count' if that was meant."
        )
    effects = tuple(_effect(row, number, path) for number, row in enumerate(content.get("effects", ()), 1))
    inputs = {name: _input(name, row, path) for name, row in content.get("inputs", {}).items()}
    known = from_data(content[KEY], str(path)) if KEY in content else Credibility()
    told = (content.get("provenance", {}), inputs, known, contents_digest(content))
    return ModelFile(path, content["model"], settings, effects, *told)


def _input(name: str, row, path: Path) -> dict:
    """One row of ``[inputs]``: what the input does between samples."""
    if not isinstance(row, dict):
        raise DataError(f"{path}: input '{name}' is no table (got {row!r}). Write {{interpolation = \"linear\"}}.")
    for key, value in row.items():
        if key not in _INPUT:
            raise DataError(f"{path}: input '{name}' has an unknown key '{key}'. {nearest(key, _INPUT)}")
        if key == "shift" and not (type(value) in (int, float) and np.isfinite(value)):
            raise DataError(f"{path}: input '{name}': 'shift' is no number of seconds (got {value!r}). Correct it.")
        if key != "shift" and not isinstance(value, str):
            raise DataError(f"{path}: input '{name}': '{key}' is no text (got {value!r}). Put it in quotes.")
    return {"chosen_by": "user", **row}


def _effect(row, number: int, path: Path) -> dict[str, str]:
    """One row of ``[[effects]]``, all of it text."""
    if not isinstance(row, dict):
        raise DataError(f"{path}: effect {number} is no table (got {row!r}). Write [[effects]] and its lines below.")
    for key, value in row.items():
        if key not in _EFFECT:
            raise DataError(f"{path}: effect {number} has an unknown key '{key}'. {nearest(key, _EFFECT)}")
        if not isinstance(value, str):
            raise DataError(f"{path}: effect {number}: '{key}' is no text (got {value!r}). Put it in quotes.")
    for key in ("effect", "site"):
        if not row.get(key):
            raise DataError(f"{path}: effect {number} has no '{key}'. 'hydrotwin effects MODEL' lists both.")
    if not all(word.isidentifier() for word in row.get("name", "a").split(".")):
        raise DataError(f"{path}: effect {number}: '{row['name']}' is no name of a part. Use letters, digits and _.")
    return {"name": "", **row}


def write_model_file(
    path: Path | str,
    model: str,
    flat: FlatModel,
    provenance: Mapping | None = None,
    additions: Iterable[Addition] | None = None,
    evidence: Evidence | None = None,
) -> Path:
    """Write the values, sigmas, bounds and sources of ``flat`` (SI); an existing file is replaced only when whole.

    flat : a FlatModel, or a Model.
    additions : the effects of the model; by default those of a Model. Parts that no catalogue names belong to the code
        of ``model`` and are not written.
    provenance : where the values come from; by default what the model says itself.
    evidence : of these values, for the block [credibility].
    """
    path = Path(path)
    if additions is None:
        additions = getattr(flat, "additions", ())
    flat = getattr(flat, "flat", flat)
    provenance = flat.provenance if provenance is None else provenance
    document = tomlkit.document()
    document.add(tomlkit.comment("hydrotwin model file: data only; values in SI units"))
    document["format"] = FORMAT
    document["kind"] = "model"
    document["model"] = model
    document["count"] = len(flat.parameters)
    effects = [_effect_table(addition) for addition in additions if addition.effect]
    if effects:
        document.add(tomlkit.nl())
        document["effects"] = tomlkit.aot()
        document["effects"].extend(effects)
    text = tomlkit.dumps(document)
    rows = [f"{tomlkit.key(p.name.split('.')).as_string()} = {_entry(p).as_string()}" for p in flat.parameters]
    text += "\n".join(["", "[parameters]", *rows, ""])  # not by tomlkit: every dotted key would copy those before it
    inputs = {s.name: _between(s) for s in flat.inputs if s.chosen_by}
    if inputs:
        text += "\n" + tomlkit.dumps({"inputs": inputs})
    if provenance:
        known = equations_digest(flat) or provenance.get(EQUATIONS, "")
        provenance = {**provenance, **({EQUATIONS: known} if known else {})}
        text += "\n" + tomlkit.dumps({"provenance": toml_values(provenance)})
    write_whole(path, _vouched(text, evidence) if evidence else text)
    return path


def add_evidence(path: Path | str, evidence: Evidence) -> Credibility:
    """Add to the block [credibility] of a model file; the rest of its text stays as it is.

    Evidence of other values than the file has is dropped, and with it the intervals of a fit that gave those. Returns
    what the block holds now.

    Raises
    ------
    DataError : as `read_model_file`, and for a file in which the block cannot be told from the rest.
    """
    file = read_model_file(path)
    text = file.path.read_bytes().decode("utf-8-sig")
    rest = _without_block(text)
    before = {key: value for key, value in tomllib.loads(text).items() if key != KEY}
    if tomllib.loads(rest) != before:
        raise DataError(f"{path}: its block [{KEY}] cannot be told from the rest. Put it last, or take it out.")
    rest = _without_intervals(rest) if file.stale else rest
    known = file.credibility.of(file.contents)
    write_whole(file.path, _vouched(rest, evidence, known))
    return read_model_file(path).credibility


def _vouched(text: str, evidence: Evidence, known: Credibility = Credibility()) -> str:  # noqa: B008  frozen
    """The text of a model file with what is known of its values, and ``evidence`` of them."""
    found = known.plus(replace(evidence, contents=contents_digest(tomllib.loads(text))))
    return f"{text.rstrip()}\n\n{found.as_toml()}"


def _without_intervals(text: str) -> str:
    """A model file whose values were edited, without what a fit said of how sure others were."""
    document, waiting = tomlkit.parse(text), []
    waiting.append(document.get("parameters", {}))
    while waiting:
        table = waiting.pop()
        waiting += [part for part in table.values() if isinstance(part, dict)]
        if "value" in table:
            table.pop("sigma", None)
    if isinstance(told := document.get("provenance"), dict):
        left = lasting(told.unwrap(), EDITED)
        for key in [key for key in told if key not in left]:
            told.pop(key)
        told.update({SINCE: left[SINCE]} if SINCE in left else {})
    return tomlkit.dumps(document)


def _without_block(text: str) -> str:
    """The lines outside of the tables of [credibility]."""
    kept, inside = [], False
    for line in text.splitlines(keepends=True):
        inside = bool(_OF_BLOCK.match(line)) if _HEADER.match(line) else inside
        kept += [] if inside else [line]
    return "".join(kept)


def _entry(p: ParameterValue) -> tomlkit.items.InlineTable:
    entry = tomlkit.inline_table()
    entry["value"] = float(p.value)
    entry["unit"] = p.unit
    if p.sigma is not None and np.isfinite(p.sigma):
        entry["sigma"] = float(p.sigma)
    entry["bounds"] = [float(b) for b in p.bounds]
    if p.free:
        entry["free"] = True
    if p.source:
        entry["source"] = p.source
    return entry


def _between(signal: Signal) -> tomlkit.items.InlineTable:
    """What an input does between its samples, and who says so."""
    entry = tomlkit.inline_table()
    entry.update({key: value for key in _INPUT if (value := getattr(signal, key))})
    return entry


def _effect_table(addition: Addition) -> tomlkit.items.Table:
    row = tomlkit.table()
    row["effect"], row["site"] = addition.effect, addition.site
    if addition.name:
        row["name"] = addition.name
    return row
