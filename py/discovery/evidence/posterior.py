"""The posterior over nothing, every structure that was fitted, and something else.

    p(structure) ~ [(1 - r) exp(-S / T) + r exp(-S_rough / T)] N^-m n^(-k/2),    T = max(1, tempered S_base)

m effects cost one name each out of N candidates, k parameters half the logarithm of n measured values each (BIC). No
law is exactly the machine's: of a large gap two right structures leave shares that say nothing, so scores count in
units of T. With the prior probability r the law of what is missing is only roughly the catalogue's, and S_rough allows
for that. Something else would leave nothing, at the price of the best structure, and has a small prior. Beside it the
law of an effect is seen through what else is missing, so there structures are compared by exp(-S_beside / T). Effects
that nobody looked at have priors, too: some of them may explain all, at the price of the best structure.
Source: G. Schwarz, Annals of Statistics 6 (1978); P. Grunwald, Bayesian Analysis 12 (2017) (tempered likelihood).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .deciding import DECIDING

Key = tuple[str, ...]
NOTHING: Key = ()


@dataclass(frozen=True)
class Prices:
    """What names and parameters cost: N candidates, n measured values."""

    candidates: int
    values: int

    def of(self, effects: int, parameters: int) -> float:
        """Nats that a structure with so many effects and parameters of theirs costs."""
        return effects * np.log(max(self.candidates, 2)) + 0.5 * parameters * np.log(max(self.values, 2))


@dataclass(frozen=True)
class Posterior:
    """Probabilities of structures by key (labels of their effects), the empty one nothing; ``else_`` something else.

    unseen : that an effect is missing which nobody looked at.
    beside : logarithms of the weights of structures with effects beside something else, as far as they compare.
    """

    structures: Mapping[Key, float]
    else_: float
    beside: Mapping[Key, float]
    unseen: float = 0.0

    @property
    def best(self) -> Key:
        """The most probable structure, nothing included."""
        return max(self.structures, key=self.structures.__getitem__)

    def ranked(self) -> list[Key]:
        """Structures, the most probable first."""
        return sorted(self.structures, key=self.structures.__getitem__, reverse=True)

    def class_(self) -> list[Key]:
        """The smallest set that holds most of the probability of what is known, of structures worth telling."""
        return likeliest(self.structures)


def likeliest(probabilities: Mapping[Key, float]) -> list[Key]:
    """The smallest set that holds most of the sum of probabilities, of structures worth telling, likeliest first."""
    known, held, members = sum(probabilities.values()), 0.0, []
    for key in sorted(probabilities, key=probabilities.__getitem__, reverse=True):
        if held >= DECIDING.in_class * known or (members and probabilities[key] < DECIDING.told * known):
            break
        members.append(key)
        held += probabilities[key]
    return members


def temperature(base: float) -> float:
    """Nats of difference in score that count as one."""
    return max(1.0, DECIDING.tempered * base)


def posterior(
    scores: Mapping[Key, float],
    rough: Mapping[Key, float],
    beside: Mapping[Key, float],
    parameters: Mapping[Key, int],
    prices: Prices,
    unseen: float = 0.0,
) -> Posterior:
    """Of scores S, S_rough and S_beside by key; those of the base, the empty key, must be among them.

    unseen : how many effects that explain all are to be expected among those that nobody looked at.
    """
    keys = [k for k in scores if np.isfinite(scores[k])] or [NOTHING]
    T = temperature(scores[NOTHING])
    costs = {k: prices.of(len(k), parameters[k]) for k in keys}
    r = DECIDING.rarely
    logs = {k: np.logaddexp(np.log(1 - r) - scores[k] / T, np.log(r) - rough[k] / T) - costs[k] for k in keys}
    effects = [k for k in keys if k]
    as_dear = costs[max(effects, key=logs.__getitem__)] if effects else prices.of(1, 1)
    known, else_ = np.log(1 - DECIDING.something_else), np.log(DECIDING.something_else) - as_dear
    others = known + np.log(unseen) - as_dear if unseen > 0 else -np.inf
    values = np.array([*(known + logs[k] for k in keys), else_, others])
    weights = np.exp(values - values.max())
    weights /= weights.sum()
    partly = {k: -beside[k] / T - costs[k] for k in effects}
    structures = dict(zip(keys, weights[:-2].tolist(), strict=True))
    return Posterior(structures, float(weights[-2]), partly, float(weights[-1]))
