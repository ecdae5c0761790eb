"""Component and Law: what a physical model is written in."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Iterator, Mapping
from numbers import Real
from types import MappingProxyType

import casadi as ca

from .declarations import PLACEHOLDER, Input, Output, Parameter, Port, Slot, State, Variable, finite
from .dimensions import NUMBER, check_units, grows_with, literals
from .elaboration import Elaboration, Entry, Equation
from .errors import DeclarationError, UnitError, nearest
from .units import dimension, to_si
from .user_code import Here, place_of_code, running

RESERVED = ("path", "parent", "changes")  # attributes of every component


class _Declared:
    """Mark of `Component`, which is defined in terms of what it holds."""


KINDS = (Parameter, State, Variable, Input, Output, Port, Slot, _Declared)  # what counts as a declaration


@functools.cache
def declarations(kind: type) -> Mapping[str, object]:
    """Everything a component class declares, its bases' first, in the order of the source."""
    found: dict[str, object] = {}
    for base in reversed(kind.__mro__):
        for name, value in vars(base).items():
            if isinstance(value, KINDS):
                found[name] = value
    return MappingProxyType(found)


class _Body(dict):
    """What a class body holds: nothing declared in it may be lost to a second one of the same name."""

    def __setitem__(self, name, value):
        if isinstance(self.get(name), KINDS):
            raise DeclarationError(
                f"{Here()}'{name}' is declared a second time in one class: the first would be lost. Rename one of them."
            )
        super().__setitem__(name, value)


class _Kind(type):
    """The class of components: it sees what their class bodies say."""

    @classmethod
    def __prepare__(cls, name, bases, **options):
        return _Body()


class Component(_Declared, metaclass=_Kind):
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
        words = {*RESERVED, *(word for word in vars(Component) if not word.startswith("_"))}
        inherited = {name for base in cls.__mro__[1:] if issubclass(base, Component) for name in declarations(base)}
        for name, value in vars(cls).items():
            if name in RESERVED or (name in words and isinstance(value, KINDS)):
                raise DeclarationError(
                    f"{Here()}{cls.__name__}: '{name}' is a word of the language. Choose another name."
                )
            _refuse_hidden(Here(f"{cls.__name__}.{name}"), value, cls)
            if name in inherited and not isinstance(value, KINDS):
                raise DeclarationError(
                    f"{Here()}{cls.__name__}.{name}: declared by a base class and replaced by {value!r}, which "
                    f"declares nothing. Declare it anew (Parameter(.., unit, ..)) or write {cls.__name__}({name}=..)."
                )

    def __init__(self, **changes):
        declared, where = declarations(type(self)), type(self).__name__
        for name, change in changes.items():
            if name not in declared:
                raise DeclarationError(f"{Here(where)}: no '{name}'. {nearest(name, declared)}")
            _check_change(Here(f"{where}.{name}"), declared[name], change)
        self.changes = {k: float(v) if isinstance(v, Real) else v for k, v in changes.items()}

    def __setattr__(self, name, value):
        if name in declarations(type(self)):
            raise DeclarationError(
                f"{Here()}{type(self).__name__}.{name}: a component does not change. Give '{name}' when it is made, "
                f"{type(self).__name__}({name}=..), or with .but({name}=..); an equation is 'yield self.{name} == ..'."
            )
        super().__setattr__(name, value)

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
            object.__setattr__(replaced, "alone", True)
            return replaced
        return change

    def bind(self, path: str, elaboration: Elaboration, parent=None) -> Component:
        """A copy whose attributes are symbols, registered with ``elaboration``; its equations are collected."""
        self._check_made()
        bound = copy.copy(self)
        bound.path = path
        bound.parent = parent
        around = bound if parent is None else parent  # the scope of changes
        followers = []
        for name in declarations(type(self)):
            declaration, full = self.declared(name), f"{path}.{name}" if path else name
            if getattr(declaration, "refused", ""):
                raise DeclarationError(declaration.refused)
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
            vars(bound)[name] = value
        for full, function, scope in followers:
            elaboration.bindings[full] = (function, scope)
        for name in declarations(type(self)):
            part = getattr(bound, name)
            if isinstance(part, Component):
                vars(bound)[name] = part.bind(f"{path}.{name}" if path else name, elaboration, bound)
        elaboration.kinds[type(self)] = None
        elaboration.collect(bound.equations, path, elaboration.equations)
        elaboration.collect(bound.initial_equations, path, elaboration.initial_equations)
        return bound

    def _check_made(self) -> None:
        """Its constructor has run, and every part of it is declared in its class."""
        kind = type(self)
        if "changes" not in vars(self):
            raise DeclarationError(
                f"{place_of_code(kind.__init__)}{kind.__name__}.__init__ does not make a component. "
                "Begin it with super().__init__(**changes)."
            )
        for name, value in vars(self).items():
            if name != "changes":
                _refuse_hidden(f"{place_of_code(kind.__init__)}{kind.__name__}.{name}", value, kind, made=True)

    def __repr__(self):
        inside = ", ".join(f"{k}={v!r}" for k, v in self.changes.items())
        return f"{type(self).__name__}({inside})"


