"""Try every kind of learned model on the same recordings; rank them by how well they run freely on what is held out.

Each kind is trained in a process of its own (`trials`). Of many kinds one is the best by chance: among those that are
as good, by one standard error over the stretches held out (`verdicts`), the one with the fewest numbers is taken. What
is held out chooses here, so the figure of the chosen is a little too good. Where commands repeat, what is held out has
been seen before: there every kind is also trained on the first course of the commands alone (`without_repeats`), judged
at the end of that, and ranked by both. One that knows commands by heart fails there; one that drifts fails over all.

That is a race: the first course, which is short, comes first. Squared errors add up, so one that is already too much
for a kind ever to be as good as the best so far ends its race there, and the ranking says so. It changes no choice.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .block_file import LearnedBlock
from .held_out import Split
from .interruption import INTERRUPTED
from .learning import FINISHED, KINDS, check_judges, check_select, held_out_of, unbroken_for, with_card
from .repeats import without_repeats
from .trials import ALWAYS, Asked, Outcome, Trial, Trials
from .verdicts import as_good, may_be_as_good

ALONE = ("hybrid", "dual_gp")  # kinds that need more than recordings with inputs and outputs
FIRST, ALL = "first", "all"  # what is trained on: the first course of the commands, and all recordings
ABREAST = 2  # kinds that go on at a time: two cores are busy, and with one or four the same kinds go on
ONCE = (
    "The commands repeat: kinds were also trained on the first {first:.3g} s of {all:.3g} s alone and judged at "
    "commands there that they had not seen, for at repeated ones what is known by heart seems best."
)
NO_FIRST = "On the first course of the commands alone, it cannot be judged: {why}"
DROPPED = (
    "on the first course of the commands alone it missed {own:.3g} % of the range: whatever it did on all of them, it "
    "could not be as good as {best} ({least:.3g} %), so it was not trained there (--thorough does)."
)
CUT = "The budget cut {kinds}: what they would come to in their time is not known. Give a longer --budget, or none."
FAILED = "Not ranked: {reasons}"
OUT = "Not trained on all, for after the first course nothing could make them as good: {kinds} (see the ranking)."


@dataclass(frozen=True, eq=False)
class Tried:
    """A kind that was tried.

    shares : by output, the RMS error of its free run on what was held out over the output's range. stretches : the same
    by output and stretch. seconds : of the processor. failed : why there is no figure, or no block, a sentence.
    dropped : why it was not trained on all recordings, a sentence; its figures are of the first course alone.
    late : the budget was over before it had an answer.
    """

    kind: str
    block: LearnedBlock | None = None
    shares: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    failed: str = ""
    stretches: Mapping[str, Sequence[float]] = field(default_factory=dict)
    dropped: str = ""
    why: str = ""
    late: bool = False

    @property
    def numbers(self) -> int:
        """How many the block is made of, without zeros: what it takes to write it down."""
        return int(sum(map(np.count_nonzero, self.block.arrays.values()))) if self.block else 0

    @property
    def errors(self) -> list[float]:
        """By stretch, the mean over the outputs; none where there are none of some output."""
        known = len(self.stretches) == len(self.shares) > 0
        return [float(np.mean(part)) for part in zip(*self.stretches.values(), strict=True)] if known else []

    def as_good_as(self, best: Tried) -> bool:
        """Whether chance may be all that makes another one the best."""
        return self is best or bool(self.errors and best.errors and as_good(self.errors, best.errors))

    @property
    def share(self) -> float:
        """Mean over the outputs; infinite where it failed, or where nothing could be held out."""
        return sum(self.shares.values()) / len(self.shares) if self.shares else float("inf")

    @property
    def cut(self) -> bool:
        """Whether the budget ended it, or left it out."""
        ended = self.block is not None and self.block.provenance.get("stopped", FINISHED) not in (FINISHED, INTERRUPTED)
        return ended or self.late

    @property
    def standing(self) -> int:
        """What is judged whole comes first, then what was dropped, then what failed."""
        return 2 if self.failed else 1 if self.dropped else 0

    def told(self) -> dict:
        """For the provenance and JSON."""
        answer = {"kind": self.kind, "seconds": round(self.seconds, 2)}
        answer |= {"numbers": self.numbers} if self.block else {}
        if self.shares:
            answer |= {"percent_of_range": {name: 100 * share for name, share in self.shares.items()}}
        if self.stretches:
            answer["stretches"] = {name: [100 * e for e in part] for name, part in self.stretches.items()}
        answer |= {"dropped": self.dropped} if self.dropped else {}
        answer |= {"cut": True} if self.cut else {}
        return answer | ({"failed": self.failed} if self.failed else {})


def learn_best(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    kinds: Sequence[str] | None = None,
    workers: int | None = None,
    budget: float | None = None,
    thorough: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
    **options,
) -> LearnedBlock:
    """Train every kind as `learn` does, and answer the block that runs best on what was held out.

    Of those that run as well, by one standard error over the stretches held out, it is the one with the fewest numbers.
    ``provenance["ranking"]`` lists all kinds, the best first: share of the range in percent, over all and by stretch;
    numbers of the block; seconds; which are ``as_good`` as the first, which is ``chosen``; why one failed, or was
    ``dropped``: where commands repeat, one whose error on their first course alone is too much to be as good as another
    is not trained on all of them, and its figures are of the first course. The block, and its card, are those of the
    kind trained alone with the same options.

    Args:
        records, inputs, outputs: as in `learn`.
        kinds: names of `KINDS`; None: all that need nothing else.
        workers: processes; None: one per core. Their number changes no answer.
        budget: s on the clock that all trials may take together; None: as long as they take. What is left is shared
            evenly among the kinds still to try; the quick ones come first. A kind that looks at no clock is ended with
            its share, and says so in the ranking. On a busier machine the same budget gives other blocks.
        thorough: drop no kind. The choice is the same; all figures of the ranking are then of whole trainings.
        progress: called with (kinds done, kinds in all, what was found).
        options: those of `learn` that a kind takes are passed on to it (seed, validate, select, name).

    Ctrl-C ends the trials with the best so far. `refitted` trains the chosen kind again on all recordings.

    Raises:
        DataError: no kind could be trained; the sentence of each is in it. DeclarationError: a kind that is not known.
    """
    every = [k for k in KINDS if k not in ALONE]
    chosen = list(dict.fromkeys(kinds)) if kinds is not None else every
    for kind in chosen:
        if kind not in every:
            raise DeclarationError(f"learn auto: no kind '{kind}' to try. {nearest(kind, every)}")
    check_select("auto", records, options.get("select"))
    inputs, outputs = list(inputs), list(outputs)
    records = unbroken_for(records, inputs, outputs)
    validate = list(options.pop("validate", None) or ())
    check_judges(validate, records, inputs, outputs)
    first = without_repeats(records, *([getattr(s, "name", s) for s in part] for part in (inputs, outputs)))
    again = sum(map(len, first)) < sum(map(len, records))
    asked = Asked({FIRST: first, ALL: records} if again else {ALL: records}, inputs, outputs, options)
    found, stopped = _raced(chosen, asked, (workers, budget, thorough), progress)
    ranked = sorted(found, key=lambda t: (t.standing, t.share, t.block is None, chosen.index(t.kind)))
    if not ranked or ranked[0].block is None:
        raise DataError(f"learn auto: no kind could be trained. {_reasons(found)}")
    good = [t for t in ranked if t.block is not None and t.as_good_as(ranked[0])]
    taken = min(good, key=lambda t: t.numbers)
    split = Split(records, why=taken.why) if taken.why else held_out_of(records, inputs, outputs)
    block = with_card(taken.block, split, records, inputs, outputs, validate=validate)
    rows = [t.told() | {"as_good": t in good, "chosen": t is taken} for t in ranked]
    told = {"ranking": rows, "chosen_on": "what was held out of the training recordings"}
    told["free_run"] = _with_what_is_missing(block.provenance["free_run"], ranked)
    if again:
        seconds = {FIRST: sum(r.duration for r in first), ALL: sum(r.duration for r in records)}
        out = ", ".join(t.kind for t in ranked if t.dropped)
        words = [ONCE.format(**seconds), *([OUT.format(kinds=out)] if out else [])]
        card = told["free_run"]
        told["free_run"] = card | {"says": " ".join([card["says"], *words])}
    return replace(block, provenance={**block.provenance, **told, **({"stopped": INTERRUPTED} if stopped else {})})


def _with_what_is_missing(card: Mapping, ranked: Sequence[Tried]) -> dict:
    """The card with what the budget cut, which comes first, and which kinds failed otherwise."""
    cut = [t.kind for t in ranked if t.cut]
    failed = [t for t in ranked if t.failed and not t.cut]
    first = [CUT.format(kinds=", ".join(cut))] if cut else []
    last = [FAILED.format(reasons=_reasons(failed, some=True))] if failed else []
    return {**card, "bad": bool(card["bad"] or cut), "says": " ".join([*first, card["says"], *last])}


def _raced(kinds: Sequence[str], asked: Asked, means: tuple, progress: Callable | None) -> tuple[list[Tried], bool]:
    """What became of each kind that has ended its race, and whether Ctrl-C has ended it for others.

    means : workers, s on the clock (None: one per core, as long as it takes), and whether all are trained on all.
    """
    race = _Race(kinds, list(asked.records), means[2])
    with tempfile.TemporaryDirectory() as folder, Trials(asked, Path(folder), *means[:2]) as trials:
        try:
            for some, later in race.rounds():
                for trial, outcome in trials.outcomes(some, later):
                    race.outcomes[trial] = outcome
                    if progress:
                        ended = race.ended()
                        best = min(ended, key=lambda t: t.share).kind if ended else "none yet"
                        progress(len(ended), len(kinds), f"{trial.kind} ended, best so far {best}")
        except KeyboardInterrupt:
            if not any(t.block for t in race.ended()):
                raise
        found = race.ended()
        return found, len(found) < len(kinds)


class _Race:
    """Which kinds are trained on what: all on what comes first, then those on the rest that may still be as good."""

    def __init__(self, kinds: Sequence[str], parts: Sequence[str], thorough: bool):
        self.kinds, self.parts, self.thorough = list(kinds), list(parts), thorough
        self.outcomes: dict[Trial, Outcome] = {}
        self.dropped: dict[str, str] = {}

    def rounds(self) -> Iterator[tuple[list[Trial], int]]:
        """Trials that are to be made, and how many may follow them; which ones follows from how all before ended."""
        first = [Trial(k, on) for k in self.kinds for on in (self.parts if self._whole(k) else self.parts[:1])]
        yield first, len(self.kinds) * len(self.parts) - len(first)
        while waiting := self._waiting():
            yield [Trial(kind, ALL) for kind in waiting[:ABREAST]], len(waiting[ABREAST:])

    def ended(self) -> list[Tried]:
        """Kinds whose race is over, in the order in which they were asked for."""
        return [self._tried(k) for k in self.kinds if k in self.dropped or Trial(k, ALL) in self.outcomes]

    def _whole(self, kind: str) -> bool:
        """Whether it is trained on everything, whatever the first part says: there is to be an answer."""
        return self.thorough or kind == ALWAYS

    def _waiting(self) -> list[str]:
        """Kinds that go on, the most promising first."""
        left = [k for k in self.kinds if k not in self.dropped and Trial(k, ALL) not in self.outcomes]
        best = min(self.ended(), key=lambda t: t.share, default=None)
        for kind in left:
            self._drop(kind, best)
        left = [k for k in left if k not in self.dropped]
        return sorted(left, key=lambda k: self._of_first(k).share)

    def _drop(self, kind: str, best: Tried | None) -> None:
        """Note why a kind does not go on, where it does not; where nobody can be judged, all do."""
        own = self._of_first(kind)
        if best is None or not best.errors:
            return
        if own.failed:
            self.dropped[kind] = ""
        elif own.share / np.sqrt(2) >= best.share and not may_be_as_good(own.errors, best.errors):
            told = {"own": 100 * own.share, "best": best.kind, "least": 100 * best.share}
            self.dropped[kind] = DROPPED.format(**told)

    def _of_first(self, kind: str) -> Tried:
        one = self.outcomes[Trial(kind, FIRST)]
        why = one.failed or one.why or ("" if one.stretches else "it diverges there.")
        failed = NO_FIRST.format(why=why) if why else ""
        return Tried(kind, None, one.shares, one.seconds, failed, one.stretches, late=one.late)

    def _tried(self, kind: str) -> Tried:
        """What is known of a kind, of all that it was trained on."""
        if FIRST not in self.parts:
            return _of(kind, self.outcomes[Trial(kind, ALL)])
        first = self._of_first(kind)
        if kind in self.dropped:
            return replace(first, dropped=self.dropped[kind])
        last = self.outcomes[Trial(kind, ALL)]
        one = replace(_of(kind, last), seconds=first.seconds + last.seconds, late=first.late or last.late)
        if one.failed or first.failed:  # where there is a block, nothing says how good it is
            return replace(one, shares={}, stretches={}, failed=one.failed or first.failed)
        shares, stretches = _both((one.shares, one.stretches), (first.shares, first.stretches))
        return replace(one, shares=shares, stretches=stretches)


def _of(kind: str, one: Outcome) -> Tried:
    return Tried(kind, one.block, one.shares, one.seconds, one.failed, one.stretches, why=one.why, late=one.late)


def _reasons(found: Sequence[Tried], some: bool = False) -> str:
    """Why kinds failed, each reason once behind all that have it; some : others did not."""
    kinds: dict[str, list[str]] = {}
    for one in found:
        kinds.setdefault(one.failed.removeprefix("learn: "), []).append(one.kind)
    return " ".join(f"{', '.join(own) if some or len(kinds) > 1 else 'all'}: {why}" for why, own in kinds.items())


def _both(one: tuple[dict, dict], other: tuple[dict, dict]) -> tuple[dict, dict]:
    """Two judgements as one: root of the mean square, and the stretches of both."""
    shares = {n: float(np.sqrt((share**2 + other[0].get(n, np.inf) ** 2) / 2)) for n, share in one[0].items()}
    return shares, {n: [*part, *other[1][n]] for n, part in one[1].items() if n in other[1]}
