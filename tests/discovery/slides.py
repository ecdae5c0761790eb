"""A pushed mass, a drive and a tank; and what they do with exact friction, dead time and pulses, without the models.

Held forces: between two samples the motion is a sum of exponentials; where the speed passes zero it sticks or turns.
"""

from __future__ import annotations

import time as clock
from concurrent.futures import Future

import numpy as np

from hydrotwin.discovery.answer.standing import Standing, standing
from hydrotwin.discovery.asked import Wanted
from hydrotwin.discovery.discover import discover, inside
from hydrotwin.discovery.fits.job import Fitted, Job, Question
from hydrotwin.discovery.fits.whole import fit
from hydrotwin.discovery.recordings import split
from hydrotwin.discovery.structures.jobs import EFFORTS
from hydrotwin.discovery.structures.search import Search
from hydrotwin.models.components.mechanical import ForceSource
from hydrotwin.models.effects import candidates
from hydrotwin.models.language import Component, Flange, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.records import Record

PERIOD = 0.02  # s
MASS, DAMPING = 50.0, 200.0  # kg, N.s/m
NOISE, RATE_NOISE = 2e-3, 0.02  # m/s, rad/s
STEP = 5e-3  # s, of the runs of a search
START = {"mass.mass": 65.0, "mass.damping": 150.0}  # what the model begins with


class PushedMass(Component):
    """A mass with viscous friction."""

    flange = Flange("where forces act")
    mass = Parameter(START["mass.mass"], "kg", "moved mass", bounds=(1.0, 1e4), free=True)
    damping = Parameter(START["mass.damping"], "N.s/m", "viscous friction", bounds=(1.0, 1e4), free=True)
    position = State(0.0, "m", "position", nominal=0.5)
    speed = State(0.0, "m/s", "speed", nominal=1.0)

    def equations(self):
        yield self.flange.s == self.position
        yield der(self.position) == self.speed
        yield self.mass * der(self.speed) == self.flange.f - self.damping * self.speed


class Slide(Component):
    """The mass, its speed measured."""

    force = Input("N", "force", nominal=300.0, interpolation="hold")
    speed = Output("m/s", "measured speed", nominal=1.0)
    mass = PushedMass()
    source = ForceSource()

    def equations(self):
        yield connect(self.force, self.source.force)
        yield connect(self.source.flange, self.mass.flange)
        yield self.speed == self.mass.speed


class Drive(Component):
    """A drive of first order: T w' + w = k u."""

    command = Input("V", "command")
    rate = Output("rad/s", "measured speed", nominal=10.0)
    gain = Parameter(8.0, "rad/(s.V)", "gain", bounds=(0.1, 100.0), free=True)
    time_constant = Parameter(0.5, "s", "time constant", bounds=(0.01, 10.0), free=True)
    turning = State(0.0, "rad/s", "speed", nominal=10.0)

    def equations(self):
        yield self.time_constant * der(self.turning) + self.turning == self.gain * self.command
        yield self.rate == self.turning


class TwoSensors(Drive):
    """The drive measured twice."""

    other = Output("rad/s", "measured again", nominal=10.0)

    def equations(self):
        yield from super().equations()
        yield self.other == self.turning


class Unstable(Drive):
    """A drive that runs away at once, whatever its gain: T w' - w = k u."""

    time_constant = Parameter(1e-3, "s", "time constant", bounds=(1e-4, 2e-3))

    def equations(self):
        yield self.time_constant * der(self.turning) == self.gain * self.command + self.turning
        yield self.rate == self.turning


