"""Why a search stops before it has tried everything."""

from __future__ import annotations


class OutOfTime(Exception):
    """The time limit has come."""


class Surprised(Exception):
    """A structure explains all in short windows, whose starts are free, and not in longer runs."""


class Freed(Exception):
    """A structure has led the base out of a local minimum: what was seen beside it says little."""
