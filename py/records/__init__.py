"""Record: named signals with units on one time axis; read, write, resample, check, noise floor."""

from .files import read_record, write_record
from .noise import NoiseFloor, noise_floor
from .record import Gap, Record
from .require import require
from .scale import Scale, parse_scale

__all__ = [
    "Gap",
    "NoiseFloor",
    "Record",
    "Scale",
    "noise_floor",
    "parse_scale",
    "read_record",
    "require",
    "write_record",
]
