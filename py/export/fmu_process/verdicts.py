"""The four words of a verdict."""

from __future__ import annotations

PASS, FAIL, REMARK, NOT_TRIED = "pass", "FAIL", "remark", "not tried"
"""As it should be; a required rule is broken; worth knowing, and no rule; the detail says why it could not be tried."""
GOOD = (PASS, REMARK)


class NotTried(Exception):
    """There is nothing to try here, or no way to; the words say why."""
