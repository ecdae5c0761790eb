"""How good a block runs freely on what was held out, beside what costs little: holding, ARX, a curve.

All run from the first samples of the recordings, and are counted where they were held out, see `held_out`; what is held
is the last sample before that, for a block knows from its training where the outputs had come to by then. Where the
stretches held out disagree about which is better, the card says that it cannot tell (`verdicts`).

The card is written into the block (``provenance["free_run"]``) and said in one sentence, which begins with the bad news
where there is some.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import display_units, from_si
from hydrotwin.records import Record
from hydrotwin.simulation import Block, predict_one_step, simulate
from hydrotwin.simulation.stops import Diverged

from .bands import RUNS, band_of
from .grey_box.data import block_period
from .held_out import Part, Split, through
from .left_over import LeftOver, left_over
from .linear.arx import learn_arx
from .piecewise.learn import learn_piecewise
from .verdicts import BETTER, NOTHING, rms_of, surely_less

HOLD, MEAN, CURVE, MODEL = "holding the last sample", "the mean", "a piecewise linear curve", "the model alone"
ARX = "ARX"
EXACT = 1e-9  # of the range: an error that is none
BEYOND = 0.4  # of the range seen in training: a free run further outside it has diverged
SAMPLES = 6000  # of the curve's own run over all recordings: a yardstick may cost little
ADVICE = "Record more: held levels, ramps and steps of every input over the range that matters; or try another kind."
REPEATS = (
    "What was held out repeats commands that were trained on: it cannot tell how good the block is at other "
    "commands, beside ARX or anything else. Record some that do not repeat, last."
)
MARGIN = f", for less than {100 * (1 - BETTER):.2g} % apart is alike"
RUN, STEADY = "free_run", "held_out"  # of the provenance: the card of what runs, and of what is steady
FREE, ONE_STEP = "free_run", "one_step"
BLOCK = "the block"  # in `Row.stretches`
Run = Callable[[Record], Record]


@dataclass(frozen=True)
class Row:
    """One output: RMS error of the free run and of each yardstick, SI; range in the recordings; where it diverged.

    errors : further errors of the free run by name, SI (mae, maximum, bias) and percent (fit_percent). band : how the
    95 % band holds in free run, see `bands.band_of`.
    one_step : RMS error from measured sample to sample, None where no state is the output. left : of the free run, and
    of one step. stretches : RMS errors by stretch of what was held out, of `BLOCK` and of each yardstick.
    """

    output: Signal
    rmse: float
    range: float
    yardsticks: Mapping[str, float]
    diverged: str = ""
    one_step: float | None = None
    left: Mapping[str, LeftOver] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    band: Mapping[str, object] = field(default_factory=dict)
    stretches: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @property
    def no_better_than(self) -> list[str]:
        """The yardsticks that the block does not beat."""
        exact = EXACT * self.range  # what is so good is no worse than anything: rounding would decide
        return [n for n, error in self.yardsticks.items() if not self.rmse < BETTER * error and not self.rmse <= exact]

    @property
    def cannot_tell(self) -> list[str]:
        """The yardsticks that it beats over all, but by no more than the stretches differ among each other."""
        known = [n for n in self.yardsticks if n not in self.no_better_than and n in self.stretches]
        return [n for n in known if not surely_less(self.stretches[BLOCK], self.stretches[n])]

    def undecided(self, name: str) -> str:
        """How the stretches disagree about the block and a yardstick, in words."""
        apart = [
            own / max(rival, NOTHING) for own, rival in zip(self.stretches[BLOCK], self.stretches[name], strict=True)
        ]
        return f"{name} (over {len(apart)} stretches it has {min(apart):.2g} to {max(apart):.2g} times its error)"

    def told(self) -> dict:
        """For the provenance and JSON: SI, and as a share of the range."""
        answer = {"unit": self.output.unit, "range": self.range, "yardsticks": dict(self.yardsticks)}
        answer |= {"no_better_than": self.no_better_than, "cannot_tell": self.cannot_tell}
        answer["stretches"] = {name: list(errors) for name, errors in self.stretches.items()}
        if np.isfinite(self.rmse):
            answer |= {"rmse": self.rmse, "percent_of_range": 100 * self.rmse / self.range, **self.errors}
        if self.one_step is not None:
            answer["one_step"] = {"rmse": self.one_step}
        if self.left:
            answer["left"] = {of: part.told() for of, part in self.left.items()}
        answer |= {"band": dict(self.band)} if self.band else {}
        return answer | ({"diverged": self.diverged} if self.diverged else {})

    def band_said(self) -> str:
        """A band that does not hold, in a sentence; else empty."""
        if self.band.get("trustworthy") or "coverage" not in self.band:
            return ""
        inside = 100 * self.band["coverage"]
        return f"The 95 % band of {self.output.name} holds {inside:.3g} % of what was held out: do not rely on it."

    def said(self) -> str:
        """In the unit that a person reads."""
        apart = ", ".join(f"{name} {shown(error, self.output.unit)}" for name, error in self.yardsticks.items())
        own = f"{shown(self.rmse, self.output.unit)}, {100 * self.rmse / self.range:.2g} % of its range"
        if len(self.stretches.get(BLOCK, ())) > 1:
            low, high = (shown(end(self.stretches[BLOCK]), self.output.unit) for end in (min, max))
            own += f", {low} to {high} by stretch"
        own += f", one step ahead {shown(self.one_step, self.output.unit)}" if self.one_step is not None else ""
        return f"{self.output.name} {own} ({apart})"


def further(measured: np.ndarray, miss: np.ndarray) -> dict[str, float]:
    """Errors of a run beside its RMS, (n,) SI."""
    swing = float(np.linalg.norm(measured - measured.mean()))
    fit = {"fit_percent": 100 * (1 - float(np.linalg.norm(miss)) / swing)} if swing > 0 else {}
    return {
        "mae": float(np.abs(miss).mean()),
        "maximum": float(np.abs(miss).max()),
        "bias": float(miss.mean()),
        **fit,
    }


@dataclass(frozen=True)
class Words:
    """Sentences of who knows the kind of block: bad news to begin with, notes to end with.

    repeats : what was held out repeats what was trained on, see `repeats`.
    """

    bad: Sequence[str] = ()
    notes: Sequence[str] = ()
    repeats: bool = False


def card(split: Split, rows: Sequence[Row], words: Words) -> dict:
    """The card as it is stored: what was held out, a row per output, and the sentences."""
    if not rows:
        return unknown(f"{split.why.rstrip('.')}. How well the block runs freely is not known.", words)
    good = f"Free run on what was held out ({_parts(split)}): RMS error of {'; '.join(row.said() for row in rows)}."
    notes = [row.left[FREE].said(row.output.name) for row in rows if FREE in row.left]
    notes += [row.band_said() for row in rows]
    return carded(rows, words, split.told(), [good, *filter(None, notes)])


def card_of(block: Block) -> Mapping:
    """The card of a block that was learnt; empty where it has none."""
    provenance = getattr(block, "provenance", {})
    return provenance.get(RUN) or provenance.get(STEADY) or {}


def unknown(why: str, words: Words) -> dict:
    """The card of a block that nothing could be held out of."""
    none: dict = {"held_out": [], "outputs": {}, "bad": True, "no_better_than": [], "cannot_tell": []}
    return none | {"says": " ".join([*words.bad, f"Nothing was held out: {why}", *words.notes])}


def carded(rows: Sequence[Row], words: Words, held_out: Sequence[Mapping], found: Sequence[str]) -> dict:
    """A card of rows: what they say against the block first, then what was found, then the notes."""
    worse = {row.output.name: row.no_better_than for row in rows if row.no_better_than}
    close = {row.output.name for row in rows if any(row.rmse < row.yardsticks[n] for n in row.no_better_than)}
    bad = [*words.bad, *([REPEATS] if words.repeats else [])]
    bad += [f"Of {row.output.name} the block {row.diverged}." for row in rows if row.diverged]
    bad += [f"Of {name} the block is no better than {' or '.join(than)}{MARGIN if name in close else ''}."
            for name, than in worse.items()]  # fmt: skip
    for row in (row for row in rows if row.cannot_tell):
        than = " or ".join(row.undecided(name) for name in row.cannot_tell)
        bad.append(f"Of {row.output.name} the recordings cannot tell whether the block is better than {than}.")
    bad += [ADVICE] if any(HOLD in than or MEAN in than for than in worse.values()) else []
    return {
        "held_out": list(held_out),
        "outputs": {row.output.name: row.told() for row in rows},
        "bad": bool(bad),
        "no_better_than": sorted({name for than in worse.values() for name in than}),
        "cannot_tell": sorted({n for row in rows for n in (_beaten(row) if words.repeats else row.cannot_tell)}),
        "repeats": words.repeats,
        "says": " ".join([*bad, *found, *words.notes]),
    }


def _beaten(row: Row) -> list[str]:
    return [name for name in row.yardsticks if name not in row.no_better_than]


def judged(block: Block, split: Split, outputs: Sequence[str], more: Mapping[str, Run], seen: Sequence[Record]) -> list:
    """A `Row` for each of ``outputs``: the block and the yardsticks over ``split.parts``.

    more : `yardsticks`, each with what it answers to a recording. seen : all training recordings, for the range.
    """
    parts, measured = split.parts, split.held_out
    apart = {HOLD: {n: [r[n][0] - r[n] for r in measured] for n in outputs}}
    apart |= {name: _misses(run, parts, outputs) for name, run in more.items()}
    found, diverged = _runs(block, parts)
    ahead = _one_step(block, parts) if not diverged else {}
    bands = {} if diverged else {name: _band(told) for name, told in band_of(block, parts).items()}
    rows = []
    for signal in (s for s in block.outputs if s.name in outputs):
        name, values = signal.name, np.concatenate([r[signal.name] for r in seen])
        misses = [run[name] - r[name] for run, r in zip(found, measured, strict=not diverged)]
        far = diverged or _left(found, signal, values.min(), values.max())
        rivals = {yardstick: per[name] for yardstick, per in apart.items() if name in per}
        rows.append(
            Row(
                signal,
                np.inf if diverged else _rms(misses),
                float(np.ptp(values)),
                {yardstick: _rms(per) for yardstick, per in rivals.items()},
                far,
                _rms(ahead[name]) if name in ahead else None,
                {} if far else _all_left(block, parts, misses, ahead.get(name)),
                {} if diverged else further(np.concatenate([r[name] for r in measured]), np.concatenate(misses)),
                bands.get(name, {}),
                {} if diverged else {BLOCK: rms_of(misses)} | {n: rms_of(per) for n, per in rivals.items()},
            )
        )
    return rows


def figures(block: Block, split: Split, outputs: Sequence[str], seen: Sequence[Record]) -> tuple[dict, dict]:
    """What a card says of the block alone, by output over the range: RMS errors, and those of every stretch.

    Infinite, and no stretches, where it diverges; nothing where nothing was held out. Arguments: as of `judged`.
    """
    if not split.parts:
        return {}, {}
    runs, diverged = _runs(block, split.parts)
    if diverged:
        return dict.fromkeys(outputs, np.inf), {}
    shares, stretches = {}, {}
    for name in outputs:
        range_ = float(np.ptp(np.concatenate([r[name] for r in seen])))
        misses = [run[name] - part.seen[name] for run, part in zip(runs, split.parts, strict=True)]
        shares[name], stretches[name] = _rms(misses) / range_, [e / range_ for e in rms_of(misses)]
    return shares, stretches


def _band(told: Mapping) -> dict:
    """What the card keeps of a band: its source, coverage and half width (SI), free run and one step."""
    modes = {mode: {key: told[mode][key] for key in ("coverage", "half_width")} for mode in RUNS if mode in told}
    free = modes.get("free_run", {})
    return {"source": told["source"], "trustworthy": told["trustworthy"], **free, **modes}


def yardsticks_of(kind: str, with_model: bool) -> list[str]:
    """Names of all that a block of ``kind`` may be held against."""
    own = [*([] if kind == "arx" else [ARX]), *([] if kind == "piecewise" else [CURVE])]
    return [HOLD, MEAN, *own, *([MODEL] if with_model else [])]


def yardsticks(kind: str, split: Split, inputs: Sequence[str], outputs: Sequence[str]) -> dict[str, Run]:
    """What a block of ``kind`` is measured by, of what is trained on: the mean, ARX and a piecewise linear curve.

    Neither of the last two where it is the kind itself, or cannot be fitted.
    """
    mean = {n: float(np.mean(np.concatenate([r[n] for r in split.fit]))) for n in outputs}
    found: dict[str, Run] = {MEAN: lambda record: constant(record, mean)}
    found |= {} if kind == "arx" else _arx(split, inputs, outputs)
    return found if kind == "piecewise" else found | _curve(split, inputs, outputs)


def _arx(split: Split, inputs: Sequence[str], outputs: Sequence[str]) -> dict[str, Run]:
    """Of the signals that move."""
    moving = [[n for n in part if any(np.ptp(r[n]) > 0 for r in split.fit)] for part in (inputs, outputs)]
    try:
        block = learn_arx(split.fit, *moving)
    except DataError:
        return {}
    return {ARX: lambda record: simulate(block, record)}


def _curve(split: Split, inputs: Sequence[str], outputs: Sequence[str]) -> dict[str, Run]:
    """For one input and one output."""
    if len(inputs) != 1 or len(outputs) != 1:
        return {}
    try:
        period = max(block_period("", split.fit, None), sum(r.duration for r in split.fit) / SAMPLES)
        block = learn_piecewise(split.fit, inputs, outputs, period=period, starts=1)
    except DataError:
        return {}
    return {CURVE: lambda record: simulate(block, record)}


def _one_step(block: Block, parts: Sequence[Part]) -> dict[str, list[np.ndarray]]:
    """Misses (n - 1,) per part of every output that is a state, predicted from measured sample to sample."""
    names = {s.measured_by for s in block.states} & {s.name for s in block.outputs}
    try:
        found = through(lambda r: predict_one_step(block, r), parts) if names else []
    except (DataError, Diverged):
        return {}
    return {n: [run[n][1:] - p.seen[n][1:] for run, p in zip(found, parts, strict=True)] for n in names}


def _all_left(block: Block, parts: Sequence[Part], misses, ahead) -> dict[str, LeftOver]:
    """What the free run leaves, and what is left one step ahead where that is known."""
    records = [part.seen for part in parts]
    left = {FREE: left_over([-m for m in misses], records, _moving(block, records))}
    if ahead is not None:
        left[ONE_STEP] = left_over([-m for m in ahead], [r.window(r.time[1], None) for r in records], ())
    return left


def _moving(block: Block, records: Sequence[Record]) -> list[str]:
    """The block's inputs that move, where every recording has them."""
    names = [s.name for s in block.inputs]
    return [n for n in names if all(n in r for r in records) and any(np.ptp(r[n]) > 0 for r in records)]


