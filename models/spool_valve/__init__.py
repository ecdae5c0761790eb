"""The proportional spool valve with its cylinder and load."""

from .model import QuasiStaticSpoolValve, SpoolValve, model, quasi_static

__all__ = ["QuasiStaticSpoolValve", "SpoolValve", "model", "quasi_static"]
