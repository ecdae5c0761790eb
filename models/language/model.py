"""Model: a component tree with its parameter values. Immutable; flattens to one explicit ODE."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType

import casadi as ca
import numpy as np

from .acting import refuse_idle
from .additions import Addition, named, outputs_without
from .component import Component
from .declarations import finite
from .errors import DeclarationError, SolveError, TopologyError, nearest
from .flat import (
    FlatModel,
    ParameterValue,
    Signal,
    StateVariable,
    by_name,
    changed,
    no_parameter,
    same_value,
    since_set,
)
from .flattening import Solved, elaborate, solve
from .initialisation import initialisation
from .parameter_file import setting_in_si
from .provenance import OF_NO_FIT, lasting
from .quantities import Wanted, in_target, in_unit
from .regularity import check_solvable, loops_of
from .summary_html import model_html

_KEPT = ("root", "name", "step", "settings", "provenance", "inputs_changed")  # of a model with other parts
_NUMBERS = ("value", "bounds", "sigma")  # of a setting, in its unit


class Model:
    """A component tree, its name, and the parameter values that differ from the declarations.

    Parameters
    ----------
    root : the top component; its Inputs and Outputs are those of the model.
    name : used in files, errors and exports; the class name in lower camel case by default.
    settings : ``{path: value}`` in SI, or ``{path: {...}}`` with value, unit, bounds, sigma, source, free.
    step : recommended fixed integration step [s].
    additions : parts added from outside, see `plus`.
    inputs : what inputs do between samples where that is not as declared, see `with_inputs`.

    Raises
    ------
    DeclarationError, TopologyError, UnitError : when `flat` is first asked for.
    """

    sought = False  # its additions are looked for: they need not act

    def __init__(
        self,
        root: Component,
        name: str | None = None,
        *,
        settings: Mapping = (),
        step: float = 1e-3,
        provenance: Mapping | None = None,
        additions: Iterable[Addition] = (),
        inputs: Mapping[str, Mapping] = MappingProxyType({}),
    ):
        if not isinstance(root, Component):
            raise DeclarationError(f"Model: {root!r} is no component. Give an instance of a Component subclass.")
        self.root = root
        kind = type(root).__name__
        if not isinstance(name, str | None):
            raise DeclarationError(f"Model: the name is no text (got {name!r}). Write name='press'.")
        self.name = name or kind[0].lower() + kind[1:]
        self.step = finite(f"{self.name}: Model", "step", step)
        if not self.step > 0:
            raise DeclarationError(f"{self.name}: the step is no time ahead (got {step:g} s). Give seconds above zero.")
        self.provenance = dict(provenance or {})
        self.additions = tuple(additions)
        self.inputs_changed = dict(by_name(inputs, self.name, "inputs", "{'name': {'interpolation': 'linear'}}"))
        self.settings = self._in_si(settings)

    def _in_si(self, settings: Mapping) -> dict[str, dict]:
        """Settings in SI; a number alone is a value."""
        settings = by_name({} if settings == () else settings, self.name, "settings", "{'part.name': 1.0}")
        rows = {path: c if isinstance(c, Mapping) else {"value": c} for path, c in settings.items()}
        return {path: setting_in_si(change, f"{self.name}.{path}") for path, change in rows.items()}

    # -- other models ------------------------------------------------------------------------------------------
    def with_settings(self, settings: Mapping, provenance: Mapping | None = None) -> Model:
        """The same structure with further values, bounds, sigmas or sources, by path.

        Another value has no deviation and no source but what is given with it, and by default its model no provenance
        but what `since_set` leaves.
        """
        merged, new = {k: dict(v) for k, v in self.settings.items()}, self._in_si(settings)
        moved = self._moved(new)
        for path, change in new.items():
            if "unit" not in change and any(change.get(key) is not None for key in _NUMBERS):
                merged.get(path, {}).pop("unit", None)  # of the numbers before, and it vouches for no others
            merged.setdefault(path, {}).update({**OF_NO_FIT, **change} if path in moved else change)
        if provenance is None:
            provenance = since_set(self.flat, moved) if moved else self.provenance
        other = Model(
            self.root, self.name, settings=merged, step=self.step, provenance=provenance, additions=self.additions,
            inputs=self.inputs_changed,
        )  # fmt: skip
        other.sought = self.sought
        if set(merged) - set(self.settings) <= {p.name for p in self.flat.parameters}:
            other.__dict__["_solved"] = self._solved  # the equations are the same: solve them once
            other.__dict__["_functions"] = self._functions
        return other

    def _moved(self, changes: Mapping[str, Mapping]) -> list[str]:
        """Paths that have another value in ``changes``, which are as `_in_si` gives them."""
        own, entries = self.flat.parameters, {q.path: q for q in self._solved.elaboration.parameters}
        known = {p.name: p.value for p in own}
        known |= {p.name: p.value for p, _ in self.followers} if changes.keys() - known.keys() else {}
        said = {n: self._numbers_of(entries[n], c) for n, c in changes.items() if n in entries and "value" in c}
        return [n for n, c in said.items() if n not in known or not same_value(c["value"], known[n])]

    def with_parameters(self, values: Mapping[str, float], provenance: Mapping | None = None) -> Model:
        """The same model with other parameter values (SI)."""
        units = {p.path: p.unit for p in self._solved.elaboration.parameters}
        changes = {k: {"value": v, "unit": units[k]} if k in units else v for k, v in values.items()}
        return self.with_settings(changes, provenance)

    def with_inputs(self, changes: Mapping[str, Mapping]) -> Model:
        """The same model whose inputs do something else between samples.

        changes : by input ``interpolation`` ("hold", "linear"), ``chosen_by``, ``why``, ``shift`` [s]; see `Signal`.

        Raises DeclarationError for an unknown input or interpolation.
        """
        before, other = self.inputs_changed, copy.copy(self)
        other.__dict__ = {**self.__dict__, "flat": self.flat.with_inputs(changes)}  # the equations are the same
        merged = {name: {**before.get(name, {}), **change} for name, change in changes.items()}
        other.inputs_changed = {**before, **merged}
        return other

    def _bare(self, since: str) -> Model:
        """A copy without what is made of its parts; since : what was changed of these, "" for nothing."""
        other = copy.copy(self)
        other.__dict__ = {k: self.__dict__[k] for k in _KEPT}
        other.provenance = lasting(self.provenance, since) if since else self.provenance
        return other

    def but(self, name: str | None = None, **changes) -> Model:
        """A model whose root component has other parts or laws: ``model.but(cylinder=...)``."""
        other = self._bare(f"{', '.join(changes)} exchanged" if changes else "")
        other.additions, other.sought = self.additions, self.sought
        other.root, other.name = self.root.but(**changes), name or self.name
        return other

    def plus(self, additions: Iterable[Addition], *, sought: bool = False) -> Model:
        """The same model with further parts tied in, and further parameters free or held; see `Addition`.

        sought : the additions are looked for; otherwise one that changes nothing is refused when `flat` is asked for.
        """
        added = tuple(additions)
        other = self._bare(named(added, "added"))
        other.additions, other.sought = (*self.additions, *added), True  # until what it frees or holds is independent
        freed = {a.frees: {"free": True} for a in other.additions if a.frees}
        wanted = {path for a in other.additions for path in a.holds}
        held = {p.name: {"value": p.value, "unit": p.unit} for p, _ in self.followers if p.name in wanted}
        settings = {path: {**held.get(path, {}), **freed.get(path, {})} for path in (*held, *freed)}
        final = other.with_settings(settings, other.provenance) if settings else other
        final.sought = sought or self.sought
        return final

    def without(self, additions: Iterable[Addition]) -> Model:
        """The same model without some of its additions, and without what was set of them: what `plus` added is gone."""
        gone = [a for a in self.additions if any(a is other for other in additions)]
        kept = [a for a in self.additions if not any(a is other for other in gone)]
        parts = tuple(f"{a.name}." for a in gone if a.part is not None)
        held = {path for a in kept for path in (*a.holds, *([a.frees] if a.frees else []))}
        own = {path for a in gone for path in (*a.holds, *([a.frees] if a.frees else []))} - held
        other = self._bare(named(gone, "taken out"))
        other.additions, other.sought = tuple(kept), self.sought
        other.settings = {p: s for p, s in self.settings.items() if p not in own and not p.startswith(parts)}
        return other

    @cached_property
    def followers(self) -> tuple[tuple[ParameterValue, frozenset[str]], ...]:
        """Parameters that follow others, with the values they have now, each with the paths of those it follows.

        What follows a signal (a viscosity the oil's temperature) has no value, and is none of them.
        """
        solved, found = self._solved, []
        entries = {q.symbol.element_hash(): q for q in solved.elaboration.parameters}
        for key, expression in solved.bindings.items():
            sources = [entries.get(s.element_hash()) for s in ca.symvar(expression)]
            if None in sources:
                continue
            values = [self._parameter(q).value for q in sources]
            value = float(ca.substitute(expression, ca.vertcat(*(q.symbol for q in sources)), ca.vertcat(*values)))
            found.append((self._parameter(entries[key], value), frozenset(q.path for q in sources)))
        return tuple(found)

    @cached_property
    def varying(self) -> tuple[str, ...]:
        """Paths of what is declared a parameter and follows a signal, as a viscosity the temperature of the oil."""
        elaboration, _ = elaborate(self.root, self.name, (), self.additions)
        paths = {q.symbol.element_hash(): q.path for q in elaboration.parameters}
        bindings = solve(elaboration).bindings
        follow = {key: {s.element_hash() for s in ca.symvar(e)} for key, e in bindings.items()}
        return tuple(paths[key] for key, sources in follow.items() if not sources <= paths.keys())

    # -- flattening --------------------------------------------------------------------------------------------
    @cached_property
    def _solved(self) -> Solved:
        elaboration, _ = elaborate(self.root, self.name, tuple(self.settings), self.additions)
        known = {p.path: p.unit for p in elaboration.parameters}
        for path in self.settings:
            if path not in known:
                leaf = path.rpartition(".")[2]
                start = any(path == s.path for s in elaboration.states)
                hint = f"It is a state: give its start to the part, ..({leaf}=..)." if start else ""
                raise no_parameter(self.name, path, known, hint)
        return solve(elaboration)

    @cached_property
    def _functions(self):
        """CasADi functions of the explicit ODE and the names of the states that outputs measure."""
        solved = self._solved
        e = solved.elaboration
        x = ca.vertcat(*(s.symbol for s in e.states))
        u = ca.vertcat(*(i.symbol for i in e.inputs))
        independent = [q for q in e.parameters if q.symbol.element_hash() not in solved.bindings]
        p = ca.vertcat(*(q.symbol for q in independent))
        rates = [solved.of(e.derivatives[s.symbol.element_hash()][1]) for s in e.states]
        outputs = [solved.of(o.symbol) for o in e.outputs]
        self._refuse_mixed_delay(solved)
        seen = outputs_without(self.additions, e, outputs)
        measured = {
            s.path: next((o.path for o, y in zip(e.outputs, seen, strict=True) if ca.is_equal(y, s.symbol)), None)
            for s in e.states
        }
        ode = ca.Function(
            "ode",
            [e.time, ca.SX(x), ca.SX(u), ca.SX(p)],
            [ca.SX(ca.vertcat(*rates)), ca.SX(ca.vertcat(*outputs))],
            ["t", "x", "u", "p"],
            ["xdot", "y"],
            {"cse": True},
        )
        return ode, initialisation(solved, ca.SX(u), ca.SX(p), rates), measured, independent

    def _refuse_mixed_delay(self, solved: Solved) -> None:
        """An input may be used delayed or not delayed, not both."""
        for path in solved.dead_times:
            if path in solved.undelayed_inputs:
                raise TopologyError(
                    f"{self.name}: input '{path}' is used both delayed by {solved.dead_times[path]} and not delayed. "
                    "Declare a second input for the other use."
                )

    @cached_property
    def flat(self) -> FlatModel:
        """The explicit ODE with named vectors, see `FlatModel`."""
        ode, start, measured, independent = self._functions
        solved = self._solved
        e = solved.elaboration
        flat = FlatModel(
            name=self.name,
            description=(type(self.root).__doc__ or "").strip().split("\n")[0],
            inputs=changed([self._input(i) for i in e.inputs], self.inputs_changed, self.name),
            outputs=tuple(
                Signal(o.path, o.unit, d.description, d.nominal, written_in=d.written_in)
                for o in e.outputs
                for d in [o.declaration]
            ),
            states=tuple(
                StateVariable(s.path, s.unit, d.description, d.nominal, d.bounds, measured[s.path], d.written_in)
                for s in e.states
                for d in [s.declaration]
            ),
            parameters=tuple(self._parameter(q) for q in independent),
            ode=ode,
            initialisation=start,
            step=self.step,
            loops=loops_of(solved),
            provenance=self.provenance,
        )
        check_solvable(solved, flat)
        if self.additions and not self.sought:
            refuse_idle(solved, self.additions, flat)
        return flat

    @property
    def asked(self) -> dict[str, Wanted]:
        """Parameter, those that follow others too -> what a number for it is asked for."""
        return {e.path: self._asked(e) for e in self._solved.elaboration.parameters}

    def _asked(self, entry) -> Wanted:
        return Wanted(f"{self.name}.{entry.path}", entry.unit, entry.declaration.written_in)

    def _input(self, entry) -> Signal:
        d = entry.declaration
        dead_time = self._solved.dead_times.get(entry.path)
        by = "model" if d.interpolation else None
        return Signal(
            entry.path, entry.unit, d.description, d.nominal, d.interpolation, dead_time, d.default, by,
            written_in=d.written_in,
        )  # fmt: skip

    def _parameter(self, entry, follows: float | None = None) -> ParameterValue:
        d, change = entry.declaration, self._numbers_of(entry)
        value = change.get("value", follows if callable(d.value) else d.value)
        if value is None:
            raise DeclarationError(
                f"{self.name}.{entry.path}: this parameter follows others. Give it a value to free it."
            )
        low, high = change.get("bounds", d.bounds)
        if not low <= value <= high:
            raise DeclarationError(
                f"{self.name}.{entry.path}: value outside its bounds (got {value:g} {entry.unit}). "
                f"It must lie in [{low:g}, {high:g}]. Correct the value or widen the bounds."
            )
        return ParameterValue(
            name=entry.path,
            value=float(value),
            unit=entry.unit,
            bounds=(float(low), float(high)),
            nominal=d.nominal or abs(float(value)) or 1.0,
            sigma=change.get("sigma"),
            source=change.get("source", d.source),
            description=d.description,
            free=bool(change.get("free", d.free)),
            written_in=d.written_in,
        )

    def _numbers_of(self, entry, change: Mapping | None = None) -> Mapping:
        """What is set of a parameter, or is to be, its numbers in SI."""
        change, asked = dict(self.settings.get(entry.path, {}) if change is None else change), self._asked(entry)
        unit = change.get("unit")
        for key in (key for key in _NUMBERS if change.get(key) is not None):
            if unit:
                of = replace(asked, difference=key == "sigma")
                several = isinstance(change[key], tuple)
                turned = [in_target(n, unit, of) for n in (change[key] if several else [change[key]])]
                change[key] = tuple(turned) if several else turned[0]
            for number in np.atleast_1d(change[key]) if asked.written_in and not unit else ():
                in_unit(float(number), asked, f"{{'{key}': .., 'unit': '{asked.written_in}'}}")
        return change

    # -- looking inside ----------------------------------------------------------------------------------------
    def observe(self, paths: Iterable[str]) -> ca.Function:
        """Any variables by path: ``(t, x, u, p) -> values``, shape (len(paths),)."""
        solved = self._solved
        e = solved.elaboration
        known = {v.path: v.symbol for v in [*e.variables, *e.states, *e.inputs, *e.parameters]}
        known |= {f"der({s.path})": e.derivatives[s.symbol.element_hash()][1] for s in e.states}
        chosen = []
        for path in paths:
            if path not in known:
                raise DeclarationError(f"{self.name}: no variable '{path}'. {nearest(path, known)}")
            chosen.append(solved.of(known[path]))
        arguments = self._functions[0].sx_in()
        symbols = [*(s.symbol for s in e.states), *(i.symbol for i in e.inputs)]
        symbols += [q.symbol for q in self._functions[3]] + [e.time]
        t, x, u, p = arguments
        targets = [*ca.vertsplit(x), *ca.vertsplit(u), *ca.vertsplit(p), t]
        values = ca.substitute([ca.vertcat(*chosen)], symbols, targets)[0]
        return ca.Function("observe", arguments, [values], ["t", "x", "u", "p"], ["values"])

    def equilibrium(self, inputs: Mapping[str, float] | None = None, states: Mapping[str, float] | None = None):
        """The start state that the initial equations give for constant inputs and given states, shape (nx,), SI."""
        u = np.array([(inputs or {}).get(i.name, i.default) for i in self.flat.inputs])
        given = states or {}
        start = self.flat.start_given(tuple(given))
        x = np.array(start(u, self.flat.parameter_vector(), list(given.values()))).ravel()
        lost = [s.name for s, value in zip(self.flat.states, x, strict=True) if not np.isfinite(value)]
        if lost:
            raise SolveError(
                f"{self.name}: no static equilibrium found for {', '.join(lost)} (got inputs {u.tolist()}). "
                "Give these states, other inputs, or a start value nearer to the equilibrium."
            )
        return x

    def linearize(self, at: Mapping[str, float] | None = None, *, steady: bool = False):
        """The linear model around an operating point as `control.StateSpace`, see `linearisation.linearise`."""
        from .linearisation import linearise

        return linearise(self, at, steady=steady)

    def __repr__(self):
        flat = self.flat
        return (
            f"Model({self.name}: {len(flat.states)} states, {len(flat.inputs)} inputs, {len(flat.outputs)} outputs, "
            f"{len(flat.parameters)} parameters)"
        )

    def _repr_html_(self) -> str:
        return model_html(self)
