"""What holds for every law and component, found by walking the packages: a new one is under contract at birth."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

import numpy as np

from hydrotwin.models.language import Component, Input, Output, Parameter, State
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import Port


def registered(package: ModuleType) -> list[type[Component]]:
    """Every component class defined in a package, in the order of its modules."""
    found = []
    for module in pkgutil.iter_modules(package.__path__):
        content = importlib.import_module(f"{package.__name__}.{module.name}")
        found += [
            kind
            for kind in vars(content).values()
            if isinstance(kind, type) and issubclass(kind, Component) and kind.__module__ == content.__name__
        ]
    return found


def complaints(kind: type[Component]) -> list[str]:
    """What a law or component fails to say about itself; empty when it is well declared.

    A pure signal block has parameters too, so they follow the same rule; their source is "setting".
    """
    own = (kind.__doc__ or "").strip()
    found = [] if own and kind.__doc__ is not Component.__doc__ else [f"{kind.__name__} has no docstring"]
    for name, declared in declarations(kind).items():
        where = f"{kind.__name__}.{name}"
        if isinstance(declared, Parameter):
            found += [f"{where} {flaw}" for flaw in _parameter_flaws(declared)]
        if isinstance(declared, (Port, Input, Output, State, Parameter)) and not declared.description:
            found.append(f"{where} has no description")
        if isinstance(declared, (Input, Output, State)) and declared.written_in:
            found.append(f"{where} is not in SI")
    return found


def _parameter_flaws(parameter: Parameter) -> list[str]:
    low, high = parameter.bounds
    flaws = [] if parameter.source else ["has no source"]
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        flaws.append("has no finite bounds")
    if not callable(parameter.value) and not low <= parameter.value <= high:
        flaws.append("lies outside its bounds")
    if parameter.value == 0 and parameter.nominal is None:
        flaws.append("is zero and has no nominal, so nothing says how large a change matters")
    if parameter.written_in:
        flaws.append("is not in SI")
    return flaws
