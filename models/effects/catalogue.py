"""The catalogue: every named effect by its id, gathered from the families."""

from __future__ import annotations

import importlib

from .effect import Effect

FAMILIES = ("friction", "leakage", "fluid", "mechanism", "valve", "command", "sensor", "vessel")


def _gathered() -> dict[str, type[Effect]]:
    found: dict[str, type[Effect]] = {}
    for family in FAMILIES:
        module = importlib.import_module(f".{family}", __package__)
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
