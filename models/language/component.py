"""Component and Law: what a physical model is written in."""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterator, Mapping
from numbers import Real
from types import MappingProxyType

from .declarations import Input, Output, Parameter, Port, Slot, State, Variable
from .elaboration import Elaboration
from .errors import DeclarationError, nearest

RESERVED = ("path", "parent", "changes")  # attributes of every component


class Component:
    """A part of a machine: class attributes declare its quantities, `equations` ties them.

    Subclassing extends, keyword arguments modify: a number for a parameter or a start value, a law for a slot, another
    component for a part. A function of the *enclosing* component binds a parameter to parameters there.

    Example
    -------
    >>> from hydrotwin.models.language import Component, Flange, Parameter
    >>> class Spring(Component):
    ...     end = Flange("free end")
    ...     stiffness = Parameter(1e5, "N/m", "spring rate", bounds=(0, 1e12))
    ...     def equations(self):
    ...         yield self.end.f == self.stiffness * self.end.s
    >>> Spring(stiffness=2e5).changes
    {'stiffness': 200000.0}
    """

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        for name in RESERVED:
            if name in vars(cls):
                raise DeclarationError(f"{cls.__name__}: '{name}' is a word of the language. Choose another name.")

    def __init__(self, **changes):
        declared = declarations(type(self))
        for name, change in changes.items():
            if name not in declared:
                raise DeclarationError(f"{type(self).__name__}: no '{name}'. {nearest(name, declared)}")
            _check_change(type(self).__name__, name, declared[name], change)
        self.changes = {k: float(v) if isinstance(v, Real) else v for k, v in changes.items()}

    def equations(self) -> Iterator:
        """Yield ``left == right`` and ``connect(a, b)``."""
        return iter(())

    def initial_equations(self) -> Iterator:
        """Yield what holds at the start; each equation determines one state declared with ``fixed=False``."""
        return iter(())

    def but(self, **changes) -> Component:
        """A copy with further changes."""
        return type(self)(**{**self.changes, **changes})

    def declared(self, name: str):
        """The declaration of ``name`` with this instance's change applied."""
        declaration = declarations(type(self))[name]
        change = self.changes.get(name)
        if change is None:
            return declaration.default if isinstance(declaration, Slot) else declaration
        if isinstance(change, Component):
            return change
        if isinstance(declaration, (Parameter, State)) and not isinstance(change, (Parameter, State)):
            replaced = copy.copy(declaration)
            object.__setattr__(replaced, "start" if isinstance(declaration, State) else "value", change)
            return replaced
        return change

    def bind(self, path: str, elaboration: Elaboration, parent=None) -> Component:
        """A copy whose attributes are symbols, registered with ``elaboration``; its equations are collected."""
        bound = copy.copy(self)
        bound.path = path
        bound.parent = parent
        around = bound if parent is None else parent  # the scope of changes
        followers = []
        for name in declarations(type(self)):
            declaration, full = self.declared(name), f"{path}.{name}" if path else name
            if isinstance(declaration, Component):
                value = declaration  # bound below, once this component's own symbols exist
            elif isinstance(declaration, Parameter):
                value = elaboration.parameter(full, declaration, bound)
                if callable(declaration.value):
                    scope = around if name in self.changes else bound
                    followers.append((full, declaration.value, scope))
            elif isinstance(declaration, State):
                value = elaboration.state(full, declaration, around if name in self.changes else bound)
            elif isinstance(declaration, Port):
                value = elaboration.port(full, declaration)
            else:
                value = elaboration.variable(full, declaration, bound)
            setattr(bound, name, value)
        for full, function, scope in followers:
            elaboration.bindings[full] = (function, scope)
        for name in declarations(type(self)):
            part = getattr(bound, name)
            if isinstance(part, Component):
                setattr(bound, name, part.bind(f"{path}.{name}" if path else name, elaboration, bound))
        elaboration.collect(bound.equations(), path, elaboration.equations)
        elaboration.collect(bound.initial_equations(), path, elaboration.initial_equations)
        return bound

    def __repr__(self):
        inside = ", ".join(f"{k}={v!r}" for k, v in self.changes.items())
        return f"{type(self).__name__}({inside})"


class Law(Component):
    """A constitutive relation that fills a slot: parameters and functions, no ports."""


@functools.cache
def declarations(kind: type) -> Mapping[str, object]:
    """Everything a component class declares, its bases' first, in the order of the source."""
    kinds = (Parameter, State, Variable, Input, Output, Port, Slot, Component)
    found: dict[str, object] = {}
    for base in reversed(kind.__mro__):
        for name, value in vars(base).items():
            if isinstance(value, kinds):
                found[name] = value
    return MappingProxyType(found)


def _check_change(owner: str, name: str, declaration, change) -> None:
    number = isinstance(change, Real) and not isinstance(change, bool)
    if isinstance(declaration, Slot):
        good, wanted = isinstance(change, declaration.kind), f"a {declaration.kind.__name__}"
    elif isinstance(declaration, Component):
        good, wanted = isinstance(change, Component), "a component"
    elif isinstance(declaration, Parameter):
        good, wanted = number or callable(change) or isinstance(change, Parameter), "a number in SI units"
    elif isinstance(declaration, State):
        good, wanted = number or callable(change) or isinstance(change, State), "a start value or a State"
    else:
        good, wanted = isinstance(change, type(declaration)), f"another {type(declaration).__name__}"
    if not good:
        raise DeclarationError(f"{owner}.{name}: cannot be replaced by {change!r}. Give {wanted}.")
    if number and isinstance(declaration, Parameter) and not declaration.bounds[0] <= change <= declaration.bounds[1]:
        low, high = declaration.bounds
        raise DeclarationError(
            f"{owner}.{name}: value outside its bounds (got {change:g} {declaration.unit}). "
            f"It must lie in [{low:g}, {high:g}]. Correct the value, or declare the parameter with other bounds."
        )
