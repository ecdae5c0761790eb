"""Test benches: one component, each of its ports driven by a prescribed potential or a prescribed flow.

Every drive is an input of the bench named like the port, positive into the component where it is a flow. The other
quantity of each port comes out, so energy and mass can be balanced from outside.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import casadi as ca
import numpy as np

from hydrotwin.models.language import (
    Component,
    ElectricPin,
    Flange,
    HydraulicPort,
    HydrotwinError,
    Input,
    Model,
    Output,
    RotationalFlange,
    Shaft,
    State,
    connect,
    der,
)
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.declarations import Port
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

KINDS = (HydraulicPort, Shaft, ElectricPin)


def _holding(kind: type[Port]) -> type[Component]:
    """An end that holds a port's potential at its input."""
    letter, unit = kind().potential

    def equations(self):
        yield getattr(self.port, letter) == self.drive

    return type("Holding", (Component,), {"port": kind("end"), "drive": Input(unit), "equations": equations})


def _moving(kind: type[Port]) -> type[Component]:
    """An end that moves a flange: its input is the acceleration, for parts that carry mass."""
    letter, unit = kind().potential

    def equations(self):
        yield getattr(self.port, letter) == self.place
        yield der(self.place) == self.speed
        yield der(self.speed) == self.drive

    content = {"port": kind("end"), "place": State(0.0, unit), "speed": State(0.0, f"{unit}/s")}
    return type("Moving", (Component,), {**content, "drive": Input(f"{unit}/s2"), "equations": equations})


def _pushing(kind: type[Port]) -> type[Component]:
    """An end that prescribes a port's flow, positive into the component under test."""
    letter, unit = kind().flow

    def equations(self):
        yield getattr(self.port, letter) == -self.drive

    return type("Pushing", (Component,), {"port": kind("end"), "drive": Input(unit), "equations": equations})


ENDS = {(kind, "potential"): _holding(kind) for kind in KINDS}
ENDS |= {(kind, "potential"): _moving(kind) for kind in (Flange, RotationalFlange)}
ENDS |= {(kind, "flow"): _pushing(kind) for kind in (*KINDS, Flange, RotationalFlange)}


def bench(part: Component, **drives: str) -> Model:
    """A model of the part between its drives: ``bench(Orifice(), a="potential", b="potential")``.

    Inputs: one per port, and the part's own. Outputs: ``cap_p``, ``cap_q``, ... and the part's own.
    """
    declared = declarations(type(part))
    ports = {name: d for name, d in declared.items() if isinstance(d, Port)}
    signals = {name: d for name, d in declared.items() if isinstance(d, (Input, Output))}
    ends = {name: ENDS[type(port), drives[name]] for name, port in ports.items()}
    content: dict[str, object] = {"part": part, **{f"{name}_end": end() for name, end in ends.items()}}
    content |= {name: Input(declarations(end)["drive"].unit, "drive", nominal=1.0) for name, end in ends.items()}
    content |= {name: type(d)(d.unit, d.description) for name, d in signals.items()}
    for name, port in ports.items():
        content |= {f"{name}_{letter}": Output(unit) for letter, unit in (port.potential, port.flow)}

    def equations(self):
        for name, port in ports.items():
            end, own = getattr(self, f"{name}_end"), getattr(self.part, name)
            yield connect(end.port, own)
            yield connect(getattr(self, name), end.drive)
            for letter, _ in (port.potential, port.flow):
                yield getattr(self, f"{name}_{letter}") == getattr(own, letter)
        for name in signals:
            yield connect(getattr(self, name), getattr(self.part, name))

    return Model(type("Bench", (Component,), {**content, "equations": equations})(), "bench")


def any_bench(part: Component) -> Model:
    """The first bench on which the part is determined; fails with every reason when there is none."""
    ports = [name for name, d in declarations(type(part)).items() if isinstance(d, Port)]
    reasons = []
    for choice in itertools.product(("potential", "flow"), repeat=len(ports)):
        model = bench(part, **dict(zip(ports, choice, strict=True)))
        try:
            assert model.flat
            return model
        except HydrotwinError as error:
            reasons.append(f"{choice}: {error}")
    raise AssertionError("no bench fits: " + "; ".join(reasons))


def at(model: Model, states: Mapping[str, float] | None = None, **inputs: float) -> dict[str, float]:
    """Outputs and state rates ``der(...)`` at one point; states not given stand at their start."""
    flat = model.flat
    given = dict(states or {})
    u = [inputs.pop(i.name, i.default) for i in flat.inputs]
    assert not inputs, f"no inputs {inputs}"
    p = flat.parameter_vector()
    x = flat.start_given(tuple(given))(u, p, list(given.values()))
    rates, y = (np.array(v).ravel() for v in flat.ode(0, x, u, p))
    found = dict(zip((o.name for o in flat.outputs), y.tolist(), strict=True))
    return found | {f"der({s.name})": float(r) for s, r in zip(flat.states, rates, strict=True)}


def run(model: Model, time, *, start: Mapping[str, float] | None = None, **inputs) -> Record:
    """Simulate; inputs are arrays over ``time`` or constants, zero where not given."""
    flat, time = model.flat, np.asarray(time, dtype=float)
    signals = {i.name: np.broadcast_to(np.asarray(inputs.pop(i.name, 0.0), float), time.shape) for i in flat.inputs}
    assert not inputs, f"no inputs {inputs}"
    record = Record(time, signals, {i.name: i.unit for i in flat.inputs}, "bench")
    return simulate(model, record, start=start)


def observed(model: Model, paths, states: Mapping[str, float], **inputs: float) -> np.ndarray:
    """Any quantities of the model at one point."""
    flat = model.flat
    u = [inputs.get(i.name, i.default) for i in flat.inputs]
    p = flat.parameter_vector()
    x = flat.start_given(tuple(states))(u, p, list(states.values()))
    return np.array(model.observe(paths)(0, x, u, p)).ravel()


def jacobian(model: Model) -> ca.Function:
    """``(t, x, u, p) -> d(rates)/dx``."""
    t, x, u, p = model.flat.ode.sx_in()
    return ca.Function("jacobian", [t, x, u, p], [ca.jacobian(model.flat.ode(t, x, u, p)[0], x)])
