"""What an exported system computes, as text that a person can read: Modelica of a model, the recursion of a block."""

from __future__ import annotations

import inspect
from dataclasses import dataclass

from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.modelica import modelica_text


@dataclass(frozen=True)
class AddedEffect:
    """An effect of the catalogue that was added to the machine: what it is, its equation, where it acts."""

    title: str
    name: str
    site: str
    equation: str
    source: str


@dataclass(frozen=True)
class Equations:
    """text : all of it. language : "modelica", "text", or "" where there is none. reason : why there is none."""

    text: str = ""
    language: str = ""
    reason: str = ""
    effects: tuple[AddedEffect, ...] = ()


def equations_of(system, told: str = "") -> Equations:
    """The equations of a Model, with its added effects; of anything else the words ``told`` by who exports it."""
    if not isinstance(system, Model):
        text = inspect.cleandoc(told)
        return Equations(text, "text" if text else "", "" if text else "None were given; see sources/functions.c.")
    effects = tuple(_effect(a) for a in system.additions if a.effect)
    try:
        return Equations(modelica_text(system), "modelica", effects=effects)
    except DeclarationError as failure:
        return Equations(reason=str(failure), effects=effects)


def _effect(addition) -> AddedEffect:
    title, equation, source = (getattr(addition.part, name, "") for name in ("title", "equation", "source"))
    return AddedEffect(title or addition.effect.replace("_", " "), addition.name, addition.site, equation, source)
