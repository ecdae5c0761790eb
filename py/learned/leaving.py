"""How much of a run lies outside of what a block was trained on: there it extrapolates, or stands at its limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.records import Record
from hydrotwin.simulation import Block
from hydrotwin.simulation.block import TrainingDomain

from .training_data import domain_share

OUTSIDE, FAR = 0.01, 0.1  # share of samples outside of what was trained on: from which on it is told, and is bad news
CARRIED = 1e-9  # of a range: a block whose next step moves by no more when its start does not look at where it is


def leaves(block: Block, records: Sequence[Record], runs: Sequence[Record] = ()) -> dict:
    """The ``share`` of the samples outside of what a block was trained on, and the ``signals`` that leave it.

    Of inputs as recorded, and of outputs as the block's ``runs`` of the same recordings have them, where these are
    given. Nothing where that is hardly any. ``carried`` where it is outputs alone that leave it, which the block
    integrates and never looks at.
    """
    if block.domain is None:
        return {}
    units = {s.name: s.unit for s in block.outputs if s.name in block.domain.names}
    seen = [r.with_signals({n: a[n] for n in units}, units) for r, a in zip(records, runs, strict=False)] or records
    shares = [domain_share(block, record) for record in seen]
    outside = 1 - float(np.average([s.inside for s in shares], weights=[len(r) for r in records]))
    beyond = dict.fromkeys(name for share in shares for name in share.beyond)
    if outside < OUTSIDE:
        return {}
    carried = all(_is_carried(block, name) for name in beyond)
    return {"share": outside, "signals": list(beyond), **({"carried": True} if carried else {})}


def leaves_said(found: Mapping | None, of_what: str) -> str:
    """What `leaves` found, in a sentence; "" of nothing."""
    if not found:
        return ""
    names = found["signals"]
    return (
        f"It extrapolates in {100 * found['share']:.3g} % of {of_what}: {' and '.join(names)} "
        f"leave{'' if len(names) > 1 else 's'} what it was trained on."
    )


def far(found: Mapping) -> bool:
    """Whether what `leaves` found speaks against a block."""
    return found.get("share", 0.0) >= FAR and not found.get("carried")


def _is_carried(block: Block, name: str) -> bool:
    """Whether an output is only integrated: where it begins moves it, and nothing else."""
    states = [k for k, s in enumerate(block.states) if s.measured_by == name]
    if len(states) != 1:
        return False
    box: TrainingDomain = block.domain
    low, high = (np.array(end) for end in (box.lower, box.upper))
    middle = dict(zip(box.names, 0.5 * (low + high), strict=True))
    u, y = (np.array([middle.get(s.name, 0.0) for s in part]) for part in (block.inputs, block.outputs))
    p = block.parameter_vector()
    x = block.start(u, y, p).full().ravel()
    at = box.names.index(name)
    shift = np.zeros(len(x))
    shift[states[0]] = 0.25 * (high[at] - low[at])
    moved = (block.step(x + shift, u, p)[0] - block.step(x, u, p)[0]).full().ravel()
    return bool(np.isfinite(moved).all() and np.abs(moved - shift).max() <= CARRIED * (high[at] - low[at]))
