"""Effect: a named physical phenomenon, written once for a kind of site, added to any model that has such a site."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State
from hydrotwin.models.language.additions import Addition
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import PLACEHOLDER
from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.places import Places

SIGNAL = PLACEHOLDER  # stands for the unit of the signal an effect is put into, in the units of its declarations


@dataclass(frozen=True)
class Site:
    """One place of one model where an effect may act.

    name : how files and reports call it; the other fields as in `Addition`.
    unit, nominal : of the signal, where it is one.
    also_free : parameters of the effect, otherwise held at neutral, that are looked for here as well.
    further : a place beside the usual ones of the effect, as a signal inside is for what else acts on commands: what
        is added there carries the place in its name, and `add_effect` takes it when it is asked for alone.
    """

    name: str
    ties: Mapping[str, str] | None = None
    reads: Mapping[str, str] | None = None
    through: str | Mapping[str, str] | None = None
    between: str | Mapping[str, str] | None = None
    frees: str | None = None
    unit: str = "1"
    nominal: float = 1.0
    holds: tuple[str, ...] = ()
    also_free: tuple[str, ...] = ()
    further: bool = False

    @property
    def place(self) -> frozenset[str]:
        """What an effect here acts on; the same for effects at the same nodes, whatever their ports are called."""
        return frozenset(self.ties.values() if self.ties else (self.name,))


class Effect(Component):
    """What is missing, perhaps: its equation, its parameters at the values where it is absent, where it may act.

    A subclass declares ports and equations as any component does. Parameters with ``free=True`` are those to be
    identified; every parameter is declared at its neutral value, where the effect changes nothing. In an effect on a
    signal, ``u`` is what comes in and ``y`` what goes on, and ``"signal"`` in a unit stands for the signal's unit:
    values, bounds and probes are then in units of its nominal value.

    Class attributes
    ----------------
    id, title, equation, source : as reports show them.
    family : the row of the catalogue.
    typical : parameter -> usual range (SI, or in nominals of the signal).
    probes : finite amplitudes from which to start, each a mapping parameter -> value.
    refines : simpler effects that this one contains: id -> own parameter -> theirs that it then equals.
    confused_with : ids that leave the same traces in many recordings.
    experiment : what tells it from those.
    order : of effects on one signal, from the input on: 0 dead time ... 9 the last before the machine.
    """

    id: ClassVar[str] = ""
    title: ClassVar[str] = ""
    equation: ClassVar[str] = ""
    source: ClassVar[str] = ""
    family: ClassVar[str] = ""
    typical: ClassVar[Mapping[str, tuple[float, float]]] = {}
    probes: ClassVar[Sequence[Mapping[str, float]]] = ()
    refines: ClassVar[Mapping[str, Mapping[str, str]]] = {}
    confused_with: ClassVar[tuple[str, ...]] = ()
    experiment: ClassVar[str] = ""
    order: ClassVar[int] = 5

    @classmethod
    def sites(cls, places: Places) -> Iterator[Site]:
        """Every site of a model that this effect fits."""
        raise NotImplementedError

    @classmethod
    def known(cls, places: Places) -> Iterator[Site]:
        """Sites at which a free parameter of the model is the effect already: it fits nowhere that is the same."""
        return iter(())

    @classmethod
    def at(cls, site: Site) -> Component | None:
        """The part for a site: units and scales of the signal put in. None for an effect that frees a parameter."""
        if site.frees:
            return None
        changes = {}
        for name, declared in declarations(cls).items():
            if isinstance(declared, (Parameter, State, Input, Output)) and SIGNAL in declared.unit:
                changes[name] = _scaled(declared, site)
            if name in site.also_free:
                changes[name] = replace(changes.get(name, declared), free=True)
        return cls(**changes)

    @classmethod
    def freed(cls, value: float) -> tuple[tuple[float, ...], tuple[float, float]]:
        """Starts and usual range of a parameter that is freed at ``value``: probes and typical are factors of it."""
        factors = [factor for probe in cls.probes for factor in probe.values()]
        low, high = next(iter(cls.typical.values()))
        return tuple(value * factor for factor in factors), tuple(sorted((value * low, value * high)))


def _scaled(declared, site: Site):
    """A declaration in units of the signal."""
    power = -1 if declared.unit.startswith("1/") else 1
    scale = site.nominal**power
    unit = declared.unit.replace(SIGNAL, f"({site.unit})") if site.unit != "1" else _without_signal(declared.unit)
    unit = site.unit if unit == f"({site.unit})" else unit
    if isinstance(declared, Parameter):
        return Parameter(
            declared.value * scale,
            unit,
            declared.description,
            bounds=tuple(b * scale for b in declared.bounds),
            nominal=(declared.nominal or 1.0) * scale,
            source=declared.source,
            free=declared.free,
        )
    if isinstance(declared, State):
        start = declared.start if callable(declared.start) else declared.start * scale
        return State(start, unit, declared.description, nominal=declared.nominal * scale, fixed=declared.fixed)
    return type(declared)(unit, declared.description, nominal=declared.nominal * scale)


def _without_signal(unit: str) -> str:
    """``signal/s`` -> ``1/s``; ``1/signal`` -> ``1``; ``signal`` -> ``1``."""
    return "1" if unit == "1/signal" else unit.replace(SIGNAL, "1")


@dataclass(frozen=True)
class Candidate:
    """An effect at a site of a model: what may be added to it.

    name : path of the part; free : paths of its free parameters; neutral : their values when absent (for an effect
    that frees a parameter, that parameter and its present value); probes : starts, by path; typical : by path.
    twins : labels of the same effect at other places, where the equations cannot tell it from this one.
    """

    effect: type[Effect]
    site: Site
    name: str
    free: tuple[str, ...]
    neutral: Mapping[str, float]
    probes: tuple[Mapping[str, float], ...]
    typical: Mapping[str, tuple[float, float]]
    twins: tuple[str, ...] = ()

    @property
    def id(self) -> str:
        return self.effect.id

    @property
    def label(self) -> str:
        """``id at site``."""
        return f"{self.id} at {self.site.name}"

    def refines(self, other: Candidate) -> bool:
        """Whether this is the other, at the same place, and more."""
        return other.id in self.effect.refines and bool(self._places & other._places)

    @property
    def _places(self) -> set[frozenset[str]]:
        """Its place and those of its twins, which are called after their ports."""
        return {self.site.place, *(frozenset((twin.partition(" at ")[2],)) for twin in self.twins)}

    @property
    def addition(self) -> Addition:
        """What to give to `Model.plus`."""
        s = self.site
        return Addition(
            self.name,
            self.effect.at(s),
            s.ties or {},
            s.reads or {},
            s.through,
            s.between,
            s.frees,
            self.id,
            s.name,
            s.holds,
        )


def candidates(
    model: Model, effects: Sequence[str] | None = None, exclude: Sequence[str] = (), *, merged: bool = True
) -> tuple[Candidate, ...]:
    """Every effect of the catalogue at every site of a model that it fits, in the order they act.

    Args: effects, exclude: globs over ids or ``id at site``; unknown ones raise DeclarationError with the nearest.
    merged: sites that the equations cannot tell apart are one candidate, which tells its ``twins``; sites at which
    nothing would move are none, nor is a parameter beside free ones that do the same; otherwise all that fits.
    """
    from .alike import gathered
    from .catalogue import CATALOGUE

    check_patterns((*(effects or ()), *exclude))
    places = Places(model)
    wanted = [e for e in CATALOGUE.values() if _wanted_somewhere(e.id, effects)]
    sites = {effect: list(effect.sites(places)) for effect in sorted(wanted, key=lambda e: e.order)}
    groups = gathered(places, sites) if merged else {e: [(site,) for site in found] for e, found in sites.items()}
    values = {p.name: p.value for p in (*model.flat.parameters, *(p for p, _ in model.followers))}
    here, found = {(a.effect, a.site) for a in model.additions}, []
    for effect, several in groups.items():
        for group in several:
            if not any((effect.id, site.name) in here for site in group):
                one = _candidate(effect, group[0], _alone(group[0], sites[effect]), values)
                found.append(replace(one, twins=tuple(f"{effect.id} at {site.name}" for site in group[1:])))
    return tuple(c for c in found if _wanted(c, effects, exclude))


def check_patterns(patterns: Iterable[str]) -> None:
    """Raises DeclarationError, with the nearest, for a glob over ids or ``id at site`` that no effect is called."""
    from .catalogue import CATALOGUE

    for pattern in patterns:
        word = pattern.partition(" at ")[0]
        if not fnmatch.filter(CATALOGUE, word):
            raise DeclarationError(f"effects: none is called '{word}'. {nearest(word, CATALOGUE)}")


def _alone(site: Site, sites: Sequence[Site]) -> bool:
    """Whether this is the only usual site of an effect."""
    return [s for s in sites if not s.further] == [site]


def _wanted_somewhere(effect: str, patterns) -> bool:
    return patterns is None or any(fnmatch.fnmatch(effect, pattern.partition(" at ")[0]) for pattern in patterns)


def _wanted(candidate: Candidate, effects, exclude) -> bool:
    words = (candidate.id, candidate.label, *candidate.twins)
    inside = effects is None or any(fnmatch.fnmatch(w, pattern) for w in words for pattern in effects)
    return inside and not any(fnmatch.fnmatch(w, pattern) for w in words for pattern in exclude)


def _candidate(effect: type[Effect], site: Site, alone: bool, values: Mapping[str, float]) -> Candidate:
    if site.frees:
        path, value = site.frees, values[site.frees]
        starts, usual = effect.freed(value)
        return Candidate(effect, site, "", (path,), {path: value}, tuple({path: s} for s in starts), {path: usual})
    name = effect.id if alone else f"{effect.id}_{re.sub(r'[^0-9A-Za-z]+', '_', site.name).strip('_')}"
    part = effect.at(site)
    declared = {k: d for k, d in declarations(type(part)).items() if isinstance(d, Parameter)}
    own = {k: part.declared(k) for k in declared}
    free = tuple(f"{name}.{k}" for k, p in own.items() if p.free)
    scale = {k: _ratio(own[k], declared[k]) for k in own}
    probes = tuple({f"{name}.{k}": v * scale[k] for k, v in probe.items() if k in own} for probe in effect.probes)
    typical = {f"{name}.{k}": tuple(v * scale[k] for v in t) for k, t in effect.typical.items() if k in own}
    neutral = {f"{name}.{k}": p.value for k, p in own.items() if p.free}
    return Candidate(effect, site, name, free, neutral, probes, typical)


def _ratio(scaled: Parameter, declared: Parameter) -> float:
    """By how much a declaration was scaled."""
    if scaled is declared:
        return 1.0
    return (scaled.nominal or 1.0) / (declared.nominal or 1.0)


def add_effect(model: Model, effect: str, site: str | None = None, values: Mapping[str, float] | None = None) -> Model:
    """The model with one effect more, at neutral or at ``values`` (parameter -> SI); the model itself is unchanged.

    >>> from hydrotwin.models.cehA import model
    >>> leaking = add_effect(model(), "internal_leakage", values={"conductance": 1e-14})
    >>> [a.site for a in leaking.additions]
    ['cylinder.annulus-cylinder.cap']

    Raises DeclarationError: no such effect, no such site (or several and none chosen), no such parameter.
    """
    fitting = candidates(model, [effect], merged=False)
    if not fitting:
        raise DeclarationError(
            f"{model.name}: '{effect}' fits nowhere here. 'hydrotwin effects' lists what fits where."
        )
    sites = {c.site.name: c for c in fitting}
    usual = [c for c in fitting if not c.site.further] or fitting
    if site is None and len(usual) > 1:
        raise DeclarationError(f"{model.name}: '{effect}' fits at several sites ({', '.join(sites)}). Choose one.")
    if site is not None and site not in sites:
        raise DeclarationError(f"{model.name}: '{effect}' does not fit at '{site}'. {nearest(site, sites)}")
    chosen = sites[site] if site else usual[0]
    added = model.plus([chosen.addition])
    settings = {(k if "." in k else f"{chosen.name}.{k}"): float(v) for k, v in (values or {}).items()}
    return added.with_parameters(settings, added.provenance) if settings else added


def neutral_difference(model: Model, candidate: Candidate, inputs: np.ndarray, times: np.ndarray) -> float:
    """Largest relative change of rates and outputs that adding a candidate at neutral makes; 0 when it is absent.

    Args: inputs (n, nu), times (n,): operating points, states drawn around the start.
    """
    base, added = model.flat, model.plus([candidate.addition], sought=True).flat
    order = [s.name for s in added.states]
    where = [order.index(s.name) for s in base.states]
    p, q = base.parameter_vector(), added.parameter_vector()
    around, worst = base.start_given()(inputs[0], p, []).full().ravel(), 0.0
    start = added.start_given()(inputs[0], q, []).full().ravel()
    spread, draw = 0.05 * np.array([s.nominal for s in base.states]), np.random.default_rng(0)
    for u, t in zip(inputs, times, strict=True):
        x = start.copy()
        x[where] = z = around + spread * draw.uniform(-1, 1, len(around))
        for ours, theirs in zip(base.ode(t, z, u, p), added.ode(t, x, u, q), strict=True):
            a, b = ours.full().ravel(), theirs.full().ravel()
            b = b[where] if len(b) == len(order) and len(a) == len(where) else b
            worst = max(worst, float(np.max(np.abs(a - b) / (np.abs(a) + 1e-300), initial=0.0)))
    return worst
