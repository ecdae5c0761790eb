"""Cases of the hidden-effect benchmark: enumerable by name, deterministic, made when needed.

for case in cases("tuning", machines=("cehA",)):
    made = make(case)          # records, truth, the gap; Unreachable where the effect cannot make it
    discover(made.model, made.fit, validate=made.held_out)
"""

from __future__ import annotations

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
from .severity import COARSE, FINE, FIT, HELD_OUT, Meter, Unreachable, bed, scaled

GRIDS = ("tuning", "fresh")
KINDS = ("single", "none", "out_of_library", "pairs")
SECONDS = 40.0


@cache
def grid() -> Mapping:
    """The data file."""
    return tomllib.loads(Path(__file__).with_name("grid.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Case:
    """What is hidden, how large, and what is recorded. ``effects``: rig ids, in the order of a name."""

    machine: str
    kind: str
    effects: tuple[str, ...]
    severity: float
    sensors: str
    excitation: str
    seed: int
    seconds: float = SECONDS

    @property
    def name(self) -> str:
        """``machine/kind/effects/severity/sensors/excitation/seed``; shorter recordings say so."""
        hidden = "+".join(self.effects) or "nothing"
        words = [self.machine, self.kind, hidden, f"{self.severity:g}", self.sensors, self.excitation, str(self.seed)]
        return "/".join(words + ([] if self.seconds == SECONDS else [f"{self.seconds:g}s"]))

    @classmethod
    def from_name(cls, name: str) -> Case:
        """The case of that name."""
        machine, kind, hidden, severity, sensors, excitation, seed, *rest = name.split("/")
        effects = () if hidden == "nothing" else tuple(hidden.split("+"))
        seconds = float(rest[0].rstrip("s")) if rest else SECONDS
        return cls(machine, kind, effects, float(severity), sensors, excitation, int(seed), seconds)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Recorded outputs."""
        own = grid()["machines"][self.machine]
        kept = {"position": own["position"], "position+pressures": own["position"] + own["pressures"]}
        return tuple(kept.get(self.sensors, rig.MACHINES[self.machine].outputs))

    @property
    def settings(self) -> dict[str, float]:
        """Values that truth and model share and that differ from the usual ones."""
        found = {}
        for effect in self.effects:
            found |= grid()["settings"].get(self.machine, {}).get(effect, {})
        return found


@dataclass(frozen=True, eq=False)
class Made:
    """A case with its recordings.

    truth : true base parameters that differ from the model's. hidden : (effect, options) as the rig got them.
    gap, visible : over the noise, see `benchmarks.gap.severity`; ``shares``: the gap of each effect alone.
    noise : true standard deviation by recorded output.
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
    def model(self):
        """The base model as the workflow gets it: nominal values, but the settings that everybody knows."""
        import hydrotwin

        model = hydrotwin.load(self.case.machine)
        return model.with_parameters(self.case.settings) if self.case.settings else model


def make(case: Case) -> Made:
    """Record a case. Raises Unreachable when the effect cannot be of that severity inside its plausible limits."""
    own = grid()["machines"][case.machine]
    settings = tuple(sorted(case.settings.items()))
    key = (case.machine, case.seed, case.excitation, grid()["off"], tuple(own["free"]), settings, case.seconds)
    meter, random = Meter(key, case.outputs), np.random.default_rng(_number(case.name))
    hidden, shares = [], []
    for effect in case.effects:
        facts = meter.facts(random.choice([-1.0, 1.0]), str(random.choice(case.outputs)))
        options, _, gap = scaled(meter, effect, case.severity, facts)
        hidden.append((effect, options))
        shares.append(gap)
    step = FINE if STIFF & set(case.effects) else COARSE
    gap, visible = (meter.gap(hidden, step=step), meter.visible(hidden, step=step)) if hidden else (0.0, 0.0)
    records = [_recorded(case, key, i, hidden) for i in range(FIT + HELD_OUT)]
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


def _recorded(case, key, index, hidden) -> Record:
    here, m = bed(*key), rig.MACHINES[case.machine]
    time, command = here.commands[index]
    sigmas = {n: s for n, s in rig.sensor_noise(case.machine).items() if n in case.outputs}
    parameters = {**here.settings, **here.truth}
    seed = _number(f"{case.name}/{index}")
    try:
        columns = rig.record(
            case.machine, command, time, parameters=parameters, effects=hidden, noise=sigmas, seed=seed
        )
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
    """Every rig effect of the catalogue that this machine can have."""
    return tuple(
        name for name in AMPLITUDES if _fits(machine, name) and name not in grid()["out_of_library"]["effects"]
    )


def _fits(machine, name):
    return machine in rig.EFFECTS[name].machines and name not in left_out(machine)


def left_out(machine: str) -> dict[str, str]:
    """Rig effects that are no case of this machine, and why."""
    everywhere = {name: why for name, why in grid()["left_out"].items() if isinstance(why, str)}
    return {**everywhere, **grid()["left_out"].get(machine, {})}


def cases(
    which: str,
    *,
    machines: Sequence[str] = tuple(rig.MACHINES),
    kinds: Sequence[str] = KINDS,
    severities: Sequence[float] | None = None,
) -> list[Case]:
    """The cases of a grid ("tuning" or "fresh") in an order whose every beginning is a fair sample.

    For each effect and severity the seeds go through the sensor sets; the excitation is drawn.
    """
    chosen = tuple(severities or grid()["severities"])
    found = [c for m in machines for kind in kinds for c in _of_kind(which, m, kind, chosen)]
    return sorted(found, key=lambda case: _number(case.name))


def _of_kind(which, machine, kind, severities) -> Iterator[Case]:
    seeds = grid()["seeds"][which][kind]
    for effects in _hidden_sets(machine, kind):
        for severity in severities if kind != "none" else (0.0,):
            yield from _of_cell(machine, kind, effects, severity, seeds)


def _hidden_sets(machine, kind):
    if kind == "none":
        return [()]
    if kind == "pairs":
        return [tuple(pair) for pair in grid()["machines"][machine]["pairs"]]
    if kind == "single":
        return [(name,) for name in single_effects(machine)]
    return [(name,) for name in grid()["out_of_library"]["effects"] if _fits(machine, name)]


def _of_cell(machine, kind, effects, severity, seeds):
    sensors, excitations = grid()["sensors"], grid()["excitations"]
    first = _number(f"{machine}/{kind}/{effects}/{severity}")
    for k, seed in enumerate(seeds):
        for sensor_set in sensors if kind == "none" else [sensors[(first + k) % len(sensors)]]:
            random = np.random.default_rng([first, seed, _number(sensor_set)])
            yield Case(machine, kind, effects, severity, sensor_set, str(random.choice(excitations)), seed)
