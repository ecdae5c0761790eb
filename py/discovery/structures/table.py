"""The table: every structure that was looked at or fitted, and what is known of it. The answer is read from it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.models.language.model import Model

from ..evidence.deciding import DECIDING
from ..evidence.posterior import NOTHING, Key, Posterior, Prices, posterior, temperature
from ..evidence.score import Floor, Spectrum, by_output, least, score, sharper
from ..fits.job import Fitted, Look, Question
from .starts import compatible


@dataclass(eq=False)
class Entry:
    """One structure. look, fitted : None until they are made; failed : why it cannot be fitted.

    beside : after a few steps from where the best structure ended, in the place of one of its effects, the share of
    what the others of its effects leave alone after as many; nan where nobody asked. foreseen : whether that was asked
    to first order alone, without a run: of what the best is foreseen to explain. early : what share of the gap it left,
    or promised to leave, in the beginnings of long recordings, where it was asked alone.
    """

    members: tuple[Candidate, ...]
    look: Look | None = None
    fitted: Fitted | None = None
    failed: str = ""
    beside: float = np.nan
    foreseen: bool = False
    early: float = np.nan

    def put_aside(self, share: float, foreseen: bool = False) -> None:
        """Say that it was asked, in all recordings, and what share it leaves."""
        self.beside, self.foreseen, self.early = share, foreseen, np.nan

    @property
    def key(self) -> Key:
        return tuple(c.label for c in self.members)

    @property
    def open(self) -> bool:
        """Whether there is still something to try."""
        return not (self.fitted or self.failed)

    @property
    def seen(self) -> bool:
        """Whether anything is known of it."""
        return bool(self.look or self.fitted or self.failed or self.asked or not np.isnan(self.early))

    @property
    def asked(self) -> bool:
        """Whether it was tried from where the best structure ended."""
        return not np.isnan(self.beside)


@dataclass(eq=False)
class Table:
    """The base, its candidates, and entries by key (labels in the order of the catalogue).

    coloured : (ny,), SI, what of the noise is not white; told : outputs (ny,) whose noise the user gave.
    foreseen : by key, a fit and what is expected of every other effect in addition, by label, see `foreseen`.
    """

    base: Model
    free: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    question: Question
    coloured: np.ndarray
    told: np.ndarray
    entries: dict[Key, Entry] = field(default_factory=dict)
    foreseen: dict[Key, tuple[Fitted, dict]] = field(default_factory=dict)
    _models: dict[Key, Model] = field(default_factory=dict)

    def entry(self, members: Iterable[Candidate] = ()) -> Entry:
        """The entry of a structure, new where there is none."""
        new = self.possible(members)
        return self.entries.setdefault(new.key, new)

    def possible(self, members: Iterable[Candidate]) -> Entry:
        """An entry of a structure that the table need not hold."""
        order = {c.label: i for i, c in enumerate(self.candidates)}
        return Entry(tuple(sorted(members, key=lambda c: order[c.label])))

    def key(self, members: Iterable[Candidate]) -> Key:
        """The key of a structure, which may have no entry."""
        labels = {c.label for c in members}
        return tuple(c.label for c in self.candidates if c.label in labels)

    def model(self, entry: Entry) -> Model:
        """The base with the effects of a structure."""
        if entry.key not in self._models:
            additions = [c.addition for c in entry.members]
            self._models[entry.key] = self.base.plus(additions, sought=True) if additions else self.base
        return self._models[entry.key]

    def names(self, entry: Entry) -> tuple[str, ...]:
        """Free parameters of a structure, by path."""
        return tuple(dict.fromkeys([*self.free, *(n for c in entry.members for n in c.free)]))

    def of_its_own(self, entry: Entry, values: Mapping[str, float]) -> dict[str, float]:
        """Of values by path, those of parameters that the model of a structure has."""
        names = {p.name for p in self.model(entry).flat.parameters}
        return {n: v for n, v in values.items() if n in names}

    def parameters(self, entry: Entry) -> int:
        """Free parameters beside those of the base."""
        return len(self.names(entry)) - len(self.free)

    def parts(self, entry: Entry) -> list[Entry]:
        """Known structures with some of its effects, nothing included, fitted."""
        return [e for e in self.entries.values() if e.fitted and set(e.key) < set(entry.key)]

    def better_part(self, entry: Entry) -> Entry | None:
        """A structure that this one contains and that leaves less."""
        best = min(self.parts(entry), key=self.score, default=None)
        return best if best and self.score(best) < self.score(entry) - 1.0 else None

    def seen_all(self) -> bool:
        """Whether every single effect was looked at, fitted, or cannot be."""
        return self._seen() == len(self.candidates)

    def look_anew(self) -> None:
        """Forget what was seen beside the base as it was before, or through other windows: it compares with nothing."""
        self.foreseen.clear()
        for entry in self.entries.values():
            if entry.members:
                entry.look = None

    def _seen(self) -> int:
        alone = (self.entries.get((c.label,)) for c in self.candidates)
        return sum(bool(e and e.seen) for e in alone)

    def instead(self, best: Entry, one: Candidate) -> list[tuple[Candidate, ...]]:
        """Members of structures that have another effect in the place of ``one`` of the best's."""
        rest = tuple(m for m in best.members if m is not one)
        others = (c for c in self.candidates if c not in best.members)
        return [(*rest, c) for c in others if compatible((*rest, c))]

    def unseen(self) -> float:
        """How many structures that explain all are to be expected among those that nobody looked at.

        As large a share as of others, beside the one that is right. Where some explain all, others were looked at if
        they were asked from where one of fewest effects ended, for which most were: from a base that is bent even the
        right one may promise nothing.
        Source: Jeffreys, Proc. R. Soc. A 186 (1946).
        """
        scores, enough = self.scores(), self._enough()
        right = [e for e in self.fitted if e.members and scores[e.key] < enough]
        if not right:
            return (len(self.candidates) - self._seen()) / (2 * self._seen() + 2)
        fewest = min(len(e.key) for e in right)
        return min(self._unasked(e, right) for e in right if len(e.key) == fewest)

    def _unasked(self, best: Entry, right: Sequence[Entry]) -> float:
        """The same of structures that have another effect in the place of one of a structure's that explains all."""
        others = [self.entries.get(self.key(members)) for one in best.members for members in self.instead(best, one)]
        seen = 1 + sum(bool(e and (e.fitted or e.failed or e.asked)) for e in others)
        twins = sum(e in others for e in right)
        return (len(others) + 1 - seen) * (twins + 0.5) / (seen + 1)

    # -- what the fits say ---------------------------------------------------------------------------------------
    @property
    def fitted(self) -> list[Entry]:
        return [e for e in self.entries.values() if e.fitted]

    @property
    def noise(self) -> np.ndarray:
        """Of the sensors (ny,), SI, as all fits together show it."""
        return sharper(self.question.noise, [e.fitted.left for e in self.fitted], self.told, self.coloured)

    def floor(self, law: float = 0.0) -> Floor:
        """What a right structure, whose law differs by this share, may leave of whole recordings."""
        base, noise = self.entries.get(NOTHING), self.noise
        known = base.fitted.left.variance if law and base and base.fitted else None
        known = known if known is not None and np.isfinite(known).all() else None
        return Floor(noise, self.coloured, known, law, least([e.fitted.left for e in self.fitted], noise))

    def score(self, entry: Entry) -> float:
        """S of a fit, nats."""
        return score(entry.fitted.left, self.floor(DECIDING.law if entry.members else 0.0))

    def scores(self, law: float = DECIDING.law) -> dict[Key, float]:
        """S of every fit, nats; the base has no law."""
        own, others = self.floor(), self.floor(law)
        return {e.key: score(e.fitted.left, others if e.members else own) for e in self.fitted}

    @property
    def temperature(self) -> float:
        """Nats of difference in score that count as one."""
        base = self.entries.get(NOTHING)
        return temperature(self.score(base) if base and base.fitted else 0.0)

    def explained(self, by: Sequence[Entry] = ()) -> bool:
        """Whether one of these structures, else any, leaves no more than what names would cost."""
        scores, enough = self.scores(), self._enough()
        return any(scores[e.key] < enough for e in (by or self.fitted))

    def _enough(self) -> float:
        return self.temperature * self.prices.of(1, 1) / 2

    def usable(self, entry: Entry) -> bool:
        """Whether the model of a structure can be made; it failed if not."""
        try:
            _ = self.model(entry).flat
        except HydrotwinError as error:
            entry.failed = str(error)
        return not entry.failed

    def keep_better(self, entry: Entry, found: Fitted | str) -> None:
        """Take a further fit of a structure where it leaves less; one that failed says why there is none."""
        before = entry.fitted
        if not isinstance(found, Fitted):
            entry.failed = entry.failed or ("" if before else found)
            return
        score = self.score(entry) if before else np.inf
        entry.fitted, entry.failed = found, ""  # from another start it may have diverged
        entry.fitted = found if self.score(entry) < score else before

    @property
    def prices(self) -> Prices:
        return Prices(len(self.candidates), int(self.question.counts.sum()))

    def posterior(self) -> Posterior:
        """What all fits together say."""
        parameters = {e.key: self.parameters(e) for e in self.fitted}
        rough, beside = self.scores(DECIDING.rough), self.scores(DECIDING.beside)
        return posterior(self.scores(), rough, beside, parameters, self.prices, self.unseen())

    # -- what the windows promise ----------------------------------------------------------------------------------
    def promise(self, entry: Entry, most: int | None = None) -> float:
        """Share of what the base leaves that a structure leaves in windows as long; else in its fit, 1 without one.

        most : of how many lengths the last is meant at most, or the first that it went through; None: of all of these.
        """
        if entry.look is None or self.entries[NOTHING].look is None:
            return self.share(entry) if entry.fitted and entry.members else 1.0
        if entry.look.left is not None:
            base = self.entries[NOTHING].look.left
            whole = score(base, Floor(self.noise, self.coloured))
            left = score(entry.look.left, Floor(self.noise, self.coloured, base.variance))
            return left / whole if whole > 0 else 1.0
        stage = max(min(entry.look.end, most or entry.look.end) - 1, entry.look.begin)
        before, left = self.base_in_windows(stage), self._left(entry.look, stage)
        whole = self._in_windows(before)
        return self._in_windows(left, before, before.counts) / whole if whole > 0 else 1.0

    def was_right(self, entry: Entry, share: float) -> bool:
        """Whether a structure leaves no more than a ``share`` in windows of some length that show what is missing."""
        stages = range(entry.look.begin, entry.look.end if entry.look.left is None else entry.look.begin)
        return any(self.visible(k) > DECIDING.visible and self.promise(entry, k + 1) < share for k in stages)

    def visible(self, stage: int) -> float:
        """S of what the base leaves in windows of one length, nats."""
        return self._in_windows(self.base_in_windows(stage))

    def in_windows(self, look: Look, stage: int) -> float:
        """S of what a look leaves in windows of one length, nats."""
        return self._in_windows(self._left(look, stage))

    def base_in_windows(self, stage: int) -> Spectrum:
        """What the base leaves in windows of one length, and never more than the mean of an output would."""
        left = self._left(self.entries[NOTHING].look, stage)
        y = np.concatenate([r.y for r in self.question.fit])
        spread = np.array([np.nanvar(c) if np.isfinite(c).any() else 0.0 for c in y.T])
        return Spectrum(np.minimum(left.squares, spread * left.counts), left.counts)

    @staticmethod
    def _left(look: Look, stage: int) -> Spectrum:
        k = stage - look.begin
        return Spectrum(look.squares[k : k + 1], look.counts[k : k + 1])

    def _in_windows(self, left: Spectrum, base: Spectrum | None = None, counts: np.ndarray | None = None) -> float:
        """S in windows, as if they were as many as hold so many values."""
        each = by_output(left, Floor(self.question.noise, np.zeros_like(self.coloured), base and base.variance))
        times = 1.0 if counts is None else np.max(counts) / max(np.max(left.counts), 1.0)
        return float(np.nansum(each)) * float(times)

    def share(self, entry: Entry) -> float:
        """Share of what the base leaves of whole recordings that a fitted structure leaves."""
        base = self.score(self.entries[NOTHING])
        return self.score(entry) / base if base > 0 else 0.0
