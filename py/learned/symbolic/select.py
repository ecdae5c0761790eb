"""Which formula it shall be: candidates refitted, judged in their runs and grown, the shortest of the good, pruned."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..interruption import INTERRUPTED
from ..verdicts import as_good, log_ratio
from .block import ADD, CONSTANT, MULTIPLY, VARIABLE, Formula
from .data import Prepared
from .growth import most_telling, terms_for, with_terms
from .refit import Piece, cut
from .text import simplified

STRETCH = 100  # samples of the short free runs in which all candidates are refitted
FEW_STRETCHES = 60  # of these, drawn at random
FEW_SAMPLES = 20_000  # of the whole runs in which all candidates are judged
SHORT, LONG = 8, 30  # evaluations of a refit on stretches and on whole runs
FINALISTS = 8
TRIED = 4  # terms, those with the largest gains, of which one must help where a formula grows
SURE = 2.0  # standard errors over the folds by which a term must help: several are tried, and one helps by chance
LEAST_GAIN = 0.01  # of the squared error of a run: terms that take less are not tried


@dataclass(frozen=True)
class Candidate:
    """A formula of one output with its error where it was judged (RMS in output scales).

    error : infinite where the run diverges; a diverging formula is chosen only where all do. rms : the error as it is.
    folds : the RMS on every fold, where there are several.
    """

    formula: Formula
    error: float
    rms: float
    folds: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """Tokens: operators, functions, variables and constants."""
        return len(self.formula.tokens)

    @property
    def rank(self) -> tuple[float, float, int]:
        """The smallest is the best."""
        return self.error, self.rms, self.size


@dataclass(frozen=True)
class SelectionProgress:
    """After one refit of a candidate: how many are done, and the best free-run error so far, in output scales."""

    output: str
    done: int
    candidates: int
    best: float


@dataclass(frozen=True)
class Choice:
    """How a formula is chosen.

    tolerance : what simplicity may cost, as a share of the error. terms : at most added in free run, of ``functions``.
    until : `time.monotonic()` at which to stop. progress : called with a `SelectionProgress`.
    """

    tolerance: float
    terms: int
    functions: Sequence[str]
    until: float = np.inf
    seed: int = 0
    progress: Callable | None = None


class Selection:
    """The choice of one formula per output.

    stopped : what ended it early, empty when nothing did. fronts : for every output the `Candidate`s, judged on whole
    runs, than which no other is both shorter and better, the shortest first. chosen : the one of each output.
    """

    def __init__(self, data: Prepared, names: Sequence[str], how: Choice):
        self.data, self.brief = data, _brief(data, how.seed)
        self.names, self.how = names, how
        self.stopped = ""
        self.fronts: list[list[Candidate]] = []
        self.chosen: list[Candidate] = []

    def choose(self, found: Sequence[Sequence[Formula]]) -> Formula:
        """The expressions of all outputs, from the formulas ``found`` for each, the best first, and linear ones.

        Of those that are worse than the best by no more than the tolerance, or than the folds tell, the shortest is
        chosen, each output with the others as measured; then all constants are refitted together.
        """
        whole = Formula((), ())
        for i, formulas in enumerate(found):
            judged = self._refitted(distinct([*linear_formulas(self.data, i), *formulas], self.data), i)
            judged = [c for c in judged if np.isfinite(c.error)] or [replace(c, error=c.rms) for c in judged]
            judged = self._grown(judged, i)
            shortest = self._shortest(judged)
            bound = max((1 + self.how.tolerance) * min(c.error for c in judged), shortest.error)
            chosen = self._pruned(shortest, i, bound)
            self.chosen.append(chosen)
            self.fronts.append(pareto([*judged, chosen]))
            whole += chosen.formula
        if len(self.names) == 1 or self.data.static or self.stopped:
            return whole
        try:
            joint = _refit(self.data, whole, range(len(self.names)), LONG)
        except KeyboardInterrupt:
            self.stopped = INTERRUPTED
            return whole
        return min(joint, whole, key=lambda f: judged_errors(self.data, f))

    def _shortest(self, judged: Sequence[Candidate]) -> Candidate:
        """The shortest of those that are as good as the best."""
        best = min(judged, key=lambda c: c.rank)
        bound = (1 + self.how.tolerance) * best.error
        return min((c for c in judged if c.error <= bound or _as_good(c, best)), key=lambda c: (c.size, c.rank))

    def _grown(self, judged: Sequence[Candidate], i: int) -> list[Candidate]:
        """The candidates, and what becomes of the best and of the shortest that is as good with more terms."""
        judged = list(judged)
        if self.data.static:
            return judged
        terms = terms_for(self.data, i, self.how.functions)
        for candidate in dict.fromkeys((min(judged, key=lambda c: c.rank), self._shortest(judged))):
            try:
                for _ in range(self.how.terms):
                    if self._late() or not np.isfinite(candidate.error):
                        break
                    candidate = self._with_one_more(candidate, i, terms)
                    if candidate is None:
                        break
                    judged.append(candidate)
                    self._tell(i, len(judged), len(judged), judged)
            except KeyboardInterrupt:
                self.stopped = INTERRUPTED
        return judged

    def _with_one_more(self, candidate: Candidate, i: int, terms: Sequence) -> Candidate | None:
        """The candidate with the term that takes most from its run and surely helps where it was not fitted."""
        for term, gain in most_telling(self.data, candidate.formula, i, terms, TRIED):
            if gain < LEAST_GAIN or self._late():
                break
            more = self._candidate(with_terms(candidate.formula, [term]), i, brief=False)
            if _better(more, candidate, self.how.tolerance):
                return more
        return None

    def _refitted(self, formulas: Sequence[Formula], i: int) -> list[Candidate]:
        """The best candidates after the refit on whole runs; those after the refit on stretches if time ends."""
        short: list[Candidate] = []
        final: list[Candidate] = []
        try:
            for formula in formulas:
                if short and self._late():
                    break
                short.append(self._candidate(formula, i, brief=True))
                self._tell(i, len(short), len(formulas) + FINALISTS, short)
            finalists = _finalists(short)
            for candidate in finalists:
                if self._late():
                    break
                final.append(self._candidate(candidate.formula, i, brief=False))
                self._tell(i, len(formulas) + len(final), len(formulas) + len(finalists), final)
        except KeyboardInterrupt:
            self.stopped = INTERRUPTED
        return final or short or [Candidate(formulas[0], np.inf, np.inf)]  # short ones are judged on less

    def _pruned(self, candidate: Candidate, i: int, bound: float) -> Candidate:
        """The candidate without the constants it can do without: set to zero, one after the other, and refitted."""
        try:
            while not self._late():
                tried = [self._candidate(f, i, brief=True) for f in _with_one_zero(candidate.formula, self.data)]
                if not tried:
                    break
                best = self._candidate(min(tried, key=lambda c: c.rank).formula, i, brief=False)
                if not best.error <= bound:
                    break
                candidate = best
        except KeyboardInterrupt:
            self.stopped = INTERRUPTED
        return candidate

    def _candidate(self, formula: Formula, i: int, brief: bool) -> Candidate:
        """The formula after a refit; on stretches the one before where it runs better."""
        if not brief:
            return Candidate(_refit(self.data, formula, [i], LONG), *_judged_apart(self.data, formula, i))
        pair = [
            Candidate(f, *judged_errors(self.brief, f, [i])) for f in (_refit(self.brief, formula, [i], SHORT), formula)
        ]
        return min(pair, key=lambda c: c.rank)

    def _late(self) -> bool:
        if not self.stopped and time.monotonic() > self.how.until:
            self.stopped = "time budget of the selection"
        return bool(self.stopped)

    def _tell(self, i: int, done: int, count: int, candidates: Sequence[Candidate]) -> None:
        if self.how.progress is not None:
            self.how.progress(SelectionProgress(self.names[i], done, count, min(c.rms for c in candidates)))


def distinct(formulas: Sequence[Formula], data: Prepared) -> list[Formula]:
    """The formulas simplified, without those of the same form, in their order."""
    forms: dict[tuple, Formula] = {}
    for formula in formulas:
        short = simplified(formula, data.shape.features)
        if np.all(np.isfinite(short.constants)):
            forms.setdefault(short.tokens, short)
    return list(forms.values())


def _with_one_zero(formula: Formula, data: Prepared) -> list[Formula]:
    """The shorter formulas that are left when one constant is zero."""
    left = []
    for k in range(len(formula.constants)):
        constants = (*formula.constants[:k], 0.0, *formula.constants[k + 1 :])
        left.append(Formula(formula.tokens, constants))
    return [f for f in distinct(left, data) if len(f.tokens) < len(formula.tokens)]


def _finalists(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best, among them for every size only the best two, and of the front those of other sizes."""
    kept: list[Candidate] = []
    for c in sorted(candidates, key=lambda c: c.rank):
        if sum(k.size == c.size for k in kept) < 2:
            kept.append(c)
    best = kept[:FINALISTS]
    return best + [c for c in pareto(candidates) if c not in best]


