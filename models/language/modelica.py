"""A Model writes itself as Modelica source: one package that needs no library.

One connector per kind of port, one class per component and choice of laws, ``Main`` with the model's parameter values.
Added parts stand in a class that extends the machine, or in classes written anew, see `modelica_additions`.
A law is a record of its parameters; its relation stands in the equations of the component that uses it. Dotted paths
stay as they are, except that a word of Modelica gets an underscore (``end`` -> ``end_``).
Source: Modelica Language Specification 3.6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import casadi as ca

from .component import Component, declarations
from .declarations import Input, Output, Parameter, Port, State, Variable
from .elaboration import BoundPort, Elaboration, Equation
from .errors import DeclarationError
from .flattening import elaborate
from .model import Model
from .modelica_additions import WithAdditions, mentions, with_additions
from .modelica_expression import modelica_equation, modelica_expression, modelica_number
from .modelica_words import attributes_of, identifier, indented, modelica_path, modifier, nested, quoted, sentence_of
from .units import modelica_unit

MAIN = "Main"


def modelica_text(model: Model) -> str:
    """Modelica source of a model: package ``<model name>`` whose class ``Main`` is the model with its values.

    Raises
    ------
    DeclarationError : an expression uses an operation that Modelica has no form for, or a parameter follows a signal.
    """
    if model.varying:
        raise DeclarationError(
            f"{model.name}: {', '.join(model.varying)} follows a signal, and a parameter of Modelica stays as it is. "
            "Make it a Variable with an equation of its own."
        )
    elaboration, root = elaborate(model.root, model.name)
    writer = _PackageWriter(elaboration)
    top, renamed = writer.class_of(root), {}
    if any(addition.part is not None for addition in model.additions):
        tied = with_additions(model)
        writer = _PackageWriter(tied.elaboration, writer, tied)
        top, elaboration, renamed = writer.class_with_additions(top), tied.elaboration, tied.renamed
    changes = nested(_changed_settings(model, elaboration, renamed))
    connectors = [_connector(kind) for kind in writer.port_kinds]
    if writer.has_signals:
        connectors += ["connector RealInput = input Real;", "connector RealOutput = output Real;"]
    main = f"model {MAIN}{quoted(f'{model.name} with its parameter values')}\n  extends {top}{changes};\nend {MAIN};"
    body = "\n\n".join([*connectors, *writer.classes.values(), main])
    head = f"package {identifier(model.name)}{quoted(sentence_of(model.root))}\n"
    return head + indented(body) + f"\nend {identifier(model.name)};\n"


def modelica_main(model: Model) -> str:
    """Full name of the class to simulate: ``cehA.Main``."""
    return f"{identifier(model.name)}.{MAIN}"


def _connector(kind: Port) -> str:
    (letter, unit), (flow, flow_unit) = kind.potential, kind.flow
    nominal, flow_nominal = (f", nominal={modelica_number(n)}" if n != 1 else "" for n in kind.nominals)
    return (
        f"connector {type(kind).__name__}{quoted(sentence_of(kind))}\n"
        f'  Real {identifier(letter)}(unit="{modelica_unit(unit)}"{nominal});\n'
        f'  flow Real {identifier(flow)}(unit="{modelica_unit(flow_unit)}"{flow_nominal});\n'
        f"end {type(kind).__name__};"
    )


@dataclass
class _Body:
    """The sections of one class while it is written."""

    declarations: list[str] = field(default_factory=list)
    shared: list[str] = field(default_factory=list)
    initial: list[str] = field(default_factory=list)
    equations: list[str] = field(default_factory=list)

    def text(self, description: str) -> str:
        sections = [description, *(f"  {line}" for line in self.declarations)]
        for title, lines in (
            ("protected", [f"Real {name};" for name in self.shared]),
            ("initial equation", self.initial),
            ("equation", self.equations),
        ):
            if lines:
                sections += [title, *(f"  {line}" for line in lines)]
        return "\n".join(sections)


class _PackageWriter:
    """Writes the classes of one bound component tree; equal texts share one class."""

    def __init__(
        self, elaboration: Elaboration, before: _PackageWriter | None = None, tied: WithAdditions | None = None
    ):
        self.elaboration = elaboration
        self.tied = tied
        self.classes: dict[str, str] = before.classes if before else {}  # name -> text
        self.bodies: dict[tuple[str, str], str] = before.bodies if before else {}  # (class, body) -> name
        self.port_kinds: list[Port] = before.port_kinds if before else []
        self.has_signals = bool(before and before.has_signals)
        self.paths = {
            entry.symbol.element_hash(): entry.path
            for entry in (*elaboration.parameters, *elaboration.states, *elaboration.variables, *elaboration.inputs)
        }
        self.paths |= {
            signal.symbol.element_hash(): f"{owner}.{signal.word}"
            for owner, signals in (tied.signals if tied else {}).items()
            for signal in signals
        }
        self.parameters = {p.symbol.element_hash() for p in elaboration.parameters}
        self.rates = {rate.element_hash(): symbol for symbol, rate in elaboration.derivatives.values()}
        self.delays = {d.symbol.element_hash(): d for d in elaboration.delays}
        self.equations = self._by_owner(elaboration.equations)
        self.initial_equations = self._by_owner([*elaboration.initial_equations, *self._followed_starts()])

    # -- classes -----------------------------------------------------------------------------------------------
    def class_of(self, component: Component) -> str:
        """Name of the class of a bound component, written the first time it is met."""
        body = self._body(component)
        kind = type(component).__name__
        if self.tied and self.tied.is_opened(component.path):
            kind = f"{kind}Opened"
        taken = {MAIN, "RealInput", "RealOutput", *(port.__name__ for port in Port.__subclasses__())}
        passive = all(line.startswith("parameter ") for line in body.declarations) and not body.equations
        text = body.text(quoted(sentence_of(component)))
        if (kind, text) not in self.bodies:
            name = next(n for n in _names(kind) if n not in self.classes and n not in taken)
            word = "record" if passive else "model"
            self.classes[name] = f"{word} {name}{text}\nend {name};"
            self.bodies[kind, text] = name
        return self.bodies[kind, text]

    def class_with_additions(self, top: str) -> str:
        """Name of the class of the machine with its added parts: the machine opened where it must be, and extended."""
        opened = self.class_of(self.tied.root)
        parts = [self.tied.parts[path] for path in self.tied.parts if path in self.tied.extending]
        if not parts:
            return opened
        body = _Body(declarations=[f"extends {opened};", *(self._added_declaration(part) for part in parts)])
        self._fill(body, "", extending=True)
        name = next(n for n in _names(f"{top}Extended") if n not in self.classes)
        added = ", ".join(part.path for part in parts)
        self.classes[name] = f"model {name}{body.text(quoted(f'{opened} with {added}'))}\nend {name};"
        return name

    def _added_declaration(self, part: Component) -> str:
        home, _, leaf = part.path.rpartition(".")
        return f"{self.class_of(part)} {identifier(leaf)}{self._modifiers(part, self._names_in(home))};"

    def _body(self, component: Component) -> _Body:
        body, path = _Body(), component.path
        for name in declarations(type(component)):
            body.declarations.append(self._declaration(component, name))
        for part in self.tied.within(path) if self.tied else ():
            body.declarations.append(self._added_declaration(part))
        for signal in self.tied.signals.get(path, ()) if self.tied else ():
            unit = f'(unit="{modelica_unit(signal.unit)}")' if modelica_unit(signal.unit) else ""
            body.declarations.append(
                f"Real{'Output' if signal.is_output else 'Input'} {identifier(signal.word)}{unit};"
            )
            self.has_signals = True
        self._fill(body, path, extending=False)
        return body

    def _fill(self, body: _Body, path: str, extending: bool) -> None:
        """Connections and equations of the class at ``path``; at the root those ``extending`` it or the rest."""
        for owner, connection in self.elaboration.connections:
            ends = (connection.first, connection.second)
            if owner == path and extending == self._is_extending(ends):
                body.equations.append(f"connect({', '.join(self._end(end, path) for end in ends)});")
        for equations, lines in (
            (self.initial_equations.get(path, ()), body.initial),
            (self.equations.get(path, ()), body.equations),
        ):
            for equation in equations:
                if extending == self._is_extending(ca.symvar(ca.vertcat(equation.left, equation.right)), path):
                    lines.append(self._equation(equation, path, body) + ";")

    def _is_extending(self, ends, path: str = "") -> bool:
        """Whether a statement of the root names a part of the extending class."""
        return not path and self.tied is not None and mentions(self.tied, ends, self._path_of)

    def _path_of(self, symbol: ca.SX) -> str | None:
        return next(self._paths_of(symbol), None)

    def _equation(self, equation: Equation, path: str, body: _Body) -> str:
        new = (f"shared_{k}" for k in range(len(body.shared) + 1, 10_000))
        names = self._names_in(path, body)
        text, shared = modelica_equation(equation.left, equation.right, names, lambda: next(new))
        for name, definition in shared:
            body.shared.append(name)
            body.equations.append(f"{name} = {definition};")
        return text

    # -- declarations ------------------------------------------------------------------------------------------
    def _declaration(self, component: Component, name: str) -> str:
        changed, own = component.changes.get(name), declarations(type(component))[name]
        declared = changed if isinstance(changed, (Parameter, State, Variable, Input, Output)) else own
        here = getattr(component, name)
        word = identifier(name)
        if isinstance(here, Component):
            said_around = name in component.changes and component.parent is not None
            changes = "" if said_around else self._modifiers(here, self._names_in(component.path))
            return f"{self.class_of(here)} {word}{changes};"
        if isinstance(here, BoundPort):
            if type(declared) not in [type(kind) for kind in self.port_kinds]:
                self.port_kinds.append(declared)
            return f"{type(declared).__name__} {word}{quoted(declared.description)};"
        attributes = attributes_of(declared)
        if isinstance(declared, Parameter):
            value = self._value(component, name, declared)
            return f"parameter Real {word}{modifier(attributes)}{value}{quoted(declared.description)};"
        if isinstance(declared, State):
            attributes |= self._start_attributes(component, name, declared)
        elif isinstance(declared, Variable) and declared.start:
            attributes["start"] = modelica_number(declared.start)
        elif isinstance(declared, Input) and not component.path and declared.default:
            attributes["start"] = modelica_number(declared.default)
        signal = isinstance(declared, (Input, Output))
        self.has_signals |= signal
        kind = f"Real{type(declared).__name__}" if signal else "Real"
        return f"{kind} {word}{modifier(attributes)}{quoted(declared.description)};"

    def _value(self, component: Component, name: str, declared: Parameter) -> str:
        """`` = ...`` of a parameter in its class; values given from around the component are modifiers there."""
        if not callable(declared.value):
            return f" = {modelica_number(declared.value)}"
        if name in component.changes and component.parent is not None and component.changes[name] is declared:
            return ""
        return f" = {modelica_expression(ca.SX(declared.value(component)), self._names_in(component.path))}"

    def _start_attributes(self, component: Component, name: str, declared: State) -> dict[str, str]:
        always = {"stateSelect": "StateSelect.always"}
        if not callable(declared.start):
            return {"start": modelica_number(declared.start), "fixed": str(declared.fixed).lower(), **always}
        around = component.parent if name in component.changes and component.parent is not None else component
        start = ca.SX(declared.start(around))
        if around is component and self._constant(start):
            text = modelica_expression(start, self._names_in(component.path))
            return {"start": text, "fixed": str(declared.fixed).lower(), **always}
        return {"fixed": "false", **always}  # an initial equation or a modifier says the rest

    def _modifiers(self, component: Component, names: Callable[[ca.SX], str]) -> str:
        """The modifiers that make a class this component: numbers, bindings and start values, of its parts as well."""
        found = []
        for name, change in component.changes.items():
            here, word = getattr(component, name), identifier(name)
            if isinstance(here, Component):
                inside = self._modifiers(here, names)
                found += [f"{word}{inside}"] if inside else []
            elif isinstance(declarations(type(component))[name], Parameter):
                binding = self.elaboration.bindings.get(f"{component.path}.{name}")
                if binding is not None:
                    found.append(f"{word}={modelica_expression(binding, names)}")
                elif not isinstance(change, Parameter):
                    found.append(f"{word}={modelica_number(change)}")
            elif isinstance(here, ca.SX) and not isinstance(change, (State, Variable, Input, Output)):
                start = ca.SX(change(component.parent) if callable(change) else change)
                known = f"start={modelica_expression(start, names)}" if self._constant(start) else "fixed=false"
                found.append(f"{word}({known})")
        return f"({', '.join(found)})" if found else ""

    # -- names and places --------------------------------------------------------------------------------------
    def _names_in(self, owner: str, body: _Body | None = None) -> Callable[[ca.SX], str]:
        """How symbols are called inside the class of the component at ``owner``.

        Modelica takes no derivative of a derivative: ``body`` gets a variable for the inner one.
        """
        skip = len(owner) + 1 if owner else 0

        def name_of(symbol: ca.SX) -> str:
            key = symbol.element_hash()
            if key in self.rates:
                inner = name_of(self.rates[key])
                if inner.startswith("der("):
                    rate = "rate_of_" + inner[4:-1].replace(".", "_")
                    if rate not in body.shared:
                        body.shared.append(rate)
                        body.equations.append(f"{rate} = {inner};")
                    inner = rate
                return f"der({inner})"
            if key in self.delays:
                item = self.delays[key]
                return f"delay({name_of(item.argument)}, {name_of(item.time)})"
            return modelica_path(self.paths[key][skip:]) if key in self.paths else "time"

        return name_of

    def _end(self, end, owner: str) -> str:
        path = end.path if isinstance(end, BoundPort) else self.paths[end.element_hash()]
        return modelica_path(path[len(owner) + 1 if owner else 0 :])

    def _by_owner(self, equations) -> dict[str, list[Equation]]:
        """Equations by the innermost component that sees all their symbols."""
        found: dict[str, list[Equation]] = {}
        for equation in equations:
            owner = equation.owner
            for path in self._paths_of(ca.vertcat(equation.left, equation.right)):
                while owner and not path.startswith(f"{owner}."):
                    owner = owner.rpartition(".")[0]
            found.setdefault(owner, []).append(equation)
        return found

    def _paths_of(self, expression: ca.SX) -> Iterator[str]:
        for symbol in ca.symvar(expression):
            key = symbol.element_hash()
            if key in self.rates:
                yield from self._paths_of(self.rates[key])
            elif key in self.delays:
                yield from self._paths_of(ca.vertcat(self.delays[key].argument, self.delays[key].time))
            elif key in self.paths:
                yield self.paths[key]

    def _constant(self, expression: ca.SX) -> bool:
        return all(s.element_hash() in self.parameters for s in ca.symvar(expression))

    def _followed_starts(self) -> Iterator[Equation]:
        """Start values that follow other states, as initial equations."""
        for state in self.elaboration.states:
            if state.declaration.fixed and callable(state.declaration.start):
                start = ca.SX(state.declaration.start(state.owner))
                if not self._constant(start):
                    yield Equation(state.symbol, start, state.owner.path)


def _changed_settings(model: Model, elaboration: Elaboration, renamed: Mapping[str, str]) -> dict[str, str]:
    """Values of the model that differ from the declarations, by path."""
    values, known = {}, {p.name: p.value for p in model.flat.parameters}
    for path, setting in model.settings.items():
        first, dot, rest = path.partition(".")
        if "value" in setting:
            values[f"{renamed.get(first, first)}{dot}{rest}"] = known.get(path, setting["value"])
    declared = {entry.path: entry.declaration.value for entry in elaboration.parameters}
    return {p: f"={modelica_number(value)}" for p, value in values.items() if value != declared.get(p)}


def _names(kind: str) -> Iterator[str]:
    yield kind
    yield from (f"{kind}_{k}" for k in range(2, 1000))
