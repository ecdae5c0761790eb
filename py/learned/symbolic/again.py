"""The constants of a formula that was judged, fitted again to all recordings; its form, which was judged, stays.

To choose the form again is to take one that nothing has judged: on the bench `learn narx` kept other terms of all
recordings, which ran at 4.5 mm where the judged ones ran at 0.8 mm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, tidy

from ..block_file import LearnedBlock
from ..steady import steady_where_it_integrates
from ..substeps import with_steps
from ..substeps_step import STEPS
from ..training_data import checked_recordings, named
from .block import Formula, whole_tokens
from .data import prepare


def fitted_again(
    block: LearnedBlock, records: Sequence[Record], inputs: Sequence[Signal | str], outputs: Sequence[Signal | str]
) -> LearnedBlock:
    """The block of a formula of increments with its constants fitted to free runs over ``records``, from those it has.

    Period, lags and scales stay; the bounds of its free runs are those of ``records``. Its provenance keeps what was
    found on the way to the form (front, terms), and names what it is fitted to.

    Raises DataError for recordings that nothing can be learnt from.
    """
    from . import deploy
    from .select import LONG

    inputs, outputs, records, _ = checked_recordings("learn", records, inputs, outputs, ())
    steps, lags = block.structure.get(STEPS, 1), (block.structure["output_lags"], block.structure["input_lags"])
    period = tidy(block.period * steps)
    data = prepare(records, [], inputs, outputs, period, lags, False, steps=steps, scales=block.arrays)
    formula = Formula(whole_tokens(block.arrays["tokens"]), tuple(block.arrays["constants"].tolist()))
    own = range(len(outputs))
    formula = data.run(formula, own).refit(data.laid_out(data.fit, own), LONG)
    again = deploy.formula_block(formula, data, records, inputs, outputs, period, block.name)
    text, latex = deploy.equation(formula, data, inputs, outputs)
    told = {**block.provenance, "trained_on": named(records), "equation": text, "latex": latex}
    told |= {"narx": _with_factors(told["narx"], formula, data.shape, inputs, outputs)} if "narx" in told else {}
    told = {key: value for key, value in told.items() if key not in ("rest", "drift", "integration")}
    worded = text if block.description == block.provenance.get("equation") else block.description
    again = replace(again, description=worded, provenance=told)
    again = with_steps(replace(again, certificate=deploy.certify(again, formula)), steps)
    return steady_where_it_integrates(again, records, outputs)


def _with_factors(told: Mapping, formula: Formula, shape, inputs, outputs) -> dict:
    """The terms of a polynomial by output, with the factors that they have now."""
    from ..polynomial.terms import factors_of, feature_names, words

    names = feature_names(shape, [s.name for s in inputs], [s.name for s in outputs])
    answer = {}
    for output, own in zip(outputs, factors_of(formula, shape.features), strict=True):
        now = {words(term, names): factor for term, factor in own.items()}
        rows = [{**row, "factor": now.get(row["term"], 0.0)} for row in told[output.name]["terms"]]
        answer[output.name] = {**told[output.name], "terms": rows}
    return answer
