"""From a minimum to a Fit: uncertainty, residuals, findings, provenance."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.provenance import IDENTIFIED
from hydrotwin.records.whiteness import SIGNIFICANCE, ljung_box
from hydrotwin.simulation.control import Accuracy

from .descent import Task, held_out_run, undecided, whole_runs
from .ending import doubts
from .fit import SIZE, Finding, Fit, FittedParameter, OutputResidual, RecordFit
from .identifiability import bounds_reached, identifiability, unexplained
from .least_squares import Minimum
from .noise import solver_error
from .problem import FreeParameters, Recording
from .rounded_inputs import may_be_rounded, moved_by_rounding, noise_of_rounding
from .shooting import Shooting
from .uncertainty import Errors, correlation, uncertainty, without_starts
from .valley import TROUBLE, margin

ROUNDED, WITHIN = 0.55, 0.99  # of a step, and of the samples: how far rounding takes so many
MOSTLY, SCATTER = 0.7, 2.0  # of the noise: rounded inputs that make so much of it may leave so much: they are few
RULED = 3.0  # times the noise left somewhere: then weights by noise are worth a word


def answer(task: Task, minima: Sequence[Minimum], judged: Sequence[Recording], settings: Mapping, began: float) -> Fit:
    """Everything a Fit knows, from the minima of the training runs, the lowest first."""
    free, flat, best = task.free, task.flat, minima[0]
    values = free.values(best.q)
    at_bound = at_bounds(free, best)
    shooting, _ = whole_runs(task)
    rows, lost = differentiated(task, shooting, best)
    doubted = doubts(task, best, at_bound)
    *weighted, errors = weighted_rows(rows, shooting)
    moved = moved_by_rounding(task, best, rows)
    rounded = noise_of_rounding(task, rows, moved)
    if not may_be_rounded(task, best, rounded):
        moved = []
    known = uncertainty(*weighted, at_bound, Errors(errors, moved))
    if moved:
        task = dataclasses.replace(task, noise=np.hypot(task.noise, rounded), rounded=rounded)
    rows = [row for row in rows if row is not None]
    slope = free.slope(best.q)
    sandwich, white = (C * np.outer(slope, slope) for C in (known.sandwich, known.white))
    sandwich, ambiguous = _widened(sandwich, free, minima)
    if doubted:  # a number that means nothing is not told
        sandwich, white, ambiguous = np.full_like(sandwich, np.nan), np.full_like(white, np.nan), []
    parameters = _fitted(free, values, at_bound, sandwich, white)
    records, residuals, findings = _judged(task, shooting, best, judged)
    accuracy = _accuracy(shooting, best)
    findings = [
        *lost,
        *_inaccurate(accuracy, task),
        *doubted,
        *([] if doubted else identifiability(flat, free, known.information, _unrecorded(task, rows, slope), at_bound)),
        *ambiguous,
        *([] if ambiguous else _rough(best)),
        *_weighing(task, residuals),
        *bounds_reached(free.names, values, free.lower, free.upper, free.units, at_bound),
        *findings,
    ]
    starts = shooting.locals * len(shooting.segments)
    return Fit(
        name=flat.name,
        flat=_with_results(task, parameters),
        parameters=parameters,
        covariance=sandwich,
        covariance_white=white,
        correlation=correlation(white),
        noise={s.name: float(n) for s, n in zip(flat.outputs, task.noise, strict=True) if np.isfinite(n)},
        cost=best.cost,
        chi2=float(sum(r.samples * r.chi2_per_sample for r in residuals if r.role == "train")),
        degrees_of_freedom=sum(len(r) for r, _, _ in rows) - int((~at_bound).sum()) - starts,
        records=records,
        residuals=residuals,
        allowed={s.name: 1 / float(w) for s, w in zip(flat.outputs, task.weights, strict=True) if w > 0},
        findings=tuple(findings),
        history=tuple(task.history),
        converged=best.converged and not doubted,
        message="no minimum was found" if doubted else best.message,
        seconds=time.perf_counter() - began,
        settings=dict(settings),
        accuracy=accuracy,
    )


def _accuracy(shooting: Shooting, best: Minimum) -> Accuracy | None:
    """That of the training run which is least accurate; those that diverge are told elsewhere."""
    found = []
    for i in range(0 if shooting.propagator.flat.black_box else len(shooting.segments)):
        with contextlib.suppress(SolveError):
            found.append(shooting.accuracy(i, best.q, best.z[i]))
    return max(found, key=lambda one: one.error, default=None)


def _inaccurate(accuracy: Accuracy | None, task: Task) -> list[Finding]:
    """What to know of runs that miss the accuracy, or whose error the sensors would see."""
    if accuracy is None:
        return []
    noise = {s.name: n for s, n in zip(task.flat.outputs, task.noise, strict=True) if np.isfinite(n)}
    seen = [name for name, n in noise.items() if accuracy.apart[name] > n]
    if accuracy.reached and not seen:
        return []
    listed = ", ".join(f"{name} by {accuracy.apart[name]:.2g}, its noise is {noise[name]:.2g}" for name in seen)
    seen_by = f" The sensors see it: half the step changes {listed} (SI)." if seen else ""
    return [Finding("accuracy", (), (
        f"identify: the runs are {accuracy}.{seen_by} The fit follows errors of the solver; give a smaller step."
    ))]  # fmt: skip


def differentiated(task: Task, shooting: Shooting, best: Minimum) -> tuple[list, list[Finding]]:
    """`sensitivities` of every training run at a minimum, None and told where they are lost.

    Near stiffness explicit steps may carry a run and lose its derivatives, which the implicit method keeps.

    Raises SolveError when all are lost.
    """
    rows = [shooting.sensitivities(i, best.q, best.z[i]) for i in range(len(shooting.segments))]
    if any(row is None for row in rows) and not task.flat.black_box and task.propagator.method == "explicit":
        implicit, _ = whole_runs(undecided(task, "implicit"))
        rows = [row or implicit.sensitivities(i, best.q, best.z[i]) for i, row in enumerate(rows)]
    lost = [recording.name for recording, row in zip(task.recordings, rows, strict=True) if row is None]
    if len(lost) == len(rows):
        raise SolveError(
            f"identify: every training run of {task.flat.name} diverges at the fitted parameters, or its derivatives "
            "do. Start elsewhere, or free fewer parameters."
        )
    told = [Finding("diverged", (), (
        f"identify: the free run over {name}, or its derivatives, diverge at the fitted parameters. The sigmas do not "
        "count this recording. Something is missing in the model, or the start was too far off."
    )) for name in lost]  # fmt: skip
    return rows, told


def explains(task: Task, found: Minimum) -> bool:
    """Nothing is left but noise on any output of any training recording, and none of them diverges."""
    shooting, _ = whole_runs(undecided(task))
    left = [shooting.residuals(i, found.q, found.z[i]) for i in range(len(task.recordings))]
    if not found.converged or any(r is None for r in left):
        return False
    rows = zip(task.recordings, left, strict=True)
    return all(row.explained for recording, r in rows for row in _output_residuals(task, r, recording, "train"))


def _widened(covariance: np.ndarray, free: FreeParameters, minima: Sequence[Minimum]):
    """A covariance that reaches the other minima which explain the recordings as well, and a finding that names them.

    As well: within the 99 % region of the likelihood. On a smooth cost a minimum higher by d would be sqrt(2 d) sigmas
    away; half of that is taken, for the hollows tried are a sample and a lower one may lie beside.
    """
    best = minima[0]
    others = [m for m in minima[1:] if m.cost - best.cost < margin(len(free.names))]
    if not others:
        return covariance, []
    sigma = np.sqrt(np.diag(covariance))
    values = free.values(best.q)
    apart_by = [np.abs(free.values(m.q) - values) / max(1.0, np.sqrt((m.cost - best.cost) / 2)) for m in others]
    spread = np.max(apart_by, axis=0)
    apart = spread > 1.5 * sigma
    if not apart.any():
        return covariance, []
    grown = np.where(np.isfinite(sigma) & (sigma > 0), np.hypot(1.0, spread / np.where(sigma > 0, sigma, 1.0)), 1.0)
    names = tuple(n for n, far in zip(free.names, apart, strict=True) if far)
    rows = zip(free.names, spread, free.units, apart, strict=True)
    reach = ", ".join(f"{name} by {by:.2g} {unit}" for name, by, unit, far in rows if far)
    sentence = (
        f"identify: {len(others) + 1} different minima explain the recordings equally well ({reach}). The sigmas are "
        "widened to reach them. Record another output, or excite faster."
    )
    return covariance * np.outer(grown, grown), [Finding("ambiguous", names, sentence)]


def _rough(best: Minimum) -> list[Finding]:
    """A warning when the free runs settled so slowly that the cost must have many small valleys."""
    if best.iterations < TROUBLE:
        return []
    sentence = (
        f"identify: the free runs settled slowly (got {best.iterations} iterations). The cost has many small valleys "
        "here, and the sigmas describe the one that was reached. Record another output, or free fewer parameters."
    )
    return [Finding("rough", (), sentence)]


def _weighing(task: Task, residuals: Sequence[OutputResidual]) -> list[Finding]:
    """What the weights were when not the noise, and what they could be when the best sensors rule alone."""
    used = np.flatnonzero(task.weights > 0)
    factor = {task.flat.outputs[j].name: 1 / (task.weights[j] * task.noise[j]) for j in used}
    wide = {name: f for name, f in factor.items() if f > 1.001}
    if wide:
        listed = ", ".join(f"{name} {f:.3g} x" for name, f in wide.items())
        return [Finding("weights", (), (
            f"identify: weighed by what is left of each output, not by its noise ({listed}), because the model cannot "
            "reach the noise. The sigmas allow for that much. weights='noise' follows the best sensors instead."
        ))]  # fmt: skip
    left = [r.chi2_per_sample for r in residuals if r.role == "train"]
    if len(used) < 2 or max(left) < RULED**2:
        return []
    return [Finding("weights", (), (
        f"identify: up to {np.sqrt(max(left)):.3g} times the noise is left, and weighed by noise the best sensors rule "
        "the fit. Give noise={...} as what may be left of each output, or take weights='residual'."
    ))]  # fmt: skip


def at_bounds(free: FreeParameters, best: Minimum) -> np.ndarray:
    """On a bound, with the cost still falling beyond it."""
    lower, upper = free.scaled(free.lower), free.scaled(free.upper)
    gradient = best.at.gradient[:, : len(best.q)].sum(axis=0)
    return ((best.q - lower <= 1e-9) & (gradient > 0)) | ((upper - best.q <= 1e-9) & (gradient < 0))


def weighted_rows(rows, shooting: Shooting):
    """Residuals, projected Jacobians, sample numbers, error of the runs per recording, under the loss."""
    residuals, jacobians, samples, errors = [], [], [], []
    error = np.nan_to_num(solver_error(shooting.recordings)) * shooting.weights
    for row, segment in zip(rows, shooting.segments, strict=True):
        if row is None:
            continue
        r, J = shooting.loss.linearised(*row[:2])
        measured = np.isfinite(shooting.recordings[segment.recording].y) & (shooting.weights > 0)
        residuals.append(r)
        jacobians.append(without_starts(J, len(shooting.free.names)))
        sample, output = np.nonzero(measured)
        samples.append(sample)
        errors.append(error[output])
    return residuals, jacobians, samples, errors


def _fitted(free: FreeParameters, values, at_bound, sandwich, white) -> tuple[FittedParameter, ...]:
    sigma, sigma_white = np.sqrt(np.diag(sandwich)), np.sqrt(np.diag(white))
    return tuple(
        FittedParameter(
            name, float(values[j]), float(free.start[j]), float(sigma[j]), free.units[j],
            (float(free.lower[j]), float(free.upper[j])), bool(at_bound[j]), float(sigma_white[j]),
        )
        for j, name in enumerate(free.names)
    )  # fmt: skip


def _with_results(task: Task, parameters: Sequence[FittedParameter]):
    """The model with fitted values, their sigmas and where they come from."""
    fitted = {p.name: p for p in parameters}
    source = f"{IDENTIFIED} from {', '.join(r.name for r in task.recordings)}"
    names = [p.name for p in task.flat.parameters]
    given = task.flat.with_parameters(dict(zip(names, task.free.all_values, strict=True)))
    return dataclasses.replace(
        given,
        parameters=tuple(
            dataclasses.replace(
                p, value=fitted[p.name].value, source=source,
                sigma=fitted[p.name].sigma if np.isfinite(fitted[p.name].sigma) else None,
            )
            if p.name in fitted
            else p
            for p in given.parameters
        ),
    )  # fmt: skip


def _unrecorded(task: Task, rows, slope: np.ndarray) -> dict[str, np.ndarray]:
    """Mean of dy dy^T over all samples for each output without a recording, y in SI, p in q."""
    k, mean = len(task.free.names), {}
    for j, signal in enumerate(task.flat.outputs):
        if task.weights[j] > 0:
            continue
        moved = [dy[:, j, :k] * slope for _, _, dy in rows]
        mean[signal.name] = sum(m.T @ m for m in moved) / sum(len(m) for m in moved)
    return mean


def _judged(task: Task, shooting: Shooting, best: Minimum, judged: Sequence[Recording]):
    """Records, residuals and findings of training and validation runs."""
    records, residuals, findings = [], [], []
    for i, recording in enumerate(task.recordings):
        records.append(_record_fit(task, shooting, recording, "train", best.z[i]))
        left = shooting.residuals(i, best.q, best.z[i])
        residuals += [] if left is None else _output_residuals(task, left, recording, "train")
    for recording in judged:
        alone, z = held_out_run(task, best.q, recording)
        left = alone.residuals(0, best.q, z[0])
        if left is None:
            findings.append(Finding("diverged", (), (
                f"identify: the free run over {recording.name} diverges at the fitted parameters. The recording "
                "leaves the range in which the model holds. Look at its inputs."
            )))  # fmt: skip
            continue
        records.append(_record_fit(task, alone, recording, "validate", z[0]))
        residuals += _output_residuals(task, left, recording, "validate")
    findings += unexplained(residuals)
    return tuple(records), tuple(residuals), findings


def _record_fit(task: Task, shooting: Shooting, recording: Recording, role: str, z: np.ndarray) -> RecordFit:
    start = {n: float(v) for n, v in zip(shooting.start.names, z * shooting.start.nominal, strict=True)}
    return RecordFit(recording.name, role, recording.digest, len(recording.time), start, recording.row)


def _output_residuals(task: Task, weighted: np.ndarray, recording: Recording, role: str):
    rows = []
    for j, signal in enumerate(task.flat.outputs):
        r = weighted[:, j][np.isfinite(weighted[:, j])]
        if not task.weights[j] > 0 or not len(r):
            continue
        lag_one, p_value = ljung_box(r)
        rmse, noise = float(np.sqrt(np.mean(r**2)) / task.weights[j]), float(task.noise[j])
        step = float(recording.steps[j])
        rounded = task.rounded is not None and np.hypot(task.rounded[j], step / np.sqrt(12)) > MOSTLY * noise
        rounding = (rounded and rmse < SCATTER * noise) or _is_rounding(r / task.weights[j], noise, step)
        rows.append(OutputResidual(
            recording.name, signal.name, role, rmse, noise, signal.unit, len(r), (rmse / noise) ** 2, lag_one, p_value,
            p_value > SIGNIFICANCE, bool(rounding),
        ))  # fmt: skip
    return rows


def _is_rounding(left: np.ndarray, noise: float, step: float) -> bool:
    """Whether rounding to a step makes most of the noise, and may make residuals (n,): neither are they independent."""
    other = noise**2 - step**2 / 12
    if not other < step**2 / 12:
        return False
    within = np.mean(np.abs(left) <= ROUNDED * step + 3 * np.sqrt(max(other, 0.0))) > WITHIN
    return bool(within or np.mean(left**2) < SIZE * noise**2)
