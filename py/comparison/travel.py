"""Contenders on their way to other processes, and what runs of theirs depend on.

A contender with ``content`` (plain values, models, blocks: all that its runs depend on) can be kept and can travel; one
without runs where the comparison was asked for.
"""

from __future__ import annotations

import copy
import hashlib
import pickle
from collections import OrderedDict
from functools import cached_property

from hydrotwin.work.memory import key_of

MOST = 16  # contenders that a process keeps: unpacked once, their compiled equations serve all their recordings


class Carried:
    """A contender in a job. It is packed once, however many jobs it is in, and unpacked once in every process."""

    def __init__(self, contender):
        self.contender = contender

    @cached_property
    def content(self) -> str:
        """A hash of all that its runs depend on."""
        return key_of(type(self.contender).__name__, self.contender.name, self.contender.content)

    @cached_property
    def packed(self) -> tuple[str, bytes]:
        """Digest and bytes."""
        lean = self.contender.to_travel() if hasattr(self.contender, "to_travel") else self.contender
        data = pickle.dumps(lean)
        return hashlib.sha256(data).hexdigest(), data

    def __reduce__(self):
        return _arrived, self.packed


_here: OrderedDict[str, Carried] = OrderedDict()


def _arrived(digest: str, data: bytes) -> Carried:
    if digest not in _here:
        _here[digest] = Carried(pickle.loads(data))
        while len(_here) > MOST:
            _here.popitem(last=False)
    _here.move_to_end(digest)
    return _here[digest]


def travels(contender) -> bool:
    """Whether its runs can be made in another process and be kept."""
    return getattr(contender, "content", None) is not None


def with_changes(thing, **changes):
    """A copy of an object with other attributes."""
    other = copy.copy(thing)
    vars(other).update(changes)
    return other
