"""Simulation: lower a model to C, compile it once, run it, with sensitivities to parameters and start states."""

from .block import Block, TrainingDomain
from .closed_loop import close_loop
from .lowering import lower
from .propagator import Propagator, prepare
from .simulate import InaccurateWarning, predict_one_step, simulate
from .stops import Diverged

__all__ = [
    "Block",
    "Diverged",
    "InaccurateWarning",
    "Propagator",
    "TrainingDomain",
    "close_loop",
    "lower",
    "predict_one_step",
    "prepare",
    "simulate",
]
