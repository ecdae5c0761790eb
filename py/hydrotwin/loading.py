"""MODEL: what a user may write for a model, and the object it stands for."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import re
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from hydrotwin.models.language import Component, Model
from hydrotwin.models.language.credibility import StaleEvidenceWarning
from hydrotwin.models.language.equations import equations_digest
from hydrotwin.models.language.errors import DataError, DeclarationError, HydrotwinError, nearest
from hydrotwin.models.language.model_file import ModelFile, read_model_file
from hydrotwin.models.language.parameter_file import read_toml
from hydrotwin.models.language.provenance import EDITED, EQUATIONS, OTHERS, lasting, refitted
from hydrotwin.models.language.user_code import place, place_of_code, running

PHYSICAL = ("cehA", "cehA:third_order", "spool_valve", "spool_valve:quasi_static")
SHIPPED = (*PHYSICAL, "eq17")


def origin(spec: str) -> str:
    """The model behind ``spec``, without the values of a model file: what a model file names as its model."""
    base = str(spec).partition("@")[0]
    if not base.endswith(".toml"):
        return base
    model = read_model_file(base).model
    return str((Path(base).parent / model).resolve()) if is_fmu(model) else model


def is_fmu(spec: str) -> bool:
    """Whether ``spec`` is an FMU, ``machine.fmu`` or ``machine.fmu:variable,variable``."""
    return spec.endswith(".fmu") or ".fmu:" in spec


def fmu_parts(spec: str) -> tuple[str, list[str] | None]:
    """The file of an FMU and the variables that are named as its outputs; commas in brackets are part of a name."""
    file, colon, names = spec.partition(".fmu:")
    if not colon:
        return spec, None
    named = [n.strip() for n in re.split(r",(?![^\[(]*[\])])", names)]
    if not all(named):
        raise DeclarationError(f"MODEL: no variable where one belongs in '{spec}'. Write {file}.fmu:mass.s,mass.v.")
    return f"{file}.fmu", named


def load(spec: str):
    """The Model, Block or FMU that ``spec`` names.

    ======================  ==============================================================================
    ``cehA``                a shipped model; ``cehA:third_order`` one of its variants; ``eq17`` the published formula
    ``fitted.toml``         a model file (of a shipped model) or a learned block
    ``machine.fmu``         an FMU; a model file may stand for one with effects around it
    ``machine.fmu:a,b.c``   the same with these variables as its outputs, local ones too
    ``rig.py:axis``         a Model that a function in the user's own Python file returns
    ``rig.py:axis@f.toml``  the same with the values and effects of a model file
    ======================  ==============================================================================

    Python files run only when the user names them; a model file never makes one run.

    Warns with `StaleEvidenceWarning` where the values of a model file were edited after it was judged.

    Raises
    ------
    DeclarationError : no such model; names the nearest. DataError : a file that cannot be read.
    """
    spec = str(spec)
    base, at, values = spec.partition("@")
    if at and not values:
        raise DeclarationError(f"MODEL: no file after '@' (got '{spec}'). Write {base}@model.toml.")
    if at:
        _no_hybrid(Path(values))
        return _with_file(surroundable(base), read_model_file(values))
    if spec.endswith(".toml"):
        return _from_toml(Path(spec))
    return _load_base(spec)


def _load_base(spec: str):
    if spec == "eq17":
        from hydrotwin.learned import published_formula

        return published_formula()
    if spec in SHIPPED:
        machine, _, variant = spec.partition(":")
        return getattr(importlib.import_module(f"hydrotwin.models.{machine}"), variant or "model")()
    if is_fmu(spec):
        from hydrotwin.export import read_fmu

        file, named = fmu_parts(spec)
        return read_fmu(Path(file), outputs=named)
    file, colon, factory = spec.rpartition(":")
    if colon and file.endswith(".py"):
        return _from_python(Path(file), factory)
    raise DeclarationError(
        f"MODEL: '{spec}' is no model. {nearest(spec, SHIPPED)} "
        "It is a shipped name, a .toml or .fmu file, or file.py:factory."
    )


def _from_toml(path: Path):
    """A model file or a learned block; the file says which."""
    content = read_toml(path)
    if content.get("kind") == "hybrid":
        from hydrotwin.learned import read_hybrid

        return read_hybrid(path, load)
    if content.get("kind") == "physics":
        raise DeclarationError(f"{path}: the equations of a hybrid. Name the hybrid, the file without '_physics'.")
    if "model" not in content and content.get("kind", "model") != "model":
        from hydrotwin.learned import read_block

        return read_block(path)
    if "models" in content and "validate" in content:
        raise DeclarationError(f"{path}: a scenario, not a model. Run it: hydrotwin compare {path}.")
    file = read_model_file(path)
    if is_fmu(file.model):
        return _with_file(_fmu_of(file), file)
    if ".py:" in file.model:
        raise DeclarationError(
            f"{path}: its model is Python code ('{file.model}'), which a data file may not start. "
            f"Name the code yourself: {file.model}@{path}."
        )
    if file.model not in PHYSICAL:
        raise DeclarationError(
            f"{path}: its model is none of hydrotwin's (got '{file.model}'). {nearest(file.model, PHYSICAL)}"
        )
    return _with_file(_load_base(file.model), file)


def _no_hybrid(path: Path) -> None:
    """Raise `DeclarationError` where the values that a model is to take are a hybrid."""
    if path.suffix == ".toml" and read_toml(path).get("kind") == "hybrid":
        raise DeclarationError(
            f"{path}: a hybrid, not the values of a model. Its physics is in its files: name {path} alone."
        )


def values_file(spec: str) -> Path | None:
    """The model file that ``spec`` takes its values from, ``fitted.toml`` or ``rig.py:axis@fitted.toml``; else None."""
    base, _, values = str(spec).partition("@")
    path = Path(values or base)
    return path if path.suffix == ".toml" and path.is_file() and "model" in read_toml(path) else None


def surroundable(spec: str):
    """The model that ``spec`` names; an FMU as one that effects can be added to, before its inputs and behind it."""
    thing = load(spec)
    if getattr(thing, "kind", "") == "fmu" and not isinstance(thing, Model):
        from hydrotwin.discovery.around.surroundings import surrounded

        return surrounded(thing)
    return thing


def _fmu_of(file: ModelFile) -> Model:
    """The FMU that a model file names, from the folder of the file; it must be the one that was worked with."""
    spec = file.path.parent / file.model
    path = Path(fmu_parts(str(spec))[0])
    if not path.is_file():
        raise DataError(f"{file.path}: its FMU is not there (got '{file.model}'). Put it where the file says: {path}.")
    known = file.provenance.get("fmu", {})
    told = known.get("sha256") if isinstance(known, Mapping) else None
    if told and told != sha256_of(path):
        raise DataError(
            f"{file.path}: {path} is another FMU than the one its effects belong to (its SHA-256 differs). Put the "
            "old one back, or look for effects of the new one: hydrotwin gap."
        )
    return surroundable(str(spec))


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _with_file(model, file: ModelFile) -> Model:
    if not isinstance(model, Model):
        raise DeclarationError(f"{file.path}: only a physical model takes the values of a model file. Drop the '@'.")
    try:
        settings, provenance = _vouched(file)
        provenance = refitted(model.provenance, provenance, stay=True)
        bare = with_effects(_as_it_is(model, file), file.effects)
        bare = bare.with_inputs(file.inputs) if file.inputs else bare
        answer = bare.with_settings(settings, provenance)
        others = file.provenance.get(EQUATIONS, "") not in ("", equations_digest(answer.flat))
        if others:
            answer = bare.with_settings(*_without_intervals(settings, provenance, OTHERS))
    except HydrotwinError as error:
        raise type(error)(f"{file.path}: {error}") from None
    if file.stale:
        warnings.warn(file.stale, StaleEvidenceWarning, stacklevel=4)
    if others:
        warnings.warn(
            f"{file.path}: {OTHERS} (code that was edited, or another version of hydrotwin), so its record no longer "
            "holds, nor do the intervals of its fit, which are left out. Identify the model again.",
            StaleEvidenceWarning,
            stacklevel=4,
        )
    return answer


def _vouched(file: ModelFile) -> tuple[dict, dict]:
    """Settings and provenance; without the intervals of a fit where its values were edited: they are about others."""
    settings, provenance = dict(file.settings), dict(file.provenance)
    return _without_intervals(settings, provenance, EDITED) if file.stale else (settings, provenance)


def _without_intervals(settings: Mapping, provenance: Mapping, since: str) -> tuple[dict, dict]:
    known = {n: {k: v for k, v in s.items() if k != "sigma"} for n, s in settings.items()}
    return known, lasting(provenance, since)


def _as_it_is(model: Model, file: ModelFile) -> Model:
    """The machine with the file's values: where its effects fit may depend on them, but not on what they free.

    A payload that is freed and found to be nil would be none that can be wrong.
    """
    own = {p.name for p in model.flat.parameters} - {row["site"] for row in file.effects} if file.effects else ()
    known = {n: {k: s[k] for k in ("value", "unit", "bounds") if k in s} for n, s in file.settings.items() if n in own}
    return model.with_settings(known)


def with_effects(model: Model, rows: Sequence[Mapping[str, str]]) -> Model:
    """The model with the effects of a model file, in their order; those that its code has added already stay.

    Sites are those of the model itself; only what it does not have is looked for on the parts added before.

    Raises
    ------
    DeclarationError : no such effect, or it does not fit there; names the nearest.
    """
    here = {(a.effect, a.site) for a in model.additions}
    rows = [row for row in rows if (row["effect"], row["site"]) not in here]
    if not rows:
        return model
    from hydrotwin.models.effects import CATALOGUE, candidates

    for row in rows:
        if row["effect"] not in CATALOGUE:
            raise DeclarationError(f"effects: none is called '{row['effect']}'. {nearest(row['effect'], CATALOGUE)}")
    found = {(c.id, c.site.name): c for c in candidates(model, [row["effect"] for row in rows], merged=False)}
    added: list = []
    for row in rows:
        fitting = found.get((row["effect"], row["site"]))
        if fitting is None:
            later = candidates(model.plus(added), [row["effect"]], merged=False) if added else ()
            fitting = next((c for c in later if c.site.name == row["site"]), None)
        if fitting is None:
            sites = [site for effect, site in found if effect == row["effect"]]
            raise DeclarationError(
                f"{model.name}: '{row['effect']}' does not fit at '{row['site']}'. {nearest(row['site'], sites)}"
            )
        addition = fitting.addition
        added.append(replace(addition, name=row["name"]) if row["name"] and addition.part else addition)
    return model.plus(added)


def _from_python(path: Path, factory: str) -> Model:
    """The Model that ``factory`` in the user's file returns."""
    if not path.is_file():
        beside = [p.name for p in path.parent.glob("*.py")] if path.parent.is_dir() else []
        raise DataError(f"{path}: no such file. {nearest(path.name, beside)}")
    name = f"hydrotwin_user_{path.stem}"
    specification = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    with _beside(path):
        sys.modules.setdefault(path.stem, module)  # a neighbour that imports this file gets it, and no second copy
        _ran(path, lambda: specification.loader.exec_module(module))
        functions = [n for n, f in vars(module).items() if callable(f) and getattr(f, "__module__", "") == name]
        make = getattr(module, factory, None)
        if not callable(make):
            raise DeclarationError(f"{path}: no function '{factory}'. {nearest(factory, functions)}")
        needed = _needed(make)
        if needed:
            raise DeclarationError(
                f"{place_of_code(make) or f'{path}: '}{factory} needs arguments ({', '.join(needed)}), which nobody "
                "gives. Give each a default value, or write a function without arguments that calls it."
            )
        model = _ran(path, make)
    if not isinstance(model, Model):
        kind = f"the component {type(model).__name__}" if isinstance(model, Component) else type(model).__name__
        raise DeclarationError(
            f"{place_of_code(make)}{path}:{factory}: returns no Model (got {kind}). Return Model(component, 'name')."
        )
    return model


@contextmanager
def _beside(path: Path):
    """A file may import what lies beside it; the next file of that name in another folder gets its own."""
    folder = str(path.parent.resolve())
    before = set(sys.modules)
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
        for name in set(sys.modules) - before:
            file = getattr(sys.modules[name], "__file__", None)
            if file and Path(file).parent == Path(folder) and not name.startswith("hydrotwin_user_"):
                del sys.modules[name]


def _needed(function: Callable) -> list[str]:
    """Arguments without a default."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return []
    return [p.name for p in parameters if p.default is p.empty and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]


def _ran(path: Path, action: Callable):
    """What a piece of the user's file returns; anything it raises becomes a sentence with the line."""
    try:
        with running(str(path)):
            return action()
    except SyntaxError as error:
        text = (error.text or "").strip()
        hint = "An equation is written with '==': yield left == right." if "yield" in text else "Correct that line."
        file = error.filename or path
        raise DataError(
            f"{place(str(file), error.lineno)}does not run (SyntaxError: {error.msg}): {text!r}. {hint}"
        ) from error
