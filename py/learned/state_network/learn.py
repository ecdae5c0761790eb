"""Learn a network with hidden states from recordings, judged by how well it runs free; NumPy alone trains it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..block_file import Certificate, LearnedBlock, assemble
from ..interruption import INTERRUPTED, CtrlC
from ..linear.periods import affordable_period
from ..options import check_counts, check_positive
from ..steady import steady_where_it_integrates
from ..training_data import ROOM, checked_recordings, named, on_period, training_box, usable
from .choosing import Form, Plan, Task, Trial, choose, on_everything
from .climbing import Run, Stage
from .committee import committee
from .equations import STATE_NETWORK, StateShape, network_states
from .sensitivities import Network, Sections, free_run

TOLERANCE = 1e-12  # of the outputs' scale: deployed against trained
FEWEST = 60  # samples at the network's period, over all recordings
HELD_OUT = ((0.3, 0.45), (0.85, 1.0))  # parts of every recording that choose and take no training
ORDERS = (1, 2, 3)  # hidden states that are tried
MEMBERS = 3  # networks that are one: five cost more and run no better
PAST = 6  # samples that the encoder looks back
SAMPLES_PER_UNIT, UNITS = 100, (2, 8)  # one tanh unit for so many samples; fewest and most
DECAYS = (1e-4, 1e-3, 1e-5)  # of the squared weights: the first for every form, the others for the best
SHARES, SHORTEST = (16, 8, 4), 16  # of the longest recording are the sections; samples of the shortest
TRIAL_SAMPLES = 8000  # simulated in one iteration of a trial
CHECKED = 5000  # random steps of the certificate


@dataclass(frozen=True)
class _Normalised:
    """Recordings at the network's period, over the scales that are written into the block."""

    arrays: dict[str, np.ndarray]
    runs: list[Run]

    @property
    def samples(self) -> int:
        """Over all recordings."""
        return sum(len(run.u) for run in self.runs)


def learn_state_network(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    period: float | None = None,
    validate: Sequence[Record] = (),
    select: Sequence[Record] = (),
    hidden_states: int | None = None,
    hidden: int | None = None,
    past: int = PAST,
    seed: int = 0,
    starts: int = 3,
    members: int = MEMBERS,
    effort: float = 1.0,
    budget: float | None = None,
    name: str = "state_nn",
    commands: Sequence[str] | None = None,
    progress: Callable | None = None,
) -> LearnedBlock:
    """Train a network with hidden states on several recordings and answer it as a Block.

    The outputs and some hidden states move at rates that are a linear part plus one layer of tanh units of all states
    and inputs (see `equations`). An encoder of the last samples starts the sections that it is trained on; a block
    starts from its first sample, taken for a machine at rest. Training is Levenberg-Marquardt on the free run (see
    `climbing`) from a linear start (see `subspace`). The number of hidden states, whether anything depends on where the
    outputs are (not so where they integrate), the decay of the weights and the seed are chosen by the free-run error on
    parts of the training recordings that are held out (`HELD_OUT`), and so is the iteration that is kept. What is
    chosen is trained some more on everything.

    Args:
        records: training recordings, uniform or not, without gaps.
        inputs, outputs: Signals, or names that take the unit of the recording.
        period: s between steps; None: the longest that loses nothing worth having and is neither too many nor too
            few samples (`affordable_period`).
        validate: checked, but nothing is selected on them. select: recordings that choose in place of parts held out;
            nothing is fitted to them.
        hidden_states: beside the outputs; None: 1 to 3 are tried.
        hidden: tanh units; None: one for every 100 samples, 2 to 8; 0 gives a linear model.
        past: samples before the first that the encoder sees.
        seed, starts: seeds ``seed ... seed + starts - 1`` are tried.
        members: of the candidates that run best, the mean of up to so many is the network (see `committee`).
        effort: scales the number of iterations. budget: s, after which the best so far is taken; None: no limit.
        commands: inputs whose standing still lets the machine rest (see `steady`); None: all of them.
        progress: called with a `Progress` after every iteration.

    The same seed and data give the same network unless the budget ends the training (``provenance["stopped"]``).
    Ctrl-C ends the training with the best network so far. ``provenance["trials"]`` holds what every candidate came to.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options.
    """
    counts = {"hidden_states": (hidden_states, 0), "hidden": (hidden, 0), "past": (past, 1), "starts": (starts, 1)}
    counts |= {"members": (members, 1)}
    check_counts("learn_state_network", counts)
    check_positive("learn_state_network", effort=effort, budget=budget, period=period)
    inputs, outputs, records, _ = checked_recordings("learn_state_network", records, inputs, outputs, validate)
    select, began = usable(select, (*inputs, *outputs)) if select else [], time.monotonic()
    period = float(period or affordable_period((records, select), inputs, outputs))
    data = _normalised((records, select), inputs, outputs, period)
    forms = _forms(data, hidden_states, hidden)
    with CtrlC() as ctrl_c:
        stop = _Stop(ctrl_c, budget, began)
        task = _task(data, past, effort, {"progress": progress, "stop": stop})
        found, trials = choose(task, forms, DECAYS, [seed + k for k in range(starts)], members)
        last = [on_everything(task, one) for one in found]
    net = committee([climb.net for climb in last])
    block = network_block(
        net,
        data.arrays,
        name=name,
        inputs=inputs,
        outputs=outputs,
        period=period,
        domain=training_box(records, (*inputs, *outputs)),
        description=_described(net.shape, found),
        provenance=_provenance((records, select), found, trials)
        | {"iterations": sum(c.iterations for c in (*last, *(one.climb for one in found)))}
        | {"stopped": stop.reason or "finished"},
    )
    return steady_where_it_integrates(block, records, outputs, commands=commands)


