"""Drives that give way to what they turn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hydrotwin.models.language import Input, Output, Parameter, Shaft, State, der
from hydrotwin.models.language.places import Places

from .effect import Effect, Site
from .sites import drives, pumps, scattered

SAME = 1e-6  # relative: a torque that differs by less is that of the whole difference of pressures


class MotorDroop(Effect):
    """A drive that slows down under load.

        w = w_0 - R M,   T M' + M = M_load

    Load works through the same inertia as the command does: T is the lag of the drive. A drive of first order,
    T w' + w = k u - R M_load, is met exactly. A pump whose torque the model takes for another than that of the whole
    difference of its pressures has a site of its own, `PressedMotorDroop`.
    Source: W. Leonhard, Control of Electrical Drives, 2001, section 6.
    """

    id, title = "motor_droop", "speed lost under load"
    equation = "w = w_0 - R M,  T M' + M = M_load"
    source = "W. Leonhard, Control of Electrical Drives, 2001"
    typical = {"slope": (0.5, 100.0)}
    probes = ({"slope": 2.0}, {"slope": 20.0})
    confused_with = ("internal_leakage", "external_leakage", "turbulent_leakage", "pump_slip", "null_bias")
    experiment = "constant speeds at two loads, with the shaft's speed measured"

    a = Shaft("drive")
    b = Shaft("what it drives")
    torque = State(0.0, "N.m", "felt torque M", nominal=1.0, fixed=False)
    slope = Parameter(
        0.0, "rad/(s.N.m)", "speed lost per torque R", bounds=(0, 1e4), nominal=10.0, source="typical", free=True
    )
    lag = Parameter(0.03, "s", "lag T of the drive", bounds=(2e-3, 1.0), nominal=0.03, source="assumed")

    @classmethod
    def sites(cls, places: Places) -> Iterator[Site]:
        for site in drives(places):
            yield site
            yield from _by_pressure(places, site)

    @classmethod
    def at(cls, site: Site):
        """The part for a drive whose sensor sees what is lost or not, which feels the shaft or a pump's pressures."""
        if site.reads:
            kind = MeasuredPressedMotorDroop if site.through else PressedMotorDroop
            return kind(capacity=replace(kind.capacity, value=site.nominal))
        return MeasuredMotorDroop() if site.through else cls()

    def felt(self):
        """The torque that it gives way to."""
        return self.a.tau

    def equations(self):
        yield self.a.tau + self.b.tau == 0
        yield self.lag * der(self.torque) == self.felt() - self.torque
        yield self.b.w == self.a.w - self.slope * self.torque

    def initial_equations(self):
        yield self.torque == self.felt()


class MeasuredMotorDroop(MotorDroop):
    """The same where a sensor of the drive sees it."""

    id = ""
    u_speed = Input("rad/s", "speed without the load", nominal=100.0)
    y_speed = Output("rad/s", "measured speed", nominal=100.0)

    def equations(self):
        yield from super().equations()
        yield self.y_speed == self.u_speed - self.slope * self.torque


class PressedMotorDroop(MotorDroop):
    """The same under the torque of the whole difference of pressures: ``M_load = c_p (p_a - p_b)``.

    The return ratio of a pump with valves may be one of its flows alone, and not of its torque.
    """

    id = ""
    p_a = Input("Pa", "pressure at the side that is filled", nominal=1e6)
    p_b = Input("Pa", "pressure at the other side", nominal=1e6)
    capacity = Parameter(1e-6, "m3/rad", "c_p, as the model has it", bounds=(0, 1), source="the pump's")

    def felt(self):
        return self.capacity * (self.p_a - self.p_b)


class MeasuredPressedMotorDroop(MeasuredMotorDroop, PressedMotorDroop):
    """Both."""

    id = ""


def _by_pressure(places: Places, drive: Site) -> Iterator[Site]:
    """Pumps on the shaft of a drive whose torque is none of the whole difference of pressures; nominal: its c_p."""
    ports = places.node_at(drive.between).ports
    for site in pumps(places):
        shaft = site.reads["w"].removesuffix(".w")
        if shaft in ports:
            pressures = {"p_a": f"{site.ties['a']}.p", "p_b": f"{site.ties['b']}.p"}
            torque, p_a, p_b = scattered(places, [f"{shaft}.tau", *pressures.values()])
            (capacity, other), *_ = np.linalg.lstsq(np.stack([p_a, p_b], axis=1), torque, rcond=None)
            if capacity > 0 and abs(capacity + other) > SAME * capacity:
                name = f"{drive.name}-{site.name}"
                yield replace(drive, name=name, reads=pressures, nominal=float(capacity), further=True)
