"""Comparison: every kind of model on the same recordings, scored alike."""

from .acceptance import FORMAT, Acceptance, Change, Wanted, acceptance, junit
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
from .criteria import Criterion, Judged, criterion, judge
from .domain import domain_shares
from .metrics import Errors, errors_of
from .residual import Residual, explain
from .run import compare
from .scenario import ModelEntry, Scenario, load_contenders, read_scenario, run_scenario
from .starts import Started
from .tags import Tags

__all__ = [
    "FORMAT",
    "FREE_RUN",
    "MEAN",
    "MODES",
    "ONE_STEP",
    "Acceptance",
    "BlockContender",
    "Change",
    "Comparison",
    "Contender",
    "Criterion",
    "DomainShare",
    "Entrant",
    "Errors",
    "Failure",
    "HoldLast",
    "Judged",
    "ModelEntry",
    "PhysicalContender",
    "Residual",
    "Scenario",
    "Score",
    "Started",
    "Tags",
    "Timing",
    "Trajectory",
    "Unscored",
    "Wanted",
    "acceptance",
    "as_contender",
    "compare",
    "criterion",
    "domain_shares",
    "errors_of",
    "explain",
    "judge",
    "junit",
    "load_contenders",
    "read_scenario",
    "run_scenario",
]