def network_block(net: Network, arrays: Mapping[str, np.ndarray], **frame) -> LearnedBlock:
    """A network as a block with its certificate; arrays: the scales among them, frame: other fields of the block."""
    kept = {name: arrays[name] for part in ("input", "output") for name in (f"{part}_centre", f"{part}_scale")}
    kept |= {"rate": net.rate, "state_lower": net.lower, "state_upper": net.upper} | net.parts
    states = network_states(net.shape, frame["outputs"])
    block = assemble(STATE_NETWORK, kept, net.shape.structure(), states=states, parameters=(), **frame)
    return replace(block, certificate=certify(block, net))


class _Stop:
    """Whether training shall end, and why."""

    def __init__(self, ctrl_c: CtrlC, budget: float | None, began: float):
        self.ctrl_c, self.budget, self.began, self.reason = ctrl_c, budget, began, ""

    def __call__(self) -> bool:
        if self.ctrl_c.came:
            self.reason = INTERRUPTED
        elif self.budget is not None and time.monotonic() - self.began > self.budget:
            self.reason = f"time budget of {self.budget:g} s"
        return bool(self.reason)


def certify(block: LearnedBlock, net: Network) -> Certificate:
    """The largest |deployed - trained| of one step from random states and inputs, over the outputs' scale."""
    a, shape, rng = block.arrays, net.shape, np.random.default_rng(0)
    x = rng.uniform(net.lower, net.upper, (CHECKED, shape.order))
    u = rng.uniform(-3, 3, (CHECKED, shape.inputs))
    spread = np.concatenate([a["output_scale"], np.ones(shape.hidden_states)])
    centre = np.concatenate([a["output_centre"], np.zeros(shape.hidden_states)])
    after = block.step.map(CHECKED)(
        (centre + spread * x).T, (a["input_centre"] + a["input_scale"] * u).T, np.zeros((0, CHECKED))
    )[0]
    wanted = _stepped(net, x, u)
    difference = float(np.abs((after.full().T - centre) / spread - wanted).max())
    return Certificate(difference, TOLERANCE, CHECKED, f"numpy {metadata.version('numpy')} float64")


