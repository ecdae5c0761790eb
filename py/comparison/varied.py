"""Models as a variant wants them: other values, effects taken out or added, another step or method."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hydrotwin.models.effects import Candidate, candidates
from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel, no_parameter
from hydrotwin.models.language.quantities import Wanted, in_unit, wanted

from .variants import Variant


@dataclass(frozen=True)
class Thing:
    """A model of a scenario before it is a contender, under its name there."""

    name: str
    thing: object


def varied(one: Thing, variant: Variant) -> object:
    """The model as the variant wants it; the same object where it changes nothing of it.

    Raises what the model raises for a value or an effect that it cannot take.
    """
    if not concerns(one, variant):
        return one.thing
    made = one.thing
    if isinstance(made, Model):
        made = _with_effects(made, variant)
    known = settable(made)
    values = {path: value for path, value in variant.parameters.items() if path in known}
    return with_values(made, values) if values else made


def with_values(thing, values: Mapping[str, object]) -> object:
    """The model with these values, in SI or as a text with a unit. What a fit said of a value that is set is gone.

    Raises DeclarationError for a text that is no number and a number alone that may mean two, and what the model raises
    for what it cannot take.
    """
    if hasattr(thing, "with_values"):
        return thing.with_values({path: _as_written(value) for path, value in values.items()})
    own = _asked(thing)
    if unknown := [path for path in values if path not in own]:
        raise no_parameter(thing.name, unknown[0], own)
    numbers = {path: in_unit(value, own[path]) for path, value in values.items()}
    if isinstance(thing, Model):
        return thing.with_settings({n: {"value": v, "unit": own[n].unit} for n, v in numbers.items()})
    return thing.with_parameters(numbers)


def _asked(thing) -> Mapping[str, Wanted]:
    """What can be set of a model with equations."""
    return thing.asked if isinstance(thing, Model) else {p.name: wanted(p, thing.name) for p in thing.parameters}


def _as_written(value: object) -> str:
    """A value of a scenario as a text, of which a unit is asked where a number alone may mean two."""
    return value if isinstance(value, str) else str(value).lower()


def run_as(contender, variant: Variant):
    """The contender with the step and the method of the variant, where it takes any."""
    if (variant.step is None and variant.method is None) or not hasattr(contender, "stepped"):
        return contender
    return contender.stepped(variant.step, variant.method)


def concerns(one: Thing, variant: Variant) -> bool:
    """Whether the variant is about this model at all."""
    return not variant.models or one.name in variant.models


def settable(thing) -> set[str]:
    """Paths of what can be set; those of a learned block: none."""
    if hasattr(thing, "with_values"):
        return set(thing.description.scales)
    if isinstance(thing, Model):
        return {p.name for p in (*thing.flat.parameters, *(p for p, _ in thing.followers))}
    return {p.name for p in thing.parameters} if isinstance(thing, FlatModel) else set()


def check_variant(things: Sequence[Thing], variant: Variant, where: str) -> None:
    """Refuse what no model of the scenario knows. Raises DeclarationError with the nearest right name."""
    where = f"{where}: variant '{variant.name}'"
    names = [one.name for one in things]
    for name in variant.models:
        if name not in names:
            raise DeclarationError(f"{where}: no model '{name}'. {nearest(name, names)}")
    asked = [one for one in things if concerns(one, variant)]
    if (variant.step or variant.method) and not any(hasattr(getattr(t.thing, "flat", t.thing), "ode") for t in asked):
        raise DeclarationError(f"{where}: none of its models has equations that take a step or a method.")
    effects = [word for one in asked for word in _words(one.thing)]
    for pattern in variant.effects_off:
        if not fnmatch.filter(effects, pattern):
            known = nearest(pattern, effects) if effects else "None of its models has one; a model file may name some."
            raise DeclarationError(f"{where}: no model has an effect '{pattern}' to put off. {known}")
    models = [one.thing for one in asked if isinstance(one.thing, Model)]
    if variant.effects_on and not models:
        raise DeclarationError(f"{where}: none of its models has equations that an effect could be added to.")
    for effect in variant.effects_on:
        labels = [word for model in models for c in _fitting(model, effect) for word in (c.id, c.label)]
        if effect not in labels:
            raise DeclarationError(f"{where}: '{effect}' fits in no model. {nearest(effect, sorted(set(labels)))}")
    made = [_with_effects(model, variant) if variant.effects_on else model for model in models]
    known = set().union(*map(settable, [*made, *(one.thing for one in asked)]))
    for path in variant.parameters:
        if path not in known:
            raise DeclarationError(f"{where}: no model has a parameter '{path}'. {nearest(path, sorted(known))}")
    _check_set(models, made, variant, where)


def _check_set(models: Sequence[Model], made: Sequence[Model], variant: Variant, where: str) -> None:
    """What an added effect is without values is nothing."""
    for before, after in zip(models, made, strict=True):
        for addition in after.additions[len(before.additions) :] if variant.effects_on else ():
            own = [p for p in settable(after) if p.startswith(f"{addition.name}.")]
            if not any(path in variant.parameters for path in own):
                raise DeclarationError(
                    f"{where}: {addition.effect} changes nothing at the values at which it is added. Set one of "
                    f"{', '.join(sorted(own))} in its parameters."
                )


def _words(thing) -> list[str]:
    """How effects of a model may be called."""
    return [word for a in getattr(thing, "additions", ()) for word in _names(a)]


def _names(addition) -> list[str]:
    return [addition.effect, f"{addition.effect} at {addition.site}"] if addition.effect else [addition.name]


def _with_effects(model: Model, variant: Variant) -> Model:
    """Without those to put off, with those to add that fit it."""
    off = [a for a in model.additions if any(fnmatch.filter(_names(a), p) for p in variant.effects_off)]
    model = model.without(off) if off else model
    found = [_candidate(model, effect) for effect in variant.effects_on]
    added = [one.addition for one in found if one]
    return model.plus(added, sought=True) if added else model


def _candidate(model: Model, effect: str) -> Candidate | None:
    """The effect of the catalogue at its one place, or at the place that is named; None where it does not fit."""
    fitting = [c for c in _fitting(model, effect) if effect in (c.id, c.label)]
    if len(fitting) > 1:
        labels = ", ".join(c.label for c in fitting)
        raise DeclarationError(f"{model.name}: '{effect}' fits at several places. Name one: {labels}.")
    return fitting[0] if fitting else None


def _fitting(model: Model, effect: str) -> list[Candidate]:
    return [c for c in candidates(model, [effect.partition(" at ")[0]], merged=False) if not c.site.frees]
