"""Recent: the same arrays, numbers and words have the same answer; the oldest answers make room."""

from __future__ import annotations

import numpy as np

from hydrotwin.simulation import recent
from hydrotwin.simulation.recent import Recent


def counting():
    asked = []
    return asked, lambda step, x: asked.append(x) or (step * x, x**2)


def test_the_same_is_worked_out_once():
    asked, work = counting()
    kept, x = Recent(), np.arange(6.0)
    first = kept.answer(work, 0.1, x)
    assert kept.answer(work, 0.1, x.copy()) is first and len(asked) == 1
    for step, other in ((0.2, x), (0.1, x + 1e-15), (0.1, x.reshape(2, 3)), (0.1, x.astype(np.float32))):
        kept.answer(work, step, other)
    assert len(asked) == 5


def test_an_array_that_was_written_to_is_another():
    asked, work = counting()
    kept, x = Recent(), np.arange(6.0)
    kept.answer(work, 0.1, x)
    x[2] = 7.0
    assert kept.answer(work, 0.1, x)[1][2] == 49.0 and len(asked) == 2


def test_the_oldest_make_room_and_the_newest_always_stays(monkeypatch):
    monkeypatch.setattr(recent, "MOST", 30)
    asked, work = counting()
    kept, xs = Recent(), [np.full(6, float(i)) for i in range(4)]
    for x in xs:
        kept.answer(work, 1.0, x)
    kept.answer(work, 1.0, xs[3])
    kept.answer(work, 1.0, xs[2])
    assert len(asked) == 4
    kept.answer(work, 1.0, xs[0])
    assert len(asked) == 5
    large = np.arange(100.0)
    kept.answer(work, 1.0, large)
    kept.answer(work, 1.0, large)
    assert len(asked) == 6


def test_what_is_kept_is_counted_as_it_comes_and_goes(monkeypatch):
    """Summed anew at every answer, twenty thousand small ones took 6 ms each."""
    monkeypatch.setattr(recent, "MOST", 50)
    kept = Recent()
    for k in (0, 1, 2, 1, 3, 4, 0, 4):
        kept.answer(lambda step, x: (x[: 2 + int(x[0])],), 1.0, np.full(20, float(k)))
        assert kept._size == sum(a.size for answer in kept._answers.values() for a in answer)
    kept.answer(lambda x: (x,), np.ones(60))
    assert kept._size == 60 and len(kept._answers) == 1
