"""The compact electrohydraulic actuator (C-EHA) with its arm."""

from .model import CehA, CehAThirdOrder, model, third_order

__all__ = ["CehA", "CehAThirdOrder", "model", "third_order"]