def pushes(seed: int, seconds: float = 12.0, highest: float = 300.0) -> tuple[np.ndarray, np.ndarray]:
    """Time and a force of random steps and pauses with a slow wave, held between samples."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, PERIOD)
    levels = random.uniform(-1.0, 1.0, int(seconds / 0.6) + 1) * (random.uniform(size=int(seconds / 0.6) + 1) > 0.2)
    wave = 0.3 * np.sin(2 * np.pi * random.uniform(0.1, 0.3) * time + random.uniform(0, 6))
    return time, highest * np.clip(levels[(time / 0.6).astype(int)] + wave, -1, 1)


def slid(force: np.ndarray, friction=0.0, mass: float = MASS, damping: float = DAMPING) -> np.ndarray:
    """Speed at every sample of a mass from rest, Coulomb friction exact: m v' = F - b v - F_c sign(v).

    friction : F_c [N], one for all samples or one for each.
    """
    speeds, v = np.zeros(len(force)), 0.0
    for k, (push, dry) in enumerate(zip(force[:-1], np.broadcast_to(friction, len(force)), strict=False)):
        left = PERIOD
        while left > 1e-12:
            if v == 0.0 and abs(push) <= dry:
                break
            way = np.sign(v) if v else np.sign(push)
            end = (push - dry * way) / damping
            if end * way < 0 and v != 0.0:
                stop = mass / damping * np.log((v - end) / -end)
                if stop <= left:
                    left, v = left - stop, 0.0
                    continue
            v, left = end + (v - end) * np.exp(-damping * left / mass), 0.0
        speeds[k + 1] = v
    return speeds


def record(
    seed: int, *, dry: float = 0.0, late: int = 0, pulse: float = 0.0, limit: float = np.inf, then: float | None = None,
    leaning: float = 0.0, **more
) -> Record:  # fmt: skip
    """A recording of the slide: dry friction [N], a delay [samples], a hidden force [N] from 7 to 8 s, a limit.

    then : dry friction from the middle on. leaning : a further force [N] from there on.
    """
    time, force = pushes(seed, **more)
    acting = np.clip(np.concatenate([np.full(late, force[0]), force[: len(force) - late]]), -limit, limit)
    acting = acting + pulse * ((time >= 7.0) & (time < 8.0)) + leaning * (time >= 0.5 * time[-1])
    friction = np.where(time < 0.5 * time[-1], dry, dry if then is None else then)
    speed = slid(acting, friction) + NOISE * np.random.default_rng(1000 + seed).standard_normal(len(time))
    return Record(time, {"force": force, "speed": speed}, {"force": "N", "speed": "m/s"}, f"run_{seed}")


def records(count: int = 3, first: int = 0, **more) -> list[Record]:
    """Several of them."""
    return [record(first + k, **more) for k in range(count)]


def drive_records(
    count: int = 3, first: int = 0, seconds: float = 12.0, command=None, other=None, highest: float = 5.0
) -> list[Record]:
    """Recordings of a drive with k = 10 rad/(s.V), T = 0.3 s; ``command`` maps the wanted to the acting voltage.

    highest : of the commands, V.
    """
    runs = []
    for seed in range(first, first + count):
        time, u = pushes(seed, seconds, highest)
        acting, w, decay = (command(u) if command else u), np.zeros(len(u)), np.exp(-PERIOD / 0.3)
        for k in range(len(u) - 1):
            w[k + 1] = decay * w[k] + (1 - decay) * 10.0 * acting[k]
        noise = RATE_NOISE * np.random.default_rng(2000 + seed).standard_normal((2, len(u)))
        signals = {"command": u, "rate": w + noise[0]} | ({"other": other(w, time) + noise[1]} if other else {})
        units = {"command": "V", "rate": "rad/s", "other": "rad/s"}
        runs.append(Record(time, signals, {name: units[name] for name in signals}, f"drive_{seed}"))
    return runs


def started(effect: str):
    """The slide with an effect added: its flat model, free parameters, and the effect's first parameter."""
    (candidate,) = candidates(slide(), [effect])
    return slide().plus([candidate.addition]).flat, ("mass.mass", "mass.damping", *candidate.free), candidate.free[0]


def slide() -> Model:
    """The model of the slide, its parameters 25 to 30 % off."""
    return Model(Slide())


def question(runs: list[Record], model: Model | None = None, noise: dict[str, float] | None = None) -> Question:
    """What is fitted to these recordings, the noise known."""
    known = noise or ({"rate": RATE_NOISE} if model else {"speed": NOISE})
    data = split((model or slide()).flat, runs, [], noise=known)
    return Question(data.train, data.noise, step=STEP)


def fitted(asked: Question, effect: str | None = None, **more) -> Fitted | str:
    """The slide, with an effect or without, fitted to whole recordings."""
    flat, free, _ = started(effect) if effect else (slide().flat, tuple(START), "")
    return fit(Job(flat, free, asked, **more))


# -- a search --------------------------------------------------------------------------------------------------------
def begun(runs, effects, model=None, effort="normal", most=3, until=np.inf, validate=(), **more) -> Search:
    """The search alone, its jobs done at once in this thread; ``more`` as in `discover`."""
    noise = more.get("noise", {"speed": NOISE})
    plain = {"free": None, "exclude": (), "initial_states": "auto", "outputs": None, "interpolation": None, **more}
    wanted = Wanted(runs, validate, effects=effects, step=STEP, **{**plain, "noise": noise})
    asked = inside(model or slide(), wanted)
    told = [o.name in (noise or {}) for o in asked.model.flat.outputs]

    def run(function, jobs, stage):
        return [function(job) for job in jobs]

    return Search(asked.table(STEP, told), run, EFFORTS[effort], most, until)


def tried(search: Search, *entries) -> None:
    """Look at structures and fit them."""
    search._look(entries)
    search._fit(entries)


def searched(runs, effects, time_limit: float | None = None, **more) -> tuple[Search, Standing]:
    """The same when it has come to its end, and what it says."""
    until = np.inf if time_limit is None else clock.monotonic() + time_limit
    search = begun(runs, effects, until=until, **more)
    search.go()
    return search, standing(search.table)


def found(runs, effects, executor=None, model=None, **more):
    """What is missing in the slide, looked for in this thread unless told otherwise."""
    return discover(model or slide(), runs, effects=effects, executor=executor or Inline(), step=STEP, **more)


class Inline:
    """An executor that does the work at once, here."""

    def submit(self, function, *words):
        done = Future()
        try:
            done.set_result(function(*words))
        except BaseException as error:
            done.set_exception(error)
        return done
