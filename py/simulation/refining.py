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


def refine(trial: Trial, t: float, h: float, z: tuple, control: Control, units: tuple, left: list, judged: int = 1):
    """What moves, z = (x, ...), after the step [t, t + h], in parts as long as the first ``judged`` of it allow.

    trial : ``(t, h, z) -> z``; units : of what moves; left : trials for states, for sensitivities, counted down. Where
    not even the shortest step is finite, x is not.

    Raises Dear when no trial is left.
    """
    everything = part = 1 << DEEPEST
    done = 0
    while done < everything:
        start, half = t + h * (done / everything), 0.5 * h * (part / everything)
        left[judged - 1] -= 3
        if left[judged - 1] < 0:
            raise Dear
        whole = trial(start, 2 * half, z)
        halves = trial(start + half, half, trial(start, half, z))
        if part > 1 and not _agree(whole[:judged], halves, control, units):
            part //= 2
            continue
        if not np.isfinite(halves[0]).all():
            return halves
        if len(z) > judged and not _agree(whole, halves, control, units):
            z = halves[0], refine(trial, start, 2 * half, z, control, units, left, len(z))[1]
        else:
            z = halves
        done += part
        if part < everything and done % (2 * part) == 0:
            part *= 2
    return z


def _agree(whole: tuple, halves: tuple, control: Control, units: tuple) -> bool:
    parts = zip(whole, halves, units, strict=False)
    apart = sum((((w - d) / (unit + np.abs(d))) ** 2).sum() for w, d, unit in parts)
    return bool(apart <= control.tolerance**2)
