"""Influence: which parameters drive which output where, how far each can be told, what to measure next."""

from .answer import FORMAT, Sensitivity, StudiedRecord
from .intervals import Interval
from .study import sensitivity

__all__ = ["FORMAT", "Interval", "Sensitivity", "StudiedRecord", "sensitivity"]
