"""Two tanks, one above the other, filled by a pump: what Bernoulli's law says of them. See README.md."""

from __future__ import annotations

import math

from hydrotwin.models.components import Gain
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.models.laws.orifice import signed_root


class Pump(Gain):
    """Flow in proportion to the voltage: ``y = k u``; the flow is counted in volts of level per second."""

    u = Input("V", "pump voltage", nominal=5.0)
    y = Output("V/s", "flow", nominal=0.2)
    k = Parameter(0.05, "1/s", "flow per voltage", bounds=(0, 1), nominal=0.05, source="guess: fills a tank in minutes")


class Tank(Component):
    """An open tank with an outlet in its bottom: ``dh/dt = q_in - k sqrt(h)``, level h in volts of its sensor.

    Source: Torricelli; k is outlet area over tank area times sqrt(2 g), in the sensor's volts. Close to the bottom the
    root is straightened, as a draining outlet is, so that an empty tank stays empty.
    """

    inflow = Input("V/s", "flow in", nominal=0.2)
    outflow = Output("V/s", "flow through the outlet", nominal=0.2)
    discharge = Parameter(
        0.05, "sqrt(V)/s", "discharge k of the outlet", bounds=(0, 1), nominal=0.05, source="guess: empties in minutes"
    )
    shallow = Parameter(0.01, "V", "level below which the root is straightened", bounds=(1e-4, 1), source="numerical")
    level = State(5.0, "V", "level", nominal=5.0, bounds=(0.0, math.inf))

    def equations(self):
        yield self.outflow == self.discharge * signed_root(self.level, self.shallow)
        yield der(self.level) == self.inflow - self.outflow


class CascadedTanks(Component):
    """Pump, upper tank, lower tank, and a level sensor on the lower one. Both tanks have the same section."""

    pump = Input("V", "pump voltage", nominal=5.0)
    level = Output("V", "level of the lower tank", nominal=5.0)

    supply = Pump()
    upper = Tank()
    lower = Tank()

    def equations(self):
        yield connect(self.pump, self.supply.u)
        yield connect(self.supply.y, self.upper.inflow)
        yield connect(self.upper.outflow, self.lower.inflow)
        yield self.level == self.lower.level


def model() -> Model:
    """The tanks as a first guess writes them."""
    free = ("supply.k", "upper.discharge", "lower.discharge")
    return Model(CascadedTanks(), "cascaded_tanks", settings={path: {"free": True} for path in free}, step=1.0)
