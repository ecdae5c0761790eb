"""The gap workflow: where simulation and measurement disagree, which effect is missing, and what it closes."""

from __future__ import annotations

from .discover import discover
from .discovery import Discovery

__all__ = ["Discovery", "discover"]
