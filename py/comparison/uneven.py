"""Means over recordings of which one has far fewer known samples than another: they count alike, and tell it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

UNEVEN = 5.0  # times: the error of the smaller is then more than twice as uncertain, by 1 / sqrt(samples)


@dataclass(frozen=True)
class Uneven:
    """The recording with the fewest samples of a mean and that with the most, by name and count; few : how many have
    far fewer."""

    least: tuple[str, int]
    most: tuple[str, int]
    few: int

    @property
    def briefly(self) -> str:
        """For a row of a table."""
        return f"a mean over recordings of {self.least[1]} to {self.most[1]} samples"

    def __str__(self) -> str:
        """In words."""
        (name, count), (other, most) = self.least, self.most
        others = f" (and {self.few - 1} more)" if self.few > 1 else ""
        return f"{name}{others} with {count} samples counts in the mean as much as {other} with {most}"


def uneven(samples: Mapping[str, int]) -> Uneven | None:
    """What to tell of a mean over recordings of so many samples, by name; None where they are alike.

    >>> str(uneven({"a": 400, "b": 30, "c": 380}))
    'b with 30 samples counts in the mean as much as a with 400'
    >>> uneven({"a": 400, "b": 30}).briefly, uneven({"a": 400, "b": 200})
    ('a mean over recordings of 30 to 400 samples', None)
    """
    if len(samples) < 2:
        return None
    most, least = max(samples, key=samples.__getitem__), min(samples, key=samples.__getitem__)
    few = sum(count * UNEVEN < samples[most] for count in samples.values())
    return Uneven((least, samples[least]), (most, samples[most]), few) if few else None
