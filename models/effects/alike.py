"""Places of an effect that the equations cannot tell apart: there it is one candidate.

An effect feels something and acts on something. It does the same at two places where both are in one ratio:

    same       what acts there moves every output alike, and both feel the same: any effect
    scaled     the same but for a factor that never changes, as before and behind a gain: an effect at one place alone,
               whose parameters take the factor
    filtered   all that lies between the two is linear and never changes: a linear effect, as a delay or a lag

Pressures in the parts of a hose, shafts in one coupling, the two sides of a lossless sensor, mirror-equal halves of a
machine are the same by what they do, whatever they are called.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.models.language import Flange, HydraulicPort, RotationalFlange
from hydrotwin.models.language.additions import by_end
from hydrotwin.models.language.errors import SolveError, TopologyError
from hydrotwin.models.language.places import Places

from .effect import Effect, Site
from .law import law_of
from .survey import Channel, Survey

TOLD = 0.02  # relative: a law is never closer to the machine than that, so what differs by less is not told apart
FAINT = 0.01  # of the largest response of an output: below, a difference counts as if the response were so large
HARDLY_FELT = 0.1  # the same of what is felt
RELEVANT = 1e-9  # of the largest response of all: smaller ones are rounding
SAME = 1e-6  # relative: parameters whose directions differ by less are one
NOTHING = 1e-12  # of the largest response: what is left of none by rounding


def channels_of(places: Places, site: Site) -> tuple[Channel, ...]:
    """Where an effect at a site acts, then what else it reads."""
    if site.frees:
        delays = {i.dead_time: i.name for i in places.model.flat.inputs if i.dead_time}
        if site.frees in delays:
            return (Channel("signal", delays[site.frees], _unit(places, delays[site.frees])),)
        return (Channel("parameter", site.frees),)
    found = [Channel("node", places.node_at(port).name) for port in (site.ties or {}).values()]
    found += [Channel("behind", port) for port in by_end(site.between).values()]
    found += [Channel("signal", path, _unit(places, path)) for path in by_end(site.through).values()]
    return (*found, *(Channel("read", path) for path in (site.reads or {}).values()))


def _free(places: Places) -> list[str]:
    """The free parameters of a model, without those of what was added to it."""
    added = tuple(f"{a.name}." for a in places.model.additions if a.part is not None)
    return [p.name for p in places.model.flat.parameters if p.free and not (added and p.name.startswith(added))]


def _unit(places: Places, path: str) -> str:
    """The unit of a signal or of the rate of a state."""
    known = {w.path: w.unit for w in places.wires} | {path: v.unit for path, v in places.variables.items()}
    known |= {f"der({s.path})": f"({s.unit})/s" if s.unit != "1" else "1/s" for s in places.states}
    return known[path]


class Alike:
    """Sites of the effects of one model, gathered by what cannot be told apart."""

    def __init__(self, places: Places, sites: Sequence[Site]):
        self._places = places
        self._channels = {id(site): channels_of(places, site) for site in sites}
        self._sites = sites  # whose identities are the keys
        acting = [c for found in self._channels.values() for c in found]
        ends = [end for c in dict.fromkeys(acting) for end in self._ends(c)]
        freeing = any(c.kind == "parameter" for c in acting)
        self._free = [Channel("parameter", path) for path in _free(places)] if freeing else []
        self._survey = self._surveyed([*acting, *ends, *self._free])
        self._same: dict[Channel, Channel] = {}

    def _surveyed(self, channels: Sequence[Channel]) -> Survey | None:
        """The responses at all channels; None where nobody sees into the model, or it does not run from its start."""
        if self._places.model.flat.black_box:
            return None
        independent = {p.name for p in self._places.model.flat.parameters}
        known = [c for c in channels if c.kind != "parameter" or c.path in independent]
        if not known:
            return None
        try:
            survey = Survey(self._places, known)
        except (TopologyError, SolveError):
            return None  # nothing can act everywhere at once: each place counts by itself
        return survey if len(survey.journey) else None

    # -- what is told of one effect ----------------------------------------------------------------------------
    def gathered(self, effect: type[Effect], sites: Sequence[Site]) -> list[tuple[Site, ...]]:
        """The sites that matter, each with those that are the same: in their order, the first stands for the rest."""
        groups: list[list[Site]] = []
        for site in (s for s in sorted(sites, key=self._within) if not self._idle(effect, s)):
            group = next((g for g in groups if self._one(effect, g[0], site)), None)
            if group is None:
                groups.append([site])
            else:
                group.append(site)
        return [tuple(group) for group in sorted(groups, key=lambda group: sites.index(group[0]))]

    def _idle(self, effect: type[Effect], site: Site) -> bool:
        """Whether nothing that acts here moves an output, or it lies between two ports that are one place.

        A parameter says nothing by being freed where those that are free already do the same and have room for it.
        """
        acting = [c for c in self._channels[id(site)] if c.kind != "read"]
        if self._survey is None or not all(c in self._survey.channels for c in acting):
            return False
        if site.frees and acting[0].kind == "parameter":
            return self._done_already(effect, acting[0])
        across = len(acting) > 1 and all(c.kind == "node" for c in acting) and not site.reads
        if across and len({self._class(c) for c in acting}) == 1:
            return True
        return not any(self._moves(c) for c in acting)

    def _done_already(self, effect: type[Effect], channel: Channel) -> bool:
        """Whether free parameters do all that this one usually does, everywhere, without leaving their bounds."""
        rows = self._survey.slopes.T
        given, wanted = rows[:, [self._survey.index(c) for c in self._free]], rows[:, self._survey.index(channel)]
        size = np.maximum(np.linalg.norm(given, axis=0), np.finfo(float).tiny)  # units make columns of any size
        step, *_ = np.linalg.lstsq(given / size, wanted, rcond=None)
        if not np.linalg.norm(given / size @ step - wanted) < SAME * np.linalg.norm(wanted):
            return False
        known = {p.name: p for p in self._places.model.flat.parameters}
        value, free = known[channel.path].value, [known[c.path] for c in self._free]
        for end in effect.freed(value)[1]:
            moved = np.array([p.value for p in free]) + step / size * (end - value)
            if not all(p.bounds[0] <= v <= p.bounds[1] for p, v in zip(free, moved, strict=True)):
                return False
        return True

    def _moves(self, channel: Channel) -> bool:
        survey = self._survey
        alike = [k for k, c in enumerate(survey.channels) if c.kind == channel.kind]
        most = np.abs(survey.acts[alike]).max(initial=0.0)
        return bool(np.abs(survey.acts[survey.index(channel)]).max(initial=0.0) > NOTHING * most)

    def _one(self, effect: type[Effect], one: Site, other: Site) -> bool:
        """Whether the effect does the same at both."""
        if self._survey is None or one.also_free != other.also_free:
            return False
        ours, theirs = self._channels[id(one)], self._channels[id(other)]
        if [c.kind for c in ours] != [c.kind for c in theirs] or not ours:
            return False
        if not all(c in self._survey.channels for c in (*ours, *theirs)):
            return False
        if len(ours) > 1:
            classes = [[self._class(c) for c in channels] for channels in (ours, theirs)]
            if one.reads or other.reads or isinstance(one.through, dict):
                return classes[0] == classes[1]
            return sorted(map(str, classes[0])) == sorted(map(str, classes[1]))
        (a,), (b,) = ours, theirs
        if self._within(one) or self._within(other):
            return self._place(a) == self._place(b)
        return self._one_channel(effect, one, a, b)

    def _within(self, site: Site) -> bool:
        """Whether what is put behind a port of oil lies between parts that all have the same pressure everywhere.

        What is lost within a place of one pressure is lost at its ends.
        """
        (channel, *more) = self._channels[id(site)]
        ends = [] if more else self._ends(channel)
        return bool(ends) and self._survey is not None and len({self._class(end) for end in ends}) == 1

    def _place(self, channel: Channel) -> Channel:
        """The place of the port of a channel."""
        return self._class(Channel("node", self._places.node_at(channel.path).name))

    def _ends(self, channel: Channel) -> list[Channel]:
        """The nodes of all oil ports of the parts that meet behind a port of oil."""
        places = self._places
        node = places.node_at(channel.path) if channel.kind == "behind" else None
        if node is None or not issubclass(node.kind, HydraulicPort):
            return []
        parts = [places.part(port.rpartition(".")[0]) for port in node.ports]
        ports = [f"{part.path}.{name}" for part in parts if part for name in part.ports_of(HydraulicPort)]
        return [Channel("node", met.name) for met in map(places.node_at, ports) if met]

    def _one_channel(self, effect: type[Effect], site: Site, a: Channel, b: Channel) -> bool:
        i, j = self._survey.index(a), self._survey.index(b)
        if a.kind == "parameter":
            return self._same_direction(i, j)
        if a.kind != "signal":
            position = a.kind == "node" and issubclass(self._places.node_at(a.path).kind, (Flange, RotationalFlange))
            return self._scaled(i, j, shifts=position)
        law = law_of(effect, site.further)
        return self._scaled(i, j, law.shifts) or (law.linear and self._filtered(i, j))

    def _class(self, channel: Channel) -> Channel:
        """The first channel that is the same as this one."""
        if channel not in self._same:
            others = [c for c in dict.fromkeys(self._same.values()) if c.kind == channel.kind]
            found = (c for c in others if self._are_same(self._survey.index(c), self._survey.index(channel)))
            self._same[channel] = next(found, channel)
        return self._same[channel]

    # -- two channels ------------------------------------------------------------------------------------------
    def _feel_alike(self, i: int, j: int, h: np.ndarray, back: np.ndarray) -> bool:
        """Whether j feels of the inputs h times what i feels, of itself ``back`` times (points, frequencies or 1)."""
        survey = self._survey
        felt = [survey.feels[n][..., [*range(survey.inputs), survey.inputs + n]] for n in (i, j)]
        factors = np.concatenate([np.repeat(h[..., None], survey.inputs, axis=-1), back[..., None]], axis=-1)
        return _close(factors * felt[0], felt[1], HARDLY_FELT)

    def _act_alike(self, i: int, j: int, k: np.ndarray) -> bool:
        """Whether i does k times (points, frequencies or 1) what j does."""
        return _close(self._survey.acts[i], k[..., None] * self._survey.acts[j])

    def _are_same(self, i: int, j: int) -> bool:
        """Whether both are one place: what either does is felt there alike."""
        survey, one = self._survey, np.ones((len(self._survey.journey), 1))
        if not (_near(survey.values[i], survey.values[j]) and self._act_alike(i, j, one)):
            return False
        both = [survey.inputs + i, survey.inputs + j]
        across = _close(survey.feels[i][..., both], survey.feels[j][..., both], HARDLY_FELT)
        return self._feel_alike(i, j, one, one) and (across or survey.channels[i].kind in ("read", "signal"))

    def _scaled(self, i: int, j: int, shifts: bool) -> bool:
        """One factor for what is felt and one for what is done; where ``shifts``, an offset between them is nothing."""
        survey, journey = self._survey, self._survey.journey
        h = _factor(survey.feels[i][..., : survey.inputs], survey.feels[j][..., : survey.inputs], journey)
        k = _factor(survey.acts[j], survey.acts[i], journey)
        if h is None or k is None or (survey.channels[i].kind == "signal" and not np.allclose(h, k, rtol=TOLD)):
            return False
        v, w = h * survey.values[i], survey.values[j]
        if shifts:
            v, w = (np.concatenate([z[journey == n] - z[journey == n].mean() for n in set(journey)]) for z in (v, w))
        h, k = h[:, None], k[:, None]
        return _near(v, w) and self._act_alike(i, j, k) and self._feel_alike(i, j, h, h / k)

    def _filtered(self, i: int, j: int) -> bool:
        """What j feels comes from what i feels through something linear that is the same at every point."""
        survey, journey = self._survey, self._survey.journey
        a, b = (survey.feels[n][..., : survey.inputs] for n in (i, j))
        size = np.sum(np.abs(a) ** 2, axis=-1)
        H = np.sum(a.conj() * b, axis=-1) / np.where(size > 0, size, 1.0)
        for n in set(journey):
            H[journey == n] = H[journey == n].mean(axis=0)
        return bool(np.all(H != 0)) and self._act_alike(i, j, H) and self._feel_alike(i, j, H, np.ones_like(H))

    def _same_direction(self, i: int, j: int) -> bool:
        """Whether two parameters change rates, outputs and start in one proportion, everywhere."""
        a, b = self._survey.slopes[[i, j]]
        if not (np.abs(a).max(initial=0) and np.abs(b).max(initial=0)):
            return False
        return bool(np.linalg.norm(b - a * (a @ b) / (a @ a)) <= SAME * np.linalg.norm(b))


def _factor(a: np.ndarray, b: np.ndarray, journey: np.ndarray) -> np.ndarray | None:
    """The real factor (points,) between b and a on each journey, of arrays (points, frequencies, n); None where none.

    Every frequency counts alike.
    """
    seen = np.abs(a) > FAINT * np.abs(a).max(axis=(0, 1), initial=0.0, keepdims=True)
    if not seen.any():
        return None
    ratios, factor = np.where(seen, b / np.where(seen, a, 1.0), 0.0), np.zeros(len(journey))
    for n in set(journey):
        here = seen[journey == n]
        if not here.any():
            return None
        factor[journey == n] = np.median(ratios[journey == n][here].real)
    return factor if np.all(factor != 0) else None


def _close(a: np.ndarray, b: np.ndarray, faint: float = FAINT) -> bool:
    """Whether responses (points, frequencies, n) differ by no more than is told."""
    peak = np.maximum(np.abs(a), np.abs(b)).max(axis=(0, 1), initial=0.0, keepdims=True)
    floor = np.maximum(faint * peak, RELEVANT * peak.max(initial=0.0))
    return bool(np.all(np.abs(a - b) <= TOLD * np.maximum(np.maximum(np.abs(a), np.abs(b)), floor)))


def _near(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.all(np.abs(a - b) <= TOLD * max(np.abs(a).max(initial=0), np.abs(b).max(initial=0))))


def gathered(
    places: Places, sites: Mapping[type[Effect], Sequence[Site]]
) -> dict[type[Effect], list[tuple[Site, ...]]]:
    """The sites of each effect that matter, those that the equations cannot tell apart together."""
    known = {effect: list(effect.known(places)) for effect in sites}
    alike = Alike(places, [site for effect, found in sites.items() for site in (*known[effect], *found)])
    groups = {effect: alike.gathered(effect, [*known[effect], *found]) for effect, found in sites.items()}
    return {effect: [g for g in found if g[0] not in known[effect]] for effect, found in groups.items()}
