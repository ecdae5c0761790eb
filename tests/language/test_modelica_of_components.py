"""Every component, its ports held or free, gives valid Modelica."""

from __future__ import annotations

from itertools import product

import pytest

from hydrotwin.models import components
from hydrotwin.models.language import Component, Input, Model, Output, TopologyError, connect
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import Port
from tests.language.test_modelica import compiled


def closing(port: Port, free: bool) -> type[Component]:
    """A component that sets a port's flow (free) or potential (held) to zero."""

    def equations(self):
        yield (self.port.flow if free else self.port.potential) == 0

    name = f"{'Free' if free else 'Held'}{type(port).__name__}"
    return type(name, (Component,), {"__doc__": name, "port": type(port)("closed"), "equations": equations})


def bench(kind: type[Component], free: tuple[bool, ...]) -> Component:
    """A component with its signals led outside and its ports closed."""
    declared = declarations(kind)
    ports = {name: d for name, d in declared.items() if isinstance(d, Port)}
    signals = {f"{name}_outside": type(d)(d.unit) for name, d in declared.items() if isinstance(d, (Input, Output))}
    ends = {f"at_{name}": closing(port, f)() for (name, port), f in zip(ports.items(), free, strict=True)}

    def equations(self):
        for name in ports:
            yield connect(getattr(self.part, name), getattr(self, f"at_{name}").port)
        for name in signals:
            yield connect(getattr(self, name), getattr(self.part, name.removesuffix("_outside")))

    parts = {"__doc__": "A bench.", "part": kind(), "equations": equations}
    return type("Bench", (Component,), {**parts, **signals, **ends})()


def closed(kind: type[Component]) -> Model:
    """The first way of closing the ports that leaves a model that can be solved."""
    count = sum(isinstance(d, Port) for d in declarations(kind).values())
    for free in product((False, True), repeat=count):
        model = Model(bench(kind, free))
        try:
            assert model.flat
        except TopologyError:
            continue
        return model.with_parameters({s.dead_time: 0.02 for s in model.flat.inputs if s.dead_time})
    raise AssertionError(f"{kind.__name__} cannot be closed")


@pytest.mark.parametrize("name", components.__all__)
def test_a_component_alone_is_valid_modelica(name):
    model = closed(getattr(components, name))
    theirs = compiled(model)
    structure = theirs.structure()
    assert structure.is_balanced and structure.is_matched
    assert {p.name for p in model.flat.parameters} <= set(theirs.parameters.names)
