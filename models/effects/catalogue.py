"""The catalogue: every named effect by its id, gathered from the families."""

from __future__ import annotations

import importlib

from .effect import Effect

FAMILIES = {  # file -> row of the catalogue
    **{name: name for name in ("friction", "leakage", "fluid", "mechanism", "valve", "command")},
    "drive": "command",
    "sensor": "sensor",
    "deflection": "sensor",
    "vessel": "vessel",
}


def _gathered() -> dict[str, type[Effect]]:
    found: dict[str, type[Effect]] = {}
    for file, family in FAMILIES.items():
        module = importlib.import_module(f".{file}", __package__)
        for effect in vars(module).values():
            if (
                isinstance(effect, type)
                and issubclass(effect, Effect)
                and effect.id
                and effect.__module__ == module.__name__
            ):
                effect.family = family
                found[effect.id] = effect
    return found


CATALOGUE: dict[str, type[Effect]] = _gathered()
