"""A block that was judged, trained again on all recordings: of few data what was held out is missed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import Block, simulate
from hydrotwin.simulation.stops import Diverged

from .held_out import Part, through
from .interruption import INTERRUPTED
from .learning import FINISHED, PUBLISHED, held_out_of, trainer, unbroken_for
from .training_data import with_marks
from .validation import beside, validated

REFITTED = "Then it was trained again on all recordings: the figures are those of the block that had not seen all."
KEPT = "Trained again on all recordings, it ran worse over what had been held out: the block as it was judged is kept."

CUT = "The training on all recordings was not done ({why}): give it longer, or no --budget."
NETWORK = ("period", "delay", "substeps", "integrates", "hidden")  # blocks of an older version lack some

AGAIN = ("symbolic", "narx", "state_network")  # kinds in provenances that are trained on from where they are
FORMS: Mapping[str, Callable[[Mapping], dict]] = {  # by kind, the options that say what a provenance tells was chosen
    "arx": lambda told: _arx_form(told["arx"]),
    "network": lambda told: (
        {key: told["form"][key] for key in NETWORK if key in told["form"]}
        | {"lags": (told["form"]["output_lags"], told["form"]["input_lags"])}
    ),
    "gaussian_feedback": lambda told: (
        {"period": told["period"], "kernel": told["kernel"]}
        | {"lags": tuple(told[key] for key in ("level", "increments", "samples"))}
    ),
}


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

    The form that was chosen for ``block``, its period, lags, hidden units or kernel, stays where it is one of `FORMS`:
    to choose it again takes most of a training, and what was judged is the form. Of formulas only the constants are
    fitted again, and a network with hidden states is trained on from where it is (`AGAIN`). A training may end
    elsewhere. One that then runs worse over what it has now seen than ``block`` did unseen is no better anywhere else,
    and ``block`` is answered. The card in ``provenance["free_run"]`` stays that of ``block``, which alone has something
    to be judged on; it says what became of it, and ``"refitted"`` whether it is the new one.
    Arguments and errors: those of `learn`.
    """
    train, records = trainer(kind, fit), unbroken_for(records, inputs, outputs, model)
    options = (form_of(block) if fit is None else {}) | options
    options |= {"fit": fit} if fit is not None and kind not in PUBLISHED else {}
    if fit is None and block.provenance.get("kind") in AGAIN and not block.provenance.get("static"):
        again = _trained_on(block)(block, records, inputs, outputs)
    elif kind == "hybrid":
        again = train(model, records, list(outputs) or None, **options)
    else:
        again = train(records, inputs, outputs, **options)
    again = with_marks(again, records)
    told = dict(block.provenance.get("free_run", {}))
    worse = _worse(again, told, held_out_of(records, inputs, outputs, model).parts)
    if told:
        cut = _cut(again)
        words = [told["says"], KEPT, *cut] if worse else [*cut, told["says"], REFITTED]
        told |= {"says": " ".join(words), "refitted": not worse, "bad": bool(told.get("bad") or (cut and not worse))}
    if worse:
        return replace(block, provenance={**block.provenance, "free_run": told})
    kept = {key: block.provenance[key] for key in ("ranking", "chosen_on") if key in block.provenance}
    again = replace(again, provenance={**again.provenance, **kept, "free_run": told})
    return validated(again, validate, beside=beside(block, validate))


def _cut(again: Block) -> list[str]:
    """What ended the training on all recordings before it was done; those of `AGAIN` end by themselves."""
    why = again.provenance.get("stopped", FINISHED)
    own = again.provenance.get("kind") not in AGAIN
    return [CUT.format(why=why)] if own and why not in (FINISHED, INTERRUPTED) else []


def _trained_on(block: Block) -> Callable[..., Block]:
    """What trains a block of `AGAIN` on; a formula needs libraries that others do not."""
    if block.provenance["kind"] == "state_network":
        from .state_network.again import fitted_again
    else:
        from .symbolic.again import fitted_again
    return fitted_again


def form_of(block: Block) -> dict:
    """The options with which the trainer of a block's kind takes the form that it has; none where it chooses anew."""
    told = block.provenance
    if told.get("kind") not in FORMS:
        return {}
    return FORMS[told["kind"]](told) | ({"period": block.period} if told["kind"] == "arx" else {})


def _arx_form(told: Mapping[str, Mapping]) -> dict:
    """What all equations have in common, which is all of it for one input and one output."""
    windows = [w for equation in told.values() for w in equation["inputs"].values()]
    found = {
        "rate": {equation["rate"] for equation in told.values()},
        "lags": {(equation["past"], w["samples"]) for equation in told.values() for w in equation["inputs"].values()},
        "delay": {w["delay"] for w in windows},
    }
    return {name: values.pop() for name, values in found.items() if len(values) == 1}


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
