"""What the recordings cannot say: parameters without effect, and parameters that only show together.

    J = U S V^T with unit columns: a small singular value is a direction in which parameters trade places unseen.

The next step comes from the outputs that were not recorded: the one that such a trade moves most would separate them.
It must not see them as parallel as the recorded ones do, and more of it than a sensor's noise, whatever its unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.flat import FlatModel

from .fit import Finding
from .problem import FreeParameters
from .uncertainty import LEAST_SIGHT

INVISIBLE = 1.0  # a change of its own size that moves the recordings by less than one sigma in all has no effect
VAGUE = 0.2  # a direction known worse than this (relative to the start) ...
PARALLEL = 0.05  # ... and with a singular value below this is a trade, not just a weak effect
MEMBER = 0.2
FAR = 3.0  # times what the worst training recording leaves: a validation recording that leaves more is told
REVEALING = 1e-3  # of what the parameter that moves an output most does: what a sensor of it must see at least


def identifiability(
    flat: FlatModel, free: FreeParameters, information: np.ndarray, unrecorded: dict[str, np.ndarray],
    held: np.ndarray,
) -> list[Finding]:  # fmt: skip
    """Findings from J^T J in scaled parameters (np, np).

    ``unrecorded`` maps each output without a recording to the mean of dy dy^T over the samples, SI (np, np); ``held``
    marks parameters at a bound. Changes count in the size of each parameter, see `FreeParameters.sizes`.
    """
    own = np.outer(free.sizes, free.sizes)
    information, unrecorded = information * own, {name: G * own for name, G in unrecorded.items()}
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    invisible = size < INVISIBLE
    findings = [_no_effect(free, j, size[j], unrecorded) for j in np.flatnonzero(invisible)]
    seen = np.flatnonzero(~invisible & ~held)
    if len(seen) < 2:
        return findings
    unit = information[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
    values, vectors = np.linalg.eigh(unit)
    for value, vector in zip(values, vectors.T, strict=True):
        singular = np.sqrt(max(value, 1e-16))
        step = vector / size[seen] / singular
        known = value > LEAST_SIGHT and np.abs(step).max() < VAGUE
        if singular > PARALLEL or known:
            continue
        members = np.flatnonzero(np.abs(vector) > MEMBER * np.abs(vector).max())
        if len(members) < 2:
            continue
        direction = np.zeros(len(free.names))
        direction[seen] = step / np.abs(step).max()
        findings.append(_confused(free, seen[members], unit[np.ix_(members, members)], direction, unrecorded))
    return findings


def _no_effect(free: FreeParameters, j: int, size: float, unrecorded: dict[str, np.ndarray]) -> Finding:
    name = free.names[j]
    direction = np.zeros(len(next(iter(unrecorded.values()))) if unrecorded else j + 1)
    direction[j] = 1.0
    change = "100 %" if free.sizes[j] == 1 else f"{free.nominal[j]:g} {free.units[j]}".removesuffix(" 1")
    how = "none at all" if size == 0 else f"a change of {change} moves them by {size:.2g} noise sigmas in all"
    step = f"Fix it{_or_record(direction, unrecorded)}"
    sentence = f"identify: {name} has no effect on any recorded output ({how}). {step}."
    return Finding("no_effect", (name,), sentence)


def _confused(free, members, unit, direction, unrecorded) -> Finding:
    names = tuple(free.names[j] for j in members)
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    if len(names) == 2:
        how, fix = f"correlation {-unit[0, 1]:.4f}", "Fix one"
    else:
        parts = " ".join(f"{100 * direction[j]:+.0f} %" for j in members)
        how, fix = f"changing them together by {parts} changes no output", "Fix one of them"
    step = f"{fix}{_or_record(direction, unrecorded)}"
    sentence = f"identify: {listed} cannot be told apart in these recordings ({how}). {step}."
    return Finding("indistinguishable", names, sentence)


def _or_record(direction: np.ndarray, unrecorded: dict[str, np.ndarray]) -> str:
    shown = {name: _shown(direction, G) for name, G in unrecorded.items()}
    best = max(shown, key=shown.get, default=None)
    return f", or record {best}" if best is not None and shown[best] > REVEALING**2 else ""


def _shown(direction: np.ndarray, G: np.ndarray) -> float:
    """Square of what a trade moves an output, over that of the parameter that moves it most; 0 where it is parallel."""
    moved, each = float(direction @ G @ direction), np.diag(G)
    apart = moved > PARALLEL**2 * float(each @ direction**2)
    return moved / each.max() if apart and each.max() > 0 else 0.0


def bounds_reached(names: Sequence[str], values, lower, upper, units, at_bound) -> list[Finding]:
    """One sentence per parameter that rests on a bound."""
    findings = []
    for name, value, low, high, unit, hit in zip(names, values, lower, upper, units, at_bound, strict=True):
        if hit:
            lowest = value - low <= high - value
            side, bound, wish = ("lower", low, "less") if lowest else ("upper", high, "more")
            shown = f"{bound:g}" if unit == "1" else f"{bound:g} {unit}"
            findings.append(Finding("at_bound", (name,), (
                f"identify: {name} rests on its {side} bound ({shown}). The recordings ask for {wish}. "
                "Widen the bound if physics allows, or look for an effect the model lacks."
            )))  # fmt: skip
    return findings


def unexplained(residuals: Sequence) -> list[Finding]:
    """One sentence per output whose training residual is more than noise, or which is left at far more elsewhere."""
    findings = []
    for output in dict.fromkeys(r.output for r in residuals):
        rows = [r for r in residuals if r.output == output and r.role == "train"]
        if not rows or all(r.explained for r in rows):
            continue
        worst = max(rows, key=lambda r: r.chi2_per_sample)
        colour = "" if worst.white else f", neighbours correlate by {worst.lag_one:.2f}"
        findings.append(Finding("unexplained", (), (
            f"identify: the fitted model leaves {np.sqrt(worst.chi2_per_sample):.2f} times the noise on {output} in "
            f"{worst.record}{colour}. The parameters cannot explain it. Look for a missing effect, or free more."
        )))  # fmt: skip
    return [*findings, *not_borne_out(residuals)]


def not_borne_out(residuals: Sequence) -> list[Finding]:
    """One sentence per output of which a validation recording leaves far more than any that was fitted to."""
    findings = []
    for output in dict.fromkeys(r.output for r in residuals):
        trained, judged = (
            max((r for r in residuals if (r.output, r.role) == (output, role)), key=_times, default=None)
            for role in ("train", "validate")
        )
        if trained and judged and _times(judged) > FAR * max(1.0, _times(trained)):
            findings.append(Finding("not_borne_out", (), (
                f"identify: {judged.record}, which took no part, leaves {_times(judged):.3g} times the noise on "
                f"{output}; the training recordings leave {_times(trained):.3g} at most. What was fitted does not hold "
                "there. Look whether its start, its inputs or its machine are others (hydrotwin inspect), or what is "
                "missing."
            )))  # fmt: skip
    return findings


def _times(residual) -> float:
    """RMSE over the noise."""
    return float(np.sqrt(residual.chi2_per_sample))
