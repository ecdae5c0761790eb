"""Which network: its form, size and training are chosen by free runs over parts of the recordings that are held out.

Linear models first, by least squares and a few iterations in free run: they cost little and decide on period, lags,
delay, and whether the outputs integrate. Around the best of them networks are trained, and the linear model stays where
none is better. Every figure is pooled over the same parts at the recordings' own times, whatever the period.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, tidy

from ..substeps import chosen_substeps
from ..training_data import recorded_period
from .form import Form
from .series import Series, series, squares
from .training import Ended, Meter, Problem, Stage

FACTORS = (1, 2, 5, 10, 20, 50, 100)  # periods that are tried, over that of the recordings
LONGEST, FEWEST = 8000, 200  # samples of one recording, and of all, at a period that is tried
OUTPUT_LAGS, INPUT_LAGS, DELAYS = (1, 3), (2, 5), (1, 2, 3, 5, 8, 13)
PERIODS, NEAR = 3, 2.0  # periods at which a network is tried: the best, those within so many times its error
HIDDEN = (4, 8, 14)  # units that are tried
ROWS = 8  # samples at the period for every weight of a network, at least
DECAYS = (1e-6, 1e-4)  # of the squared distance from the linear model, in units of the mean squared error
GAIN = 0.9  # of the linear model's error: what networks must stay under, in the median over seeds, to be taken
FEW, PARTS_OF_MANY = 60_000, 2  # recorded samples; of more, so many parts are held out in turn
LOOK = (Stage(32, 6),)
LINEAR = (Stage(32, 6), Stage(256, 6), Stage(1500, 6))
SHORT = (Stage(32, 8), Stage(256, 8), Stage(1500, 6))
FULL = (Stage(32, 16), Stage(256, 16), Stage(None, 16))
WHOLE = (Stage(None, 16),)  # of what was trained without a part, on all recordings


@dataclass(frozen=True)
class Asked:
    """What the user has fixed; None: chosen. effort : scales the iterations."""

    period: float | None = None
    output_lags: int | None = None
    input_lags: int | None = None
    delay: int | None = None
    integrates: bool | None = None
    hidden: int | None = None
    seed: int = 0
    starts: int = 3
    effort: float = 1.0
    substeps: int | None = None

    def stages(self, stages: Sequence[Stage]) -> list[Stage]:
        """With that effort."""
        return [Stage(s.horizon, max(1, round(self.effort * s.iterations))) for s in stages]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A form, how it is trained, and its free-run error (RMS over spreads) on what was held out.

    stages : those it is trained through, none: least squares alone. around : the linear one that a network starts from.
    weights : trained without each of the parts held out.
    """

    form: Form
    error: float
    stages: Sequence[Stage]
    weights: Sequence[np.ndarray]
    decay: float = 0.0
    seed: int = 0
    around: Candidate | None = None


