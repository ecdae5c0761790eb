"""Choose: which of the refitted candidates is named, what cannot be told from it, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .decide import CLEARLY, T_NEEDED, TOGETHER, Evidence, compared, has_gap
from .refit import Question
from .structure import Tried

TEMPERATURE = 4.0  # by which BIC differences and squares of t are divided, for fits end in neighbouring minima: a guess
UNLIKELY = 2 * TEMPERATURE * np.log(20)  # BIC behind the best: a twentieth of its probability
CREDIBLE = 0.95  # of the probability: what the members of a class hold at least
HELD_OUT = 0.2  # of what the most likely leaves on held-out recordings: what another must close to replace it
EQUAL = 0.05  # of the gap: effects that close it alike, and neither better on held-out recordings, are not told apart
PARALLEL, SAME = 0.98, 0.01  # cosine of what two effects do to the outputs; share of the gap by which they then differ
REFINEMENT = 0.3  # of what the simple effect leaves: what its refinement must close to be preferred


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen candidate(s), the class that explains the recordings as well, and probabilities by label."""

    best: Tried
    members: tuple[Tried, ...]
    probability: dict[str, float]

    def without_first(self, count: int) -> Choice:
        """The same without the first so many members."""
        gone = {label(t) for t in self.members[:count]}
        likely = {name: p for name, p in self.probability.items() if name not in gone}
        total = sum(likely.values())
        return Choice(self.members[count], self.members[count:], {name: p / total for name, p in likely.items()})

    def beside(self, others: Sequence[Tried]) -> Choice:
        """The same with others that may as well be it: together as likely as the best."""
        share = self.probability[label(self.best)] / len(others)
        likely = {**self.probability, **{label(t): share for t in others}}
        total = sum(likely.values())
        return Choice(self.best, (*self.members, *others), {name: p / total for name, p in likely.items()})


def choose(tried: Sequence[Tried], library: int, q: Question) -> Choice | None:
    """The best of the candidates that pass; None when none does."""
    passing = [t for t in tried if t.evidence and t.evidence.passes(library) and not t.implausible]
    if not passing:
        return None
    best = _best_and_simplest(passing, q)
    likely = max(passing, key=lambda t: _score(t, q))  # the best, unless held-out recordings say otherwise
    told = [t for t in passing if t is best or not (t.reason or _idly_refined(t, best, passing, q))]
    weight = {label(t): _weight(t, best, q) for t in told}
    total = sum(weight.values())
    probability = {name: w / total for name, w in weight.items()}
    credible = _credible(told, probability)
    alike = [t for t in told if t in credible or t is likely or as_good(t, best, q) or as_good(t, likely, q)]
    members = [best, *(t for t in alike if t is not best)]
    members[1:] = sorted(members[1:], key=lambda t: -probability[label(t)])
    return Choice(best, tuple(members), probability)


def label(tried: Tried) -> str:
    """``id at site``, several joined by `` + ``."""
    return " + ".join(c.label for c in tried.members)


def _credible(tried: Sequence[Tried], probability: Mapping[str, float]) -> list[Tried]:
    """The most probable that together hold nearly all of the probability."""
    found, held = [], 0.0
    for t in sorted(tried, key=lambda t: -probability[label(t)]):
        if held >= CREDIBLE:
            break
        found.append(t)
        held += probability[label(t)]
    return found


def _best(passing: Sequence[Tried], q: Question) -> Tried:
    """The most likely on the fit recordings, unless another is clearly better on those held out.

    Of those that leave no more than the inexact form of what is named does by itself, one of the fewest effects: how
    far below that they come says how well each hides it, and the finer form of a named effect asks for nothing more.
    """
    best = max(passing, key=lambda t: _score(t, q))
    rivals = [(compared(t.structure.fitted, best.structure.fitted, q), t) for t in passing if t is not best]
    better = [(over.closed, t) for over, t in rivals if over.paired_t > T_NEEDED and over.closed > HELD_OUT]
    best = max(better, key=lambda pair: pair[0])[1] if better else best
    if not (q.inexact and _explains(best, q)):
        return best
    return min((t for t in passing if _explains(t, q)), key=lambda t: (len(t.structure.members), -_score(t, q)))


def _score(tried: Tried, q: Question) -> float:
    fitted = tried.structure.fitted
    return -2 * fitted.likelihood - fitted.parameters * np.log(max(q.counts.sum(), 2))


