"""What a machine of the rig is: names, defaults, spans, and how it stands still."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

GRAVITY = 9.80665
NEUTRAL = {  # C fields whose absence is not zero
    "stribeck_velocity": 0.0,
    "ripple_length": 0.05,
    "bristle_velocity": 1e-3,
    "air_exponent": 1.3,
    "rod_mass": 2.0,
    "warming_time": 60.0,
    "slip_speed": 100.0,
    "lost_speed": 50.0,
    "supply_volume": 1e-3,
}


@dataclass(frozen=True)
class RigMachine:
    """One machine as the rig sees it."""

    name: str
    input: str
    input_unit: str
    outputs: tuple[str, ...]
    units: tuple[str, ...]  # SI
    file_units: tuple[str, ...]
    noise: tuple[float, ...]  # realistic sensor noise, SI
    parameters: Mapping[str, float]
    fields: Mapping[str, str]  # parameter path -> C field
    start_output: str
    start_value: float
    command_limit: float
    position: str  # the output a drive command is shaped with
    span: tuple[float, float]  # where `drive` keeps it
    path_band: tuple[float, float]  # its frequencies [Hz]
    fastest: float  # speed at the command limit [m/s]
    speed_per_command: tuple[float, float]  # out and in, default values
    start_state: Callable
    start_pressure: str  # the parameter that is the pressure it starts from
    full_scale: tuple[float, ...]  # of the converters of its sensors, SI
    positioned: bool = False  # the input is a wanted position, not what makes a speed


def table(rows: str) -> tuple[dict[str, float], dict[str, str]]:
    entries = [line.split() for line in rows.strip().splitlines()]
    return {path: float(value) for path, value, _ in entries}, {path: field for path, _, field in entries}
