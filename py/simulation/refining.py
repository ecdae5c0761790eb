"""Refinement of rough steps for the virtual machine, as ``driver.c`` does it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .control import DEEPEST, SMOOTH, Control

Trial = Callable[[float, float, tuple], tuple]


class Dear(Exception):
    """Explicit steps have become dearer than implicit ones."""


def is_rough(roughness, x, control: Control, nominal) -> np.ndarray:
    """Which steps (m,) from states ``x`` (m, nx) are to be refined; not a number is rough."""
    ratio = (roughness / (nominal + np.abs(x)) ** 2).sum(axis=1)
    return ~(ratio < (SMOOTH * control.tolerance) ** 2)


def refine(trial: Trial, t: float, h: float, z: tuple, control: Control, units: tuple, left: float):
    """What moves, z = (x, ...), after the step [t, t + h], and what is left of the trials.

    trial : ``(t, h, z) -> z``; units : of what moves. Where not even the shortest step is finite, x is not.

    Raises Dear when no trial is left.
    """
    everything = part = 1 << DEEPEST
    done = 0
    while done < everything:
        start, half = t + h * (done / everything), 0.5 * h * (part / everything)
        left -= 3
        if left < 0:
            raise Dear
        whole = trial(start, 2 * half, z)
        halves = trial(start + half, half, trial(start, half, z))
        if part > 1 and not _agree(whole, halves, control, units):
            part //= 2
            continue
        z = halves
        if not np.isfinite(z[0]).all():
            break
        done += part
        if part < everything and done % (2 * part) == 0:
            part *= 2
    return z, left


def _agree(whole: tuple, halves: tuple, control: Control, units: tuple) -> bool:
    parts = zip(whole, halves, units, strict=False)
    apart = sum((((w - d) / (unit + np.abs(d))) ** 2).sum() for w, d, unit in parts)
    return bool(apart <= control.tolerance**2)