@dataclass(eq=False)
class Search:
    """The recordings, what was asked, and the candidates so far."""

    records: Sequence[Record]
    select: Sequence[Record]
    inputs: Sequence[Signal]
    outputs: Sequence[Signal]
    asked: Asked
    meter: Meter
    best: Candidate | None = None
    seeds: list[dict] = field(default_factory=list)
    _series: dict[float, Series] = field(default_factory=dict)
    _folds: dict[float, list] = field(default_factory=dict)

    def run(self) -> None:
        """Look at linear forms, then at networks; `best` is what there is when time or patience ends."""
        try:
            linear = self._linear()
            if self.asked.hidden != 0:
                self._networks(linear)
        except Ended:
            pass

    def trained(self) -> tuple[Candidate, np.ndarray]:
        """The best candidate, and its weights when trained on all recordings; those it has where time is up.

        A training may end badly: each that was run without a part goes on with all parts, one begins anew, and the one
        is taken whose free run over all recordings is the best.
        """
        found = self.best
        problem, ends = self.problem(found.form), list(found.weights)
        try:
            if not self.meter.stopped:
                ends.append(self._whole(found))
                for weights in found.weights:
                    ends += self._on(problem, found, weights)
        except Ended:
            pass
        return found, min(ends, key=lambda w: (problem.grows(w), problem.judge(w, problem.series.pieces)))

    def _on(self, problem: Problem, found: Candidate, weights: np.ndarray) -> list[np.ndarray]:
        """Weights that were trained without a part, trained on with all of them."""
        if not found.stages:
            return []
        pieces = problem.series.pieces
        return problem.path(weights, weights, pieces, self.asked.stages(WHOLE), found.decay, self.meter, found.seed)

    def problem(self, form: Form) -> Problem:
        """A form over the recordings at its period."""
        return Problem.of(form, self.series(form.period))

    def series(self, period: float) -> Series:
        """The recordings at a period."""
        if period not in self._series:
            given = self.records, self.select, self.inputs, self.outputs
            self._series[period] = series(*given, period, self.steps(period))
        return self._series[period]

    def steps(self, period: float) -> int:
        """Steps of a period, over which inputs are means."""
        return chosen_substeps(
            self.asked.substeps, self.asked.period, [*self.records, *self.select], self.inputs, period
        )

    # -- linear forms --------------------------------------------------------------------------------------------------
    def _linear(self) -> list[Candidate]:
        """Refined linear candidates, best first: at every period the best, and the best of the most lags."""
        looked = [self._judged(form, LOOK) for form in self._forms()]
        looked.sort(key=lambda c: c.error)
        refined = [self._judged(c.form, LINEAR) for c in _of_every_period(looked)]
        first = min(refined, key=lambda c: c.error)
        refined += [self._judged(f, LINEAR) for f in self._delayed(first.form)]
        return sorted(refined, key=lambda c: c.error)

    def _forms(self) -> list[Form]:
        asked, delay = self.asked, self.asked.delay or 0
        lags = product(_one(asked.output_lags, OUTPUT_LAGS), _one(asked.input_lags, INPUT_LAGS))
        integrates = _one(asked.integrates, (False, True))
        return [
            Form(period, n, max(m, delay + 1), delay, how)
            for period, (n, m), how in product(self.periods(), list(lags), integrates)
        ]

    def periods(self) -> list[float]:
        """Those that are tried [s]."""
        if self.asked.period:
            return [float(self.asked.period)]
        recorded = recorded_period(self.records)
        longest, all_ = max(r.duration for r in self.records), sum(r.duration for r in self.records)
        tried = [f * recorded for f in FACTORS if f * recorded * FEWEST <= all_ or f == 1]
        kept = [p for p in tried if longest <= 1.01 * LONGEST * p] or tried[-1:]
        return [tidy(p) for p in kept]

    def _delayed(self, form: Form) -> list[Form]:
        """The best form with other delays, those that a look finds better."""
        if self.asked.delay is not None or self.asked.input_lags is not None:
            return []
        samples = form.input_lags
        forms = [replace(form, delay=d, input_lags=d + samples) for d in DELAYS]
        room = min(len(p.time) for p in self.series(form.period).pieces) // 8
        looked = [self._judged(f, LOOK) for f in forms if f.input_lags < room]
        here = self._judged(form, LOOK).error
        return [c.form for c in sorted(looked, key=lambda c: c.error)[:1] if c.error < GAIN * here]

    def _judged(self, form: Form, stages: Sequence[Stage]) -> Candidate:
        """A linear form, by least squares and free runs."""
        problem = self.problem(form)

        def start(pieces):
            first = problem.least_squares(pieces)
            return first, first

        return self._held_out(problem, start, stages, 0.0, self.asked.seed)

    # -- networks ------------------------------------------------------------------------------------------------------
    def _networks(self, linear: Sequence[Candidate]) -> None:
        """Networks around the best linear forms, one choice after the other, then several seeds of the best."""
        alone = self.best  # of all linear ones
        near = [c for c in _first_of_periods(linear) if c.error <= NEAR * linear[0].error][:PERIODS]
        best = None
        for base, hidden in ((c, h) for c in near for h in self._sizes(c)[:1]):
            best = self._short(base, hidden, DECAYS[0], True, best)
        if best is None:
            return
        for change in VARIANTS:
            for base, places, hidden, decay in change(self, best, linear):
                best = self._short(base, hidden, decay, places, best)
        ends = []
        for seed in range(self.asked.seed, self.asked.seed + self.asked.starts):
            ends.append(self._network(best.around, best.form.hidden, best.decay, best.form.places, FULL, seed))
            self.seeds.append({"seed": seed, "held_out_error": ends[-1].error})
        helps = float(np.median([c.error for c in ends])) < GAIN * alone.error
        self.best = min(ends, key=lambda c: c.error) if helps or self.asked.hidden else alone

    def _of_other_lags(self, best: Candidate, linear: Sequence[Candidate]):
        """Around the other linear candidates of that period: what suits a linear model may not suit a network."""
        for c in linear:
            if c.form.period == best.form.period and c is not best.around:
                yield c, True, best.form.hidden, best.decay

    def _of_other_sight(self, best: Candidate, linear: Sequence[Candidate]):
        """Blind to where the output is, if it integrates."""
        if best.form.integrates:
            yield best.around, False, best.form.hidden, best.decay

    def _of_other_decay(self, best: Candidate, linear: Sequence[Candidate]):
        """Drawn to the linear model more strongly."""
        for decay in DECAYS[1:]:
            yield best.around, best.form.places, best.form.hidden, decay

    def _of_other_size(self, best: Candidate, linear: Sequence[Candidate]):
        """Fewer and more hidden units."""
        for hidden in self._sizes(best.around):
            if hidden != best.form.hidden:
                yield best.around, best.form.places, hidden, best.decay

    def _sizes(self, linear: Candidate) -> list[int]:
        """Numbers of hidden units that the samples bear; the middle one first."""
        if self.asked.hidden is not None:
            return [self.asked.hidden]
        rows = sum(len(p.time) for p in self.series(linear.form.period).pieces) * len(self.outputs)
        sizes = [h for h in HIDDEN if ROWS * self.problem(linear.form.with_hidden(h)).shape.size <= rows]
        return sorted(sizes, key=lambda h: h != HIDDEN[1])

    def _short(self, linear: Candidate, hidden: int, decay: float, places: bool, best: Candidate | None):
        """The best so far, or the better of two seeds after a short training, where several are asked for.

        One seed alone may end badly.
        """
        for seed in range(self.asked.seed, self.asked.seed + min(2, self.asked.starts)):
            beat = best.error if best else np.inf
            one = self._network(linear, hidden, decay, places, SHORT, seed, beat)
            best = one if best is None or one.error < beat else best
        return best

    def _network(
        self, linear: Candidate, hidden: int, decay: float, places: bool, stages, seed: int, beat: float = np.inf
    ) -> Candidate:
        """A network around a linear candidate."""
        problem, around = self.problem(linear.form.with_hidden(hidden, places)), self.problem(linear.form)

        def start(pieces):
            return problem.around(self._refined(around, linear, pieces), around.shape, seed)

        return self._held_out(problem, start, stages, decay, seed, linear, beat)

    def _refined(self, problem: Problem, linear: Candidate, pieces) -> np.ndarray:
        """The weights of a linear candidate on ``pieces``."""
        first = problem.least_squares(pieces)
        return [first, *problem.path(first, first, pieces, linear.stages, 0.0, self.meter, linear.seed)][-1]

    # -- both ----------------------------------------------------------------------------------------------------------
    def _held_out(
        self, problem: Problem, start: Callable, stages, decay: float, seed: int, around: Candidate | None = None,
        beat: float = np.inf,
    ) -> Candidate:  # fmt: skip
        """The candidate at the stage after which it runs best on all parts held out.

        One whose error over the parts so far is alone too much to ``beat`` goes no further: its error is infinite.
        """
        stages, folds = self.asked.stages(stages), self._folds_at(problem.form.period)
        totals, count, kept = np.zeros(len(stages) + 1), 0, []
        most = beat**2 * sum(len(piece.times) for _, held in folds for piece in held) * len(self.outputs)
        for fit, held in folds:
            first, centre = start(fit)
            self._fall_back(problem, first, held, around, seed)
            ends = [first, *problem.path(first, centre, fit, stages, decay, self.meter, seed)]
            found = [squares(w, held, problem.shape, problem.scales) for w in ends]
            bad = np.where([problem.grows(w) for w in ends], np.inf, 0.0)
            totals, count = totals + bad + [total.sum() for total, _ in found], count + found[0][1]
            kept.append(ends)
            if not (totals < most).any():
                break
        errors = np.sqrt(totals / max(count * len(self.outputs), 1))
        errors = np.where(np.isfinite(errors) & (len(kept) == len(folds)), errors, np.inf)
        at = int(errors.argmin())
        one = Candidate(problem.form, float(errors[at]), stages[:at], [ends[at] for ends in kept], decay, seed, around)
        self._note(one)
        return one

    def _folds_at(self, period: float) -> list[tuple]:
        """What is trained and judged on in turn at a period, made once: all candidates share what follows from it."""
        if period not in self._folds:
            parts = PARTS_OF_MANY if sum(len(r) for r in self.records) > FEW else 4
            self._folds[period] = self.series(period).folds(parts)
        return self._folds[period]

    def _fall_back(self, problem, weights, held, around, seed: int) -> None:
        """Something to answer, before any candidate is complete."""
        if self.best is None:
            self.best = Candidate(problem.form, problem.judge(weights, held), (), [weights], 0.0, seed, around)
            self.meter.best = self.best.error

    def _note(self, one: Candidate) -> None:
        """The better of this and the best; a network must be better than what is linear by a margin."""
        margin = GAIN if one.form.hidden and not self.best.form.hidden else 1.0
        if one.error < margin * self.best.error:
            self.best = one
        self.meter.best = min(self.meter.best, one.error)

    def _whole(self, found: Candidate) -> np.ndarray:
        """The weights of a candidate on all recordings."""
        problem = self.problem(found.form)
        pieces = problem.series.pieces
        if found.around is None:
            return self._refined(problem, found, pieces)
        around = self.problem(found.around.form)
        first, centre = problem.around(self._refined(around, found.around, pieces), around.shape, found.seed)
        return [first, *problem.path(first, centre, pieces, found.stages, found.decay, self.meter, found.seed)][-1]


VARIANTS = (Search._of_other_lags, Search._of_other_sight, Search._of_other_decay, Search._of_other_size)


def _one(asked, choices: Sequence) -> Sequence:
    return choices if asked is None else (asked,)


def _of_every_period(looked: Sequence[Candidate]) -> list[Candidate]:
    """Of every period the best, and the best of those with the most lags: a short look is not fair to them."""
    kept = []
    for period in dict.fromkeys(c.form.period for c in looked):
        own = [c for c in looked if c.form.period == period]
        most = max((c.form.output_lags, c.form.input_lags) for c in own)
        kept += [own[0], next(c for c in own if (c.form.output_lags, c.form.input_lags) == most)]
    return list(dict.fromkeys(kept))


def _first_of_periods(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The first of every period."""
    return list({c.form.period: c for c in reversed(candidates)}.values())[::-1]
