"""Comparison: every kind of model on the same recordings, scored alike."""

from .acceptance import Acceptance, Wanted, acceptance
from .again import Again, replay
from .changes import Change
from .comparison import (
    FREE_RUN,
    MEAN,
    MODES,
    ONE_STEP,
    Comparison,
    DomainShare,
    Entrant,
    Failure,
    Inaccurate,
    Score,
    Timing,
    Trajectory,
    Unscored,
)
from .contender import BlockContender, Contender, HoldLast, PhysicalContender, as_contender
from .criteria import Criterion, Judged, judge, worst
from .domain import domain_shares
from .earlier import ASIDE, FORMAT
from .evidence import asked_by, record_comparison
from .junit import junit
from .matrix import Matrix, VariantRun, run_matrix
from .meaning import criteria_of, criterion
from .metrics import Errors, errors_of
from .residual import Residual, explain
from .run import compare
from .running import Where, load_contenders, run_scenario, things_of
from .scenario import ModelEntry, Scenario, read_scenario
from .starts import Started
from .tags import Tags
from .variants import Variant

__all__ = [
    "ASIDE",
    "FORMAT",
    "FREE_RUN",
    "MEAN",
    "MODES",
    "ONE_STEP",
    "Acceptance",
    "Again",
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
    "Inaccurate",
    "Judged",
    "Matrix",
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
    "Variant",
    "VariantRun",
    "Wanted",
    "Where",
    "acceptance",
    "as_contender",
    "asked_by",
    "compare",
    "criteria_of",
    "criterion",
    "domain_shares",
    "errors_of",
    "explain",
    "judge",
    "junit",
    "load_contenders",
    "read_scenario",
    "record_comparison",
    "replay",
    "run_matrix",
    "run_scenario",
    "things_of",
    "worst",
]
