"""The catalogue of named effects: what a model may be missing, where it fits, and how it is added."""

from .catalogue import CATALOGUE
from .effect import Candidate, Effect, Site, add_effect, candidates, check_patterns

__all__ = ["CATALOGUE", "Candidate", "Effect", "Site", "add_effect", "candidates", "check_patterns"]
