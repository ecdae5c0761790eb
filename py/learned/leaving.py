"""How much of a run lies outside of what a block was trained on: there it extrapolates, or stands at its limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.records import Record
from hydrotwin.simulation import Block

from .training_data import domain_share

OUTSIDE, FAR = 0.01, 0.1  # share of samples outside of what was trained on: from which on it is told, and is bad news


def leaves(block: Block, records: Sequence[Record], runs: Sequence[Record] = ()) -> dict:
    """The ``share`` of the samples outside of what a block was trained on, and the ``signals`` that leave it.

    Of inputs as recorded, and of outputs as the block's ``runs`` of the same recordings have them, where these are
    given. Nothing where that is hardly any.
    """
    if block.domain is None:
        return {}
    units = {s.name: s.unit for s in block.outputs if s.name in block.domain.names}
    seen = [r.with_signals({n: a[n] for n in units}, units) for r, a in zip(records, runs, strict=False)] or records
    shares = [domain_share(block, record) for record in seen]
    outside = 1 - float(np.average([s.inside for s in shares], weights=[len(r) for r in records]))
    beyond = dict.fromkeys(name for share in shares for name in share.beyond)
    return {"share": outside, "signals": list(beyond)} if outside >= OUTSIDE else {}


def leaves_said(found: Mapping | None, of_what: str) -> str:
    """What `leaves` found, in a sentence; "" of nothing."""
    if not found:
        return ""
    names = found["signals"]
    return (
        f"It extrapolates in {100 * found['share']:.3g} % of {of_what}: {' and '.join(names)} "
        f"leave{'' if len(names) > 1 else 's'} what it was trained on."
    )
