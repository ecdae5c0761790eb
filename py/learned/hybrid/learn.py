"""Learn what an identified model lacks: a network on the residual of its free runs, joined to it as one Block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, noise_floor
from hydrotwin.simulation import prepare, simulate

from ..network.learn import train_network
from ..training_data import RESOLUTION, check_excitation, choose_period, on_period, usable
from .block import HybridBlock, hybrid_outputs, join, residual_signal, sampled_model, simulated_signal

STILL = 1e-9  # of its size: a simulated output that moves less tells the residual nothing


def learn_hybrid(
    model,
    records: Sequence[Record],
    outputs: Sequence[str] | None = None,
    *,
    period: float | None = None,
    validate: Sequence[Record] = (),
    features: Sequence[str] | None = None,
    method: str = "auto",
    lags: tuple[int, int | None] = (1, 2),
    name: str = "hybrid",
    **training,
) -> HybridBlock:
    """Run an identified model over the recordings and learn what it leaves of its outputs.

    The residual is a network (`train_network`, judged by its free run) whose inputs are the model's inputs and its
    simulated outputs; model and residual together are one Block (see `hybrid`).

    Args:
        model: an identified Model or FlatModel.
        records: training recordings with the model's inputs and outputs, without gaps.
        outputs: names of the outputs to correct; None: all that are in every recording.
        period: s between steps; None: the longest at which neither the recordings (`choose_period`) nor the runs of the
            model lose anything worth having.
        validate: recordings that select the network; without them the last fifth of every recording does.
        features: simulated outputs that the residual may depend on; None: all that move.
        method: "explicit", "rosenbrock" (for a stiff model, see `lower`), or "auto": what `simulate` takes.
        lags: past increments of the residual, samples of the inputs.
        training: seed, starts, hidden, effort, budget and progress of `train_network`.

    ``provenance["errors"]`` holds, by output, the RMS error of the free runs (SI) of the model and of the hybrid on
    ``validate``, or on the training recordings when there are none.

    Raises:
        DataError: too few samples, NaN, gaps, a model that leaves nothing. DeclarationError: unknown outputs or
        options, or PyTorch is not installed. Diverged: a run of the model that leaves the finite numbers.
    """
    flat = getattr(model, "flat", model)
    records, validate = list(records), list(validate)
    if not records:
        raise DataError("learn_hybrid: no recordings (got an empty list). Give at least one Record.")
    known = [*records, *validate]
    chosen = hybrid_outputs(flat, outputs, lambda n: all(n in r for r in known))
    starting = {s.measured_by for s in flat.states}
    kept = [s for s in flat.outputs if s in chosen or (s.name in starting and all(s.name in r for r in known))]
    records, validate = (usable(part, (*flat.inputs, *kept)) if part else [] for part in (records, validate))
    check_excitation(records, chosen)
    period = float(period or _period(model, records, chosen))
    way = _method(flat, records[0]) if method == "auto" else {"method": method, "substep": None}
    physical = sampled_model(model, period, **way)
    fit, judge = ([_lacking(physical, r, chosen, period) for r in part] for part in (records, validate))
    seen = [*flat.inputs, *(simulated_signal(s) for s in _moving(flat, fit, features))]
    _check_lacking(flat, fit, chosen)
    residual = train_network(
        fit,
        seen,
        [residual_signal(s) for s in chosen],
        period=period,
        validate=judge,
        lags=lags,
        name=f"{name}_residual",
        **{"commands": [s.name for s in flat.inputs], **training},
    )
    hybrid = join(model, residual, name=name, started_by=[s.name for s in kept], **way)
    provenance = {
        "kind": "hybrid",
        "model": flat.name,
        **{key: residual.provenance[key] for key in ("trained_on", "selected_on", "seed", "stopped", "versions")},
        **{key: residual.provenance[key] for key in ("integration", "drift", "rest") if key in residual.provenance},
        "errors": _errors(physical, hybrid, [on_period(r, period, flat.inputs) for r in validate or records], chosen),
    }
    return replace(hybrid, provenance=provenance)


def _method(flat, record: Record) -> dict:
    """The method and the step that `simulate` settles on for this model."""
    settled = prepare(flat)
    u, p = record.array([s.name for s in flat.inputs]), flat.parameter_vector()
    settled.run(record.time, u, p, flat.start_given(())(u[0], p, []).full().ravel())
    return {"method": "rosenbrock" if settled.method == "rosenbrock" else "explicit", "substep": settled.step}


def _period(model, records: Sequence[Record], chosen: Sequence[Signal]) -> float:
    """The longest period [s] at which the model, its inputs held that long, runs as it does on the recording."""
    recorded, period = max(r.period for r in records), choose_period(records)
    flat, names = getattr(model, "flat", model), [s.name for s in chosen]
    runs = [simulate(model, r).array(names) for r in records]
    floors = [noise_floor(r) for r in records]
    while period > 1.5 * recorded:
        held = [on_period(r, period, flat.inputs) for r in records]
        slow = [simulate(model, h).resample(times=r.time[r.time <= h.time[-1]]).array(names)
                for r, h in zip(records, held, strict=True)]  # fmt: skip
        lost = [np.sqrt(np.mean((a[: len(b)] - b) ** 2, axis=0)) for a, b in zip(runs, slow, strict=True)]
        allowed = [np.maximum([f[n].sigma for n in names], RESOLUTION * np.ptp(a, axis=0))
                   for f, a in zip(floors, runs, strict=True)]  # fmt: skip
        if all(np.all(x <= y) for x, y in zip(lost, allowed, strict=True)):
            return period
        period = recorded * max(1, round(period / recorded / 2))
    return period


def _lacking(physical, record: Record, chosen: Sequence[Signal], period: float) -> Record:
    """Inputs, simulated outputs and residuals at the block's samples; the provenance stays that of the recording."""
    even = on_period(record, period, physical.inputs)
    run = simulate(physical, even)
    signals = {s.name: even[s.name] for s in physical.inputs}
    units = {s.name: s.unit for s in physical.inputs}
    for s in physical.outputs:
        signals[simulated_signal(s).name], units[simulated_signal(s).name] = run[s.name], s.unit
    for s in chosen:
        signals[residual_signal(s).name], units[residual_signal(s).name] = even[s.name] - run[s.name], s.unit
    return Record(even.time, signals, units, record.name, source=record.source, digest=record.digest)


