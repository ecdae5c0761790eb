"""What moves: a flange, a rotational flange, a shaft, or a link that turns on a joint of its own.

A law of force over speed is written once, for a flange. On what turns its forces are torques and its speeds rates of an
angle, each at a usual lever. A link whose joint is no port feels the torque over its inertia, as an angular
deceleration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

from hydrotwin.models.language import Flange, Input, Output, Parameter, RotationalFlange, Shaft, der
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.places import Places
from hydrotwin.models.language.units import compatible

from .effect import Effect, Site
from .inertia import moved_mass
from .stepping import SteppedSite

LEVERS = {"rotational": 0.1, "shaft": 0.01, "joint": 0.1}  # m, at which usual forces become usual torques
LINK = 10.0  # kg.m2, a usual inertia behind a joint
TORQUES = {"N": ("N.m", 1), "N.s/m": ("N.m.s/rad", 2), "N/m": ("N.m/rad", 2)}  # unit -> that of what turns, levers
ANGLES = {"m": ("rad", -1), "m/s": ("rad/s", -1)}
DECELERATIONS = {"N": "rad/s2", "N.s/m": "1/s", "N/m": "1/s2"}  # torques over inertia
PORTS = {"flange": Flange, "rotational": RotationalFlange, "shaft": Shaft}


@dataclass(frozen=True)
class BodySite(SteppedSite):
    """A body and the mass [kg] or inertia [kg.m2] that a force on it moves, nan where it moves none at once."""

    body: str = "flange"
    mass: float = math.nan


class OnBody(Effect):
    """A force against the motion of a body: `speed`, `position` and `against` say what these are on each kind.

    bodies : the kinds it acts on. body : the kind that this class is written for.
    """

    bodies: ClassVar[tuple[str, ...]] = ("flange", "rotational", "shaft", "joint")
    body: ClassVar[str] = "flange"
    along: ClassVar[bool] = False  # whether it depends on the position

    flange = Flange("where it acts")

    def speed(self):
        """v [m/s], or w [rad/s]."""
        if self.body == "joint":
            return self.flange
        return self.flange.w if self.body == "shaft" else der(self.position())

    def position(self):
        """s [m], or an angle [rad]."""
        if self.body == "joint":
            return self.angle
        return self.flange.phi if self.body == "rotational" else self.flange.s

    def against(self, force):
        """The equation by which a force [N], or a torque [N.m], acts against larger positions."""
        if self.body == "joint":
            return self.y == self.u - force
        return (self.flange.f if self.body == "flange" else self.flange.tau) == force

    @classmethod
    def sites(cls, places: Places) -> Iterator[BodySite]:
        for body in cls.bodies:
            if not (cls.along and body == "shaft"):
                yield from _found(places, body, cls.along)

    @classmethod
    def at(cls, site: Site):
        """The part for the body of a site."""
        body = getattr(site, "body", cls.body)
        if body != cls.body:
            return _turned(cls, body).at(site)
        part = super().at(site)
        return part.but(**_levered(part, body)) if body != "flange" else part


def held(sites: Callable[[Places], Iterator[Site]]):
    """The same sites of flanges, with the step of the model and the mass behind their flange."""

    def found(places: Places) -> Iterator[BodySite]:
        for site in sites(places):
            mass = moved_mass(places, site.ties["flange"])
            yield BodySite(**{**vars(site), "step": places.model.step, "mass": mass})

    return staticmethod(found)


def _found(places: Places, body: str, along: bool) -> Iterator[BodySite]:
    """Bodies of one kind; the port is ``flange``, of a joint the speed. Those of flanges are the usual ones."""
    step = places.model.step
    if body == "joint":
        for part, angle, speed in links(places):
            reads = {"flange": speed} | ({"angle": angle} if along else {})
            yield BodySite(part, reads=reads, through=f"der({speed})", further=True, step=step, body=body, mass=1.0)
        return
    for node in places.nodes_of(PORTS[body]):
        if not places.is_prescribed(node):
            mass = moved_mass(places, node.name)
            ties = {"flange": node.name}
            yield BodySite(node.name, ties=ties, further=body != "flange", step=step, body=body, mass=mass)


def links(places: Places) -> Iterator[tuple[str, str, str]]:
    """Parts that turn by themselves, with the paths of their angle and its rate; what turns a port has that place."""
    states = {s.path: s.unit for s in places.states}
    for part in places.parts:
        angles = [s for s in part.states if states[s] == "rad"]
        speeds = [s for s in part.states if compatible(states[s], "rad/s")]
        if len(angles) == len(speeds) == 1 and not (part.ports_of(RotationalFlange) or part.ports_of(Shaft)):
            yield part.path, angles[0], speeds[0]


@lru_cache(maxsize=128)
def _turned(effect: type[OnBody], body: str) -> type[OnBody]:
    """The effect for another kind of body: the same numbers in its units."""
    content = {"__module__": effect.__module__, "__doc__": effect.__doc__, "id": "", "body": body}
    for name, declared in declarations(effect).items():
        if isinstance(declared, Parameter):
            content[name] = replace(declared, unit=_unit(declared.unit, body))
    if body == "joint":
        content |= {"flange": Input("rad/s", "rate of the angle"), "u": Input("rad/s2", "its rate without the effect")}
        content |= {"y": Output("rad/s2", "its rate")} | ({"angle": Input("rad", "angle")} if effect.along else {})
    else:
        content["flange"] = PORTS[body](effect.flange.description)
    return type(f"{effect.__name__}On{body.capitalize()}", (effect,), content)


def _unit(unit: str, body: str) -> str:
    if body == "joint" and unit in DECELERATIONS:
        return DECELERATIONS[unit]
    return {**TORQUES, **ANGLES}.get(unit, (unit, 0))[0]


def _levered(part: OnBody, body: str) -> dict[str, Parameter]:
    """The parameters of a turned part at the usual lever, and over the usual inertia of a link."""
    levers = {_unit(unit, body): power for unit, (_, power) in (*TORQUES.items(), *ANGLES.items())}
    changed = {}
    for name, own in declarations(type(part)).items():
        if isinstance(own, Parameter) and own.unit in levers:
            inertia = LINK if body == "joint" and own.unit in DECELERATIONS.values() else 1.0
            scale, now = LEVERS[body] ** levers[own.unit] / inertia, part.declared(name)
            low, high = (bound * scale for bound in now.bounds)
            nominal = (now.nominal or 1.0) * scale
            changed[name] = replace(now, value=now.value * scale, bounds=(low, high), nominal=nominal)
    return changed
