"""Every law in its slot gives valid Modelica, and a machine of the less usual laws moves as ours."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models import cehA, laws, spool_valve
from hydrotwin.models.components import Cylinder, FourEdgeValve, Pump
from hydrotwin.models.language import Slot
from hydrotwin.models.language.component import declarations
from tests.language.test_modelica import compiled, largest_difference

HOSTS = {  # slot of a machine: what holds it
    "cylinder": (cehA, Cylinder),
    "pump": (cehA, Pump),
    "valve": (spool_valve, FourEdgeValve),
}


def choices():
    """(part, slot, law) for every law of the catalogue that fits a slot of a machine."""
    catalogue = [getattr(laws, name) for name in laws.__all__]
    for part, (_, holder) in HOSTS.items():
        for slot, declared in declarations(holder).items():
            for law in catalogue:
                if isinstance(declared, Slot) and issubclass(law, declared.kind) and law is not declared.kind:
                    yield pytest.param(part, slot, law, id=f"{part}.{slot}-{law.__name__}")


@pytest.mark.parametrize(("part", "slot", "law"), list(choices()))
def test_a_machine_with_this_law_is_valid_modelica(part, slot, law):
    machine, _ = HOSTS[part]
    base = machine.model().root
    changed = base.declared(part).but(**{slot: law()})
    model = machine.model().but(**{part: changed})
    model.settings = {}
    if machine is spool_valve:
        model = model.with_parameters({"solenoid.dead_time": 0.02})  # the compiler takes no dead time of zero
    theirs = compiled(model)
    assert theirs.structure().is_balanced
    assert {p.name for p in model.flat.parameters} <= set(theirs.parameters.names)


def test_a_machine_of_the_less_usual_laws_moves_as_ours():
    base = cehA.model()
    cylinder = base.root.declared("cylinder").but(
        friction=laws.Coulomb(coulomb=30.0, viscous=600.0, smoothing_velocity=0.01),
        oil=laws.AirLadenBulkModulus(air_fraction=0.02),
        leakage=laws.TurbulentLeakage(coefficient=2e-10),
    )
    pump = base.root.declared("pump").but(loss=laws.PumpSlip(slip_conductance=1e-12))
    model = base.but(cylinder=cylinder, pump=pump)
    model.settings = {}
    drives = {"command": ("2*sin(3*time)", lambda t: 2 * np.sin(3 * t))}
    assert largest_difference(model, drives, 0.6) < 1e-4
