"""Learn what an identified model lacks: a network on the residual of its free runs, joined to it as one Block."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.provenance import made_from_rows
from hydrotwin.records import Record, noise_floor
from hydrotwin.simulation import prepare, simulate

from ..network.learn import train_network
from ..training_data import (
    HELD_OUT,
    RESOLUTION,
    check_excitation,
    choose_period,
    named,
    on_period,
    recorded_period,
    split_tail,
    training_box,
    usable,
)
from .block import HybridBlock, alone, hybrid_outputs, join, residual_signal, sampled_model, simulated_signal

HELPS = 0.9  # of the model's error on what was held out: what a residual must bring it to
TOLD = ("trained_on", "selected_on", "seed", "seeds", "stopped", "versions", "integration", "drift", "rest")
FINISHED = "finished"  # what a training that nothing cut says
LEAST = 0.01  # s, of a budget that the first training has used up
STILL = 1e-9  # of its size: a simulated output that moves less tells the residual nothing


def learn_hybrid(
    model,
    records: Sequence[Record],
    outputs: Sequence[str] | None = None,
    *,
    period: float | None = None,
    validate: Sequence[Record] = (),
    select: Sequence[Record] = (),
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
        validate: checked, and nothing else. select: recordings to choose by, which take no part in training.
        features: simulated outputs that the residual may depend on; None: all that move.
        method: "explicit", "implicit" (for a stiff model, see `lower`), or "auto": what `simulate` takes.
        lags: past increments of the residual, samples of the inputs.
        training: seed, starts, hidden, effort, budget (of both trainings) and progress of `train_network`.

    The residual is added where it helps: on ``select``, or over the last fifth of every recording, run freely from its
    beginning with a residual that was trained without that fifth. Where it does not, by `HELPS`, the answer is the
    model alone (`alone`), and ``provenance["says"]`` begins with that. ``provenance["added"]`` tells it,
    ``provenance["held_out"]`` holds both errors by output (RMS, SI), ``provenance["errors"]`` those over the training
    recordings.

    Raises:
        DataError: too few samples, NaN, gaps, a model that leaves nothing. DeclarationError: unknown outputs or
        options, or PyTorch is not installed. Diverged: a run of the model that leaves the finite numbers.
    """
    flat = getattr(model, "flat", model)
    records, validate, select = list(records), list(validate), list(select)
    if not records:
        raise DataError("learn_hybrid: no recordings (got an empty list). Give at least one Record.")
    known = [*records, *validate, *select]
    chosen = hybrid_outputs(flat, outputs, lambda n: all(n in r for r in known))
    starting = {s.measured_by for s in flat.states}
    kept = [s for s in flat.outputs if s in chosen or (s.name in starting and all(s.name in r for r in known))]
    records, _, select = (usable(part, (*flat.inputs, *kept)) if part else [] for part in (records, validate, select))
    check_excitation(records, chosen)
    period = float(period or _period(model, records, chosen))
    way = _method(flat, records[0]) if method == "auto" else {"method": method, "substep": None}
    physical = sampled_model(model, period, **way)
    fit, judge = ([_lacking(physical, r, chosen, period) for r in part] for part in (records, select))
    seen = [*flat.inputs, *(simulated_signal(s) for s in _moving(flat, fit, features))]
    _check_lacking(flat, fit, chosen)
    task = _Task(model, flat, physical, chosen, seen, {"name": name, "started_by": [s.name for s in kept], **way})
    options = {"period": period, "lags": lags, "commands": [s.name for s in flat.inputs], **training}
    residual, told = _chosen(task, fit, judge, options, [on_period(r, period, flat.inputs) for r in select or records])
    training_runs = [on_period(r, period, flat.inputs) for r in records]
    told["physics_trained_on"] = made_from_rows(getattr(model, "provenance", {}))  # whoever judges the hybrid asks
    if residual is None:
        names = {"trained_on": named(records), **told}
        hybrid = alone(model, period, **task.frame, domain=training_box(records, flat.inputs))
        return replace(hybrid, provenance={"kind": "hybrid", "model": flat.name, **names})
    hybrid = join(model, residual, **task.frame)
    provenance = {
        "kind": "hybrid",
        "model": flat.name,
        **{key: residual.provenance[key] for key in TOLD if key in residual.provenance},
        **told,
        "errors": _errors(physical, hybrid, training_runs, chosen),
    }
    return replace(hybrid, provenance=provenance)


