"""A network with hidden states that was judged, trained some more on all recordings from where it is.

To choose and train it anew is to take another one, which nothing has judged: other parts choose another form, and from
another start it ends elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..block_file import LearnedBlock
from ..steady import steady_where_it_integrates
from ..training_data import checked_recordings, named, on_period, training_box
from .choosing import HELD_BACK
from .climbing import Climb, Course, Run
from .equations import StateShape
from .learn import bounds_of, network_block, plan_of
from .sensitivities import Network, joined_weights


def fitted_again(
    block: LearnedBlock, records: Sequence[Record], inputs: Sequence[Signal | str], outputs: Sequence[Signal | str]
) -> LearnedBlock:
    """The block trained on all samples of ``records``, held back more by its decay; a weight that is zero stays so.

    Scales and period stay; the bounds of the outputs are those of ``records``.

    Raises DataError for recordings that nothing can be learnt from.
    """
    inputs, outputs, records, _ = checked_recordings("learn", records, inputs, outputs, ())
    runs = [_run(block, on_period(r, block.period, inputs), inputs, outputs) for r in records]
    before = _network(block, len(inputs), len(outputs), runs)
    decay, seed = (block.provenance[key] for key in ("decay", "seed"))
    climb = Climb(Course(runs, before.shape, HELD_BACK * decay, (before.flat != 0).astype(float)), before, seed)
    net = climb.through(plan_of(runs).everything).net
    told = {key: value for key, value in block.provenance.items() if key not in ("rest", "drift", "integration")}
    again = network_block(
        net,
        block.arrays,
        name=block.name,
        inputs=inputs,
        outputs=outputs,
        period=block.period,
        domain=training_box(records, (*inputs, *outputs)),
        description=block.description,
        provenance={**told, "trained_on": named(records)},
    )
    return steady_where_it_integrates(again, records, outputs)


def _run(block: LearnedBlock, record: Record, inputs: Sequence[Signal], outputs: Sequence[Signal]) -> Run:
    """A recording at the block's period, over its scales."""
    u, y = (
        (record.array([s.name for s in signals]) - block.arrays[f"{part}_centre"]) / block.arrays[f"{part}_scale"]
        for part, signals in (("input", inputs), ("output", outputs))
    )
    return Run(u, y, np.ones(len(u), dtype=bool))


def _network(block: LearnedBlock, inputs: int, outputs: int, runs: Sequence[Run]) -> Network:
    """What trains, from the arrays of a block."""
    ends = {side: block.arrays[f"state_{side}"].copy() for side in ("lower", "upper")}
    ends["lower"][:outputs], ends["upper"][:outputs] = bounds_of(runs)
    shape = StateShape(inputs, outputs, **block.structure)
    return Network(shape, block.arrays["rate"], **ends, flat=joined_weights(block.arrays, shape))
