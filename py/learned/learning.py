"""`learn`: any kind of learned block by name, run freely on a part of the recordings that took no part in training."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import NEAR, Record, all_unbroken, as_needed, cuts, shares_samples
from hydrotwin.simulation import Block, simulate

from . import held_out
from .excitation import one_way
from .gaussian.choice import learn_gp
from .gaussian.dual import learn_dual_gp
from .grey_box.learn import learn_grey_box
from .hybrid.block import hybrid_outputs
from .hybrid.learn import learn_hybrid
from .importance import idle, importance
from .interruption import INTERRUPTED
from .leaving import far, leaves, leaves_said
from .linear.arx import learn_arx
from .linear.learn import learn_linear
from .network.learn import train_network
from .network.rate import learn_rate_network
from .piecewise.learn import learn_piecewise
from .polynomial.learn import learn_narx
from .repeats import repeats
from .report_card import MODEL, Words, card, judged, shown, yardsticks
from .state_network.learn import learn_state_network
from .substeps_step import STEPS as SUBSTEPS
from .symbolic.learn import learn_symbolic
from .training_data import MANY, typed_period, with_marks
from .validation import judges, validated

KINDS: Mapping[str, Callable] = {
    "arx": learn_arx,
    "linear": learn_linear,
    "nn": train_network,
    "gp": learn_gp,
    "dual_gp": learn_dual_gp,
    "piecewise": learn_piecewise,
    "grey_box": learn_grey_box,
    "symbolic": learn_symbolic,
    "narx": learn_narx,
    "hybrid": learn_hybrid,
    "state_nn": learn_state_network,
}
FINISHED = "finished"  # what the provenance says of a training that nothing cut
ONLY_RATES = ("dual_gaussian_process", "rate_network")  # kinds of block that hold no level
ANY_FORM = ("gp", "nn", "grey_box", "symbolic")
LEARNED = {True: "its rate is learned", False: "its level is learned", None: "its change from step to step is learned"}
PUBLISHED = {"nn": learn_rate_network}  # where the paper's procedure is another function


def trainer(kind: str, fit: str | None = None) -> Callable:
    """The function that trains a kind; ``fit`` "paper" is the published procedure.

    Raises `DeclarationError` for a kind or a fit that is not known.
    """
    if kind not in KINDS:
        raise DeclarationError(f"learn: no kind '{kind}'. {nearest(kind, KINDS)}")
    if kind not in PUBLISHED:
        return KINDS[kind]
    if fit not in (None, "default", "paper"):
        raise DeclarationError(f"learn {kind}: no fit '{fit}'. {nearest(str(fit), ('default', 'paper'))}")
    return PUBLISHED[kind] if fit == "paper" else KINDS[kind]


def takes(kind: str, option: str) -> bool:
    """Whether the trainer of a kind has an option; recordings to validate judge any kind."""
    if option == "validate":
        return True
    parameters = inspect.signature(trainer(kind)).parameters
    return option in parameters and parameters[option].kind is inspect.Parameter.KEYWORD_ONLY


def learn(
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
    """Train a block of ``kind`` and run it freely on what was held out of the recordings, see `held_out`.

    ``provenance["free_run"]`` holds by output the RMS error of that run (SI), that of holding the last sample, of the
    mean, of ARX by least squares, of a piecewise linear curve (one input, one output) and of ``model`` alone, which of
    these the block does not beat (``"no_better_than"``) or not for certain (``"cannot_tell"``), and all of it in a
    sentence (``"says"``); the error of every stretch of what was held out (``"stretches"``), the error one step ahead,
    and what is left (`left_over`). Where nothing can be held out, all is trained on and the sentence says so.
    ``provenance["validation"]`` holds the RMS errors (SI) of free runs over ``validate``, by output, and
    ``["validation_beside"]`` those of holding the first sample and of the other yardsticks (see `validated`). No
    trainer sees these recordings.

    Args:
        kind: one of `KINDS`. records: training recordings. inputs, outputs: signals, or names of columns.
        model: the identified model of a hybrid, whose inputs are those of the model and whose outputs may be left out.
        fit: "paper": the published procedure. validate: recordings that judge. options: those of the trainer of that
            kind.

    Raises: as the trainer of that kind, and `DeclarationError` for a kind that is not known.
    """
    trainer(kind, fit)
    check_judges(validate, records, inputs, outputs, model)
    block, split = trained(kind, records, inputs, outputs, model=model, fit=fit, **options)
    return with_card(block, split, records, inputs, outputs, model=model, validate=validate)


def trained(
    kind: str,
    records: Sequence[Record],
    inputs: Sequence[Signal | str] = (),
    outputs: Sequence[Signal | str] = (),
    *,
    model=None,
    fit: str | None = None,
    **options,
) -> tuple[Block, held_out.Split]:
    """A block without its card, and what of the recordings it was trained on; arguments and errors as of `learn`."""
    train = trainer(kind, fit)
    if options.get("select") and not takes(kind, "select"):
        raise DeclarationError(f"learn {kind}: nothing is chosen by recordings here. Leave --select out.")
    check_select(kind, records, options.get("select"))
    if (kind == "hybrid") != (model is not None):
        raise DeclarationError(
            f"learn {kind}: a model goes with hybrid (got {model}). Give learn('hybrid', model=...)."
        )
    options |= {"fit": fit} if fit is not None and kind not in PUBLISHED else {}
    records = unbroken_for(records, inputs, outputs, model)
    options |= {"period": typed_period(options["period"], records)} if options.get("period") else {}
    options |= {"select": unbroken_for(options["select"], inputs, outputs, model)} if options.get("select") else {}
    split = held_out_of(records, inputs, outputs, model)

    def on(some: Sequence[Record]) -> Block:
        if kind == "hybrid":
            block = train(model, some, list(outputs) or None, **options)
        else:
            block = train(some, inputs, outputs, **options)
        return with_marks(block, [*some, *(options.get("select") or ())])

    try:
        return on(split.fit), split
    except DataError as error:
        if not split.parts:
            raise
        why = f"without it there is too little to learn from: {error}"
        return on(records), held_out.Split(records, why=why)  # its own error is about all that was given


def with_card(
    block: Block,
    split: held_out.Split,
    records: Sequence[Record],
    inputs: Sequence[Signal | str] = (),
    outputs: Sequence[Signal | str] = (),
    *,
    model=None,
    validate: Sequence[Record] = (),
) -> Block:
    """A block with its free run over what was held out, and over ``validate``, in its provenance (see `learn`)."""
    records, rivals = unbroken_for(records, inputs, outputs, model), {}
    named = _names(model, records, inputs, outputs)
    try:
        rivals = _rivals(block, split, named, model) if split.parts or validate else {}
        told = _card(block, split, records, named, rivals)
    except KeyboardInterrupt:  # the block is trained: it is not lost because nobody waits for its card
        told = card(held_out.Split(records, why="the free run was interrupted"), [], Words())
    return validated(replace(block, provenance={**block.provenance, "free_run": told}), list(validate), rivals)


def _rivals(block: Block, split: held_out.Split, named, model) -> dict:
    """The yardsticks of a block, the model alone among them where there is one."""
    alone = {} if model is None else {MODEL: lambda record: simulate(model, record)}
    return alone | yardsticks(block.provenance.get("kind", ""), split, *named)


def check_judges(validate: Sequence[Record], records: Sequence[Record], inputs, outputs, model=None) -> None:
    """Raises DataError for a recording to validate that lacks a column or is trained on, before a long training."""
    inputs, outputs = _names(model, records, inputs, outputs)
    judges(validate, records, [*inputs, *outputs])


def check_select(kind: str, records: Sequence[Record], select: Sequence[Record] | None) -> None:
    """Raises DeclarationError for a recording that is both trained on and to choose."""
    twice = [one.name for one in select or () if any(shares_samples(one, r) for r in records)]
    if twice:
        raise DeclarationError(
            f"learn {kind}: {', '.join(twice)} is trained on: choosing on it, too, says nothing of others. Give "
            "--select others."
        )


def held_out_of(
    records: Sequence[Record], inputs: Sequence[Signal | str], outputs: Sequence[Signal | str], model=None
) -> held_out.Split:
    """What `learn` trains on of these recordings, and what it holds out."""
    records = unbroken_for(records, inputs, outputs, model)
    return held_out.split(records, *_names(model, records, inputs, outputs))


def unbroken_for(records: Sequence[Record], inputs, outputs, model=None) -> list[Record]:
    """The parts of recordings between their holes: no block is trained, or runs, over what nobody measured.

    Columns are what the model, or the signals, take them for. Raises `DataError` for a recording of which no part is
    long enough.
    """
    flat = getattr(model, "flat", model)
    known = (*inputs, *outputs) if model is None else (*flat.inputs, *flat.outputs)
    records = [as_needed(r, [s for s in known if isinstance(s, Signal)]) for r in records]
    named = _names(model, records, inputs, outputs)
    return all_unbroken(records, [name for names in named for name in names])


def _names(model, records: Sequence[Record], inputs, outputs) -> tuple[list[str], list[str]]:
    if model is not None:
        flat = getattr(model, "flat", model)
        chosen = hybrid_outputs(flat, list(outputs) or None, lambda n: all(n in r for r in records))
        return [s.name for s in flat.inputs], [s.name for s in chosen]
    return tuple([getattr(s, "name", s) for s in part] for part in (inputs, outputs))


def _card(block: Block, split: held_out.Split, records: Sequence[Record], named, rivals) -> dict:
    bad, notes = _of_form(block)
    bad += [*one_way(records, named[0]), *_of_ending(block)]
    notes += [
        *cuts(records),
        *_of_printing(records),
        *_of_drift(block),
        *_of_seeds(block),
        *_of_thinning(block, records),
    ]
    if not split.parts:
        return card(split, [], Words(bad, notes))
    rows = judged(block, split, named[1], rivals, records)
    worth = importance(block, split.parts, named[1])
    unused = idle(worth, {row.output.name: row.rmse for row in rows})
    notes += [f"Without {name} it runs as well: leave it out, or record it moving more." for name in unused]
    if block.provenance.get("kind") == "symbolic" and any(row.no_better_than for row in rows) and not _static(block):
        notes.append("It was learned with a memory. Where outputs follow from the inputs of the same moment alone, say "
                     "static=true.")  # fmt: skip
    if not any(row.diverged for row in rows):
        bad, notes = ([*before, *more] for before, more in zip((bad, notes), _outside(block, split), strict=True))
    return card(split, rows, Words(bad, notes, repeats(split, named[0]))) | ({"inputs": worth} if worth else {})


def _outside(block: Block, split: held_out.Split) -> tuple[list[str], list[str]]:
    """Bad news and notes: how much of the free runs lies outside of what the block was trained on."""
    runs = held_out.through(lambda record: simulate(block, record), split.parts)
    found = leaves(block, split.held_out, runs)
    said = [leaves_said(found, "what was held out")] if found else []
    return (said, []) if far(found) else ([], said)


def _static(block: Block) -> bool:
    return bool(block.provenance.get("static"))


def _of_ending(block: Block) -> list[str]:
    """What ended the training before it was done; Ctrl-C is the user's own."""
    stopped = block.provenance.get("stopped", FINISHED)
    if stopped in (FINISHED, INTERRUPTED):
        return []
    return [f"Training was not done ({stopped}): this is the best so far. Give it longer, or no --budget."]


