"""How much of a recording lies where a model was trained."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.records import Record
from hydrotwin.simulation.block import ON_THE_EDGE, TRAINING_DISTANCE, TrainingDomain

from .comparison import FREE_RUN, DomainShare, Trajectory


def domain_shares(
    contenders, records: Sequence[Record], train_records: Sequence[Record], trajectories: Sequence[Trajectory]
) -> tuple[DomainShare, ...]:
    """Share of every recording inside the training box of every contender that has one (its ``domain``).

    The box of ``train_records`` (every input and output of the contenders) gets a row per recording as well, with
    ``model`` empty. Values come from the recording, or from the free run for what was not recorded. An FMU of a learned
    block has no box, and says itself in its run how far outside of it it is.
    """
    free_runs = {(t.model, t.record): t.prediction for t in trajectories if t.mode == FREE_RUN}
    boxes = [(c.name, c.domain, "model") for c in contenders if getattr(c, "domain", None)]
    seen = training_box(contenders, records, train_records)
    boxes += [("", seen, "recordings")] if seen else []
    rows = []
    for model, box, source in boxes:
        for record in records:
            values = _values(box, record, free_runs.get((model, record.name)))
            if values is not None:
                rows.append(_share(model, record.name, box, values, source))
    boxed = {model for model, _, _ in boxes}
    for (model, name), run in free_runs.items():
        if model not in boxed and TRAINING_DISTANCE in run:
            rows.append(_told(model, name, run))
    return tuple(rows)


def _told(model: str, record: str, run: Record) -> DomainShare:
    """What a run says itself of how far it leaves the box; which quantities do is not known."""
    distance = run[TRAINING_DISTANCE][np.isfinite(run[TRAINING_DISTANCE])]
    inside = 100.0 * float(np.mean(distance <= ON_THE_EDGE)) if len(distance) else 100.0
    return DomainShare(model, record, inside, float(distance.max(initial=0.0)), (), "model")


def training_box(contenders, records: Sequence[Record], train_records: Sequence[Record]) -> TrainingDomain | None:
    """Range over the training recordings of the inputs and outputs that every recording holds."""
    signals = dict.fromkeys(s.name for c in contenders for s in (*c.inputs, *c.outputs))
    names = [n for n in signals if all(n in r.signals for r in (*records, *train_records))]
    seen = [np.concatenate([r[n] for r in train_records]) for n in names if train_records]
    box = [(n, v[np.isfinite(v)]) for n, v in zip(names, seen, strict=bool(train_records)) if np.isfinite(v).any()]
    if not box:
        return None
    return TrainingDomain(
        tuple(n for n, _ in box), tuple(float(v.min()) for _, v in box), tuple(float(v.max()) for _, v in box)
    )


def _values(box: TrainingDomain, record: Record, prediction: Record | None) -> np.ndarray | None:
    """(n, names) the boxed quantities, or None when one is nowhere to be had; what is unknown lies on the line between
    known samples, for those of two rasters may never meet in a row."""
    columns, sources = [], [r for r in (record, prediction) if r is not None]
    for name in box.names:
        source = next((r for r in sources if name in r.signals and np.isfinite(r[name]).any()), None)
        if source is None:
            return None
        here = np.isfinite(source[name])
        columns.append(np.interp(source.time, source.time[here], source[name][here]))
    return np.column_stack(columns)


def _share(model: str, record: str, box: TrainingDomain, values: np.ndarray, source: str) -> DomainShare:
    distance = box.distance(values)
    beyond = tuple(
        name
        for name, low, high, column in zip(box.names, box.lower, box.upper, values.T, strict=True)
        if ((column < low - ON_THE_EDGE * (high - low)) | (column > high + ON_THE_EDGE * (high - low))).any()
    )
    return DomainShare(
        model=model,
        record=record,
        inside_percent=100.0 * float(np.mean(distance <= ON_THE_EDGE)),
        farthest=float(distance.max()),
        beyond=beyond,
        source=source,
    )
