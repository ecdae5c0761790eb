"""Cylinder and mechanism: geometry, masses, play, stops."""

from __future__ import annotations

from .effect import Effect
from .sites import parameters


class AreaError(Effect):
    """A piston area that is not what the drawing says; the parameter becomes free."""

    id, title = "area_error", "area other than stated"
    equation = "A = A_stated (1 + e)"
    source = "tolerances of the geometry"
    typical = {"value": (0.9, 1.1)}
    probes = ({"value": 1.05}, {"value": 0.95})
    confused_with = ("displacement_error", "sensor_scale")
    experiment = "pressures and position together, at two loads"

    sites = staticmethod(parameters("m2"))
