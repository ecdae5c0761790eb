"""What is asked: the recordings and wishes of a caller, and the search that a model of either kind makes of them.

A model whose equations are known and an FMU with its surroundings differ in how recordings are cut, where effects fit
and how candidates are looked at. From there on the way to an answer is one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.identification.noise import quanta, solver_error
from hydrotwin.identification.outliers import Strays
from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.model import Model
from hydrotwin.models.language.units import compatible

from .evidence.deciding import DECIDING
from .fits.job import Question
from .recordings import Split
from .structures.table import Table

NARROW, WIDE = 2.0, 30.0  # factors around the start within which a positive base parameter may move


@dataclass(frozen=True, eq=False)
class Wanted:
    """What the caller said, as in `discover`."""

    records: Sequence
    validate: Sequence
    free: Sequence[str] | None
    effects: Sequence[str] | None
    exclude: Sequence[str]
    initial_states: str
    outputs: Sequence[str] | None
    noise: Mapping[str, float] | None
    step: float | None
    interpolation: Mapping[str, str] | None


@dataclass(frozen=True, eq=False)
class Asked:
    """What a search begins with.

    model : as it was given, with its own bounds; bounded: as it is searched. names : what is identified along.
    note : what the user should know before it begins.
    """

    model: Model
    bounded: Model
    names: tuple[str, ...]
    data: Split
    candidates: tuple[Candidate, ...]
    initial_states: str
    note: str = ""

    def table(self, step: float | None, told: Sequence[bool]) -> Table:
        """The empty table of a search. step [s] of the runs, None: as they need; told: outputs with a given noise."""
        flat, data = self.bounded.flat, self.data
        usual = {p.name: p.value for p in self.model.flat.parameters if p.name in self.names}
        question = Question(data.train, data.noise, initial_states=self.initial_states, step=step, usual=usual)
        unseen = [o.name for o, n in zip(flat.outputs, question.counts, strict=True) if not n]
        here = tuple(c for c in self.candidates if c.site.through not in unseen)  # no faults of sensors that are not
        digits = quanta(data.train)
        with np.errstate(invalid="ignore"):
            rounding = np.where(digits > DECIDING.coarse * data.noise, digits / np.sqrt(12), 0.0)
        coloured = np.fmax(solver_error(data.train), rounding)
        return Table(self.bounded, self.names, here, question, coloured, np.array(told))

    def without(self, alone: Strays) -> Asked:
        """The same without samples that stand alone; where they stay, they are told."""
        if alone.left_out:
            return dataclasses.replace(self, data=self.data.without(alone.masks))
        return self.telling(alone.sentences)

    def telling(self, sentences: Sequence[str]) -> Asked:
        """The same with more findings."""
        told = (*self.data.findings, *(f"gap: {sentence}" for sentence in sentences))
        return dataclasses.replace(self, data=dataclasses.replace(self.data, findings=told))


def bounded(model: Model, names: Sequence[str]) -> Model:
    """The model with what is to be identified free, and bounds around the start values of what is always positive.

    A base that lacks an effect swallows the gap with whatever lets it: a third of the dead volume, a fourth of the
    stiffness. Volumes and pressures stay within a factor of two, to which they are known, the rest within thirty.
    """
    changes = {}
    for p in model.flat.parameters:
        low, high = p.bounds
        if p.name in names and not p.free:
            changes[p.name] = {"free": True}
        if p.name in names and low > 0 and p.value > 0:
            factor = NARROW if any(compatible(p.unit, unit) for unit in ("m3", "m3/rad", "Pa")) else WIDE
            bounds = max(low, p.value / factor), min(high, p.value * factor)
            changes.setdefault(p.name, {}).update(bounds=bounds, unit=p.unit)
    return model.with_settings(changes, model.provenance) if changes else model


def free_names(flat: FlatModel, free: Sequence[str] | None) -> tuple[str, ...]:
    """The parameters that these globs name; None: those the model declares free."""
    from hydrotwin.identification.problem import free_parameters

    return free_parameters(flat, free).names
