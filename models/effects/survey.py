"""How a model answers at its places: what something that acts there does to the outputs, and what it feels there.

The equations alone tell it. Every place gets a small disturbance with an amplitude of its own: a flow into a node, a
difference of potential behind a port, something added to a signal, a change of a parameter. Along rough journeys of
the model, from its own start and under inputs of several sizes, all of them are linearised,

    x' = A x + B_u u + B a,   y = C x + D a,   r = R x + R_u u + R_a a,

and what is compared are the responses ``y/a`` and ``r/u``, ``r/a`` over the frequencies that recordings show.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydrotwin.models.language import Component, Input, Model, Output, Parameter
from hydrotwin.models.language.additions import Addition
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.places import Places

BAND = np.geomspace(0.3, 300.0, 6)  # rad/s: a minute to the Nyquist frequency of 100 Hz, what recordings show
SIZES = (0.3, 1.0, 2.0)  # of the inputs on a journey each, in their nominals
STEPS, STEP = 40, 0.05  # of a journey; s, long enough for what no recording shows to settle within one
LEVELS = 8  # steps for which an input stays where it is
SAMPLED = 4  # every so many steps the model is linearised
SHAKEN = 0.1  # relative change of free parameters on a journey: what holds for one value alone is a coincidence
SCATTERED = 12  # states around the start at which the directions of parameters are compared
NAME = "disturbance_{}"


@dataclass(frozen=True)
class Channel:
    """Something that can act on a model, and what it feels there.

    kind : "node" (a flow into the node of a port, its potential), "behind" (a difference of potential behind a port,
        the flow through it), "signal" (something added to a signal, the signal before), "parameter" (a change of it,
        nothing), "read" (nothing, the value of a path).
    """

    kind: str
    path: str
    unit: str = "1"


def _joined(places: Places, channel: Channel) -> Addition:
    """The part that disturbs a node, a port or a signal."""
    part: dict = {"__module__": __name__, "__doc__": "A disturbance with an amplitude of its own."}
    if channel.kind == "signal":
        part |= {"u": Input(channel.unit), "y": Output(channel.unit), "amplitude": _amplitude(channel.unit)}
        part["equations"] = lambda self: iter([self.y == self.u + self.amplitude])
        return Addition("", type("Added", (Component,), part)(), through=channel.path)
    kind = places.node_at(channel.path).kind
    (potential, unit), (flow, flow_unit) = kind("").potential, kind("").flow
    if channel.kind == "node":
        part |= {"port": kind("here"), "amplitude": _amplitude(flow_unit)}
        part["equations"] = lambda self: iter([getattr(self.port, flow) == -self.amplitude])
        return Addition("", type("Injected", (Component,), part)(), ties={"port": channel.path})

    def equations(self):
        yield getattr(self.a, flow) + getattr(self.b, flow) == 0
        yield getattr(self.a, potential) - getattr(self.b, potential) == self.amplitude

    part |= {"a": kind("here"), "b": kind("behind"), "amplitude": _amplitude(unit), "equations": equations}
    return Addition("", type("Difference", (Component,), part)(), between=channel.path)


def _amplitude(unit: str) -> Parameter:
    return Parameter(0.0, unit, "amplitude", bounds=(-1e12, 1e12), nominal=1.0, source="none")


def bare(model: Model) -> Model:
    """The model without what was added to it."""
    if not model.additions:
        return model
    added = tuple(f"{a.name}." for a in model.additions if a.part is not None)
    freed = {a.frees for a in model.additions}
    own = {path: s for path, s in model.settings.items() if not path.startswith(added)} if added else model.settings
    own = {path: {k: v for k, v in s.items() if k != "free"} if path in freed else s for path, s in own.items()}
    return type(model)(model.root, model.name, settings=own, step=model.step)


class Survey:
    """The responses of a model at channels.

    acts : (m, points, frequencies, outputs), y/a in nominals of the outputs.
    feels : (m, points, frequencies, inputs + m), r/u in nominals of the inputs, then r/a.
    values : (m, points) of what is felt; journey : (points,) which journey each point is on.
    slopes : (m, rows), rates, outputs and start by a change of each, at states anywhere, each row in its largest.
    inputs : how many the model has.

    Where no journey went anywhere, ``journey`` is empty, and there are no responses.
    """

    def __init__(self, places: Places, channels: Iterable[Channel]):
        self.channels = tuple(dict.fromkeys(channels))
        self._index = {channel: k for k, channel in enumerate(self.channels)}
        model = bare(places.model)
        additions, self._amplitudes, read = [], [], []
        for k, channel in enumerate(self.channels):
            name = NAME.format(k)
            if channel.kind in ("node", "behind", "signal"):
                joined = _joined(places, channel)
                additions.append(Addition(name, joined.part, joined.ties, {}, joined.through, joined.between))
            acts = {"parameter": channel.path, "read": None}.get(channel.kind, f"{name}.amplitude")
            self._amplitudes.append(acts)
            read.append(self._felt(places, channel, name))
        self._disturbed = model.plus(additions, sought=True)
        self._travel(self._disturbed.flat, read)

    @staticmethod
    def _felt(places: Places, channel: Channel, name: str) -> str | None:
        if channel.kind == "parameter":
            return None
        if channel.kind == "signal":
            return f"{name}.u"
        if channel.kind == "read":
            return channel.path
        kind = places.node_at(channel.path).kind("")
        return f"{channel.path}.{kind.potential[0] if channel.kind == 'node' else kind.flow[0]}"

    def index(self, channel: Channel) -> int:
        return self._index[channel]

    def _travel(self, flat: FlatModel, read: Sequence[str | None]) -> None:
        linear, step = self._linearised(flat, read), _stepping(flat)
        draw, points, journey = np.random.default_rng(0), [], []
        for k, size in enumerate(SIZES):
            p = _shaken(flat, draw)
            for x, u in _journey(flat, step, p, size, draw):
                found = [part.full() for part in linear(0.0, x, u, p)]
                if all(np.isfinite(part).all() for part in found):
                    points.append(self._responses(flat, found))
                    journey.append(k)
        self.journey, self.inputs = np.array(journey, int), len(flat.inputs)
        if points:
            self.acts, self.feels, self.values = (np.stack(part, axis=1) for part in zip(*points, strict=True))
        self.slopes = self._slopes(flat, linear, draw)

    def _slopes(self, flat: FlatModel, linear: ca.Function, draw: np.random.Generator) -> np.ndarray:
        """(m, rows): rates, outputs and start by each amplitude, at states anywhere around the start."""
        p, given = _shaken(flat, draw), np.array([i.default for i in flat.inputs])
        start = np.nan_to_num(flat.start_given()(given, p, []).full().ravel())
        rows = [self._start_moves(flat, p)]
        for _ in range(SCATTERED):
            x = start + draw.uniform(-1, 1, len(start)) * [s.nominal for s in flat.states]
            u = given + draw.uniform(-1, 1, len(given)) * [i.nominal for i in flat.inputs]
            _, _, B, _, D, *_ = (part.full() for part in linear(0.0, x, u, p))
            rows.append(np.vstack([B, D]).T)
        found = np.hstack(rows)
        found = found[:, np.isfinite(found).all(axis=0)]
        return found / np.maximum(np.abs(found).max(axis=0, keepdims=True, initial=0.0), 1e-300)

    def _linearised(self, flat: FlatModel, read: Sequence[str | None]) -> ca.Function:
        """A, B_u, B, C, D, R, R_u, R_a and r."""
        t, x, u, p = flat.ode.sx_in()
        rates, outputs = flat.ode(t, x, u, p)
        paths = [path for path in read if path]
        seen = self._disturbed.observe(paths)(t, x, u, p) if paths else ca.SX(0, 1)
        rows = iter(range(len(paths)))
        felt = ca.vertcat(*(seen[next(rows)] if path else 0 for path in read))
        columns = [flat.index_of(name) if name else None for name in self._amplitudes]

        def by_amplitude(expression):
            whole = ca.jacobian(expression, p)
            none = ca.SX(expression.shape[0], 1)
            return ca.horzcat(*(none if c is None else whole[:, c] for c in columns))

        ends = [ca.jacobian(rates, x), ca.jacobian(rates, u), by_amplitude(rates), ca.jacobian(outputs, x)]
        ends += [by_amplitude(outputs), ca.jacobian(felt, x), ca.jacobian(felt, u), by_amplitude(felt), felt]
        return ca.Function("linearised", [t, x, u, p], [ca.densify(ca.SX(end)) for end in ends], {"cse": True})

    def _responses(self, flat: FlatModel, found: Sequence[np.ndarray]):
        A, B_u, B, C, D, R, R_u, R_a, felt = found
        outputs = np.array([o.nominal for o in flat.outputs])
        B_u, R_u = (part * [i.nominal for i in flat.inputs] for part in (B_u, R_u))
        acts, feels = [], []
        for frequency in BAND:
            moved = np.linalg.solve(1j * frequency * np.eye(len(A)) - A, np.hstack([B_u, B]))
            acts.append(((C @ moved[:, B_u.shape[1] :] + D) / outputs[:, None]).T)
            feels.append(np.einsum("ij,jk->ik", R, moved) + np.hstack([R_u, R_a]))  # no threads for so little
        return np.stack(acts, axis=1), np.stack(feels, axis=1), felt.ravel()

    def _start_moves(self, flat: FlatModel, p: np.ndarray) -> np.ndarray:
        """(m, states): the start by each parameter; nothing for other channels."""
        moves = np.zeros((len(self.channels), len(flat.states)))
        parameters = [(k, c.path) for k, c in enumerate(self.channels) if c.kind == "parameter"]
        if parameters:
            u, v = ca.SX.sym("u", len(flat.inputs)), ca.SX.sym("p", len(flat.parameters))
            by_all = ca.jacobian(flat.start_given()(u, v, []), v)
            columns = [flat.index_of(path) for _, path in parameters]
            start = ca.Function("start", [u, v], [ca.densify(by_all[:, columns])])
            found = np.nan_to_num(start([i.default for i in flat.inputs], p).full())
            for (k, _), column in zip(parameters, found.T, strict=True):
                moves[k] = column
        return moves


def _stepping(flat: FlatModel) -> ca.Function:
    t, x, u, p = flat.ode.sx_in()
    rates, _ = flat.ode(t, x, u, p)
    return ca.Function("stepping", [t, x, u, p], [rates, ca.densify(ca.jacobian(rates, x))])


def _shaken(flat: FlatModel, draw: np.random.Generator) -> np.ndarray:
    """The parameters, the free ones a little elsewhere."""
    values = {}
    for p in flat.parameters:
        if p.free:
            size = abs(p.value) or min(p.nominal, max(map(abs, p.bounds)))
            values[p.name] = float(np.clip(p.value + SHAKEN * size * draw.uniform(-1, 1), *p.bounds))
    return flat.parameter_vector(values)


def _journey(flat: FlatModel, step: ca.Function, p: np.ndarray, size: float, draw: np.random.Generator):
    """States and inputs along a rough run: linearly implicit Euler steps, in which all that is fast settles."""
    given = np.array([i.default for i in flat.inputs])
    nominal = np.array([i.nominal for i in flat.inputs])
    low, high = (np.array([s.bounds[k] for s in flat.states]) for k in (0, 1))
    x = np.nan_to_num(flat.start_given()(given, p, []).full().ravel())
    for k in range(STEPS):
        if k % LEVELS == 0:
            u = given + size * nominal * draw.uniform(-1, 1, len(given))
        rates, slopes = (part.full() for part in step(0.0, x, u, p))
        if not (np.isfinite(rates).all() and np.isfinite(slopes).all()):
            return
        x = np.clip(x + np.linalg.solve(np.eye(len(x)) / STEP - slopes, rates.ravel()), low, high)
        if k % SAMPLED == SAMPLED - 1:
            yield x, u
