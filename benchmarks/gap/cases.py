"""Cases of the hidden-effect benchmark: enumerable by name, deterministic, made when needed.

for case in cases("tuning", machines=("cehA",)):
    made = make(case)          # records, truth, the gap; Unreachable where the effect cannot make it
    discover(made.model, made.fit, validate=made.held_out)
"""

from __future__ import annotations

import fnmatch
import tomllib
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from hydrotwin.records import Record
from tests import rig

from .amplitudes import AMPLITUDES, STIFF
from .severity import CLOSED_LOOP, COARSE, FINE, FIT, HELD_OUT, Meter, Unreachable, bed, scaled, steps_of

SEEDS = ("tuning", "fresh")
GRIDS = ("narrow", "wide", "further")
KINDS = ("single", "none", "out_of_library", "pairs")
SECONDS = 40.0
MACHINES = Path(__file__).with_name("machines")  # models of the further machines


@cache
def grid() -> Mapping:
    """The data file."""
    return tomllib.loads(Path(__file__).with_name("grid.toml").read_text(encoding="utf-8"))


def facts_of(machine: str) -> Mapping:
    """What the data file says of a machine, shipped or further."""
    return {**grid()["machines"], **grid()["further"]["machines"]}[machine]


def machines_of(which_grid: str) -> tuple[str, ...]:
    """The machines of a grid."""
    shipped, further = tuple(grid()["machines"]), tuple(grid()["further"]["machines"])
    return {"narrow": shipped, "wide": shipped + further, "further": further}[which_grid]


@dataclass(frozen=True)
class Case:
    """What is hidden, how large, and what is recorded. ``effects``: rig ids, in the order of a name.

    sensors : a set's name, or outputs joined by "+". bits : of the converters, 0 for no steps. wide : base parameters
    are as far off as in the wide grid.
    """

    machine: str
    kind: str
    effects: tuple[str, ...]
    severity: float
    sensors: str
    excitation: str
    seed: int
    seconds: float = SECONDS
    bits: int = 0
    wide: bool = False

    @property
    def name(self) -> str:
        """``machine/kind/effects/severity/sensors/excitation/seed``; then ``20s``, ``12bit``, ``wide`` where it is."""
        hidden = "+".join(self.effects) or "nothing"
        words = [self.machine, self.kind, hidden, f"{self.severity:g}", self.sensors, self.excitation, str(self.seed)]
        unusual = {f"{self.seconds:g}s": self.seconds != SECONDS, f"{self.bits}bit": self.bits, "wide": self.wide}
        return "/".join(words + [word for word, said in unusual.items() if said])

    @classmethod
    def from_name(cls, name: str) -> Case:
        """The case of that name."""
        machine, kind, hidden, severity, sensors, excitation, seed, *rest = name.split("/")
        effects = () if hidden == "nothing" else tuple(hidden.split("+"))
        bits = next((int(w.removesuffix("bit")) for w in rest if w.endswith("bit")), 0)
        seconds = next((float(w.removesuffix("s")) for w in rest if w.endswith("s")), SECONDS)
        return cls(
            machine, kind, effects, float(severity), sensors, excitation, int(seed), seconds, bits, "wide" in rest
        )

    @property
    def outputs(self) -> tuple[str, ...]:
        """Recorded outputs."""
        own, every = facts_of(self.machine), rig.machine_of(self.machine).outputs
        kept = {"all": every, "position": own["position"], "position+pressures": own["position"] + own["pressures"]}
        return tuple(kept.get(self.sensors) or self.sensors.split("+"))

    @property
    def settings(self) -> dict[str, float]:
        """Values that truth and model share and that differ from the usual ones."""
        found = {}
        for effect in self.effects:
            found |= grid()["settings"].get(self.machine, {}).get(effect, {})
        return found

    @property
    def bed_key(self) -> tuple:
        """What `benchmarks.gap.severity.bed` makes truth and commands of."""
        free = tuple((name, _off(name, self.wide)) for name in facts_of(self.machine)["free"])
        return (self.machine, self.seed, self.excitation, free, tuple(sorted(self.settings.items())), self.seconds)


def _off(parameter: str, wide: bool) -> float:
    """How far off a base parameter lies at most."""
    if not wide:
        return grid()["off"]
    return next(off for pattern, off in grid()["wide"]["off"] if fnmatch.fnmatch(parameter, pattern))


@dataclass(frozen=True, eq=False)
class Made:
    """A case with its recordings.

    truth : true base parameters that differ from the model's. hidden : (effect, options) as the rig got them.
    gap, visible : over the noise, see `benchmarks.gap.severity`; ``shares``: the gap of each effect alone.
    noise : true standard deviation by recorded output, that of converters included.
    """

    case: Case
    fit: tuple[Record, ...]
    held_out: tuple[Record, ...]
    truth: Mapping[str, float]
    hidden: tuple[tuple[str, Mapping], ...]
    gap: float
    visible: float
    shares: tuple[float, ...]
    noise: Mapping[str, float]

    @property
    def spec(self) -> str:
        """The base model as `hydrotwin.load` takes it."""
        file = facts_of(self.case.machine).get("model")
        return str(MACHINES / file) if file else self.case.machine

    @property
    def model(self):
        """The base model as the workflow gets it: nominal values, but the settings that everybody knows."""
        import hydrotwin

        model = hydrotwin.load(self.spec)
        return model.with_parameters(self.case.settings) if self.case.settings else model


