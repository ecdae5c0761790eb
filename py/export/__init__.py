"""Export: write FMUs that run without Python, read anybody's FMU as a contender, check an FMU."""

from .check import Check, CheckRow, check_fmu
from .reader import FmuBlock, StartValueWarning, read_fmu
from .reference import reference_experiment, reference_run
from .replay import Replay
from .ssp import SystemArchive, SystemPart, export_ssp
from .writer import export_fmu

__all__ = [
    "Check",
    "CheckRow",
    "FmuBlock",
    "Replay",
    "StartValueWarning",
    "SystemArchive",
    "SystemPart",
    "check_fmu",
    "export_fmu",
    "export_ssp",
    "read_fmu",
    "reference_experiment",
    "reference_run",
]
