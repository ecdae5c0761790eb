"""The truth rig: an independent simulator of both machines, with effects the models do not know."""

from __future__ import annotations

from . import commands
from .closed_loop import record_closed_loop
from .effects import EFFECTS
from .excitation import clean_recordings, drive
from .files import file_units, read_csv, write_csv
from .friction import friction_test
from .machines import MACHINES, sensor_noise
from .recording import record

__all__ = [
    "EFFECTS",
    "MACHINES",
    "clean_recordings",
    "commands",
    "drive",
    "file_units",
    "friction_test",
    "read_csv",
    "record",
    "record_closed_loop",
    "sensor_noise",
    "write_csv",
]