def make(case: Case) -> Made:
    """Record a case. Raises Unreachable when the effect cannot be of that severity inside its plausible limits."""
    meter, random = Meter(case.bed_key, case.outputs, case.bits), np.random.default_rng(_number(case.name))
    hidden, shares = [], []
    for effect in case.effects:
        facts = meter.facts(random.choice([-1.0, 1.0]), str(random.choice(case.outputs)))
        options, _, gap = scaled(meter, effect, case.severity, facts)
        hidden.append((effect, options))
        shares.append(gap)
    step = FINE if STIFF & set(case.effects) else COARSE
    gap, visible = (meter.gap(hidden, step=step), meter.visible(hidden, step=step)) if hidden else (0.0, 0.0)
    records = [_recorded(case, i, hidden) for i in range(FIT + HELD_OUT)]
    return Made(
        case=case,
        fit=tuple(records[:FIT]),
        held_out=tuple(records[FIT:]),
        truth=dict(meter.bed.truth),
        hidden=tuple(hidden),
        gap=gap,
        visible=visible,
        shares=tuple(shares),
        noise=meter.noise,
    )


def _recorded(case, index, hidden) -> Record:
    m = rig.machine_of(case.machine)
    sigmas = {n: s for n, s in rig.sensor_noise(case.machine).items() if n in case.outputs}
    seed, steps = _number(f"{case.name}/{index}"), steps_of(case.machine, case.bits)
    try:
        columns = bed(*case.bed_key).recorded(hidden, index, noise=sigmas, quantisation=steps, seed=seed)
    except RuntimeError as lost:
        raise Unreachable(f"{'+'.join(case.effects)} drives the machine out of its span ({lost})") from None
    units = {**dict(zip(m.outputs, m.units, strict=True)), m.input: m.input_unit}
    signals = {n: columns[n] for n in (m.input, *case.outputs)}
    name = f"fit_{index + 1}" if index < FIT else f"held_out_{index - FIT + 1}"
    return Record(columns["time"], signals, {n: units[n] for n in signals}, name)


def _number(text: str) -> int:
    """A number that a text always gives."""
    return zlib.crc32(text.encode())


def single_effects(machine: str) -> tuple[str, ...]:
    """Every rig effect of the catalogue that is hidden in this machine."""
    own = facts_of(machine).get("effects")
    outside = grid()["out_of_library"]["effects"]
    return tuple(own or (name for name in AMPLITUDES if _fits(machine, name) and name not in outside))


def _fits(machine, name):
    return rig.effect_of(machine, name) is not None and name not in left_out(machine)


def left_out(machine: str) -> dict[str, str]:
    """Rig effects that are no case of this machine, and why."""
    everywhere = {name: why for name, why in grid()["left_out"].items() if isinstance(why, str)}
    return {**everywhere, **grid()["left_out"].get(machine, {})}


def cases(
    which: str,
    *,
    which_grid: str = "narrow",
    machines: Sequence[str] | None = None,
    kinds: Sequence[str] = KINDS,
    severities: Sequence[float] | None = None,
) -> list[Case]:
    """The cases of a grid, for the seeds "tuning" or "fresh", in an order whose every beginning is a fair sample.

    "narrow" : for each effect and severity the seeds go through the sensor sets; the excitation is drawn.
    "wide" : sensors down to one, styles of command, lengths, bits of converters are drawn, on all five machines.
    "further" : the machines that hydrotwin does not ship, as in the narrow grid.
    """
    own = grid() if which_grid == "narrow" else grid()[which_grid]
    chosen = tuple(severities or own["severities"])
    found = [
        case
        for machine in machines or machines_of(which_grid)
        for kind in kinds
        for cell in _cells(machine, kind, chosen)
        for case in _of_cell(cell, own["seeds"][which].get(kind, ()), which_grid)
    ]
    return sorted(found, key=lambda case: _number(case.name))


def _cells(machine, kind, severities) -> Iterator[tuple]:
    """(machine, kind, effects, severity) of everything that may be hidden."""
    for effects in _hidden_sets(machine, kind):
        for severity in severities if kind != "none" else (0.0,):
            yield machine, kind, effects, severity


def _hidden_sets(machine, kind):
    if kind == "none":
        return [()]
    if kind == "pairs":
        return [tuple(pair) for pair in facts_of(machine).get("pairs", ())]
    if kind == "single":
        return [(name,) for name in single_effects(machine)]
    if machine not in grid()["machines"]:
        return []
    return [(name,) for name in grid()["out_of_library"]["effects"] if _fits(machine, name)]


def _of_cell(cell, seeds, which_grid) -> Iterator[Case]:
    machine, kind, effects, severity = cell
    first = _number(f"{machine}/{kind}/{effects}/{severity}")
    if which_grid == "wide":
        yield from (_drawn(cell, seed, np.random.default_rng([first, seed])) for seed in seeds)
        return
    sensors = grid()["sensors"]
    excitations = grid()["excitations"] if which_grid == "narrow" else grid()["further"]["excitations"]
    for k, seed in enumerate(seeds):
        for sensor_set in sensors if kind == "none" else [sensors[(first + k) % len(sensors)]]:
            random = np.random.default_rng([first, seed, _number(sensor_set)])
            yield Case(machine, kind, effects, severity, sensor_set, str(random.choice(excitations)), seed)


def _drawn(cell, seed, random) -> Case:
    """A case of the wide grid."""
    machine, _, effects, _ = cell
    wide = grid()["wide"]
    open_loop = rig.machine_of(machine).positioned or "packet_loss" in effects  # no loop around these
    styles = [style for style in wide["excitations"] if not (open_loop and style == CLOSED_LOOP)]
    sensors, style = (str(random.choice(choices)) for choices in (wide["sensors"][machine], styles))
    lengths = [s for s in wide["seconds"] if s <= wide["longest"].get(style, s)]
    seconds, bits = (random.choice(choices) for choices in (lengths, wide["bits"]))
    return Case(*cell, sensors, style, seed, float(seconds), int(bits), wide=True)
