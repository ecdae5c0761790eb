"""Where a limit or a stop begins: at levels that what is seen of its place just exceeds, or exceeds now and then.

A limit that nothing reaches changes nothing, to first order either: no fit leads on from there. One that is exceeded
most of the time may be so far from what was recorded that none leads back.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

DEPTHS = (0.01, 0.1, 0.3)  # of the range of what is seen: so far below its highest, however seldom that is
SHARES = (0.03, 0.1, 0.25)  # of the time in which more than that is seen
DEEPER = 1.5  # times as deep as the level before: what is nearer to it is the same level


def exceeded(values, depths: Iterable[float] = DEPTHS, shares: Iterable[float] = SHARES) -> list[float]:
    """Levels that ``values`` (n,) exceed, the one that is exceeded least first; none where they do not change."""
    seen = np.asarray(values, float)
    highest, span = np.max(seen), np.ptp(seen)
    if not span > 0:
        return []
    levels = [*(highest - d * span for d in depths), *np.quantile(seen, [1 - share for share in shares])]
    found: list[float] = []
    for level in sorted(map(float, levels), reverse=True):
        if highest - level > DEEPER * (highest - found[-1] if found else 0.0):
            found.append(level)
    return found


def fallen_below(values, *settings) -> list[float]:
    """Levels that ``values`` (n,) fall below, the one that they do least first."""
    return [-level for level in exceeded(-np.asarray(values, float), *settings)]
