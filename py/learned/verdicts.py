"""Whether one free run is better than another, by the stretches of what was held out.

Over S stretches with the RMS errors a and b, the mean of d = log(a / b) and its standard error tell what another
recording might have shown:

    mean d + t sd(d) / sqrt(S) < 0      a is better, with a probability of 95 % or more

where t is Student's, of S - 1 degrees of freedom: of three stretches, two of which agree by chance, nothing is sure.
Which of several is chosen is another question: there the simpler one within one standard error is.
Source: Student, Biometrika 6 (1908); L. Breiman and others, Classification and Regression Trees (1984), section 3.4.3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

STRETCHES = 3  # at least: parts that are fewer are cut, for of two alone nothing tells how far they are apart by chance
NOTHING = 1e-300  # an error that is none, for its logarithm
BETTER = 0.95  # of a yardstick's error: what a block must stay under to be better
SURE = 0.95  # probability from which on a card says without a doubt that a block is better


def stretches(misses: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Misses (n,) of every part held out, in `STRETCHES` stretches or more: parts, or equal pieces of them."""
    pieces = -(-STRETCHES // max(len(misses), 1))
    return [piece for miss in misses for piece in np.array_split(miss, pieces) if len(piece)]


def rms_of(misses: Sequence[np.ndarray]) -> list[float]:
    """RMS error of every stretch."""
    return [float(np.sqrt(np.mean(piece**2))) for piece in stretches(misses)]


def log_ratio(errors: Sequence[float], rival: Sequence[float]) -> tuple[float, float]:
    """Mean of log(errors / rival) over stretches, and its standard error; infinite where one run diverges."""
    d = np.log(np.maximum(errors, NOTHING)) - np.log(np.maximum(rival, NOTHING))
    if len(d) < 2 or not np.isfinite(d).all():
        return (float(np.mean(d)) if len(d) else float("nan")), float("inf")
    return float(d.mean()), float(d.std(ddof=1) / np.sqrt(len(d)))


def surely_less(errors: Sequence[float], rival: Sequence[float]) -> bool:
    """Whether the errors are less than the rival's by more than chance over the stretches explains."""
    mean, error = log_ratio(errors, rival)
    return bool(np.isfinite(error) and mean + stdtrit(len(errors) - 1, SURE) * error < 0)


def as_good(errors: Sequence[float], best: Sequence[float]) -> bool:
    """Whether errors may be those of the best: within one standard error of the difference, and of the best's own.

    The second is that of its mean square, so that what fails in one stretch is not as good, whatever it does elsewhere.
    """
    mean, error = log_ratio(errors, best)
    return bool(mean <= error and np.mean(np.square(errors)) <= _bound(best))


def may_be_as_good(errors: Sequence[float], best: Sequence[float]) -> bool:
    """Whether that may become of errors over some of the stretches, whatever the others will be: squares add up."""
    return bool(np.sum(np.square(errors)) <= len(best) * _bound(best))


def _bound(best: Sequence[float]) -> float:
    """The mean square of the best and one standard error of it."""
    squares = np.square(best)
    return float(squares.mean() + (squares.std(ddof=1) / np.sqrt(len(squares)) if len(squares) > 1 else 0.0))
