"""MODEL: what a user may write for a model, and the object it stands for."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path

from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DataError, DeclarationError, HydrotwinError, nearest
from hydrotwin.models.language.model_file import ModelFile, read_model_file
from hydrotwin.models.language.parameter_file import read_toml

SHIPPED = ("cehA", "cehA:third_order", "spool_valve", "spool_valve:quasi_static", "eq17")


def load(spec: str):
    """The Model, Block or FMU that ``spec`` names.

    ======================  ==============================================================================
    ``cehA``                a shipped model; ``cehA:third_order`` one of its variants; ``eq17`` the published formula
    ``fitted.toml``         a model file (of a shipped model) or a learned block
    ``machine.fmu``         an FMU
    ``rig.py:axis``         a Model that a function in the user's own Python file returns
    ``rig.py:axis@f.toml``  the same with the values of a model file
    ======================  ==============================================================================

    Python files run only when the user names them; a model file never makes one run.

    Raises
    ------
    DeclarationError : no such model; names the nearest. DataError : a file that cannot be read.
    """
    spec = str(spec)
    base, at, values = spec.partition("@")
    if at:
        return _with_file(_load_base(base), read_model_file(values))
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
    if spec.endswith(".fmu"):
        from hydrotwin.export import read_fmu

        return read_fmu(Path(spec))
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
    if "model" not in content:
        from hydrotwin.learned import read_block

        return read_block(path)
    file = read_model_file(path)
    if ".py:" in file.model:
        raise DeclarationError(
            f"{path}: its model is Python code ('{file.model}'), which a data file may not start. "
            f"Name the code yourself: {file.model}@{path}."
        )
    return _with_file(_load_base(file.model), file)


def _with_file(model, file: ModelFile) -> Model:
    if not isinstance(model, Model):
        raise DeclarationError(f"{file.path}: only a physical model takes the values of a model file. Drop the '@'.")
    if file.effects:
        raise DataError(f"{file.path}: it holds effects, which this version cannot add. Update hydrotwin.")
    try:
        answer = model.with_settings(file.settings, dict(file.provenance))
        _ = answer.flat
    except HydrotwinError as error:
        raise type(error)(f"{file.path}: {error}") from None
    return answer


def _from_python(path: Path, factory: str) -> Model:
    """The Model that ``factory`` in the user's file returns."""
    if not path.is_file():
        beside = [p.name for p in path.parent.glob("*.py")] if path.parent.is_dir() else []
        raise DataError(f"{path}: no such file. {nearest(path.name, beside)}")
    name = f"hydrotwin_user_{path.stem}"
    specification = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    try:
        specification.loader.exec_module(module)
    except HydrotwinError:
        raise
    except Exception as error:
        raise DataError(f"{path}: does not run ({type(error).__name__}: {error}). Correct the file.") from error
    functions = [n for n, f in vars(module).items() if callable(f) and getattr(f, "__module__", "") == name]
    if not callable(getattr(module, factory, None)):
        raise DeclarationError(f"{path}: no function '{factory}'. {nearest(factory, functions)}")
    model = getattr(module, factory)()
    if not isinstance(model, Model):
        raise DeclarationError(
            f"{path}:{factory}: returns no Model (got {type(model).__name__}). Return Model(component, 'name')."
        )
    return model
