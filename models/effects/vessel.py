"""Vessels whose level cannot rise for ever."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydrotwin.models.language import Input, Output, Parameter
from hydrotwin.models.language.places import Places

from .exceeded import exceeded
from .stepping import Lagged, SteppedSite

SCHOUKENS = (
    "M. Schoukens and J. P. Noel, Three benchmarks addressing open challenges in nonlinear system identification, 2017"
)
ENDLESS = 1e6  # nominal levels, a rim that nothing reaches


def levels(places: Places):
    """States that are levels: declared with a lower bound of 0 or more."""
    return [s for s in places.states if 0 <= s.bounds[0] < np.inf]


class Overflow(Lagged):
    """A vessel runs over: what would stand above its rim is spilled, and lost or partly caught by a lower vessel.

        spill = max(h - h_max, 0)/T_0,   dh/dt = (dh/dt without it) - spill

    The level exceeds the rim by T_0 times the rate that is spilled; T_0 is the model's step. At a site of two levels
    the lower one catches a share, see `OverflowIntoLower`.

    Source: Schoukens and Noel 2017, cascaded tanks.
    """

    id, title = "overflow", "overflow"
    equation = "h <= h_max; a share r of the spill reaches the lower vessel, if there is one"
    source = SCHOUKENS
    typical = {"limit": (0.5, 20.0), "share": (0.0, 1.0)}
    probes = ({"limit": 1.0, "share": 0.5}, {"limit": 3.0, "share": 0.5}, {"limit": 10.0, "share": 0.5})
    confused_with = ("command_saturation", "sensor_scale")
    experiment = "fill the upper vessel to the rim and go on, with both levels measured"

    u = Input("signal/s", "rate of the level without a rim")
    y = Output("signal/s", "rate of the level")
    h = Input("signal", "level")
    limit = Parameter(ENDLESS, "signal", "h_max", bounds=(0, ENDLESS), nominal=1.0, source="far above: none", free=True)
    resolution = Parameter(1e-3, "s", "T_0", bounds=(1e-5, 1e3), source="numerical: the model's step")

    @classmethod
    def sites(cls, places: Places):
        for level in levels(places):
            path = level.path
            yield SteppedSite(
                path,
                reads={"h": path},
                through=f"der({path})",
                unit=level.unit,
                nominal=level.nominal,
                step=places.model.step,
            )
        yield from OverflowIntoLower.sites(places)

    @classmethod
    def at(cls, site):
        """The part for one level, or for a level above another."""
        if cls is Overflow and isinstance(site.through, dict):
            return OverflowIntoLower.at(site)
        return super().at(site)

    def equations(self):
        yield self.y == self.u - ca.fmax(self.h - self.limit, 0) / self.resolution

    @classmethod
    def probes_for(cls, seen) -> list[dict]:
        """Rims that the level seen exceeds, a share of the spill caught where something can catch it."""
        return [{"limit": limit, "share": share} for limit in exceeded(seen["h"]) for share in (0.3, 0.8)]


class OverflowIntoLower(Lagged):
    """A vessel runs over into a lower one, which catches a share of what is spilled.

        spill = max(h_1 - h_max, 0)/T_0,   dh_1/dt = ... - spill,   dh_2/dt = ... + r spill

    ``r`` counts in levels: the share times the section of the upper vessel over that of the lower one.

    Source: Schoukens and Noel 2017, cascaded tanks.
    """

    u_upper = Input("signal/s", "rate of the upper level without a rim")
    y_upper = Output("signal/s", "rate of the upper level")
    u_lower = Input("signal/s", "rate of the lower level without the spill")
    y_lower = Output("signal/s", "rate of the lower level")
    h = Input("signal", "upper level")
    limit = Parameter(ENDLESS, "signal", "h_max", bounds=(0, ENDLESS), nominal=1.0, source="far above: none", free=True)
    share = Parameter(0.5, "1", "r", bounds=(0, 1), nominal=0.5, source="how they stand", free=True)
    resolution = Parameter(1e-3, "s", "T_0", bounds=(1e-5, 1e3), source="numerical: the model's step")

    @classmethod
    def sites(cls, places: Places):
        found = levels(places)
        for upper in found:
            for lower in found:
                if upper is not lower and upper.unit == lower.unit:
                    yield SteppedSite(
                        f"{upper.path}-{lower.path}",
                        reads={"h": upper.path},
                        through={"upper": f"der({upper.path})", "lower": f"der({lower.path})"},
                        unit=upper.unit,
                        nominal=upper.nominal,
                        step=places.model.step,
                    )

    def equations(self):
        spill = ca.fmax(self.h - self.limit, 0) / self.resolution
        yield self.y_upper == self.u_upper - spill
        yield self.y_lower == self.u_lower + self.share * spill
