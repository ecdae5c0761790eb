"""How much of a recording lies where a model was trained."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hydrotwin.records import Record
from hydrotwin.simulation.block import TrainingDomain

from .comparison import FREE_RUN, DomainShare, Trajectory

MARGIN = 1e-9  # of the box width: samples on the edge are inside


def domain_shares(
    contenders, records: Sequence[Record], train_records: Sequence[Record], trajectories: Sequence[Trajectory]
) -> tuple[DomainShare, ...]:
    """Share of every recording inside the training box of every contender.

    The box is the model's own ``domain``, else the range of its inputs and outputs over ``train_records``; a model
    with neither gets no row. Values come from the recording, or from the free run for what was not recorded.
    """
    free_runs = {(t.model, t.record): t.prediction for t in trajectories if t.mode == FREE_RUN}
    rows = []
    for contender in contenders:
        own = getattr(contender, "domain", None)
        box = own or training_box(contender, train_records)
        if box is None or not contender.inputs:
            continue
        for record in records:
            values = _values(box, record, free_runs.get((contender.name, record.name)))
            if values is not None:
                rows.append(_share(contender.name, record.name, box, values, "model" if own else "recordings"))
    return tuple(rows)


def training_box(contender, train_records: Sequence[Record]) -> TrainingDomain | None:
    """Range of the contender's inputs and outputs over the training recordings that hold them."""
    names, lower, upper = [], [], []
    for signal in dict.fromkeys((*contender.inputs, *contender.outputs)):
        seen = [r[signal.name] for r in train_records if signal.name in r.signals]
        seen = [s[np.isfinite(s)] for s in seen if np.isfinite(s).any()]
        if seen and signal.name not in names:
            names.append(signal.name)
            lower.append(min(float(s.min()) for s in seen))
            upper.append(max(float(s.max()) for s in seen))
    return TrainingDomain(tuple(names), tuple(lower), tuple(upper)) if names else None


def _values(box: TrainingDomain, record: Record, prediction: Record | None) -> np.ndarray | None:
    """(n, names) the boxed quantities, or None when one is nowhere to be had."""
    columns = []
    for name in box.names:
        source = next((r for r in (record, prediction) if r is not None and name in r.signals), None)
        if source is None:
            return None
        columns.append(np.asarray(source[name], float))
    values = np.column_stack(columns)
    return values[np.isfinite(values).all(axis=1)]


def _share(model: str, record: str, box: TrainingDomain, values: np.ndarray, source: str) -> DomainShare | None:
    distance = box.distance(values)
    beyond = tuple(
        name
        for name, low, high, column in zip(box.names, box.lower, box.upper, values.T, strict=True)
        if ((column < low - MARGIN * (high - low)) | (column > high + MARGIN * (high - low))).any()
    )
    return DomainShare(
        model=model,
        record=record,
        inside_percent=100.0 * float(np.mean(distance <= MARGIN)),
        farthest=float(distance.max()),
        beyond=beyond,
        source=source,
    )
