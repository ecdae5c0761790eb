"""Identification: the parameters of a physical model from recordings, how sure they are, what cannot be told."""

from .fit import Finding, Fit, FittedParameter, OutputResidual, RecordFit
from .identify import identify

__all__ = ["Finding", "Fit", "FittedParameter", "OutputResidual", "RecordFit", "identify"]
