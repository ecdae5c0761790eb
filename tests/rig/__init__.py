"""The truth rig: an independent simulator of five machines, with effects the models do not know."""

from __future__ import annotations

from . import commands
from .closed_loop import record_closed_loop, tracking
from .effects import EFFECTS, effect_of
from .excitation import clean_recordings, drive
from .files import file_units, read_csv, write_csv
from .friction import friction_test
from .further import FURTHER
from .machines import MACHINES, machine_of, sensor_noise
from .recording import record

__all__ = [
    "EFFECTS",
    "FURTHER",
    "MACHINES",
    "clean_recordings",
    "commands",
    "drive",
    "effect_of",
    "file_units",
    "friction_test",
    "machine_of",
    "read_csv",
    "record",
    "record_closed_loop",
    "sensor_noise",
    "tracking",
    "write_csv",
]