def _stepped(net: Network, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """States one period after x (n, nx), by what trains."""
    shape, n = net.shape, len(x)
    none, ny = np.zeros((n, shape.encoder_features)), shape.outputs
    s = Sections(none, x[:, :ny], u[None], np.zeros((1, n, ny)), np.ones((1, n)))
    return free_run(net, s, x)[1, :, : shape.order]


def _normalised(both, inputs, outputs, period: float) -> _Normalised:
    """Recordings to train on, with their scales, and those that only choose."""
    records, select = ([on_period(r, period, inputs) for r in part] for part in both)
    count = sum(len(r) for r in records)
    if count < FEWEST:
        raise DataError(
            f"learn_state_network: too few samples to learn from (got {count} at {period:g} s). At least {FEWEST} are "
            "needed. Record longer or choose a shorter period."
        )
    records, select = ([r for r in part if len(r) > PAST + 2] for part in (records, select))
    u, y = ([r.array([s.name for s in part]) for r in (*records, *select)] for part in (inputs, outputs))
    arrays, n = {}, len(records)
    for part, values in (("input", np.concatenate(u[:n])), ("output", np.concatenate(y[:n]))):
        spread = values.std(axis=0)
        arrays |= {f"{part}_centre": values.mean(axis=0), f"{part}_scale": np.where(spread > 0, spread, 1.0)}
    runs = []
    for k, (given, measured) in enumerate(zip(u, y, strict=True)):
        normal = (given - arrays["input_centre"]) / arrays["input_scale"]
        used = np.full(len(given), k < n) if select else _used(len(given))
        runs.append(Run(normal, (measured - arrays["output_centre"]) / arrays["output_scale"], used))
    return _Normalised(arrays, runs)


def _used(n: int) -> np.ndarray:
    """Which samples of a recording are trained on."""
    used = np.ones(n, dtype=bool)
    for first, last in HELD_OUT:
        used[round(first * n) : round(last * n)] = False
    return used


def _forms(data: _Normalised, hidden_states: int | None, hidden: int | None) -> list[Form]:
    orders = ORDERS if hidden_states is None else (hidden_states,)
    units = hidden if hidden is not None else int(np.clip(data.samples // SAMPLES_PER_UNIT, *UNITS))
    return [Form(order, units, level_free, DECAYS[0]) for order in orders for level_free in (False, True)]


def _task(data: _Normalised, past: int, effort: float, hooks: dict) -> Task:
    bounds = np.array(bounds_of([run for run in data.runs if run.used.any()]))
    return Task(data.runs, bounds, past, plan_of(data.runs, effort), hooks)


def bounds_of(runs: Sequence[Run]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest normalised outputs (ny,) of free runs: what was seen, and room beyond it."""
    y = np.concatenate([run.y for run in runs])
    room = ROOM * np.ptp(y, axis=0)
    return y.min(axis=0) - room, y.max(axis=0) + room


def plan_of(runs: Sequence[Run], effort: float = 1.0) -> Plan:
    """Sections that grow, the longer ones together with whole recordings."""
    longest = max(len(run.u) for run in runs)
    short, middle, long = (max(longest // share, SHORTEST) for share in SHARES)

    def stage(horizon: int, iterations: int, whole: bool) -> Stage:
        return Stage(horizon, max(1, round(effort * iterations)), whole)

    return Plan(
        linear=[stage(short, 8, False), stage(middle, 10, True)],
        trial=[stage(short, 8, False), stage(middle, 15, True)],
        final=[stage(middle, 15, True), stage(long, 25, True)],
        everything=[stage(middle, 15, True)],
        trial_samples=TRIAL_SAMPLES,
    )


def _described(shape: StateShape, found: Sequence[Trial]) -> str:
    layer = f"{shape.hidden} tanh units and a linear part" if shape.hidden else "linear"
    level = ", the same at every level of the outputs" if all(one.form.level_free for one in found) else ""
    many = f", the mean of {len(found)} networks" if len(found) > 1 else ""
    return f"state-space network, {shape.hidden_states} hidden states, {layer}{level}, {shape.size} weights{many}"


def _provenance(both, found: Sequence[Trial], trials: list[dict]) -> dict:
    best, judge = found[0], found[0].climb.judge
    of_form = best.form.told().items()
    parts = " and ".join(f"{first:.0%} to {last:.0%}" for first, last in HELD_OUT)
    return {
        "kind": "state_network",
        "trained_on": named(both[0]),
        "selected_on": named(both[1]) or f"{parts} of every training recording",
        "seed": best.seed,
        **best.form.told(),
        "held_out_error": judge(committee([one.climb.best.net for one in found])),
        "members": [{**one.form.told(), "seed": one.seed, "held_out_error": one.error} for one in found],
        "trials": trials,
        "seeds": [
            {key: trial[key] for key in ("seed", "held_out_error")} for trial in trials if of_form <= trial.items()
        ],
        "versions": {package: metadata.version(package) for package in ("numpy", "casadi")},
    }