def pareto(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those whose run stays and than which no other is both shorter and better, the shortest first."""
    front: list[Candidate] = []
    for c in sorted(candidates, key=lambda c: (c.size, c.rank)):
        if np.isfinite(c.error) and (not front or c.error < front[-1].error):
            front.append(c)
    return front


def linear_formulas(data: Prepared, i: int, terms: int = 4) -> list[Formula]:
    """Linear formulas of the increment of output ``i`` with one to ``terms`` features, added greedily, and a shift."""
    z, d = data.pairs(data.fit)
    chosen: list[int] = []
    answer = []
    for _ in range(min(terms, z.shape[1])):
        errors = {}
        for j in (j for j in range(z.shape[1]) if j not in chosen):
            A = np.column_stack([np.ones(len(z)), z[:, [*chosen, j]]])
            errors[j] = float(np.sum((A @ np.linalg.lstsq(A, d[:, i], rcond=None)[0] - d[:, i]) ** 2))
        chosen.append(min(errors, key=errors.get))
        A = np.column_stack([np.ones(len(z)), z[:, chosen]])
        shift, *factors = np.linalg.lstsq(A, d[:, i], rcond=None)[0].tolist()
        products = [t for j in chosen for t in (MULTIPLY, CONSTANT, VARIABLE + j)]
        answer.append(Formula((ADD,) * len(chosen) + (CONSTANT, *products), (shift, *factors)))
    return answer


def _brief(data: Prepared, seed: int) -> Prepared:
    """The same recordings with a few short stretches to fit, and the beginnings of the runs to judge on."""
    stretches = cut(data.fit, STRETCH)
    drawn = np.sort(np.random.default_rng(seed).permutation(len(stretches))[:FEW_STRETCHES])
    each = max(FEW_SAMPLES // len(data.judged), STRETCH)
    parts = [(p, begin, min(end, begin + each)) for p in data.judged for begin, end in p.ranges]
    begun = [Piece(p.series, begin, end, p.rest and begin == p.first) for p, begin, end in parts]
    few = [stretches[k] for k in drawn]
    return replace(data, fit=few, folds=[(few, begun)])


def _refit(data: Prepared, formula: Formula, own: Sequence[int], evaluations: int) -> Formula:
    return data.run(formula, own).refit(data.laid_out(data.fit, own), evaluations)


def _judged_apart(data: Prepared, formula: Formula, i: int) -> tuple[float, float, tuple]:
    """Error, RMS, and RMS by fold of a formula whose constants are fitted without what judges them."""
    run, errors = data.run(formula, [i]), []
    for fit, judged in data.folds:
        runs = data.laid_out(judged, [i])
        fitted = run.refit(data.laid_out(fit, [i]), LONG)
        errors.append((*run.errors(fitted.constants, runs), runs.inside.sum()))
    error, rms, samples = np.array(errors).T
    whole = (float(np.sqrt(np.average(e**2, weights=samples))) for e in (error, rms))
    return *whole, tuple(rms.tolist())


def _as_good(candidate: Candidate, best: Candidate) -> bool:
    """Whether the folds do not tell a candidate from the best (`verdicts.as_good`)."""
    return len(candidate.folds) > 1 and bool(np.isfinite(candidate.error)) and as_good(candidate.folds, best.folds)


def _better(more: Candidate, than: Candidate, tolerance: float) -> bool:
    """Whether a candidate is better on more than chance; by one fold alone, by more than the tolerance."""
    if len(more.folds) < 2:
        return more.error * (1 + tolerance) < than.error
    mean, error = log_ratio(more.folds, than.folds)
    return more.error < than.error and mean + SURE * error < 0


def judged_errors(data: Prepared, formula: Formula, own: Sequence[int] | None = None) -> tuple[float, float]:
    """The errors of `Run.errors` where formulas are judged; by default of all outputs together."""
    own = range(data.shape.outputs) if own is None else own
    return data.run(formula, own).errors(formula.constants, data.laid_out(data.judged, own))
