"""Recent: the last answers to questions that are arrays."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable

import numpy as np

MOST = 1_000_000  # numbers: 8 MB


class Recent:
    """The answers, tuples of arrays that nobody may write to, that were asked for last; safe in several threads."""

    def __init__(self):
        self._answers: OrderedDict[bytes, tuple[np.ndarray, ...]] = OrderedDict()
        self._size, self._changing = 0, threading.Lock()

    def answer(self, work: Callable[..., tuple[np.ndarray, ...]], *asked) -> tuple[np.ndarray, ...]:
        """What ``work`` gives, or gave before, of the same contiguous arrays, numbers and words.

        What is not finite is not kept: a run that was given up may be asked for under other limits.
        """
        key, answers = _digest(asked), self._answers
        found = answers.get(key)
        found = work(*asked) if found is None else found
        if not all(np.isfinite(part).all() for part in found):
            return found
        with self._changing:
            self._size += _size(found) - _size(answers.pop(key, ()))
            answers[key] = found
            while len(answers) > 1 and self._size > MOST:
                self._size -= _size(answers.popitem(last=False)[1])
        return found


def _size(arrays: tuple[np.ndarray, ...]) -> int:
    return sum(a.size for a in arrays)


def _digest(asked) -> bytes:
    told = hashlib.blake2b(digest_size=16)
    for one in asked:
        told.update(repr((one.shape, one.dtype.str) if isinstance(one, np.ndarray) else one).encode())
        if isinstance(one, np.ndarray):
            told.update(memoryview(one.reshape(-1)).cast("B"))
    return told.digest()
