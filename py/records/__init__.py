"""Record: named signals with units on one time axis; read, write, resample, filter, check, noise floor."""

from .files import SUFFIXES, WRITTEN, read_record, write_record
from .filters import one_euro, savitzky_golay
from .marks import follows, row_of
from .noise import NoiseFloor, noise_floor
from .reading import Reading, import_from, import_text, reading_of
from .record import EXACT, Gap, Record, Whole, distinct, gaps_of, tidy
from .require import (
    as_needed,
    copies,
    known_inputs,
    require,
    require_once,
    require_unseen,
    shares_samples,
    without_unknown,
)
from .resampling import CLOCKS, NEAR, steps_over
from .scale import Scale, parse_scale
from .turning import turned_back
from .unbroken import all_unbroken, cuts, joined, unbroken

__all__ = [
    "CLOCKS",
    "EXACT",
    "NEAR",
    "SUFFIXES",
    "WRITTEN",
    "Gap",
    "NoiseFloor",
    "Reading",
    "Record",
    "Scale",
    "Whole",
    "all_unbroken",
    "as_needed",
    "copies",
    "cuts",
    "distinct",
    "follows",
    "gaps_of",
    "import_from",
    "import_text",
    "joined",
    "known_inputs",
    "noise_floor",
    "one_euro",
    "parse_scale",
    "read_record",
    "reading_of",
    "require",
    "require_once",
    "require_unseen",
    "row_of",
    "savitzky_golay",
    "shares_samples",
    "steps_over",
    "tidy",
    "turned_back",
    "unbroken",
    "without_unknown",
    "write_record",
]
