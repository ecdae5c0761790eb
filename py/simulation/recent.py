"""Recent: the last answers to questions that are arrays."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable

import numpy as np

MOST = 1_000_000  # numbers: 8 MB


class Recent:
    """The answers, tuples of arrays that nobody may write to, that were asked for last; safe in several threads."""

    def __init__(self):
        self._answers: OrderedDict[bytes, tuple[np.ndarray, ...]] = OrderedDict()

    def answer(self, work: Callable[..., tuple[np.ndarray, ...]], *asked) -> tuple[np.ndarray, ...]:
        """What ``work`` gives, or gave before, of the same contiguous arrays, numbers and words."""
        key, answers = _digest(asked), self._answers
        found = answers.pop(key, None)
        found = work(*asked) if found is None else found
        answers[key] = found
        while len(answers) > 1 and sum(a.size for kept in list(answers.values()) for a in kept) > MOST:
            answers.popitem(last=False)
        return found


def _digest(asked) -> bytes:
    told = hashlib.blake2b(digest_size=16)
    for one in asked:
        told.update(repr((one.shape, one.dtype.str) if isinstance(one, np.ndarray) else one).encode())
        if isinstance(one, np.ndarray):
            told.update(memoryview(one.reshape(-1)).cast("B"))
    return told.digest()