def _best_and_simplest(passing: Sequence[Tried], q: Question) -> Tried:
    """The best, a refinement only where it is worth it over the simple effect."""
    left = list(passing)
    while True:
        best = _best(left, q)
        simple = [t for t in left if refines(best, t)]
        if all(worth_refining(compared(best.structure.fitted, t.structure.fitted, q)) for t in simple):
            return best
        left.remove(best)


def worth_refining(over: Evidence) -> bool:
    """Whether a refinement explains clearly more than the simple effect."""
    return over.bic_gain > TOGETHER and over.paired_t > T_NEEDED and over.closed > REFINEMENT


def refines(tried: Tried, other: Tried) -> bool:
    """Whether it contains a refinement of the other, which is a single effect."""
    return len(other.members) == 1 and any(c.refines(other.members[0]) for c in tried.members)


def _idly_refined(tried: Tried, best: Tried, passing: Sequence[Tried], q: Question) -> bool:
    """Whether it is the best, or another that passes, with more parameters to no avail: that is no alternative."""
    simple = [t for t in passing if refines(tried, t)]
    idle = (not _more_likely(compared(tried.structure.fitted, t.structure.fitted, q)) for t in simple)
    return best in simple or any(idle)


def _more_likely(over: Evidence) -> bool:
    """Whether a refinement is more likely than the simple effect, and held-out recordings say nothing against it."""
    return over.bic_gain > TOGETHER and not over.paired_t < -T_NEEDED


def as_good(tried: Tried, best: Tried, q: Question) -> bool:
    """Whether the recordings cannot tell it from the best.

    Where the best leaves only noise, the likelihood tells, as far as two fits find their minima. Where it leaves more,
    its equation is not exactly the machine's, and likelihoods that differ by less than a share of the gap decide
    nothing: held-out recordings must, and not between effects that do the same to every output once the base has
    adapted.
    """
    if _late_somewhere(tried, q) and _late_somewhere(best, q):
        return True
    over = compared(best.structure.fitted, tried.structure.fitted, q)
    untold = not over.paired_t > T_NEEDED  # one that is better there, though less likely on the fit, is not told apart
    apart = best.evidence.closed - tried.evidence.closed
    if _exact(best, q):
        return (untold or apart < EQUAL) and abs(over.bic_gain) < UNLIKELY
    alike = apart < SAME and _cosine(tried, best) > PARALLEL
    return alike or (untold and (abs(over.bic_gain) < TOGETHER or apart < EQUAL))


def _exact(best: Tried, q: Question) -> bool:
    """Whether the best leaves nothing but noise of the sensors: then the likelihood tells."""
    return not q.inexact and _explains(best, q)


def _explains(tried: Tried, q: Question) -> bool:
    """Whether it leaves nothing that asks for a reason."""
    fitted = tried.structure.fitted
    return not has_gap((*fitted.residuals_fit, *fitted.residuals_select), q.noise, CLEARLY).any()


def _late_somewhere(tried: Tried, q: Question) -> bool:
    """A delay of the only input that moves or of the only output: time-invariant equations cannot tell which."""
    moving = np.any([np.ptp(r.u, axis=0) > 0 for r in q.fit], axis=0)
    only = moving.sum() == 1 and (q.counts > 0).sum() == 1
    return only and [c.id for c in tried.members] in (["dead_time"], ["sensor_delay"])


def _cosine(one: Tried, other: Tried) -> float:
    """Of what two single effects do to the outputs, beyond what the base parameters do."""
    if one.screened is None or other.screened is None:
        return 0.0
    return float(abs(one.screened.column @ other.screened.column))


def _weight(tried: Tried, best: Tried, q: Question) -> float:
    if tried is best or (_late_somewhere(tried, q) and _late_somewhere(best, q)):
        return 1.0
    over = compared(best.structure.fitted, tried.structure.fitted, q)
    decides = _exact(best, q) or not as_good(tried, best, q)
    return against(over.paired_t, over.bic_gain * decides)


def against(paired_t: float, bic_gain: float = 0.0) -> float:
    """How much less likely one is than another that is better by so much, 0..1."""
    behind = max(bic_gain, 0.0) + max(np.nan_to_num(paired_t), 0.0) ** 2
    return float(np.exp(-behind / (2 * TEMPERATURE)))
