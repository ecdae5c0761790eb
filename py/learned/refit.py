"""A block that was judged, trained again on all recordings: of few data what was held out is missed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import Block, simulate
from hydrotwin.simulation.stops import Diverged

from .held_out import Part, through
from .learning import PUBLISHED, held_out_of, trainer
from .validation import validated

REFITTED = "Then it was trained again on all recordings: the figures are those of the block that had not seen all."
KEPT = "Trained again on all recordings, it ran worse over what had been held out: the block as it was judged is kept."


def refitted(
    block: Block,
    kind: str,
    records: Sequence[Record],
    inputs: Sequence[Signal | str] = (),
    outputs: Sequence[Signal | str] = (),
    *,
    model=None,
    fit: str | None = None,
    validate: Sequence[Record] = (),
    **options,
) -> Block:
    """A block of ``kind`` trained again on all of ``records``, what was held out of ``block`` among them.

    A training may end elsewhere. One that then runs worse over what it has now seen than ``block`` did unseen is no
    better anywhere else, and ``block`` is answered. The card in ``provenance["free_run"]`` stays that of ``block``,
    which alone has something to be judged on; it says what became of it, and ``"refitted"`` whether it is the new one.
    Arguments and errors: those of `learn`.
    """
    train, records = trainer(kind, fit), list(records)
    options |= {"fit": fit} if fit is not None and kind not in PUBLISHED else {}
    if kind == "hybrid":
        again = train(model, records, list(outputs) or None, **options)
    else:
        again = train(records, inputs, outputs, **options)
    told = dict(block.provenance.get("free_run", {}))
    worse = _worse(again, told, held_out_of(records, inputs, outputs, model).parts)
    if told:
        told |= {"says": f"{told['says']} {KEPT if worse else REFITTED}", "refitted": not worse}
    if worse:
        return replace(block, provenance={**block.provenance, "free_run": told})
    kept = {key: block.provenance[key] for key in ("ranking", "chosen_on") if key in block.provenance}
    return validated(replace(again, provenance={**again.provenance, **kept, "free_run": told}), validate)


def _worse(again: Block, told: dict, parts: Sequence[Part]) -> bool:
    """Whether its free run over the parts is worse than the one on the card, in the mean over the outputs."""
    judged = {name: row["rmse"] for name, row in told.get("outputs", {}).items() if row.get("rmse")}
    if not judged or not parts:
        return False
    try:
        runs = through(lambda record: simulate(again, record), parts)
    except Diverged:
        return True
    ratios = []
    for name, before in judged.items():
        misses = [run[name] - part.seen[name] for run, part in zip(runs, parts, strict=True)]
        ratios.append(np.sqrt(np.mean(np.concatenate(misses) ** 2)) / before)
    return bool(np.mean(ratios) > 1)