def _moving(flat, fit: Sequence[Record], features: Sequence[str] | None) -> list[Signal]:
    """The model's outputs that the residual may depend on."""
    names = [s.name for s in flat.outputs]
    unknown = [n for n in features or () if n not in names]
    if unknown:
        raise DeclarationError(f"{flat.name}: no output '{unknown[0]}'. features are among {', '.join(names)}.")
    wanted = [s for s in flat.outputs if features is None or s.name in features]
    return [s for s in wanted if _moves(fit, simulated_signal(s).name)]


def _moves(fit: Sequence[Record], name: str) -> bool:
    values = np.concatenate([r[name] for r in fit])
    return bool(np.ptp(values) > STILL * max(np.abs(values).max(), 1e-300))


def _check_lacking(flat, fit: Sequence[Record], chosen: Sequence[Signal]) -> None:
    for s in chosen:
        if not _moves(fit, residual_signal(s).name):
            raise DataError(
                f"{flat.name}: leaves nothing of '{s.name}' to learn (its residual is constant). "
                "Leave it out of the outputs to correct."
            )


def _errors(physical, hybrid, records: Sequence[Record], chosen: Sequence[Signal]) -> dict[str, dict[str, float]]:
    """RMS of the free runs by output, SI."""
    runs = [(r, simulate(physical, r), simulate(hybrid, r)) for r in records]

    def rms(name, which):
        return float(np.sqrt(np.mean(np.concatenate([(run[which][name] - run[0][name]) ** 2 for run in runs]))))

    return {s.name: {"model": rms(s.name, 1), "hybrid": rms(s.name, 2)} for s in chosen}
