"""The equation language: components, ports, laws, connections; flattened to one explicit ODE."""

from .component import Component, Law
from .declarations import (
    ElectricPin,
    Flange,
    HydraulicPort,
    Input,
    Output,
    Parameter,
    RotationalFlange,
    Shaft,
    Slot,
    State,
    Variable,
)
from .elaboration import connect, delay, der, time
from .errors import DataError, DeclarationError, HydrotwinError, SolveError, TopologyError, UnitError
from .flat import FlatModel, ParameterValue, Signal, StateVariable
from .model import Model

__all__ = [
    "Component",
    "DataError",
    "DeclarationError",
    "ElectricPin",
    "Flange",
    "FlatModel",
    "HydraulicPort",
    "HydrotwinError",
    "Input",
    "Law",
    "Model",
    "Output",
    "Parameter",
    "ParameterValue",
    "RotationalFlange",
    "Shaft",
    "Signal",
    "Slot",
    "SolveError",
    "State",
    "StateVariable",
    "TopologyError",
    "UnitError",
    "Variable",
    "connect",
    "delay",
    "der",
    "time",
]
