"""Standing: what the scores of all fits say together. Verdict, class and probabilities are read from nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hydrotwin.models.effects import Candidate

from ..evidence.deciding import DECIDING
from ..evidence.posterior import NOTHING, Key, Posterior
from .table import Entry, Table


@dataclass(frozen=True, eq=False)
class Standing:
    """What a table says.

    verdict : "none", "named", "class" or "unknown". best : the most probable structure with an effect; None without
    any. order : its effects, the one that explains most alone first. class_ : structures that are told together.
    """

    table: Table
    posterior: Posterior
    verdict: str
    best: Entry | None
    order: tuple[Candidate, ...]
    class_: tuple[Key, ...]

    @property
    def kept(self) -> Entry:
        """The structure that the answer adds: the best where it is named, else the base."""
        return self.best if self.verdict in ("named", "class") else self.table.entries[NOTHING]

    def probability(self, label: str) -> float:
        """That this effect is missing: of all structures that hold it."""
        return sum(p for key, p in self.posterior.structures.items() if label in key)

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
        """Probabilities of nothing, of every structure that is likely enough to tell, and of something else."""
        known = self.posterior.structures
        likely = {
            " + ".join(k): known[k] for k in self.posterior.ranked() if k != NOTHING and known[k] >= DECIDING.told
        }
        return {"nothing": known.get(NOTHING, 0.0), **likely, "something else": self.posterior.else_}


def standing(table: Table) -> Standing:
    """What the fits of a table say."""
    posterior, scores = table.posterior(), table.scores()
    effects: Mapping[Key, float] = {k: p for k, p in posterior.structures.items() if k != NOTHING}
    best = table.entries[max(effects, key=lambda k: (effects[k], -scores[k]))] if effects else None
    nothing = posterior.structures.get(NOTHING, 0.0)
    class_ = tuple(k for k in posterior.class_() if k != NOTHING)
    if nothing >= max(posterior.else_, sum(effects.values())):
        verdict = "none"
    elif posterior.else_ > sum(effects.values()):
        verdict = "unknown"
    else:
        several = {tuple(sorted(c.id for c in table.entries[k].members)) for k in class_}
        verdict = "class" if len(several) > 1 else "named"
    order = tuple(sorted(best.members, key=lambda c: _alone(table, c))) if best else ()
    return Standing(table, posterior, verdict, best, order, class_)


def _alone(table: Table, candidate: Candidate) -> float:
    """What an effect leaves alone, nats; where it was not fitted alone, more than any."""
    entry = table.entries.get((candidate.label,))
    return table.score(entry) if entry and entry.fitted else float("inf")