def _of_form(block: Block) -> tuple[list[str], list[str]]:
    """Bad news and notes: whether each output was found to integrate, and what was made of it."""
    provenance, notes = block.provenance, []
    bad = [provenance["says"]] if "says" in provenance else []  # a residual that was not added
    form, units = provenance.get("rate", provenance.get("integrating")), _units(block)
    for name, found in provenance.get("integration", {}).items():
        integrates = found["integrates"]
        rate, level = (shown(found[f"{part}_form"], units.get(name, "1")) for part in ("rate", "level"))
        verb = "integrates" if integrates else "does not integrate"
        if provenance.get("kind") in ONLY_RATES and not integrates:
            bad.append(f"{name} {verb} its inputs, and this kind learns rates only: take {', '.join(ANY_FORM)}.")
        made = LEARNED[form] + (", as asked for" if form not in (None, integrates) else "")
        if not found["clear"]:
            made += ". The recordings hardly tell the two apart: record commands that are held, at several levels"
        notes.append(f"{name} {verb} its inputs (a simple model of its rate runs to {rate}, of its level to {level}); "
                     f"{made}.")  # fmt: skip
    return bad, notes


def _units(block: Block) -> dict[str, str]:
    """Units of the outputs by name, those of a hybrid's residual among them."""
    parts = [block, block.residual] if getattr(block, "residual", None) else [block]
    return {s.name: s.unit for part in parts for s in part.outputs}


