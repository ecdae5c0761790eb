"""Small lags that suit the step a model is integrated with: never faster than that step can follow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import ClassVar

from hydrotwin.models.language.places import Places

from .effect import Effect, Site


@dataclass(frozen=True)
class SteppedSite(Site):
    """A site of a model whose step [s] is known."""

    step: float = 1e-3


def stepped(sites: Callable[[Places], Iterator[Site]]):
    """The same sites, with the step of the model."""

    def found(places: Places) -> Iterator[SteppedSite]:
        for site in sites(places):
            yield SteppedSite(**{f.name: getattr(site, f.name) for f in fields(Site)}, step=places.model.step)

    return staticmethod(found)


class Lagged(Effect):
    """An effect with a fixed parameter ``resolution`` [s], a numerical lag that is at least the step of the model.

    shortest : in steps; half a step is what an explicit Runge-Kutta method of order 4 still follows without overshoot.
    """

    shortest: ClassVar[float] = 1.0

    @classmethod
    def at(cls, site: Site):
        """The part for a site, its lag no shorter than the step."""
        part = super().at(site)
        if part is None:
            return None
        declared, shortest = part.declared("resolution"), cls.shortest * getattr(site, "step", 0.0)
        if declared.value >= shortest:
            return part
        low, high = declared.bounds
        return part.but(resolution=replace(declared, value=shortest, bounds=(low, max(high, 2 * shortest))))


def followed(u, w, time_constant, resolution):
    """``T y' + y = u`` without a stiff state where T is zero: ``(w', y)`` of a state w, of symbols.

        w' = (u - w)/tau,   y = u + T/tau (w - u),   tau = (T^4 + T_0^4)^(1/4)

    The same delay T for slow signals at any T; from T = 2 T_0 on the same lag within 2 %.
    """
    tau = (time_constant**4 + resolution**4) ** 0.25
    return (u - w) / tau, u + time_constant / tau * (w - u)


def closely_followed(u, w, v, time_constant, resolution):
    """`followed` with a second state v, for signals not much slower than T_0: ``(w', v', y)``.

        w' = (u - w)/tau,   v' = (w - v)/tau,   y = (1 - r)^2 u + r (3 - 2 r) w - r (1 - r) v,   r = T/tau

    The same as 1/(1 + T s) but for r (1 - r)^2 (tau s)^3 and beyond, at any T; itself where r = 1.
    """
    tau = (time_constant**4 + resolution**4) ** 0.25
    r = time_constant / tau
    return (u - w) / tau, (w - v) / tau, (1 - r) ** 2 * u + r * (3 - 2 * r) * w - r * (1 - r) * v
