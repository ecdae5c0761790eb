"""Simulation: lower a model to C, compile it once, run it, with sensitivities to parameters and start states."""

from .block import Block, TrainingDomain
from .closed_loop import close_loop
from .lowering import lower
from .many import run_many, squares_of_many
from .propagator import Propagator, prepare
from .simulate import InaccurateWarning, predict_one_step, simulate
from .simulate_many import Ensemble, simulate_many
from .stops import Diverged

__all__ = [
    "Block",
    "Diverged",
    "Ensemble",
    "InaccurateWarning",
    "Propagator",
    "TrainingDomain",
    "close_loop",
    "lower",
    "predict_one_step",
    "prepare",
    "run_many",
    "simulate",
    "simulate_many",
    "squares_of_many",
]
