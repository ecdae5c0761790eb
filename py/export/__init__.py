"""Export: write FMUs that run without Python, read anybody's FMU as a contender, check an FMU."""

from .writer import export_fmu

__all__ = ["export_fmu"]
