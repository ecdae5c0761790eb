"""Means over recordings of which one has far fewer known samples than another: they count alike, and tell it."""

from __future__ import annotations

from collections.abc import Mapping

UNEVEN = 5.0  # times: the error of the smaller is then more than twice as uncertain, by 1 / sqrt(samples)


def uneven(samples: Mapping[str, int]) -> str:
    """In words that some recordings have far fewer samples; "" where they are alike. samples : by recording.

    >>> uneven({"a": 400, "b": 30, "c": 380})
    'b with 30 samples counts in the mean as much as a with 400'
    >>> uneven({"a": 400, "b": 200})
    ''
    """
    if len(samples) < 2:
        return ""
    most, least = max(samples, key=samples.__getitem__), min(samples, key=samples.__getitem__)
    few = [name for name, count in samples.items() if count * UNEVEN < samples[most]]
    if not few:
        return ""
    others = f" (and {len(few) - 1} more)" if len(few) > 1 else ""
    return f"{least}{others} with {samples[least]} samples counts in the mean as much as {most} with {samples[most]}"