def _rms(misses: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(misses) ** 2)))


def constant(record: Record, values: Mapping[str, float]) -> Record:
    """The recording with signals that stay at ``values``."""
    return record.with_signals({name: np.full(len(record), value) for name, value in values.items()})


def _misses(run: Run, parts: Sequence[Part], outputs: Sequence[str]) -> dict[str, list[np.ndarray]]:
    """What a yardstick misses by (n,) in every part, by output; none where it cannot run."""
    try:
        runs = through(run, parts)
    except (DataError, Diverged):
        return {}
    return {
        n: [found[n] - part.seen[n] for found, part in zip(runs, parts, strict=True)]
        for n in outputs
        if all(n in found for found in runs)
    }


def _runs(block: Block, parts: Sequence[Part]) -> tuple[list[Record], str]:
    """Free runs in the parts, and what ended them where they left the finite numbers; then there are none."""
    begun: list[str] = []

    def run(whole: Record) -> Record:
        begun.append(whole.name)
        return simulate(block, whole)

    try:
        return through(run, parts), ""
    except Diverged as error:
        return [], f"diverges in free run, beyond the finite numbers {error.time:g} s into '{begun[-1]}'"


def _left(runs: Sequence[Record], signal: Signal, low: float, high: float) -> str:
    """Words for a run far outside what was seen, else empty."""
    values = np.concatenate([run[signal.name] for run in runs])
    worst = float(values[np.argmax(np.maximum(low - values, values - high))])
    if max(low - worst, worst - high) <= BEYOND * (high - low):
        return ""
    ends = f"{shown(low, signal.unit)} to {shown(high, signal.unit)}"
    return f"diverges in free run: it reaches {shown(worst, signal.unit)}, in training it was {ends}"


def _parts(split: Split) -> str:
    seconds, many = sum(r.duration for r in split.held_out), len(split.parts) > 1
    return f"{seconds:.3g} s of {len(split.parts)} recording{'s' if many else ''}, run from the first sample"


def shown(value: float, unit: str) -> str:
    """A difference in the unit that a person reads."""
    if unit == "1":
        return f"{value:.3g}"
    read = display_units(unit)[0]
    apart = from_si(float(value), read) - from_si(0.0, read) if np.isfinite(value) else value
    return f"{apart:.3g} {read}"
