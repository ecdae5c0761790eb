"""What was read of a recording, in a few numbers: whether another run read the same file as this one did."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from hydrotwin.records import Record

SAME = 1e-9  # relative: numbers of the same samples on another processor or with another numpy differ by less
TIME = "time"  # no signal is called so


def as_read(record: Record) -> dict[str, dict[str, float]]:
    """Of the time axis and every signal how many samples are known, their mean and their rms, SI."""
    return {name: _told(values) for name, values in ({TIME: record.time} | dict(record.signals)).items()}


def read_otherwise(record: Record, then: Mapping[str, Mapping], names: Iterable[str]) -> tuple[str, ...]:
    """Of ``names`` and the time axis those that both have and that are not as they were told ``then``."""
    now = {TIME: record.time} | dict(record.signals)
    return tuple(n for n in (TIME, *names) if n in now and n in then and not _same(_told(now[n]), then[n]))


def _told(values: np.ndarray) -> dict[str, float]:
    known = values[np.isfinite(values)]
    size = float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
    return {"known": len(known), "mean": float(known.mean()) if len(known) else 0.0, "rms": size}


def _same(now: Mapping[str, float], then: Mapping) -> bool:
    room = SAME * now["rms"]
    return now["known"] == then["known"] and all(abs(now[k] - float(then[k])) <= room for k in ("mean", "rms"))
