"""What is asked of a comparison, held against what it can answer: before a long run, not after it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .band import SD
from .comparison import FREE_RUN, Comparison, Entrant
from .criteria import Criterion, some_of
from .earlier import Earlier, earlier
from .meaning import criteria_of
from .metric import ERRORS, METRICS, SCORED
from .rates import rate_signal
from .tags import each_tag, groups, of_group

if TYPE_CHECKING:
    from .acceptance import Wanted

SUFFIX = ".json"  # of an earlier comparison that a criterion names
YARDSTICK = "yardstick"


@dataclass(frozen=True)
class Asked:
    """What a comparison is of: its models, the outputs that are scored (slopes too), its recordings and first mode;
    changed : whether it is a variant whose models are not those of the scenario."""

    entrants: Sequence[Entrant]
    outputs: Sequence[Signal]
    records: Sequence[Record]
    mode: str
    changed: bool = False

    @classmethod
    def of(cls, comparison: Comparison) -> Asked:
        return cls(comparison.entrants, comparison.outputs, comparison.records, comparison.modes[0])

    @property
    def models(self) -> tuple[str, ...]:
        return tuple(e.name for e in self.entrants)

    def given_by(self, model: str) -> dict[str, str]:
        """The scored outputs of a model, and what each is made from: a slope from its output."""
        own = {s.name: s for e in self.entrants if e.name == model for s in e.outputs}
        made = {name: name for name in own} | {rate_signal(s).name: name for name, s in own.items()}
        return {s.name: made[s.name] for s in self.outputs if s.name in made}

    def recorded(self, name: str, group: str = "") -> bool:
        """Whether a recording, of a group, holds a signal."""
        chosen = of_group(self.records, group)
        return any(name in r.signals for r in self.records if r.name in chosen)

    def testable(self, one: Criterion, given: Mapping[str, str]) -> bool:
        """Whether recordings of its group hold its output, and the model gives it that it is held against."""
        other = self.given_by(one.than) if one.than in self.models else given
        return self.recorded(given[one.output], one.group) and one.output in other

    def banded(self, model: str, output: str) -> bool:
        """Whether a model has a band of an output in the mode that is judged."""
        (one,) = (e for e in self.entrants if e.name == model)
        own = any(s.name == f"{output}{SD}" for s in one.outputs)
        return own or (self.mode == FREE_RUN and any(b.output == output for b in one.bands))


def judged_model(asked: Asked, name: str) -> str:
    """The name where there is such a model, or the first that is no yardstick. Raises DeclarationError."""
    real = [e.name for e in asked.entrants if e.kind != YARDSTICK]
    return _known(name, asked.models, "judge") if name else (real or list(asked.models))[0]


def check_wanted(wanted: Wanted, asked: Asked) -> None:
    """Refuse before a long run what could not be judged after it.

    Raises DeclarationError for a criterion that says nothing about this comparison, DataError for an earlier comparison
    that cannot be read.
    """
    model = judged_model(asked, wanted.model)
    for text in wanted.accept:
        for one in criteria_about(text, asked, model):
            if one.than.endswith(SUFFIX):
                _check_file(one, earlier(wanted.folder(text) / one.than), asked, model)
    if wanted.against:
        earlier(wanted.against).check_recordings(asked.records)


def criteria_about(text: str, asked: Asked, model: str) -> tuple[Criterion, ...]:
    """What a sentence asks of a model: one criterion, or one for each output of an overall one.

    Those are the scored outputs that the model gives, and the one that it is held against, and that a recording holds
    which the sentence is about. Raises as `criteria_of` and `check_criterion`.
    """
    given = asked.given_by(model)
    every = [s for s in asked.outputs if s.name in given and asked.recorded(given[s.name])]
    found = criteria_of(text, asked.outputs, every)
    if not found:
        raise DeclarationError(
            f"accept: '{text}': {model} gives no output that a recording holds, so nothing can test it. It gives "
            f"{', '.join(given) or 'nothing scored'}."
        )
    if found[0].overall:
        found = tuple(one for one in found if asked.testable(one, given)) or found[:1]
    for one in found:
        check_criterion(one, asked, model)
    return found


def left_out(found: Sequence[Criterion], asked: Asked, model: str) -> str:
    """Scored outputs that an overall criterion is not about, and why, in words; empty where there is none."""
    about = {one.output for one in found}
    rest = [s.name for s in asked.outputs if s.name not in about]
    if not found[0].overall or not rest:
        return ""
    given, other = asked.given_by(model), found[0].than
    lacking = [n for n in rest if n not in given]
    held = [n for n in rest if n in given and other in asked.models and n not in asked.given_by(other)]
    told = [(lacking, f"{model} does not give"), (held, f"{other} does not give")]
    told.append(([n for n in rest if n not in (*lacking, *held)], "no recording of it holds"))
    return "; ".join(f"not judged on {some_of(names)}, which {why}" for names, why in told if names)


def check_criterion(one: Criterion, asked: Asked, model: str) -> None:
    """Raises DeclarationError for a criterion that no recording, no model or no mode can test."""
    if one.group and not of_group(asked.records, one.group):
        known = [*(r.name for r in asked.records), *groups(asked.records)]
        if re.match(r"variant\s*=", one.group):
            raise DeclarationError(
                f"accept: '{one.text}': the scenario has no variants. Leave '{one.group}:' out, or say what a variant "
                "changes: [variants.NAME]."
            )
        if one.group in {s.name for s in asked.outputs}:
            raise DeclarationError(
                f"accept: '{one.text}': {one.group} is an output, and recordings stand before a colon. Write "
                f"{one.group}.{one.metric}."
            )
        lost = next((tag for tag in each_tag(one.group) if not of_group(asked.records, tag)), "")
        if not lost:
            raise DeclarationError(
                f"accept: '{one.text}': there are recordings of each of these tags, and none of all at once. They have "
                f"{'; '.join(dict.fromkeys(_tags_of(r) for r in asked.records if r.tags))}."
            )
        raise DeclarationError(f"accept: '{one.text}': no recordings '{lost}'. {nearest(lost, known)}")
    _check_name(one, asked)
    _check_model(one, asked, model)
    if one.than and not one.than.endswith(SUFFIX):
        _check_other(one, asked, model)
    made_from = asked.given_by(model)[one.output]
    if not asked.recorded(made_from, one.group):
        raise DeclarationError(
            f"accept: '{one.text}': none of the recordings it is about holds {made_from}, so nothing can test it. "
            "Judge an output that was recorded, or other recordings."
        )
    if asked.mode != FREE_RUN and (one.metric == "iso18571" or made_from != one.output):
        what = one.metric if one.metric == "iso18571" else one.output
        raise DeclarationError(
            f"accept: '{one.text}': {what} is scored in free run only, and judged is the first mode, {asked.mode}. Put "
            "'free run' first."
        )


def _tags_of(record: Record) -> str:
    return ", ".join(f"{tag}={value}" for tag, value in record.tags.items())


def _check_other(one: Criterion, asked: Asked, model: str) -> None:
    """What a model is held against is another one, of this comparison: against itself everything or nothing holds."""
    _check_model(one, asked, _known(one.than, asked.models, f"accept: '{one.text}'"))
    if one.than == model:
        others = [name for name in asked.models if name != model]
        way = f"against {some_of(others)}, or judge another (--judge)" if others else "against a model beside it"
        raise DeclarationError(
            f"accept: '{one.text}' holds for {'nothing' if one.by < 0 else 'everything'}: {model} is the model that is "
            f"judged, and would be held against itself. Hold it {way}."
        )


def _check_name(one: Criterion, asked: Asked) -> None:
    """A name that several recordings have, or that is a tag of others, says of none of them that it is meant."""
    if (chosen := of_group(asked.records, one.group)) and one.group in {r.name for r in asked.records} - set(chosen):
        raise DeclarationError(
            f"accept: '{one.text}': {one.group} is the name of one recording and a tag of {some_of(chosen)}. Rename "
            "the file, or give those another tag and judge by that."
        )
    own = {r.name: _given_name(r, [other.name for other in asked.records]) for r in asked.records}
    same = [name for name, given in own.items() if given == own.get(one.group)]
    if len(same) > 1:
        raise DeclarationError(
            f"accept: '{one.text}': more than one recording is called {own[one.group]}: they stand as "
            f"{', '.join(same)}, in the order in which they were given. Rename the files, or give them a tag and judge "
            "by that."
        )


def _given_name(record: Record, names: Sequence[str]) -> str:
    """The name before it was told apart from others: that of ``run (2)``, of another folder's run.csv, is ``run``."""
    plain = re.sub(r" \(\d+\)$", "", record.name)
    renamed = Path(record.source).stem == plain if record.source else plain in names
    return plain if renamed else record.name


