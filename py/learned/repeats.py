"""Do the commands of what was held out repeat commands that were trained on, and where do they begin anew?

    d(k) = sum_i |u_held[i] - u[k + i]|^2 / sum_i |u_held[i] - mean u_held|^2,    least over all places k of training

On a periodic recording every part is like every other: a block that has learnt one period by heart is as good on the
next, and what was held out tells nothing of other commands. The end of the first period does, when no other is trained
on. EMPS are four periods of one motion: at its end a network errs by 0.8 mm and ARX by 5.0 mm; at commands of the first
period that neither was trained on, by 11 and 3.0 mm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.records import Record

from .held_out import ENDS, Split, split

SAME = 0.05  # of the variance of a part's inputs: what is nearer to training is no other command. EMPS, four periods of
# one motion, is at 1e-4; recordings of the tanks, the bench, the C-EHA and the valve are at 0.4 and above
OTHER = 0.5  # of that variance: commands that are so far apart are others; 2 where one knows nothing of the other


def repeats(split: Split, inputs: Sequence[str]) -> bool:
    """Whether every part held out repeats the inputs of some stretch that was trained on."""
    names = [n for n in inputs if any(np.ptp(r[n]) > 0 for r in split.fit)]
    if not names or not split.parts:
        return False
    trained = [r.array(names) for r in split.fit]
    centre, spread = (of(np.concatenate(trained), axis=0) for of in (np.mean, np.std))
    trained = [(u - centre) / spread for u in trained]
    return all(_apart((r.array(names) - centre) / spread, trained) < SAME for r in split.held_out)


def _apart(held: np.ndarray, trained: Sequence[np.ndarray]) -> float:
    """The least d(k) over the stretches of ``trained`` (n, nu); infinite where none is long enough or nothing moves."""
    from scipy.signal import fftconvolve  # takes most of a second, and most blocks are not learnt here

    m, moved = len(held), float(((held - held.mean(axis=0)) ** 2).sum())
    found = [np.inf]
    for u in (u for u in trained if len(u) >= m and moved > 0):
        both = sum(fftconvolve(u[:, j], held[::-1, j], "valid") for j in range(u.shape[1]))
        own = np.cumsum(np.concatenate([[0.0], (u**2).sum(axis=1)]))
        found.append(float((own[m:] - own[:-m] + (held**2).sum() - 2 * both).min()) / moved)
    return min(found)


def without_repeats(records: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]) -> list[Record]:
    """The recordings up to where their commands begin anew, without those whose commands another one has.

    As they are where what would be held out of them does not repeat, or where of what is left nothing else could be.
    """
    records = list(records)
    if not repeats(split(records, inputs, outputs), inputs):
        return records
    centre, spread = (of(np.concatenate([r.array(list(inputs)) for r in records]), axis=0) for of in (np.mean, np.std))
    kept: list[tuple[Record, np.ndarray]] = []
    for record in records:
        u = (record.array(list(inputs)) - centre) / np.where(spread > 0, spread, 1.0)
        n = _period(u) or len(u)
        if _apart(u[:n], [known for _, known in kept]) >= SAME:
            kept.append((record.window(None, float(record.time[n - 1])) if n < len(u) else record, u))
    first = [record for record, _ in kept]
    left = split(first, inputs, outputs)
    return first if left.parts and not repeats(left, inputs) else records


def _period(u: np.ndarray) -> int:
    """After how many samples (n, nu) inputs begin anew and repeat what they did to their end; 0: never.

    A smooth input is like itself a moment later: they must have been `OTHER` in between.
    """
    from scipy.signal import fftconvolve

    n, u = len(u), u - u.mean(axis=0)
    both = sum(fftconvolve(column, column[::-1])[n - 1 :] for column in u.T)
    own = np.cumsum(np.concatenate([[0.0], (u**2).sum(axis=1)]))
    lags = np.arange(n - max(int(ENDS[0] * n), 2))
    late = own[n] - own[lags]
    apart = (late + own[n - lags] - 2 * both[lags]) / np.maximum(late, 1e-300)
    others = np.flatnonzero(apart > OTHER)
    again = others[0] + np.flatnonzero(apart[others[0] :] < SAME) if len(others) else np.array([], dtype=int)
    if not len(again):
        return 0
    dip = again[: np.argmax(np.diff(again, append=np.inf) > 1) + 1]
    return int(dip[np.argmin(apart[dip])])
