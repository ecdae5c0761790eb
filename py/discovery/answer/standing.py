"""Standing: what the scores of all fits say together. Verdict, class and probabilities are read from nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.effects import Candidate

from ..evidence.deciding import DECIDING
from ..evidence.gaps import gap_closed
from ..evidence.posterior import NOTHING, Key, Posterior, likeliest
from ..structures.table import Entry, Table

UNSEEN = "not looked at"  # the key of effects that nobody looked at, among probabilities


@dataclass(frozen=True, eq=False)
class Standing:
    """What a table says.

    verdict : "none", "named", "class" or "unknown", whichever is most probable; what nobody looked at is unknown, too,
    even where the best explains all: others may explain as much. best : the most probable structure with an effect,
    beside something else where that is more probable; None without any. order : its effects, the one that explains most
    alone first. class_ : structures that are told together. part : whether the best, which does not explain all, is a
    part of what is missing; not before every single effect was looked at, for another may be the whole of it if this
    leaves much, nor where others may as well be that part. parts : probabilities of structures by key if one is.
    """

    table: Table
    posterior: Posterior
    verdict: str
    best: Entry | None
    order: tuple[Candidate, ...]
    class_: tuple[Key, ...]
    part: bool = False
    parts: Mapping[Key, float] = field(default_factory=dict)

    @property
    def unasked(self) -> bool:
        """Whether the best explains all, and what nobody looked at may well do so, too."""
        return self.best is not None and _unasked(self.table, self.posterior, self.best)

    @property
    def kept(self) -> Entry:
        """The structure that the answer adds: the best where it is named, else the base."""
        return self.best if self.verdict in ("named", "class") or self.part else self.table.entries[NOTHING]

    def probability(self, label: str) -> float:
        """That this effect is missing: of all structures that hold it, and beside something else where it is a part."""
        known = (self.posterior.structures, self.parts)
        alone, beside = (sum(p for k, p in some.items() if label in k) for some in known)
        return alone + DECIDING.partly * self.posterior.else_ * beside * self.part

    def members(self, effect: Candidate) -> list[Candidate]:
        """What may stand in the place of a named effect, itself first."""
        rest = set(self.best.key) - {effect.label}
        found = [effect]
        for key in self.class_:
            others = [c for c in self.table.entries[key].members if c.label not in rest]
            if rest <= set(key) and len(others) == 1 and others[0].label != effect.label:
                found.append(others[0])
        return found

    def told(self) -> dict[str, float]:
        """Probabilities of nothing, of structures likely enough to tell, of what was not looked at, something else."""
        known = self.posterior.structures
        likely = {
            " + ".join(k): known[k] for k in self.posterior.ranked() if k != NOTHING and known[k] >= DECIDING.told
        }
        unseen = {UNSEEN: self.posterior.unseen} if self.posterior.unseen else {}
        return {"nothing": known.get(NOTHING, 0.0), **likely, **unseen, "something else": self.posterior.else_}


def standing(table: Table) -> Standing:
    """What the fits of a table say."""
    posterior, scores = table.posterior(), table.scores()
    effects: Mapping[Key, float] = {k: p for k, p in posterior.structures.items() if k != NOTHING}
    best = table.entries[max(effects, key=lambda k: (effects[k], -scores[k]))] if effects else None
    nothing = posterior.structures.get(NOTHING, 0.0)
    class_, part, parts = tuple(k for k in posterior.class_() if k != NOTHING), False, {}
    if nothing >= max(posterior.else_, sum(effects.values())):
        verdict = "none"
    elif max(posterior.else_, posterior.unseen) > sum(effects.values()):
        verdict = "unknown"
        if best is not None and not _unasked(table, posterior, best):
            best = table.entries[max(effects, key=posterior.beside.__getitem__)]
            parts = _beside_something_else(table, posterior, best)
            asked = sum(parts.values()) > 0.5  # what was fitted is likelier than what promises as much and was not
            looked = table.seen_all() or table.explained([best])
            part = looked and asked and closed(table, best) >= DECIDING.part
            class_ = tuple(likeliest(parts))
    else:
        several = {tuple(sorted(c.id for c in table.entries[k].members)) for k in class_}
        verdict = "class" if len(several) > 1 else "named"
    order = tuple(sorted(best.members, key=lambda c: _alone(table, c))) if best else ()
    return Standing(table, posterior, verdict, best, order, class_, part, parts)


def _unasked(table: Table, posterior: Posterior, best: Entry) -> bool:
    return posterior.unseen > posterior.else_ and table.explained([best])


def _beside_something_else(table: Table, posterior: Posterior, best: Entry) -> dict[Key, float]:
    """Probabilities of fitted structures, beside something else that is missing.

    What promises to leave as little as the best leaves, and was not fitted, is as likely.
    """
    logs, level = posterior.beside, table.share(best)
    open_ = [e for e in table.entries.values() if e.open and e.look and 0 < len(e.key) <= len(best.key) and not e.asked]
    rivals = sum(table.promise(e) <= level for e in open_)
    weights = {k: float(np.exp(value - logs[best.key])) for k, value in logs.items()}
    return {k: w / (sum(weights.values()) + rivals) for k, w in weights.items()}


def closed(table: Table, entry: Entry) -> float:
    """Share of the gap of the base that a fit closes, squared errors; nan where it was not fitted."""
    return gap_closed(table.entry().fitted.rmse, entry.fitted.rmse, table.noise) if entry.fitted else float("nan")


def _alone(table: Table, candidate: Candidate) -> float:
    """What an effect leaves alone, nats; where it was not fitted alone, more than any."""
    entry = table.entries.get((candidate.label,))
    return table.score(entry) if entry and entry.fitted else float("inf")
