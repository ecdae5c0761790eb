"""Influence: which parameters drive which output where, how far each can be told, what to measure next."""

from .answer import FORMAT, Sensitivity, StudiedRecord
from .intervals import Interval
from .measurements import Measurement
from .profile import profile
from .profiles import Profile, Profiles
from .study import sensitivity

__all__ = [
    "FORMAT",
    "Interval",
    "Measurement",
    "Profile",
    "Profiles",
    "Sensitivity",
    "StudiedRecord",
    "profile",
    "sensitivity",
]