def _refuse_hidden(where: Here | str, value, owner: type, made: bool = False) -> None:
    """A part that no path leads to: in a list, a class in place of an instance, or set on an instance.

    made : the value was set on an instance, after its class was declared.
    """
    if isinstance(value, type) and issubclass(value, KINDS) and not value.__qualname__.startswith(owner.__qualname__):
        raise DeclarationError(
            f"{where}: a class where a part is meant (got {value.__name__}). Make one: {value.__name__}(..)."
        )
    members = value.values() if isinstance(value, Mapping) else value if isinstance(value, (list, tuple, set)) else ()
    several = any(isinstance(member, KINDS) for member in members)
    if several or (made and isinstance(value, KINDS)):
        leaf = str(where).rpartition(".")[2]
        held = f"a {type(value).__name__} of parts" if several else f"{type(value).__name__} set on an instance"
        raise DeclarationError(
            f"{where}: {held} is no part of the model: nothing in it has a name. "
            f"Declare each in the class body with a name of its own: {leaf}_1 = .., {leaf}_2 = ..."
        )


def _check_change(where: Here, declaration, change) -> None:
    number = isinstance(change, Real) and not isinstance(change, bool)
    if isinstance(declaration, Slot):
        good, wanted = isinstance(change, declaration.kind), f"a {declaration.kind.__name__}"
    elif isinstance(declaration, Component):
        good, wanted = isinstance(change, Component), "a component"
    elif isinstance(declaration, Parameter):
        good, wanted = number or _follows(change) or isinstance(change, Parameter), "a number in SI units"
    elif isinstance(declaration, State):
        good, wanted = number or _follows(change) or isinstance(change, State), "a start value or a State"
    else:
        good, wanted = isinstance(change, type(declaration)), f"another {type(declaration).__name__}"
    if not good:
        instance = f" Make one: {change.__name__}(..)." if isinstance(change, type) else ""
        raise DeclarationError(f"{where}: cannot be replaced by {change!r}. Give {wanted}.{instance}")
    measured = isinstance(change, (Parameter, State, Input, Output, Variable)) and PLACEHOLDER not in declaration.unit
    if measured and dimension(change.unit) != dimension(declaration.unit):
        raise UnitError(f"{where}: its unit is {declaration.unit} (got {change.unit}). Give one of that dimension.")
    if number:
        _check_number(where, declaration, finite(where, "the number given", change))


def _check_number(where: Here, declaration: Parameter | State, number: float) -> None:
    """A number alone is in SI, and within the bounds."""
    if declaration.written_in and to_si(number, declaration.written_in)[0] != number:
        kind = type(declaration).__name__
        raise DeclarationError(
            f"{where}: declared in {declaration.written_in}, so {number:g} alone may mean {declaration.written_in} or "
            f"{declaration.unit}. Give the unit with it: {kind}({number:g}, '{declaration.written_in}', ..)."
        )
    low, high = declaration.bounds
    if not low <= number <= high:
        raise DeclarationError(
            f"{where}: value outside its bounds (got {number:g} {declaration.unit}). It must lie in [{low:g}, "
            f"{high:g}]. Correct the value, or declare the {type(declaration).__name__.lower()} with other bounds."
        )


def given_in_si(elaboration: Elaboration, function: Callable, scope: Component, entry: Entry) -> ca.SX:
    """What a function gives for a Parameter or a State, in SI; its unit is checked.

    A number is in the unit of the declaration, as if it stood there. What is made of other quantities is in SI, as it
    is in equations.

    Raises
    ------
    UnitError : another dimension, or a pure number by which nobody can tell which of two units is meant.
    """
    where, declaration = f"{elaboration.name}.{entry.path}", entry.declaration
    with running(where):
        given = ca.SX(function(scope))
    if given.is_constant():
        number = finite(where, "what its function gives", float(given))
        if declaration.alone:
            _check_number(where, declaration, number)
        return given
    equation = Equation(entry.symbol, given, entry.path)
    check_units(elaboration.name, [equation], elaboration.units)
    share = declaration.unit == "1"  # 1 - efficiency is clear, whatever its unit; 1 + angle is not
    if declaration.written_in and dimension(declaration.unit) == NUMBER and literals(given, ones=not share):
        _refuse_unclear(elaboration, where, declaration, equation)
    return given


def _refuse_unclear(elaboration: Elaboration, where: str, declaration, equation: Equation) -> None:
    """A pure number among pure numbers: the dimension does not tell a degree from a radian.

    A factor of something declared in the same unit is clear; what is added to it is not.
    """
    alike = [
        e.symbol
        for e in (*elaboration.parameters, *elaboration.states)
        if e.declaration.unit == declaration.unit
        and (declaration.unit != "1" or e.declaration.written_in == declaration.written_in)
    ]
    if alike and grows_with(equation.right, ca.vertcat(*alike)):
        return
    raise UnitError(
        f"{where}: declared in {declaration.written_in}, so '{equation.right}' may mean {declaration.written_in} or "
        f"{declaration.unit}. Declare it in {declaration.unit}, and let its function give that."
    )


def _follows(change) -> bool:
    """A function that gives the value from others."""
    return callable(change) and not isinstance(change, type)


class Law(Component):
    """A constitutive relation that fills a slot: parameters and functions, no ports."""
