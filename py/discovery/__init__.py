"""The gap workflow: where simulation and measurement disagree, which effect is missing, and what it closes."""

from __future__ import annotations

from .answer.discovery import Discovery
from .discover import discover

__all__ = ["Discovery", "discover"]
