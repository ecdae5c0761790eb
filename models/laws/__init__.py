"""Constitutive relations that fill the slots of components."""

from .bulk_modulus import AirLadenBulkModulus, BulkModulusLaw, ConstantBulkModulus
from .friction import Coulomb, FrictionLaw, NoFriction, Stribeck, Viscous
from .leakage import LaminarLeakage, LeakageLaw, NoLeakage, TurbulentLeakage
from .metering_edge import MeteringEdgeLaw, OverlappedEdge, ZeroOverlapEdge
from .orifice import OrificeLaw, SharpEdgedOrifice, TurbulentOrifice
from .pump_loss import ConstantVolumetricEfficiency, NoPumpLoss, PumpLossLaw, PumpSlip

__all__ = [
    "AirLadenBulkModulus",
    "BulkModulusLaw",
    "ConstantBulkModulus",
    "ConstantVolumetricEfficiency",
    "Coulomb",
    "FrictionLaw",
    "LaminarLeakage",
    "LeakageLaw",
    "MeteringEdgeLaw",
    "NoFriction",
    "NoLeakage",
    "NoPumpLoss",
    "OrificeLaw",
    "OverlappedEdge",
    "PumpLossLaw",
    "PumpSlip",
    "SharpEdgedOrifice",
    "Stribeck",
    "TurbulentLeakage",
    "TurbulentOrifice",
    "Viscous",
    "ZeroOverlapEdge",
]