def _of_seeds(block: Block) -> list[str]:
    """How far apart trainings from several seeds ended where they were chosen."""
    errors = [row["held_out_error"] for row in block.provenance.get("seeds", ())]
    if len(errors) < 2 or not min(errors) > 0:
        return []
    apart = max(errors) / min(errors)
    told = f"{apart:.2g} times the error of the best" if np.isfinite(apart) else "diverged"
    return [f"Of {len(errors)} seeds the worst {'had ' if np.isfinite(apart) else ''}{told} where they were chosen."]


def _of_thinning(block: Block, records: Sequence[Record]) -> list[str]:
    """What of long recordings a training did not run over."""
    steps = getattr(block, "structure", {}).get(SUBSTEPS, 1)
    all_, period = sum(len(r) for r in records), steps * block.period
    taken = sum(r.duration for r in records) / period
    if all_ <= MANY or taken > all_ / 2:
        return []
    means = "; the inputs are their means in between" if steps > 1 else ""
    return [f"Of {all_} samples one every {period:.3g} s was trained on{means}: more than {MANY} take too long. Give "
            "period=... for another."]  # fmt: skip


def _of_printing(records: Sequence[Record]) -> list[str]:
    """Recordings whose samples were not taken at the times that are printed, but evenly."""
    far = [r for r in records if np.abs(r.evenly().time - r.time).max(initial=0.0) > NEAR * r.period]
    if not far:
        return []
    names = ", ".join(r.name for r in far[:3]) + (f" and {len(far) - 3} more" if len(far) > 3 else "")
    return [
        f"Times of {names} are printed with few digits: the samples count as even, one every {far[0].period:.6g} s."
    ]


def _of_drift(block: Block) -> list[str]:
    """What the block did where the machine rests, and what it drifted by."""
    rest = block.provenance.get("rest", {})
    units, words = _units(block), []
    for name, drift in rest.get("drift", {}).items():
        rate = f"{shown(drift, units.get(name, '1'))}/s"
        held = f"drifted by up to {rate} and is held" if name in rest["held"] else f"drifts by up to {rate}"
        if drift > 0:
            words.append(f"Where the machine rests, {name} {held}.")
    for name, off in block.provenance.get("drift", {}).items():
        before, after = (shown(off[key], units.get(name, "1")) for key in ("before", "after"))
        words.append(f"Free runs in training drifted by {before} in {name}; a curve of the inputs leaves {after}.")
    return words
