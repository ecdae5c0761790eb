"""Record: named signals with units on one time axis; read, write, resample, filter, check, noise floor."""

from .files import read_record, write_record
from .filters import one_euro, savitzky_golay
from .noise import NoiseFloor, noise_floor
from .record import Gap, Record, distinct
from .require import as_needed, known_inputs, require
from .resampling import steps_over
from .scale import Scale, parse_scale

__all__ = [
    "Gap",
    "NoiseFloor",
    "Record",
    "Scale",
    "as_needed",
    "distinct",
    "known_inputs",
    "noise_floor",
    "one_euro",
    "parse_scale",
    "read_record",
    "require",
    "savitzky_golay",
    "steps_over",
    "write_record",
]
