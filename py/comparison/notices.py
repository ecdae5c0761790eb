"""Notices of a comparison: what must not be missed, first on the page, in Markdown and in the JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hydrotwin.models.language.provenance import made_from_rows, told_since
from hydrotwin.records import all_unbroken, cuts, turned_back
from hydrotwin.records.between import shown_otherwise
from hydrotwin.records.sizes import far_from_usual, made_by_few

from .comparison import FREE_RUN, ONE_STEP
from .criteria import some_of
from .elsewhere import input_names, slower
from .uneven import uneven

if TYPE_CHECKING:
    from .comparison import Comparison
    from .starts import Started


def notices(comparison: Comparison) -> tuple[str, ...]:
    """All of them: what a model was made from, what failed, what cannot be believed, what recordings lack."""
    first = (
        _made(comparison)
        + _started(comparison)
        + _inaccurate(comparison)
        + _failures(comparison)
        + _unlikely(comparison)
    )
    found = _sizes(comparison) + _cut(comparison) + _turned(comparison) + _holes(comparison) + _uneven(comparison)
    return tuple(first + found + _slower(comparison))


def remarks(comparison: Comparison) -> list[str]:
    """Those that a terminal has not told in another way: of recordings as they are read, of failures and of inaccurate
    runs as they happen."""
    found = _made(comparison) + _unlikely(comparison) + _sizes(comparison) + _cut(comparison) + _uneven(comparison)
    return found + _slower(comparison)


def starts_told(starts: Sequence[Started]) -> list[str]:
    """Where models start, in sentences: the same of several recordings in one."""
    alike: dict[str, list[Started]] = {}
    for one in starts:
        alike.setdefault(one.noted("") if one.estimate.note else str(one), []).append(one)
    noted = [(some[0], some_of([s.estimate.record for s in some])) for some in alike.values()]
    return [one.noted(where) if one.estimate.note else str(one) for one, where in noted]


def _started(comparison: Comparison) -> list[str]:
    """Models that start where nobody says they do, and why."""
    return [f"{told.rstrip('.')}." for told in starts_told([s for s in comparison.starts if s.estimate.note])]


def _sizes(comparison: Comparison) -> list[str]:
    """Columns of most likely another unit, those whose range a few samples make, and inputs that do something else
    between their samples."""
    signals = [s for e in comparison.entrants for s in (*e.inputs, *e.outputs)]
    found = far_from_usual(comparison.records, signals) + made_by_few(comparison.records, [s.name for s in signals])
    taken: dict[str, list[str]] = {}
    for entrant in comparison.entrants:
        for doubt in shown_otherwise(entrant.inputs, comparison.records):
            taken.setdefault(doubt, []).append(entrant.name)
    return found + [f"{some_of(names)}: {doubt}" for doubt, names in taken.items()]


def _cut(comparison: Comparison) -> list[str]:
    """What was made of recordings with holes."""
    return cuts(all_unbroken(comparison.records, input_names(comparison.entrants)))


def _turned(comparison: Comparison) -> list[str]:
    """Angles that begin anew at every turn."""
    return [f"{r.name}: {turned}" for r in comparison.records for turned in turned_back(r)]


def _failures(comparison: Comparison) -> list[str]:
    """Each cause once, of three at most."""
    causes: dict[tuple[str, str], dict[str, list[str]]] = {}
    for f in comparison.failures:
        modes = causes.setdefault((f.model, f.sentence.removeprefix(f"{f.model}: ")), {})
        modes.setdefault(f.mode, []).append(f.record)
    found = []
    for (model, text), modes in causes.items():
        where = " and ".join(f"in {mode} on {', '.join(records)}" for mode, records in modes.items())
        found.append(f"{model} failed {where}: {text}")
    if len(found) > 3:
        found[3:] = [f"{len(found) - 3} more failures are listed under “Not in the scores”."]
    return found


def _unlikely(comparison: Comparison) -> list[str]:
    """Errors below the noise, bands that cannot be trusted, and what leaves the range of a training."""
    return _too_good(comparison) + _untrusted(comparison) + _far(comparison)


def _far(comparison: Comparison) -> list[str]:
    """Of every model that leaves what it was trained on where it does so most, and where else."""
    told: dict[str, list] = {}
    for domain in comparison.domains:
        if domain.extrapolates:
            told.setdefault(domain.model, []).append(domain)
    found = []
    for domains in told.values():
        first, *others = sorted(domains, key=lambda d: d.inside_percent)
        more = f" It does so on {some_of([d.record for d in others])}, too." if others else ""
        found.append(f"{first.extrapolates}{more}")
    return found


def notices_of_variants(runs: Sequence) -> list[str]:
    """Those of several variants: which failed or is another over again, once what all share, the others behind the
    names of their variants."""
    if len(runs) == 1:
        return list(notices(runs[0].comparison))
    told: dict[str, list[str]] = {}
    ended = [run for run in runs if not run.failed and not run.same_as]
    for run in ended:
        for text in notices(run.comparison):
            told.setdefault(text, []).append(run.name)
    said = [f"Variant {run.name} could not be scored: {run.failed}" for run in runs if run.failed]
    said += twins(runs)
    return said + [text if len(names) == len(ended) else f"{', '.join(names)}: {text}" for text, names in told.items()]


def twins(runs: Sequence) -> list[str]:
    """Variants that come to the same as another one, by that."""
    same: dict[str, list[str]] = {}
    for run in (run for run in runs if run.same_as):
        same.setdefault(run.same_as, []).append(run.name)
    return [
        f"Variant{'s' * (len(names) > 1)} {', '.join(names)} come{'s' * (len(names) == 1)} to the same as {first}, and "
        "its runs stand for both." for first, names in same.items()
    ]  # fmt: skip


def seen_before(comparison: Comparison) -> list[str]:
    """Recordings that a model was fitted to or trained on: how good it is on those says little."""
    found = []
    for entrant in comparison.entrants:
        rows = made_from_rows(entrant.provenance)
        seen = [r.name for r in comparison.records if comparison.follows(r, rows)]
        if seen:
            found.append(
                f"{entrant.name} was made from {', '.join(seen)}: its errors there say nothing of other recordings. "
                "Judge it on one that it has not seen."
            )
    if both := [r.name for r in comparison.records if comparison.follows(r, comparison.train_rows)]:
        found.append(
            f"Named as what the models were made from, too: {some_of(both)}. Errors there say nothing of other "
            "recordings. Judge on ones that no model has seen."
        )
    return found + _twice(comparison)


def _made(comparison: Comparison) -> list[str]:
    """What models were made from, and which are others than were fitted or trained."""
    found = [(e.name, told_since(e.provenance)) for e in comparison.entrants]
    return seen_before(comparison) + [f"{name}: {told}." for name, told in found if told]


def _twice(comparison: Comparison) -> list[str]:
    """Recordings that are one in two files: what both measure counts twice."""
    judged, outputs = [id(r) for r in comparison.records], [s.name for s in comparison.outputs]
    pairs = [(a, b) for a, b in comparison.copies if id(a) in judged and id(b) in judged]
    twice = [f"{b.name} is {a.name}" for a, b in pairs if any(n in a and n in b for n in outputs)]
    told = "It counts twice in every mean. Name it once."
    return [f"The same recording in another file: {some_of(twice)}. {told}"] if twice else []


def _inaccurate(comparison: Comparison) -> list[str]:
    """Models whose own numbers are not those of their equations: the first sentence of each, and how often."""
    runs: dict[str, list[str]] = {}
    for run in comparison.inaccurate:
        runs.setdefault(run.model, []).append(f"{run.record}: {run.sentence.removeprefix(f'{run.model}: ')}")
    return [
        f"The numbers of {model} are not those of its equations, on {told[0].rstrip('.')}."
        + (f" The same on {len(told) - 1} more." if len(told) > 1 else "")
        for model, told in runs.items()
    ]


def _holes(comparison: Comparison) -> list[str]:
    """Samples that an output lacks, by recording: scores are of the others."""
    found = []
    for record in comparison.records:
        lacks = {s.name: int(np.isnan(record[s.name]).sum()) for s in comparison.outputs if s.name in record}
        told = [f"{name} in {count}" for name, count in lacks.items() if count]
        if told:
            lacking = ", ".join(told)
            found.append(f"{record.name}: no value of {lacking} of {len(record.time)} samples; scores are of the rest.")
    return found


def _slower(comparison: Comparison) -> list[str]:
    """Outputs that are not known in the row before: one step ahead nothing is taken from them."""
    slow: dict[str, list[str]] = {}
    for record in comparison.records if ONE_STEP in comparison.modes else ():
        for name in (s.name for s in comparison.outputs if slower(record, s.name)):
            slow.setdefault(name, []).append(record.name)
    return [
        f"{name} of {some_of(records)} has no value in the row before: one step ahead its state is as in the free run."
        for name, records in slow.items()
    ]


def _uneven(comparison: Comparison) -> list[str]:
    """Outputs whose means rest on recordings of very different numbers of known samples."""
    told: dict[str, list[str]] = {}
    for signal in comparison.outputs:
        samples = {s.record: s.samples for s in comparison.scores if s.output == signal.name}
        if sentence := uneven(samples):
            told.setdefault(str(sentence), []).append(signal.name)
    return [
        f"Means of {', '.join(names)}: {sentence}. Read the recordings one by one, or judge them by name."
        for sentence, names in told.items()
    ]


def _untrusted(comparison: Comparison) -> list[str]:
    """Models whose bands are not to be believed, and why: one sentence for the outputs that share the reason."""
    found, scored = [], {s.name for s in comparison.outputs}
    for entrant in comparison.entrants:
        doubted: dict[str, list[str]] = {}
        for band in entrant.bands:
            if band.trusted is False and band.output in scored:
                doubted.setdefault(band.why, []).append(band.output)
        found += [
            f"The bands of {entrant.name} cannot be trusted for {', '.join(names)}: {why.rstrip('.')}."
            for why, names in doubted.items()
        ]
    return found


def _too_good(comparison: Comparison) -> list[str]:
    """Models whose one-step error is below the noise of the sensor; where that of a free run is, too, which sees no
    sample, the noise is less than it seems: of a slow sensor its motion counts as noise."""
    outputs: dict[str, dict[str, list[str]]] = {}
    below = {(s.model, s.output, s.record) for s in comparison.scores if s.mode == FREE_RUN and s.below_noise}
    for s in comparison.scores:
        if s.too_good and (s.model, s.output, s.record) not in below:
            outputs.setdefault(s.model, {}).setdefault(s.output, []).append(s.record)
    return [
        f"{model} is too good to be true one step ahead on {_where(found)}: its error is below the noise of the "
        "measurement, so it may have seen the sample it predicts (or the noise estimate has taken vibration for noise)."
        for model, found in outputs.items()
    ]


def _where(found: Mapping[str, Sequence[str]]) -> str:
    """Outputs, each with the recordings that it is about."""
    return ", ".join(f"{output} ({some_of(records)})" for output, records in found.items())
