"""Parts of hydraulic machines, by domain."""

from .electric import DcMotor, ElectricGround, SpeedControlledMotor, VoltageSource
from .hydraulic import Cylinder, FlowSource, LineVolume, Orifice, Passage, Plug, PressureSource, Pump, Reservoir
from .mechanical import (
    Arm,
    AttachedMass,
    ForceSource,
    Freewheel,
    Ground,
    LinearLoad,
    Mass,
    SpeedSource,
    SpringDamper,
    TorqueSource,
)
from .sensors import AngleSensor, FlowSensor, ForceSensor, PositionSensor, PressureSensor, SpeedSensor
from .signals import Constant, Deadband, DeadTime, Difference, FirstOrderLag, Gain, PiController, Saturation
from .valve import FourEdgeValve, ProportionalSolenoid, Spool

__all__ = [
    "AngleSensor",
    "Arm",
    "AttachedMass",
    "Constant",
    "Cylinder",
    "DcMotor",
    "DeadTime",
    "Deadband",
    "Difference",
    "ElectricGround",
    "FirstOrderLag",
    "FlowSensor",
    "FlowSource",
    "ForceSensor",
    "ForceSource",
    "FourEdgeValve",
    "Freewheel",
    "Gain",
    "Ground",
    "LineVolume",
    "LinearLoad",
    "Mass",
    "Orifice",
    "Passage",
    "PiController",
    "Plug",
    "PositionSensor",
    "PressureSensor",
    "PressureSource",
    "ProportionalSolenoid",
    "Pump",
    "Reservoir",
    "Saturation",
    "SpeedControlledMotor",
    "SpeedSensor",
    "SpeedSource",
    "Spool",
    "SpringDamper",
    "TorqueSource",
    "VoltageSource",
]
