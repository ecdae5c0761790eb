"""Comparison: every kind of model on the same recordings, scored alike."""

from .comparison import (
    FREE_RUN,
    MEAN,
    MODES,
    ONE_STEP,
    Comparison,
    DomainShare,
    Entrant,
    Failure,
    Score,
    Timing,
    Trajectory,
    Unscored,
)
from .contender import BlockContender, Contender, HoldLast, PhysicalContender, as_contender
from .metrics import Errors, errors_of
from .residual import Residual, explain
from .run import compare
from .scenario import ModelEntry, Scenario, load_contenders, read_scenario, run_scenario

__all__ = [
    "FREE_RUN",
    "MEAN",
    "MODES",
    "ONE_STEP",
    "BlockContender",
    "Comparison",
    "Contender",
    "DomainShare",
    "Entrant",
    "Errors",
    "Failure",
    "HoldLast",
    "ModelEntry",
    "PhysicalContender",
    "Residual",
    "Scenario",
    "Score",
    "Timing",
    "Trajectory",
    "Unscored",
    "as_contender",
    "compare",
    "errors_of",
    "explain",
    "load_contenders",
    "read_scenario",
    "run_scenario",
]
