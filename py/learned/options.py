"""Checks of options that kinds share: counts, amounts, names and lags, each refused in one sentence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from numbers import Real

from hydrotwin.models.language.errors import DeclarationError, nearest

SECONDS = {"period": " Give seconds, such as 0.01.", "budget": " Give seconds, such as 60."}


def check_counts(verb: str, counts: Mapping[str, tuple[object, int]], hint: str = "") -> None:
    """Raise DeclarationError for what is no whole number, or less than the least given with it; None is chosen later.

    ``hint`` ends the sentence.
    """
    for option, (value, least) in counts.items():
        if value is not None and not (_is_whole(value) and value >= least):
            raise DeclarationError(f"{verb}: {option} must be a whole number from {least} up (got {value}).{hint}")


def check_positive(verb: str, **amounts: float | None) -> None:
    """Raise DeclarationError for what is not finite and above zero; None is chosen later."""
    for option, value in amounts.items():
        if value is not None and not (_is_finite(value) and value > 0):
            raise DeclarationError(f"{verb}: {option} must be positive (got {value}).{SECONDS.get(option, '')}")


def check_tolerance(verb: str, tolerance: float) -> None:
    """Raise DeclarationError for a share that is not finite, or below zero."""
    if not (_is_finite(tolerance) and tolerance >= 0):
        raise DeclarationError(f"{verb}: tolerance must be 0 or more (got {tolerance}). 0.05 is 5 %.")


def check_known(verb: str, option: str, value: object, known: Iterable[str]) -> None:
    """Raise DeclarationError for a name that is none of those known."""
    if value not in known:
        raise DeclarationError(f"{verb}: no {option} '{value}'. {nearest(str(value), known)}")


def check_lags(verb: str, lags: tuple[int, int] | None, past: str, example: str) -> None:
    """Raise DeclarationError for lags that are not two: how many ``past`` values, and samples of every input."""
    if lags is None:
        return
    if not isinstance(lags, (tuple, list)) or len(lags) != 2:
        raise DeclarationError(
            f"{verb}: lags are two: {past}, and samples of every input (got {lags}). Write {example}."
        )
    check_counts(verb, {"lags[0]": (lags[0], 0), "lags[1]": (lags[1], 1)})


def _is_whole(value: object) -> bool:
    return _is_finite(value) and int(value) == value


def _is_finite(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