@dataclass(frozen=True, eq=False)
class _Task:
    """What is corrected, what the residual sees, and the frame of the hybrid."""

    model: object
    flat: object
    physical: object
    chosen: list[Signal]
    seen: list[Signal]
    frame: dict

    def residual(self, records: Sequence[Record], select: Sequence[Record], options: dict):
        """A network on what the model lacks."""
        outputs = [residual_signal(s) for s in self.chosen]
        name = f"{self.frame['name']}_residual"
        return train_network(records, self.seen, outputs, select=select, name=name, **options)


def _chosen(task: _Task, fit: list[Record], judge: list[Record], options: dict, runs: list[Record]):
    """The residual, None where it does not help, and what is told of that. Both trainings share the budget."""
    end = time.monotonic() + options["budget"] if options.get("budget") else None
    if judge:
        residual, begins = task.residual(fit, judge, options), [r.time[0] for r in runs]
    else:
        parts = [split_tail(r, HELD_OUT) for r in fit]
        residual, begins = task.residual([first for first, _ in parts], [], options), [end.time[0] for _, end in parts]
    hybrid = join(task.model, residual, **task.frame)
    errors = _errors(task.physical, hybrid, runs, task.chosen, begins)
    helps = all(e["hybrid"] < HELPS * e["model"] for e in errors.values())
    told = {"added": helps, "held_out": errors, "stopped": residual.provenance["stopped"]}
    if not helps:
        figures = "; ".join(f"{n} {e['hybrid']:.4g} with it, {e['model']:.4g} without" for n, e in errors.items())
        told["says"] = (
            f"The residual was not added: it does not improve the free run on what was held out (RMS, SI: {figures}). "
            "The block is the model alone."
        )
        return None, told
    if not judge and told["stopped"] == FINISHED:
        left = {} if end is None else {"budget": max(end - time.monotonic(), LEAST)}
        residual = task.residual(fit, [], {**options, **_as_before(residual), **left})
        told["stopped"] = residual.provenance["stopped"]
    return residual, told


def _as_before(residual) -> dict:
    """The options that fix what was chosen for a residual."""
    form = residual.provenance["form"]
    return {
        "lags": (form["output_lags"], form["input_lags"]),
        **{key: form[key] for key in ("delay", "integrates", "hidden")},
    }


def _method(flat, record: Record) -> dict:
    """The method and the step that `simulate` settles on for this model."""
    settled = prepare(flat)
    u, p = record.array([s.name for s in flat.inputs]), flat.parameter_vector()
    settled.run(record.time, u, p, flat.start_given(())(u[0], p, []).full().ravel())
    return {"method": "implicit" if settled.method == "implicit" else "explicit", "substep": settled.step}


def _period(model, records: Sequence[Record], chosen: Sequence[Signal]) -> float:
    """The longest period [s] at which the model, its inputs held that long, runs as it does on the recording."""
    recorded, period = recorded_period(records), choose_period(records)
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
    """Inputs, simulated outputs and residuals at the block's samples; what else the recording says stays."""
    even = on_period(record, period, physical.inputs)
    run = simulate(physical, even)
    signals = {s.name: even[s.name] for s in physical.inputs}
    units = {s.name: s.unit for s in physical.inputs}
    for s in physical.outputs:
        signals[simulated_signal(s).name], units[simulated_signal(s).name] = run[s.name], s.unit
    for s in chosen:
        signals[residual_signal(s).name], units[residual_signal(s).name] = even[s.name] - run[s.name], s.unit
    return replace(even, signals=signals, units=units, refused={})


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


def _errors(
    physical, hybrid, records: Sequence[Record], chosen: Sequence[Signal], begins: Sequence[float] | None = None
) -> dict[str, dict[str, float]]:
    """RMS of the free runs by output, SI, from the times ``begins`` of every recording on."""
    begins = [-np.inf] * len(records) if begins is None else begins
    both = zip(records, begins, strict=True)
    runs = [(r.time >= at, r, simulate(physical, r), simulate(hybrid, r)) for r, at in both]

    def rms(name, which):
        return float(np.sqrt(np.mean(np.concatenate([(run[which][name] - run[1][name])[run[0]] ** 2 for run in runs]))))

    return {s.name: {"model": rms(s.name, 2), "hybrid": rms(s.name, 3)} for s in chosen}