def _check_model(one: Criterion, asked: Asked, model: str) -> None:
    """What a model does not give, nothing can judge."""
    given = asked.given_by(model)
    if one.output not in given:
        raise DeclarationError(
            f"accept: '{one.text}': {model} gives no {one.output}. It gives {', '.join(given) or 'nothing scored'}."
        )
    if METRICS[one.metric].of_band and given[one.output] != one.output:
        measured = ", ".join(f"{name}.{one.metric}" for name, made in given.items() if name == made)
        raise DeclarationError(
            f"accept: '{one.text}': {one.output} is a slope, and bands are of what sensors read. Judge {measured}, "
            "each by a criterion of its own."
        )
    if METRICS[one.metric].of_band and not asked.banded(model, one.output):
        banded = [e.name for e in asked.entrants if asked.banded(e.name, one.output)]
        have = f"Those with one: {', '.join(banded)}." if banded else "`identify` gives a model one."
        if asked.changed:
            have = f"Values that a variant changes are of no fit. Ask it of another: 'variant=base: {one.text}'."
        raise DeclarationError(
            f"accept: '{one.text}': {model} has no band of {one.output} in {asked.mode} to take {one.metric} of. {have}"
        )


def _check_file(one: Criterion, found: Earlier, asked: Asked, model: str) -> None:
    if one.metric not in SCORED:
        raise DeclarationError(
            f"accept: '{one.text}': an earlier comparison does not hold {one.metric}. Compare one of "
            f"{', '.join(name for name in ERRORS if name in SCORED)}."
        )
    found.check_recordings(asked.records)
    found.check_key(one.text, (model, one.output, asked.mode))


def _known(name: str, models: Sequence[str], where: str) -> str:
    if name not in models:
        raise DeclarationError(f"{where}: no model '{name}' in this comparison. {nearest(name, models)}")
    return name
