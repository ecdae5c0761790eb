"""Identification: the parameters of a physical model from recordings, how sure they are, what cannot be told."""

from .bands import Spread, deviations
from .beginning import StartEstimate, StartState, estimate_start
from .constant_speed import FrictionFit, fit_stribeck, friction_test, stribeck
from .fit import Finding, Fit, FittedParameter, OutputResidual, RecordFit
from .identify import identify
from .influence import Interval, Measurement, Profile, Profiles, Sensitivity, profile, sensitivity

__all__ = [
    "Finding",
    "Fit",
    "FittedParameter",
    "FrictionFit",
    "Interval",
    "Measurement",
    "OutputResidual",
    "Profile",
    "Profiles",
    "RecordFit",
    "Sensitivity",
    "Spread",
    "StartEstimate",
    "StartState",
    "deviations",
    "estimate_start",
    "fit_stribeck",
    "friction_test",
    "identify",
    "profile",
    "sensitivity",
    "stribeck",
]
