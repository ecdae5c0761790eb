"""Simulation: lower a model to C, compile it once, run it, with sensitivities to parameters and start states."""

from .block import Block, TrainingDomain
from .propagator import Diverged, Propagator, prepare

__all__ = ["Block", "Diverged", "Propagator", "TrainingDomain", "prepare"]
